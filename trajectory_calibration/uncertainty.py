"""The covariance of an extrinsic, from the equations that a solver solved.

Every solver here is the root of ``sum Z^T r = 0`` over the motions (``solution.Equations``). To
first order its error is ``H^-1 s`` with ``s = sum Z^T e`` and ``e`` what noise does to the
residuals. Three things make the textbook ``sigma^2 (J^T J)^-1`` wrong, by factors of up to 20:

* Motions share poses and drift. The covariance of s is therefore summed over poses and steps,
  not over motions: an error of pose p acts through all motions that begin or end there, a drift
  of step s through all that span it. Both come from one running sum, whatever the reference. The
  noise levels are those of ``pair_noise``; where a long-run (Newey-West) covariance of the
  scores finds more than they explain, as with coloured noise, the result is inflated to it.
* Noise in the rotations passes for excitation: in planar motion the sum J^T J is made of noise
  alone and looks well-conditioned. Here the excitation is the product of what a saw with what b
  saw, whose noises are independent, so that noise alone gives zero on average. A direction in
  which that product does not stand out of its own noise is *unobserved*.
* What the noise does to the answer on average (errors in variables), and what a constant drift
  per metre does where the data prove one, are not variance but bias; their squares are added.

W. K. Newey, K. D. West, Econometrica 55(3), 1987, doi:10.2307/1913610 (long-run covariance; with
its triangular weights the same as a moving-block bootstrap, H. R. Kunsch, Annals of Statistics
17(3), 1989, doi:10.1214/aos/1176347265); W. A. Fuller, "Measurement Error Models", 1987, section
1.4 (a second measurement as the instrument).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration import se3
from trajectory_calibration.motions import MotionPairs, parse_reference
from trajectory_calibration.pair_noise import identify_noise, PairNoise, step_lengths
from trajectory_calibration.se3 import FloatArray
from trajectory_calibration.solvers import linear
from trajectory_calibration.solvers.solution import Linearise, Solution

# Standard deviations that stand for "unknown" in a covariance, metres and radians.
UNKNOWN = np.array([1e3] * 3 + [np.pi] * 3)

# Motions that are linearised at once.
_CHUNK = 2048

# Blocks of the long-run covariance: this many lags of the reference, at most a fifth of the data.
_BLOCK_LAGS = 3
_BLOCK_SHARE = 0.2

# Directions with less than this share of true excitation are tested against noise.
_SUSPECT_SHARE = 0.5

# Excitation counts when it exceeds this many standard deviations of what noise alone would give.
_SIGNIFICANT_EXCITATION = 4.0

# Motions that are enough to find a drift of the whole drive.
_MOTIONS_FOR_DRIFT = 4000

# Chi-square of three degrees of freedom that chance exceeds once in a thousand.
_SIGNIFICANT_DRIFT = 16.27


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """How far the answer may be from the truth, and why.

    Attributes
    ----------
    covariance : (6, 6), about zero error, order and side as in ``CalibrationResult``.
    noise : what was identified, or None where the solver gave the covariance.
    drift : (3,) metres per metre of b against a along x, y, z of a, where significant, or None.
    unobserved : (K, 6) directions (dt, dtheta) in which the motion says nothing.

    """

    covariance: FloatArray
    noise: PairNoise | None = None
    drift: FloatArray | None = None
    unobserved: FloatArray = field(default_factory=lambda: np.zeros((0, 6)))


def estimate_uncertainty(solution: Solution, motions: MotionPairs) -> Uncertainty | None:
    """Return the uncertainty of a solution: the solver's own, or one from its equations."""
    if solution.covariance is not None:
        return Uncertainty(solution.covariance)
    if solution.linearise is None:
        return None
    X, weights, linearise = solution.T_a_b, solution.inliers, solution.linearise
    w = np.ones(len(motions)) if weights is None else weights.astype(np.float64)
    usable = None if weights is None else _spanned(motions, weights)
    poses_c = X @ motions.pairs.poses_b @ se3.inverse(X)
    noise = identify_noise(motions.pairs.poses_a, poses_c, usable)
    found = _analyse(X, motions, w, noise, poses_c, linearise)
    # The rotations alone tell a drift from a turned sensor; a joint solver takes one for the
    # other, and its own equations could not say.
    drift = (found if linearise is linear.separable else _analyse(
        X, _thinned(motions), _thin(w), noise, poses_c, linear.separable)).drift
    if drift is None:
        return found.uncertainty(np.zeros(6))
    # The data prove a drift: judge the noise without it, and count as possible error what the
    # answer would change by if it were known.
    step = found.by_drift @ drift
    moved = se3.from_rotation_translation(
        se3.exp_so3(step[3:]) @ X[:3, :3], X[:3, 3] + step[:3])
    poses_c = _without_drift(
        moved @ motions.pairs.poses_b @ se3.inverse(moved), motions.pairs.poses_a, drift)
    noise = identify_noise(motions.pairs.poses_a, poses_c, usable)
    rest = _analyse(moved, motions, w, noise, poses_c, linearise)
    return rest.uncertainty(step, drift=-drift)


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums over the motions; the parameters are the six of X, then three of drift per metre.

    Attributes
    ----------
    bread : (9, 9), instrument times jacobian.
    score : (9,), instrument times residual.
    clean_score : (6,), the same with instruments of a alone and of b alone.
    cross : (6, 6), true excitation: instruments of a times jacobian of b, and the reverse.
    shared, own : (6, 6), instruments of a times those of b; of each times itself.
    by_pose : (N, 9, 6), how the score moves with an error of each pose, in the world of a.
    scores : (M, 6), of each motion.

    """

    bread: FloatArray
    score: FloatArray
    clean_score: FloatArray
    cross: FloatArray
    shared: FloatArray
    own: FloatArray
    by_pose: FloatArray
    scores: FloatArray


@dataclass(frozen=True, eq=False)
class _Analysis:
    """What the sums say, see ``Uncertainty``; ``by_drift`` is (6, 3), dX by a drift."""

    covariance: FloatArray
    bias: FloatArray
    noise: PairNoise
    unobserved: FloatArray
    drift: FloatArray | None
    by_drift: FloatArray

    def uncertainty(self, shift: FloatArray, drift: FloatArray | None = None) -> Uncertainty:
        covariance = (self.covariance + np.outer(self.bias, self.bias) + np.outer(shift, shift)
                      + self.unobserved.T @ self.unobserved)
        return Uncertainty(
            0.5 * (covariance + covariance.T), self.noise, drift, self.unobserved)


def _analyse(
    X: FloatArray,
    motions: MotionPairs,
    weights: FloatArray,
    noise: PairNoise,
    poses_c: FloatArray,
    linearise: Linearise,
) -> _Analysis:
    poses_a = motions.pairs.poses_a
    # Near the first pose: world coordinates of thousands of kilometres would cost digits.
    local = se3.inverse(poses_a[0]) @ poses_a
    lengths = step_lengths(poses_a)
    sums = _accumulate(X, motions, weights, local, poses_c, linearise)
    meat = _meat(sums.by_pose, local, lengths, noise, X)
    block = _block(motions)
    inflation = max(1.0, _excess(_long_run(sums.scores, block), meat[:6, :6]))
    kept, unobserved = _excited(X, motions, weights, poses_c, linearise, sums, block)
    inverse = _inverse(sums.cross, kept)
    free = np.zeros((9, kept.shape[1] + 3))
    free[:6, :-3], free[6:, -3:] = kept, np.eye(3)
    with_drift = _inverse(sums.bread, free)[6:]
    drift = -with_drift @ sums.score
    drift_covariance = inflation * with_drift @ meat @ with_drift.T
    chi_square = drift @ np.linalg.pinv(drift_covariance, rcond=1e-12) @ drift
    return _Analysis(
        covariance=inflation * inverse @ meat[:6, :6] @ inverse.T,
        bias=-inverse @ sums.clean_score,
        noise=noise,
        unobserved=unobserved,
        drift=drift if chi_square > _SIGNIFICANT_DRIFT else None,
        by_drift=-_inverse(sums.bread[:6, :6], kept) @ sums.bread[:6, 6:],
    )


def _accumulate(
    X: FloatArray,
    motions: MotionPairs,
    weights: FloatArray,
    local: FloatArray,
    poses_c: FloatArray,
    linearise: Linearise,
) -> _Sums:
    to_body = se3.adjoint(se3.inverse(local))
    # Position errors that a drift of one metre per metre along x, y, z of a piles up.
    piled = _piled(local)
    bread, score, clean = np.zeros((9, 9)), np.zeros(9), np.zeros(6)
    cross, shared, own = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 6))
    by_pose = np.zeros((len(local), 9, 6))
    scores = np.empty((len(motions), 6))
    for start in range(0, len(motions), _CHUNK):
        part = slice(start, start + _CHUNK)
        i, j = motions.i[part], motions.j[part]
        A, C = motions.A[part], se3.inverse(poses_c[i]) @ poses_c[j]
        found, of_a, of_b = linearise(X, A, C), linearise(X, A, A), linearise(X, C, C)
        w = weights[part, None, None]
        Z_a, Z_b = w * of_a.instrument, w * of_b.instrument
        drifted = found.disturbance[:, :, :3] @ (
            np.swapaxes(local[j, :3, :3], 1, 2) @ (piled[j] - piled[i]))
        J = np.concatenate([found.jacobian, drifted], axis=2)
        Z = w * np.concatenate([found.instrument, drifted], axis=2)
        Zt = np.swapaxes(Z, 1, 2)
        each = (Zt @ found.residual[:, :, None])[:, :, 0]
        bread += _gram(Z, J)
        score += each.sum(axis=0)
        scores[part] = each[:, :6]
        clean += 0.5 * np.einsum('kri,kr->i', Z_a + Z_b, found.residual)
        cross += 0.5 * (_gram(Z_a, of_b.jacobian) + _gram(Z_b, of_a.jacobian))
        shared += _gram(Z_a, of_b.instrument)
        own += 0.5 * (_gram(Z_a, of_a.instrument) + _gram(Z_b, of_b.instrument))
        moved = Zt @ found.disturbance @ to_body[j]
        # The current pose of a motion is no other's; its reference pose may be shared.
        by_pose[j] += moved
        first = np.flatnonzero(np.diff(i, prepend=-1))
        by_pose[i[first]] -= np.add.reduceat(moved, first, axis=0)
    return _Sums(bread, score, clean, cross, 0.5 * (shared + shared.T), own, by_pose, scores)


def _gram(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return ``sum left^T right`` of (M, 6, n) and (M, 6, m)."""
    product: FloatArray = left.reshape(-1, left.shape[2]).T @ right.reshape(-1, right.shape[2])
    return product


