# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Chains of transforms: the poses that tf2 would give, and why there are none."""

import numpy as np
import pytest

from trajectory_calibration import ConfigError, TopicError
from trajectory_calibration.data.trajectory import MAX_POSITION
from trajectory_calibration.geometry import se3
from trajectory_calibration.online.buffer import BufferLimits, PoseBuffer, Refusal
from trajectory_calibration.online.feed import feed_track
from trajectory_calibration.sources.topics import transform_track
from trajectory_calibration.sources.transforms import ChainFollower, parse_tf, TransformTree

STEP_NS = 20_000_000


def moving(count, seed, step_ns=STEP_NS, start_ns=0):
    """Return stamps and (count, 7) poses of a smooth random motion."""
    rng = np.random.default_rng(seed)
    phi = np.cumsum(rng.normal(0, 0.01, (count, 3)), axis=0)
    q = se3.rotation_to_quaternion(se3.exp_so3(phi))
    return (start_ns + np.arange(count) * step_ns,
            np.column_stack([np.cumsum(rng.normal(0, 0.05, (count, 3)), axis=0), q]))


def matrix(poses):
    return se3.from_rotation_translation(
        se3.quaternion_to_rotation(poses[:, 3:]), poses[:, :3])


def robot(count=200):
    """Return a tree map -> odom -> base_link -> lidar, and the pose of the lidar in the map."""
    tree = TransformTree()
    stamps_ns, odom = moving(count, 1)
    slow_ns, correction = moving(count // 5 + 1, 2, 5 * STEP_NS)
    mount = np.array([[0.5, 0.0, 1.2, 0.0, 0.0, 0.6, 0.8]])
    tree.extend('/map', 'odom', slow_ns, correction)
    tree.extend('odom', 'base_link', stamps_ns, odom)
    tree.extend('base_link', 'lidar', [0], mount, static=True)
    return tree, stamps_ns, correction, odom, mount


def test_a_chain_is_the_product_of_its_edges_where_the_stamps_coincide():
    tree, stamps_ns, correction, odom, mount = robot()
    found_ns, poses = tree.compose('map', 'lidar')
    np.testing.assert_array_equal(found_ns, stamps_ns)
    expected = matrix(correction[:40]) @ matrix(odom[::5]) @ matrix(mount)
    np.testing.assert_allclose(poses[::5], expected, atol=1e-12)


def test_between_the_stamps_of_an_edge_it_is_interpolated_as_tf2_does():
    tree, _, correction, odom, _ = robot()
    _, poses = tree.compose('map', 'base_link')
    between = poses[2] @ se3.inverse(matrix(odom[2:3]))[0]
    np.testing.assert_allclose(
        between[:3, 3], 0.6 * correction[0, :3] + 0.4 * correction[1, :3], atol=1e-12)
    arc = se3.geodesic(*matrix(correction[:2]), 0.4)
    np.testing.assert_allclose(between[:3, :3], arc[:3, :3], atol=1e-12)


def test_a_chain_may_lead_upwards():
    tree, *_ = robot()
    down_ns, down = tree.compose('map', 'lidar')
    up_ns, up = tree.compose('lidar', 'map')
    np.testing.assert_array_equal(up_ns, down_ns)
    np.testing.assert_allclose(up @ down, np.broadcast_to(np.eye(4), up.shape), atol=1e-12)


def test_a_frame_that_is_published_often_but_hardly_changes_gives_no_stamps():
    tree, stamps_ns, *_ = robot()
    fast_ns = np.arange(0, 4_000_000_000, 5_000_000)
    tree.extend('world', 'map', fast_ns, np.repeat([[0.0, 0, 0, 0, 0, 0, 1]], len(fast_ns), 0))
    found_ns, _ = tree.compose('world', 'base_link')
    np.testing.assert_array_equal(found_ns, stamps_ns)


def test_nothing_is_extrapolated_or_interpolated_across_gaps():
    tree = TransformTree()
    stamps_ns, odom = moving(1000, 1)
    late_ns, correction = moving(200, 2, 5 * STEP_NS, start_ns=100 * STEP_NS)
    keep = (late_ns < 400 * STEP_NS) | (late_ns > 600 * STEP_NS)
    tree.extend('odom', 'base', stamps_ns, odom)
    tree.extend('map', 'odom', late_ns[keep], correction[keep])
    notes = []
    found_ns, _ = tree.compose('map', 'base', notes)
    assert found_ns[0] == late_ns[0]
    assert not ((found_ns > late_ns[keep][59]) & (found_ns < late_ns[keep][60])).any()
    assert len(notes) == 1
    assert 'poses: map -> odom has no transform at their time' in notes[0]


def test_a_restart_keeps_the_longest_part_and_says_so():
    tree = TransformTree()
    stamps_ns, odom = moving(300, 1)
    again = np.concatenate([stamps_ns[:100], stamps_ns])
    moved = odom[:100] + np.array([9.0, 0, 0, 0, 0, 0, 0])
    tree.extend('odom', 'base', again, np.concatenate([moved, odom]))
    notes = []
    found_ns, poses = tree.compose('odom', 'base', notes)
    np.testing.assert_array_equal(found_ns, stamps_ns)
    np.testing.assert_array_equal(poses[:, :3, 3], odom[:, :3])
    assert 'ran backwards 1 time ' in notes[0]
    assert 'kept 300 of 400 transforms' in notes[0]


def test_repeated_and_swapped_stamps_are_put_in_order():
    tree = TransformTree()
    stamps_ns, odom = moving(50, 1)
    order = np.r_[0, 2, 1, 1, 3:50]
    tree.extend('odom', 'base', stamps_ns[order], odom[order])
    found_ns, poses = tree.compose('odom', 'base')
    np.testing.assert_array_equal(found_ns, stamps_ns)
    np.testing.assert_array_equal(poses[:, :3, 3], odom[:, :3])


def test_why_there_is_no_chain():
    tree, *_ = robot()
    tree.extend('earth', 'gps', [0, 1], moving(2, 3)[1])
    with pytest.raises(TopicError, match='no frame nowhere in the transforms; frames: base_link,'):
        tree.chain('map', 'nowhere')
    with pytest.raises(TopicError, match='no transform connects map and gps: there are separate '
                       'trees, of map with base_link, lidar, odom and gps with earth'):
        tree.chain('map', 'gps')
    with pytest.raises(TopicError, match='nothing moves between these frames: base_link -> lidar'):
        tree.compose('base_link', 'lidar')
    with pytest.raises(TopicError, match='are one frame'):
        tree.chain('map', '/map'.strip('/'))
    tree.extend('map', 'base_link', *moving(9, 4))
    with pytest.raises(TopicError, match='two paths from map to lidar: base_link has the parents '
                       'odom and map'):
        tree.chain('map', 'lidar')
    assert len(tree.chain('base_link', 'lidar')) == 1


def test_the_pairs_that_can_serve():
    tree, *_ = robot()
    assert tree.pairs() == [('map', 'odom'), ('map', 'base_link'), ('odom', 'base_link')]


@pytest.mark.parametrize('every', [1, 7, 1000])
def test_a_follower_gives_the_same_while_the_transforms_arrive(every):
    tree, stamps_ns, *_ = robot()
    events = sorted(
        (stamp_ns, edge.parent, edge.child, pose, edge.static)
        for edge in tree.edges for stamp_ns, pose in zip(
            edge.samples[0].tolist(), edge.samples[1].tolist(), strict=True))
    follower = ChainFollower('map', 'lidar')
    parts = []
    for k, (stamp_ns, parent, child, pose, static) in enumerate(events):
        follower.add(parent, child, stamp_ns, pose, static=static)
        if k % every == 0:
            parts.append(follower.take())
    parts.append(follower.take())
    expected_ns, expected = tree.compose('map', 'lidar')
    np.testing.assert_array_equal(np.concatenate([part[0] for part in parts]), expected_ns)
    np.testing.assert_allclose(np.concatenate([part[1] for part in parts]), expected, atol=1e-12)
    assert sum(len(edge.samples[0]) for edge in follower._tree.edges) < 40
    assert len(expected_ns) == len(stamps_ns)


def test_a_follower_interpolates_no_gap_either():
    tree = TransformTree()
    stamps_ns, odom = moving(1000, 1)
    late_ns, correction = moving(200, 2, 5 * STEP_NS)
    keep = (late_ns < 400 * STEP_NS) | (late_ns > 600 * STEP_NS)
    tree.extend('odom', 'base', stamps_ns, odom)
    tree.extend('map', 'odom', late_ns[keep], correction[keep])
    follower = ChainFollower('map', 'base')
    found, said = [], set()
    for stamp_ns, parent, child, pose in sorted(
            (stamp_ns, edge.parent, edge.child, pose) for edge in tree.edges
            for stamp_ns, pose in zip(edge.samples[0].tolist(), edge.samples[1].tolist(),
                                      strict=True)):
        follower.add(parent, child, stamp_ns, pose)
        found += follower.take()[0].tolist()
        said.add(follower.waiting_for)
    assert found == tree.compose('map', 'base')[0].tolist()
    assert 'map -> odom is silent: does its sender run?' in said
    assert follower.waiting_for == ''


def test_a_follower_says_what_it_waits_for():
    follower = ChainFollower('map', 'base')
    assert 'is /tf published?' in follower.waiting_for
    follower.add('odom', 'base', 0, (0, 0, 0, 0, 0, 0, 1))
    assert len(follower.take()[0]) == 0
    assert follower.waiting_for == 'no frame map in the transforms; frames: base, odom'


def drive_past(follower, buffer, tree, *, shift=0.0):
    """Play all transforms of a tree in the order of time, as a bag does; take as the node does."""
    events = sorted(
        (stamp_ns, edge.parent, edge.child, pose, edge.static)
        for edge in tree.edges for stamp_ns, pose in zip(
            edge.samples[0].tolist(), edge.samples[1].tolist(), strict=True))
    for k, (stamp_ns, parent, child, pose, static) in enumerate(events):
        moved = pose if static else [pose[0] + shift, *pose[1:]]
        follower.add(parent, child, stamp_ns, moved, static=static)
        if k % 10 == 0 or k == len(events) - 1:
            stamps_ns, poses, _ = follower.take()
            rows = np.column_stack([poses[:, :3, 3],
                                    se3.rotation_to_quaternion(poses[:, :3, :3])])
            for at_ns, row in zip(stamps_ns.tolist(), rows.tolist(), strict=True):
                buffer.append(at_ns + 1, ('map', 'lidar'), tuple(row))


def test_a_bag_that_loops_restarts_the_buffer():
    tree, *_ = robot(count=400)
    follower, buffer = ChainFollower('map', 'lidar'), PoseBuffer(BufferLimits())
    drive_past(follower, buffer, tree)
    first = buffer.snapshot('lidar')
    drive_past(follower, buffer, tree, shift=0.5)
    again = buffer.snapshot('lidar')
    assert follower.waiting_for == ''
    assert (buffer.clock_jumps, buffer.forgotten) == (1, 400)
    # Of the second pass alone: nothing is interpolated between the passes.
    np.testing.assert_array_equal(again.stamps_ns, first.stamps_ns)
    apart = again.poses[:, :3] - first.poses[:, :3]
    alone = PoseBuffer(BufferLimits())
    drive_past(ChainFollower('map', 'lidar'), alone, tree, shift=0.5)
    np.testing.assert_array_equal(again.poses, alone.snapshot('lidar').poses)
    assert (np.linalg.norm(apart, axis=1) > 0.4).all()


def test_a_static_transform_survives_a_restart_that_does_not_repeat_it():
    tree, *_ = robot(count=400)
    follower, buffer = ChainFollower('map', 'lidar'), PoseBuffer(BufferLimits())
    drive_past(follower, buffer, tree)
    moving_only = TransformTree()
    for edge in tree.edges[:2]:
        moving_only.extend(edge.parent, edge.child, *edge.samples)
    drive_past(follower, buffer, moving_only)
    assert (buffer.clock_jumps, len(buffer)) == (1, 400)


def test_a_stray_stamp_costs_a_few_poses_only():
    tree, stamps_ns, *_ = robot(count=400)
    follower, buffer = ChainFollower('map', 'lidar'), PoseBuffer(BufferLimits())
    half = TransformTree(), TransformTree()
    for edge in tree.edges:
        early = edge.samples[0] < 200 * STEP_NS
        for part, keep in zip(half, (early, ~early | edge.static), strict=True):
            part.extend(edge.parent, edge.child, edge.samples[0][keep], edge.samples[1][keep],
                        static=edge.static)
    drive_past(follower, buffer, half[0])
    follower.add('odom', 'base_link', 86_400 * 10**9, (0, 0, 0, 0, 0, 0, 1))
    drive_past(follower, buffer, half[1])
    assert buffer.clock_jumps == 0
    assert len(stamps_ns) - 12 < len(buffer) < len(stamps_ns)


def test_a_reset_forgets_what_has_not_come_out_yet():
    follower = ChainFollower('map', 'base')
    stamps_ns, odom = moving(50, 1)
    for stamp_ns, pose in zip(stamps_ns.tolist(), odom, strict=True):
        follower.add('odom', 'base', stamp_ns, pose)
    follower.restart()
    follower.add('map', 'odom', 0, (0, 0, 0, 0, 0, 0, 1), static=True)
    follower.add('odom', 'base', int(stamps_ns[-1]) + STEP_NS, odom[0])
    assert len(follower.take()[0]) == 0


def held(follower):
    """Return how many transforms a follower holds, those that wait among them."""
    return sum(len(edge.samples[0]) + len(edge.pending) for edge in follower._tree.edges)


@pytest.mark.parametrize('parent, child', [('map', 'base'), ('map', 'odom'), ('map', 'tool')])
def test_without_a_pose_no_more_than_a_minute_is_kept(parent, child):
    # Of a chain that is not known, of one that is, and where nothing is taken out.
    follower = ChainFollower(parent, child)
    pose = (0.0, 0, 0, 0, 0, 0, 1)
    follower.add('map', 'odom', 0, pose)
    for k in range(100_000):
        follower.add('arm', 'tool', k * STEP_NS, pose)
        if child != 'tool' and k % 50 == 0:
            assert len(follower.take()[0]) == 0
    assert held(follower) < (10 if child == 'odom' else 5000)


def test_a_frame_for_each_object_that_is_tracked_takes_neither_memory_nor_time():
    # An hour with a new object a second; the chain is found after a minute.
    follower = ChainFollower('map', 'base')
    pose = (0.0, 0, 0, 0, 0, 0, 1)
    poses, most = 0, 0
    for k in range(3600):
        at_ns = k * 10**9
        follower.add('map', f'track_{k}', at_ns, pose)
        follower.add('map', 'odom', at_ns, (k, 0, 0, 0, 0, 0, 1))
        if k > 60:
            follower.add('odom', 'base', at_ns, (0, k, 0, 0, 0, 0, 1))
        poses += len(follower.take()[0])
        most = max(most, len(follower._tree.edges))
    assert poses > 3500
    assert most < 70
    assert [str(edge) for edge in follower._tree.edges] == ['map -> odom', 'odom -> base']
    # Where there is no chain, they are bounded.
    other = ChainFollower('map', 'nowhere')
    for k in range(3000):
        other.add('map', f'track_{k}', k * 10**9, pose)
        if k % 10 == 0:
            other.take()
    assert len(other._tree.edges) < 1010


def test_a_second_parent_is_found_and_its_clock_forgets_nothing():
    tree, *_ = robot()
    follower = ChainFollower('map', 'lidar')
    drive_past(follower, PoseBuffer(BufferLimits()), tree)
    follower.add('elsewhere', 'base_link', 10 * 10**9, (0, 0, 0, 0, 0, 0, 1))
    follower.add('elsewhere', 'base_link', 0, (0, 0, 0, 0, 0, 0, 1))
    assert follower.take()[0].size == 0 and follower.waiting_for == ''
    follower.add('map', 'base_link', 0, (0, 0, 0, 0, 0, 0, 1))
    follower.take()
    assert 'two paths from map to lidar' in follower.waiting_for


def test_stamps_that_hardly_advance_and_static_transforms_take_no_memory():
    follower = ChainFollower('map', 'base')
    pose = (0.0, 0, 0, 0, 0, 0, 1)
    for k in range(100_000):
        follower.add('map', 'odom', k, pose)
        follower.add('odom', 'base', k, pose, static=True)
    assert held(follower) < 63_000
    assert len(follower.take()[0]) == 0
    assert follower.waiting_for.startswith('nothing moves between these frames: map -> odom, ')


BAD = [(np.nan, 0, 0, 0, 0, 0, 1), (0, 0, 0, 0, 0, 0, 1.5), (2 * MAX_POSITION, 0, 0, 0, 0, 0, 1)]


def with_faults():
    """Return the robot with one transform of each fault on the chain, and one beside it."""
    tree, *_ = robot()
    for k, pose in enumerate(BAD):
        tree.extend('odom', 'base_link', [STEP_NS * (30 + k) + 1], [pose])
    tree.extend('base_link', 'gps', [0], BAD[:1], static=True)
    return tree


def test_refused_transforms_are_counted_while_they_arrive():
    tree, *_ = robot()
    follower = ChainFollower('map', 'lidar')
    for edge in tree.edges:
        for stamp_ns, pose in zip(edge.samples[0].tolist(), edge.samples[1], strict=True):
            follower.add(edge.parent, edge.child, stamp_ns, pose, static=edge.static)
    for k, pose in enumerate(BAD):
        follower.add('odom', 'base_link', STEP_NS * 199 + 1 + k, pose)
    follower.add('base_link', 'gps', 0, BAD[0], static=True)
    stamps_ns, _, refused = follower.take()
    assert (len(stamps_ns), refused.tolist()) == (200, [1, 1, 1])
    assert follower.take()[2].tolist() == [0, 0, 0]


def test_refused_transforms_of_a_bag_are_in_the_warnings_and_in_the_buffer():
    track = transform_track('tf:map.lidar', with_faults(), [])
    assert track.refused == (1, 1, 1)
    words = ('lidar: tf:map.lidar: dropped 3 transforms: 1 not finite, 1 quaternion not of unit '
             'length, 1 more than 1e+09 m away along an axis')
    assert words in track.to_trajectory().warnings
    buffer = PoseBuffer(BufferLimits())
    feed_track(track, buffer)
    assert [buffer.refused[why] for why in (
        Refusal.NOT_FINITE, Refusal.NOT_UNIT, Refusal.TOO_FAR)] == [1, 1, 1]


def test_an_edge_of_which_nothing_can_be_used_is_named():
    tree, *_ = robot()
    tree.extend('lidar', 'lens', [0], BAD[:1], static=True)
    with pytest.raises(TopicError, match=r'lidar -> lens has no usable transform \(1 not finite'):
        tree.compose('map', 'lens')
    follower = ChainFollower('lidar', 'lens')
    follower.add('lidar', 'lens', 0, BAD[0])
    assert follower.take()[2].tolist() == [1, 0, 0]
    assert 'no usable transform' in follower.waiting_for


@pytest.mark.parametrize(('name', 'frames', 'expected'), [
    ('tf:map.base_link', (), ('map', 'base_link')),
    ('tf:/map./base_link', (), ('map', 'base_link')),
    ('/tf:map.base_link', (), ('map', 'base_link')),
    ('tf:map.camera.left', ('map', 'camera.left'), ('map', 'camera.left')),
])
def test_names_of_pairs(name, frames, expected):
    assert parse_tf(name, frames) == expected


@pytest.mark.parametrize('name', ['tf:map', 'tf:', 'tf:.base', 'tf:map.', 'tf:a.b.c'])
def test_names_that_are_no_pair(name):
    with pytest.raises(ConfigError, match='does not name two frames; needed tf:PARENT'):
        parse_tf(name)
