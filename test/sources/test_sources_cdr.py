# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Poses read straight from serialized bytes are those that rosbags wrote."""

from bag_writing import make_track, Messages, ROS1, ROS2
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from trajectory_calibration.sources import cdr

_MESSAGES = Messages()
_NAMES = st.text(st.characters(min_codepoint=1, codec='utf-8'), max_size=20)
_FLOATS = st.floats(width=64, allow_nan=False)
_POSES = st.tuples(*[_FLOATS] * 7)
_STAMPS = st.integers(-2**31 * 10**9, (2**31 - 1) * 10**9)


def _build(msgtype, stamp_ns, pose, frame, child):
    if msgtype == cdr.ODOMETRY:
        return _MESSAGES.odometry(stamp_ns, pose, frame, child)
    if msgtype == cdr.TRANSFORM:
        return _MESSAGES.transform(stamp_ns, pose, frame, child)
    if msgtype == cdr.POSE:
        return _MESSAGES.pose(stamp_ns, pose, frame)
    return _MESSAGES.pose_with_covariance(stamp_ns, pose, frame)


def _serialize(message, *, little_endian=True):
    return bytes(ROS2.serialize_cdr(message, message.__msgtype__, little_endian=little_endian))


def _read(data, msgtype):
    """Return what rosbags reads."""
    message = ROS2.deserialize_cdr(data, msgtype)
    child = getattr(message, 'child_frame_id', '')
    pose = getattr(message, 'transform', None) or message.pose
    pose = getattr(pose, 'pose', pose)
    p, q = getattr(pose, 'translation', None) or pose.position, getattr(
        pose, 'rotation', None) or pose.orientation
    stamp = message.header.stamp
    return (stamp.sec * 10**9 + stamp.nanosec, (message.header.frame_id, child),
            (p.x, p.y, p.z, q.x, q.y, q.z, q.w))


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(cdr.POSE_TYPES), _STAMPS, _POSES, _NAMES, _NAMES, st.integers(0, 3),
       st.booleans())
def test_one_pose(msgtype, stamp_ns, pose, frame, child, padding, little_endian):
    data = _serialize(_build(msgtype, stamp_ns, pose, frame, child), little_endian=little_endian)
    has_child = msgtype in (cdr.ODOMETRY, cdr.TRANSFORM)
    assert cdr.parse_pose(data + bytes(padding), msgtype) == (
        stamp_ns, (frame, child if has_child else ''), pose)


@settings(max_examples=50, deadline=None)
@given(st.sampled_from(cdr.POSE_TYPES), st.data())
def test_a_block_of_mixed_lengths_frames_and_orders_of_bytes(msgtype, data):
    samples = data.draw(st.lists(
        st.tuples(_STAMPS, _POSES, _NAMES, _NAMES, st.booleans()), max_size=12))
    messages = [_serialize(_build(msgtype, *sample), little_endian=little_endian)
                for *sample, little_endian in samples]
    groups, damaged = cdr.parse_poses([*messages, b'damaged'], msgtype)
    assert damaged == 1
    found = {k: (stamp_ns, group.frames, tuple(pose)) for group in groups
             for k, stamp_ns, pose in zip(*group[1:], strict=True)}
    assert sorted(found) == list(range(len(messages)))
    for k, message in enumerate(messages):
        assert found[k] == cdr.parse_pose(message, msgtype) == _read(message, msgtype)


@settings(max_examples=60, deadline=None)
@given(st.lists(_NAMES, max_size=9), _NAMES, st.integers(0, 3), st.booleans())
def test_a_path(names, frame, padding, little_endian):
    stamps_ns, poses = make_track(len(names))
    message = _MESSAGES.path(stamps_ns, poses, frame)
    for pose, name in zip(message.poses, names, strict=True):
        pose.header.frame_id = name
    path = cdr.parse_path(_serialize(message, little_endian=little_endian) + bytes(padding))
    assert path.frames == (frame, '')
    np.testing.assert_array_equal(path.stamps_ns, stamps_ns)
    np.testing.assert_array_equal(path.poses, poses.reshape(-1, 7))


@settings(max_examples=30, deadline=None)
@given(_NAMES, _NAMES, st.integers(0, 9), st.booleans())
def test_a_path_of_one_element_frame(frame, element_frame, count, ros1):
    messages = Messages(ROS1) if ros1 else _MESSAGES
    stamps_ns, poses = make_track(count)
    message = messages.path(stamps_ns, poses, frame, element_frame)
    data = bytes(ROS1.serialize_ros1(message, message.__msgtype__)) if ros1 else (
        _serialize(message))
    path = cdr.parse_path(data, ros1=ros1)
    assert path.frames == (frame, '')
    np.testing.assert_array_equal(path.stamps_ns, stamps_ns)
    np.testing.assert_array_equal(path.poses, poses)


@pytest.mark.parametrize('msgtype', cdr.POSE_TYPES)
def test_every_cut_is_refused(msgtype):
    stamps_ns, poses = make_track(1)
    data = _serialize(_build(msgtype, stamps_ns[0], poses[0], 'map', 'lidar'))
    for end in range(len(data)):
        assert cdr.parse_pose(data[:end], msgtype) is None
        assert cdr.parse_poses([data[:end]], msgtype) == ([], 1)
    assert cdr.parse_pose(data + bytes(4), msgtype) is None


def test_every_cut_of_a_path_is_refused():
    data = _serialize(_MESSAGES.path(*make_track(3)))
    for end in range(len(data)):
        assert cdr.parse_path(data[:end]) is None
    assert cdr.parse_path(data + bytes(4)) is None


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(cdr.TRAJECTORY_TYPES), st.integers(0, 2**31))
def test_flipped_bytes_never_raise_nor_disagree(msgtype, seed):
    rng = np.random.default_rng(seed)
    stamps_ns, poses = make_track(2)
    message = (_MESSAGES.path(stamps_ns, poses) if msgtype == cdr.PATH
               else _build(msgtype, stamps_ns[0], poses[0], 'map', 'lidar'))
    data = bytearray(_serialize(message))
    for position in rng.integers(0, min(len(data), 60), size=2):
        data[position] ^= rng.integers(1, 256)
    data = bytes(data)
    if msgtype == cdr.PATH:
        path = cdr.parse_path(data)
        if path is not None:
            expected = ROS2.deserialize_cdr(data, msgtype)
            assert path.frames == (expected.header.frame_id, '')
            np.testing.assert_array_equal(path.poses[:, 0], [
                item.pose.position.x for item in expected.poses])
            np.testing.assert_array_equal(path.stamps_ns, [
                item.header.stamp.sec * 10**9 + item.header.stamp.nanosec
                for item in expected.poses])
        return
    fast = cdr.parse_pose(data, msgtype)
    if fast is not None:
        assert repr(tuple(fast)) == repr(_read(data, msgtype))


def test_empty_block():
    assert cdr.parse_poses([], cdr.POSE) == ([], 0)
