# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether one extrinsic and one scale hold along a whole drive.

A mount that moves, or a monocular SLAM that restarts with another scale, makes two extrinsics in
one drive. A solver returns a value in between with a small covariance. The drive is split into
parts. A change is a step at a boundary of two parts, or linear in time. For each of them and each
of seven unknowns the change is estimated by least squares over the parts, and

    t = change / std,    std^2 = f P,    f = u' W u / tr(W C),

where P is the variance from the information of the parts, and f the ratio of the scatter of their
scores u of that unknown to the covariance C of the scores. W is Bartlett's kernel, for correlated
neighbours. Without a change, t has Student's distribution with ``tr(W C)^2 / tr(W C W C)`` degrees
of freedom. The limit is its quantile at the one false-alarm probability of the package, divided by
the number of changes and unknowns. Noise that is correlated over more than a few parts has heavier
tails; docs/uncertainty.md has the measured rates. The covariance of the answer cannot be used
instead: a change enlarges it, too.

F. E. Satterthwaite, "An approximate distribution of estimates of variance components", Biometrics
Bulletin 2(6), 1946, doi:10.2307/3002019, for the degrees of freedom of a quadratic form.
"""

from __future__ import annotations

import numpy as np

from trajectory_calibration.assessment.motion_equations import (
    motions_over,
    MotionVectors,
    student_weights,
)
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.errors import rounded
from trajectory_calibration.geometry import chi_squared
from trajectory_calibration.geometry.se3 import FloatArray, PRECISION

# Parts of the drive, and the fewest on either side of a step.
_PARTS, _LEAST_PARTS = 24, 4
# Unknowns: the rotation and the translation of the pose, the logarithm of the scale.
_UNKNOWNS = 7
# Directions with a smaller share of the information are not compared.
_UNSEEN = 1e-6
# A change matters from this many standard deviations of the answer, or this share of scale.
_MATTERS, _SCALE = 2.0, 0.02

_PART = np.arange(_PARTS)
_STEPS = np.arange(_LEAST_PARTS, _PARTS - _LEAST_PARTS + 1)
# The share of a change in each part (column): steps, and in the last row the linear change.
_PROFILES = np.vstack([_STEPS[:, None] <= _PART, (_PART + 0.5) / _PARTS])
# Scores of neighbouring parts may be correlated.
_KERNEL = np.maximum(1 - np.abs(_PART[:, None] - _PART) / 2, 0.0)


def unsteady(
    T_a_b: FloatArray, covariance: FloatArray, pairs: PosePairs, frames: tuple[str, str],
) -> tuple[Finding, ...]:
    """Return a finding if the pose of b in a, or the scale, changes during the drive.

    ``pairs`` have the scale of b corrected; ``covariance`` is (6, 6) of the answer.
    """
    motions = motions_over(pairs, 2.0, fewest=5 * _PARTS)
    if motions is None:
        return ()
    H, g = _information(T_a_b, motions)
    information = np.diagonal(H.sum(axis=0))
    most = np.maximum.reduceat(information, (0, 3, 6))[[0, 0, 0, 1, 1, 1, 2]]
    # Unobservable directions, such as the height on flat ground, keep almost no information.
    unit = np.sqrt(np.maximum(np.where(information > _UNSEEN**2 * most, information, most),
                              np.finfo(float).tiny))
    H, g = H / np.outer(unit, unit), g / unit
    # Column k projects scores on unknown k, the others being estimated.
    along = _inverse(H.sum(axis=0))
    changes = [(size / unit, ratio) for size, ratio in (
        _change(H, g, along, profile) for profile in _PROFILES)]
    std = np.sqrt(np.diag(covariance))[[3, 4, 5, 0, 1, 2]]
    least = np.append(_MATTERS * np.maximum(std, PRECISION), _SCALE)
    excess = [np.where(np.abs(size) > least, ratio, 0.0).max() for size, ratio in changes]
    found = int(np.argmax(excess))
    if excess[found] < 1:
        return ()
    size, ratio = changes[found]
    size = np.where(ratio > 1, size, 0.0)
    turned, moved = float(np.linalg.norm(size[:3])), float(np.linalg.norm(size[3:6]))
    scaled = float(np.expm1(size[6]))
    by = ' and '.join(text for text, value in (
        (f'{rounded(np.rad2deg(turned))} deg', turned), (f'{rounded(moved)} m', moved),
        (f'{scaled:+.1%} in scale', scaled)) if value)
    question = (f'did {frames[0]} or {frames[1]} move on its mount' if turned or moved else
                f'did the SLAM of {frames[1]} restart with another scale')
    first = len(motions) * (_STEPS[found] if found < len(_STEPS) else _PARTS // 2) // _PARTS
    since_s = float(pairs.stamps_ns[motions.i[first]] - pairs.stamps_ns[0]) * 1e-9
    what = (f'the first {since_s:.0f} s and the rest of the drive differ by {by}'
            if found < len(_STEPS) else f'the answer changes steadily, by {by} over the drive')
    return (Finding(
        'extrinsic-unsteady', f'{what}: {question}? Calibrate the parts separately',
        {'at_s': since_s, 'turned_deg': float(np.rad2deg(turned)), 'moved_m': moved,
         'scale_change': scaled}),)


def _information(T_a_b: FloatArray, motions: MotionPairs) -> tuple[FloatArray, FloatArray]:
    """Return the (P, 7, 7) information and (P, 7) scores of the parts, about one common answer."""
    vectors = MotionVectors.by(motions.A, motions.B)
    jacobians, at_answer = vectors.jacobians(T_a_b), vectors.residuals(T_a_b)
    residuals = list(at_answer)
    parts = np.arange(len(motions)) * _PARTS // len(motions)
    H, g = np.zeros((_PARTS, _UNKNOWNS, _UNKNOWNS)), np.zeros((_PARTS, _UNKNOWNS))
    for _ in range(6):
        H[:], g[:] = 0.0, 0.0
        for J, residual, remaining in zip(jacobians, at_answer, residuals, strict=True):
            weighted = student_weights(remaining)[:, None, None] * J
            np.add.at(H, parts, np.swapaxes(weighted, 1, 2) @ J)
            np.add.at(g, parts, np.einsum('kij,ki->kj', weighted, residual))
        off = _inverse(H.sum(axis=0)) @ g.sum(axis=0)
        residuals = [residual - J @ off for J, residual in zip(jacobians, at_answer, strict=True)]
    return H, g


def _change(
    H: FloatArray, g: FloatArray, along: FloatArray, profile: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the (7,) change of a (P,) profile, and its ``|t|`` relative to the limit.

    ``along`` is (7, 7), the inverse of the information of all parts.
    """
    # The value at the start, and the change.
    columns = np.stack([np.ones(_PARTS), profile])
    P = _inverse(np.einsum('ip,jp,pab->iajb', columns, columns, H).reshape(
        2 * _UNKNOWNS, 2 * _UNKNOWNS))
    solved = (P @ (columns @ g).ravel()).reshape(2, _UNKNOWNS)
    u = (g - np.einsum('pab,pb->pa', H, columns.T @ solved)) @ along
    H_along = np.moveaxis(H @ along, 2, 0)
    own = np.einsum('ak,kpa->kp', along, H_along)
    through = np.einsum('ip,kpa->kpia', columns, H_along).reshape(_UNKNOWNS, _PARTS, -1)
    C = own[:, :, None] * np.eye(_PARTS) - through @ P @ np.swapaxes(through, 1, 2)
    WC = _KERNEL @ C
    tiny = np.finfo(float).tiny
    expected = np.maximum(np.trace(WC, axis1=1, axis2=2), tiny)
    freedom = expected**2 / np.maximum(np.einsum('kpq,kqp->k', WC, WC), tiny)
    scatter = np.einsum('pk,pq,qk->k', u, _KERNEL, u) / expected
    std = np.sqrt(np.maximum(scatter * np.diag(P)[_UNKNOWNS:], tiny))
    probability = chi_squared.FALSE_ALARM / (len(_PROFILES) * _UNKNOWNS)
    limit = [chi_squared.student_quantile(max(1, int(n)), probability) for n in freedom]
    return solved[1], np.abs(solved[1]) / std / limit


def _inverse(H: FloatArray) -> FloatArray:
    """Return the pseudo-inverse of symmetric matrices."""
    return np.asarray(np.linalg.pinv(H, rcond=_UNSEEN, hermitian=True), dtype=np.float64)
