"""Poses at rest are left out where drift makes them worthless, and only there."""

from motion_data import perturb, random_pose
import numpy as np
import pytest

from trajectory_calibration import calibrate, Trajectory
from trajectory_calibration.simulation import Noise, Scenario, Sensor, simulate, Wander
from trajectory_calibration.solvers.drift_aware.standstill import without_rest
from trajectory_calibration.time_alignment.pairing import associate

MOTION = Wander(3.0, 0.4, 1.0, 0.3)
WHITE = Noise(white=0.001, white_rotation=0.001)
STEP_NS = 100_000_000


def with_rest(run, seed, stops, seconds, noise=WHITE):
    """Return the drive with white noise and so many stops of so long, and the driving instants."""
    rng = np.random.default_rng(seed)
    driven = np.arange(len(run.a))
    at = np.linspace(0, len(driven), stops + 2)[1:-1].astype(int)
    k = np.sort(np.concatenate([driven, np.repeat(at, round(10 * seconds))]))
    stamps_ns = run.a.stamps_ns[0] + STEP_NS * np.arange(len(k))
    return [perturb(rng, Trajectory(stamps_ns, poses[k], sensor_frame=name),
                    noise.white, noise.white_rotation)
            for poses, name in ((run.a.poses, 'a'), (run.b.poses, 'b'))], ~np.isin(k, at)


def drifting(seed, walk):
    return simulate(Scenario(120.0, MOTION, Sensor(), Sensor(noise=walk)), seed)


@pytest.mark.parametrize('stops, seconds', [(1, 300.0), (10, 10.0)])
def test_what_is_left_is_the_drive_and_a_pose_each_five_seconds(stops, seconds):
    run = drifting(0, Noise())
    (a, b), moving = with_rest(run, 1, stops, seconds)
    pairs = associate(a, b)
    drive = without_rest(pairs)
    assert drive.stops == stops
    left = np.isin(pairs.stamps_ns, drive.pairs.stamps_ns)
    assert left[moving].mean() > 0.97
    assert left[~moving].sum() <= stops * (seconds / 5 + 12)
    assert np.diff(drive.pairs.stamps_ns).max() <= 5_000_000_000
    # A single glitch does not make the rest of the drive look like rest.
    poses = a.poses.copy()
    poses[700, :3, 3] += 1e5
    glitch = without_rest(associate(Trajectory(a.stamps_ns, poses), b))
    assert abs(len(glitch.pairs) - len(drive.pairs)) < 30


def test_a_drive_without_rest_and_rest_without_a_drive_are_left_alone():
    run = drifting(0, Noise())
    pairs = associate(run.a, run.b)
    assert len(without_rest(pairs).pairs) == len(pairs)
    rng = np.random.default_rng(2)
    stamps_ns = STEP_NS * np.arange(500)
    at_rest = [Trajectory(stamps_ns, np.tile(random_pose(rng), (500, 1, 1))) for _ in 'ab']
    still = [perturb(rng, one, 0.01, 0.01) for one in at_rest]
    assert len(without_rest(associate(*still)).pairs) == 500


def test_minutes_of_rest_do_not_shorten_the_lever_arm():
    """A pose at rest shows rotation noise and nothing else, which a shorter lever arm fits."""
    metres, squares = [], []
    for seed in range(6):
        run = drifting(seed, Noise(walk=0.01, walk_rotation=0.003))
        (a, b), _ = with_rest(run, seed, 1, 600.0)
        result = calibrate(a, b)
        dt = result.T_a_b[:3, 3] - run.T_a_b[:3, 3]
        metres.append(np.linalg.norm(dt))
        squares.append(dt @ np.linalg.solve(result.covariance[:3, :3], dt) / 3)
    # Three times as far with all poses at rest.
    assert np.mean(metres) < 0.005
    assert np.mean(squares) < 2


def test_where_nothing_drifts_rest_is_worth_its_poses():
    """A machine that stops to be measured: each stop says the more, the longer it is."""
    run = drifting(0, Noise())
    (a, b), _ = with_rest(run, 0, 40, 10.0, Noise(white=0.005, white_rotation=0.002))
    result = calibrate(a, b)
    pairs = without_rest(associate(a, b)).pairs
    driven = calibrate(*(Trajectory(pairs.stamps_ns, poses) for poses in (
        pairs.poses_a, pairs.poses_b)))
    assert np.trace(result.covariance[:3, :3]) < 0.6 * np.trace(driven.covariance[:3, :3])
    assert result.absolute_errors(run.T_a_b).e_at < 4 * np.sqrt(
        np.trace(result.covariance[:3, :3]))
