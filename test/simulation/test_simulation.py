# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The simulator against the paper's published trajectories and against its own definition."""

from dataclasses import fields, replace

from motion_data import random_pose
import numpy as np
import pytest

from trajectory_calibration import calibrate, CalibrationConfig
from trajectory_calibration.assessment.metrics import absolute_errors
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.errors import ConfigError
from trajectory_calibration.geometry import se3
from trajectory_calibration.outputs.extrinsic_file import read_extrinsic
from trajectory_calibration.simulation import (
    flat,
    hills,
    Noise,
    paper_scenario,
    peaks,
    Scenario,
    SCENARIOS,
    Sensor,
    simulate,
    Unicycle,
    Wander,
    with_noise,
)
from trajectory_calibration.simulation.noise import (
    accumulate,
    jump,
    JUMP_VARIANCE,
    ornstein_uhlenbeck,
    running_product,
)
from trajectory_calibration.solvers import load_solver
from trajectory_calibration.sources.files import FileSource
from trajectory_calibration.time_alignment.align import match

SEEDS = range(20)
MANY = Scenario(duration=1000.0)


@pytest.fixture(scope='module')
def published(shared_data):
    """Return a reader of the published trajectories and extrinsics of a class, run by run."""
    def read(folder):
        runs = sorted((shared_data / 'simulation' / folder).glob('run_*'))
        assert runs
        return [(FileSource(run / 'T_S1_W1.txt').load(), FileSource(run / 'T_S2_W2.txt').load(),
                 read_extrinsic(run / 'T_S2_S1.txt').T_a_b) for run in runs]
    return read


@pytest.fixture(scope='module')
def own():
    """Return the noiseless pairs of the paper's scenario."""
    return [simulate(paper_scenario(), seed) for seed in SEEDS]


def steps(poses):
    """Return the (N - 1, 4, 4) motions from each pose to the next."""
    return se3.inverse(poses[:-1]) @ poses[1:]


def errors_of(disturbed, true):
    """Return the (N, 6) errors that were multiplied to the right: metres, radians."""
    error = se3.inverse(true.poses) @ disturbed.poses
    return np.concatenate([error[:, :3, 3], se3.log_so3(error[:, :3, :3])], axis=1)


# --- The base motion of the paper ---

def test_paper_dimensions(own):
    for pair in own:
        assert len(pair.a) == len(pair.b) == 100
        np.testing.assert_array_equal(np.diff(pair.a.stamps_ns), 100_000_000)
        np.testing.assert_array_equal(pair.a.stamps_ns, pair.b.stamps_ns)
        assert np.abs(pair.T_a_b[:3, 3]).max() <= 0.5


def test_terrain_is_the_published_one(published):
    for a, _, _ in published('noise/noise_0.000000'):
        height, slope_x, slope_y = peaks(*a.positions[:, :2].T)
        np.testing.assert_allclose(a.positions[:, 2], height, atol=1e-10)
        # The published orientations follow the ground on a grid.
        steep = 1 + slope_x**2 + slope_y**2
        np.testing.assert_allclose(
            a.rotations[:, 2, 2], np.sqrt((1 - slope_x**2 / steep) * (1 - slope_y**2 / steep)),
            atol=0.006)


def test_steps_and_tilt_are_like_the_published_ones(published, own):
    theirs = [a for a, _, _ in published('noise/noise_0.000000')]
    ours = [pair.a for pair in own]
    for statistic in (
        lambda a: np.linalg.norm(np.diff(a.positions, axis=0), axis=1).mean(),
        lambda a: np.linalg.norm(np.diff(a.positions[:, :2], axis=0), axis=1).mean(),
        lambda a: np.arccos(a.rotations[:, 2, 2]).mean(),
        lambda a: np.arccos(a.rotations[:, 2, 2]).max(),
        lambda a: se3.rotation_angle(steps(a.poses)[:, :3, :3]).mean(),
        lambda a: np.abs(a.positions).max(),
    ):
        of_theirs, of_ours = (np.array([statistic(a) for a in group]) for group in (theirs, ours))
        error = np.hypot(of_theirs.std() / len(theirs)**0.5, of_ours.std() / len(ours)**0.5)
        assert abs(of_theirs.mean() - of_ours.mean()) < 4 * error + 1e-5


