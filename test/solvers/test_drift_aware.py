# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The drift-aware solver as a whole: laws, noise identified, honest covariance, real data."""

from dataclasses import replace
from functools import lru_cache, partial

from motion_data import random_pose
import numpy as np
from published import kitti, SEQUENCES, simulations
import pytest

from trajectory_calibration import calibrate, Trajectory
from trajectory_calibration.assessment.metrics import absolute_errors
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.errors import CalibrationError, MotionError, SolverError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.chi_squared import quantile
from trajectory_calibration.simulation import SCENARIOS, simulate
from trajectory_calibration.solvers import load_solver
from trajectory_calibration.solvers.drift_aware.diagnosis import findings_of
from trajectory_calibration.solvers.drift_aware.drive import Drive, State
from trajectory_calibration.solvers.drift_aware.fit import fit
from trajectory_calibration.solvers.drift_aware.solver import solve_pairs
from trajectory_calibration.solvers.solution import Jump
from trajectory_calibration.time_alignment.pairing import associate, associate_nearest

FIXED = dict.fromkeys(('scale', 'systematic_drift', 'time_offset'), 'fixed')
AUTO = dict.fromkeys(FIXED, 'auto')


def smooth_motion(rng, times, reach=3.0, tilt=0.4, turn=1.2, *, planar=False):
    """Return (N, 4, 4) poses of a smooth motion at (N,) seconds."""
    omega = 2 * np.pi * rng.uniform(0.06, 0.3, size=(6, 4))
    waves = np.sin(omega * times[:, None, None] + rng.uniform(0, 6.3, size=(6, 4))).sum(axis=2)
    waves *= 0.7 * np.array([reach, reach, reach, tilt, tilt, turn])
    if planar:
        waves[:, 2:5] = 0
    return se3.from_rotation_translation(se3.exp_so3(waves[:, 3:]), waves[:, :3])


def shaken(rng, poses, sigma_t, sigma_r):
    noise = rng.normal(size=(len(poses), 6)) * np.repeat([sigma_t, sigma_r], 3)
    return poses @ se3.from_rotation_translation(se3.exp_so3(noise[:, 3:]), noise[:, :3])


def as_pairs(times, poses_a, poses_b):
    stamps_ns = np.rint(1e9 * times).astype(np.int64)
    return associate_nearest(Trajectory(stamps_ns, poses_a), Trajectory(stamps_ns, poses_b),
                             max_difference_ns=0)


def simulated(seed, poses=150, white=(0.0, 0.0), walk=(0.0, 0.0), jumps=(), scale=1.0, *,
              drift=(0.0, 0.0, 0.0), offset=0.0, irregular=False, planar=False):
    """Return pose pairs and the truth; every kind of noise is on both sensors."""
    rng = np.random.default_rng(seed)
    times = 0.2 * np.arange(poses)
    if irregular:
        times = np.cumsum(rng.uniform(0.02, 0.4, size=poses))
    motion = np.random.default_rng(seed + 1)
    T_a_b = random_pose(rng)
    # Sensor b stamps late: what it says of t was true at t + offset.
    true_a = smooth_motion(np.random.default_rng(seed + 1), times, planar=planar)
    true_b = smooth_motion(motion, times + offset, planar=planar)
    true_b = random_pose(rng, distance=5.0) @ true_b @ T_a_b
    poses_a = drifted(rng, true_a, walk, (), 1.0, np.zeros(3))
    poses_b = drifted(rng, true_b, walk, jumps, scale, np.asarray(drift))
    return as_pairs(times, shaken(rng, poses_a, *white), shaken(rng, poses_b, *white)), T_a_b


