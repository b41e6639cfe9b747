"""Whether two trajectories belong together at all.

Two sensors on one body turn by the same angle at the same time, wherever they are mounted. A
solver finds the best extrinsic for any two trajectories, also for those of two vehicles, or of
one with clocks that differ by more than was looked for, and its residuals then pass for noise.
The turns tell: where they are large, half of them at least must agree well.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from trajectory_calibration.assessment.excitation import thinned_to
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.motion_pairs import lag_grid, select_motions
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import AssociationError, MotionError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.time_alignment.align import match

# Lags, seconds, that are looked at: short ones have fewer jumps in them, long ones turn farther.
_LAGS = (0.1, 0.2, 0.5, 2.0, 8.0)
_MOTIONS = 4000
# With so few of them, the best one counts, otherwise the second best.
_TOO_FEW_LAGS = 2

# Turns, radians, that are compared: larger than noise ever is, and well below half a turn, which
# is the same the other way round. Fewer than this many turns say nothing.
_LEAST_TURN, _LARGEST_TURN = np.deg2rad(10.0), np.deg2rad(150.0)
_LEAST_TURNS = 5

# Squared difference of two turns relative to both, above which they disagree: 0 for equal ones,
# 1 for such as have nothing in common. Median over the turns.
_DISAGREEMENT = 0.03

# Up to this disagreement the best rotation tells that they turned together, whatever a solver
# says; from there on inverted poses are tried, which are the explanation where they leave this
# share of it. Of a vehicle that turns about one axis they agree as well as the others.
_SUSPICIOUS, _MUCH_LESS = 0.01, 0.1

# Radians, and times the usual, that two sensors turn apart in a step only where one has jumped.
_PARTED, _PARTED_USUAL = np.deg2rad(10.0), 20.0


def require_agreement(
    T_a_b: FloatArray | None, pairs: PosePairs, a: Trajectory, b: Trajectory,
    config: CalibrationConfig,
) -> None:
    """Raise MotionError where the sensors turned, but not together.

    Not judged where they hardly turned: that is for the observability to say. ``pairs`` are of
    the trajectories a and b by ``config``.
    """
    turns = list(_turns(pairs))
    if not turns:
        return
    possible = _least_disagreement(turns)
    found = possible if T_a_b is None else _usual(
        [_disagreement(turn_a, turn_b @ T_a_b[:3, :3].T) for turn_a, turn_b in turns])
    inverted = _least_if_inverted(a, b, config) if possible > _SUSPICIOUS else np.inf
    if inverted < _MUCH_LESS * possible:
        advice = ('they would agree if the poses of one of them were inverted, or its quaternions '
                  'had w first: give the pose of the sensor in its world, as x, y, z, w')
    elif found > _DISAGREEMENT and possible <= _SUSPICIOUS:
        raise MotionError(_misfit(found, possible, a.sensor_frame, b.sensor_frame, config.solver))
    elif found > _DISAGREEMENT:
        advice = ('check the topics or files, the order of their quaternions (x, y, z, w), and '
                  'the clocks (max_time_offset is how far apart they may be)')
    else:
        return
    raise MotionError(
        f'{a.sensor_frame} and {b.sensor_frame} did not turn together: half of their turns differ '
        f'by more than {np.sqrt(2 * found):.0%}; needed two trajectories of one vehicle at the '
        f'same time: {advice}')


def _misfit(found: float, possible: float, name_a: str, name_b: str, solver: str) -> str:
    """Say that the rotation of a solver does not fit turns that agree by themselves.

    A method that weighs rotation and translation together gives up the rotation where the
    lengths of one sensor are far from those of the other.
    """
    scale = ('give it (scale)' if solver == 'drift_aware' else
             'give it (scale), or use solver drift_aware, which finds it')
    return (
        f'the rotation that {solver} found does not fit the turns: half of them differ by more '
        f'than {np.sqrt(2 * found):.0%}, with the best rotation by {np.sqrt(2 * possible):.1%}; '
        f'{name_a} and {name_b} did turn together; needed positions of both in one unit: check '
        f'their unit and scale; {scale}')


def _least_if_inverted(a: Trajectory, b: Trajectory, config: CalibrationConfig) -> float:
    """Return how little the turns would disagree if the poses of b were inverted.

    Those of a need no test of their own: inverted both, they agree as they did before. With w
    first, a rotation is read as its inverse between two that are constant.
    """
    b = replace(b, poses=se3.inverse(b.poses))
    with suppress(AssociationError):
        _, pairs = match(a, b, config)
        turns = list(_turns(pairs))
        return _least_disagreement(turns) if turns else np.inf
    return np.inf


def parted_steps(pairs: PosePairs) -> tuple[Finding, ...]:
    """Return a warning where the sensors turned apart within a single step.

    A SLAM that began anew, between two bags for instance, has another world: motions across it
    are none. How far each turned tells it whatever the extrinsic. For solvers that do not find
    such steps themselves.
    """
    angle_a, angle_b = (
        se3.rotation_angle(np.swapaxes(R[:-1], 1, 2) @ R[1:])
        for R in (pairs.poses_a[:, :3, :3], pairs.poses_b[:, :3, :3]))
    apart = np.abs(angle_a - angle_b)
    found = np.flatnonzero(apart > max(_PARTED, _PARTED_USUAL * float(np.median(apart))))
    if not len(found):
        return ()
    k = int(found[apart[found].argmax()])
    pause = (pairs.stamps_ns[k + 1] - pairs.stamps_ns[k]) * 1e-9
    warning = Finding(
        'orientation-jumps', f'the sensors turned apart in {len(found)} steps, the most by '
        f'{np.rad2deg(apart[k]):.3g} deg, {pause:.3g} s from {pairs.stamps_ns[k] * 1e-9:.3f} s: a '
        'SLAM that began anew or closed a loop has another world, and motions across it are '
        'none; use drift_aware, which excludes such steps, or calibrate each part alone',
        {'steps': len(found), 'largest_deg': float(np.rad2deg(apart[k]))})
    return (warning,)


def _turns(pairs: PosePairs) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield (K, 3) turns of a and of b over each lag that has enough large ones."""
    for lag in lag_grid(pairs.stamps_ns, _LAGS):
        motions = thinned_to(select_motions(pairs, f'B{lag}'), _MOTIONS)
        turn_a, turn_b = (se3.log_so3(moved[:, :3, :3]) for moved in (motions.A, motions.B))
        size = _size(turn_a, turn_b)
        large = (size > _LEAST_TURN) & (size < _LARGEST_TURN)
        if large.sum() >= _LEAST_TURNS:
            yield turn_a[large], turn_b[large]


