# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which directions of an extrinsic the motion excited, and which only noise pretends to.

Noise in the rotations passes for motion: on flat ground the pitch and roll that a sensor reports
are noise, a sum of squares counts them as excitation, and the height between the sensors comes
out wrong with a small standard deviation. The product of what a saw with what b saw is free of
that: their noises are independent, so that noise alone gives zero on average. A direction in
which the product does not stand out of its own noise is not observed.

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

# Blocks of correlated motions: this many lags of the reference, at most a fifth of the data.
_BLOCK_LAGS = 3
_BLOCK_SHARE = 0.2

# Relative to the largest eigenvalue of a sum of squares: nothing but rounding.
_UNSEEN = 1e-12

# Directions with less than this share of true excitation are tested against noise.
_SUSPECT_SHARE = 0.5

# Excitation counts when it exceeds this many standard deviations of what noise alone would give:
# a tenth of a false alarm, because noise that passes for motion makes a wrong answer look sure.
_SIGNIFICANT = float(np.sqrt(chi_squared.quantile(1, 0.1 * chi_squared.FALSE_ALARM)))

# A disagreement of this many usual ones is a glitch.
_GLITCH = 20.0

# Lags, seconds, at which the motion of a solver without a reference is judged, and motions that
# suffice.
_LAGS = (0.5, 2.0, 8.0)
_MOTIONS = 4000


@dataclass(frozen=True, eq=False)
class Excited:
    """The space of (dt, dtheta), split by what the motion says.

    ``basis`` (6, 6 - K) has columns that span the excited directions, ``unobserved`` (K, 6) are
    the others, each as long as ``UNOBSERVED_STD``.
    """

    basis: FloatArray
    unobserved: FloatArray


def block_length(motions: MotionPairs) -> int:
    """Return the number of consecutive motions that are taken to be correlated."""
    count = len(motions)
    end = motions.j[0] + _BLOCK_LAGS * parse_reference(motions.reference)[1]
    lags = int(np.searchsorted(motions.j, end))
    return max(1, min(max(lags, round(2 * count**(1 / 3))), int(_BLOCK_SHARE * count)))


def _split(shared: FloatArray, own: FloatArray, apart: FloatArray, block: int) -> Excited:
    """Split the directions by their excitation.

    In the basis that makes what each sensor saw the identity, what both saw has eigenvalues
    near one where they saw the same turns, and near zero where each saw its own noise. ``shared``
    and ``own`` (6, 6) are sums of what a saw times what b saw, and of what each saw times itself,
    the mean of both; ``apart`` (M, 6, 6) is what a saw minus what b saw.
    """
    largest = np.diagonal(own).reshape(2, 3).max(axis=1)
    scale = np.repeat(np.sqrt(np.maximum(largest, np.finfo(float).tiny)), 3)
    eigenvalues, vectors = np.linalg.eigh(own / np.outer(scale, scale))
    seen = eigenvalues > _UNSEEN * eigenvalues[-1]
    unseen = vectors[:, ~seen] / scale[:, None]
    basis = vectors[:, seen] / np.sqrt(eigenvalues[seen]) / scale[:, None]
    share, rotation = np.linalg.eigh(basis.T @ shared @ basis)
    basis = basis @ rotation
    excited = share > _SUSPECT_SHARE
    suspects = np.flatnonzero(~excited)
    if len(suspects):
        noise = _excitation_by_noise(apart @ basis[:, suspects], block)
        excited[suspects] = share[suspects] > _SIGNIFICANT * noise
    directions = np.concatenate([basis[:, ~excited], unseen], axis=1).T
    return Excited(basis[:, excited], scaled_to_unobserved(directions))


def scaled_to_unobserved(directions: FloatArray) -> FloatArray:
    """Return (K, 6) directions, each as long as ``UNOBSERVED_STD``."""
    # What they span is unobserved, not each by itself: lengthened one by one until its translation
    # is, a rotation that comes along with it would pass for known.
    _, _, basis = np.linalg.svd(directions / UNOBSERVED_STD, full_matrices=False)
    scaled: FloatArray = basis * UNOBSERVED_STD
    return scaled


def split_pairs(T_a_b: FloatArray, pairs: PosePairs) -> Excited:
    """Split the directions by the motion itself, for solvers that use no relative motions.

    Over several lags, and by the one that shows most: noise hides short motions.
    """
    found = []
    for lag in lag_grid(pairs.stamps_ns, _LAGS):
        motions = _plausible(T_a_b, select_motions(pairs, f'B{lag}', _MOTIONS))
        found.append(split_equations(T_a_b, motions, linear.frobenius))
    return min(found, key=lambda excited: len(excited.unobserved))


def _plausible(T_a_b: FloatArray, motions: MotionPairs) -> MotionPairs:
    """Leave out motions in which the sensors part by far more than in most: a glitch of one.

    A single position kilometres away would pass for noise that hides all excitation.
    """
    parted = np.linalg.norm(
        (motions.A @ T_a_b)[:, :3, 3] - (T_a_b @ motions.B)[:, :3, 3], axis=1)
    reach = float(np.linalg.norm(motions.A[:, :3, 3], axis=1).max(initial=0.0))
    return motions.picked(parted <= _GLITCH * float(np.median(parted)) + _UNSEEN * reach)


def split_equations(
    T_a_b: FloatArray, motions: MotionPairs, linearise: Linearise,
    inliers: NDArray[np.bool_] | None = None,
) -> Excited:
    """Split the directions by the equations of a solver and the motions it kept."""
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
    # What is found after an unobserved direction goes wrong with it.
    basis, unobserved = excited.basis, excited.unobserved
    inverse = basis @ np.linalg.pinv(basis.T @ cross @ basis, rcond=1e-14) @ basis.T
    return Excited(basis, scaled_to_unobserved(unobserved - unobserved @ (inverse @ cross).T))


def _excitation_by_noise(rows: FloatArray, block: int) -> FloatArray:
    """Return (K,) standard deviations of the shared excitation if both saw only noise.

    The difference of what a and b saw, (M, 6, K), holds the noise of both; half of its
    autocovariance is taken for either.
    """
    count = len(rows)
    variance = np.zeros(rows.shape[2])
    for lag in range(block + 1):
        for k in range(len(variance)):
            covariance = rows[lag:, :, k].T @ rows[:count - lag, :, k] / 2
            variance[k] += (1 if lag == 0 else 2) * np.sum(covariance**2) / count
    return np.sqrt(variance)