@pytest.mark.parametrize('ground', [flat, peaks, hills])
def test_slopes_are_those_of_the_height(ground):
    x, y = np.random.default_rng(1).uniform(-3, 3, (2, 200))
    h = 1e-6
    _, slope_x, slope_y = ground(x, y)
    np.testing.assert_allclose(
        slope_x, (ground(x + h, y)[0] - ground(x - h, y)[0]) / (2 * h), atol=1e-7)
    np.testing.assert_allclose(
        slope_y, (ground(x, y + h)[0] - ground(x, y - h)[0]) / (2 * h), atol=1e-7)


def test_vehicle_drives_where_it_points():
    path = Unicycle(ground=hills).draw(60.0, np.random.default_rng(3))
    times = np.arange(0, 60, 1e-3)
    poses = path(times)
    velocity = np.diff(poses[:, :3, 3], axis=0) / 1e-3
    forward = poses[:-1, :3, 0]
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    np.testing.assert_allclose(velocity / speed, forward, atol=5e-3)
    np.testing.assert_allclose(np.linalg.norm(velocity[:, :2], axis=1), 0.5, atol=1e-5)


def test_yaw_rate_is_held():
    path = Unicycle(ground=flat).draw(9.9, np.random.default_rng(4))
    rates = se3.log_so3(steps(path(np.arange(100) / 10))[:, :3, :3])[:, 2] / 0.1
    held = rates[:95].reshape(-1, 5)
    np.testing.assert_allclose(held, held[:, :1].repeat(5, axis=1), atol=1e-9)
    assert np.abs(rates).max() <= 2.0
    assert held[:, 0].std() == pytest.approx(4 / np.sqrt(12), rel=0.35)


def test_path_does_not_depend_on_the_rate():
    path = Wander().draw(20.0, np.random.default_rng(5))
    times = np.linspace(0, 20, 401)
    np.testing.assert_array_equal(path(times)[::4], path(times[::4]))


def test_wander_moves_in_all_directions():
    poses = Wander(reach=2.0, tilt=0.3, turn=1.0).draw(1e4, np.random.default_rng(6))(
        np.arange(0, 1e4, 0.5))
    np.testing.assert_allclose(poses[:, :3, 3].std(axis=0), 2.0, rtol=0.05)
    assert np.arccos(poses[:, 2, 2]).mean() > 0.2


# --- Noise, as defined and as published ---

@pytest.mark.parametrize('sigma', [0.002, 0.010])
def test_white_noise_is_recovered(published, sigma):
    true, noisy = (published(f'noise/noise_{level:.6f}') for level in (0.0, sigma))
    theirs = np.concatenate([
        errors_of(disturbed, pose) for run, clean in zip(noisy, true, strict=True)
        for disturbed, pose in zip(run[:2], clean[:2], strict=True)])
    pairs = [(simulate(paper_scenario(white=sigma), seed), simulate(paper_scenario(), seed))
             for seed in SEEDS]
    ours = np.concatenate([
        errors_of(disturbed, pose) for noisy_pair, clean_pair in pairs
        for disturbed, pose in ((noisy_pair.a, clean_pair.a), (noisy_pair.b, clean_pair.b))])
    expected = sigma * np.array([1, 1, 1, 2, 2, 2])
    for errors in (theirs, ours):
        # Four standard errors of a standard deviation.
        np.testing.assert_allclose(errors.std(axis=0), expected, rtol=4 / np.sqrt(2 * len(errors)))


def test_jumps_are_recovered(published):
    true, jumped = (published(f'outliers/outliers_{count}') for count in (0, 10))

    def found(disturbed, pose):
        moved = np.diff(disturbed.positions - pose.positions, axis=0)
        np.testing.assert_allclose(disturbed.rotations, pose.rotations, atol=1e-12)
        return moved[np.linalg.norm(moved, axis=1) > 1e-9]

    theirs = np.concatenate([
        found(run[k], clean[k]) for run, clean in zip(jumped, true, strict=True) for k in (0, 1)])
    ours = []
    for seed in SEEDS:
        pair, clean = (simulate(paper_scenario(jumps=count), seed) for count in (10, 0))
        for disturbed, pose in ((pair.a, clean.a), (pair.b, clean.b)):
            ours.append(found(disturbed, pose))
            assert len(ours[-1]) == 10
    for jumps in (theirs, np.concatenate(ours)):
        np.testing.assert_allclose(
            jumps.var(axis=0), JUMP_VARIANCE, rtol=4 * np.sqrt(2 / len(jumps)))


