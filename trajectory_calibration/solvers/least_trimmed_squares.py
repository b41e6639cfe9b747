"""The cost of ``dnlo`` for many motions: weights in closed form, the extrinsic by Gram matrices.

    min over X, alpha of  sum alpha |M|^2 + (1 - alpha) c,   0 <= alpha <= 1,  sum alpha >= d M

For a fixed extrinsic the weights follow: a motion is kept where its |M|^2 is below c, and where
that keeps fewer than d M of them, the d M smallest are kept, which is least trimmed squares. For
fixed weights the extrinsic follows from the weighted Gram matrix. ``|M|^2`` is a sum of 91
products of the entries of v (see ``quadratic``), so that both steps are one product with a
constant (M, 91) matrix, for all candidates at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers import quadratic

# Alternation: few steps from every start, then the best of them to the end.
_SHORT_STEPS = 3
_LONG_STARTS = 3
_MAX_STEPS = 500

# Central path: the barrier shrinks by this factor a step, down to this share of c.
_BARRIER_FACTOR = 0.6
_BARRIER_END = 1e-6

_BISECTIONS = 50

# A kept set whose rotations are this much smaller about one axis than about another (squared)
# cannot carry a step; see quadratic.require_translation for what the user is told.
_SINGULAR = 1e-14

UPPER = np.triu_indices(13)
_TWICE = np.where(UPPER[0] == UPPER[1], 1.0, 2.0)


@dataclass(frozen=True, eq=False)
class Candidates:
    """Extrinsics (S, 4, 4) with the weights (M, S) that are best for each, and costs (S,)."""

    T_a_b: FloatArray
    weights: FloatArray
    cost: FloatArray

    def __getitem__(self, keep: Any) -> Candidates:
        return Candidates(self.T_a_b[keep], self.weights[:, keep], self.cost[keep])


class TrimmedCost:
    """The cost over the motions, with its two ways down.

    Attributes
    ----------
    features : (M, 91), coefficients of ``|M|^2`` in the products v_i v_j, i <= j.
    c : cost of rejecting a motion.
    least : the least sum of weights, d M.
    held : (13, 13) form that is added to every Gram matrix, see ``quadratic.hold``.

    """

    def __init__(self, motions: MotionPairs, c: float, min_inliers: float) -> None:
        self.features = np.empty((len(motions), len(UPPER[0])))
        for start in range(0, len(motions), quadratic.CHUNK):
            part = slice(start, start + quadratic.CHUNK)
            E = quadratic.equations(motions.A[part], motions.B[part])
            G = np.swapaxes(E, 1, 2) @ E
            self.features[part] = G[:, UPPER[0], UPPER[1]] * _TWICE
        self.c = c
        self.least = min_inliers * len(motions)
        self.held = np.zeros((13, 13))

    def gram(self, weights: FloatArray) -> FloatArray:
        """Return the (S, 13, 13) Gram matrices of (M, S) weights."""
        G = np.zeros((weights.shape[1], 13, 13))
        G[:, UPPER[0], UPPER[1]] = (weights.T @ self.features) / _TWICE
        G[:, UPPER[1], UPPER[0]] = G[:, UPPER[0], UPPER[1]]
        return G + self.held

    def squares(self, T_a_b: FloatArray) -> FloatArray:
        """Return ``|M|^2`` (M, S) for (S, 4, 4) extrinsics."""
        v = quadratic.monomials(T_a_b)
        return np.maximum(self.features @ (v[:, UPPER[0]] * v[:, UPPER[1]]).T, 0.0)

    def weigh(self, T_a_b: FloatArray) -> Candidates:
        """Attach the best weights, in closed form, to (S, 4, 4) extrinsics."""
        squares = self.squares(T_a_b)
        weights = (squares < self.c).astype(np.float64)
        whole = int(self.least)
        for s in np.flatnonzero(weights.sum(axis=0) < self.least):
            order = np.argpartition(squares[:, s], min(whole, len(squares) - 1))
            weights[:, s] = 0.0
            weights[order[:whole], s] = 1.0
            if self.least > whole:
                weights[order[whole], s] = self.least - whole
        cost = np.sum(weights * squares + (1 - weights) * self.c, axis=0)
        return Candidates(T_a_b, weights, cost)

    def alternate(self, starts: FloatArray) -> tuple[Candidates, int]:
        """Take turns between weights and extrinsic from (S, 4, 4) starts; keep the lowest.

        The concentration steps, and the many short and few long starts, of P. J. Rousseeuw, K. Van
        Driessen, "Computing LTS Regression for Large Data Sets", Data Mining and Knowledge
        Discovery 12, 2006, doi:10.1007/s10618-005-0024-4. No step raises the cost. Returns the
        candidate of lowest cost and the steps that were taken.
        """
        found = self.weigh(starts)
        for step in range(1, _MAX_STEPS + 1):
            G = self.gram(found.weights)
            solvable = _solvable(G)
            if not solvable.any():
                # Nothing can move; the caller tests the kept motions and names the direction.
                break
            found = found[solvable]
            moved = self.weigh(_minimise_each(G[solvable], found.T_a_b))
            settled = (moved.weights == found.weights).all() or (
                found.cost - moved.cost <= 1e-13 * found.cost).all()
            found = moved
            if step == _SHORT_STEPS:
                found = found[np.argsort(found.cost, kind='stable')[:_LONG_STARTS]]
            elif settled:
                break
        return found[[int(np.argmin(found.cost))]], step

    def follow_central_path(self, start: FloatArray) -> tuple[FloatArray, int]:
        """Follow the minimum of the cost with a logarithmic barrier on the weights down to zero.

        The path that an interior-point method follows, with the weights eliminated: for a barrier
        mu they solve ``|M|^2 - c - lambda = mu / alpha - mu / (1 - alpha)``, and lambda is zero or
        what makes the sum of the weights d M. Every motion has its say at first and the decision
        hardens slowly, which passes by the many small minima of the trimmed cost. It ends early
        where the weights have gone that carry a step. Returns a (4, 4) extrinsic and the steps
        that were taken.
        """
        T_a_b = start[None]
        mu = max(float(self.squares(T_a_b).mean()), self.c)
        steps = 0
        while mu > _BARRIER_END * self.c and steps < _MAX_STEPS:
            G = self.gram(self._barrier_weights(self.squares(T_a_b), mu))
            if not _solvable(G).all():
                break
            T_a_b = _minimise_each(G, T_a_b)
            mu *= _BARRIER_FACTOR
            steps += 1
        return T_a_b[0], steps

    def _barrier_weights(self, squares: FloatArray, mu: float) -> FloatArray:
        weights = _barrier_weight(squares - self.c, mu)
        if weights.sum() >= self.least:
            return weights
        low, high = 0.0, float(squares.max()) + 1e3 * mu
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            if _barrier_weight(squares - self.c - middle, mu).sum() < self.least:
                low = middle
            else:
                high = middle
        return _barrier_weight(squares - self.c - high, mu)


def _barrier_weight(excess: FloatArray, mu: float) -> FloatArray:
    """Return the root in (0, 1) of ``excess = mu / alpha - mu / (1 - alpha)``."""
    # In a form without cancellation for large and for vanishing excess.
    weight: FloatArray = 0.5 - excess / (2 * (np.sqrt(excess**2 + 4 * mu**2) + 2 * mu))
    return weight


def _solvable(G: FloatArray) -> NDArray[np.bool_]:
    """Return which (S,) of (S, 13, 13) quadratic forms determine a translation."""
    turns = np.linalg.eigvalsh(G[:, 9:12, 9:12])
    solvable: NDArray[np.bool_] = turns[:, 0] > _SINGULAR * turns[:, 2]
    return solvable


def _minimise_each(G: FloatArray, T_a_b: FloatArray) -> FloatArray:
    """Minimise each of (S, 13, 13) quadratic forms from its (S, 4, 4) start."""
    R = quadratic.minimise_rotations(G, T_a_b[:, :3, :3])[0]
    return se3.from_rotation_translation(R, quadratic.best_translation(G, R))
