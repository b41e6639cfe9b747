# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""One contract for motion that leaves directions unobservable, whoever solves, however exact."""

from motion_data import perturb, random_pose, sensor_pair, wander
import numpy as np
import pytest

from trajectory_calibration import calibrate, CalibrationConfig
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.geometry import se3
from trajectory_calibration.solvers import load_solver, solver_info, SOLVER_NAMES
from trajectory_calibration.time_alignment.pairing import associate

pytestmark = pytest.mark.usefixtures('noise_identified_once')
# Three of them on the oldest dependencies, too.
NOISE = (0.0, *(pytest.param(noise, marks=pytest.mark.once)
                for noise in (1e-12, 1e-7, 1e-6, 1e-5, 1e-4)), 1e-9, 1e-3)
CAMERA = se3.from_rotation_translation(
    [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [0.3, 0.05, -0.1])
# They find the rotation from rotations alone, which about a single axis leave it unobserved.
ROTATION_ALONE = ('park', 'taylor')


def planar(rng):
    return wander(rng, poses=200, translation=(0.3, 0.02, 0.0), rotation=(0.0, 0.0, 0.1))


def straight(rng):
    poses = np.tile(np.eye(4), (200, 1, 1))
    poses[:, 0, 3] = np.cumsum(rng.uniform(0.2, 0.4, 200))
    return poses


def on_the_spot(rng):
    return wander(rng, poses=200, translation=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, 0.1))


def calibrated(motion, noise, solver, X=CAMERA, **settings):
    rng = np.random.default_rng(3)
    a, b = sensor_pair(rng, X, body=motion(rng))
    if noise:
        a, b = perturb(rng, a, noise, noise), perturb(rng, b, noise, noise)
    return calibrate(a, b, CalibrationConfig(solver=solver, reference='B5', **settings))


@pytest.mark.parametrize('noise', NOISE)
@pytest.mark.parametrize('solver', SOLVER_NAMES)
def test_planar_motion_leaves_the_height_open(solver, noise):
    found = calibrated(planar, noise, solver)
    unobserved = set(found.observability.unobserved)
    if solver in ROTATION_ALONE:
        assert {'z', 'rotation z'} <= unobserved
        assert unobserved.isdisjoint({'rotation x', 'rotation y'})
    else:
        assert unobserved == {'z'}
        near = 30 if solver == 'zhuang' else 5
        np.testing.assert_allclose(found.T_a_b[:2, 3], CAMERA[:2, 3], atol=near * noise + 1e-8)
    # Not the kilometres at which noise happens to balance noise.
    assert abs(found.T_a_b[2, 3]) < 100
    (height,) = (item for item in found.observability.weak_axes
                 if item.kind == 'translation' and abs(item.axis[2]) > 0.99)
    assert height.std > 5
    codes = [finding.code for finding in found.findings]
    assert 'direction-unobserved' in codes


@pytest.mark.parametrize('solver', SOLVER_NAMES)
def test_what_is_unobserved_exactly_is_zero_or_the_prior(solver):
    height = calibrated(planar, 0.0, solver).T_a_b[2, 3]
    # The likelihood has a prior of its own, metres wide.
    assert height == pytest.approx(0.0, abs=5 if solver_info(solver).identifies_noise else 1e-6)
    found = calibrated(
        planar, 0.0, solver, prior_translation='-,-,0.42', prior_translation_std='0.01')
    assert found.T_a_b[2, 3] == pytest.approx(0.42, abs=1e-4)
    assert found.observability.status['z'] == 'prior'


@pytest.mark.parametrize('noise', (1e-4, 1e-3))
@pytest.mark.parametrize('solver', SOLVER_NAMES)
def test_a_straight_line_tells_no_translation_and_at_most_two_rotations(solver, noise):
    X = random_pose(np.random.default_rng(4))
    found = calibrated(straight, noise, solver, X)
    assert {'x', 'y', 'z', 'rotation x'} <= set(found.observability.unobserved)
    assert np.isfinite(found.covariance).all()
    if solver not in (*ROTATION_ALONE, 'zhuang'):
        assert found.observability.unobserved == ('x', 'y', 'z', 'rotation x')
        np.testing.assert_allclose(
            found.T_a_b[:3, :3].T[:, 0], X[:3, :3].T[:, 0], atol=5 * noise + 1e-7)


@pytest.mark.parametrize('solver', SOLVER_NAMES)
def test_a_straight_line_without_noise_has_an_answer_too(solver):
    """A constant orientation is refused before (no sensor has it)."""
    rng = np.random.default_rng(3)
    motions = select_motions(associate(*sensor_pair(rng, CAMERA, body=straight(rng))), 'B5')
    found = load_solver(solver)(motions, CalibrationConfig(solver=solver)).T_a_b
    if not solver_info(solver).identifies_noise:
        np.testing.assert_allclose(found[:3, 3], 0.0, atol=1e-6)
    if solver not in ROTATION_ALONE:
        np.testing.assert_allclose(found[:3, :3].T[:, 0], CAMERA[:3, :3].T[:, 0], atol=1e-6)


@pytest.mark.parametrize('noise', (0.0, 1e-9, 1e-6, 1e-3))
@pytest.mark.parametrize('solver', SOLVER_NAMES)
def test_turning_on_the_spot_about_one_axis_leaves_heading_and_height_open(solver, noise):
    found = calibrated(on_the_spot, noise, solver)
    assert {'z', 'rotation z'} <= set(found.observability.unobserved)
