# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Consistency of the data: the extrinsic from quarters of the drive and from time scales.

One weighted Gauss-Newton step from the answer, with motions of one duration: cheap, and near the
answer as accurate as a solver. The information matrix is the product of a Jacobian from a and one
from b, as in ``assessment.excitation``, so that rotation noise is not counted as excitation.
Standard deviations include the correlation of overlapping motions (Newey and West 1987).
"""

from __future__ import annotations

from dataclasses import dataclass
import itertools

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.assessment.observability import Observability, UNOBSERVED
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.answer import TO_DEGREES
from trajectory_calibration.outputs.report.tracks import Indices, Tracks
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.solvers.solution import UNOBSERVED_STD

# Time scales, seconds, if the drive is long enough.
TIME_SCALES_S = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
QUARTERS = 4

# Motions of one time scale: the most that are used, and the fewest for an estimate.
_MOTIONS, _LEAST_MOTIONS, _LEAST_INDEPENDENT = 1500, 12, 6
# Inflation of the variance for few independent motions, as in Student's distribution.
_SMALL_SAMPLE = 4.0
# Largest duration of a motion, relative to its time scale.
_LONGEST = 2.0
# Smallest length of the drive, in time scales.
_LEAST_REPEATS = 6
# Motions with normalised residuals above this many medians are undetected jumps.
_OUTLIER = 6.0
# Information, 1/m^2 or 1/rad^2, that fixes an unobservable direction.
_HELD = 1e12
# Points of the curve of standard deviation over time.
_CURVE = 24
# A part contradicts the answer beyond this many standard deviations and this share of the limit
# of 'weak'.
_FAR, _NOTABLE = 3.0, 0.2


@dataclass(frozen=True, eq=False)
class Parts:
    """Extrinsics from N parts of the data minus the answer: x, y, z of a in metres, degrees.

    ``names`` are 'Q1' to 'Q4' and the time scales in seconds; empty for a short drive. ``values``
    and ``std`` (N, 6) are NaN without an estimate. ``known`` (N, 6): the part determines the
    component; ``far`` (N, 6): it contradicts the answer, whose standard deviations are ``own``
    (6,). ``unobserved`` (6,): the motion does not determine the component. ``growth_std`` (T, 6)
    are standard deviations from the first ``growth_s`` (T,) seconds; NaN if unobserved.
    """

    names: tuple[str, ...]
    values: FloatArray
    std: FloatArray
    known: NDArray[np.bool_]
    far: NDArray[np.bool_]
    own: FloatArray
    unobserved: NDArray[np.bool_]
    growth_s: FloatArray
    growth_std: FloatArray


@dataclass(frozen=True, eq=False)
class _Scores:
    """Linearised motions of one time scale: (M, 6) scores and (M, 6, 6) information.

    ``start`` (M,) are the first poses; ``overlap`` is the number of motions that overlap.
    """

    start: Indices
    score: FloatArray
    information: FloatArray
    overlap: int


def compare_parts(tracks: Tracks, result: CalibrationResult) -> Parts:
    """Estimate the extrinsic from quarters and time scales of the tracks."""
    held = _held(result.observability)
    by_scale: list[tuple[float, _Scores]] = []
    for seconds, lag in time_scales(tracks):
        if len(tracks) < _LEAST_REPEATS * lag:
            continue
        scores = _scores(tracks, result.T_a_b, lag)
        if len(scores.start) >= _LEAST_MOTIONS:
            by_scale.append((seconds, scores))
    own = np.zeros(6) if result.std is None else TO_DEGREES * result.std
    unobserved = np.array(list(result.observability.status.values())) == UNOBSERVED
    solved = [_solve(scores, held) for _, scores in by_scale]
    std = np.array([each for _, each in solved])
    if np.isnan(std).all():
        none = np.zeros((0, 6))
        return Parts((), none, none, none > 0, none > 0, own, unobserved, np.zeros(0), none)
    # White noise dominates short time scales, and long ones have few independent motions.
    best = by_scale[int(np.nanargmin(np.sum(np.log(std), axis=1)))][1]
    edges = np.linspace(0, len(tracks), QUARTERS + 1)
    quarters = [_solve(best, held, (best.start >= low) & (best.start < high))
                for low, high in itertools.pairwise(edges)]
    values, std = np.array(quarters + solved).swapaxes(0, 1) * TO_DEGREES
    config = result.config
    limit = np.repeat([config.unobserved_translation, config.unobserved_rotation], 3)
    known = np.isfinite(std) & (std < limit) & ~unobserved
    # Statistically significant, and large enough to matter.
    notable = _NOTABLE * np.repeat([config.weak_translation, config.weak_rotation], 3)
    far = known & (np.abs(values) > np.maximum(_FAR * np.hypot(std, own), notable))
    names = (*(f'Q{n + 1}' for n in range(QUARTERS)), *(f'{scale:g}' for scale, _ in by_scale))
    return Parts(names, values, std, known, far, own, unobserved,
                 *_growth(tracks, best, result, held, unobserved))


def lag_of(tracks: Tracks, seconds: float) -> int:
    """Return the lag, in pairs, of a time in seconds; at least one."""
    return max(1, round(seconds / np.median(np.diff(tracks.seconds))))


def time_scales(tracks: Tracks) -> list[tuple[float, int]]:
    """Return the time scales, seconds, with their distinct lags."""
    by_lag: dict[int, float] = {}
    for seconds in TIME_SCALES_S:
        by_lag.setdefault(lag_of(tracks, seconds), seconds)
    return [(seconds, lag) for lag, seconds in by_lag.items()]


def lagged(tracks: Tracks, lag: int, count: int) -> tuple[Indices, Indices]:
    """Return (M,) indices of the first and last poses of at most ``count`` motions of a lag.

    Motions over a jump or a gap are left out.
    """
    broken = ~tracks.usable
    broken[tracks.gaps] = True
    bad = np.concatenate([[0], np.cumsum(broken)])
    duration = tracks.seconds[lag:] - tracks.seconds[:-lag]
    median = lag * np.median(np.diff(tracks.seconds))
    i = np.flatnonzero((bad[:-lag] == bad[lag:]) & (duration <= _LONGEST * median))
    i = i[::max(1, -(-len(i) // count))]
    return i, i + lag


def _jacobian(T_a_b: FloatArray, A: FloatArray, C: FloatArray) -> FloatArray:
    """Return (M, 6, 6): derivatives of ``log(A^-1 C)`` by (dt, dtheta), from the motions C."""
    motion = A.copy()
    motion[:, :3, 3] = C[:, :3, 3]
    # A rotation of b about its origin, as a twist of a, also translates.
    to_twist = np.eye(6)
    to_twist[:3, 3:] = se3.skew(T_a_b[:3, 3])
    return se3.adjoint(se3.inverse(motion)) @ (np.eye(6) - se3.adjoint(C)) @ to_twist


def _scores(tracks: Tracks, T_a_b: FloatArray, lag: int) -> _Scores:
    i, j = lagged(tracks, lag, _MOTIONS)
    if not len(i):
        return _Scores(i, np.zeros((0, 6)), np.zeros((0, 6, 6)), 1)
    A, C, residual = tracks.motions(i, j)
    sigma = tracks.covariance(T_a_b, A, i, j)
    of_a, of_c = _jacobian(T_a_b, A, A), _jacobian(T_a_b, A, C)
    weighted = np.linalg.solve(sigma, np.concatenate([of_a, of_c, residual[:, :, None]], axis=2))
    chi = np.sqrt(np.einsum('ki,ki->k', residual, weighted[:, :, 12]))
    keep = chi <= _OUTLIER * max(np.median(chi), 1e-12)
    mean = 0.5 * (of_a + of_c)
    score = -np.einsum('kji,kj->ki', mean, weighted[:, :, 12])
    information = np.swapaxes(of_c, 1, 2) @ weighted[:, :, :6]
    information = 0.5 * (information + np.swapaxes(information, 1, 2))
    stride = int(i[1] - i[0]) if len(i) > 1 else 1
    return _Scores(i[keep], score[keep], information[keep], max(1, lag // stride))


def _solve(
    scores: _Scores, held: FloatArray, part: slice | NDArray[np.bool_] = slice(None),
) -> tuple[FloatArray, FloatArray]:
    """Return the (6,) step from the answer and its standard deviations, metres and radians."""
    score, information = scores.score[part], scores.information[part]
    # Overlapping motions count once.
    independent = len(score) / scores.overlap
    if len(score) < _LEAST_MOTIONS or independent < _LEAST_INDEPENDENT:
        return np.full(6, np.nan), np.full(6, np.nan)
    inverse = _bounded_inverse(information.sum(axis=0), held)
    step = inverse @ score.sum(axis=0)
    residuals = score - information @ step
    scatter = _long_run(residuals, min(2 * scores.overlap, len(residuals) // 3))
    # The scatter of a few motions is itself uncertain.
    scatter *= 1 + _SMALL_SAMPLE / independent
    covariance = inverse @ (scatter + np.diag(UNOBSERVED_STD**-2.0)) @ inverse
    return step, np.sqrt(np.maximum(np.diagonal(covariance), 0.0))


def _held(observability: Observability) -> FloatArray:
    """Return the (6, 6) information that fixes unobservable directions at the answer.

    Otherwise noise, which tilts an unobservable direction a little, adds metres to the others.
    """
    held = np.zeros((6, 6))
    for item in observability.weak_axes:
        if item.status == UNOBSERVED:
            part = slice(0, 3) if item.kind == 'translation' else slice(3, 6)
            held[part, part] += _HELD * np.outer(item.axis, item.axis)
    return held


def _bounded_inverse(information: FloatArray, held: FloatArray) -> FloatArray:
    """Return the inverse of (6, 6) information with a prior of ``UNOBSERVED_STD`` added."""
    information = information + held
    values, vectors = np.linalg.eigh(UNOBSERVED_STD[:, None] * information * UNOBSERVED_STD)
    root = UNOBSERVED_STD[:, None] * vectors / np.sqrt(np.maximum(values, 0.0) + 1.0)
    return root @ root.T


def _long_run(scores: FloatArray, window: int) -> FloatArray:
    """Return the (6, 6) covariance of the sum of correlated (M, 6) scores (Newey and West)."""
    total = scores.T @ scores
    for lag in range(1, window + 1):
        product = scores[lag:].T @ scores[:-lag]
        total = total + (1 - lag / (window + 1)) * (product + product.T)
    values, vectors = np.linalg.eigh(total)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T


def _growth(
    tracks: Tracks, scores: _Scores, result: CalibrationResult, held: FloatArray,
    unobserved: NDArray[np.bool_],
) -> tuple[FloatArray, FloatArray]:
    """Return (T,) times and (T, 6) standard deviations; the last ones are those of the answer."""
    running = np.cumsum(scores.information, axis=0)
    ends = np.unique(np.linspace(len(running) / _CURVE, len(running), _CURVE).astype(np.intp)) - 1
    ends = ends[ends >= 0]
    std = np.array([np.sqrt(np.diagonal(_bounded_inverse(running[end], held))) for end in ends])
    if result.std is not None:
        std *= result.std / np.maximum(std[-1], 1e-300)
    std = np.minimum(std, UNOBSERVED_STD)
    std[:, unobserved] = np.nan
    return tracks.seconds[scores.start[ends]], std * TO_DEGREES