def _meat(
    by_pose: FloatArray, local: FloatArray, lengths: FloatArray, noise: PairNoise, X: FloatArray,
) -> FloatArray:
    """Return the (9, 9) covariance of the score under white noise and a walk."""
    Ad = se3.adjoint(local)
    of_pose = by_pose @ Ad
    # An error of step s moves every later pose; what a motion sees of it is the difference of
    # its ends.
    of_step = -np.cumsum(by_pose, axis=0)[:-1] @ Ad[1:] * np.sqrt(lengths)[:, None, None]
    return _spread(of_pose, noise.white_covariance(X)) + _spread(of_step, noise.walk_covariance(X))


def _spread(effects: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return ``sum E covariance E^T`` of (N, 9, 6) effects."""
    eigenvalues, vectors = np.linalg.eigh(covariance)
    rows = effects @ (vectors * np.sqrt(np.maximum(eigenvalues, 0.0)))
    rows = np.swapaxes(rows, 1, 2).reshape(-1, effects.shape[1])
    spread: FloatArray = rows.T @ rows
    return spread


def _block(motions: MotionPairs) -> int:
    """Return the number of motions over which scores are taken to be correlated."""
    count = len(motions)
    end = motions.j[0] + _BLOCK_LAGS * parse_reference(motions.reference)[1]
    lags = int(np.searchsorted(motions.j, end))
    return max(1, min(max(lags, round(2 * count**(1 / 3))), int(_BLOCK_SHARE * count)))


def _long_run(scores: FloatArray, block: int) -> FloatArray:
    """Return the (6, 6) covariance of the sum of (M, 6) scores, triangular weights.

    The mean over all windows of ``block`` consecutive scores of their summed outer product.
    """
    padded = np.concatenate([np.zeros((block, 6)), scores, np.zeros((block - 1, 6))])
    running = np.cumsum(padded, axis=0)
    windows = running[block:] - running[:-block]
    # The scores sum to zero: a window sees that much less than their spread.
    lost = 1.0 - block / len(scores)
    covariance: FloatArray = windows.T @ windows / (block * max(lost, 0.5))
    return covariance


def _excess(found: FloatArray, expected: FloatArray) -> float:
    """Return how many times ``found`` exceeds ``expected``, both (6, 6), over all directions."""
    scale = np.sqrt(np.maximum(np.diagonal(expected), np.finfo(float).tiny))
    unit = np.outer(scale, scale)
    return float(np.trace(np.linalg.pinv(expected / unit, rcond=1e-10) @ (found / unit))) / 6


def _inverse(matrix: FloatArray, basis: FloatArray) -> FloatArray:
    """Return the inverse of a matrix on the span of the columns of a basis, zero elsewhere."""
    inverse: FloatArray = basis @ np.linalg.pinv(basis.T @ matrix @ basis, rcond=1e-14) @ basis.T
    return inverse


def _excited(
    X: FloatArray,
    motions: MotionPairs,
    weights: FloatArray,
    poses_c: FloatArray,
    linearise: Linearise,
    sums: _Sums,
    block: int,
) -> tuple[FloatArray, FloatArray]:
    """Return a basis (6, 6 - K) of the excited directions, and the (K, 6) others.

    In the basis that makes what each sensor saw the identity, what both saw has eigenvalues
    near one where they saw the same turns, and near zero where each saw its own noise.
    """
    scale = np.sqrt(np.maximum(np.diagonal(sums.own), np.finfo(float).tiny))
    eigenvalues, vectors = np.linalg.eigh(sums.own / np.outer(scale, scale))
    floor = 1e-14 * eigenvalues[-1]
    basis = vectors / np.sqrt(np.maximum(eigenvalues, floor)) / scale[:, None]
    share, rotation = np.linalg.eigh(basis.T @ sums.shared @ basis)
    basis = basis @ rotation
    excited = share > _SUSPECT_SHARE
    suspects = np.flatnonzero(~excited)
    if len(suspects):
        noise = _excitation_by_noise(
            X, motions, weights, poses_c, linearise, basis[:, suspects], block)
        excited[suspects] = share[suspects] > _SIGNIFICANT_EXCITATION * noise
    directions = basis[:, ~excited].T
    length = np.abs(directions / UNKNOWN).max(axis=1, initial=0.0)
    return basis[:, excited], directions / np.maximum(length, np.finfo(float).tiny)[:, None]


def _excitation_by_noise(
    X: FloatArray,
    motions: MotionPairs,
    weights: FloatArray,
    poses_c: FloatArray,
    linearise: Linearise,
    directions: FloatArray,
    block: int,
) -> FloatArray:
    """Return (K,) standard deviations of the shared excitation if both saw only noise.

    The difference of what a and b saw along (6, K) directions holds the noise of both; half of
    its autocovariance is taken for either.
    """
    parts = []
    for start in range(0, len(motions), _CHUNK):
        part = slice(start, start + _CHUNK)
        A = motions.A[part]
        C = se3.inverse(poses_c[motions.i[part]]) @ poses_c[motions.j[part]]
        difference = linearise(X, A, A).instrument - linearise(X, C, C).instrument
        parts.append(np.sqrt(weights[part])[:, None, None] * (difference @ directions))
    rows = np.concatenate(parts)
    count = len(rows)
    variance = np.zeros(directions.shape[1])
    for lag in range(block + 1):
        for k in range(len(variance)):
            covariance = rows[lag:, :, k].T @ rows[:count - lag, :, k] / 2
            variance[k] += (1 if lag == 0 else 2) * np.sum(covariance**2) / count
    return np.sqrt(variance)


def _thin(values: NDArray[Any]) -> NDArray[Any]:
    """Return every n-th of the values of the motions, enough to find a drift."""
    return values[::-(-len(values) // _MOTIONS_FOR_DRIFT)]


def _thinned(motions: MotionPairs) -> MotionPairs:
    return MotionPairs(motions.reference, _thin(motions.i), _thin(motions.j),
                       _thin(motions.A), _thin(motions.B), motions.pairs)


def _spanned(motions: MotionPairs, inliers: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (N - 1,) whether any motion that was kept spans each step."""
    change = np.zeros(len(motions.pairs), dtype=np.intp)
    np.add.at(change, motions.i[inliers], 1)
    np.add.at(change, motions.j[inliers], -1)
    spanned: NDArray[np.bool_] = np.cumsum(change)[:-1] > 0
    return spanned


def _piled(poses: FloatArray) -> FloatArray:
    """Return (N, 3, 3): the position error per unit of drift, in the world of (N, 4, 4) poses."""
    steps = poses[1:, :3, :3] * step_lengths(poses)[:, None, None]
    return np.concatenate([np.zeros((1, 3, 3)), np.cumsum(steps, axis=0)])


def _without_drift(poses_c: FloatArray, poses_a: FloatArray, drift: FloatArray) -> FloatArray:
    """Return (N, 4, 4) poses_c with ``drift`` (metres per metre, axes of a) added."""
    result = poses_c.copy()
    # The drift was fitted in the world of a; the world of c is turned against it.
    turned = poses_c[0, :3, :3] @ poses_a[0, :3, :3].T
    result[:, :3, 3] += _piled(poses_a) @ drift @ turned.T
    return result