def drifted(rng, poses, walk, jumps, scale, drift):
    """Return the poses as dead reckoning with a walk per root metre would report them."""
    steps = se3.inverse(poses[:-1]) @ poses[1:]
    length = np.linalg.norm(steps[:, :3, 3], axis=1, keepdims=True)
    steps[:, :3, 3] = (steps[:, :3, 3] + length * drift) / scale
    noise = rng.normal(size=(len(steps), 6)) * np.repeat(walk, 3) * np.sqrt(length)
    steps = steps @ se3.from_rotation_translation(se3.exp_so3(noise[:, 3:]), noise[:, :3])
    for k, size in jumps:
        steps[k, :3, 3] += size
    result = [poses[0]]
    for step in steps:
        result.append(result[-1] @ step)
    return np.stack(result)


def error_of(solution, T_a_b):
    """Return (6,) dt and dtheta about the fixed axes of a, truth less answer."""
    R = solution.T_a_b[:3, :3]
    return np.concatenate([T_a_b[:3, 3] - solution.T_a_b[:3, 3],
                           se3.log_so3(T_a_b[:3, :3] @ R.T)])


def as_trajectories(pairs):
    return (Trajectory(pairs.stamps_ns, pairs.poses_a, 'map_a', 'lidar'),
            Trajectory(pairs.stamps_ns, pairs.poses_b, 'map_b', 'camera'))


@pytest.mark.parametrize('irregular', [False, True])
def test_exact_without_noise(irregular):
    pairs, T_a_b = simulated(1, irregular=irregular)
    solution = solve_pairs(pairs, AUTO)
    np.testing.assert_allclose(solution.T_a_b, T_a_b, atol=1e-8)
    assert solution.diagnosis.white_m < 1e-6
    assert solution.diagnosis.walk_m < 1e-6
    assert solution.scale == pytest.approx(1.0, abs=1e-9)
    assert solution.findings == ()


def test_through_the_registry_whatever_the_reference():
    pairs, T_a_b = simulated(2, white=(0.01, 0.01))
    solve = load_solver('drift_aware')
    short, long = (solve(select_motions(pairs, reference), CalibrationConfig())
                   for reference in ('B1', 'C10'))
    np.testing.assert_array_equal(short.T_a_b, long.T_a_b)
    assert absolute_errors(short.T_a_b, T_a_b).e_at < 0.01


def test_swapped_sensors_give_the_inverse():
    pairs, _ = simulated(3, white=(0.01, 0.005), walk=(0.01, 0.002))
    there = solve_pairs(pairs, FIXED)
    back = solve_pairs(as_pairs(pairs.stamps_ns * 1e-9, pairs.poses_b, pairs.poses_a), FIXED)
    deviation = np.sqrt(np.diag(there.covariance))
    np.testing.assert_array_less(
        np.abs(error_of(there, se3.inverse(back.T_a_b))), 0.5 * deviation)


def test_world_frames_do_not_matter():
    pairs, _ = simulated(4, white=(0.01, 0.005), walk=(0.01, 0.002))
    rng = np.random.default_rng(0)
    moved = as_pairs(pairs.stamps_ns * 1e-9, random_pose(rng, distance=50) @ pairs.poses_a,
                     random_pose(rng, distance=50) @ pairs.poses_b)
    first, second = solve_pairs(pairs, AUTO), solve_pairs(moved, AUTO)
    np.testing.assert_allclose(second.T_a_b, first.T_a_b, atol=1e-7)
    np.testing.assert_allclose(second.covariance, first.covariance, rtol=1e-4, atol=1e-12)


def test_noise_is_identified():
    pairs, _ = simulated(5, poses=1000, white=(0.01, 0.004), walk=(0.02, 0.003))
    diagnosis = solve_pairs(pairs, AUTO).diagnosis
    np.testing.assert_allclose(diagnosis.white_m, 0.01, rtol=0.3)
    np.testing.assert_allclose(diagnosis.white_rad, 0.004, rtol=0.3)
    # Both sensors walk; the walk is that of the pair.
    np.testing.assert_allclose(diagnosis.walk_m, 0.02 * np.sqrt(2), rtol=0.25)
    np.testing.assert_allclose(diagnosis.walk_rad, 0.003 * np.sqrt(2), rtol=0.25)


