# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether a trajectory has an orientation of its own, and holds the poses it claims to hold.

Receivers of GNSS give positions. What fills in an orientation writes a constant, or the course
over ground; either passes for a pose, and no solver can tell. Poses that were inverted pass too:
a motion A X = X B is as true of the inverses. Only how things move tells them apart.
"""

from __future__ import annotations

import numpy as np

from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import MotionError, rounded
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# Radians: what is left of a constant orientation by the digits of a file.
_DIGITS = 1e-5

# Course over ground: poses that are looked at, and steps, of the longest ones, that count.
_COURSE_POSES = 5_000
_LONG_STEP = 0.3
_LEAST_STEPS = 20
# A yaw that was computed from the positions is off the course by this share of its roughness.
_COPIED = 0.02
# A yaw that is the course has no lever arm (metres) in curves, but for this much and so many
# standard deviations.
_NO_LEVER, _SIGMA = 0.05, 3.0
# Steps to the positions before and after of which the course is taken then.
_SPAN = (2, 2)

# Nanoseconds over which a body is followed, motions, rounds of reweighting.
_FOLLOWED_NS = 200_000_000
_MOTIONS = 400
_ROUNDS = 4
# Nanoseconds over which a vehicle moves along an axis of its own, and the share of its motion
# that is along one axis where the quaternions are in that order, and where they are not.
_AHEAD_NS = 500_000_000
_AHEAD, _ASKEW = 0.97, 0.85
# Metres that are rounding.
_ROUNDING = 1e-12
# Share of the steps that may be jumps.
_JUMPS = 0.02


def require_orientation(trajectory: Trajectory) -> None:
    """Raise MotionError where the orientation is constant, or computed from the positions."""
    name = trajectory.sensor_frame
    way = np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1)
    if not way.any():
        return
    turned = np.swapaxes(trajectory.rotations[:1], 1, 2) @ trajectory.rotations
    # The trace tells a turn by t to within t^2 / 2, and rounding of 1e-16 is a turn of 1e-8.
    if 3.0 - float(np.trace(turned, axis1=1, axis2=2).min()) < _DIGITS**2:
        raise MotionError(
            f'{name}: the orientation never changes over {rounded(way.sum(), 3)} m driven: '
            'positions alone (GNSS without an INS?) cannot be calibrated. Give poses whose '
            'orientation is measured')
    if _is_course(trajectory):
        raise MotionError(
            f'{name}: the orientation is the course over ground, computed from the positions, '
            'not that of the sensor. Give poses whose orientation is measured, as of an INS')


def _is_course(trajectory: Trajectory) -> bool:
    """Tell whether the yaw is the direction from one position to the next, and all there is.

    It turns about one axis only, to the last digit. What computed it from the positions follows
    every error of them. What took it from velocities shows no roll and pitch where the height
    changes and no lever arm in curves, as a measured yaw would.
    """
    count = min(len(trajectory), _COURSE_POSES)
    turns = trajectory.turns[:count - 1]
    sizes, axes = np.linalg.eigh(turns.T @ turns)
    if count < _LEAST_STEPS or sizes[1] > _DIGITS**2 * count:
        return False
    axis = trajectory.rotations[0] @ axes[:, 2]
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    yaw = np.concatenate([[0.0], np.cumsum(turns @ axes[:, 2])])
    moved = trajectory.positions[:count] - trajectory.positions[0]
    position = moved @ np.stack([across, np.cross(axis, across)]).T
    height_varies = float(np.std(np.diff(moved @ axis))) > _DIGITS
    return any(
        _follows(position, sign * yaw, *steps, no_lever=height_varies and steps == _SPAN)
        for steps in ((0, 1), (1, 0), (1, 1), _SPAN) for sign in (1.0, -1.0))


def _follows(
    position: FloatArray, yaw: FloatArray, before: int, after: int, *, no_lever: bool,
) -> bool:
    """Tell whether (N,) yaw is the course of (N, 2) positions over so many steps.

    By the errors of the positions in it, or else, where asked for, by a lever arm of zero.
    """
    k = np.arange(before, len(position) - after)
    step = position[k + after] - position[k - before]
    length = np.linalg.norm(step, axis=1)
    course = np.arctan2(step[:, 1], step[:, 0])
    # Standing still it has no course; at both ends of three, for their second difference.
    long_ = length > _LONG_STEP * np.median(length)
    inner = long_[:-2] & long_[1:-1] & long_[2:]
    if inner.sum() < _LEAST_STEPS:
        return False
    apart = _wrapped(course - yaw[k])
    # The axis of the turns, and with it where yaw counts from, is known but for a constant.
    apart = _wrapped(apart - np.angle(np.mean(np.exp(1j * apart[long_]))))
    bend = np.where(inner, _wrapped(np.diff(course, 2)), 0.0)
    rough = float(np.median(np.abs(bend[inner])))
    # Errors of positions bend the course to and fro. Without any, it bends as the road does, and
    # a vehicle that does not slip is truly turned along it.
    to_and_fro = float(bend[:-1] @ bend[1:]) < 0
    if to_and_fro and rough > _DIGITS and np.median(np.abs(apart[long_])) < _COPIED * rough:
        return True
    if not no_lever:
        return False
    # Radians a metre; the course of a lever arm l ahead is off by l times that.
    curvature = (yaw[k + after] - yaw[k - before])[long_] / length[long_]
    columns = np.column_stack([np.ones_like(curvature), curvature])
    P = np.linalg.pinv(columns.T @ columns)
    offset, lever = P @ (columns.T @ apart[long_])
    rest = apart[long_] - columns @ [offset, lever]
    # Errors of positions reach over the steps that they have in common.
    std = np.sqrt(np.diag(P) * 2 * (before + after) * float(np.mean(rest**2)))
    return bool(abs(lever) < _NO_LEVER + _SIGMA * std[1] < 4 * _NO_LEVER)


def order_doubts(trajectory: Trajectory) -> tuple[Finding, ...]:
    """Ask whether w comes first, where the motion along an axis of the sensor says so.

    Wheels move a vehicle along one of its axes. In the wrong order its poses move along all of
    them. What flies, or is carried, does so in either order, and is not asked about.
    """
    R = trajectory.rotations
    every = trajectory.poses_in(_AHEAD_NS)
    step = trajectory.positions[every:] - trajectory.positions[:-every]
    at = slice(every // 2, every // 2 + len(step))
    if len(step) < _LEAST_STEPS or not step.any():
        return ()
    w_first = se3.rotation_to_quaternion(R[at])[:, [1, 2, 3, 0]]
    ahead, other = (_share_along_one_axis(rotations, step) for rotations in (
        R[at], se3.quaternion_to_rotation(w_first)))
    if ahead > _ASKEW or other < _AHEAD:
        return ()
    return (Finding(
        'quaternion-order', f'is w first in the quaternions? Then it moves along one of its axes '
        f'({other:.0%} of the distance; as read {ahead:.0%}), as a vehicle: '
        '--quaternion-order wxyz',
        {'share_as_read': ahead, 'share_w_first': other}),)


def _share_along_one_axis(rotations: FloatArray, steps: FloatArray) -> float:
    """Return the share of (N, 3) steps in the world along one axis of the body."""
    own = np.einsum('kji,kj->ki', rotations, steps)
    sizes = np.linalg.eigvalsh(own.T @ own)
    return float(np.sqrt(sizes[-1] / sizes.sum()))


def _wrapped(angle: FloatArray) -> FloatArray:
    turned: FloatArray = np.angle(np.exp(1j * angle))
    return turned


def least_steps(trajectory: Trajectory) -> tuple[float, float]:
    """Return how far a body moves in 0.2 s, metres, as its poses read and if they are inverted.

    Of all points of the body, and for the inverses of all points of the world, the one that moves
    least is followed: a sensor that looks at a target all the time turns about that target, which
    then stands still in either reading. Else poses as they should be move less than inverted ones,
    in which all turns swing what is far away. Both are zero where there are too few poses.
    """
    every = trajectory.poses_in(_FOLLOWED_NS)
    i = np.arange(0, len(trajectory) - every, max(1, len(trajectory) // _MOTIONS))
    if len(i) < 10:
        return 0.0, 0.0
    poses = trajectory.poses[np.stack([i, i + every])]
    # Far from the origin the inverses are large numbers, and their differences lose digits.
    poses[..., :3, 3] -= poses[0, :, :3, 3].mean(axis=0)
    return _least_step(*poses), _least_step(*se3.inverse(poses))


def _least_step(here: FloatArray, there: FloatArray) -> float:
    """Return the root mean square step, metres, of the point of the body that moves least."""
    turn, step = (there - here)[:, :3, :3], (there - here)[:, :3, 3]
    weights = np.ones(len(step))
    left = weights
    for _ in range(_ROUNDS):
        weighted = weights[:, None, None] * turn
        H = np.einsum('kij,kil->jl', weighted, turn)
        point = -np.linalg.pinv(H, rcond=1e-12, hermitian=True) @ np.einsum(
            'kij,ki->j', weighted, step)
        left = np.sum((step + turn @ point)**2, axis=1)
        weights = 1 / (left + left.mean() + _ROUNDING**2)
    # Jumps are no way that it went.
    return float(np.sqrt(np.mean(np.sort(left)[:-max(1, round(_JUMPS * len(left)))])))
