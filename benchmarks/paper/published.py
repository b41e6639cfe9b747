# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The paper's published trajectories and figures, read from the folder that holds them."""

from __future__ import annotations

from collections.abc import Iterator
import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import SourceError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.extrinsic_file import read_extrinsic
from trajectory_calibration.sources.files import FileSource

SEQUENCES = ('2011_09_30_drive_0027', '2011_10_03_drive_0027')

ERRORS = ('e_rt_m', 'e_rR_deg', 'e_at_m', 'e_aR_deg')

# The file of 2011_10_03 holds the extrinsic of the cameras before rectification, and its inverse.
# The trajectories come from rectified images, whose projection matrices give this.
_RECTIFIED_1003 = se3.from_rotation_translation(np.eye(3), [-0.0599, 0.0011, -0.0038])


@dataclass(frozen=True)
class PublishedRun:
    """One published simulation: where it lies and what it is."""

    kind: str
    level: float
    run: int
    folder: Path

    def load(self) -> tuple[Trajectory, Trajectory, FloatArray]:
        """Return the trajectories of a and b and the true (4, 4) pose of b in a."""
        return (FileSource(self.folder / 'T_S1_W1.txt', 'tum', sensor_frame='a').load(),
                FileSource(self.folder / 'T_S2_W2.txt', 'tum', sensor_frame='b').load(),
                read_extrinsic(self.folder / 'T_S2_S1.txt').T_a_b)


@dataclass(frozen=True, eq=False)
class KittiDrive:
    """Two trajectories of a KITTI drive.

    Attributes
    ----------
    a, b : trajectories as the paper used them.
    T_a_b_file : (4, 4), the truth that the paper used.
    T_a_b_corrected : (4, 4), the truth for what the trajectories show; the same where the
        file is right.

    """

    a: Trajectory
    b: Trajectory
    T_a_b_file: FloatArray
    T_a_b_corrected: FloatArray


def simulation_runs(data: Path) -> list[PublishedRun]:
    """Return the published simulations, sorted.

    Raises
    ------
    SourceError
        The folder holds none.

    """
    runs = []
    for path in (data / 'simulation').rglob('T_S2_S1.txt'):
        kind = path.relative_to(data / 'simulation').parts[0]
        level = 0.0 if kind == 'mixture' else float(path.parent.parent.name.split('_')[1])
        runs.append(PublishedRun(kind, level, int(path.parent.name.split('_')[1]), path.parent))
    if not runs:
        raise SourceError(f'{data} holds no simulation/*/*/T_S2_S1.txt; needed the folder of the '
                          'published data')
    return sorted(runs, key=lambda item: (item.kind, item.level, item.run))


def read_kitti(data: Path, sequence: str) -> KittiDrive:
    """Return a KITTI drive with the paper's choice of poses."""
    folder = data / 'kitti' / sequence
    keyframes = 'KeyFrameTrajectory_TUM_Format.txt'
    if sequence == SEQUENCES[0]:
        a = FileSource(folder / 'LIDAR_HDL64E' / 'traj_HDL_aft_opt.csv', 'tum',
                       sensor_frame='lidar').load()
        b = FileSource(folder / 'cam01' / keyframes, 'tum', sensor_frame='camera').load()
        # The camera's first keyframe precedes the lidar's first scan.
        b = Trajectory(b.stamps_ns[1:], b.poses[1:], b.world_frame, b.sensor_frame)
        truth = read_extrinsic(folder / 'camera_gray_left_in_velo_link.txt').T_a_b
        return KittiDrive(_in_seconds(a), _in_seconds(b), truth, truth)
    a, b = (FileSource(folder / camera / keyframes, 'tum', sensor_frame=name).load()
            for camera, name in (('cam01', 'gray'), ('cam23', 'color')))
    truth = read_extrinsic(folder / 'camera_color_left_in_camera_gray_left.txt').T_a_b
    return KittiDrive(_in_seconds(a), _in_seconds(b), truth, _RECTIFIED_1003)


def simulation_figures(data: Path) -> dict[tuple[str, float, int, str, str], FloatArray]:
    """Return (4,) ``ERRORS`` by kind, level, run, solver, reference."""
    return {
        (row['kind'], _level(row), int(row['run']), row['algorithm'].lower(), row['reference']):
        np.array([float(row[name]) for name in ERRORS])
        for row in _rows(data / 'published' / 'simulation_runs.csv')}


def simulation_quartiles(data: Path) -> dict[tuple[str, float, str, str], FloatArray]:
    """Return (3, 4) lower quartile, median, upper quartile of ``ERRORS`` over all 38 runs."""
    return {
        (row['kind'], _level(row), row['algorithm'].lower(), row['reference']):
        np.array([[float(row[f'{name}_{part}']) for name in ERRORS]
                  for part in ('q25', 'median', 'q75')])
        for row in _rows(data / 'published' / 'simulation_summary_38_runs.csv')}


def kitti_figures(
    data: Path,
) -> dict[tuple[str, str, str], tuple[float, float, float, float]]:
    """Return the four ``ERRORS`` by sequence, solver, reference."""
    return {(row['sequence'], row['algorithm'].lower(), row['reference']):
            (float(row['e_rt_m']), float(row['e_rR_deg']),
             float(row['e_at_m']), float(row['e_aR_deg']))
            for row in _rows(data / 'published' / 'kitti.csv')}


def _rows(path: Path) -> Iterator[dict[str, str]]:
    try:
        with path.open(encoding='utf-8', newline='') as stream:
            yield from csv.DictReader(stream)
    except OSError as error:
        raise SourceError(f'{path} cannot be read: {error.strerror or error}; needed the folder '
                          'of the published data') from error


def _level(row: dict[str, str]) -> float:
    return 0.0 if row['kind'] == 'mixture' else float(row['level'])


def _in_seconds(trajectory: Trajectory) -> Trajectory:
    """Return the trajectory with stamps as float64 seconds hold them, to 0.24 microseconds.

    The authors' program held them so, and one figure of theirs hangs on it: with stamps moved by
    0.1 us the error of dnlo at C5 on 2011_10_03 is anything from 0.155 to 0.228 m.
    """
    # Python divides integers with one rounding; NumPy would round the integer first.
    seconds = np.array([int(stamp) / 10**9 for stamp in trajectory.stamps_ns])
    return Trajectory(np.round(seconds * 1e9).astype(np.int64), trajectory.poses,
                      trajectory.world_frame, trajectory.sensor_frame)
