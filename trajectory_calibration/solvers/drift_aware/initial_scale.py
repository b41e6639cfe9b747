"""The unit of length of b, where it is another one than that of a.

A single camera has no scale, and files come in millimetres. A scale that far from one is no
error to be weighed against drift, but has to be known before anything fits. How far each sensor
moved does not tell it: a sensor on a long arm moves far where the other turns on the spot. With
the extrinsic in the equations it does: ``(R_A - I) t - s R t_B = -t_A`` is linear in t and s, and
R aligns the turns and what remains of the moves.
"""

from __future__ import annotations

import numpy as np

from trajectory_calibration.data.motion_pairs import MotionPairs, select_motions
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.geometry import se3

# Lengths of the motions, in shares of the drive: long ones drown noise, short ones have few jumps.
_LENGTHS = (0.1, 0.03, 0.01, 0.0)
_MOTIONS = 1000
_ITERATIONS = 10

# A scale within this factor of one is left to the likelihood; beyond, it must be this many
# standard deviations from one.
_ANOTHER_UNIT = 1.5
_SIGNIFICANT = 6.0

# What may be left over, as a share of what the scale explains, squared metres both.
_UNEXPLAINED = 0.1


def unit_of_b(pairs: PosePairs) -> float:
    """Return metres of a per unit of b where that is clearly not one, else 1."""
    lags = {max(1, round(share * len(pairs))) for share in _LENGTHS}
    every = -(-len(pairs) // _MOTIONS)
    found = [_scale(select_motions(pairs, f'B{lag}').picked(slice(None, None, every)),
                    max(1.0, lag / every)) for lag in lags]
    scale, deviation = min(found, key=lambda item: item[1] / item[0])
    another = max(scale, 1 / scale) > _ANOTHER_UNIT
    return scale if another and abs(scale - 1) > _SIGNIFICANT * deviation else 1.0


def _scale(motions: MotionPairs, sharing: float) -> tuple[float, float]:
    """Return the scale at which the motions agree, and its standard deviation.

    So many motions share each pose: ``sharing`` of them count as one.
    """
    turn_a, turn_b = (se3.log_so3(motion[:, :3, :3]) for motion in (motions.A, motions.B))
    move_a, move_b = motions.A[:, :3, 3], motions.B[:, :3, 3]
    swing = motions.A[:, :3, :3] - np.eye(3)
    tiny = np.finfo(float).tiny
    turns = turn_a.T @ turn_b / max(float(np.linalg.norm(turn_a) * np.linalg.norm(turn_b)), tiny)
    weight = np.ones(len(motions))
    t = np.zeros(3)
    for _ in range(_ITERATIONS):
        # Of a as b's unit has it, but for the size.
        moved = move_a + swing @ t
        moves = (weight[:, None] * moved).T @ move_b
        size = np.sqrt(np.sum(weight @ moved**2) * np.sum(weight @ move_b**2))
        R = se3.nearest_rotation(turns + moves / max(float(size), tiny))
        columns = np.concatenate([swing, -(move_b @ R.T)[:, :, None]], axis=2)
        root = np.sqrt(weight)[:, None]
        rows = (root[:, :, None] * columns).reshape(-1, 4)
        found = np.linalg.lstsq(rows, -(root * move_a).reshape(-1), rcond=1e-9)[0]
        t = found[:3]
        residual = np.linalg.norm(columns @ found + move_a, axis=1)
        # Least absolute values: a jump in every third motion must not decide.
        weight = 1 / np.maximum(residual, 1e-6 * np.linalg.norm(move_a, axis=1).max() + tiny)
        weight /= weight.max()
    scale = float(found[3])
    variance = float(np.linalg.pinv(rows.T @ rows, rcond=1e-12, hermitian=True)[3, 3])
    left_over = float(root[:, 0]**2 @ residual**2)
    # Of b's moves 1 / variance is not explained by turning about a point, any scale of which t
    # would make up for. Where no turn tells t, s is what it is without.
    if not (scale > 0 and left_over * variance < _UNEXPLAINED * scale**2):
        return 1.0, np.inf
    return scale, float(np.sqrt(variance * left_over / len(motions) * sharing))
