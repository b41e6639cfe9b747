# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the diagnostics say of an input, second by second."""

import math

from ros_if_any import needs_ros, ros

from trajectory_calibration.online.buffer import BufferLimits, PoseBuffer

pytestmark = needs_ros
if ros is not None:
    from trajectory_calibration.ros import diagnostics, topics

SECOND = 1_000_000_000
OK, WARN = b'\x00', b'\x01'


class Input:
    """A buffer, and the monitor that looks at it each second."""

    def __init__(self):
        self.buffer = PoseBuffer(BufferLimits())
        self.monitor = diagnostics.InputMonitor('a', self.buffer, 0.0)
        self.topic = topics.TopicStatus('Odometry on /a', ready=True)
        self.now_s, self.clock_s = 0, 100
        self.losses = []

    def receive(self, seconds, frame='map', speed=1.0):
        """Take ten poses a second; return the level and the message of the last report."""
        for _ in range(seconds):
            for k in range(10):
                stamp_ns = self.clock_s * SECOND + k * SECOND // 10
                x = speed * stamp_ns * 1e-9
                self.buffer.append(stamp_ns, (frame, 'lidar'), (x, 0, 0, 0, 0, 0, 1))
            self.now_s += 1
            self.clock_s += 1
            self.losses.append(self.monitor.new_loss(self.now_s))
            status = self.monitor.report(self.topic, self.now_s)
        return status.level, status.message


def test_poses_that_are_all_refused_are_a_warning_until_one_is_taken():
    a = Input()
    assert a.receive(10) == (OK, 'Odometry on /a: 10.0 Hz')
    # What replaces the newest pose of a standstill is taken.
    assert a.receive(20, speed=0.0)[0] == OK
    assert a.receive(3, speed=math.nan)[0] == OK
    assert a.receive(10, speed=math.nan) == (
        WARN, 'Odometry on /a: no pose accepted for 12 s: 130 poses refused (130 not finite)')
    # After the pause a new clock goes on for a second before it is believed.
    assert a.receive(2)[0] == OK


def test_a_clock_that_went_back_is_said_once_and_a_warning_for_a_minute():
    a = Input()
    a.receive(20)
    a.clock_s = 50
    level, message = a.receive(30)
    assert level == WARN and 'the stamps went back, 200 poses were dropped' in message
    assert [loss for loss in a.losses if loss] == [message.removeprefix('Odometry on /a: ')]
    assert a.receive(40)[0] == OK
    a.clock_s = 50
    assert a.receive(5)[0] == WARN
    a.buffer.clear()
    assert a.receive(1)[0] == OK


def test_other_frames_are_said_once_with_their_names_and_a_warning_for_a_minute():
    a = Input()
    a.receive(20, frame='')
    level, message = a.receive(30, frame='map2')
    assert level == WARN
    assert message == (
        'Odometry on /a: the frames changed from none and lidar to map2 and lidar, 200 poses were '
        'dropped; unless the sender was restarted, check that only one sensor publishes on the '
        'topic')
    assert [loss for loss in a.losses if loss] == [message.removeprefix('Odometry on /a: ')]
    assert a.receive(40, frame='map2') == (OK, 'Odometry on /a: 10.0 Hz')


def test_as_many_messages_after_a_reset_as_before_are_no_silence():
    a = Input()
    a.receive(1)
    a.buffer.clear()
    assert a.receive(1) == (OK, 'Odometry on /a: 10.0 Hz')
