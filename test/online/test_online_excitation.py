"""What the motion so far would allow: honest, and cheap to keep up to date. Needs no ROS."""

import time

import numpy as np
import pytest

from trajectory_calibration import calibrate, CalibrationConfig, Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.online.buffer import BufferLimits, PoseBuffer
from trajectory_calibration.online.excitation import ExcitationMonitor

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


def followed(stamps_ns, a, b, chunk=10, config=None):
    """Return the excitation after the drive arrived in chunks."""
    buffers = PoseBuffer(BufferLimits()), PoseBuffer(BufferLimits())
    monitor = ExcitationMonitor()
    for k in range(0, len(stamps_ns), chunk):
        part = slice(k, k + chunk)
        fill(buffers[0], stamps_ns[part], a[part])
        fill(buffers[1], stamps_ns[part], b[part])
        excitation = monitor.update(*buffers, 0, GAP_NS, config)
    return excitation


# In white noise drift_aware gains from every lag what motions of a second cannot show.
@pytest.mark.parametrize('solver, least', [
    ('taylor', 0.1), ('dnl', 0.1), ('ali', 0.1), ('drift_aware', 0.03)])
def test_the_prediction_bounds_the_errors_and_is_not_far_above_them(solver, least):
    normalised = []
    config = CalibrationConfig(solver=solver, reference='B1', max_gap=2.0, max_time_offset=0)
    for seed in range(20):
        stamps_ns, a, b = drive(900, (0, 1, 2), seed)
        excitation = followed(stamps_ns, a, b, chunk=900, config=config)
        # The same motions, one of a second after the other.
        result = calibrate(
            Trajectory(stamps_ns[::10], a[::10]), Trajectory(stamps_ns[::10], b[::10]), config)
        t = result.T_a_b[:3, 3] - T_A_B[:3, 3]
        rotation = se3.log_so3(result.T_a_b[:3, :3] @ T_A_B[:3, :3].T)
        normalised.append([np.mean((t / excitation.translation_std)**2),
                           np.mean((np.rad2deg(rotation) / excitation.rotation_std_deg)**2)])
    # Neighbouring motions share a pose, which makes sums of them better than independent ones.
    assert (np.mean(normalised, axis=0) < 1.3).all()
    assert (np.mean(normalised, axis=0) > least).all()


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
    assert advice == (
        'drive a ramp or a bank, or give prior_translation along z of lidar: translation along z '
        'is not determined, needed 0.02 m')


