# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Questions about the units of stamps and positions.

Files contain numbers without units. Millimetres, or times in microseconds, can be read without an
error, but steps and speeds are implausible. This is only a question, because a few recordings are
really as slow, and a few vehicles as fast.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import rounded
from trajectory_calibration.geometry.se3 import FloatArray

# Units and their divisors to seconds.
_UNITS = (('milliseconds', '1000'), ('microseconds', '1e6'), ('nanoseconds', '1e9'))

# Units of length per metre.
_SMALL_UNITS = (('feet', 1 / 0.3048), ('inches', 1 / 0.0254), ('centimetres', 100.0),
                ('millimetres', 1000.0))


def time_doubts(trajectory: Trajectory) -> tuple[Finding, ...]:
    """Return a question about the unit of the stamps if the steps are implausible."""
    step = trajectory.usual_step_ns * 1e-9
    # Fewer poses may be captures, one at each place where the sensors stood still.
    if len(trajectory) < 30 or 1e-5 <= step <= 10:
        return ()
    unit, divisor = next(
        (item for item in _UNITS if step / float(item[1]) <= 1), _UNITS[-1])
    question = ('days? Then multiply them by 86400' if step < 1e-5 else
                f'{unit}? Then divide them by {divisor}; --time-unit reads them')
    return (Finding(
        'time-unit', f'{trajectory.sensor_frame}: the median step between its poses is '
        f'{step:.6g} s: are its times in {question}', {'median_step_s': step}),)


def position_doubts(trajectory: Trajectory) -> tuple[Finding, ...]:
    """Return a question about the unit of the positions if the speed is implausible."""
    # Over a second: over shorter lags noise dominates.
    every = min(trajectory.poses_in(1_000_000_000), len(trajectory) - 1)
    way = np.linalg.norm(
        trajectory.positions[every:] - trajectory.positions[:-every], axis=1)
    time_s = (trajectory.stamps_ns[every:] - trajectory.stamps_ns[:-every]) * 1e-9
    speed = float(np.median(way / time_s))
    # No ground vehicle, and hardly a drone, is faster than that.
    if speed <= 100:
        return ()
    return (Finding(
        'length-unit',
        f'{trajectory.sensor_frame}: its median speed is {rounded(speed)} m/s: are its positions '
        'in metres? Divide millimetres by 1000', {'median_speed_m_per_s': speed}),)


def unit_doubts(scale: float, frame: str) -> tuple[Finding, ...]:
    """Return a question if sensor a may be in feet, or another unit smaller than a metre.

    ``scale`` is the factor of the lengths of b. The answer is in the unit of a, so a smaller unit
    of b does no harm.
    """
    for unit, per_metre in _SMALL_UNITS:
        # A SLAM is off by some per cent.
        if abs(scale / per_metre - 1) < 0.03:
            return (Finding(
                'length-unit',
                f'{frame}: its lengths are {scale:.4g} times those of b: are its positions in '
                f'{unit}? Then so is the translation. Divide them by {per_metre:.6g}',
                {'factor': scale}),)
    return ()


def doubts_of_both(a: Trajectory, b: Trajectory) -> tuple[Finding, ...]:
    """Return questions about the units of the stamps of two trajectories that do not match.

    Those about each trajectory, or one if they do not overlap and their steps differ by the ratio
    of two units.
    """
    found = (*time_doubts(a), *time_doubts(b), *(
        item for item in (*a.findings, *b.findings) if item.code == 'stamps-are-numbers'))
    common = a.stamps_ns[0] <= b.stamps_ns[-1] and b.stamps_ns[0] <= a.stamps_ns[-1]
    if found or common:
        return found
    short, long_ = sorted((a, b), key=lambda trajectory: trajectory.usual_step_ns)
    factor = long_.usual_step_ns / short.usual_step_ns
    for unit, divisor in _UNITS:
        # Rates of sensors differ by less than ten times.
        if 0.1 < factor / float(divisor) < 10:
            return (Finding(
                'time-unit',
                f'the median step is {short.usual_step_ns * 1e-9:.3g} s in {short.sensor_frame} '
                f'and {long_.usual_step_ns * 1e-9:.3g} s in {long_.sensor_frame}: are the times '
                f'of {long_.sensor_frame} in {unit}? Then divide them by {divisor}; --time-unit '
                'reads them', {'factor': factor}),)
    return ()


def lost_as_identity(poses: FloatArray) -> NDArray[np.bool_]:
    """Return which of (N, 7) poses or (N, 4, 4) matrices are an identity in place of a pose.

    A SLAM that is lost often writes the identity. Such rows have distant neighbours, unlike a
    trajectory that starts or restarts at the origin.
    """
    lost = np.zeros(len(poses), dtype=bool)
    if not len(poses):
        return lost
    identity = np.array([0, 0, 0, 0, 0, 0, 1.0]) if poses.ndim == 2 else np.eye(4).ravel()
    found = (poses.reshape(len(poses), -1) == identity).all(axis=1)
    # At the beginning the identity is the origin of the trajectory.
    found[:np.argmin(found)] = False
    place = poses[:, :3] if poses.ndim == 2 else poses[:, :3, 3]
    if not found.any() or found.sum() > len(found) - 2:
        return lost
    # A damaged row may lie at 1e303.
    with np.errstate(over='ignore'):
        steps = np.linalg.norm(np.diff(place[~found], axis=0), axis=1)
        far = np.linalg.norm(place, axis=1) > 5 * float(np.median(steps))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], found, [False]]).astype(int)))
    for first, end in edges.reshape(-1, 2).tolist():
        lost[first:end] = far[first - 1] and (end == len(poses) or far[end])
    return lost
