# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checks of a single trajectory: a measured orientation, poses that are not inverted.

A GNSS receiver measures positions only. Software may add a constant orientation, or the course
over ground, and the file then looks like poses. Inverted poses satisfy ``A X = X B`` as well. Only
the motion itself shows these faults.
"""

from __future__ import annotations

import numpy as np

from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.trajectory import ROUNDING_TOLERANCE, Trajectory
from trajectory_calibration.errors import MotionError, rounded
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# Number of steps that is enough for a check.
LEAST_STEPS = 20


def require_orientation(trajectory: Trajectory) -> None:
    """Raise MotionError if the orientation is constant or computed from the positions."""
    name = trajectory.sensor_frame
    way = np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1)
    if not way.any():
        return
    rotated = np.swapaxes(trajectory.rotations[:1], 1, 2) @ trajectory.rotations
    # The trace is 3 - angle^2: rounding of 1e-16 is an angle of 1e-8.
    if 3.0 - float(np.trace(rotated, axis1=1, axis2=2).min()) < ROUNDING_TOLERANCE**2:
        raise MotionError(
            f'{name}: the orientation never changes over {rounded(way.sum(), 3)} m driven: '
            'positions alone (GNSS without an INS?) cannot be calibrated. Give poses whose '
            'orientation is measured')
    if _is_course(trajectory):
        raise MotionError(
            f'{name}: the orientation is the course over ground, computed from the positions, '
            'not that of the sensor. Give poses whose orientation is measured, as of an INS')


def _is_course(trajectory: Trajectory) -> bool:
    """Return whether the orientation is a yaw from the course over ground.

    Such an orientation rotates about one axis only, to the last digit. Computed from positions it
    follows their errors. Computed from velocities it has no roll and pitch although the height
    changes, and no lever arm in curves; a measured yaw has.
    """
    count = min(len(trajectory), 5_000)
    turns = trajectory.turns[:count - 1]
    sizes, axes = np.linalg.eigh(turns.T @ turns)
    if count < LEAST_STEPS or sizes[1] > ROUNDING_TOLERANCE**2 * count:
        return False
    axis = trajectory.rotations[0] @ axes[:, 2]
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    yaw = np.concatenate([[0.0], np.cumsum(turns @ axes[:, 2])])
    moved = trajectory.positions[:count] - trajectory.positions[0]
    position = moved @ np.stack([across, np.cross(axis, across)]).T
    height_varies = float(np.std(np.diff(moved @ axis))) > ROUNDING_TOLERANCE
    return any(
        _is_course_over(position, sign * yaw, *steps, no_lever=height_varies and steps == (2, 2))
        for steps in ((0, 1), (1, 0), (1, 1), (2, 2)) for sign in (1.0, -1.0))


def _is_course_over(
    position: FloatArray, yaw: FloatArray, before: int, after: int, *, no_lever: bool,
) -> bool:
    """Return whether (N,) yaw angles are the course of (N, 2) positions over so many steps.

    They are if they follow the errors of the positions or, with ``no_lever``, if the lever arm is
    zero.
    """
    k = np.arange(before, len(position) - after)
    step = position[k + after] - position[k - before]
    length = np.linalg.norm(step, axis=1)
    course = np.arctan2(step[:, 1], step[:, 0])
    # A stationary vehicle has no course; the second difference needs three of them.
    long_ = length > 0.3 * np.median(length)
    inner = long_[:-2] & long_[1:-1] & long_[2:]
    if inner.sum() < LEAST_STEPS:
        return False
    difference = _wrapped(course - yaw[k])
    # The origin of the yaw is arbitrary.
    difference = _wrapped(difference - np.angle(np.mean(np.exp(1j * difference[long_]))))
    second = np.where(inner, _wrapped(np.diff(course, 2)), 0.0)
    noise = float(np.median(np.abs(second[inner])))
    # Position errors make successive second differences of opposite sign. Without such errors the
    # course follows the road, and a vehicle without slip really has this yaw.
    alternating = float(second[:-1] @ second[1:]) < 0
    residual = float(np.median(np.abs(difference[long_])))
    if alternating and noise > ROUNDING_TOLERANCE and residual < 0.02 * noise:
        return True
    if not no_lever:
        return False
    # Radians per metre; a lever arm l ahead changes the course by l times the curvature.
    curvature = (yaw[k + after] - yaw[k - before])[long_] / length[long_]
    columns = np.column_stack([np.ones_like(curvature), curvature])
    P = np.linalg.pinv(columns.T @ columns)
    offset, lever = P @ (columns.T @ difference[long_])
    residuals = difference[long_] - columns @ [offset, lever]
    # Position errors are correlated over overlapping steps.
    std = np.sqrt(np.diag(P) * 2 * (before + after) * float(np.mean(residuals**2)))
    # Zero within 5 cm and three standard deviations, if these are small enough to tell.
    return bool(abs(lever) < 0.05 + 3 * std[1] < 0.2)


def order_doubts(trajectory: Trajectory) -> tuple[Finding, ...]:
    """Return a question if the quaternions seem to be in the order w, x, y, z.

    A vehicle moves along one of its axes. With a wrong quaternion order the motion is along all
    axes. Drones and handheld sensors move along all axes anyway, and give no question.
    """
    R = trajectory.rotations
    every = trajectory.poses_in(500_000_000)
    step = trajectory.positions[every:] - trajectory.positions[:-every]
    at = slice(every // 2, every // 2 + len(step))
    if len(step) < LEAST_STEPS or not step.any():
        return ()
    w_first = se3.rotation_to_quaternion(R[at])[:, [1, 2, 3, 0]]
    as_read, other = (_share_along_one_axis(rotations, step) for rotations in (
        R[at], se3.quaternion_to_rotation(w_first)))
    if as_read > 0.85 or other < 0.97:
        return ()
    return (Finding(
        'quaternion-order', f'is w first in the quaternions? Then it moves along one of its axes '
        f'({other:.0%} of the distance; as read {as_read:.0%}), as a vehicle: '
        '--quaternion-order wxyz',
        {'share_as_read': as_read, 'share_w_first': other}),)


def _share_along_one_axis(rotations: FloatArray, steps: FloatArray) -> float:
    """Return the share of (N, 3) steps in the world along one axis of the body."""
    own = np.einsum('kji,kj->ki', rotations, steps)
    sizes = np.linalg.eigvalsh(own.T @ own)
    return float(np.sqrt(sizes[-1] / sizes.sum()))


def _wrapped(angle: FloatArray) -> FloatArray:
    wrapped: FloatArray = np.angle(np.exp(1j * angle))
    return wrapped


def least_steps(trajectory: Trajectory) -> tuple[float, float]:
    """Return the motion of a body in 0.2 s, metres: as the poses are, and if they are inverted.

    It is that of the point of the body that moves least. Correct poses move less than inverted
    ones, in which every rotation swings the distant origin. A sensor that always looks at one
    target rotates about the target, and both motions are small. Both are zero if there are too few
    poses.
    """
    every = trajectory.poses_in(200_000_000)
    i = np.arange(0, len(trajectory) - every, max(1, len(trajectory) // 400))
    if len(i) < 10:
        return 0.0, 0.0
    poses = trajectory.poses[np.stack([i, i + every])]
    # Near the origin, because the inverses of distant poses lose digits.
    poses[..., :3, 3] -= poses[0, :, :3, 3].mean(axis=0)
    return _least_step(*poses), _least_step(*se3.inverse(poses))


def _least_step(here: FloatArray, there: FloatArray) -> float:
    """Return the root mean square step, metres, of the point of the body that moves least."""
    turn, step = (there - here)[:, :3, :3], (there - here)[:, :3, 3]
    weights = np.ones(len(step))
    squares = weights
    for _ in range(4):
        weighted = weights[:, None, None] * turn
        H = np.einsum('kij,kil->jl', weighted, turn)
        point = -np.linalg.pinv(H, rcond=se3.ROUNDING, hermitian=True) @ np.einsum(
            'kij,ki->j', weighted, step)
        squares = np.sum((step + turn @ point)**2, axis=1)
        weights = 1 / (squares + squares.mean() + se3.ROUNDING**2)
    # Without the largest steps, which may be jumps.
    return float(np.sqrt(np.mean(np.sort(squares)[:-max(1, round(0.02 * len(squares)))])))
