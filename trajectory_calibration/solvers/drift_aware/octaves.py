# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Scores and information of each octave, saturated by noise that is correlated with the motion.

SLAM noise at short times is not white: smoothing, deskewing and delays correlate it with the
motion, with a coefficient up to rho. This biases an octave of n contrasts by rho sqrt(n) standard
deviations. The score s of an octave has the covariance ``H (1 + n rho^2)``, and its information
saturates at ``H / (n rho^2)``:

    sum over octaves of  c Q s = 0,    c = 1 / (1 + n rho^2).

rho is estimated for each pair from the disagreement of the octaves: by a restricted likelihood of
the scores with a log-normal prior about 0.2.

``Q = H~ H^-1`` corrects the normal matrix H for noise in the regressors (errors in variables): H~,
the sensitivity of the score, is the excitation by the motion alone.
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

# Values of rho.
_GRID = np.geomspace(0.002, 1.0, 40)


@dataclass(frozen=True, eq=False)
class Octaves:
    """Scores and information of all octaves that have contrasts.

    Attributes
    ----------
    n : (o,) number of contrasts.
    score : (o, 12) weighted sum of ``J' V^-1 d``.
    each : (n, 12) the terms of that sum, in the order of the plan.
    Q : (o, 12, 12) correction of the scores for noise in the regressors.
    A : (o, 12, 12) ``H~ H^-1 H~``, the information.
    squares : (o,) ``s' H^-1 s``, each direction weighted by its share of signal.
    rank : (o,) sum of these shares.
    normal : (12, 12) sum of H over the octaves.

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
        """Return the (o,) weights c for a rho."""
        return 1.0 / (1.0 + self.n * rho**2)

    def information(self, c: FloatArray) -> FloatArray:
        """Return the (12, 12) information, the derivative of the combined score."""
        return np.tensordot(c, self.A, axes=1)

    def combined(self, c: FloatArray) -> FloatArray:
        """Return the (12,) combined score."""
        result: FloatArray = (c[:, None] * apply(self.Q, self.score)).sum(axis=0)
        return result


def scores(tree: Plan, found: Contrasts, weights: FloatArray, step_s: float) -> Octaves:
    """Sum the scores and the information of each octave; poses are ``step_s`` apart."""
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
    # Directions of an octave with a smaller share of the information are ignored.
    seen = values > 1e-9
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
    """Return the (n, 12) contribution of pose noise to the diagonal of H.

    Half of the noise of a contrast is of b, and moves the axes in which J is expressed. The
    velocities in the columns of latency and clock offset are differences of noisy poses: over a
    window of ``length_s`` their noise is that of its ends divided by that time.
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
    """Return rho, its root mean square over the posterior.

    ``prior`` (12,) are the precisions of the priors, ``terms`` (12,) the present values.
    """
    v = 1.0 + octaves.n * _GRID[:, None]**2
    A = np.tensordot(1 / v, octaves.A, axes=1) + np.diag(prior)
    g = (1 / v) @ apply(octaves.Q, octaves.score) + prior * terms
    # Columns that are fixed or unobservable do not count.
    dial = 1 / np.sqrt(np.maximum(np.einsum('gii->gi', A), 1e-300))
    A = A * dial[:, :, None] * dial[:, None, :] + 1e-12 * np.eye(PARAMETERS)
    g = g * dial
    # The prior of rho: median 0.2, standard deviation of its logarithm 0.8. Measured: 0.03 to 0.1
    # for VIO and stereo SLAM, 0.2 to 0.35 for lidar odometry against GNSS.
    cost = ((octaves.squares / v + octaves.rank * np.log(v)).sum(axis=1)
            + np.linalg.slogdet(A)[1] - 2 * np.log(dial).sum(axis=1)
            - (g * np.linalg.solve(A, g[:, :, None])[:, :, 0]).sum(axis=1)
            + (np.log(_GRID / 0.2) / 0.8)**2)
    weight = np.exp(-0.5 * (cost - cost.min()))
    return float(np.sqrt((weight @ _GRID**2) / weight.sum()))
