# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether one extrinsic and one scale hold along a whole drive.

A mount that moves, or a monocular SLAM that begins anew with another scale, leaves two answers in
one drive; a solver gives something between them and calls it sure. The drive is cut into parts,
and for each cut between them the pose and the scale before are compared with those after, by what
the parts of either side scatter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.motion_pairs import lag_grid, select_motions
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.errors import rounded
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# Seconds of a motion, motions in that time and in all, and parts of the drive.
_LAG_S, _OVERLAPPING, _MOTIONS, _PARTS = 2.0, 4, 2000, 12
# Motions that a part needs.
_FEWEST = 10
# Longer ones, in terms of the usual, reach across gaps; larger turns (radians) flip their axis.
_LONG, _LARGEST_TURN = 2.5, 2.6
# Unknowns: the rotation and the translation of the pose, the logarithm of the scale.
_UNKNOWNS = 7
_ROUNDS, _FREEDOM = 6, 4.0
# Directions with a smaller share of the information than this are not compared.
_UNSEEN = 1e-6
# The statistic is one on average where all is well. Over 20 real pairs it reaches 6, where a
# monocular SLAM changes its scale by 4 % on the way; mounts that moved by 2 deg give 20 to 270.
_UNSTEADY = 12.0
# Standard deviations of one unknown that name it, and of the answer that matter.
_NAMED, _MATTERS = 4.0, 2.0
# The same of the scale, and what is rounding, radians and metres.
_SCALE, _ROUNDING = 0.01, 1e-6


class _Change(NamedTuple):
    """The cut of a drive between the parts that differ most.

    ``statistic``; ``part``, the first one behind it; (7,) ``step`` and its ``std``.
    """

    statistic: float
    part: int
    step: FloatArray
    std: FloatArray


