# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The noise between two trajectories, read off their disagreement over longer and longer motions.

Two sensors on one body should report the same motion. The mean square of their disagreement over
n poses, the variogram, has the share ``2 white`` that does not depend on n, the noise of single
poses, and a share that grows with the distance, the random walk of drift and jumps. Two numbers
for each of translation and rotation are few enough to be known from a hundred poses, where the
36 of a covariance of scores are not.

N. Cressie, D. M. Hawkins, "Robust estimation of the variogram", Mathematical Geology 12(2), 1980,
doi:10.1007/BF01035243, for the idea; D. W. Allan's variance of clocks is the same one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.motion_pairs import lag_grid
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# Lags, seconds, up to this share of the poses: beyond, too few motions are independent.
_LAGS = (0.1, 0.2, 0.3, 0.5, 0.8, 1.2, 2.0, 3.0, 5.0, 8.0)
_LARGEST_LAG = 0.25

# Motions of one lag that are looked at; more would not change a variance by a tenth.
_MOTIONS_OF_A_LAG = 1000

_REWEIGHTINGS = 5

# What one more variance lowers a sum of squares by through chance, seldom; lags share poses, so
# that chance does more than a chi-square would allow.
_CHANCE = 9.0

# Smallest standard deviation of white noise, metres and radians: rounding of files and floats.
_LEAST = 1e-10

# A step has at least this share of the mean length, so that a sensor at rest may still drift.
_REST_SHARE = 0.1


@dataclass(frozen=True)
class PairNoise:
    """Noise of both sensors together; standard deviations of one axis.

    Attributes
    ----------
    white_translation, white_rotation : of one pose, metres and radians.
    walk_translation, walk_rotation : after one metre, metres and radians.

    """

    white_translation: float
    white_rotation: float
    walk_translation: float
    walk_rotation: float

    def white_covariance(self, T_a_b: FloatArray) -> FloatArray:
        """Return the (6, 6) covariance of a pose of b, (rho, phi) in the axes of a."""
        return _shared(self.white_translation, self.white_rotation, T_a_b)

    def walk_covariance(self, T_a_b: FloatArray) -> FloatArray:
        """Return the (6, 6) covariance of a step of one metre, as ``white_covariance``."""
        return _shared(self.walk_translation, self.walk_rotation, T_a_b)


def _shared(translation: float, rotation: float, T_a_b: FloatArray) -> FloatArray:
    """Give half to each sensor in its own axes; the half of b reaches a through the lever arm."""
    own = np.diag(np.repeat([translation, rotation], 3)**2)
    Ad = se3.adjoint(T_a_b)
    covariance: FloatArray = 0.5 * (own + Ad @ own @ Ad.T)
    return covariance


def step_lengths(poses: FloatArray) -> FloatArray:
    """Return the (N - 1,) lengths, metres, that drift is counted in, of (N, 4, 4) poses."""
    length = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    mean = float(length.mean())
    return length + _REST_SHARE * mean if mean > 0 else np.ones(len(length))


def identify_noise(
    stamps_ns: NDArray[np.int64], poses_a: FloatArray, poses_c: FloatArray,
    usable: NDArray[np.bool_],
) -> PairNoise:
    """Fit white noise and walk to the disagreement of two trajectories.

    ``stamps_ns`` (N,) are of the poses of sensor a, (N, 4, 4), and of those that b reports of a,
    ``T_a_b B_k T_a_b^-1``, in any world. Motions across steps that are not ``usable``, (N - 1,),
    are left out. No deviation of white noise is zero, because files and floats are rounded.
    """
    along = np.concatenate([[0.0], np.cumsum(step_lengths(poses_a))])
    bad = np.concatenate([[0], np.cumsum(~usable)])
    rows = []
    for lag in lag_grid(stamps_ns, _LAGS, _LARGEST_LAG):
        i = np.flatnonzero(bad[lag:] == bad[:-lag])
        i = i[::-(-len(i) // _MOTIONS_OF_A_LAG) or 1]
        if len(i) < 2:
            continue
        A, C = (se3.inverse(poses[i]) @ poses[i + lag] for poses in (poses_a, poses_c))
        error = se3.log_se3(se3.inverse(A) @ C)
        rows.append((lag, float(np.mean(along[i + lag] - along[i])),
                     float(np.mean(error[:, :3]**2)), float(np.mean(error[:, 3:]**2)),
                     float(np.mean(np.sum(A[:, :3, 3]**2, axis=1)))))
    if not rows:
        return PairNoise(_LEAST, _LEAST, 0.0, 0.0)
    lag, distance, translation, rotation, moved = np.array(rows).T
    white_r, walk_r = _fit(len(poses_a), lag, distance, rotation)
    # What the rotation noise of the start does to the translation at the end, two axes of three:
    # all of the white noise, a third of what accumulates on the way.
    swung = 2 / 3 * moved * (white_r + walk_r * distance / 3)
    white_t, walk_t = _fit(
        len(poses_a), lag, distance, np.maximum(translation - swung, 1e-3 * translation))
    return PairNoise(max(np.sqrt(white_t), _LEAST), max(np.sqrt(white_r), _LEAST),
                     np.sqrt(walk_t), np.sqrt(walk_r))


def _fit(
    poses: int, lag: FloatArray, distance: FloatArray, variogram: FloatArray,
) -> tuple[float, float]:
    """Return variances >= 0 of ``variogram = 2 white + distance walk``, both for one axis.

    One of them is zero if it may: where it lowers the sum of squares by less than chance does.
    """
    columns = np.column_stack([np.full(len(lag), 2.0), distance])
    expected = np.maximum(variogram, _LEAST**2)
    found: FloatArray = np.zeros(2)
    for _ in range(_REWEIGHTINGS):
        # Motions of n poses overlap n-fold: so many of their 3 x poses squares are independent.
        root = np.sqrt(1.5 * poses / lag) / expected
        X, y = columns * root[:, None], variogram * root
        alone = np.maximum(X.T @ y / np.sum(X**2, axis=0), 0.0)
        cost = np.sum((X * alone - y[:, None])**2, axis=0)
        found = np.where(np.arange(2) == np.argmin(cost), alone, 0.0)
        both = np.linalg.lstsq(X, y, rcond=None)[0]
        if (both >= 0).all() and np.sum((X @ both - y)**2) < cost.min() - _CHANCE:
            found = np.asarray(both, dtype=np.float64)
        expected = np.maximum(columns @ found, _LEAST**2)
    return float(found[0]), float(found[1])
