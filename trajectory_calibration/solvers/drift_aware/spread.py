"""How much the answer varies: a sandwich over blocks of the drive, never less than the model.

The combined score is summed over 20, 10 and 5 blocks of time. Blocks see what contrasts do not:
errors that go on for minutes. Their scatter, whitened by the information A, gives

* its pooled size phi: one number, stable, for all directions, by which A is divided, and
* the middle of the sandwich by direction, with phi as the floor of every eigenvalue;

both with ``sum c^2 A n rho^2``, what correlation with the motion may do and no block shows.

H. White, "Maximum likelihood estimation of misspecified models", Econometrica 50(1), 1982,
doi:10.2307/1912526.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.algebra import apply
from trajectory_calibration.solvers.drift_aware.drive import Drive, LATENCY, PARAMETERS
from trajectory_calibration.solvers.drift_aware.octaves import Octaves
from trajectory_calibration.solvers.drift_aware.tree import Plan

if TYPE_CHECKING:
    from trajectory_calibration.solvers.drift_aware.fit import Fit

_BLOCKS = (20, 10, 5)

# phi of data better than their model is not trusted below this.
_LEAST = 0.3

# Directions with less information than this part of the others (rounding) are open: a kilometre.
_OPEN, _FAR = 1e-11, 1e3

# A latency that the motion does not tell is stated with this deviation, seconds: half of what
# filters and loosely coupled navigation have where they have any.
_LATENCY_STATED = 0.03


def _inverse(bread: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the inverse where there is one, and the covariance of what is exactly open."""
    diagonal = np.diag(bread)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(bread * np.outer(scale, scale))
    known = values > _OPEN
    rows = scale[:, None] * vectors
    kept = rows[:, known]
    free = rows[:, ~known] / np.linalg.norm(rows[:, ~known], axis=0)
    return kept / values[known] @ kept.T, free @ free.T * _FAR**2


def _whitener(A: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return W and its inverse with ``W' A W = 1``; where A says nothing, next to nothing."""
    scale = np.sqrt(np.maximum(np.diag(A), 1e-300))
    values, vectors = np.linalg.eigh(A / np.outer(scale, scale))
    root = np.sqrt(np.maximum(values, 1e-12))
    return vectors / root / scale[:, None], (vectors * root).T * scale


def _scatter(
    drive: Drive, tree: Plan, octaves: Octaves, c: FloatArray, rho: float, W: FloatArray,
) -> list[FloatArray]:
    """Return the whitened (12, 12) middle of the sandwich for each number of blocks."""
    Q = c[:, None, None] * octaves.Q
    each = apply((W.T @ Q)[octaves.of], octaves.each)
    correlated = W.T @ np.tensordot(c**2 * octaves.n * rho**2, octaves.A, axes=1) @ W
    share = drive.times[tree.boundary] / max(drive.times[-1], 1e-300)
    result = []
    for blocks in _BLOCKS:
        of = np.minimum((share * blocks).astype(np.intp), blocks - 1)
        sums = np.stack([np.bincount(of, column, blocks) for column in each.T], axis=-1)
        sums -= sums.mean(axis=0)
        result.append(sums.T @ sums * blocks / (blocks - 1) + correlated)
    return result


def inflation(
    drive: Drive, tree: Plan, octaves: Octaves, c: FloatArray, rho: float,
) -> float:
    """Return phi."""
    W, _ = _whitener(octaves.information(c))
    return max(_LEAST, *(float(np.trace(middle)) / PARAMETERS for middle in _scatter(
        drive, tree, octaves, c, rho, W)))


def covariance(fit: Fit) -> FloatArray:
    """Return (12, 12), of all parameters about the truth; fixed ones have none."""
    A = fit.octaves.information(fit.c)
    W, back = _whitener(A)
    middle = np.zeros_like(A)
    for scatter in _scatter(fit.drive, fit.tree, fit.octaves, fit.c, fit.rho, W):
        values, vectors = np.linalg.eigh(scatter)
        middle += (vectors * np.maximum(values, fit.phi)) @ vectors.T / len(_BLOCKS)
    prior = fit.prior.copy()
    prior[:6] = 0.0
    latency = fit.state.terms[LATENCY - 6]
    prior[LATENCY] = min(prior[LATENCY], 1.0 / (_LATENCY_STATED**2 + latency**2))
    inverse, open_ = _inverse(A / fit.phi + np.diag(prior))
    result = inverse @ (back.T @ middle @ back / fit.phi**2 + np.diag(prior)) @ inverse + open_
    result = np.where(np.outer(fit.free, fit.free), result, 0.0)
    return 0.5 * (result + result.T)
