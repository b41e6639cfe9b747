# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What reading bags by our own code gains over rosbags: time a message, and damaged bags.

    python -m benchmarks.bags

Prints a Markdown table. Each container holds one topic of Odometry. Microseconds of processor
time a message: ``BagSource``, to the trajectory; rosbags to the bytes of the message, of which our
struct then reads blocks; rosbags to the message object. Then of ``--damaged`` bags of 50 messages,
with flipped bits, flipped bytes, holes or cuts: how many give two messages or more, by ours and by
rosbags, and in how many rosbags leaves messages out and raises nothing.
"""

import argparse
from collections import Counter
from contextlib import suppress
from pathlib import Path
import tempfile
import time

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

from trajectory_calibration import CalibrationError
from trajectory_calibration.sources import BagSource
from trajectory_calibration.sources.cdr import ODOMETRY, parse_poses

ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)
CONTAINERS = ('mcap', 'sqlite3', 'ros1')
WHOLE = 50
STEP_NS = 10_000_000


def odometry(store, k):
    """Return message k of a drive, serialised."""
    types, ros1 = store.types, store is ROS1
    vector, time_type = types['geometry_msgs/msg/Vector3'], types['builtin_interfaces/msg/Time']
    header = types['std_msgs/msg/Header'](
        **({'seq': k} if ros1 else {}), frame_id='odom',
        stamp=time_type(1_700_000_000 + k // 100, k % 100 * STEP_NS))
    pose = types['geometry_msgs/msg/Pose'](
        types['geometry_msgs/msg/Point'](0.1 * k, np.sin(0.1 * k), 0.0),
        types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0))
    twist = types['geometry_msgs/msg/Twist'](vector(0.0, 0.0, 0.0), vector(0.0, 0.0, 0.0))
    message = types[ODOMETRY](
        header, 'base_link',
        types['geometry_msgs/msg/PoseWithCovariance'](pose, np.zeros(36)),
        types['geometry_msgs/msg/TwistWithCovariance'](twist, np.zeros(36)))
    return bytes((store.serialize_ros1 if ros1 else store.serialize_cdr)(message, ODOMETRY))


def write(folder, container, count):
    """Return a bag of so many messages, and the file that holds them."""
    bag = folder / (f'{container}.bag' if container == 'ros1' else container)
    store = ROS1 if container == 'ros1' else ROS2
    writer = Ros1Writer(bag) if container == 'ros1' else Writer(
        bag, version=9, storage_plugin=StoragePlugin[container.upper()])
    with writer:
        connection = writer.add_connection('/odom', ODOMETRY, typestore=store)
        for k in range(count):
            writer.write(connection, 1_700_000_000 * 10**9 + k * STEP_NS, odometry(store, k))
    return bag, bag if bag.is_file() else next(
        item for item in bag.iterdir() if item.name != 'metadata.yaml')


def by_rosbags(bag, *, objects=False):
    """Yield the poses of each block of bytes, or each message object."""
    with AnyReader([bag], default_typestore=ROS2) as reader:
        block = []
        for connection, _, data in reader.messages():
            if objects:
                yield reader.deserialize(data, connection.msgtype)
                continue
            block.append(data)
            if len(block) == 4096:
                yield parse_poses(block, ODOMETRY, ros1=bag.suffix == '.bag')
                block = []
        if block:
            yield parse_poses(block, ODOMETRY, ros1=bag.suffix == '.bag')


def microseconds(read, count):
    """Return the least processor time a message of three runs."""
    def once():
        start = time.process_time()
        read()
        return 1e6 * (time.process_time() - start) / count
    return min(once() for _ in range(3))


def damaged(data, rng, kind):
    """Return a copy with one kind of damage."""
    result = bytearray(data)
    position = int(rng.integers(len(data)))
    if kind == 0:
        return result[:position]
    if kind == 1:
        end = min(len(data), position + int(rng.integers(1, 4096)))
        result[position:end] = bytes(end - position)
    for where in rng.integers(len(data), size=rng.integers(1, 4)) if kind > 1 else ():
        result[where] ^= 1 << int(rng.integers(8)) if kind == 2 else int(rng.integers(1, 256))
    return result


def survivors(bag, file, count):
    """Return of how many damaged copies ours and rosbags give messages, and who is silent."""
    found = Counter()
    data, rng = file.read_bytes(), np.random.default_rng(11)
    for k in range(count):
        file.write_bytes(damaged(data, rng, k % 4))
        with suppress(CalibrationError):
            found['ours'] += len(BagSource([bag], '/odom').load()) > 1
        read = 0
        # Whatever it raises, what it gave before counts.
        with suppress(Exception):
            for poses, _ in by_rosbags(bag):
                read += sum(len(group.messages) for group in poses)
            found['silent'] += read < WHOLE
        found['rosbags'] += read > 1
    return found


def main(arguments=None):
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--messages', type=int, default=100_000)
    parser.add_argument('--damaged', type=int, default=250)
    options = parser.parse_args(arguments)
    print('| container | ours, us | rosbags and our struct | rosbags, objects | damaged: ours '
          '| rosbags | rosbags, silent |\n|---|---|---|---|---|---|---|')
    for container in CONTAINERS:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name) / 'small'
            folder.mkdir()
            bag, _ = write(Path(name), container, options.messages)
            times = [microseconds(read, options.messages) for read in (
                BagSource([bag], '/odom').load, lambda bag=bag: list(by_rosbags(bag)),
                lambda bag=bag: [None for _ in by_rosbags(bag, objects=True)])]
            found = survivors(
                *write(folder, container, WHOLE), options.damaged)
        print(f'| {container} | {" | ".join(f"{one:.1f}" for one in times)} | '
              f'{found["ours"]} | {found["rosbags"]} | {found["silent"]} |')


if __name__ == '__main__':
    main()
