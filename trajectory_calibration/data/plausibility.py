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

# Median speed, m/s, above any ground vehicle and almost any drone.
_FASTEST = 100.0

# Lag of the speed, nanoseconds: over shorter ones noise dominates.
_SPEED_SPAN_NS = 1_000_000_000

# Plausible median steps, seconds, and the longest one after conversion to seconds.
_SHORTEST_STEP, _LONGEST_STEP = 1e-5, 10.0
_USUAL_STEP = 1.0
# Fewer poses may be single captures at standstill.
_CAPTURES = 30

# Units and their divisors to seconds, and the largest ratio of the rates of two sensors.
_UNITS = (('milliseconds', '1000'), ('microseconds', '1e6'), ('nanoseconds', '1e9'))
_RATES = 10.0

# Units of length per metre, and the tolerance of a scale (a SLAM is off by some per cent).
_SMALL_UNITS = (('feet', 1 / 0.3048), ('inches', 1 / 0.0254), ('centimetres', 100.0),
                ('millimetres', 1000.0))
_LIKE_A_UNIT = 0.03

# An identity pose is no measurement if its neighbours are this many steps from the origin.
_FAR_STEPS = 5.0


def time_doubts(trajectory: Trajectory) -> tuple[Finding, ...]:
    """Return a question about the unit of the stamps if the steps are implausible."""
    step = trajectory.usual_step_ns * 1e-9
    if len(trajectory) < _CAPTURES or _SHORTEST_STEP <= step <= _LONGEST_STEP:
        return ()
    unit, divisor = next(
        (item for item in _UNITS if step / float(item[1]) <= _USUAL_STEP), _UNITS[-1])
    question = ('days? Then multiply them by 86400' if step < _SHORTEST_STEP else
                f'{unit}? Then divide them by {divisor}; --time-unit reads them')
    return (Finding(
        'time-unit', f'{trajectory.sensor_frame}: the median step between its poses is '
        f'{step:.6g} s: are its times in {question}', {'median_step_s': step}),)


def position_doubts(trajectory: Trajectory) -> tuple[Finding, ...]:
    """Return a question about the unit of the positions if the speed is implausible."""
    every = min(trajectory.poses_in(_SPEED_SPAN_NS), len(trajectory) - 1)
    way = np.linalg.norm(
        trajectory.positions[every:] - trajectory.positions[:-every], axis=1)
    time_s = (trajectory.stamps_ns[every:] - trajectory.stamps_ns[:-every]) * 1e-9
    speed = float(np.median(way / time_s))
    if speed <= _FASTEST:
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
        if abs(scale / per_metre - 1) < _LIKE_A_UNIT:
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
        if 1 / _RATES < factor / float(divisor) < _RATES:
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
    steps = np.linalg.norm(np.diff(place[~found], axis=0), axis=1)
    if not (found.any() and len(steps)):
        return lost
    far = np.linalg.norm(place, axis=1) > _FAR_STEPS * float(np.median(steps))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], found, [False]]).astype(int)))
    for first, end in edges.reshape(-1, 2).tolist():
        lost[first:end] = far[first - 1] and (end == len(poses) or far[end])
    return lost
