# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""One suite of laws over every solver of relative motions, then what each promises alone."""

import itertools
import json
import os
from pathlib import Path
import subprocess
import sys

from motion_data import perturb, random_pose, sensor_pair, stamps, wander
import numpy as np
import pytest
from scipy.optimize import least_squares

from trajectory_calibration import (
    calibrate,
    CalibrationConfig,
    CalibrationError,
    ConfigError,
    MotionError,
    Trajectory,
)
from trajectory_calibration.assessment.metrics import absolute_errors
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.geometry import se3
from trajectory_calibration.solvers import load_solver, quadratic, SOLVER_NAMES
from trajectory_calibration.solvers.least_trimmed_squares import TrimmedCost
from trajectory_calibration.time_alignment.pairing import associate

PAPER = ['dnl', 'dnlo', 'ali', 'park', 'taylor', 'zhuang']
JOINT = ['dnl', 'dnlo', 'ali']
SEPARABLE = ['park', 'taylor', 'zhuang']
REFERENCES = ['A', 'B1', 'B5', 'B10', 'C5', 'C10']

IDENTITY = np.eye(4)
BACK_TO_BACK = se3.from_rotation_translation(np.diag([-1.0, -1.0, 1.0]), [-1.2, 0.0, 0.1])
UPSIDE_DOWN = se3.from_rotation_translation(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, -0.4])
CAMERA = se3.from_rotation_translation(
    [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [0.3, 0.05, -0.1])
FAR = se3.from_rotation_translation(np.eye(3), [12.0, -3.0, 5.0])


def solve(name, a, b, reference='B5', **settings):
    config = CalibrationConfig(solver=name, reference=reference, **settings)
    motions = select_motions(associate(a, b), reference)
    return load_solver(name)(motions, config)


# Laws -----------------------------------------------------------------------------------------


@pytest.mark.parametrize('reference', REFERENCES)
@pytest.mark.parametrize('name', PAPER)
def test_recovers_any_extrinsic_exactly_without_noise(name, reference):
    for seed in range(10):
        rng = np.random.default_rng(seed)
        X = random_pose(rng)
        found = absolute_errors(solve(name, *sensor_pair(rng, X), reference).T_a_b, X)
        assert found.e_at < 1e-10
        assert found.e_aR < 1e-10


@pytest.mark.parametrize('X', [IDENTITY, BACK_TO_BACK, UPSIDE_DOWN, CAMERA, FAR],
                         ids=['identity', 'back-to-back', 'upside-down', 'camera', 'far'])
@pytest.mark.parametrize('name', PAPER)
def test_no_mounting_is_singular(name, X):
    rng = np.random.default_rng(7)
    found = absolute_errors(solve(name, *sensor_pair(rng, X)).T_a_b, X)
    assert found.e_at < 1e-9
    assert found.e_aR < 1e-10


@pytest.mark.parametrize('name', PAPER)
def test_just_beside_half_a_turn(name):
    for degrees in (179.0, 179.89, 179.91, 179.999999):
        rng = np.random.default_rng(8)
        X = se3.from_rotation_translation(
            se3.exp_so3(np.deg2rad(degrees) * np.array([0.6, 0.0, 0.8])), [0.3, 0.1, 0.2])
        found = absolute_errors(solve(name, *sensor_pair(rng, X)).T_a_b, X)
        assert found.e_at < 1e-7
        assert found.e_aR < 1e-7


@pytest.mark.parametrize('name, motions', [
    # Two motions give ali six equations for six unknowns, with more than one solution.
    (name, 3 if name == 'ali' else 2) for name in PAPER])
def test_two_motions_about_two_axes_are_enough(name, motions):
    rng = np.random.default_rng(9)
    X = random_pose(rng)
    a, b = sensor_pair(rng, X, poses=motions + 1, rotation=(0.5, 0.5, 0.5))
    found = absolute_errors(solve(name, a, b, 'B1').T_a_b, X)
    assert found.e_at < 1e-8
    assert found.e_aR < 1e-8


@pytest.mark.parametrize('name', PAPER)
def test_swapping_the_sensors_gives_the_inverse(name):
    rng = np.random.default_rng(10)
    a, b = sensor_pair(rng, random_pose(rng))
    forward, backward = solve(name, a, b).T_a_b, solve(name, b, a).T_a_b
    np.testing.assert_allclose(forward @ backward, np.eye(4), atol=1e-9)


@pytest.mark.parametrize('name', PAPER)
def test_moving_either_world_changes_nothing(name):
    rng = np.random.default_rng(11)
    a, b = sensor_pair(rng, random_pose(rng))
    a, b = perturb(rng, a, 0.002, 0.004), perturb(rng, b, 0.002, 0.004)
    moved_a = Trajectory(a.stamps_ns, random_pose(rng, distance=50) @ a.poses, 'x', 'lidar')
    moved_b = Trajectory(b.stamps_ns, random_pose(rng, distance=50) @ b.poses, 'y', 'camera')
    np.testing.assert_allclose(
        solve(name, moved_a, moved_b).T_a_b, solve(name, a, b).T_a_b, atol=1e-7)


@pytest.mark.parametrize('name', PAPER)
def test_the_answer_is_a_pose_and_always_the_same(name):
    rng = np.random.default_rng(12)
    a, b = sensor_pair(rng, random_pose(rng))
    a, b = perturb(rng, a, 0.01, 0.02), perturb(rng, b, 0.01, 0.02)
    first, second = solve(name, a, b), solve(name, a, b)
    np.testing.assert_array_equal(first.T_a_b, second.T_a_b)
    R = first.T_a_b[:3, :3]
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)
    assert first.cost >= 0


