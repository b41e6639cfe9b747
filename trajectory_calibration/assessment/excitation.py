# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which directions of an extrinsic the motion excited, as opposed to rotation noise.

Rotation noise looks like excitation: on flat ground the measured pitch and roll are noise, a sum
of squares counts them, and the height between the sensors is wrong with a small standard
deviation. The product of the regressors of a and of b has no such bias, because their noise is
independent. A direction is unobservable if this product is not significant.

W. A. Fuller, "Measurement Error Models", 1987, section 1.4 (a second measurement as instrument).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.motion_pairs import (
    lag_grid,
    MotionPairs,
    parse_reference,
    select_motions,
)
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.geometry import chi_squared, se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers import linear
from trajectory_calibration.solvers.solution import Linearise, UNOBSERVED_STD

# Number of motions that is enough.
_MOTIONS = 4000


@dataclass(frozen=True, eq=False)
class Excited:
    """The space of (dt, dtheta), split into excited and unobservable directions.

    ``basis`` (6, 6 - K) has columns that span the excited directions. ``unobserved`` (K, 6) are
    the others, scaled to the standard deviations ``UNOBSERVED_STD``.
    """

    basis: FloatArray
    unobserved: FloatArray


def block_length(motions: MotionPairs) -> int:
    """Return the number of consecutive motions that are treated as correlated.

    Three lags of the reference, at most a fifth of all.
    """
    count = len(motions)
    end = motions.j[0] + 3 * parse_reference(motions.reference)[1]
    lags = int(np.searchsorted(motions.j, end))
    return max(1, min(max(lags, round(2 * count**(1 / 3))), count // 5))


def _split(shared: FloatArray, own: FloatArray, apart: FloatArray, block: int) -> Excited:
    """Split the directions by their excitation.

    ``shared`` (6, 6) is the product of the regressors of a and of b, ``own`` (6, 6) the mean of
    the products of each with itself, ``apart`` (M, 6, 6) the difference of both regressors. In the
    basis in which ``own`` is the identity, the eigenvalues of ``shared`` are near one for common
    motion and near zero for noise.
    """
    largest = np.diagonal(own).reshape(2, 3).max(axis=1)
    scale = np.repeat(np.sqrt(np.maximum(largest, np.finfo(float).tiny)), 3)
    eigenvalues, vectors = np.linalg.eigh(own / np.outer(scale, scale))
    seen = eigenvalues > se3.ROUNDING * eigenvalues[-1]
    unseen = vectors[:, ~seen] / scale[:, None]
    basis = vectors[:, seen] / np.sqrt(eigenvalues[seen]) / scale[:, None]
    share, rotation = np.linalg.eigh(basis.T @ shared @ basis)
    basis = basis @ rotation
    # What is mostly common is no noise.
    excited = share > 0.5
    suspects = np.flatnonzero(~excited)
    if len(suspects):
        noise = _excitation_by_noise(apart @ basis[:, suspects], block)
        # A tenth of the false-alarm probability: noise makes a wrong answer look certain.
        limit = chi_squared.quantile(1, 0.1 * chi_squared.FALSE_ALARM)
        excited[suspects] = share[suspects] > np.sqrt(limit) * noise
    directions = np.concatenate([basis[:, ~excited], unseen], axis=1).T
    return Excited(basis[:, excited], scaled_to_unobserved(directions))


def scaled_to_unobserved(directions: FloatArray) -> FloatArray:
    """Return (K, 6) directions scaled to the standard deviations ``UNOBSERVED_STD``."""
    # The whole span is unobserved. Scaling each direction separately until its translation is
    # unknown would leave a rotation that belongs to it too certain.
    _, _, basis = np.linalg.svd(directions / UNOBSERVED_STD, full_matrices=False)
    scaled: FloatArray = basis * UNOBSERVED_STD
    return scaled


def split_pairs(T_a_b: FloatArray, pairs: PosePairs) -> Excited:
    """Split the directions by the motion itself, for solvers without relative motions.

    The lag with the most excited directions counts: at short lags noise hides the motion.
    """
    found = []
    for lag in lag_grid(pairs.stamps_ns, (0.5, 2.0, 8.0)):
        motions = _plausible(T_a_b, select_motions(pairs, f'B{lag}', _MOTIONS))
        found.append(split_equations(T_a_b, motions, linear.frobenius))
    return min(found, key=lambda excited: len(excited.unobserved))


def _plausible(T_a_b: FloatArray, motions: MotionPairs) -> MotionPairs:
    """Exclude motions with residuals beyond 20 medians.

    A single position kilometres away would count as noise that hides all excitation.
    """
    parted = np.linalg.norm(
        (motions.A @ T_a_b)[:, :3, 3] - (T_a_b @ motions.B)[:, :3, 3], axis=1)
    reach = float(np.linalg.norm(motions.A[:, :3, 3], axis=1).max(initial=0.0))
    return motions.picked(parted <= 20 * float(np.median(parted)) + se3.ROUNDING * reach)


def split_equations(
    T_a_b: FloatArray, motions: MotionPairs, linearise: Linearise,
    inliers: NDArray[np.bool_] | None = None,
) -> Excited:
    """Split the directions by the equations of a solver and the inliers it used."""
    if inliers is not None:
        motions = motions.picked(inliers)
    motions = motions.thinned(_MOTIONS)
    A, C = motions.A, T_a_b @ motions.B @ se3.inverse(T_a_b)
    of_a, of_b = linearise(T_a_b, A, A), linearise(T_a_b, C, C)
    Z_a, Z_b = of_a.instrument, of_b.instrument
    shared = linear.gram(Z_a, Z_b)
    own = 0.5 * (linear.gram(Z_a, Z_a) + linear.gram(Z_b, Z_b))
    cross = 0.5 * (linear.gram(Z_a, of_b.jacobian) + linear.gram(Z_b, of_a.jacobian))
    excited = _split(0.5 * (shared + shared.T), own, Z_a - Z_b, block_length(motions))
    # An error along an unobservable direction also changes the excited ones.
    basis, unobserved = excited.basis, excited.unobserved
    inverse = basis @ np.linalg.pinv(basis.T @ cross @ basis, rcond=1e-14) @ basis.T
    return Excited(basis, scaled_to_unobserved(unobserved - unobserved @ (inverse @ cross).T))


def _excitation_by_noise(rows: FloatArray, block: int) -> FloatArray:
    """Return the (K,) standard deviations of the shared excitation if there is only noise.

    ``rows`` (M, 6, K), the difference of both regressors, has the noise of both. Half of its
    autocovariance is that of each.
    """
    count = len(rows)
    variance = np.zeros(rows.shape[2])
    for lag in range(block + 1):
        for k in range(len(variance)):
            covariance = rows[lag:, :, k].T @ rows[:count - lag, :, k] / 2
            variance[k] += (1 if lag == 0 else 2) * np.sum(covariance**2) / count
    return np.sqrt(variance)
