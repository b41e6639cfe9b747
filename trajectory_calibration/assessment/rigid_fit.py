# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A fast fit of one extrinsic to two trajectories, to check that they are of one rigid body.

Relative motions over a few lags; the rotation by Wahba's problem, lever arm and scale by least
squares, reweighted against outliers. It takes milliseconds, so that other readings of the poses
can be tried (inverted, another quaternion order, mirrored). It is no solver and has no covariance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from trajectory_calibration.assessment.motion_equations import MotionVectors
from trajectory_calibration.data.motion_pairs import lag_grid
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# Lags, seconds; those first over which most recordings fit. Beyond the first of them two sensors
# fit even with clocks seconds apart. Residuals at shorter lags must then be errors: they must not
# grow faster with the lag than independent errors by this factor.
LAGS_S = (2.0, 0.5, 0.2, 0.1, 8.0, 32.0)
NOT_BY_NOISE = 1.5

# Rounding, squared metres or radians.
_TINY = 1e-24

# One body: over at least one lag, the residuals are below these shares of the motion.
ONE_BODY = {'rotation': 0.1, 'translation': 0.2}


# A function that converts (K, 4, 4) poses to the intended ones; None: as they are.
Read = Callable[[FloatArray], FloatArray] | None


@dataclass(frozen=True)
class RigidFit:
    """The residuals of the best extrinsic over one lag.

    Attributes
    ----------
    lag, lag_s : the lag in poses, and in seconds as in ``LAGS_S``.
    rotation : median rotation of a motion, radians.
    rotation_residual : median residual, radians.
    rotation_share : residual / rotation, median over the quarter with the largest rotations.
    translation_residual : median residual, metres.
    translation_share : residual / translation, median over the longer half of the motions.

    """

    lag: int
    lag_s: float
    rotation: float
    rotation_residual: float
    rotation_share: float
    translation_residual: float
    translation_share: float

    @property
    def one_body(self) -> bool:
        """Return whether the two trajectories belong to one rigid body."""
        return self.misfit < 1

    @property
    def misfit(self) -> float:
        """Return the larger of both shares, relative to the limits of one body."""
        return max(self.rotation_share / ONE_BODY['rotation'],
                   self.translation_share / ONE_BODY['translation'])


def fits(
    pairs: PosePairs, read_a: Read = None, read_b: Read = None,
    seconds: Sequence[float] = LAGS_S,
) -> Iterator[RigidFit]:
    """Yield the fit over each lag that has enough motions."""
    lags: dict[int, float] = {}
    for lag_s in seconds:
        lags.setdefault(lag_grid(pairs.stamps_ns, (lag_s,), 1.0)[0], lag_s)
    for lag, lag_s in lags.items():
        if lag <= len(pairs) // 4:
            found = _fit(*_motions(pairs, lag, read_a, read_b), lag, lag_s)
            if found is not None:
                yield found


def best_fit(
    pairs: PosePairs, read_a: Read = None, read_b: Read = None,
    seconds: Sequence[float] = LAGS_S,
) -> RigidFit | None:
    """Return the first fit of one body, or the best one; None if there are too few motions."""
    found: list[RigidFit] = []
    for fit in fits(pairs, read_a, read_b, seconds):
        found.append(fit)
        if fit.one_body and (fit.lag_s <= LAGS_S[0] or max(
                growth(found, 'rotation'), growth(found, 'translation')) <= NOT_BY_NOISE):
            return fit
    # None of these is one body, however long the lag.
    return min((fit for fit in found if not fit.one_body),
               key=lambda fit: fit.misfit, default=None)


def rotation_share(pairs: PosePairs, lag: int, R_a_b: FloatArray) -> float:
    """Return the ``rotation_share`` of a (3, 3) rotation over a lag."""
    return _rotation_share(MotionVectors.by(*_motions(pairs, lag)), R_a_b)


def growth(found: Sequence[RigidFit], what: str) -> float:
    """Return how much faster the residuals grow with the lag than independent errors do.

    Errors of poses do not grow with the lag, errors of steps grow with its square root, and the
    residuals of two separate bodies grow with the lag itself. ``what`` is 'rotation' or
    'translation'. Lags whose share is below the limit of one body do not count.
    """
    ascending = sorted(found, key=lambda item: item.lag)
    residuals = [float(getattr(item, f'{what}_residual')) for item in ascending]
    factor = 1.0
    for k, item in enumerate(ascending):
        likely = min((np.sqrt(item.lag / other.lag) * size
                      for other, size in zip(ascending[:k], residuals[:k], strict=True)),
                     default=0.0)
        if likely > 0 and getattr(item, f'{what}_share') > ONE_BODY[what]:
            factor = max(factor, residuals[k] / likely)
    return factor