def test_what_motions_differ_by_is_told_by_time_scale():
    pairs, T_a_b = simulated(5, poses=1000, white=(0.01, 0.004), walk=(0.02, 0.003))
    apart = np.array(solve_pairs(pairs, AUTO).diagnosis.apart)
    steps = np.diff(pairs.stamps_ns) * 1e-9
    for seconds, _, radians in apart[:7]:
        k = round(seconds / steps[0])
        A, B = (se3.inverse(poses[:-k]) @ poses[k:] for poses in (pairs.poses_a, pairs.poses_b))
        left = se3.log_se3(se3.inverse(A @ T_a_b) @ T_a_b @ B)[:, 3:]
        np.testing.assert_allclose(radians, np.sqrt(np.mean(left**2)), rtol=0.2)


def test_jumps_are_named_and_set_aside():
    size = np.array([0.2, -0.2, 0.1])
    pairs, T_a_b = simulated(6, white=(0.002, 0.001), jumps=[(40, size), (90, -2 * size)])
    solution = solve_pairs(pairs, AUTO)
    assert [jump.stamp_ns for jump in solution.diagnosis.jumps] == [
        pairs.stamps_ns[91], pairs.stamps_ns[41]]
    np.testing.assert_allclose(
        [jump.translation_m for jump in solution.diagnosis.jumps], [0.6, 0.3], atol=0.02)
    assert absolute_errors(solution.T_a_b, T_a_b).e_at < 0.002
    (finding,) = solution.findings
    assert finding.code == 'pose-jumps'
    assert finding.text.startswith('2 pose jumps')
    assert '0.6 m and' in finding.text
    assert 'at 18.2 s' in finding.text
    # What rounding leaves of a rotation that did not jump is no number; a far jump no exponent.
    exact = replace(solution.diagnosis, systematic_drift=(0.05, 1e-16, -0.01),
                    systematic_drift_deviation=(1e-3,) * 3,
                    jumps=(
                        Jump(8_200_000_000, 0.3, 1e-16), Jump(9_000_000_000, 1520.0, np.pi)))
    drift, jump = findings_of(exact, 0)
    assert jump.text.endswith('0.3 m and 0 deg at 8.2 s, 1,520 m and 180 deg at 9.0 s')
    assert drift.text == (
        'b drifts by +5.00% and -1.00% of the distance along its x and z: corrected')


@pytest.mark.parametrize('size', [0.1, 1.0, 10.0, 100.0])
def test_one_jump_among_good_steps_is_found_however_large(size):
    pairs, T_a_b = simulated(6, white=(0.005, 0.002), jumps=[(90, np.array([size, 0.0, 0.0]))])
    solution = solve_pairs(pairs, AUTO)
    (jump,) = solution.diagnosis.jumps
    assert jump.stamp_ns == pairs.stamps_ns[91]
    assert jump.translation_m == pytest.approx(size, abs=0.05)
    assert absolute_errors(solution.T_a_b, T_a_b).e_at < 0.005


def test_scale_is_found_where_there_is_one():
    pairs, T_a_b = simulated(7, white=(0.01, 0.005), scale=0.97)
    solution = solve_pairs(pairs, AUTO)
    diagnosis = solution.diagnosis
    assert abs(solution.scale - 0.97) < 3 * diagnosis.scale_deviation < 0.01
    assert absolute_errors(solution.T_a_b, T_a_b).e_at < 0.015
    assert [finding.code for finding in solution.findings] == ['scale']


def test_clock_offset_is_found_where_there_is_one():
    pairs, T_a_b = simulated(8, white=(0.005, 0.003), offset=0.04)
    solution = solve_pairs(pairs, AUTO)
    # Twists over steps of 0.2 s are a little too slow, which takes 2 % off the offset.
    assert abs(solution.time_offset_s - 0.04) < 0.002
    assert solution.diagnosis.time_offset_deviation_s < 0.001
    assert absolute_errors(solution.T_a_b, T_a_b).e_at < 0.01


