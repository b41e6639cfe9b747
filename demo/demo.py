# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The whole job on simulated data: a bag, the node over DDS, the offline tool, and the truth.

Exit status 0: the node and the offline tool agree with each other and with the truth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
import json
import os
from pathlib import Path
import random
import shutil
import subprocess
import sys
import textwrap
import time

import numpy as np

from trajectory_calibration.assessment.metrics import absolute_errors
from trajectory_calibration.geometry import se3
from trajectory_calibration.simulation import SCENARIOS, simulate
from trajectory_calibration.simulation.files import write_bag, write_transform

SCENARIO = 'offroad'
SEED = 1
SPEED = 30.0
TOPICS = ('/lidar_slam/odometry', '/visual_slam/odometry')

# What the answers must keep to. The node and the offline tool see the same poses.
MAX_DIFFERENCE = 1e-6
MAX_ERROR_M = 0.05
MAX_ERROR_DEG = 0.5

LIMIT_S = 60.0
FOLDER = Path(__file__).resolve().parents[1] / '.demo'


class DemoError(Exception):
    """A step that did not happen."""


@dataclass(frozen=True)
class Answer:
    """An extrinsic: (3,) metres and (4,) quaternion x, y, z, w."""

    translation: np.ndarray
    rotation_xyzw: np.ndarray

    @property
    def matrix(self) -> np.ndarray:
        """Return the (4, 4) pose of b in a."""
        return se3.from_rotation_translation(
            se3.quaternion_to_rotation(self.rotation_xyzw), self.translation)

    def difference(self, other: Answer) -> float:
        """Return the largest difference of a number of the two poses."""
        return float(np.abs(self.matrix - other.matrix).max())


def main() -> int:
    """Run the demo."""
    shutil.rmtree(FOLDER, ignore_errors=True)
    FOLDER.mkdir()
    # Alone on this machine, whatever else runs on it; read when ROS is imported and started.
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ['ROS_DOMAIN_ID'] = str(random.randint(1, 101))
    os.environ['ROS_LOG_DIR'] = str(FOLDER / 'log')
    try:
        truth = make_bag()
        with running_node() as node:
            online = calibrate_online(node)
        offline = calibrate_offline()
    except DemoError as error:
        print(f'error: {error}', file=sys.stderr)
        return 1
    return compare(truth, online, offline)


def make_bag() -> Answer:
    """Simulate the drive, write it as a bag, and return the truth."""
    pair = simulate(SCENARIOS[SCENARIO], SEED)
    write_bag(FOLDER / 'bag', dict(zip(TOPICS, (pair.a, pair.b), strict=True)), storage='mcap')
    write_transform(FOLDER / 'truth.tum', pair.T_a_b)
    metres = np.linalg.norm(np.diff(pair.a.positions, axis=0), axis=1).sum()
    print(f'1. simulated a drive of {pair.a.duration_s:.0f} s and {metres:.0f} m over hills')
    for topic, trajectory in zip(TOPICS, (pair.a, pair.b), strict=True):
        print(f'   {topic}: {len(trajectory)} poses of {trajectory.sensor_frame}, noisy, drifting')
    print(f'   written as a rosbag2: {shown(FOLDER / "bag")}')
    return Answer(pair.T_a_b[:3, 3], se3.rotation_to_quaternion(pair.T_a_b[:3, :3]))


@contextmanager
def running_node() -> Iterator[subprocess.Popen]:
    """Run the real node in a process of its own; its output goes to a file."""
    executable = shutil.which('calibration_node', path=str(Path(sys.executable).parent))
    if executable is None:
        raise DemoError('calibration_node is not installed beside this Python; run make demo')
    log = FOLDER / 'node.log'
    with log.open('w') as stream:
        node = subprocess.Popen(
            [executable, '--ros-args', '-p', f'topic_a:={TOPICS[0]}', '-p',
             f'topic_b:={TOPICS[1]}'], stdout=stream, stderr=subprocess.STDOUT)
    print(f'2. started calibration_node, process {node.pid}')
    try:
        yield node
    except DemoError as error:
        raise DemoError(f'{error}; the node said:\n{log.read_text()}') from error
    finally:
        node.terminate()
        try:
            status = node.wait(timeout=10)
        except subprocess.TimeoutExpired:
            node.kill()
            status = node.wait()
    if status:
        raise DemoError(f'the node ended with status {status}, needed 0; see {shown(log)}')