def test_drift_is_recovered(published):
    true, drifted = (published(f'drift/drift_{level:.6f}') for level in (0.0, 0.05))
    pairs = [tuple(simulate(paper_scenario(drift=level), seed) for level in (0.0, 0.05))
             for seed in SEEDS]
    runs = [(clean[:2], run[:2]) for clean, run in zip(true, drifted, strict=True)]
    runs += [((clean.a, clean.b), (run.a, run.b)) for clean, run in pairs]
    axes = set()
    for (clean_a, clean_b), (a, b) in runs:
        np.testing.assert_allclose(a.poses, clean_a.poses, atol=1e-12)
        moved = steps(clean_b.poses)[:, :3, 3]
        per_metre = ((steps(b.poses)[:, :3, 3] - moved)
                     / np.linalg.norm(moved, axis=1, keepdims=True))
        axis = int(np.argmax(np.abs(per_metre[0])))
        np.testing.assert_allclose(per_metre, 0.05 * np.eye(3)[[axis] * 99], atol=1e-9)
        axes.add(axis)
    assert axes == {0, 1, 2}


@pytest.mark.statistical
@pytest.mark.parametrize(('folder', 'scenario'), [
    ('noise/noise_0.010000', paper_scenario(white=0.01)),
    ('drift/drift_0.050000', paper_scenario(drift=0.05)),
    ('mixture', SCENARIOS['mixture']),
])
def test_calibration_is_as_hard_as_on_the_published_runs(published, folder, scenario):
    # The answer of calibrate() alone; its covariance is not asked for.
    config = CalibrationConfig(solver='dnl', reference='B5')

    def error_of_dnl(a, b, truth):
        motions = select_motions(match(a, b, config)[1], 'B5')
        return absolute_errors(load_solver('dnl')(motions, config).T_a_b, truth)

    errors = [error_of_dnl(*run) for run in published(folder)]
    quartiles = np.quantile([(e.e_at, e.e_aR) for e in errors], [0.25, 0.75], axis=0)
    pairs = [simulate(scenario, seed) for seed in range(38)]
    own_errors = [error_of_dnl(p.a, p.b, p.T_a_b) for p in pairs]
    median = np.median([(e.e_at, e.e_aR) for e in own_errors], axis=0)
    assert (quartiles[0] < median).all()
    assert (median < quartiles[1]).all()


def test_random_walk_grows_with_the_distance():
    noise = Noise(walk=0.02, walk_rotation=0.01)
    true, walked = (simulate(with_noise(MANY, Noise(), noise_b), 7)
                    for noise_b in (Noise(), noise))
    error = se3.inverse(steps(true.b.poses)) @ steps(walked.b.poses)
    length = np.linalg.norm(steps(true.b.poses)[:, :3, 3], axis=1)[:, None]
    scaled = se3.log_se3(error) / np.sqrt(length)
    np.testing.assert_allclose(
        scaled.std(axis=0), [0.02] * 3 + [0.01] * 3, rtol=4 / np.sqrt(2 * len(scaled)))


def test_coloured_noise_has_its_spread_and_correlation():
    noise = ornstein_uhlenbeck(200_000, 0.1, 0.03, 0.01, 0.5, np.random.default_rng(8))
    np.testing.assert_allclose(noise.std(axis=0), [0.03] * 3 + [0.01] * 3, rtol=0.03)
    for lag in (1, 5, 10):
        product = (noise[lag:] * noise[:-lag]).mean(axis=0) / noise.var(axis=0)
        np.testing.assert_allclose(product, np.exp(-0.1 * lag / 0.5), atol=0.03)
    # Stationary from the first sample on.
    first = [ornstein_uhlenbeck(1, 0.1, 0.03, 0.01, 0.5, np.random.default_rng(seed))[0, 0]
             for seed in range(2000)]
    assert np.std(first) == pytest.approx(0.03, rel=0.07)