def _motions(
    pairs: PosePairs, lag: int, read_a: Read = None, read_b: Read = None,
) -> tuple[FloatArray, FloatArray]:
    """Return (K, 4, 4) motions of a and b over a lag, at most 300."""
    count = len(pairs) - lag
    i = np.arange(0, count, max(1, -(-count // 300)))
    found = []
    for read, poses in ((read_a, pairs.poses_a), (read_b, pairs.poses_b)):
        start, end = ((read(part) if read else part) for part in (poses[i], poses[i + lag]))
        found.append(se3.inverse(start) @ end)
    return found[0], found[1]


def _fit(A: FloatArray, B: FloatArray, lag: int, lag_s: float) -> RigidFit | None:
    vectors = MotionVectors.by(A, B)
    angle2 = np.maximum(np.sum(vectors.phi_a**2, axis=1), np.sum(vectors.phi_b**2, axis=1))
    usable = angle2 < se3.LARGEST_ROTATION**2
    if usable.sum() < 5:
        return None
    vectors, angle2 = MotionVectors(*(item[usable] for item in vectors)), angle2[usable]
    length2 = np.sum(vectors.t_a**2, axis=1)
    weights = [np.full(len(size), 1 / max(float(np.mean(size)), _TINY))
               for size in (angle2, length2)]
    T_a_b, scale = np.eye(4), 1.0
    for k in range(8):
        alone = k < 2
        if alone:
            # With rotations about one axis only, the translations determine the rest.
            arm = vectors.R_a_minus_I @ T_a_b[:3, 3]
            T_a_b[:3, :3] = se3.nearest_rotation(
                _correlation(vectors.phi_a, vectors.phi_b, weights[0])
                + _correlation(vectors.t_a + arm, vectors.t_b, weights[1]))
        # Later all unknowns together: alternating converges slowly for heading and lever arm.
        free = slice(3, 7) if alone else slice(0, 7)
        H, g = np.zeros((7, 7)), np.zeros(7)
        for J, residuals, weight, size in zip(
                vectors.jacobians(T_a_b, scale), vectors.residuals(T_a_b, scale), weights,
                (angle2, length2), strict=True):
            rows = (weight[:, None, None] / max(float(weight @ size), _TINY) * J).reshape(-1, 7)
            H += rows.T @ J.reshape(-1, 7)
            g += rows.T @ residuals.ravel()
        step = np.zeros(7)
        step[free] = np.linalg.pinv(H[free, free], rcond=1e-10, hermitian=True) @ g[free]
        T_a_b[:3, :3] = se3.exp_so3(step[:3]) @ T_a_b[:3, :3]
        T_a_b[:3, 3] += step[3:6]
        scale *= 1 + float(step[6])
        squares = [np.sum(residuals**2, axis=1) for residuals in vectors.residuals(T_a_b, scale)]
        weights = [1 / (square + np.median(square) + _TINY) for square in squares]
    of_rotation, of_translation = squares
    if scale <= 0:
        of_translation = length2
    rotation = 0.5 * np.sum(vectors.phi_a**2 + vectors.phi_b**2, axis=1)
    longer = length2 >= np.median(length2)
    return RigidFit(
        lag, lag_s, float(np.sqrt(np.median(rotation))), float(np.sqrt(np.median(of_rotation))),
        _rotation_share(vectors, T_a_b[:3, :3]), float(np.sqrt(np.median(of_translation))),
        float(np.sqrt(np.median(of_translation[longer] / (length2[longer] + _TINY)))))


def _rotation_share(vectors: MotionVectors, R: FloatArray) -> float:
    """Return the median of residual / rotation over the quarter with the largest rotations."""
    angle2 = 0.5 * np.sum(vectors.phi_a**2 + vectors.phi_b**2, axis=1)
    most = angle2 >= np.quantile(angle2, 0.75)
    squares = np.sum((vectors.phi_a - vectors.phi_b @ R.T)**2, axis=1)
    return float(np.sqrt(np.median(squares[most] / (2 * angle2[most] + _TINY))))


def _correlation(a: FloatArray, b: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the (3, 3) weighted correlation of (K, 3) vectors, between -1 and 1.

    Normalised, so that rotations and translations count alike whatever their noise.
    """
    weighted = a * weights[:, None]
    most = np.sqrt(np.sum(weighted * a) * float(weights @ np.sum(b**2, axis=1)))
    correlation: FloatArray = weighted.T @ b / max(float(most), _TINY)
    return correlation
