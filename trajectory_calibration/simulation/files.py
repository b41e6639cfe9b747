# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Write simulated trajectories as TUM files or rosbag2."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
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
    """Write rows ``t x y z qx qy qz qw``, metres and seconds with nine decimals (exact stamps).

    Raises SourceError if the file cannot be written.
    """
    rows = ''.join(
        f'{"-" * (stamp < 0)}{abs(stamp) // 10**9}.{abs(stamp) % 10**9:09d} '
        f'{" ".join(map(repr, row))}\n'
        for stamp, row in zip(trajectory.stamps_ns.tolist(), _rows(trajectory.poses), strict=True))
    header = f'# {trajectory.sensor_frame} in {trajectory.world_frame}: t x y z qx qy qz qw\n'
    write_text(path, header + rows, SourceError)


def write_transform(path: Path, transform: se3.FloatArray) -> None:
    """Write one (4, 4) transform as a row ``0 x y z qx qy qz qw``, metres.

    Raises SourceError if the file cannot be written.
    """
    row = ' '.join(map(repr, _rows(transform[None])[0]))
    write_text(path, f'# t x y z qx qy qz qw\n0 {row}\n', SourceError)


def _rows(poses: se3.FloatArray) -> list[list[float]]:
    """Return rows x, y, z, qx, qy, qz, qw of (N, 4, 4) poses."""
    q = se3.rotation_to_quaternion(poses[:, :3, :3])
    rows: list[list[float]] = np.column_stack([poses[:, :3, 3], q]).tolist()
    return rows


def write_bag(
    path: Path, trajectories: Mapping[str, Trajectory], *, message: str = MESSAGES[0],
    storage: str = STORAGES[0],
) -> None:
    """Write a rosbag2: one topic per trajectory, messages in the order of their stamps.

    ``path`` is the folder of the bag, which must not exist; ``trajectories`` are by topic.
    Raises ConfigError if ``message`` is not in ``MESSAGES`` or ``storage`` not in ``STORAGES``,
    SourceError if the bag cannot be written.
    """
    for what, given, known in (('message', message, MESSAGES), ('storage', storage, STORAGES)):
        if given not in known:
            raise ConfigError(f'{what} {given!r} is unknown; needed one of {", ".join(known)}')
    # Imported here because most uses of the simulator write no bag.
    from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
    from rosbags.typesys import get_typestore, Stores
    typestore = get_typestore(Stores.ROS2_JAZZY)
    name = _TYPES[message]
    try:
        with Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
            connections = {
                topic: writer.add_connection(topic, name, typestore=typestore)
                for topic in trajectories}
            for stamp, topic, built in heapq.merge(*(
                    _messages(typestore.types, name, topic, trajectory)
                    for topic, trajectory in trajectories.items()), key=lambda item: item[:2]):
                writer.write(connections[topic], stamp, typestore.serialize_cdr(built, name))
    except (OSError, WriterError) as error:
        raise SourceError(
            f'{path} cannot be written as a bag: {str(error).rstrip(".")}; remove what is '
            'there, or choose another folder') from error


def _messages(
    types: Mapping[str, Any], name: str, topic: str, trajectory: Trajectory,
) -> Iterator[tuple[int, str, Any]]:
    """Yield stamp, topic and message of every pose."""
    def new(kind: str, *fields: Any) -> Any:
        return types[f'geometry_msgs/msg/{kind}'](*fields)

    unknown, zero = np.zeros(36), new('Vector3', 0.0, 0.0, 0.0)
    twist = new('TwistWithCovariance', new('Twist', zero, zero), unknown)
    for stamp, row in zip(trajectory.stamps_ns.tolist(), _rows(trajectory.poses), strict=True):
        time = types['builtin_interfaces/msg/Time'](*divmod(stamp, 10**9))
        pose = new('Pose', new('Point', *row[:3]), new('Quaternion', *row[3:]))
        content = (pose,) if name == _TYPES['pose_stamped'] else (
            trajectory.sensor_frame, new('PoseWithCovariance', pose, unknown), twist)
        header = types['std_msgs/msg/Header'](time, trajectory.world_frame)
        yield stamp, topic, types[name](header, *content)