@pytest.mark.parametrize('name', PAPER)
def test_the_unit_of_the_body_frame_follows_a(name):
    """A turned sensor b turns the answer and nothing else (noise-free)."""
    rng = np.random.default_rng(13)
    X, turn = random_pose(rng), random_pose(rng)
    a, b = sensor_pair(rng, X)
    turned = Trajectory(b.stamps_ns, b.poses @ turn, 'map_b', 'camera')
    np.testing.assert_allclose(
        solve(name, a, turned).T_a_b, solve(name, a, b).T_a_b @ turn, atol=1e-9)


@pytest.mark.parametrize('name, lag, factor', [
    ('dnl', 'B10', 1.0), ('dnlo', 'B10', 1.3), ('park', 'B10', 1.3), ('taylor', 'B10', 1.3),
    ('ali', 'B10', 2.0), ('zhuang', 'B10', 4.0)])
def test_error_under_white_noise_is_of_the_order_of_sigma(name, lag, factor):
    """Rotation: 2 sigma_r / (lag angle sqrt(M)); translation: the same over the turned angle."""
    sigma_t, sigma_r = 0.002, 0.002
    errors = []
    for seed in range(15):
        rng = np.random.default_rng(seed)
        X = random_pose(rng, angle=np.pi / 2)
        a, b = sensor_pair(rng, X, poses=200)
        a, b = perturb(rng, a, sigma_t, sigma_r), perturb(rng, b, sigma_t, sigma_r)
        found = absolute_errors(solve(name, a, b, lag).T_a_b, X)
        errors.append((found.e_at, found.e_aR))
    e_at, e_aR = np.median(errors, axis=0)
    assert e_at < factor * sigma_t
    assert e_aR < factor * sigma_r


# Too little motion ----------------------------------------------------------------------------


@pytest.mark.parametrize('name', [*PAPER, 'drift_aware'])
def test_standing_still_is_refused(name):
    still = np.tile(np.eye(4), (50, 1, 1))
    a, b = sensor_pair(np.random.default_rng(0), CAMERA, body=still)
    with pytest.raises(MotionError, match='did not turn'):
        solve(name, a, b)


@pytest.mark.parametrize('name', PAPER)
def test_fewer_than_two_motions_are_refused(name):
    rng = np.random.default_rng(5)
    a, b = sensor_pair(rng, CAMERA, poses=5)
    with pytest.raises(MotionError, match='leaves 1 motion of 5 poses, needed at least 2'):
        calibrate(a, b, CalibrationConfig(solver=name, reference='B4'))


