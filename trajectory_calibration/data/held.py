# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Poses that repeat an old measurement under a new stamp.

A GNSS receiver gives one position per second, and its INS writes a hundred poses per second with
it; a SLAM at 5 Hz is published again at 20 Hz; a receiver in a tunnel repeats its last position.
Such poses are old by half a second and more, and a solver takes them for motion: the lever arm is
wrong by metres. A stationary vehicle repeats its pose, too. The next step distinguishes the two:
after standing still it is a normal step, after a held pose it is a jump.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray


def without_held(trajectory: Trajectory) -> tuple[Trajectory, tuple[Finding, ...]]:
    """Return the trajectory without the rows that repeat an old position or orientation.

    Itself where there are none. The finding says how many were dropped.
    """
    steps = np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1)
    same_rotation = (np.diff(trajectory.rotations, axis=0) == 0).all(axis=(1, 2))
    if steps.all() and not same_rotation.any():
        return trajectory, ()
    angles = np.linalg.norm(trajectory.turns, axis=1)
    held = {
        'position': _held(trajectory.positions, steps, steps == 0),
        'orientation': _held(
            se3.rotation_to_quaternion(trajectory.rotations), angles, same_rotation)}
    drop = np.logical_or(*held.values())
    count = int(np.count_nonzero(drop))
    if not count or len(trajectory) - count < 2:
        return trajectory, ()
    what = ' and '.join(f'{name}s' for name, rows in held.items() if rows.any())
    keep = ~drop
    kept = Trajectory(trajectory.stamps_ns[keep], trajectory.poses[keep], trajectory.world_frame,
                      trajectory.sensor_frame, trajectory.findings)
    return kept, (Finding(
        'poses-held',
        f'{trajectory.sensor_frame}: {count:,} of {len(trajectory):,} poses repeat old {what} '
        'while it moves: dropped. Record each measurement once, with its own stamp',
        {'poses': count}),)


def _held(values: FloatArray, steps: FloatArray, same: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which of (N, K) rows repeat an old value.

    ``steps`` are the (N - 1,) distances from row to row, ``same`` whether a row repeats the one
    before.
    """
    repeats = np.concatenate([[False], same])
    fresh = np.flatnonzero(~repeats)
    if not same.any() or len(fresh) < 2:
        return np.zeros(len(repeats), dtype=bool)
    after = np.concatenate([repeats[1:], [True]])
    alone = repeats[fresh - 1] & after[fresh]
    changes = np.diff(values[fresh], axis=0) != 0
    # A slow sensor is repeated: most new rows are between repeated ones, and one coordinate
    # changes in nearly all of them (rounded values change alternately).
    if len(fresh) >= 10 and alone[1:-1].mean() > 0.8 and changes.mean(axis=0).max() > 0.9:
        return repeats
    # Pauses that end with a jump: five times the usual step, and the one after it.
    on_its_way = ~same & ~repeats[:-1]
    usual = float(np.median(steps[on_its_way])) if on_its_way.any() else 0.0
    held = np.zeros(len(repeats), dtype=bool)
    following = np.append(steps, 0.0)
    for k in np.flatnonzero(np.diff(fresh) > 2):
        last, row = fresh[k], fresh[k + 1]
        held[last + 1:row] = steps[row - 1] > 5 * max(usual, following[row])
    return held