def _least_disagreement(turns: Sequence[tuple[FloatArray, FloatArray]]) -> float:
    """Return the disagreement with the best rotation between the sensors."""
    return _usual([_disagreement(turn_a, turn_b @ se3.nearest_rotation(turn_a.T @ turn_b).T)
                   for turn_a, turn_b in turns])


def _usual(disagreements: Sequence[float]) -> float:
    """Return the disagreement that counts, of those over each lag: the second smallest.

    Short turns are those in which noise is large, long ones those with jumps in them. But one lag
    alone may agree by chance: about one axis, half of all turns have the right sign.
    """
    ascending = sorted(disagreements)
    return ascending[1] if len(ascending) > _TOO_FEW_LAGS else ascending[0]


def _size(turn_a: FloatArray, turn_b: FloatArray) -> FloatArray:
    """Return the (K,) root mean square of the two angles of (K, 3) turns."""
    squares = np.sum(turn_a**2, axis=1) + np.sum(turn_b**2, axis=1)
    root: FloatArray = np.sqrt(squares / 2)
    return root


def _disagreement(turn_a: FloatArray, turn_b: FloatArray) -> float:
    """Return the median disagreement of (K, 3) turns, both in the axes of a."""
    difference = np.sum((turn_a - turn_b)**2, axis=1)
    return float(np.median(difference / (2 * _size(turn_a, turn_b)**2)))
