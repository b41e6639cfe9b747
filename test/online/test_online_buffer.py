# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What enters a buffer, what does not, and how much it keeps. Needs no ROS."""

import math

import numpy as np
import pytest

from trajectory_calibration import AssociationError, CalibrationConfig, TrajectoryError
from trajectory_calibration.geometry import se3
from trajectory_calibration.online.buffer import BufferLimits, PoseBuffer, Refusal
from trajectory_calibration.online.session import CalibrationSession

SECOND = 1_000_000_000


def along_x(x, angle=0.0):
    """Return a pose at x metres, turned about z."""
    return (x, 0.0, 0.0, 0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2))


def filled(poses, limits=None, start_s=100, step_ns=SECOND // 10):
    buffer = PoseBuffer(limits or BufferLimits())
    for k in range(poses):
        buffer.append(start_s * SECOND + k * step_ns, ('map', 'lidar'), along_x(0.1 * k))
    return buffer


def test_a_snapshot_is_what_was_appended_and_stays_so():
    buffer = filled(50)
    track = buffer.snapshot('sensor_a')
    buffer.append(200 * SECOND, ('map', 'lidar'), along_x(9.0))
    buffer.clear()
    trajectory = track.trajectory()
    assert len(trajectory) == 50
    assert np.array_equal(trajectory.stamps_ns, 100 * SECOND + np.arange(50) * (SECOND // 10))
    assert np.allclose(trajectory.positions[:, 0], 0.1 * np.arange(50), atol=1e-15)
    assert (trajectory.world_frame, trajectory.sensor_frame) == ('map', 'lidar')
    assert len(buffer) == 0


@pytest.mark.parametrize('named, override, expected', [
    ('lidar', '', 'lidar'), ('lidar', 'roof', 'roof'), ('', '', 'sensor_a')])
def test_the_frame_comes_from_the_messages_unless_overridden(named, override, expected):
    buffer = PoseBuffer(BufferLimits())
    buffer.append(SECOND, ('map', named), along_x(0.0))
    assert buffer.snapshot('sensor_a', override).sensor_frame == expected


@pytest.mark.parametrize('max_poses', [10, 100, 700])
def test_the_newest_poses_stay_within_a_bound_of_memory(max_poses):
    buffer = filled(5000, BufferLimits(max_poses=max_poses))
    track = buffer.snapshot('a')
    assert len(track.stamps_ns) == max_poses
    assert track.stamps_ns[-1] == 100 * SECOND + 4999 * (SECOND // 10)
    assert np.array_equal(np.diff(track.stamps_ns), np.full(max_poses - 1, SECOND // 10))
    assert np.allclose(track.poses[:, 0], 0.1 * np.arange(5000 - max_poses, 5000))
    assert buffer.nbytes <= 2 * max_poses * 64


def test_old_poses_leave_by_age():
    track = filled(100, BufferLimits(max_age_s=2.0)).snapshot('a')
    assert len(track.stamps_ns) == 21


@pytest.mark.parametrize('pose, why', [
    ((math.nan, 0, 0, 0, 0, 0, 1), Refusal.NOT_FINITE),
    ((0, 0, math.inf, 0, 0, 0, 1), Refusal.NOT_FINITE),
    ((0, 0, 0, 0, math.nan, 0, 1), Refusal.NOT_FINITE),
    ((0, 0, 0, 0, 0, 0, 0), Refusal.NOT_UNIT),
    ((0, 0, 0, 0, 0, 0, 1.02), Refusal.NOT_UNIT),
    ((0, 0, 0, 0, 0, 0, 1e100), Refusal.NOT_UNIT),
    ((0, 0, 0, 0, 0, 0, 1e200), Refusal.NOT_UNIT),
    ((1e100, 0, 0, 0, 0, 0, 1), Refusal.TOO_FAR),
    ((0, -1.1e9, 0, 0, 0, 0, 1), Refusal.TOO_FAR),
    ((1.5e308, 1.5e308, 0, 0, 0, 0, 1), Refusal.TOO_FAR),
])
def test_poses_that_are_none_are_counted(pose, why):
    buffer = filled(10)
    buffer.append(102 * SECOND, ('map', 'lidar'), pose)
    assert len(buffer) == 10
    assert buffer.refused[why] == sum(buffer.refused.values()) == 1
    assert why.value in buffer.refusals()
    # In a Path the same, and none of them costs the poses around it.
    good = np.column_stack([np.arange(10.0), np.zeros((10, 5)), np.ones(10)])
    buffer.replace(np.arange(1, 12) * SECOND, np.vstack([good, pose]), ('map', ''))
    assert len(buffer) == 10
    assert buffer.refused[why] == sum(buffer.refused.values()) == 1


def test_a_huge_position_does_not_spoil_the_calibrations_that_follow():
    rng = np.random.default_rng(4)
    a = se3.exp_se3(np.cumsum(rng.normal(size=(60, 6)) * 0.1, axis=0))
    T_a_b = se3.exp_se3([0.3, -0.2, 0.1, 0.4, -0.3, 1.2])
    session = CalibrationSession(('/a', '/b'), BufferLimits())
    for buffer, poses, child in ((session.buffers[0], a, 'lidar'),
                                 (session.buffers[1], a @ T_a_b, 'camera')):
        rows = np.column_stack([
            poses[:, :3, 3], se3.rotation_to_quaternion(poses[:, :3, :3])])
        for k, row in enumerate(rows.tolist()):
            buffer.append((1 + 2 * k) * SECOND // 10, ('map', child), row)
            buffer.append((2 + 2 * k) * SECOND // 10, ('map', child), (1e120, *row[1:]))
    result = session.job(CalibrationConfig(solver='taylor')).run().result
    assert np.allclose(result.T_a_b, T_a_b, atol=1e-9)
    assert any('60 too far away' in warning for warning in result.warnings)


@pytest.mark.parametrize('offset_s, why', [
    (0.0, Refusal.DUPLICATE), (-0.05, Refusal.OUT_OF_ORDER), (-4.9, Refusal.OUT_OF_ORDER)])
def test_late_stamps_are_counted(offset_s, why):
    buffer = filled(10)
    newest = buffer.span_ns[1]
    buffer.append(newest + round(offset_s * 1e9), ('map', 'lidar'), along_x(9.0))
    assert len(buffer) == 10
    assert buffer.refused[why] == 1


@pytest.mark.parametrize('stray_ns', [1, 50 * SECOND, 10**18])
def test_a_stray_stamp_costs_nothing_but_itself(stray_ns):
    buffer = filled(10)
    newest = buffer.span_ns[1]
    buffer.append(stray_ns, ('map', 'lidar'), along_x(1.0))
    buffer.append(newest + SECOND // 10, ('map', 'lidar'), along_x(1.1))
    assert len(buffer) == 11
    assert buffer.refused[Refusal.STRAY_STAMP] == 1
    assert buffer.clock_jumps == 0


def test_a_clock_that_went_back_starts_the_buffer_anew_without_losing_a_pose():
    buffer = filled(100)
    for k in range(20):
        buffer.append(50 * SECOND + k * SECOND // 10, ('map', 'lidar'), along_x(0.1 * k))
    assert (buffer.clock_jumps, buffer.forgotten) == (1, 100)
    assert buffer.snapshot('a').stamps_ns.tolist() == [
        50 * SECOND + k * SECOND // 10 for k in range(20)]
    assert not any(buffer.refused.values())


@pytest.mark.parametrize('wrong', [3, 150])
def test_wrong_stamps_of_less_than_a_second_forget_nothing(wrong):
    buffer = filled(1000, step_ns=SECOND // 200)
    newest = buffer.span_ns[1]
    for k in range(wrong):
        buffer.append(SECOND + k * SECOND // 200, ('map', 'lidar'), along_x(1.0))
    buffer.append(newest + SECOND // 200, ('map', 'lidar'), along_x(2.0))
    assert len(buffer) == 1001
    assert buffer.refused[Refusal.STRAY_STAMP] == wrong
    assert (buffer.clock_jumps, buffer.forgotten) == (0, 0)


def test_a_clock_that_went_back_and_hardly_moves_is_held_back_within_the_bound():
    buffer = filled(100, BufferLimits(max_poses=100))
    for k in range(100):
        buffer.append(SECOND + k, ('map', 'lidar'), along_x(0.1 * k))
    assert (len(buffer), buffer.clock_jumps, buffer.forgotten) == (100, 1, 100)


def test_a_long_pause_loses_no_pose():
    buffer = filled(10)
    for k in range(5):
        buffer.append(1000 * SECOND + k * SECOND, ('map', 'lidar'), along_x(2.0 + k))
    assert len(buffer) == 15
    assert buffer.clock_jumps == 0


def test_other_frames_are_refused_once_some_are_held():
    buffer = PoseBuffer(BufferLimits())
    buffer.append(99 * SECOND, ('earth', 'lidar'), along_x(0.0))
    for k in range(10):
        buffer.append(100 * SECOND + k, ('map', 'lidar'), along_x(0.1 * k))
    for frames in (('earth', 'lidar'), ('map', 'radar')):
        buffer.append(101 * SECOND, frames, along_x(1.0))
    assert len(buffer) == 10
    assert buffer.frames == ('map', 'lidar')
    assert buffer.refused[Refusal.OTHER_FRAME] == 2


@pytest.mark.parametrize('frames', [('map2', 'lidar'), ('map', 'lidar2')])
def test_other_frames_that_go_on_start_the_buffer_anew_without_losing_a_pose(frames):
    buffer = filled(100)
    newest, generation = buffer.span_ns[1], buffer.generation
    for k in range(1, 21):
        buffer.append(newest + k * SECOND // 10, frames, along_x(0.1 * k))
        # Ten intervals of a tenth of a second are a second.
        assert buffer.frames == (('map', 'lidar') if k < 11 else frames)
        assert buffer.refused[Refusal.OTHER_FRAME] == (k if k < 11 else 0)
    assert (buffer.frame_changes, buffer.forgotten, buffer.clock_jumps) == (1, 100, 0)
    assert buffer.frames_before == ('map', 'lidar')
    assert buffer.generation != generation
    assert buffer.snapshot('a').stamps_ns.tolist() == [
        newest + k * SECOND // 10 for k in range(1, 21)]


def test_wrong_frames_at_the_start_do_not_lock_out_the_drive():
    buffer = PoseBuffer(BufferLimits())
    for k in range(100):
        frames = ('', '') if k < 3 else ('map', 'lidar')
        buffer.append(100 * SECOND + k * SECOND // 10, frames, along_x(0.1 * k))
    assert (len(buffer), buffer.frames) == (97, ('map', 'lidar'))


def test_other_frames_among_the_old_ones_are_refused_however_many():
    buffer = filled(100)
    newest = buffer.span_ns[1]
    for k in range(1, 301):
        frames = ('map', 'lidar') if k % 10 == 0 else ('map2', 'lidar')
        buffer.append(newest + k * SECOND // 10, frames, along_x(0.1 * k))
    assert (len(buffer), buffer.frames, buffer.forgotten) == (130, ('map', 'lidar'), 0)
    assert buffer.refused[Refusal.OTHER_FRAME] == 270


def test_frames_that_change_all_the_time_are_not_believed():
    buffer = filled(100)
    newest = buffer.span_ns[1]
    for k in range(1, 301):
        buffer.append(newest + k * SECOND // 10, (f'map{k % 2}', 'lidar'), along_x(0.1 * k))
    assert (len(buffer), buffer.refused[Refusal.OTHER_FRAME]) == (100, 300)


def test_a_stray_stamp_in_other_frames_does_not_come_along():
    buffer = filled(100)
    for k in range(30):
        if k == 5:
            buffer.append(7, ('map2', 'lidar'), along_x(0.5))
        buffer.append(200 * SECOND + k * SECOND // 10, ('map2', 'lidar'), along_x(0.1 * k))
    assert buffer.span_ns == (200 * SECOND + SECOND // 2, 202 * SECOND + 9 * SECOND // 10)


def test_other_frames_are_believed_at_any_time_and_in_spite_of_repeated_stamps():
    buffer = filled(100)
    for k in range(21):
        for _ in range(2):
            buffer.append(SECOND + k * SECOND // 10, ('map2', 'lidar'), along_x(0.1 * k))
    assert (len(buffer), buffer.clock_jumps, buffer.forgotten) == (21, 0, 100)
    assert buffer.refused[Refusal.OTHER_FRAME] + buffer.refused[Refusal.DUPLICATE] == 21


def test_an_hour_of_standing_still_costs_nothing_and_keeps_the_motion_before_and_after():
    buffer = filled(50)
    stop_ns = buffer.span_ns[1]
    rng = np.random.default_rng(0)
    for k in range(1, 36_001):
        jitter = along_x(4.9 + rng.uniform(-0.004, 0.004), rng.uniform(-1e-3, 1e-3))
        buffer.append(stop_ns + k * SECOND // 10, ('map', 'lidar'), jitter)
    start_ns = buffer.span_ns[1]
    for k in range(1, 51):
        buffer.append(start_ns + k * SECOND // 10, ('map', 'lidar'), along_x(4.9 + 0.1 * k))
    stamps_ns = buffer.snapshot('a').stamps_ns
    # Of the standstill, two seconds at 10 Hz, the last of them its newest pose.
    assert len(stamps_ns) == 50 + 20 + 50
    assert buffer.still == 36_000 - 20
    assert np.diff(stamps_ns)[-50] == SECOND // 10


def test_a_slow_sensor_keeps_the_pose_where_it_stopped():
    buffer = PoseBuffer(BufferLimits())
    for k, x in enumerate([0.0, 1.0, 1.0, 1.0, 1.0, 2.0]):
        buffer.append((1 + 3 * k) * SECOND, ('map', 'lidar'), along_x(x))
    assert buffer.snapshot('a').poses[:, 0].tolist() == [0.0, 1.0, 1.0, 2.0]


def test_distance_zero_keeps_every_pose():
    buffer = PoseBuffer(BufferLimits(still_distance=0.0))
    for k in range(100):
        buffer.append((1 + k) * SECOND, ('map', 'lidar'), along_x(0.0))
    assert len(buffer) == 100


def test_replace_keeps_the_good_poses_in_order():
    buffer = filled(10)
    x = np.arange(8.0)
    poses = np.column_stack([x, np.zeros((8, 5)), np.ones(8)])
    stamps_ns = (np.array([3, 1, 2, 2, 5, 6, 7, 8]) * SECOND)
    poses[4, 1] = np.nan
    poses[5, 6] = 0.5
    buffer.replace(stamps_ns, poses, ('map', ''))
    track = buffer.snapshot('a')
    assert track.stamps_ns.tolist() == [s * SECOND for s in (1, 2, 3, 7, 8)]
    assert track.poses[:, 0].tolist() == [1, 2, 0, 6, 7]
    assert {why: count for why, count in buffer.refused.items() if count} == {
        Refusal.NOT_FINITE: 1, Refusal.NOT_UNIT: 1, Refusal.DUPLICATE: 1}
    assert '3 poses refused' in track.warnings[0]


@pytest.mark.parametrize('standing', [False, True])
@pytest.mark.parametrize('limits', [
    BufferLimits(), BufferLimits(max_age_s=2.0), BufferLimits(max_poses=15),
    BufferLimits(max_age_s=7.0, still_after_s=0.5), BufferLimits(still_distance=0.0)])
def test_a_path_is_bounded_and_thinned_as_its_poses_one_by_one_would_be(limits, standing):
    x = 0.1 * np.arange(200)
    if standing:
        x[50:120], x[170:] = x[50], x[170]
    stamps_ns = 100 * SECOND + np.arange(200) * (SECOND // 10)
    one_by_one, whole = PoseBuffer(limits), PoseBuffer(limits)
    for stamp_ns, at in zip(stamps_ns.tolist(), x.tolist(), strict=True):
        one_by_one.append(stamp_ns, ('map', ''), along_x(at))
    for _ in range(2):
        whole.replace(stamps_ns, np.array([along_x(at) for at in x]), ('map', ''))
    expected, found = one_by_one.snapshot('a'), whole.snapshot('a')
    assert np.array_equal(found.stamps_ns, expected.stamps_ns)
    assert np.array_equal(found.poses, expected.poses)
    assert whole.still == one_by_one.still
    assert found.warnings == expected.warnings == ()


def row(count):
    return np.column_stack([np.arange(float(count)), np.zeros((count, 5)), np.ones(count)])


def test_a_path_without_a_usable_pose_replaces_nothing():
    buffer = PoseBuffer(BufferLimits())
    stamps_ns = np.arange(1, 9) * SECOND
    buffer.replace(stamps_ns, row(8), ('map', ''))
    generation = buffer.generation
    buffer.replace(stamps_ns[:0], row(0), ('map', ''))
    buffer.replace(0 * stamps_ns, row(8), ('other', ''))
    assert (len(buffer), buffer.frames, buffer.generation) == (8, ('map', ''), generation)
    assert buffer.refused[Refusal.EMPTY_PATH] == 2
    assert buffer.refused[Refusal.NO_STAMP] == 8
    buffer.replace(stamps_ns[:5], row(5), ('map', ''))
    assert len(buffer) == 5
    assert buffer.refusals() == '2 messages refused (2 path without a usable pose)'
    buffer.count_unreadable()
    buffer.append(0, ('map', ''), (0, 0, 0, 0, 0, 0, 1))
    assert buffer.refusals() == (
        '1 pose refused (1 no stamp), 3 messages refused (1 unreadable, 2 path without a usable '
        'pose)')


def test_a_path_in_another_frame_is_taken_and_counted():
    buffer = PoseBuffer(BufferLimits())
    for frame in ('map', 'map', 'odom', 'map'):
        buffer.replace(np.arange(1, 9) * SECOND, row(8), (frame, ''))
    assert buffer.frame_changes == 2
    assert buffer.frames == ('map', '')
    buffer.clear()
    assert buffer.frame_changes == 0


@pytest.mark.parametrize('wrong', [1, 2])
def test_a_few_wrong_stamps_do_not_make_a_path_old(wrong):
    buffer = PoseBuffer(BufferLimits())
    stamps_ns = np.arange(1, 9) * SECOND
    stamps_ns[:wrong] += 10**18
    buffer.replace(stamps_ns, row(8), ('map', ''))
    assert len(buffer) == 8 - wrong
    assert buffer.refused[Refusal.STRAY_STAMP] == wrong


def test_headers_without_stamps_are_named():
    buffer = PoseBuffer(BufferLimits())
    for k in range(20):
        buffer.append(0, ('map', 'lidar'), along_x(0.1 * k))
    assert len(buffer) == 0
    assert buffer.refusals() == '20 poses refused (20 no stamp)'
    with pytest.raises(TrajectoryError, match=r'0 poses received.*20 no stamp'):
        buffer.snapshot('a').trajectory()
    buffer.clear()
    buffer.replace(np.array([0, 0, 1, 2]) * SECOND, row(4), ('map', ''))
    assert len(buffer) == 2
    assert buffer.refusals() == '2 poses refused (2 no stamp)'


def test_a_failure_ends_with_what_was_refused():
    session = CalibrationSession(('/a', '/b'), BufferLimits())
    for buffer, start_s, frame, speed in (
            (session.buffers[0], 1, 'lidar', 1.0), (session.buffers[1], 101, 'camera', 1.0),
            (session.buffers[1], 1, 'camera', np.nan)):
        for k in range(20):
            buffer.append((start_s + k) * SECOND, ('map', frame), along_x(speed * k, 0.1 * k))
    job = session.job(CalibrationConfig())
    with pytest.raises(AssociationError, match=r'; camera: 20 poses refused \(20 not finite\)$'):
        job.run()


def test_too_few_poses_say_what_to_do():
    with pytest.raises(TrajectoryError, match='sensor_b: 0 poses received, needed at least 2'):
        PoseBuffer(BufferLimits()).snapshot('sensor_b').trajectory()


def test_a_track_has_the_rotations_that_were_sent():
    buffer = PoseBuffer(BufferLimits())
    for k in range(5):
        buffer.append((1 + k) * SECOND, ('map', 'lidar'), along_x(k, 0.3 * k))
    expected = se3.exp_so3(np.array([[0, 0, 0.3 * k] for k in range(5)]))
    assert np.allclose(buffer.snapshot('a').trajectory().rotations, expected, atol=1e-15)


def test_frame_ids_lose_a_leading_slash_with_a_note():
    buffer = PoseBuffer(BufferLimits())
    for k in range(1, 20):
        # Of the same sender: some drivers write both.
        frames = ('/map', '/lidar') if k % 2 else ('map', 'lidar')
        buffer.append(k * 10**8, frames, (k, 0, 0, 0, 0, 0, 1))
    track = buffer.snapshot('a')
    assert (track.world_frame, track.sensor_frame, len(track.stamps_ns)) == ('map', 'lidar', 19)
    assert track.warnings == (
        'lidar: the leading slash of its frame ids was removed (tf2 refuses it)',)
    (finding,) = track.trajectory().findings
    assert finding.code == 'input-repaired'
    whole = PoseBuffer(BufferLimits())
    whole.replace(track.stamps_ns, track.poses, ('/map', ''))
    assert whole.frames == ('map', '')
