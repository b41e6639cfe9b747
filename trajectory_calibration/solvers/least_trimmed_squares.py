# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The cost of ``dnlo`` for many motions: weights in closed form, the extrinsic by Gram matrices.

    min over X, alpha of  sum alpha |M|^2 + (1 - alpha) c,   0 <= alpha <= 1,  sum alpha >= d M

For a fixed extrinsic the weights are known: a motion is kept if its |M|^2 is below c. If these are
fewer than d M, the d M smallest are kept (least trimmed squares). For fixed weights the extrinsic
follows from the weighted Gram matrix. ``|M|^2`` is a sum of 91
products of the entries of v (see ``quadratic``), so that both steps are one product with a
constant (91, M) matrix, for all candidates at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from trajectory_calibration.config.prior import Prior
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers import quadratic

# Most steps of either way down.
_MAX_STEPS = 500


@dataclass(frozen=True, eq=False)
class Candidates:
    """Extrinsics (S, 4, 4) with the weights (S, M) that are best for each, and costs (S,)."""

    T_a_b: FloatArray
    weights: FloatArray
    cost: FloatArray

    def __getitem__(self, keep: Any) -> Candidates:
        return Candidates(self.T_a_b[keep], self.weights[keep], self.cost[keep])


@dataclass(frozen=True, eq=False)
class TrimmedCost:
    """The cost over the motions, with its two minimisers.

    Attributes
    ----------
    features : (91, M), see ``quadratic.features``.
    c : cost of rejecting a motion.
    least : the least sum of weights, d M.
    prior : fixes directions that the kept motions do not determine.

    """

    features: FloatArray
    c: float
    least: float
    prior: Prior | None = None

    @classmethod
    def of(
        cls, motions: MotionPairs, c: float, min_inliers: float, prior: Prior | None = None,
    ) -> TrimmedCost:
        """Return the cost; at least the share ``min_inliers`` of the motions must be kept."""
        features = [quadratic.features(motions.A[part], motions.B[part])
                    for part in quadratic.parts(motions)]
        return cls(np.concatenate(features, axis=1), c, min_inliers * len(motions), prior)

    def thinned(self, count: int) -> TrimmedCost:
        """Return the cost over every n-th motion, at most ``count`` of them."""
        n = -(-self.features.shape[1] // count)
        features = np.ascontiguousarray(self.features[:, ::n])
        share = features.shape[1] / self.features.shape[1]
        return TrimmedCost(features, self.c, share * self.least, self.prior)

    def gram(self, weights: FloatArray) -> FloatArray:
        """Return the (..., 13, 13) Gram matrices of (..., M) weights."""
        return quadratic.form(weights @ self.features.T)

    def squares(self, T_a_b: FloatArray) -> FloatArray:
        """Return ``|M|^2`` (S, M) for (S, 4, 4) extrinsics."""
        v = quadratic.monomials(T_a_b)
        i, j = quadratic.UPPER
        return np.maximum((v[:, i] * v[:, j]) @ self.features, 0.0)

    def weigh(self, T_a_b: FloatArray) -> Candidates:
        """Return (S, 4, 4) extrinsics with their best weights, in closed form."""
        squares = self.squares(T_a_b)
        weights = (squares < self.c).astype(np.float64)
        whole = int(self.least)
        for s in np.flatnonzero(weights.sum(axis=1) < self.least):
            order = np.argpartition(squares[s], min(whole, squares.shape[1] - 1))
            weights[s] = 0.0
            weights[s, order[:whole]] = 1.0
            if self.least > whole:
                weights[s, order[whole]] = self.least - whole
        cost = np.sum(weights * squares + (1 - weights) * self.c, axis=1)
        return Candidates(T_a_b, weights, cost)

    def alternate(
        self, starts: FloatArray, tolerance: float = quadratic.SETTLED,
    ) -> tuple[Candidates, int]:
        """Alternate weights and extrinsic from (S, 4, 4) starts; return the lowest, and the steps.

        The concentration steps, and the many short and few long starts, of P. J. Rousseeuw, K. Van
        Driessen, "Computing LTS Regression for Large Data Sets", Data Mining and Knowledge
        Discovery 12, 2006, doi:10.1007/s10618-005-0024-4. No step raises the cost.
        """
        found = self.weigh(starts)
        for step in range(1, _MAX_STEPS + 1):
            moved = self.weigh(self.minimum(
                found.weights, found.T_a_b[:, :3, :3], tolerance))
            settled = (moved.weights == found.weights).all() or (
                found.cost - moved.cost <= 1e-13 * found.cost).all()
            found = moved
            # Few steps from every start, then the best of them to the end.
            if step == 3:
                found = found[np.argsort(found.cost, kind='stable')[:3]]
            elif settled:
                break
        return found[[int(np.argmin(found.cost))]], step

    def follow_central_path(self, start: FloatArray) -> tuple[FloatArray, int]:
        """Follow the minimum of the cost with a logarithmic barrier on the weights to zero.

        The path that an interior-point method follows, with the weights eliminated: for a barrier
        mu they solve ``|M|^2 - c - lambda = mu / alpha - mu / (1 - alpha)``, and lambda is zero or
        what makes the sum of the weights d M. At first all motions have similar weights, which
        avoids the many small minima of the trimmed cost. Returns one extrinsic, (1, 4, 4), and the
        number of steps.
        """
        T_a_b, squares = start[0], self.squares(start)[0]
        mu = max(float(squares.mean()), self.c)
        steps, multiplier = 0, 0.0
        # At the end weights beside the threshold are decided; going on to 1e-6 doubles the steps
        # and changes nothing.
        while mu > 1e-3 * self.c and steps < _MAX_STEPS:
            weights, multiplier = self._barrier_weights(squares, mu, multiplier)
            T_a_b = quadratic.newton_step(self.gram(weights), T_a_b, len(weights))
            squares = self.squares(T_a_b[None])[0]
            mu *= 0.6
            steps += 1
        return T_a_b[None], steps

    def _barrier_weights(
        self, squares: FloatArray, mu: float, multiplier: float,
    ) -> tuple[FloatArray, float]:
        """Return the (M,) weights, and lambda; its last value is where the search begins."""
        excess = squares - self.c
        low, high = 0.0, float(squares.max()) + 1e3 * mu
        for _ in range(60):
            weights, slope = _barrier_weight(excess - multiplier, mu)
            missing = self.least - float(weights.sum())
            if abs(missing) <= 1e-6 * self.least or (
                    multiplier == 0.0 and missing < 0):
                break
            low, high = (multiplier, high) if missing > 0 else (low, multiplier)
            multiplier += missing / max(float(slope.sum()), np.finfo(float).tiny)
            if not low < multiplier < high:
                # A step that leaves the bracket: to the bound itself where that is zero.
                multiplier = 0.0 if multiplier <= 0.0 == low else 0.5 * (low + high)
        return weights, multiplier

    def minimum(
        self, weights: FloatArray, starts: FloatArray | None = None,
        tolerance: float = quadratic.SETTLED,
    ) -> FloatArray:
        """Return (S, 4, 4) minima for (S, M) weights; starts (S, 3, 3), linear ones if omitted."""
        G = quadratic.held_translation(self.gram(weights), self.prior)
        if starts is None:
            starts = np.array([quadratic.linear_start(form) for form in G])
        R = quadratic.minimise_rotations(G, starts, tolerance)[0]
        return se3.from_rotation_translation(R, quadratic.best_translation(G, R))


def _barrier_weight(excess: FloatArray, mu: float) -> tuple[FloatArray, FloatArray]:
    """Return the root in (0, 1) of ``excess = mu / alpha - mu / (1 - alpha)``, minus its slope."""
    # In a form without cancellation for large and for vanishing excess.
    root = np.sqrt(excess**2 + 4 * mu**2)
    sum_ = root + 2 * mu
    return 0.5 - excess / (2 * sum_), mu / (root * sum_)
