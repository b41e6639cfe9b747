# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What each octave tells of the parameters, and how much of it to believe.

The noise of SLAM at short times is no white noise: smoothing, deskewing and delays correlate it
with the motion itself, with a coefficient up to rho. It then biases an octave of n contrasts by
rho sqrt(n) of its own deviations, however many contrasts there are. The score s of an octave has
the covariance ``H (1 + n rho^2)``, and its information saturates at ``H / (n rho^2)``:

    sum over octaves of  c Q s = 0,    c = 1 / (1 + n rho^2).

rho belongs to the pair, and how far the octaves contradict each other tells it: it maximises a
restricted likelihood of the scores under a log-normal prior about 0.2.

``Q = H~ H^-1`` takes out of the normal matrix H what noise in the regressors alone makes of it
(errors in variables): H~, the sensitivity of the score, is what the motion excites.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.algebra import (
    apply,
    ROTATION,
    TRANSLATION,
    transposed,
)
from trajectory_calibration.solvers.drift_aware.drive import LATENCY, OFFSET, PARAMETERS, SCALE
from trajectory_calibration.solvers.drift_aware.tree import Contrasts, Plan

# The prior of rho: its median, and the deviation of its logarithm. VIO and stereo SLAM have 0.03
# to 0.1, lidar odometry against GNSS 0.2 to 0.35.
_MEDIAN, _SPREAD = 0.2, 0.8
_GRID = np.geomspace(0.002, 1.0, 40)

# Directions that an octave sees this much less than others, each at its own size, are none.
_RELATIVE = 1e-9


@dataclass(frozen=True, eq=False)
class Octaves:
    """The scores of all octaves, those without contrasts left out.

    Attributes
    ----------
    n : (o,) contrasts.
    score : (o, 12) sum of ``J' V^-1 d``, weighted.
    each : (n, 12) of every contrast, in the order of the plan.
    Q : (o, 12, 12), what of a score is no noise.
    A : (o, 12, 12), ``H~ H^-1 H~``, the information of an octave.
    squares : (o,) ``s' H^-1 s``, each direction by its share of signal.
    rank : (o,) the sum of these shares.
    normal : (12, 12) the sum of H.

    """

    n: FloatArray
    score: FloatArray
    each: FloatArray
    Q: FloatArray
    A: FloatArray
    squares: FloatArray
    rank: FloatArray
    normal: FloatArray

    def weights(self, rho: float) -> FloatArray:
        """Return (o,) c."""
        return 1.0 / (1.0 + self.n * rho**2)

    def information(self, c: FloatArray) -> FloatArray:
        """Return (12, 12), the derivative of the combined score."""
        return np.tensordot(c, self.A, axes=1)

    def combined(self, c: FloatArray) -> FloatArray:
        """Return (12,), the combined score."""
        result: FloatArray = (c[:, None] * apply(self.Q, self.score)).sum(axis=0)
        return result


def scores(tree: Plan, found: Contrasts, weights: FloatArray, step_s: float) -> Octaves:
    """Sum up what the contrasts of each octave tell; poses are ``step_s`` apart."""
    whitened = weights[:, None, None] * (found.inverse @ found.J)
    each = np.einsum('nij,ni->nj', whitened, found.d)
    H = np.stack([whitened[part].reshape(-1, PARAMETERS).T @ found.J[part].reshape(-1, PARAMETERS)
                  for part in tree.parts])
    n = np.diff(np.append(tree.first, len(tree.octave))).astype(np.float64)
    length_s = np.float64(step_s) * 2.0**tree.octave
    in_regressors = np.add.reduceat(
        _from_regressors(found, weights, length_s, step_s), tree.first)
    scale = np.sqrt(np.einsum('oii->oi', H))
    scale = np.where(scale > 0, scale, np.inf)
    values, U = np.linalg.eigh(H / scale[:, :, None] / scale[:, None, :])
    seen = values > _RELATIVE
    root = np.sqrt(np.where(seen, values, 1.0))[:, None, :]
    shown = seen[:, None, :]
    to = np.where(shown, U / root, 0.0) / scale[:, :, None]
    finite = np.where(np.isfinite(scale), scale, 0.0)
    back = np.where(shown, U * root, 0.0) * finite[:, :, None]
    # H = back back', to' back = 1; the share of each direction that is signal.
    noise = transposed(to) @ (in_regressors[:, :, None] * to)
    share, W = np.linalg.eigh(np.eye(PARAMETERS) - noise)
    share = np.clip(share, 0.0, 1.0)
    signal = (W * share[:, None, :]) @ transposed(W)
    score = np.add.reduceat(each, tree.first)
    half = back @ signal
    return Octaves(
        n=n, score=score, each=each,
        Q=half @ transposed(to), A=half @ transposed(half),
        squares=(share * apply(transposed(to @ W), score)**2).sum(axis=1),
        rank=share.sum(axis=1) - (~seen).sum(axis=1), normal=H.sum(axis=0))


def _from_regressors(
    found: Contrasts, weights: FloatArray, length_s: FloatArray, step_s: float,
) -> FloatArray:
    """Return (n, 12), the diagonal of H that noise in the poses makes without any motion.

    Half of the noise of a contrast is of b, and turns and shifts the axes that J is told in. The
    velocities by which latency and clock offset act are differences of noisy poses: their mean
    over a window of ``length_s`` is the noise of its ends over that time.
    """
    V, inverse = ([np.einsum('nii->n', M[:, part, part]) / 3 for part in
                   (TRANSLATION, ROTATION)] for M in (found.V, found.inverse))
    result = np.zeros((len(weights), PARAMETERS))
    result[:, ROTATION] = (weights * V[1] * inverse[1])[:, None]
    result[:, TRANSLATION] = (weights * V[1] * inverse[0])[:, None]
    result[:, SCALE] = 1.5 * weights * V[0] * inverse[0]
    by_time = 1.5 * weights / (length_s * step_s)
    result[:, LATENCY] = by_time * V[0] * inverse[0]
    result[:, OFFSET] = by_time * (V[0] * inverse[0] + V[1] * inverse[1])
    return result


def saturation(octaves: Octaves, prior: FloatArray, terms: FloatArray) -> float:
    """Return rho: the root of the mean of its square over its posterior.

    ``prior`` is (12,), the precisions of the priors, ``terms`` (12,) where they pull to zero from.
    """
    v = 1.0 + octaves.n * _GRID[:, None]**2
    A = np.tensordot(1 / v, octaves.A, axes=1) + np.diag(prior)
    g = (1 / v) @ apply(octaves.Q, octaves.score) + prior * terms
    # Columns that are fixed or that nothing tells do not count.
    dial = 1 / np.sqrt(np.maximum(np.einsum('gii->gi', A), 1e-300))
    A = A * dial[:, :, None] * dial[:, None, :] + 1e-12 * np.eye(PARAMETERS)
    g = g * dial
    cost = ((octaves.squares / v + octaves.rank * np.log(v)).sum(axis=1)
            + np.linalg.slogdet(A)[1] - 2 * np.log(dial).sum(axis=1)
            - (g * np.linalg.solve(A, g[:, :, None])[:, :, 0]).sum(axis=1)
            + (np.log(_GRID / _MEDIAN) / _SPREAD)**2)
    weight = np.exp(-0.5 * (cost - cost.min()))
    return float(np.sqrt((weight @ _GRID**2) / weight.sum()))