def calibrate_online(node: subprocess.Popen) -> Answer:
    """Replay the bag to the node, ask it to calibrate, and receive what it latched."""
    # ROS loads here because it reads the environment that main() sets.
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import TransformStamped
    from nav_msgs.msg import Odometry
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from std_srvs.srv import Trigger

    rclpy.init()
    client = rclpy.create_node('demo')
    executor = SingleThreadedExecutor()
    executor.add_node(client)
    held: dict[str, int] = {}
    received: list[TransformStamped] = []

    def on_diagnostics(message: DiagnosticArray) -> None:
        for status in message.status:
            for value in status.values:
                if value.key == 'messages':
                    held[status.name] = int(value.value)

    def wait(condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + LIMIT_S
        while not condition():
            if node.poll() is not None:
                raise DemoError(f'the node ended with status {node.returncode}')
            if time.monotonic() > deadline:
                raise DemoError(f'waited {LIMIT_S:.0f} s for {what}')
            executor.spin_once(timeout_sec=0.1)

    try:
        publishers = {topic: client.create_publisher(Odometry, topic, 5000) for topic in TOPICS}
        client.create_subscription(DiagnosticArray, '/diagnostics', on_diagnostics, 10)
        service = client.create_client(Trigger, '/trajectory_calibration/calibrate')
        wait(lambda: service.service_is_ready() and all(
            publisher.get_subscription_count() for publisher in publishers.values()),
            'the node to subscribe')
        sent = replay(publishers)
        wait(lambda: sum(held.values()) >= sent, f'the node to hold {sent} messages')
        call = service.call_async(Trigger.Request())
        wait(call.done, 'an answer of ~/calibrate')
        if not call.result().success:
            raise DemoError(f'~/calibrate failed: {call.result().message}')
        print('3. called /trajectory_calibration/calibrate; it answered:')
        text, _, machine = call.result().message.rpartition('\n')
        print(textwrap.indent(f'{text}\n{machine[:72]} ...', '   '))
        # Subscribed only now: the extrinsic is latched.
        client.create_subscription(
            TransformStamped, '/trajectory_calibration/extrinsic', received.append,
            QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        wait(lambda: bool(received), 'the latched extrinsic')
    finally:
        executor.shutdown()
        client.destroy_node()
        rclpy.try_shutdown()
    header, transform = received[0].header, received[0].transform
    print(f'   received from /trajectory_calibration/extrinsic: {header.frame_id} -> '
          f'{received[0].child_frame_id}')
    t, q = transform.translation, transform.rotation
    return Answer(np.array([t.x, t.y, t.z]), np.array([q.x, q.y, q.z, q.w]))


def replay(publishers: dict) -> int:
    """Publish the bag's messages as they are, faster than real time; return their number."""
    from rosbags.highlevel import AnyReader
    count = 0
    started = time.monotonic()
    with AnyReader([FOLDER / 'bag']) as reader:
        first = reader.start_time
        for connection, stamp, data in reader.messages():
            early = (stamp - first) * 1e-9 / SPEED - (time.monotonic() - started)
            if early > 0:
                time.sleep(early)
            publishers[connection.topic].publish(data)
            count += 1
        seconds = (reader.end_time - first) * 1e-9
    took = time.monotonic() - started
    print(f'   replayed {count} messages over DDS in {took:.1f} s, {seconds / took:.0f} times '
          'as fast as they were recorded')
    return count


def calibrate_offline() -> Answer:
    """Run the offline tool on the same bag."""
    arguments = ['calibrate', *TOPICS, '--bag', str(FOLDER / 'bag'), '--ground-truth',
                 str(FOLDER / 'truth.tum')]
    print(f'4. ran: trajectory_calibration {" ".join(map(shown, arguments))}')
    done = subprocess.run(
        [sys.executable, '-m', 'trajectory_calibration', *arguments, '--format', 'json'],
        capture_output=True, text=True, check=False)
    if done.returncode:
        raise DemoError(f'the offline tool ended with {done.returncode}: {done.stderr.strip()}')
    pose = json.loads(done.stdout)['T_a_b']
    return Answer(np.array(pose['translation']), np.array(pose['rotation_xyzw']))


def compare(truth: Answer, online: Answer, offline: Answer) -> int:
    """Print the three answers and judge them; return the exit status."""
    print('\nPose of camera in lidar')
    print(f'{"":10}{"x":>9}{"y":>9}{"z":>9} m{"qx":>10}{"qy":>9}{"qz":>9}{"qw":>9}'
          f'{"error":>12}')
    right = True
    for name, answer in (('truth', truth), ('node', online), ('offline', offline)):
        errors = absolute_errors(answer.matrix, truth.matrix)
        degrees = float(np.rad2deg(errors.e_aR))
        right &= errors.e_at <= MAX_ERROR_M and degrees <= MAX_ERROR_DEG
        shown_error = '' if answer is truth else f'{1e3 * errors.e_at:8.1f} mm {degrees:6.3f} deg'
        print(f'{name:10}{"".join(f"{x:9.4f}" for x in answer.translation)}  '
              f' {"".join(f"{x:9.4f}" for x in answer.rotation_xyzw)}{shown_error}')
    difference = online.difference(offline)
    print(f'\nnode and offline tool differ by {difference:.1g}, needed at most {MAX_DIFFERENCE:g}')
    print(f'errors needed at most {1e3 * MAX_ERROR_M:g} mm and {MAX_ERROR_DEG:g} deg')
    right &= difference <= MAX_DIFFERENCE
    print('the demo succeeded' if right else 'error: the demo FAILED')
    return 0 if right else 1


def shown(path: Path | str) -> str:
    """Return a path as seen from the folder of the project."""
    return str(path).replace(f'{FOLDER.parent}/', '')


if __name__ == '__main__':
    sys.exit(main())
