"""The paper's published trajectories and figures, read from the folder beside the project."""

import csv
from functools import lru_cache

import numpy as np

from trajectory_calibration import Trajectory
from trajectory_calibration.sources.files import FileSource, read_transform

REFERENCES = ['B1', 'B5', 'B10', 'C5', 'C10']
SEQUENCES = ['2011_09_30_drive_0027', '2011_10_03_drive_0027']


def trajectory(path, sensor_frame):
    """Return the trajectory in a TUM file."""
    return FileSource(path, 'tum', sensor_frame=sensor_frame).load()


def _in_seconds(trajectory):
    """Return the trajectory with its stamps as float64 seconds can hold them, to 0.24 us.

    The authors' program held them so, and one figure of theirs hangs on it: with stamps moved by
    0.1 us the error of dnlo at C5 on 2011_10_03 is anything from 0.155 to 0.228 m.
    """
    # Python divides integers with one rounding; NumPy would round the integer first.
    seconds = np.array([int(stamp) / 10**9 for stamp in trajectory.stamps_ns])
    return Trajectory(np.round(seconds * 1e9).astype(np.int64), trajectory.poses,
                      trajectory.world_frame, trajectory.sensor_frame)


@lru_cache
def kitti(data, sequence):
    """Return trajectories a and b and the truth of a sequence, as the paper used them."""
    folder = data / 'kitti' / sequence
    if sequence == '2011_09_30_drive_0027':
        a = trajectory(folder / 'LIDAR_HDL64E' / 'traj_HDL_aft_opt.csv', 'lidar')
        b = trajectory(folder / 'cam01' / 'KeyFrameTrajectory_TUM_Format.txt', 'camera')
        # The camera's first keyframe precedes the lidar's first scan.
        b = Trajectory(b.stamps_ns[1:], b.poses[1:], b.world_frame, b.sensor_frame)
        return _in_seconds(a), _in_seconds(b), read_transform(
            folder / 'camera_gray_left_in_velo_link.txt')
    a = trajectory(folder / 'cam01' / 'KeyFrameTrajectory_TUM_Format.txt', 'gray')
    b = trajectory(folder / 'cam23' / 'KeyFrameTrajectory_TUM_Format.txt', 'color')
    return _in_seconds(a), _in_seconds(b), read_transform(
        folder / 'camera_color_left_in_camera_gray_left.txt')


def simulations(data):
    """Yield kind, level (None for the mixture), run, trajectories a and b, truth."""
    for path in sorted((data / 'simulation').rglob('T_S2_S1.txt')):
        run = path.parent
        kind = run.relative_to(data / 'simulation').parts[0]
        level = None if kind == 'mixture' else float(run.parent.name.split('_')[1])
        yield (kind, level, int(run.name.split('_')[1]),
               trajectory(run / 'T_S1_W1.txt', 'a'), trajectory(run / 'T_S2_W2.txt', 'b'),
               read_transform(path))


def kitti_figures(data):
    """Return (e_at metres, e_aR degrees) by sequence, solver, reference."""
    with (data / 'published' / 'kitti.csv').open() as stream:
        return {(row['sequence'], row['algorithm'].lower(), row['reference']):
                (float(row['e_at_m']), float(row['e_aR_deg'])) for row in csv.DictReader(stream)}


def simulation_figures(data):
    """Return lists of (e_at metres, e_aR degrees) by kind, level, solver, reference."""
    figures = {}
    with (data / 'published' / 'simulation_runs.csv').open() as stream:
        for row in csv.DictReader(stream):
            level = None if row['kind'] == 'mixture' else float(row['level'])
            key = row['kind'], level, row['algorithm'].lower(), row['reference']
            figures.setdefault(key, []).append((float(row['e_at_m']), float(row['e_aR_deg'])))
    return figures