@pytest.mark.parametrize(('settings', 'e_rt'), [
    # The clocks are told by the turning of both, before the solver.
    ({}, 0.05),
    # It does not look that far: the solver finds the offset, for motions that are 30 ms apart.
    ({'max_time_offset': 0.02}, 0.2),
    # Both find what is left of what was given.
    ({'time_offset': -0.02, 'time_offset_mode': 'estimate', 'scale': 0.97,
      'scale_mode': 'estimate'}, 0.05),
])
def test_scale_and_clock_offset_reach_the_result(settings, e_rt):
    run = simulate(replace(SCENARIOS['drone'], duration=30.0), 5)
    late = replace(run.b.scaled(1.05), stamps_ns=run.b.stamps_ns + 30_000_000)
    result = calibrate(run.a, late, CalibrationConfig(**settings))
    assert result.scale == pytest.approx(1 / 1.05, abs=0.003)
    assert result.time_offset_s == pytest.approx(-0.03, abs=0.002)
    assert result.absolute_errors(run.T_a_b).e_at < 0.01
    # In metres of a: b's are longer.
    assert result.metrics.e_rt < e_rt


def test_systematic_drift_is_found_where_there_is_one():
    drift = (0.0, 0.03, 0.0)
    pairs, T_a_b = simulated(9, white=(0.003, 0.002), drift=drift)
    solution = solve_pairs(pairs, AUTO)
    diagnosis = solution.diagnosis
    np.testing.assert_array_less(
        np.abs(np.subtract(diagnosis.systematic_drift, drift)),
        3 * np.array(diagnosis.systematic_drift_deviation))
    assert absolute_errors(solution.T_a_b, T_a_b).e_at < 0.01


def test_terms_that_are_not_there_are_no_findings():
    for seed in range(5):
        solution = solve_pairs(simulated(20 + seed, white=(0.01, 0.01))[0], AUTO)
        diagnosis = solution.diagnosis
        assert abs(diagnosis.scale - 1) < 3 * diagnosis.scale_deviation < 0.02
        assert abs(diagnosis.time_offset_s) < 3 * diagnosis.time_offset_deviation_s
        assert solution.findings == ()


def test_terms_that_are_fixed_stay():
    diagnosis = solve_pairs(simulated(7, white=(0.01, 0.005), scale=0.97)[0], FIXED).diagnosis
    assert diagnosis.scale == 1.0
    assert diagnosis.scale_deviation is None
    assert diagnosis.systematic_drift == (0.0, 0.0, 0.0)
    assert diagnosis.systematic_drift_deviation is None
    assert diagnosis.time_offset_s == 0.0
    assert diagnosis.time_offset_deviation_s is None


def late_position(poses, times, seconds):
    """Return poses whose position is older than their rotation."""
    late = poses.copy()
    for axis in range(3):
        late[:, axis, 3] = np.interp(times - seconds, times, poses[:, axis, 3])
    return late[2:]


def test_a_position_that_is_late_is_found():
    rng = np.random.default_rng(1)
    times = 0.05 * np.arange(2000)
    body = smooth_motion(rng, times, reach=10.0)
    T_a_b = random_pose(rng)
    late = late_position(shaken(rng, body @ T_a_b, 0.003, 0.001), times, 0.05)
    pairs = as_pairs(times[2:], shaken(rng, body, 0.003, 0.001)[2:], late)
    solution = solve_pairs(pairs, AUTO)
    assert abs(solution.diagnosis.latency_s - 0.05) < 0.005
    assert 'position-latency' in [finding.code for finding in solution.findings]
    assert absolute_errors(solution.T_a_b, T_a_b).e_at < 0.02


