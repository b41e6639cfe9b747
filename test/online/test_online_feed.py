# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Damaged messages: whatever bytes arrive, they are counted and nothing is raised."""

from functools import lru_cache, partial

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from ros_if_any import needs_ros, ros

from trajectory_calibration.online.buffer import BufferLimits, PoseBuffer, Refusal
from trajectory_calibration.online.feed import feed_message
from trajectory_calibration.online.motion import measure
from trajectory_calibration.sources import cdr

pytestmark = needs_ros

POSES = 8


@lru_cache
def good():
    """Return serialized messages of each type, made where ROS is."""
    stamps_ns, poses, _ = ros.drive(poses=POSES, rate_hz=1.0)
    messages = {
        msgtype: [ros.serialize_message(ros.to_message(
            msgtype.rpartition('/')[2], stamp, pose, 'map', 'lidar'))
            for stamp, pose in zip(stamps_ns, poses, strict=True)]
        for msgtype in cdr.POSE_TYPES}
    return messages | {cdr.PATH: [ros.serialize_message(ros.to_path(stamps_ns, poses))]}


def fed(msgtype, messages):
    buffer = PoseBuffer(BufferLimits())
    feed = partial(feed_message, msgtype, buffer)
    for message in messages:
        feed(message)
    return buffer


@pytest.mark.parametrize('msgtype', cdr.TRAJECTORY_TYPES)
def test_every_truncated_message_is_counted(msgtype):
    message = good()[msgtype][0]
    # What is cut off the end may be no more than padding.
    lengths = [*range(64), *range(64, len(message) - 8, 7)]
    buffer = fed(msgtype, (message[:length] for length in lengths))
    assert buffer.refused[Refusal.UNREADABLE] == buffer.messages == len(lengths)
    assert len(buffer) == 0


@pytest.mark.parametrize('msgtype', cdr.TRAJECTORY_TYPES)
def test_good_messages_go_on_after_a_bad_one(msgtype):
    cut = [message[:50] for message in good()[msgtype]]
    pairs = zip(cut, good()[msgtype], strict=True)
    buffer = fed(msgtype, [item for pair in pairs for item in pair])
    assert len(buffer) == POSES
    assert buffer.refused[Refusal.UNREADABLE] == len(cut)


@settings(max_examples=600, deadline=None)
@given(
    st.sampled_from(cdr.TRAJECTORY_TYPES),
    st.lists(st.tuples(st.integers(0, 100), st.integers(0, 255)), max_size=6),
    st.integers(0, 800))
def test_flipped_and_truncated_bytes_raise_nothing(msgtype, flips, length):
    damaged = []
    for message in good()[msgtype]:
        data = bytearray(message)
        for place, value in flips:
            data[place % len(data)] = value
        damaged.append(bytes(data[:length]))
    buffer = fed(msgtype, [*damaged, *good()[msgtype]])
    assert buffer.messages == 2 * len(damaged)
    # What passed for a pose must not trip what is computed beside the receiving.
    buffer.refusals()
    motion = measure((buffer, buffer), (0, 0))
    assert len(motion) <= 2 * POSES


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(cdr.TRAJECTORY_TYPES), st.binary(max_size=400))
def test_noise_raises_nothing(msgtype, data):
    assert fed(msgtype, [data, b'\x00\x01\x00\x00' + data]).messages == 2


def test_a_wrong_stamp_in_a_path_costs_neither_memory_nor_the_motions_around_it():
    stamps_ns, poses, _ = ros.drive(poses=POSES, rate_hz=1.0)
    stamps_ns[-1] = 2_000_000_000 * 10**9
    message = ros.serialize_message(ros.to_path(stamps_ns, poses))
    buffer = fed(cdr.PATH, [message])
    assert np.ptp(buffer.span_ns) == (POSES - 2) * 10**9
    assert buffer.refused[Refusal.STRAY_STAMP] == 1
    # With an age that reaches so far, it is a pose like any other.
    patient = PoseBuffer(BufferLimits(max_age_s=4e9))
    path = cdr.parse_path(message)
    patient.replace(path.stamps_ns, path.poses, path.frames)
    assert np.ptp(patient.span_ns) > 10**18
    assert len(measure((patient, patient), (0, 0))) == POSES
    assert len(measure((buffer, buffer), (0, 0))) == POSES - 1