def unsteady(
    T_a_b: FloatArray, covariance: FloatArray | None, pairs: PosePairs, frames: tuple[str, str],
) -> tuple[Finding, ...]:
    """Return a finding where the pose of b in a, or the scale, changes during the drive.

    ``pairs`` have the scale of b corrected; ``covariance`` is (6, 6) of the answer.
    """
    if covariance is None:
        return ()
    (lag,) = lag_grid(pairs.stamps_ns, (_LAG_S,), 1.0)
    count = min(_MOTIONS, _OVERLAPPING * len(pairs) // lag)
    if count < _FEWEST * _PARTS:
        return ()
    motions = select_motions(pairs, f'B{lag}', count)
    time_s = (pairs.stamps_ns[motions.j] - pairs.stamps_ns[motions.i]) * 1e-9
    turn = np.maximum(*(se3.rotation_angle(poses[:, :3, :3]) for poses in (motions.A, motions.B)))
    usable = np.flatnonzero((time_s < _LONG * np.median(time_s)) & (turn < _LARGEST_TURN))
    motions = motions.picked(usable)
    if len(motions) < _FEWEST * _PARTS:
        return ()
    H, g = _equations(T_a_b, motions.A, motions.B)
    change = _largest_change(H, g)
    std = np.sqrt(np.diag(covariance))[[3, 4, 5, 0, 1, 2]]
    size = np.abs(change.step) / change.std
    sure = size > _NAMED
    known = np.append(np.maximum(std, _ROUNDING), _SCALE)
    matters = sure & (np.abs(change.step) > _MATTERS * known)
    if change.statistic < _UNSTEADY or not matters.any():
        return ()
    first = motions.i[change.part * len(motions) // _PARTS]
    since_s = float(pairs.stamps_ns[first] - pairs.stamps_ns[0]) * 1e-9
    turned, moved = (float(np.linalg.norm(np.where(sure, change.step, 0.0)[part]))
                     for part in (slice(0, 3), slice(3, 6)))
    scaled = float(np.expm1(change.step[6])) if sure[6] else 0.0
    by = ' and '.join(text for text, value in (
        (f'{rounded(np.rad2deg(turned))} deg', turned), (f'{rounded(moved)} m', moved),
        (f'{scaled:+.1%} in scale', scaled)) if value)
    question = (f'did {frames[0]} or {frames[1]} move on its mount' if turned or moved else
                f'did the SLAM of {frames[1]} begin anew with another scale')
    return (Finding(
        'extrinsic-unsteady',
        f'the first {since_s:.0f} s and the rest of the drive differ by {by}: {question}? '
        'Calibrate the parts separately',
        {'at_s': since_s, 'turned_deg': float(np.rad2deg(turned)), 'moved_m': moved,
         'scale_change': scaled}),)


def _equations(
    T_a_b: FloatArray, A: FloatArray, B: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return (P, 7, 7) and (P, 7) normal equations of the parts, about one answer.

    Of turns ``log A = R log B`` and of ways ``v_a + (R_A - I) t = s R v_b``, weighted by
    Student's distribution, which jumps hardly move.
    """
    R, t = T_a_b[:3, :3], T_a_b[:3, 3]
    turn_a, turn_b = se3.log_so3(A[:, :3, :3]), se3.log_so3(B[:, :3, :3]) @ R.T
    way_a, way_b = A[:, :3, 3], B[:, :3, 3] @ R.T
    lever = A[:, :3, :3] - np.eye(3)
    nothing = np.zeros((len(A), 3, 1))
    both = (
        (np.concatenate([-se3.skew(turn_b), np.zeros_like(lever), nothing], axis=2),
         turn_a - turn_b),
        (np.concatenate([-se3.skew(way_b), -lever, way_b[:, :, None]], axis=2),
         way_a + lever @ t - way_b))
    left = [residual for _, residual in both]
    parts = np.arange(len(A)) * _PARTS // len(A)
    H, g = np.zeros((_PARTS, _UNKNOWNS, _UNKNOWNS)), np.zeros((_PARTS, _UNKNOWNS))
    for _ in range(_ROUNDS):
        H[:], g[:] = 0.0, 0.0
        for (J, residual), remaining in zip(both, left, strict=True):
            square = np.sum(remaining**2, axis=1)
            variance = max(float(np.median(square)) / 2.37, np.finfo(float).tiny)
            weights = (_FREEDOM + 3) / (_FREEDOM + square / variance) / variance
            weighted = weights[:, None, None] * J
            np.add.at(H, parts, np.swapaxes(weighted, 1, 2) @ J)
            np.add.at(g, parts, np.einsum('kij,ki->kj', weighted, residual))
        off = _inverse(H.sum(axis=0)) @ g.sum(axis=0)
        left = [residual - J @ off for J, residual in both]
    return H, g


def _largest_change(H: FloatArray, g: FloatArray) -> _Change:
    """Return the change at the cut where what is before and behind it differs most."""
    unit = np.sqrt(np.maximum(np.diagonal(H.sum(axis=0)), np.finfo(float).tiny))
    H, g = H / np.outer(unit, unit), g / unit
    of_parts = _inverse(H)
    found = []
    for cut in range(2, _PARTS - 1):
        answers, scatter = [], 0.0
        for side in (slice(0, cut), slice(cut, _PARTS)):
            P = _inverse(H[side].sum(axis=0))
            x = P @ g[side].sum(axis=0)
            answers.append((x, P))
            scatter += sum(float(rest @ of_part @ rest) for of_part, rest in zip(
                of_parts[side], g[side] - H[side] @ x, strict=True))
        # By how much parts scatter more than the noise of single motions lets them.
        inflation = max(scatter / (_UNKNOWNS * (_PARTS - 2)), 1.0)
        step, variance = answers[1][0] - answers[0][0], answers[0][1] + answers[1][1]
        found.append(_Change(
            float(step @ _inverse(variance) @ step) / _UNKNOWNS / inflation, cut,
            step / unit, np.sqrt(np.maximum(np.diag(variance) * inflation, 1e-300)) / unit))
    return max(found, key=lambda change: change.statistic)


def _inverse(H: FloatArray) -> FloatArray:
    """Return the inverse of symmetric matrices in the directions that they say something of."""
    return np.asarray(np.linalg.pinv(H, rcond=_UNSEEN, hermitian=True), dtype=np.float64)
