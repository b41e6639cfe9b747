# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The scatter of the scores over blocks of the drive, for a sandwich covariance.

The combined score is summed over 20, 10 and 5 blocks of time. Blocks show errors that are
correlated over minutes; contrasts do not. Their scatter, whitened by the information A, gives

* phi, the mean over all directions: a stable number by which A is divided, and
* the middle of the sandwich, with phi as the floor of every eigenvalue.

Both include ``sum c^2 A n rho^2``, for noise that is correlated with the motion, which blocks do
not show.

H. White, "Maximum likelihood estimation of misspecified models", Econometrica 50(1), 1982,
doi:10.2307/1912526.
"""

from __future__ import annotations

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.algebra import transposed
from trajectory_calibration.solvers.drift_aware.drive import Drive, PARAMETERS
from trajectory_calibration.solvers.drift_aware.octaves import Octaves
from trajectory_calibration.solvers.drift_aware.tree import Plan

# Numbers of blocks; the largest is a multiple of the others.
BLOCKS = (20, 10, 5)


def whitener(A: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return W and its inverse with ``W' A W = 1``; almost zero where A has no information."""
    scale = np.sqrt(np.maximum(np.diag(A), 1e-300))
    values, vectors = np.linalg.eigh(A / np.outer(scale, scale))
    root = np.sqrt(np.maximum(values, 1e-12))
    return vectors / root / scale[:, None], (vectors * root).T * scale


def scatter(
    drive: Drive, tree: Plan, octaves: Octaves, c: FloatArray, rho: float, W: FloatArray,
) -> list[FloatArray]:
    """Return the whitened (12, 12) middle of the sandwich for each number of blocks."""
    Q = transposed(W.T @ (c[:, None, None] * octaves.Q))
    each = np.concatenate([octaves.each[part] @ own for part, own in zip(
        tree.parts, Q, strict=True)])
    correlated = W.T @ np.tensordot(c**2 * octaves.n * rho**2, octaves.A, axes=1) @ W
    share = drive.times[tree.boundary] / max(drive.times[-1], 1e-300)
    most = max(BLOCKS)
    of = np.minimum((share * most).astype(np.intp), most - 1)
    shortest = np.stack([np.bincount(of, column, most) for column in each.T], axis=-1)
    result = []
    for blocks in BLOCKS:
        sums = shortest.reshape(blocks, -1, PARAMETERS).sum(axis=1)
        sums -= sums.mean(axis=0)
        result.append(sums.T @ sums * blocks / (blocks - 1) + correlated)
    return result


def inflation(
    drive: Drive, tree: Plan, octaves: Octaves, c: FloatArray, rho: float,
) -> float:
    """Return phi, the mean scatter relative to the information, at least 0.3."""
    W, _ = whitener(octaves.information(c))
    return max(0.3, *(float(np.trace(middle)) / PARAMETERS for middle in scatter(
        drive, tree, octaves, c, rho, W)))
