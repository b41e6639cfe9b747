"""What the motion so far would allow: honest, and cheap to keep up to date. Needs no ROS."""

import time

import numpy as np
import pytest

from trajectory_calibration import calibrate, CalibrationConfig, se3, Trajectory
from trajectory_calibration.ros.buffer import BufferLimits, PoseBuffer
from trajectory_calibration.ros.excitation import ExcitationMonitor

T_A_B = se3.exp_se3([0.3, -0.2, 0.1, 0.4, -0.3, 1.2])
GAP_NS = 500_000_000
NOISE = np.array([0.005] * 3 + [0.002] * 3)


def drive(poses, axes, seed=0, noise=NOISE):
    """Return stamps at 10 Hz and noisy poses of both sensors, turning about some axes of a."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(poses) * 0.1
    twists = np.zeros((poses, 6))
    twists[:, 0] = 0.1
    for axis in axes:
        rate, phase = rng.uniform(0.2, 0.9), rng.uniform(0, 6)
        twists[:, 3 + axis] = 0.04 * np.sin(rate * time_s + phase)
    steps = se3.exp_se3(twists)
    a = np.empty_like(steps)
    a[0] = np.eye(4)
    for k in range(1, poses):
        a[k] = a[k - 1] @ steps[k]
    b = se3.exp_se3([5.0, -2.0, 1.0, 0.2, 0.1, -0.9]) @ a @ T_A_B
    return (1000 * 10**9 + np.arange(poses) * 10**8,
            a @ se3.exp_se3(rng.normal(size=(poses, 6)) * noise),
            b @ se3.exp_se3(rng.normal(size=(poses, 6)) * noise))


def fill(buffer, stamps_ns, poses, frames=('map', 'lidar')):
    q = se3.rotation_to_quaternion(poses[:, :3, :3])
    rows = np.column_stack([poses[:, :3, 3], q])
    for stamp, row in zip(stamps_ns.tolist(), rows.tolist(), strict=True):
        buffer.append(stamp, frames, tuple(row))


def followed(stamps_ns, a, b, chunk=10):
    """Return the excitation after the drive arrived in chunks."""
    buffers = PoseBuffer(BufferLimits()), PoseBuffer(BufferLimits())
    monitor = ExcitationMonitor()
    for k in range(0, len(stamps_ns), chunk):
        part = slice(k, k + chunk)
        fill(buffers[0], stamps_ns[part], a[part])
        fill(buffers[1], stamps_ns[part], b[part])
        excitation = monitor.update(*buffers, 0, GAP_NS)
    return excitation


def test_the_prediction_bounds_the_errors_and_is_not_far_above_them():
    normalised = []
    for seed in range(20):
        stamps_ns, a, b = drive(900, (0, 1, 2), seed)
        excitation = followed(stamps_ns, a, b)
        # The same motions, one of a second after the other.
        result = calibrate(
            Trajectory(stamps_ns[::10], a[::10]), Trajectory(stamps_ns[::10], b[::10]),
            CalibrationConfig(solver='taylor', reference='B1', max_gap=2.0))
        t = result.T_a_b[:3, 3] - T_A_B[:3, 3]
        rotation = se3.log_so3(result.T_a_b[:3, :3] @ T_A_B[:3, :3].T)
        normalised.append([np.mean((t / excitation.translation_std)**2),
                           np.mean((np.rad2deg(rotation) / excitation.rotation_std_deg)**2)])
    # Neighbouring motions share a pose, which makes sums of them better than independent ones.
    assert (np.mean(normalised, axis=0) < 1.3).all()
    assert (np.mean(normalised, axis=0) > 0.1).all()


@pytest.mark.parametrize('chunk', [1, 7, 1000])
def test_it_does_not_matter_in_what_portions_the_poses_come(chunk):
    expected, found = (followed(*drive(1000, (0, 1, 2)), chunk=c) for c in (10, chunk))
    # A portion decides which pose of b begins a second; the statistics must not care.
    assert abs(found.motions - expected.motions) <= 0.1 * expected.motions
    assert np.allclose(found.rotation_deg, expected.rotation_deg, rtol=0.1)
    assert np.allclose(found.translation_std, expected.translation_std, rtol=0.3)


@pytest.mark.parametrize('noise', [NOISE, 0 * NOISE])
def test_planar_motion_is_not_enough_however_long(noise):
    excitation = followed(*drive(3000, (2,), noise=noise))
    advice = excitation.advice('lidar', 0.02, 0.2)
    assert not excitation.sufficient(0.02, 0.2)
    assert excitation.translation_std[2] > 0.5
    assert advice.startswith(('turn more about x of lidar', 'turn more about y of lidar'))
    assert 'z' in advice


def test_motion_about_all_axes_is_enough():
    excitation = followed(*drive(900, (0, 1, 2)))
    assert excitation.sufficient(0.02, 0.2)
    assert excitation.advice('lidar', 0.02, 0.2) == 'enough motion: call ~/calibrate'
    assert not excitation.sufficient(1e-5, 0.2)
    assert 'needed 1e-05 m' in excitation.advice('lidar', 1e-5, 0.2)


@pytest.mark.parametrize('sparse', ['a', 'b'])
def test_a_sensor_of_one_pose_a_second_serves_whichever_it_is(sparse):
    stamps_ns, a, b = drive(900, (0, 1, 2))
    poses = {'a': a, 'b': b}
    buffers = {name: PoseBuffer(BufferLimits()) for name in 'ab'}
    for name, buffer in buffers.items():
        every = 10 if name == sparse else 1
        late = 0 if name == 'a' else 700_000_000
        fill(buffer, stamps_ns[::every] + late, poses[name][::every])
    excitation = ExcitationMonitor().update(*buffers.values(), -700_000_000, GAP_NS)
    assert excitation.motions == 89
    assert excitation.sufficient(0.02, 0.2)


def test_standing_still_is_no_motion():
    excitation = followed(*drive(900, ()))
    assert not excitation.sufficient(0.02, 0.2)


def test_nothing_at_all_says_drive():
    monitor = ExcitationMonitor()
    empty = PoseBuffer(BufferLimits()), PoseBuffer(BufferLimits())
    assert monitor.update(*empty, 0, GAP_NS).advice('lidar', 0.02, 0.2).startswith('drive')


def test_a_cleared_buffer_begins_anew():
    stamps_ns, a, b = drive(900, (0, 1, 2))
    buffers = PoseBuffer(BufferLimits()), PoseBuffer(BufferLimits())
    monitor = ExcitationMonitor()
    fill(buffers[0], stamps_ns, a)
    fill(buffers[1], stamps_ns, b)
    assert monitor.update(*buffers, 0, GAP_NS).motions > 80
    buffers[0].clear()
    assert monitor.update(*buffers, 0, GAP_NS).motions == 0


def test_another_clock_offset_begins_anew_from_what_is_held():
    stamps_ns, a, b = drive(900, (0, 1, 2), noise=0 * NOISE)
    buffers = PoseBuffer(BufferLimits()), PoseBuffer(BufferLimits())
    monitor = ExcitationMonitor()
    fill(buffers[0], stamps_ns, a)
    fill(buffers[1], stamps_ns + 700_000_000, b)
    wrong = monitor.update(*buffers, 0, GAP_NS)
    right = monitor.update(*buffers, -700_000_000, GAP_NS)
    assert right.motions > 80
    assert (right.translation_std < 1e-3 * wrong.translation_std).all()


def test_gaps_that_may_be_longer_begin_anew_from_what_is_held():
    stamps_ns, a, b = drive(900, (0, 1, 2))
    buffers = PoseBuffer(BufferLimits()), PoseBuffer(BufferLimits())
    monitor = ExcitationMonitor()
    fill(buffers[0], stamps_ns, a)
    fill(buffers[1], stamps_ns + 30_000_000, b)
    assert monitor.update(*buffers, 0, 10_000_000).motions == 0
    assert monitor.update(*buffers, 0, GAP_NS).motions > 80


@pytest.mark.parametrize('limits', [BufferLimits(max_poses=600), BufferLimits(max_age_s=60.0)])
def test_motion_that_has_left_the_buffers_does_not_count(limits):
    stamps_ns, a, b = drive(900, (0, 1, 2))
    straight = se3.exp_se3(np.arange(1, 1001)[:, None] * [0.1, 0, 0, 0, 0, 0])
    a = np.concatenate([a, a[-1] @ straight])
    b = np.concatenate([b, b[-1] @ se3.inverse(T_A_B) @ straight @ T_A_B])
    stamps_ns = stamps_ns[0] + np.arange(len(a)) * 10**8
    buffers = PoseBuffer(limits), PoseBuffer(limits)
    monitor, driven = ExcitationMonitor(), []
    for k in range(0, len(a), 10):
        part = slice(k, k + 10)
        fill(buffers[0], stamps_ns[part], a[part])
        fill(buffers[1], stamps_ns[part], b[part])
        excitation = monitor.update(*buffers, 0, GAP_NS)
        driven.append(excitation.driven)
        if k == 890:
            assert excitation.sufficient(0.02, 0.2)
    assert not excitation.sufficient(0.02, 0.2)
    assert 58 <= excitation.motions <= 66
    # What was driven counts on, whatever has left.
    assert driven == list(range(len(driven)))


def test_gaps_are_not_bridged():
    stamps_ns, a, b = drive(900, (0, 1, 2))
    keep = (np.arange(900) < 200) | (np.arange(900) > 700)
    buffers = PoseBuffer(BufferLimits()), PoseBuffer(BufferLimits())
    fill(buffers[0], stamps_ns[keep], a[keep])
    fill(buffers[1], stamps_ns, b)
    motions = ExcitationMonitor().update(*buffers, 0, GAP_NS).motions
    assert 35 <= motions <= 39


def test_a_second_costs_little_with_a_hundred_thousand_poses_held():
    rng = np.random.default_rng(0)
    poses = se3.exp_se3(np.cumsum(rng.normal(size=(100_000, 6)) * 0.001, axis=0))
    rows = np.column_stack([poses[:, :3, 3], se3.rotation_to_quaternion(poses[:, :3, :3])])
    stamps_ns = np.arange(100_000) * 10**7
    buffers = [PoseBuffer(BufferLimits()) for _ in range(2)]
    for buffer in buffers:
        buffer.replace(stamps_ns[:-300], rows[:-300], ('map', ''))
    monitor = ExcitationMonitor()
    monitor.update(*buffers, 0, GAP_NS)
    seconds = []
    for k in range(-300, 0, 100):
        for buffer in buffers:
            for stamp, row in zip(stamps_ns[k:k + 100], rows[k:k + 100], strict=False):
                buffer.append(int(stamp), ('map', ''), tuple(row))
        start = time.process_time()
        monitor.update(*buffers, 0, GAP_NS)
        seconds.append(time.process_time() - start)
    assert min(seconds) < 0.01