def test_loop_closures_set_right_what_accumulated():
    true = simulate(MANY, 9).b
    pair = simulate(with_noise(MANY, Noise(), Noise(walk=0.01, loop_closures=4)), 9)
    error = np.linalg.norm(errors_of(pair.b, true)[:, :3], axis=1)
    closed = np.flatnonzero(error < 1e-9)
    assert len(closed) == 5
    assert closed[0] == 0
    assert error.max() > 0.05


def test_scale_multiplies_every_translation():
    true, scaled = (simulate(with_noise(MANY, Noise(), Noise(scale=scale)), 10)
                    for scale in (1.0, 1.02))
    np.testing.assert_allclose(
        steps(scaled.b.poses)[:, :3, 3], 1.02 * steps(true.b.poses)[:, :3, 3], atol=1e-9)
    np.testing.assert_allclose(scaled.b.rotations, true.b.rotations, atol=1e-9)


def test_raising_one_noise_leaves_the_others():
    quiet, loud = (simulate(paper_scenario(white=white, jumps=3, drift=0.01), 11)
                   for white in (0.0, 0.01))
    clean = simulate(paper_scenario(jumps=3, drift=0.01), 11)
    np.testing.assert_array_equal(quiet.b.poses, clean.b.poses)
    np.testing.assert_allclose(loud.b.positions, clean.b.positions, atol=0.06)


@pytest.mark.parametrize('count', [1, 2, 3, 10, 99, 100, 101])
def test_running_product(count):
    poses = se3.exp_se3(np.random.default_rng(count).normal(size=(count, 6)))
    expected = [poses[0]]
    for pose in poses[1:]:
        expected.append(expected[-1] @ pose)
    np.testing.assert_allclose(running_product(poses), expected, atol=1e-10)


def test_noise_leaves_its_input_alone():
    poses = simulate(Scenario(), 1).a.poses
    assert not poses.flags.writeable
    nothing = {'drift': 0.0, 'walk': 0.0, 'walk_rotation': 0.0, 'scale': 1.0}
    np.testing.assert_allclose(
        accumulate(poses, closures=np.array([], int), rng=np.random.default_rng(1), **nothing),
        poses, atol=1e-12)
    assert np.abs(jump(poses, 3, np.random.default_rng(1)) - poses).max() > 1e-3


# --- Sensors and scenarios ---

@pytest.mark.parametrize('name', SCENARIOS)
def test_without_noise_the_truth_is_exact(name):
    scenario = with_noise(SCENARIOS[name], Noise(), Noise())
    same_rate = replace(scenario, b=replace(scenario.b, rate=scenario.a.rate))
    pair = simulate(same_rate, 12)
    residual = steps(pair.a.poses) @ pair.T_a_b - pair.T_a_b @ steps(pair.b.poses)
    assert np.abs(residual).max() < 1e-10


@pytest.mark.parametrize('name', ['offroad', 'drone', 'handheld'])
def test_scenarios_can_be_calibrated(name):
    pair = simulate(SCENARIOS[name], 13)
    errors = calibrate(pair.a, pair.b).absolute_errors(pair.T_a_b)
    assert errors.e_at < 0.05
    assert np.rad2deg(errors.e_aR) < 0.5


def test_road_is_level_and_fast():
    pair = simulate(SCENARIOS['road'], 14)
    true = simulate(with_noise(SCENARIOS['road'], Noise(), Noise()), 14).a
    assert np.ptp(true.positions[:, 2]) == 0
    speed = np.linalg.norm(np.diff(true.positions, axis=0), axis=1) * 10
    np.testing.assert_allclose(speed, 15.0, rtol=1e-3)
    assert len(pair.b) == 2 * len(pair.a) - 1


def test_same_seed_same_data_other_seed_other_data():
    first, again, other = (simulate(SCENARIOS['mixture'], seed) for seed in (15, 15, 16))
    np.testing.assert_array_equal(first.b.poses, again.b.poses)
    assert np.abs(first.b.poses - other.b.poses).max() > 0.1
    assert np.abs(first.T_a_b - other.T_a_b).max() > 0.1


