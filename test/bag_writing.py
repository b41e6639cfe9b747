# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Real bags for tests, written with rosbags."""

from pathlib import Path
import struct
from zlib import crc32

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_JAZZY)
ROS1.register(get_types_from_msg(
    'geometry_msgs/TransformStamped[] transforms', 'tf2_msgs/msg/TFMessage'))


def make_track(count=50, seed=1):
    """Return stamps in nanoseconds and (count, 7) poses."""
    rng = np.random.default_rng(seed)
    stamps_ns = 1_700_000_000_123_456_789 + np.arange(count) * 100_000_007
    quaternions = rng.normal(size=(count, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1)[:, None]
    return stamps_ns, np.column_stack([rng.normal(size=(count, 3)) * 10, quaternions])


class Messages:
    """Builds messages of one ROS generation."""

    def __init__(self, store=ROS2):
        self.store = store

    def type(self, name):
        return self.store.types[name]

    def header(self, stamp_ns, frame_id):
        stamp = self.type('builtin_interfaces/msg/Time')(
            sec=int(stamp_ns) // 10**9, nanosec=int(stamp_ns) % 10**9)
        header = self.type('std_msgs/msg/Header')
        if self.store is ROS1:
            return header(seq=0, stamp=stamp, frame_id=frame_id)
        return header(stamp=stamp, frame_id=frame_id)

    def plain_pose(self, pose):
        x, y, z, qx, qy, qz, qw = map(float, pose)
        return self.type('geometry_msgs/msg/Pose')(
            position=self.type('geometry_msgs/msg/Point')(x=x, y=y, z=z),
            orientation=self.type('geometry_msgs/msg/Quaternion')(x=qx, y=qy, z=qz, w=qw))

    def with_covariance(self, pose):
        return self.type('geometry_msgs/msg/PoseWithCovariance')(
            pose=self.plain_pose(pose), covariance=np.arange(36.0))

    def odometry(self, stamp_ns, pose, frame_id='map', child_frame_id='lidar'):
        vector = self.type('geometry_msgs/msg/Vector3')(x=1.0, y=2.0, z=3.0)
        twist = self.type('geometry_msgs/msg/TwistWithCovariance')(
            twist=self.type('geometry_msgs/msg/Twist')(linear=vector, angular=vector),
            covariance=np.arange(36.0))
        return self.type('nav_msgs/msg/Odometry')(
            header=self.header(stamp_ns, frame_id), child_frame_id=child_frame_id,
            pose=self.with_covariance(pose), twist=twist)

    def pose(self, stamp_ns, pose, frame_id='map'):
        return self.type('geometry_msgs/msg/PoseStamped')(
            header=self.header(stamp_ns, frame_id), pose=self.plain_pose(pose))

    def pose_with_covariance(self, stamp_ns, pose, frame_id='map'):
        return self.type('geometry_msgs/msg/PoseWithCovarianceStamped')(
            header=self.header(stamp_ns, frame_id), pose=self.with_covariance(pose))

    def transform(self, stamp_ns, pose, frame_id='map', child_frame_id='lidar'):
        x, y, z, qx, qy, qz, qw = map(float, pose)
        return self.type('geometry_msgs/msg/TransformStamped')(
            header=self.header(stamp_ns, frame_id), child_frame_id=child_frame_id,
            transform=self.type('geometry_msgs/msg/Transform')(
                translation=self.type('geometry_msgs/msg/Vector3')(x=x, y=y, z=z),
                rotation=self.type('geometry_msgs/msg/Quaternion')(x=qx, y=qy, z=qz, w=qw)))

    def tf(self, *transforms):
        """Return a TFMessage of (stamp, pose, parent, child)."""
        return self.type('tf2_msgs/msg/TFMessage')(
            transforms=[self.transform(*transform) for transform in transforms])

    def path(self, stamps_ns, poses, frame_id='map', element_frame='map'):
        return self.type('nav_msgs/msg/Path')(
            header=self.header(stamps_ns[-1] if len(stamps_ns) else 0, frame_id),
            poses=[self.pose(stamp, pose, element_frame)
                   for stamp, pose in zip(stamps_ns, poses, strict=True)])

    def text(self, words):
        return self.type('std_msgs/msg/String')(data=words)


class BagFile:
    """A writer of one bag: ``add`` messages, then leave the ``with`` block."""

    def __init__(self, path, storage='mcap'):
        self.path = Path(path)
        self.ros1 = storage.startswith('ros1')
        self.messages = Messages(ROS1 if self.ros1 else ROS2)
        if self.ros1:
            self.writer = rosbag1.Writer(self.path)
            if storage == 'ros1 bz2':
                self.writer.set_compression(rosbag1.Writer.CompressionFormat.BZ2)
        else:
            plugin = StoragePlugin.SQLITE3 if 'sqlite3' in storage else StoragePlugin.MCAP
            self.writer = rosbag2.Writer(self.path, version=9, storage_plugin=plugin)
            if storage == 'mcap zstd':
                self.writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            elif storage == 'sqlite3 message':
                self.writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
            elif storage == 'sqlite3 file':
                self.writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
        self.connections = {}

    def __enter__(self):
        self.writer.open()
        return self

    def __exit__(self, *error):
        self.writer.close()

    def add(self, topic, message, received_ns):
        store = self.messages.store
        msgtype = message.__msgtype__
        serialize = store.serialize_ros1 if self.ros1 else store.serialize_cdr
        self.add_raw(topic, msgtype, serialize(message, msgtype), received_ns)

    def add_raw(self, topic, msgtype, data, received_ns):
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(
                topic, msgtype, typestore=self.messages.store)
        self.writer.write(self.connections[topic], int(received_ns), bytes(data))


def write_bag(path, storage='mcap', count=50):
    """Write a bag with the tracks of seeds 1 (/odom) and 2 (/pose) and a topic of no use."""
    with BagFile(path, storage) as bag:
        stamps_ns, odometry = make_track(count, 1)
        _, poses = make_track(count, 2)
        for stamp_ns, first, second in zip(stamps_ns, odometry, poses, strict=True):
            bag.add('/odom', bag.messages.odometry(stamp_ns, first), stamp_ns + 5)
            bag.add('/pose', bag.messages.pose(stamp_ns, second), stamp_ns + 6)
        bag.add('/words', bag.messages.text('hello'), stamps_ns[-1] + 7)
    return Path(path)


def _record(opcode, body):
    return struct.pack('<BQ', opcode, len(body)) + body


def _text(words):
    data = words.encode()
    return struct.pack('<I', len(data)) + data


def write_mcap(path, messages, *, profile='ros2', encoding='cdr', crc=True, chunked=True,
               indexed=True):
    """Write an mcap file as other recorders do.

    ``messages`` are tuples of topic, type, receive time and data.
    """
    channels, inner, counts = {}, b'', {}
    for topic, msgtype, stamp_ns, data in messages:
        if topic not in channels:
            key = channels[topic] = len(channels) + 1
            inner += _record(3, struct.pack('<H', key) + _text(msgtype) + _text('ros2msg')
                             + _text(''))
            inner += _record(4, struct.pack('<HH', key, key) + _text(topic) + _text(encoding)
                             + struct.pack('<I', 0))
        key = channels[topic]
        counts[key] = counts.get(key, 0) + 1
        inner += _record(5, struct.pack('<HIQQ', key, 0, int(stamp_ns), int(stamp_ns)) + data)
    body = inner
    if chunked:
        body = _record(6, struct.pack('<QQQI', 0, 1, len(inner), crc32(inner) if crc else 0)
                       + _text('') + struct.pack('<Q', len(inner)) + inner)
    magic = b'\x89MCAP0\r\n'
    start = magic + _record(1, _text(profile) + _text('test')) + body + _record(15, bytes(4))
    heads = b''.join(
        _record(opcode, inner[offset + 9:offset + 9 + size])
        for opcode, offset, size in _walk(inner) if opcode in (3, 4))
    statistics = _record(11, struct.pack('<QHIIIIQQ', sum(counts.values()), len(counts),
                                         len(counts), 0, 0, 1, 0, 1)
                         + struct.pack('<I', 10 * len(counts))
                         + b''.join(struct.pack('<HQ', *item) for item in counts.items()))
    summary = heads + statistics if indexed else b''
    footer = _record(2, struct.pack('<QQI', len(start) if indexed else 0, 0, 0))
    Path(path).write_bytes(start + summary + footer + magic)
    return Path(path)


def _walk(data):
    offset = 0
    while offset < len(data):
        opcode, size = struct.unpack_from('<BQ', data, offset)
        yield opcode, offset, size
        offset += 9 + size
