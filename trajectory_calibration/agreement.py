"""Whether two trajectories belong together at all.

Two sensors on one body turn by the same angle at the same time, wherever they are mounted. A
solver finds the best extrinsic for any two trajectories, also for those of two vehicles, or of
one with clocks that differ by more than was looked for, and its residuals then pass for noise.
The turns tell: where they are large, half of them at least must agree well.
"""

from __future__ import annotations

import numpy as np

from trajectory_calibration import se3
from trajectory_calibration.association import PosePairs
from trajectory_calibration.errors import MotionError
from trajectory_calibration.excitation import thinned
from trajectory_calibration.motions import select_motions
from trajectory_calibration.se3 import FloatArray

# Lags that are looked at: short ones have fewer jumps in them, long ones turn farther.
_LAGS = (1, 2, 5, 20, 80)
_MOTIONS = 4000

# Turns, radians, that are compared: larger than noise ever is, and well below half a turn, which
# is the same the other way round. Fewer than this many turns say nothing.
_LEAST_TURN, _LARGEST_TURN = np.deg2rad(10.0), np.deg2rad(150.0)
_LEAST_TURNS = 5

# Squared difference of two turns relative to both, above which they disagree: 0 for equal ones,
# 1 for such as have nothing in common. Median over the turns.
_DISAGREEMENT = 0.05

# Radians, and times the usual, that two sensors turn apart in a step only where one has jumped.
_PARTED, _PARTED_USUAL = np.deg2rad(10.0), 20.0


def require_agreement(T_a_b: FloatArray, pairs: PosePairs, frame_a: str, frame_b: str) -> None:
    """Raise MotionError where the sensors turned, but not together.

    Not judged where they hardly turned: that is for the observability to say.
    """
    found = [value for lag in _LAGS if (value := _disagreement(T_a_b, pairs, lag)) is not None]
    if found and min(found) > _DISAGREEMENT:
        raise MotionError(
            f'{frame_a} and {frame_b} did not turn together: half of their turns differ by more '
            f'than {np.sqrt(2 * min(found)):.0%}; needed two trajectories of one vehicle '
            'at the same time: check the topics or files, the order of their quaternions (x, y, '
            'z, w), and the clocks (max_time_offset is how far apart they may be)')


def parted_steps(pairs: PosePairs) -> tuple[str, ...]:
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
    warning = (
        f'the sensors turned apart in {len(found)} steps, the most by '
        f'{np.rad2deg(apart[k]):.3g} deg, {pause:.3g} s from {pairs.stamps_ns[k] * 1e-9:.3f} s: a '
        'SLAM that began anew or closed a loop has another world, and motions across it are '
        'none; use drift_aware, which sets such steps aside, or calibrate each part alone')
    return (warning,)


def _disagreement(T_a_b: FloatArray, pairs: PosePairs, lag: int) -> float | None:
    """Return the median disagreement of the turns over a lag, or None where they are too few."""
    if lag > len(pairs) // 2:
        return None
    motions = thinned(select_motions(pairs, f'B{lag}'), _MOTIONS)
    turn_a = se3.log_so3(motions.A[:, :3, :3])
    turn_b = se3.log_so3(motions.B[:, :3, :3]) @ T_a_b[:3, :3].T
    size = np.hypot(*(np.linalg.norm(turn, axis=1) for turn in (turn_a, turn_b))) / np.sqrt(2)
    large = (size > _LEAST_TURN) & (size < _LARGEST_TURN)
    if large.sum() < _LEAST_TURNS:
        return None
    difference = np.sum((turn_a[large] - turn_b[large])**2, axis=1)
    return float(np.median(difference / (2 * size[large]**2)))