def test_noise_does_not_change_motion_nor_truth():
    quiet, loud = (simulate(scenario, 17) for scenario in (paper_scenario(), SCENARIOS['mixture']))
    np.testing.assert_array_equal(quiet.T_a_b, loud.T_a_b)
    assert np.linalg.norm(loud.a.positions[0] - quiet.a.positions[0]) < 0.03


def test_extrinsic_rotations_are_uniform():
    R = np.array([simulate(Scenario(duration=0.2), seed).T_a_b[:3, :3] for seed in range(400)])
    # Of a uniform rotation, each entry has the mean 0 and the variance 1/3.
    np.testing.assert_allclose(R.mean(axis=0), 0, atol=4 / np.sqrt(3 * 400))
    np.testing.assert_allclose(R.var(axis=0), 1 / 3, atol=0.08)


def test_clock_rate_and_gaps():
    scenario = Scenario(
        duration=30.0, b=Sensor(rate=30.0, clock_offset=1.5, gaps=2, gap=2.0, sensor_frame='c'))
    pair = simulate(scenario, 18)
    whole_sensor = replace(scenario.b, gaps=0)
    whole = simulate(replace(scenario, b=whole_sensor), 18)
    assert len(pair.a) == 301
    assert len(whole.b) == 901
    assert whole.b.stamps_ns[0] - pair.a.stamps_ns[0] == 1_500_000_000
    missing = len(whole.b) - len(pair.b)
    assert 60 <= missing <= 120
    assert np.diff(pair.b.stamps_ns).max() >= 2_000_000_000
    fast = simulate(replace(scenario, b=replace(whole_sensor, clock_drift=1e-4)), 18).b
    np.testing.assert_allclose(
        fast.stamps_ns - fast.stamps_ns[0], 1.0001 * (whole.b.stamps_ns - whole.b.stamps_ns[0]),
        atol=1)
    kept = np.isin(whole.b.stamps_ns, pair.b.stamps_ns)
    np.testing.assert_array_equal(pair.b.poses, whole.b.poses[kept])


@pytest.mark.parametrize('noise', [
    replace(Noise(), **{item.name: 1e6})
    for item in fields(Noise) if item.name not in ('jumps', 'loop_closures')])
def test_the_largest_noise_is_still_a_trajectory(noise):
    pair = simulate(with_noise(Scenario(), noise, noise), 19)
    assert len(pair.b) == 100


@pytest.mark.parametrize('make', [
    lambda: Noise(white=-0.1),
    lambda: Noise(walk=float('nan')),
    lambda: Noise(scale=0.0),
    lambda: Noise(coloured_time=0.0),
    lambda: Noise(white=1e308),
    lambda: Noise(jumps=10**7),
    lambda: Sensor(clock_offset=float('nan')),
    lambda: Sensor(clock_drift=float('nan')),
    lambda: Sensor(clock_drift=0.002),
    lambda: Sensor(clock_offset=1e300),
    lambda: Sensor(clock_offset=-1.8e9),
    lambda: Scenario(duration=0.01),
    lambda: Scenario(duration=0.5, b=Sensor(rate=1.0)),
    lambda: Sensor(rate=0.0),
    lambda: Sensor(gaps=-1),
    lambda: Scenario(duration=float('inf')),
    lambda: simulate(paper_scenario(jumps=100), 1),
])
def test_nonsense_is_refused(make):
    with pytest.raises(ConfigError, match='needed'):
        make()


def test_a_mounting_that_is_given_changes_nothing_else():
    T = random_pose(np.random.default_rng(5))
    drawn, given = simulate(SCENARIOS['drone'], 3), simulate(SCENARIOS['drone'], 3, T)
    np.testing.assert_array_equal(given.T_a_b, T)
    np.testing.assert_array_equal(given.a.poses, drawn.a.poses)
    np.testing.assert_array_equal(given.b.stamps_ns, drawn.b.stamps_ns)
    assert not np.allclose(given.b.poses, drawn.b.poses)