def flat_drive(poses, seed, *, speed=1.0, scale=1.0, walk=(0.001, 0.0003), white=(0.0, 0.0)):
    """Return stamps at 10 Hz and both sensors on flat ground, each with drift and white noise."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(poses) * 0.1
    twists = np.zeros((poses, 6))
    twists[:, 0] = 0.1 * speed
    twists[:, 5] = 0.06 * np.sin(0.7 * time_s + rng.uniform(0, 6))
    steps = se3.exp_se3(twists)
    tracks = []
    for own in (steps, se3.inverse(T_A_B) @ steps @ T_A_B):
        noise = [rng.normal(size=(poses, 6)) * np.repeat(size, 3) for size in (walk, white)]
        track = np.empty_like(steps)
        track[0] = np.eye(4)
        for k, step in enumerate((own @ se3.exp_se3(noise[0]))[1:]):
            track[k + 1] = track[k] @ step
        track = track @ se3.exp_se3(noise[1])
        track[:, :3, :3] = se3.nearest_rotation(track[:, :3, :3])
        tracks.append(track)
    tracks[1][:, :3, 3] /= scale
    return 1000 * 10**9 + np.arange(poses) * 10**8, *tracks


def error_of(result):
    """Return (6,) errors of an answer, metres and degrees."""
    return np.concatenate([
        result.T_a_b[:3, 3] - T_A_B[:3, 3],
        np.rad2deg(se3.log_so3(result.T_a_b[:3, :3] @ T_A_B[:3, :3].T))])


HEIGHT = {'prior_translation': f'-,-,{T_A_B[2, 3]}', 'prior_translation_std': '0.005'}


@pytest.mark.parametrize('settings', [HEIGHT, {'allow_unobserved': True}])
def test_flat_ground_is_enough_with_a_known_height_or_where_none_is_asked_for(settings):
    config = CalibrationConfig(max_time_offset=0, **settings)
    normalised = []
    for seed in range(5):
        stamps_ns, a, b = flat_drive(1200, seed)
        excitation = followed(stamps_ns, a, b, chunk=1200, config=config)
        assert excitation.sufficient(0.02, 0.2)
        left_out = '' if settings == HEIGHT else '; translation along z of lidar stays open'
        advice = excitation.advice('lidar', 0.02, 0.2)
        assert advice == f'enough motion: call ~/calibrate{left_out}'
        std = np.concatenate([excitation.translation_std, excitation.rotation_std_deg])
        error = error_of(calibrate(Trajectory(stamps_ns, a), Trajectory(stamps_ns, b), config))
        normalised.append((error / std)**2)
    asked = np.array([0, 1, 3, 4, 5])
    # The answer may weigh several lags, and is then better than motions of a second.
    assert 0.1 < np.mean(np.array(normalised)[:, asked]) < 1.5
    if settings == HEIGHT:
        assert std[2] == pytest.approx(0.005, rel=0.01)


def test_the_first_moment_of_enough_is_not_one_of_luck():
    config = CalibrationConfig(solver='dnl', reference='B10', max_time_offset=0, **HEIGHT)
    normalised = []
    for seed in range(16):
        stamps_ns, a, b = flat_drive(600, seed, walk=(0.003, 0.0005))
        buffers = PoseBuffer(BufferLimits()), PoseBuffer(BufferLimits())
        monitor = ExcitationMonitor()
        for k in range(0, 600, 10):
            fill(buffers[0], stamps_ns[k:k + 10], a[k:k + 10])
            fill(buffers[1], stamps_ns[k:k + 10], b[k:k + 10])
            excitation = monitor.update(*buffers, 0, GAP_NS, config)
            if excitation.sufficient(0.02, 0.2):
                break
        assert excitation.sufficient(0.02, 0.2)
        result = calibrate(Trajectory(stamps_ns[:k + 10], a[:k + 10]),
                           Trajectory(stamps_ns[:k + 10], b[:k + 10]), config)
        std = np.concatenate([excitation.translation_std, excitation.rotation_std_deg])
        normalised.append((error_of(result) / std)[[0, 1, 3, 4, 5]])
    assert np.sqrt(np.mean(np.square(normalised))) < 1.0


def test_flat_ground_predicts_the_rest_whatever_it_does_not_show():
    excitation = followed(*flat_drive(1200, 0), chunk=1200)
    assert (excitation.translation_std[:2] < 0.01).all()
    assert (excitation.rotation_std_deg < 0.1).all()
    assert excitation.translation_std[2] > 5.0


@pytest.mark.parametrize('walk, white', [
    # Wheels that measure distance to a tenth of a millimetre, beside a gyroscope that rolls.
    ((1e-5, 0.002), (0.0, 0.0)), ((0.0, 0.0), (1e-4, 0.002)), ((0.02, 0.0003), (0.0, 0.0))])
def test_noise_of_roll_and_pitch_is_no_ramp(walk, white):
    for seed in range(4):
        excitation = followed(*flat_drive(3000, seed, walk=walk, white=white), chunk=3000)
        assert excitation.translation_std[2] > 1.0


@pytest.mark.parametrize('settings', [{}, {'prior_rotation': '0,0,60', 'prior_rotation_std': '1'}])
def test_where_a_vehicle_does_not_turn_open_directions_are_still_asked_for(settings):
    stamps_ns, a, b = drive(900, ())
    config = CalibrationConfig(allow_unobserved=True, **settings)
    assert not followed(stamps_ns, a, b, chunk=900, config=config).sufficient(0.02, 0.2)


def test_priors_of_all_that_motion_does_not_show_are_enough():
    stamps_ns, a, b = drive(900, ())
    config = CalibrationConfig(
        prior_translation='0,0,0', prior_translation_std='0.01', prior_rotation='0,0,0',
        prior_rotation_std='0.1')
    assert followed(stamps_ns, a, b, chunk=900, config=config).sufficient(0.02, 0.2)
    fixed = CalibrationConfig(prior_translation='0,0,0', prior_translation_std='0')
    std = followed(stamps_ns, a, b, chunk=900, config=fixed).translation_std
    assert (std < 1e-9).all()


@pytest.mark.parametrize('given', [1.0, 2.5])
def test_b_may_be_in_any_unit_of_length(given):
    stamps_ns, a, b = drive(900, (0, 1, 2))
    b[:, :3, 3] /= 2.5
    config = CalibrationConfig(scale=given)
    metres = followed(*drive(900, (0, 1, 2)), chunk=900)
    scaled = followed(stamps_ns, a, b, chunk=900, config=config)
    assert np.allclose(scaled.translation_std, metres.translation_std, rtol=0.1)
    assert scaled.sufficient(0.02, 0.2)
    # Of a scale that is given wrong, nothing is promised.
    wrong = CalibrationConfig(scale_mode='fixed')
    assert not followed(stamps_ns, a, b, chunk=900, config=wrong).sufficient(0.02, 0.2)


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
