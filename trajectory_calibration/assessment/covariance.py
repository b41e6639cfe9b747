"""The covariance of an extrinsic, from the equations that a solver solved.

Every solver here is the root of ``sum Z^T r = 0`` over the motions (``solution.Equations``). To
first order its error is ``H^-1 s`` with ``s = sum Z^T e`` and ``e`` what noise does to the
residuals. Three things make the textbook ``sigma^2 (J^T J)^-1`` wrong, by factors of up to 20:

* Motions share poses and drift. The covariance of s is therefore summed over poses and steps,
  not over motions: an error of pose p acts through all motions that begin or end there, a drift
  of step s through all that span it. Both come from one running sum, whatever the reference. The
  noise levels are those of ``pair_noise``; where a long-run (Newey-West) covariance of the
  scores finds more than they explain, as with coloured noise, the result is inflated to it.
* Noise in the rotations passes for excitation. H is therefore made of products of what a saw with
  what b saw, and a direction in which these do not stand out of the noise is *unobserved*: see
  ``excitation``.
* What the noise does to the answer on average (errors in variables), and what a constant drift
  per metre does where the data prove one, are not variance but bias; their squares are added.

W. K. Newey, K. D. West, Econometrica 55(3), 1987, doi:10.2307/1913610 (long-run covariance; with
its triangular weights the same as a moving-block bootstrap, H. R. Kunsch, Annals of Statistics
17(3), 1989, doi:10.1214/aos/1176347265).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.assessment.excitation import (
    block_length,
    CHUNK,
    opens_rotation,
    scaled_to_unknown,
    split,
    split_pairs,
    thinned,
    thinning,
    weighted_instruments,
)
from trajectory_calibration.assessment.variogram import identify_noise, PairNoise, step_lengths
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.errors import SolverError
from trajectory_calibration.geometry import chi_squared, se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers import linear
from trajectory_calibration.solvers.solution import Linearise, Solution

# Motions that are enough to find a drift of the whole drive.
_MOTIONS_FOR_DRIFT = 4000

# A drift of this much per metre is none, and its effect on an answer beyond any linearisation.
_LARGEST_DRIFT = 0.2


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """How far the answer may be from the truth, and why.

    Attributes
    ----------
    covariance : (6, 6), about zero error, order and side as in ``CalibrationResult``.
    drift : (3,) metres per metre of b against a along x, y, z of a, where significant, or None.
    unobserved : (K, 6) directions (dt, dtheta) in which the motion says nothing.

    """

    covariance: FloatArray
    drift: FloatArray | None = None
    unobserved: FloatArray = field(default_factory=lambda: np.zeros((0, 6)))

    def findings(self, frame_a: str, frame_b: str) -> tuple[Finding, ...]:
        """Return what a person should know of it, with the names of the sensors."""
        if self.drift is None:
            return ()
        percent = ', '.join(f'{100 * value:.2g}' for value in self.drift)
        return (Finding(
            'drift-proven',
            f'{frame_b} drifts against {frame_a} by ({percent}) % of the distance along x, y, z '
            f'of {frame_a}, or its scale is off. The standard deviations include that. Try solver '
            'drift_aware', {'drift_per_metre': self.drift.tolist()}),)


def estimate_uncertainty(solution: Solution, motions: MotionPairs) -> Uncertainty:
    """Return the uncertainty of a solution: the solver's own, or one from its equations.

    Raises
    ------
    SolverError
        The solver gave neither.

    """
    if solution.covariance is not None:
        # A solver that takes the motion for what it is trusts the noise in it as well.
        open_ = split_pairs(solution.T_a_b, motions.pairs.scaled(solution.scale)).unobserved
        return Uncertainty(
            _semidefinite(solution.covariance) + open_.T @ open_, unobserved=open_)
    if solution.linearise is None:
        raise SolverError('the solver gave neither a covariance nor the equations it solved')
    X, weights, linearise = solution.T_a_b, solution.inliers, solution.linearise
    w = np.ones(len(motions)) if weights is None else weights.astype(np.float64)
    usable = None if weights is None else _spanned_steps(motions, weights)
    trusted = None if weights is None else _ends(motions, weights)
    poses_c = X @ motions.pairs.poses_b @ se3.inverse(X)
    noise = identify_noise(
        motions.pairs.stamps_ns, motions.pairs.poses_a, poses_c, usable, trusted)
    found = _analyse(X, motions, w, noise, poses_c, linearise)
    # The rotations alone tell a drift from a turned sensor; a joint solver takes one for the
    # other, and its own equations could not say.
    drift = (found if linearise is linear.separable else _analyse(
        X, thinned(motions, _MOTIONS_FOR_DRIFT), w[thinning(len(w), _MOTIONS_FOR_DRIFT)], noise,
        poses_c, linear.separable)).drift
    if drift is None:
        return found.uncertainty(np.zeros(6))
    if np.linalg.norm(drift) > _LARGEST_DRIFT:
        x, y, z = (f'{100 * value:.0f}' for value in drift)
        raise SolverError(
            f'b drifts against a by ({x}, {y}, {z}) percent of the way along x, y, z of a, needed '
            f'less than {100 * _LARGEST_DRIFT:.0f}: no drift but other units or a scale; use '
            'solver drift_aware, which finds a scale, or give it (scale)')
    # The data prove a drift: judge the noise without it, and count as possible error what the
    # answer would change by if it were known.
    step = found.by_drift @ drift
    moved = se3.moved(X, step)
    poses_c = _without_drift(
        moved @ motions.pairs.poses_b @ se3.inverse(moved), motions.pairs.poses_a, drift)
    noise = identify_noise(
        motions.pairs.stamps_ns, motions.pairs.poses_a, poses_c, usable, trusted)
    rest = _analyse(moved, motions, w, noise, poses_c, linearise)
    return rest.uncertainty(step, drift=-drift)


def _semidefinite(covariance: FloatArray) -> FloatArray:
    """Return the nearest (6, 6) matrix without negative variances, which rounding may leave."""
    eigenvalues, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    root = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    semidefinite: FloatArray = root @ root.T
    return semidefinite


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
    unobserved: FloatArray
    drift: FloatArray | None
    by_drift: FloatArray

    def uncertainty(self, shift: FloatArray, drift: FloatArray | None = None) -> Uncertainty:
        covariance = (self.covariance + np.outer(self.bias, self.bias) + np.outer(shift, shift)
                      + self.unobserved.T @ self.unobserved)
        return Uncertainty(
            0.5 * (covariance + covariance.T), drift, self.unobserved)


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
    block = block_length(motions)
    inflation = max(1.0, _excess(_long_run(sums.scores, block), meat[:6, :6]))
    excited = split(
        sums.shared, sums.own,
        weighted_instruments(X, motions, weights, poses_c, linearise), block)
    kept = excited.basis
    inverse = _inverse(sums.cross, kept)
    # What is found after a direction that is open goes wrong with it.
    unobserved = scaled_to_unknown(
        excited.unobserved - excited.unobserved @ (inverse @ sums.cross).T)
    free = np.zeros((9, kept.shape[1] + 3))
    free[:6, :-3], free[6:, -3:] = kept, np.eye(3)
    with_drift = _inverse(sums.bread, free)[6:]
    drift = -with_drift @ sums.score
    drift_covariance = inflation * with_drift @ meat @ with_drift.T
    chi_square = drift @ np.linalg.pinv(drift_covariance, rcond=1e-12) @ drift
    drifts = chi_square > chi_squared.quantile(3) and not opens_rotation(unobserved)
    return _Analysis(
        covariance=inflation * inverse @ meat[:6, :6] @ inverse.T,
        bias=-inverse @ sums.clean_score,
        unobserved=unobserved,
        # A rotation that is open is as good an explanation as a drift.
        drift=drift if drifts else None,
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
    for start in range(0, len(motions), CHUNK):
        part = slice(start, start + CHUNK)
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
        bread += linear.gram(Z, J)
        score += each.sum(axis=0)
        scores[part] = each[:, :6]
        clean += 0.5 * np.einsum('kri,kr->i', Z_a + Z_b, found.residual)
        cross += 0.5 * (linear.gram(Z_a, of_b.jacobian) + linear.gram(Z_b, of_a.jacobian))
        shared += linear.gram(Z_a, of_b.instrument)
        own += 0.5 * (linear.gram(Z_a, of_a.instrument) + linear.gram(Z_b, of_b.instrument))
        moved = Zt @ found.disturbance @ to_body[j]
        # The current pose of a motion is no other's; its reference pose may be shared.
        by_pose[j] += moved
        first = np.flatnonzero(np.diff(i, prepend=-1))
        by_pose[i[first]] -= np.add.reduceat(moved, first, axis=0)
    return _Sums(bread, score, clean, cross, 0.5 * (shared + shared.T), own, by_pose, scores)


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


def _spanned_steps(motions: MotionPairs, inliers: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (N - 1,) whether any motion that was kept spans each step."""
    change = np.zeros(len(motions.pairs), dtype=np.intp)
    np.add.at(change, motions.i[inliers], 1)
    np.add.at(change, motions.j[inliers], -1)
    spanned: NDArray[np.bool_] = np.cumsum(change)[:-1] > 0
    return spanned


def _ends(motions: MotionPairs, inliers: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (N,) whether any motion that was kept begins or ends at each pose."""
    ends = np.zeros(len(motions.pairs), dtype=np.bool_)
    ends[motions.i[inliers]] = True
    ends[motions.j[inliers]] = True
    return ends


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