@pytest.mark.statistical
@pytest.mark.parametrize('noise', [
    {'white': (0.02, 0.02)},
    {'walk': (0.02, 0.005)},
    {'white': (0.01, 0.005), 'walk': (0.01, 0.002), 'jumps': [(50, np.array([0.3, 0.0, 0.2]))]},
])
def test_covariance_covers_the_truth(noise):
    squares, inside = [], []
    for seed in range(16):
        pairs, T_a_b = simulated(200 + seed, poses=120, **noise)
        solution = solve_pairs(pairs, AUTO)
        error = error_of(solution, T_a_b)
        squares.append(error @ np.linalg.solve(solution.covariance, error) / 6)
        inside.append(np.abs(error) < 1.96 * np.sqrt(np.diag(solution.covariance)))
    # Sixteen seeds leave the mean of chi-squared / 6 with a deviation of 0.14.
    assert 0.6 < np.mean(squares) < 1.5
    assert np.mean(inside) > 0.88


def test_planar_motion_is_not_filled_in_silence():
    pairs, T_a_b = simulated(10, white=(0.002, 0.001), planar=True)
    solution = solve_pairs(pairs, FIXED)
    # Along the axis of all rotations, z of a, next to nothing is known: millimetres elsewhere.
    deviation = np.sqrt(np.diag(solution.covariance))
    assert deviation[2] > 0.1 > 50 * deviation[:2].max()
    np.testing.assert_array_less(np.abs(error_of(solution, T_a_b)[:2]), 5 * deviation[:2])


def test_exactly_planar_motion_says_that_nothing_is_known():
    pairs, T_a_b = simulated(10, planar=True)
    solution = solve_pairs(pairs, FIXED)
    assert np.sqrt(solution.covariance[2, 2]) > 100
    np.testing.assert_allclose(solution.T_a_b[:2, 3], T_a_b[:2, 3], atol=1e-6)


def test_too_few_poses_are_refused():
    pairs, _ = simulated(11, poses=8)
    with pytest.raises(SolverError, match='8 pose pairs, needed at least 10'):
        solve_pairs(pairs, AUTO)


def test_a_straight_drive_says_what_it_leaves_open():
    times = 0.1 * np.arange(40)
    poses = np.tile(np.eye(4), (40, 1, 1))
    poses[:, 0, 3] = times
    solution = solve_pairs(as_pairs(times, poses, poses), AUTO)
    deviation = np.sqrt(np.diag(solution.covariance))
    # The lever arm, and the turn about the way.
    assert (deviation[:4] > 1).all()


def test_a_sensor_that_does_not_move_is_refused():
    poses = np.tile(np.eye(4), (40, 1, 1))
    with pytest.raises(MotionError, match='a stood still'):
        solve_pairs(as_pairs(0.1 * np.arange(40), poses, poses), AUTO)


@pytest.mark.parametrize('noise', [0.0, 1e-4])
@pytest.mark.parametrize('lever', [0.0, 0.3])
@pytest.mark.parametrize('solver', ['drift_aware', 'dnl', 'park'])
def test_turning_without_moving_is_an_answer_or_a_named_error(solver, lever, noise):
    rng = np.random.default_rng(0)
    times = 0.1 * np.arange(300)
    body = smooth_motion(rng, times, reach=0.0)
    T_a_b = se3.from_rotation_translation(random_pose(rng)[:3, :3], [lever, 0.0, 0.0])
    a, b = as_trajectories(as_pairs(
        times, shaken(rng, body, 0.0, noise), shaken(rng, body @ T_a_b, 0.0, noise)))
    try:
        result = calibrate(a, b, CalibrationConfig(solver=solver))
    except CalibrationError:
        return
    assert result.absolute_errors(T_a_b).e_aR < 1e-9 + noise


@pytest.mark.parametrize('seed', [0, 1])
@pytest.mark.parametrize('solver', ['drift_aware', 'dnl', 'park'])
def test_a_vehicle_that_stands_tells_no_rotation(solver, seed):
    """Positions to 1 cm are no motion, however much better the rotations are, to 1e-5 rad."""
    rng = np.random.default_rng(seed)
    standing = (np.tile(random_pose(rng), (300, 1, 1)) for _ in 'ab')
    a, b = as_trajectories(as_pairs(
        0.1 * np.arange(300), *(shaken(rng, poses, 0.01, 1e-5) for poses in standing)))
    try:
        result = calibrate(a, b, CalibrationConfig(solver=solver))
    except MotionError:
        return
    assert {'rotation x', 'rotation y', 'rotation z'} <= set(result.observability.unobserved)


