# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Two trajectories with a known extrinsic, as files and as a bag; an output without a reader."""

import io

from bag_writing import BagFile
import numpy as np

from trajectory_calibration.cli.main import main
from trajectory_calibration.geometry import se3

X = se3.from_rotation_translation(se3.exp_so3([0.3, -1.2, 2.0]), [0.334, -0.005, -0.076])


def make_pair(count=80, *, planar=False):
    """Return stamps in nanoseconds and (count, 4, 4) poses of a and of b, free of noise."""
    time = np.arange(count) * 0.1
    turn = np.column_stack([
        np.zeros(count) if planar else 0.4 * np.sin(1.1 * time),
        np.zeros(count) if planar else 0.3 * np.sin(1.7 * time + 1), 0.5 * time])
    place = np.column_stack([2 * time, np.sin(time), 0 * time])
    poses_a = se3.from_rotation_translation(se3.exp_so3(turn), place)
    T_b_world = se3.from_rotation_translation(se3.exp_so3([0.1, 0.2, -0.7]), [5, -3, 1])
    stamps_ns = 1_700_000_000_000_000_000 + np.round(time * 1e9).astype(np.int64)
    return stamps_ns, poses_a, T_b_world @ poses_a @ X


def rows(stamps_ns, poses):
    """Return (N, 7) poses as x y z qx qy qz qw and the lines of a TUM file."""
    values = np.column_stack([poses[:, :3, 3], se3.rotation_to_quaternion(poses[:, :3, :3])])
    lines = [f'{stamp // 10**9}.{stamp % 10**9:09d} {" ".join(map(repr, value))}'
             for stamp, value in zip(stamps_ns.tolist(), values.tolist(), strict=True)]
    return values, lines


def write_pair(folder, **kind):
    """Write a.txt, b.txt and truth.txt; return their paths as text."""
    stamps_ns, poses_a, poses_b = make_pair(**kind)
    truth, _ = rows(stamps_ns[:1], X[None])
    contents = {'a.txt': rows(stamps_ns, poses_a)[1], 'b.txt': rows(stamps_ns, poses_b)[1],
                'truth.txt': ['# b in a', '0 ' + ' '.join(map(repr, truth[0].tolist()))]}
    for name, lines in contents.items():
        (folder / name).write_text('\n'.join(lines) + '\n', encoding='utf-8')
    return [str(folder / name) for name in contents]


def write_pair_bag(path, storage='mcap', count=80):
    """Write /lidar/odom (Odometry) and /camera/pose (PoseStamped) with the same poses."""
    stamps_ns, poses_a, poses_b = make_pair(count)
    with BagFile(path, storage) as bag:
        for stamp, a, b in zip(
                stamps_ns, rows(stamps_ns, poses_a)[0], rows(stamps_ns, poses_b)[0], strict=True):
            bag.add('/lidar/odom', bag.messages.odometry(stamp, a), stamp)
            bag.add('/camera/pose', bag.messages.pose(stamp, b), stamp)
        bag.add('/words', bag.messages.text('hello'), stamps_ns[-1])
    return str(path)


def run(capsys, *arguments):
    """Run the command line in this process; return its status, output and error output."""
    status = main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


class Gone(io.StringIO):
    """Standard output whose reader, head for instance, has seen enough."""

    def write(self, _):
        raise BrokenPipeError
