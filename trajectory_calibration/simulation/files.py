# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulated trajectories as files: TUM and rosbag2."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
import heapq
from pathlib import Path
from typing import Any

import numpy as np

from trajectory_calibration.config.yaml_file import write_text
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import ConfigError, SourceError
from trajectory_calibration.geometry import se3

_TYPES = {'odometry': 'nav_msgs/msg/Odometry', 'pose_stamped': 'geometry_msgs/msg/PoseStamped'}

STORAGES = ('mcap', 'sqlite3')
MESSAGES = tuple(_TYPES)


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write rows ``t x y z qx qy qz qw``; seconds with nine decimals, so that no stamp changes.

    Raises
    ------
    SourceError
        The file cannot be written.

    """
    quaternions = se3.rotation_to_quaternion(trajectory.rotations)
    numbers = np.column_stack([trajectory.positions, quaternions]).tolist()
    rows = ''.join(
        f'{"-" * (stamp < 0)}{abs(stamp) // 10**9}.{abs(stamp) % 10**9:09d} '
        f'{" ".join(map(repr, row))}\n'
        for stamp, row in zip(trajectory.stamps_ns.tolist(), numbers, strict=True))
    header = f'# {trajectory.sensor_frame} in {trajectory.world_frame}: t x y z qx qy qz qw\n'
    write_text(path, header + rows, SourceError)


def write_transform(path: Path, transform: se3.FloatArray) -> None:
    """Write one (4, 4) transform as a row ``0 x y z qx qy qz qw``, metres.

    Raises
    ------
    SourceError
        The file cannot be written.

    """
    numbers = [*transform[:3, 3], *se3.rotation_to_quaternion(transform[:3, :3])]
    row = ' '.join(repr(float(x)) for x in numbers)
    write_text(path, f'# t x y z qx qy qz qw\n0 {row}\n', SourceError)


def write_bag(
    path: Path,
    trajectories: Mapping[str, Trajectory],
    *,
    message: str = 'odometry',
    storage: str = 'mcap',
) -> None:
    """Write a rosbag2: one topic per trajectory, messages in the order of their stamps.

    Parameters
    ----------
    path : Path
        The folder of the bag, which must not exist.
    trajectories : mapping of str to Trajectory
        By topic.
    message : 'odometry' or 'pose_stamped'
        The type of the messages.
    storage : 'mcap' or 'sqlite3'
        The format of the file.

    Raises
    ------
    ConfigError
        An unknown type of message or format.
    SourceError
        The bag cannot be written.

    """
    for what, given, known in (('message', message, MESSAGES), ('storage', storage, STORAGES)):
        if given not in known:
            raise ConfigError(f'{what} {given!r} is unknown; needed one of {", ".join(known)}')
    # The bag library loads here because most uses of the simulator stay in memory.
    from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
    from rosbags.typesys import get_typestore, Stores
    typestore = get_typestore(Stores.ROS2_JAZZY)
    name = _TYPES[message]
    build = _message_builder(typestore.types, message)
    try:
        with Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
            connections = {
                topic: writer.add_connection(topic, name, typestore=typestore)
                for topic in trajectories}
            for stamp, topic, k in _in_time_order(trajectories):
                data = typestore.serialize_cdr(build(trajectories[topic], k), name)
                writer.write(connections[topic], stamp, data)
    except (OSError, WriterError) as error:
        raise SourceError(
            f'{path} cannot be written as a bag: {str(error).rstrip(".")}; remove what is '
            'there, or choose another folder') from error


def _in_time_order(trajectories: Mapping[str, Trajectory]) -> Iterator[tuple[int, str, int]]:
    """Yield stamp, topic and index of every pose."""
    return heapq.merge(*(
        [(stamp, topic, k) for k, stamp in enumerate(trajectory.stamps_ns.tolist())]
        for topic, trajectory in trajectories.items()))


def _message_builder(types: Mapping[str, Any], message: str) -> Callable[[Trajectory, int], Any]:
    """Return a function that makes the message of the k-th pose of a trajectory."""
    make_time = types['builtin_interfaces/msg/Time']
    make_header = types['std_msgs/msg/Header']
    make_point = types['geometry_msgs/msg/Point']
    make_quaternion = types['geometry_msgs/msg/Quaternion']
    make_pose = types['geometry_msgs/msg/Pose']
    make_vector = types['geometry_msgs/msg/Vector3']
    unknown = np.zeros(36)
    twist = types['geometry_msgs/msg/TwistWithCovariance'](
        types['geometry_msgs/msg/Twist'](make_vector(0.0, 0.0, 0.0), make_vector(0.0, 0.0, 0.0)),
        unknown)

    def build(trajectory: Trajectory, k: int) -> Any:
        seconds, nanoseconds = divmod(int(trajectory.stamps_ns[k]), 10**9)
        header = make_header(make_time(seconds, nanoseconds), trajectory.world_frame)
        pose = make_pose(
            make_point(*trajectory.positions[k].tolist()),
            make_quaternion(*se3.rotation_to_quaternion(trajectory.rotations[k]).tolist()))
        if message == 'pose_stamped':
            return types[_TYPES[message]](header, pose)
        with_covariance = types['geometry_msgs/msg/PoseWithCovariance'](pose, unknown)
        return types[_TYPES[message]](header, trajectory.sensor_frame, with_covariance, twist)

    return build