def test_thinned_first_then_all_poses():
    pairs, T_a_b = simulated(12, poses=3000, white=(0.01, 0.01), walk=(0.005, 0.001))
    solution = solve_pairs(pairs, AUTO)
    error = error_of(solution, T_a_b)
    assert error @ np.linalg.solve(solution.covariance, error) / 6 < 2.8
    # What walks from pose to pose is taken out of it; thinned by two, that is a third.
    np.testing.assert_allclose(solution.diagnosis.white_m, 0.01, rtol=0.1)


@pytest.mark.once
@pytest.mark.parametrize('name, minutes', [('drone', 30), ('offroad', 65)])
def test_a_steady_drift_of_a_long_drive_is_counted_along_the_way(name, minutes):
    """Steps of a second or nearly, in which the vehicle turns."""
    run = simulate(replace(SCENARIOS[name], duration=60.0 * minutes), 1)
    solution = solve_pairs(associate(run.a, run.b), AUTO)
    z = error_of(solution, run.T_a_b) / np.sqrt(np.diag(solution.covariance))
    assert np.abs(z).max() < 3.5


@pytest.mark.parametrize('noise', [
    {'white': (0.02, 0.01)},
    {'walk': (0.02, 0.005)},
    {'white': (0.01, 0.005), 'walk': (0.01, 0.002), 'drift': (0.0, 0.02, 0.0),
     'jumps': [(k, np.array([0.3, 0.1, 0.2])) for k in range(20, 290, 90)]},
])
@pytest.mark.parametrize('poses', [300, 1600])
def test_the_answer_has_settled(noise, poses):
    """Whatever it began at: the true extrinsic leads to the same answer."""
    pairs, T_a_b = simulated(13, poses=poses, **noise)
    found = solve_pairs(pairs, AUTO)
    other = fit(Drive.of(pairs), State(T_a_b, np.zeros(6)), AUTO, most_rounds=40)
    assert other.converged
    deviation = np.sqrt(np.diag(found.covariance))
    np.testing.assert_array_less(
        np.abs(error_of(found, other.state.T_a_b)), 0.3 * deviation)


def test_a_fit_that_did_not_settle_says_so(monkeypatch):
    pairs, _ = simulated(14, poses=600, white=(0.01, 0.005), walk=(0.01, 0.002))
    assert solve_pairs(pairs, FIXED).findings == ()
    monkeypatch.setattr('trajectory_calibration.solvers.drift_aware.solver.fit',
                        partial(fit, most_rounds=1))
    (finding,) = solve_pairs(pairs, FIXED).findings
    assert finding.code == 'not-converged'
    assert 'the solver did not converge in 1 iteration: the last step was' in finding.text


def test_terms_are_findings_at_the_false_alarm_probability():
    pairs, _ = simulated(14, poses=600, white=(0.01, 0.005), walk=(0.01, 0.002))
    diagnosis = replace(
        solve_pairs(pairs, AUTO).diagnosis, systematic_drift=(0.0,) * 3, time_offset_s=0.0,
        latency_s=0.0, scale_deviation=0.01, jumps=())
    for factor, codes in ((0.99, []), (1.01, ['scale'])):
        scale = 1.0 + factor * 0.01 * quantile(1)**0.5
        found = findings_of(replace(diagnosis, scale=scale), 0)
        assert [finding.code for finding in found] == codes


