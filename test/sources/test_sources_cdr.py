# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Poses read straight from CDR bytes are exactly those of the general deserialiser."""

from bag_writing import make_track, Messages, ROS2
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from trajectory_calibration.sources import cdr
from trajectory_calibration.sources.deserialise import Deserialiser

_MESSAGES = Messages()
_GENERAL = Deserialiser(ros1=False)
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


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(cdr.POSE_TYPES), _STAMPS, _POSES, _NAMES, _NAMES, st.integers(0, 3))
def test_one_pose(msgtype, stamp_ns, pose, frame, child, padding):
    data = _serialize(_build(msgtype, stamp_ns, pose, frame, child)) + bytes(padding)
    fast = cdr.parse_pose(data, msgtype)
    assert fast == _GENERAL.pose(data, msgtype)
    has_child = msgtype in (cdr.ODOMETRY, cdr.TRANSFORM)
    assert fast == (stamp_ns, (frame, child if has_child else ''), pose)


@settings(max_examples=50, deadline=None)
@given(st.sampled_from(cdr.POSE_TYPES), st.data())
def test_a_block_of_mixed_lengths_and_frames(msgtype, data):
    samples = data.draw(st.lists(st.tuples(_STAMPS, _POSES, _NAMES, _NAMES), max_size=12))
    messages = [_serialize(_build(msgtype, *sample)) for sample in samples]
    block = cdr.parse_poses(messages, msgtype)
    assert len(block.frame_index) == len(messages)
    for k, message in enumerate(messages):
        expected = _GENERAL.pose(message, msgtype)
        if block.frame_index[k] < 0:
            # More pairs of frames of one length than the block follows.
            assert len(messages) > 8
            continue
        assert block.frames[block.frame_index[k]] == expected.frames
        assert block.stamps_ns[k] == expected.stamp_ns
        assert tuple(block.poses[k]) == expected.pose


@settings(max_examples=60, deadline=None)
@given(_NAMES, _NAMES, st.integers(0, 9), st.integers(0, 3))
def test_a_path(frame, element_frame, count, padding):
    stamps_ns, poses = make_track(count)
    data = _serialize(_MESSAGES.path(stamps_ns, poses, frame, element_frame)) + bytes(padding)
    for path in (cdr.parse_path(data), _GENERAL.path(data)):
        assert path.frame == frame
        np.testing.assert_array_equal(path.stamps_ns, stamps_ns)
        np.testing.assert_array_equal(path.poses, poses)


def test_a_path_of_several_element_frames_is_left_to_the_general_way():
    stamps_ns, poses = make_track(3)
    message = _MESSAGES.path(stamps_ns, poses)
    message.poses[1].header.frame_id = 'odd'
    assert cdr.parse_path(_serialize(message)) is None
    message.poses[1].header.frame_id = 'longer than map'
    assert cdr.parse_path(_serialize(message)) is None
    np.testing.assert_array_equal(_GENERAL.path(_serialize(message)).poses, poses)


@pytest.mark.parametrize('msgtype', cdr.POSE_TYPES)
def test_big_endian_is_left_to_the_general_way(msgtype):
    stamps_ns, poses = make_track(2)
    data = _serialize(_build(msgtype, stamps_ns[1], poses[1], 'map', 'x'), little_endian=False)
    assert cdr.parse_pose(data, msgtype) is None
    assert cdr.parse_poses([data], msgtype).frame_index.tolist() == [-1]
    assert _GENERAL.pose(data, msgtype).pose == tuple(poses[1])


@pytest.mark.parametrize('msgtype', cdr.POSE_TYPES)
def test_every_cut_is_refused(msgtype):
    stamps_ns, poses = make_track(1)
    data = _serialize(_build(msgtype, stamps_ns[0], poses[0], 'map', 'lidar'))
    for end in range(len(data)):
        assert cdr.parse_pose(data[:end], msgtype) is None
        assert _GENERAL.pose(data[:end], msgtype) is None
    assert cdr.parse_pose(data + bytes(4), msgtype) is None


def test_every_cut_of_a_path_is_refused():
    data = _serialize(_MESSAGES.path(*make_track(3)))
    for end in range(len(data)):
        assert cdr.parse_path(data[:end]) is None
        assert _GENERAL.path(data[:end]) is None


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
        fast, general = cdr.parse_path(data), _GENERAL.path(data)
        if fast is not None:
            assert fast.frame == general.frame
            np.testing.assert_array_equal(fast.stamps_ns, general.stamps_ns)
            np.testing.assert_array_equal(fast.poses, general.poses)
        return
    fast = cdr.parse_pose(data, msgtype)
    if fast is not None:
        assert repr(fast) == repr(_GENERAL.pose(data, msgtype))


def test_empty_block():
    block = cdr.parse_poses([], cdr.POSE)
    assert block.poses.shape == (0, 7)
    assert block.frames == []
