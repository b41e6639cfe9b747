# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A shift in short: much data, bad messages of every kind, calls in between, nothing lost.

A few seconds of it run always. ``TRAJECTORY_CALIBRATION_SOAK_S=600`` runs ten minutes of replayed
time, as fast as DDS carries them.
"""

import os
from pathlib import Path
import time

import numpy as np
import pytest
from ros_if_any import needs_ros, ros

pytestmark = [needs_ros, pytest.mark.ros]

SECONDS = float(os.environ.get('TRAJECTORY_CALIBRATION_SOAK_S', '15'))
RATE_HZ = 200
FULL_S, CALLS, RESETS = 600.0, 50, 20
BAD_SHARE = 0.01
# Messages under way at once on a topic; the node queues 5000.
WINDOW = 4000
# Messages that are there at a call, which may overtake the others: of less than 1.3 s of this
# drive there is no answer.
ENOUGH = 400
TOPICS = (('trajectory_a', 'map', 'lidar'), ('trajectory_b', 'odom', 'camera'))
KINDS = ('not finite', 'not a unit quaternion', 'duplicate stamp', 'out of order', 'stray stamp',
         'other frame')


def spoilt(kind, stamp_ns, pose, frame, child):
    """Return a bad message of a kind to follow the good one of that stamp."""
    if kind == 'out of order':
        stamp_ns -= 1_000_000_000
    elif kind == 'stray stamp':
        stamp_ns = 1_000_000
    elif kind != 'duplicate stamp':
        stamp_ns += 1
    message = ros.to_message(
        'Odometry', stamp_ns, pose, 'elsewhere' if kind == 'other frame' else frame, child)
    if kind == 'not finite':
        message.pose.pose.position.y = float('nan')
    elif kind == 'not a unit quaternion':
        message.pose.pose.orientation.z += 3.0
    return ros.serialize_message(message)


class Publisher:
    """Publishes one trajectory with bad messages in it, and knows what must arrive."""

    def __init__(self, client, rng, side, poses):
        self.topic, self.frame, self.child = TOPICS[side]
        self._publisher = client.publisher(self.topic)
        self._poses, self._rng = poses, rng
        self._bad = 0
        self.begin()

    def begin(self):
        """Count from here, as the node does after a reset."""
        self.good, self.sent = 0, 0
        self.refused = dict.fromkeys(KINDS, 0)

    def publish(self, stamp_ns, k):
        pose = self._poses[k % len(self._poses)]
        message = ros.to_message('Odometry', stamp_ns, pose, self.frame, self.child)
        self._publisher.publish(ros.serialize_message(message))
        self.good, self.sent = self.good + 1, self.sent + 1
        # The first poses decide the frames.
        if self.good > 5 and self._rng.random() < BAD_SHARE:
            kind = KINDS[self._bad % len(KINDS)]
            self._publisher.publish(spoilt(kind, stamp_ns, pose, self.frame, self.child))
            self.refused[kind] += 1
            self.sent, self._bad = self.sent + 1, self._bad + 1


def counts(client, topic):
    return {kind: int(client.value(topic, f'refused: {kind}')) for kind in KINDS}


def resident_mib(pid):
    pages = Path(f'/proc/{pid}/statm').read_text().split()[1]
    return int(pages) * os.sysconf('SC_PAGE_SIZE') / 2**20


def cpu_s(pid):
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def test_soak(tmp_path):
    rng = np.random.default_rng(11)
    total = round(SECONDS * RATE_HZ)
    calls, resets = (max(2, round(count * SECONDS / FULL_S)) for count in (CALLS, RESETS))
    call_at = set(np.linspace(0, total, calls + 1)[1:].astype(int) - total // calls // 3)
    reset_at = set(np.linspace(0, total, resets + 1)[1:].astype(int))
    _, poses_a, poses_b = ros.drive(poses=20_000, rate_hz=RATE_HZ)
    answers, resident = [], []
    arguments = ('-p', 'solver:=taylor', '-p', 'reference:=B50')
    with ros.running(tmp_path, *arguments) as (node, client):
        publishers = [Publisher(client, rng, side, poses)
                      for side, poses in enumerate((poses_a, poses_b))]

        def arrived():
            return all(client.value(item.topic, 'messages') == str(item.sent)
                       for item in publishers)

        def messages(item):
            return int(client.value(item.topic, 'messages') or 0)

        def window_open():
            return all(item.sent - messages(item) < WINDOW for item in publishers)

        def enough():
            return all(messages(item) >= min(item.sent, ENOUGH) for item in publishers)
        start, cpu = time.monotonic(), cpu_s(node.process.pid)
        for k in range(1, total + 1):
            stamp_ns = 1_000_000_000_000 + k * 1_000_000_000 // RATE_HZ
            for item in publishers:
                item.publish(stamp_ns, k)
            if k % 50 == 0:
                client.executor.spin_once(timeout_sec=0)
                client.wait(window_open, 'the node to keep up')
            if k in call_at:
                client.wait(enough, 'enough motion')
                client.wait(lambda: all(map(ros.Future.done, answers)), 'the last answer')
                answers.append(client.start_call('calibrate'))
            if k in reset_at:
                client.wait(arrived, 'all messages')
                for item in publishers:
                    found = counts(client, item.topic)
                    found['good'] = sum(int(client.value(item.topic, key))
                                        for key in ('poses', 'dropped while still'))
                    assert found == item.refused | {'good': item.good}
                client.wait(lambda: all(map(ros.Future.done, answers)), 'the answers')
                resident.append(resident_mib(node.process.pid))
                if k < total:
                    assert client.call('reset').success
                    for item in publishers:
                        item.begin()
                    client.wait(arrived, 'empty buffers')
        used, elapsed = cpu_s(node.process.pid) - cpu, time.monotonic() - start
        status, _ = node.stop()
        log = node.log
    results = [future.result() for future in answers]
    print(f'{2 * total} good messages in {elapsed:.0f} s, {used / (2 * total) * 1e6:.0f} us of '
          f'CPU each, {len(results)} calls, {len(resident)} resets, resident '
          f'{" ".join(f"{value:.1f}" for value in resident)} MiB')
    assert (status, 'Traceback' in log) == (0, False), log
    assert not [result.message for result in results if not result.success]
    # The first resets are still filling caches.
    settled = resident[len(resident) // 4]
    assert max(resident) <= 1.05 * settled