@pytest.mark.statistical
@pytest.mark.parametrize(('case', 'metres', 'degrees'), [
    (('mixture', None), 0.0088, 0.25),
    (('outliers', 10), 0.0005, 0.01),
    (('drift', 0.05), 0.001, 0.01),
    (('noise', 0.01), 0.0073, 0.31),
])
def test_published_simulations(shared_data, case, metres, degrees):
    errors = []
    for *_, a, b, T_a_b in simulations(shared_data, cases=[case]):
        pairs = associate_nearest(a, b, max_difference_ns=1_000_000)
        found = absolute_errors(solve_pairs(pairs, AUTO).T_a_b, T_a_b)
        errors.append([found.e_at, np.rad2deg(found.e_aR)])
    assert len(errors) == 19
    median = np.median(errors, axis=0)
    assert median[0] <= metres
    assert median[1] <= degrees


def test_kitti_cameras_at_coinciding_stamps(shared_data):
    a, b, T_a_b = kitti(shared_data, SEQUENCES[1])
    # One hardware trigger, stamped 6.14 ms apart.
    pairs = associate_nearest(a, b, max_difference_ns=12_000_000)
    solution = solve_pairs(pairs, AUTO)
    file = absolute_errors(solution.T_a_b, T_a_b)
    corrected = absolute_errors(solution.T_a_b, se3.from_rotation_translation(
        np.eye(3), np.array([-0.0599, 0.0011, -0.0038])))
    # Most of it is the height, y of a, which this drive determines to 5 cm. The file holds the
    # extrinsic of the images before their rectification.
    assert file.e_at <= 0.090
    assert corrected.e_at <= 0.075
    assert abs(solution.T_a_b[1, 3] - 0.0011) < 1.5 * np.sqrt(solution.covariance[1, 1])
    assert np.rad2deg(corrected.e_aR) <= 0.06
    assert abs(solution.scale - (1 - 0.021)) < 0.003


@lru_cache
def in_metres(name):
    """Return the pose pairs of a drive, and their answer."""
    run = simulate(replace(SCENARIOS[name], duration=40.0), 5)
    pairs = associate(run.a, run.b)
    return pairs, solve_pairs(pairs, AUTO)


@pytest.mark.parametrize('unit', [1e-3, 0.1, 3.0, 40.0])
@pytest.mark.parametrize('name', ['offroad', 'handheld', 'drone'])
def test_another_unit_changes_nothing_but_the_scale(name, unit):
    pairs, found = in_metres(name)
    other = solve_pairs(pairs.scaled(unit), AUTO)
    deviation = np.sqrt(np.diag(found.covariance))
    np.testing.assert_allclose(other.scale * unit, found.scale, rtol=0.02)
    moved = np.concatenate([
        other.T_a_b[:3, 3] - found.T_a_b[:3, 3],
        se3.log_so3(other.T_a_b[:3, :3] @ found.T_a_b[:3, :3].T)])
    assert (np.abs(moved) < 1.5 * deviation).all()
    np.testing.assert_allclose(np.sqrt(np.diag(other.covariance)), deviation, rtol=0.5)


@pytest.mark.parametrize('pivot', [0.0, 0.05])
def test_turning_on_the_spot_is_no_scale(pivot):
    """A sensor on a long arm moves far where the other hardly does."""
    rng = np.random.default_rng(3)
    times = np.arange(600) * 0.1
    turn = 0.4 * np.stack([np.sin(0.5 * times), np.sin(0.33 * times + 1),
                           2 * np.sin(0.21 * times)], axis=1)
    rotations = se3.exp_so3(turn)
    body = se3.from_rotation_translation(rotations, rotations @ [pivot, 0.0, 0.0])
    T_a_b = random_pose(rng)
    T_a_b[:3, 3] = [1.5, 0.5, 1.0]
    noisy = [poses @ se3.exp_se3(0.001 * rng.normal(size=(600, 6)))
             for poses in (body, body @ T_a_b)]
    found = solve_pairs(as_pairs(times, *noisy), AUTO)
    assert found.scale == pytest.approx(1.0, abs=0.002)
    assert absolute_errors(found.T_a_b, T_a_b).e_at < 0.01