def test_an_unknown_solver_lists_the_known():
    with pytest.raises(ConfigError, match='needed one of ' + ', '.join(SOLVER_NAMES)):
        load_solver('tsai')
    assert set(PAPER) < set(SOLVER_NAMES)


def stepping(rng, X, angles):
    """Return two trajectories, slightly noisy, that turn by one of the angles in each step."""
    body = [np.eye(4)]
    for angle in angles:
        axis = rng.normal(size=3)
        body.append(body[-1] @ se3.from_rotation_translation(
            se3.exp_so3(angle * axis / np.linalg.norm(axis)), 0.3 * rng.normal(size=3)))
    a, b = sensor_pair(rng, X, body=np.array(body))
    return perturb(rng, a, 1e-3, 1e-3), perturb(rng, b, 1e-3, 1e-3)


@pytest.mark.parametrize('name', SEPARABLE)
def test_half_turns_are_left_out(name):
    """Noise flips their axis: with them the answer is 1 m and up to 180 degrees off."""
    rng = np.random.default_rng(0)
    angles = rng.choice([np.pi, 1.0], 200)
    a, b = stepping(rng, CAMERA, angles)
    solution = solve(name, a, b, 'B1')
    found = absolute_errors(solution.T_a_b, CAMERA)
    assert found.e_at < 0.005
    assert found.e_aR < 0.005
    np.testing.assert_array_equal(solution.inliers, angles < 3)
    assert 'turn by more than 170 degrees, where noise flips' in str(solution.findings[0])
    covariance = calibrate(a, b, CalibrationConfig(solver=name, reference='B1')).covariance
    assert np.sqrt(covariance.diagonal()).max() < 0.01


@pytest.mark.parametrize('name', SEPARABLE)
def test_nothing_but_half_turns_is_refused(name):
    rng = np.random.default_rng(1)
    a, b = stepping(rng, CAMERA, np.full(100, np.pi))
    with pytest.raises(MotionError, match='100 of 100 motions turn by more than 170 degrees'):
        solve(name, a, b, 'B1')
    # The automatic reference finds one whose motions turn less.
    found = calibrate(a, b, CalibrationConfig(solver=name)).absolute_errors(CAMERA)
    assert found.e_at < 0.01


def test_half_turns_from_the_first_pose_are_kept_as_published():
    rng = np.random.default_rng(2)
    solution = solve('park', *stepping(rng, CAMERA, np.full(100, 0.5)), 'A')
    assert solution.inliers is None
    assert 'they are kept, as published' in str(solution.findings[0])


# The quadratic form ---------------------------------------------------------------------------


def noisy_motions(seed, reference='B3', poses=60, sigma=0.02):
    rng = np.random.default_rng(seed)
    X = random_pose(rng)
    a, b = sensor_pair(rng, X, poses=poses)
    a, b = perturb(rng, a, sigma, sigma), perturb(rng, b, sigma, sigma)
    return select_motions(associate(a, b), reference)


def test_the_features_are_the_squares_of_the_residual():
    motions = noisy_motions(0)
    X = random_pose(np.random.default_rng(1))
    v = quadratic.monomials(X)
    products = v[quadratic.UPPER[0]] * v[quadratic.UPPER[1]]
    M = (motions.A @ X - X @ motions.B)[:, :3]
    np.testing.assert_allclose(
        products @ quadratic.features(motions.A, motions.B), np.sum(M**2, axis=(1, 2)), rtol=1e-12)
    rows = quadratic.rows(motions.A, motions.B, rotation=False)
    np.testing.assert_allclose(
        np.sum(np.tensordot(v, rows, 1)**2, axis=0), np.sum(M[:, :, 3]**2, axis=1), rtol=1e-12)


def test_a_newton_step_on_the_whole_extrinsic_ends_at_the_minimum():
    motions = noisy_motions(1, sigma=0.005)
    G = quadratic.gram(motions)
    best = quadratic.minimise(G).T_a_b
    T = se3.moved(best, 1e-4 * np.random.default_rng(0).normal(size=6))
    for _ in range(3):
        T = quadratic.newton_step(G, T, len(motions))
    np.testing.assert_allclose(T, best, atol=1e-10)


