# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The data of all figures, computed once from a result and its two trajectories."""

from __future__ import annotations

from dataclasses import dataclass
import itertools

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.motion_pairs import reference_indices
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.answer import answer_rows, Row, TO_DEGREES
from trajectory_calibration.outputs.report.clocks import Clocks, compare_clocks
from trajectory_calibration.outputs.report.page import metres
from trajectory_calibration.outputs.report.parts import (
    compare_parts,
    lag_of,
    lagged,
    Parts,
    time_scales,
)
from trajectory_calibration.outputs.report.tracks import compare_tracks, corrected_b, Tracks
from trajectory_calibration.result import CalibrationResult

# Most residuals, and most and fewest motions of one time scale.
_RESIDUALS, _OF_A_SCALE, _LEAST_OF_A_SCALE = 4000, 600, 6
_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
# Parts of the drive whose scales are compared.
_SCALE_PARTS = 8
# Durations of motions for the scale, seconds: the first one of which at least half of the motions
# have no jump, otherwise the last.
_SCALE_SECONDS = (2.0, 1.0, 0.5, 0.2)
# A scale is not shown if its standard deviation exceeds this many medians.
_VAGUE = 8.0


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals ``log(A^-1 C)`` of the motions, in the axes of a, metres and degrees.

    ``values`` (M, 6) at ``seconds`` (M,), the ends of the motions; ``sigma`` (M, 6) are standard
    deviations from the identified noise; ``excluded`` (M,): across a jump. For S time scales
    ``scales_s``: ``by_scale`` (S, 2, 5) are the 5, 25, 50, 75, 95 % quantiles of the norms of
    translation and rotation, ``expected`` (S, 2) their root mean squares from the noise.
    """

    seconds: FloatArray
    values: FloatArray
    sigma: FloatArray
    excluded: NDArray[np.bool_]
    scales_s: FloatArray
    by_scale: FloatArray
    expected: FloatArray

    def of_used(self) -> tuple[FloatArray, FloatArray]:
        """Return (U, 6) values that are not excluded, or all, and the normalised ones."""
        used = ~self.excluded if not self.excluded.all() else slice(None)
        return self.values[used], self.values[used] / np.maximum(self.sigma[used], 1e-300)


@dataclass(frozen=True, eq=False)
class ReportData:
    """A result and the data of its figures.

    ``scale`` (S, 3): for each part of the drive the time of its middle (seconds), the scale of b
    relative to that of the answer, and the standard deviation.
    """

    result: CalibrationResult
    rows: tuple[Row, ...]
    tracks: Tracks
    parts: Parts
    residuals: Residuals
    clocks: Clocks
    scale: FloatArray

    @property
    def need_deg(self) -> float | None:
        """Return the rotation per motion, deg, that gives a standard deviation at 'weak'.

        From the best known direction of the translation: standard deviation times gain is the
        same for all directions. None without a covariance.
        """
        P, axes = self.result.covariance, np.array(self.result.observability.translation_axes)
        if P is None or not len(axes):
            return None
        std = np.sqrt(np.maximum(np.einsum('ki,ij,kj->k', axes, P[:3, :3], axes), 0.0))
        least = np.min(std * self.result.observability.translation_gain)
        return np.rad2deg(least / max(self.result.config.weak_translation, 1e-9))

    @property
    def driven(self) -> str:
        """Return the path length and duration of sensor a as text."""
        return f'{metres(self.tracks.path_m[-1])} in {self.tracks.seconds[-1]:.0f} s'


def report_data(
    result: CalibrationResult, a: Trajectory, b: Trajectory,
    T_a_b_true: FloatArray | None = None,
) -> ReportData:
    """Compute the data of the figures.

    Raises AssociationError if the two have no common time with the clock of the result.
    """
    b = corrected_b(result, b)
    tracks = compare_tracks(result, a, b)
    return ReportData(
        result, answer_rows(result, T_a_b_true), tracks,
        compare_parts(tracks, result), _residuals(tracks, result), compare_clocks(a, b),
        _path_scale(tracks))


def _residuals(tracks: Tracks, result: CalibrationResult) -> Residuals:
    i, j = reference_indices(result.reference or 'B1', len(tracks))
    every = slice(None, None, max(1, len(i) // _RESIDUALS))
    i, j = i[every], j[every]
    values, sigma = _of_motions(tracks, result.T_a_b, i, j)
    jumps = np.concatenate([[0], np.cumsum(~tracks.usable)])
    scales, quantiles, expected = [], [], []
    for seconds, lag in time_scales(tracks):
        if lag >= len(tracks):
            continue
        first, last = lagged(tracks, lag, _OF_A_SCALE)
        stride = int(np.median(np.diff(first))) if len(first) > 1 else 1
        # Overlapping motions count once.
        if len(first) * min(1.0, stride / lag) < _LEAST_OF_A_SCALE:
            continue
        error, likely = (values.reshape(-1, 2, 3) for values in _of_motions(
            tracks, result.T_a_b, first, last))
        scales.append(seconds)
        quantiles.append(np.quantile(np.linalg.norm(error, axis=2), _QUANTILES, axis=0).T)
        expected.append(np.sqrt(np.mean(np.sum(likely**2, axis=2), axis=0)))
    return Residuals(
        tracks.seconds[j], values, sigma, jumps[i] != jumps[j],
        np.array(scales), np.array(quantiles).reshape(-1, 2, 5),
        np.array(expected).reshape(-1, 2))


def _of_motions(
    tracks: Tracks, T_a_b: FloatArray, i: NDArray[np.intp], j: NDArray[np.intp],
) -> tuple[FloatArray, FloatArray]:
    """Return (M, 6) residuals and their standard deviations, metres and degrees."""
    A, _, values = tracks.motions(i, j)
    sigma = np.sqrt(np.diagonal(tracks.covariance(T_a_b, A, i, j), axis1=1, axis2=2))
    return values * TO_DEGREES, sigma * TO_DEGREES


def _path_scale(tracks: Tracks) -> FloatArray:
    """Return the ``scale`` of ``ReportData``: translations of a regressed on those of b."""
    for seconds in _SCALE_SECONDS:
        i, j = lagged(tracks, lag_of(tracks, seconds), _RESIDUALS)
        if len(i) > 0.5 * min(len(tracks), _RESIDUALS):
            break
    if len(i) < 5 * _SCALE_PARTS:
        return np.zeros((0, 3))
    of_a, of_c = (motions[:, :3, 3] for motions in tracks.motions(i, j)[:2])
    overlap = max(1.0, np.mean(j - i) / max(1, int(np.median(np.diff(i)))))
    found = []
    for low, high in itertools.pairwise(np.linspace(0, tracks.seconds[-1], _SCALE_PARTS + 1)):
        part = (tracks.seconds[i] >= low) & (tracks.seconds[i] <= high)
        square = np.sum(of_c[part] ** 2)
        if part.sum() < 5 or square <= 1e-9:
            continue
        ratio = np.sum(of_a[part] * of_c[part]) / square
        score = np.sum((of_a[part] - ratio * of_c[part]) * of_c[part], axis=1)
        found.append((0.5 * (low + high), ratio, np.sqrt(np.sum(score**2) * overlap) / square))
    scale = np.reshape(found, (-1, 3))
    median = np.median(scale[:, 2]) if found else 0.0
    # A nearly stationary sensor does not determine the scale.
    return scale[scale[:, 2] <= max(_VAGUE * median, 1e-4)]