def test_the_gram_matrix_gives_the_cost_over_chunks(monkeypatch):
    motions = noisy_motions(2)
    X = random_pose(np.random.default_rng(3))
    expected = np.sum((motions.A @ X - X @ motions.B) ** 2)
    for chunk in (8192, 7, 1):
        monkeypatch.setattr(quadratic, 'CHUNK', chunk)
        v = quadratic.monomials(X)
        assert v @ quadratic.gram(motions) @ v == pytest.approx(expected, rel=1e-12)


def test_derivatives_agree_with_differences():
    G = quadratic.gram(noisy_motions(4))[np.r_[0:9, 12]][:, np.r_[0:9, 12]][None]
    R = se3.exp_so3(np.array([[0.3, -1.0, 0.5]]))
    gradient, hessian = quadratic._derivatives(G, R)
    h = 1e-5

    def cost(theta):
        return quadratic._cost(G, se3.exp_so3(theta) @ R)[0]

    for i in range(3):
        e = h * np.eye(3)[i]
        assert gradient[0, i] == pytest.approx((cost(e) - cost(-e)) / (2 * h), rel=1e-6)
        for j in range(3):
            f = h * np.eye(3)[j]
            mixed = (cost(e + f) - cost(e - f) - cost(f - e) + cost(-e - f)) / (4 * h * h)
            assert hessian[0, i, j] == pytest.approx(mixed, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize('name, columns', [('dnl', slice(0, 4)), ('ali', slice(3, 4))])
def test_the_minimum_is_the_one_a_general_optimiser_finds(name, columns):
    for seed in range(5):
        motions = noisy_motions(seed)
        X = load_solver(name)(motions, CalibrationConfig()).T_a_b

        def residual(x, X=X, motions=motions):
            T = X @ se3.exp_se3(x)
            return (motions.A @ T - T @ motions.B)[:, :3, columns].ravel()

        better = least_squares(residual, np.zeros(6), xtol=1e-15, ftol=1e-15, gtol=1e-15)
        np.testing.assert_allclose(better.x, 0, atol=1e-7)


def test_no_start_reaches_a_lower_cost_than_dnl():
    """Brute force over 300 random rotations, on noise that makes many minima."""
    for seed in range(4):
        motions = noisy_motions(seed, sigma=0.3, poses=12, reference='B1')
        G = quadratic.gram(motions)
        found = load_solver('dnl')(motions, CalibrationConfig()).cost
        starts = se3.exp_so3(np.random.default_rng(seed).normal(size=(300, 3)) * 2)
        assert found <= quadratic.minimise(G, starts).cost * (1 + 1e-9)


@pytest.mark.parametrize('name', ['dnl', 'dnlo'])
def test_threads_take_turns_at_ipopt(name):
    """In a process of its own: where they do not, the interpreter aborts."""
    code = (
        'from concurrent.futures import ThreadPoolExecutor\n'
        'from test_solvers import load_solver, noisy_motions, CalibrationConfig as Config\n'
        'motions = [noisy_motions(seed, poses=150 + seed) for seed in range(4)]\n'
        'def solve(m):\n'
        f'    return load_solver({name!r})(m, Config()).T_a_b.tobytes()\n'
        'with ThreadPoolExecutor(16) as pool:\n'
        '    found = list(pool.map(solve, motions * 10))\n'
        'assert found == [solve(m) for m in motions] * 10\n')
    done = subprocess.run(
        [sys.executable, '-c', code], cwd=Path(__file__).parent, env={
            **os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)},
        capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr


# DNLO -----------------------------------------------------------------------------------------


def with_jumps(seed, jumps=3, sigma=0.0005):
    """Return two trajectories, the extrinsic, and which B1 motions of them hold a jump."""
    rng = np.random.default_rng(seed)
    X = random_pose(rng)
    a, b = sensor_pair(rng, X, poses=120)
    a, b = perturb(rng, a, sigma, sigma), perturb(rng, b, sigma, sigma)
    at = rng.choice(np.arange(1, 120), jumps, replace=False)
    poses = b.poses.copy()
    for k in at:
        poses[k:, :3, 3] += rng.choice([-1, 1], 3) * 0.4
    jumped = np.zeros(119, bool)
    jumped[at - 1] = True
    return a, Trajectory(b.stamps_ns, poses, 'map_b', 'camera'), X, jumped


@pytest.mark.parametrize('method', ['auto', 'ipopt', 'path', 'alternating'])
def test_dnlo_rejects_the_jumps_and_nothing_else(method):
    for seed in range(5):
        a, b, X, jumped = with_jumps(seed)
        solution = solve('dnlo', a, b, 'B1', dnlo_method=method)
        np.testing.assert_array_equal(solution.inliers, ~jumped)
        assert absolute_errors(solution.T_a_b, X).e_at < 0.01


def test_dnlo_methods_reach_the_same_minimum_where_there_is_one():
    for seed in range(5):
        a, b, _, _ = with_jumps(seed, jumps=10)
        found = [solve('dnlo', a, b, 'B1', dnlo_method=method)
                 for method in ('ipopt', 'path', 'alternating')]
        for one, other in itertools.combinations(found, 2):
            np.testing.assert_allclose(one.T_a_b, other.T_a_b, atol=1e-5)
            # Ipopt stops at its tolerance; the others put every weight on its bound.
            assert one.cost == pytest.approx(other.cost, rel=2e-3)


def test_dnlo_keeps_at_least_the_asked_fraction():
    """With c = 0 every motion is an outlier, but d of them stay: least trimmed squares."""
    motions = noisy_motions(5, sigma=0.005)
    for d in (0.5, 0.7, 0.9):
        config = CalibrationConfig(dnlo_c=0.0, dnlo_min_inliers=d, dnlo_method='path')
        kept = load_solver('dnlo')(motions, config).inliers.sum()
        assert abs(kept - d * len(motions)) <= 1


@pytest.mark.parametrize('method', ['auto', 'ipopt', 'path', 'alternating'])
@pytest.mark.parametrize('allow_unobserved', [False, True])
@pytest.mark.parametrize('c, d', [(1e-12, 0.0), (0.0, 0.0), (1e-12, 0.02), (0.0, 0.02)])
def test_dnlo_that_keeps_no_motion_says_what_to_set(method, allow_unobserved, c, d):
    motions = noisy_motions(5, sigma=0.005)
    config = CalibrationConfig(dnlo_c=c, dnlo_min_inliers=d, dnlo_method=method,
                               allow_unobserved=allow_unobserved)
    with pytest.raises(MotionError, match=r'keeps [01] of 57 motions.* Raise dnlo_c or dnlo'):
        load_solver('dnlo')(motions, config)


def test_dnlo_with_everything_kept_is_dnl():
    motions = noisy_motions(6, sigma=0.005)
    config = CalibrationConfig(dnlo_c=1e6)
    np.testing.assert_allclose(
        load_solver('dnlo')(motions, config).T_a_b, load_solver('dnl')(motions, config).T_a_b,
        atol=1e-8)


def test_dnlo_weights_are_the_best_for_their_extrinsic():
    """Against the linear program's vertices: no swap of two motions lowers the cost."""
    motions = noisy_motions(7, poses=30)
    X = random_pose(np.random.default_rng(0))
    for c, d in ((0.5, 0.5), (1e-9, 0.55), (1e9, 0.5)):
        cost = TrimmedCost.of(motions, c, d)
        found = cost.weigh(X[None])
        squares = np.array([np.sum(m ** 2) for m in (motions.A @ X - X @ motions.B)[:, :3]])
        np.testing.assert_allclose(cost.squares(X[None])[0], squares, rtol=1e-10)
        weights = found.weights[0]
        assert weights.sum() >= d * len(motions) - 1e-9
        best = np.sort(squares)
        needed = d * len(motions)
        # The linear program's optimum: everything below c, else the smallest up to the bound.
        filled = np.clip(needed - np.arange(len(best)), 0, 1)
        alpha = np.maximum(filled, best < c)
        assert found.cost[0] == pytest.approx(np.sum(alpha * best + (1 - alpha) * c))


def test_dnlo_alternation_never_goes_up():
    motions = noisy_motions(8, poses=80, sigma=0.05)
    cost = TrimmedCost.of(motions, 0.01, 0.5)
    starts = np.array([random_pose(np.random.default_rng(k)) for k in range(6)])
    before = cost.weigh(starts).cost.min()
    after, _ = cost.alternate(starts)
    again, _ = cost.alternate(after.T_a_b)
    assert after.cost[0] <= before
    assert again.cost[0] <= after.cost[0] * (1 + 1e-12)


# Zhuang ---------------------------------------------------------------------------------------


def test_zhuang_warns_where_its_parameter_magnifies_noise():
    rng = np.random.default_rng(0)
    solution = solve('zhuang', *sensor_pair(rng, BACK_TO_BACK))
    assert 'rotated by 180 degrees' in str(solution.findings[0])
    assert solve('zhuang', *sensor_pair(rng, IDENTITY)).findings == ()


def test_zhuang_uses_motions_that_do_not_turn_for_their_translation():
    rng = np.random.default_rng(1)
    body = wander(rng, poses=60)
    body[20:40, :3, :3] = body[20, :3, :3]
    a, b = sensor_pair(rng, CAMERA, body=body)
    assert absolute_errors(solve('zhuang', a, b, 'B1').T_a_b, CAMERA).e_at < 1e-9


def test_a_hundred_thousand_motions_take_seconds():
    """The work per motion is one product with a constant matrix, for dnlo too."""
    rng = np.random.default_rng(2)
    X = random_pose(rng)
    turns = wander(rng, poses=1001)
    body = np.concatenate([turns[:-1]] * 100)
    t = stamps(len(body))
    a = Trajectory(t, body, 'm', 'lidar')
    b = Trajectory(t, body @ X, 'm', 'camera')
    for name in ('dnl', 'dnlo', 'park'):
        assert absolute_errors(solve(name, a, b).T_a_b, X).e_at < 1e-9


# Anything ------------------------------------------------------------------------------------


@pytest.mark.statistical
@pytest.mark.usefixtures('noise_identified_once')
@pytest.mark.parametrize('name', ['dnl', 'dnlo', 'park', 'drift_aware'])
@pytest.mark.parametrize(
    'seed', [*range(8), *(pytest.param(k, marks=pytest.mark.slow) for k in range(8, 25))])
def test_any_two_trajectories_give_a_finite_answer_or_a_named_error(name, seed):
    """Sizes of motion and noise over many orders, jumps, missing poses, clocks, scales."""
    rng = np.random.default_rng(seed)
    poses = int(rng.choice([5, 11, 30, 100, 300]))
    a, b = sensor_pair(
        rng, random_pose(rng, distance=10), poses=poses,
        rotation=rng.choice([0, 1e-6, 1e-3, 0.1, 1.5], 3),
        translation=rng.choice([0, 1e-4, 0.3, 50], 3))
    a = perturb(rng, a, rng.choice([0, 1e-9, 0.01, 3]), rng.choice([0, 1e-9, 0.01, 0.7]))
    kept = np.sort(rng.choice(poses, max(4, int(poses * rng.uniform(0.6, 1))), replace=False))
    jumped = b.poses.copy()
    jumped[poses // 2:, :3, 3] += rng.normal(size=3) * rng.choice([0, 1, 1000])
    clock_ns = round(rng.choice([0, 0.3, 100]) * 1e9)
    b = Trajectory(b.stamps_ns[kept] + clock_ns, jumped[kept], 'map_b', 'camera')
    try:
        result = calibrate(a, b.scaled(rng.choice([0.01, 1, 1, 30])), CalibrationConfig(
            solver=name, allow_unobserved=bool(seed % 2)))
    except CalibrationError as error:
        assert len(str(error)) > 30
        return
    assert np.isfinite(result.T_a_b).all()
    assert np.linalg.eigvalsh(result.covariance).min() >= -1e-9 * result.covariance.max()
    json.dumps(result.to_dict(), allow_nan=False)
