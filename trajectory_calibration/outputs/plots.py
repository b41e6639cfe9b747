# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The figures of the report in Matplotlib: for notebooks, papers, PNG, SVG and PDF.

``Figure`` is used without pyplot: no window, no global state, no backend to choose.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import ResultError
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.answer import answer_rows
from trajectory_calibration.outputs.report.data import report_data, ReportData
from trajectory_calibration.outputs.report.drawings import AXES, unit_of
from trajectory_calibration.result import CalibrationResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ('png', 'svg', 'pdf')

_A, _B, _JUMP, _SOFT = '#1769aa', '#c4570a', '#c2185b', '#7a828a'
_AXIS = ('#c0392b', '#2e8b57', '#2c6fbb')
# Residuals that a page can show.
_POINTS = 1000
_LINES = ('-', '--', ':')
_STATUS = {'ok': '#1b7a48', 'weak': '#96600a', 'unknown': '#b3261e', 'prior': '#6a4bb4'}


def plot(
    result: CalibrationResult, a: Trajectory | None = None, b: Trajectory | None = None,
    T_a_b_true: FloatArray | None = None,
) -> Figure:
    """Return a figure of a result: its deviations, and with both trajectories what they show."""
    if a is None or b is None:
        return _deviations(result)
    return _overview(report_data(result, a, b, T_a_b_true))


def save_plots(
    data: ReportData, folder: Path, formats: Sequence[str] = FORMATS,
) -> list[Path]:
    """Write every figure in each format; return the files.

    Raises
    ------
    ResultError
        The folder or a file cannot be written.

    """
    written = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, draw in _FIGURES.items():
            figure = draw(data)
            # Laid out once, not for each format.
            figure.draw_without_rendering()
            figure.set_layout_engine('none')
            for kind in formats:
                path = folder / f'{name}.{kind}'
                figure.savefig(path, dpi=130)
                written.append(path)
    except OSError as error:
        raise ResultError(
            f'{folder} cannot be written: {error.strerror or error}; give another folder'
        ) from error
    return written


def plot_files(folder: Path, formats: Sequence[str] = FORMATS) -> list[Path]:
    """Return the files that ``save_plots`` writes."""
    return [folder / f'{name}.{kind}' for name in _FIGURES for kind in formats]


def _figure(width: float, height: float, title: str) -> Figure:
    from matplotlib.figure import Figure
    figure = Figure(figsize=(width, height), layout='constrained')
    figure.suptitle(title, fontsize=11, fontweight='bold')
    return figure


def _title(result: CalibrationResult) -> str:
    return f'Pose of {result.frame_b} in {result.frame_a}'


def _plain(axes: Any, title: str, x: str, y: str) -> None:
    axes.set_title(title, fontsize=9, loc='left')
    axes.set_xlabel(x, fontsize=8)
    axes.set_ylabel(y, fontsize=8)
    axes.tick_params(labelsize=8)
    axes.spines[['top', 'right']].set_visible(False)


def _deviations(result: CalibrationResult) -> Figure:
    """Draw the standard deviation of each number beside its two limits."""
    figure = _figure(6.4, 2.8, _title(result))
    rows = answer_rows(result)
    for column, part in enumerate((rows[:3], rows[3:])):
        axes = figure.add_subplot(1, 2, column + 1)
        for k, row in enumerate(part):
            std = row.std if row.is_known and row.std is not None else row.unobserved_limit
            std = float(np.clip(std, row.weak_limit / 90, row.unobserved_limit * 3))
            axes.barh(2 - k, std, color=_STATUS[row.word], height=0.5)
            words = f' {row.value:.3f} {row.unit}, {row.word}' if row.is_known else ' unknown'
            axes.text(std, 2 - k, words, va='center', fontsize=8)
        row = part[0]
        for limit in (row.weak_limit, row.unobserved_limit):
            axes.axvline(limit, color=_SOFT, lw=0.8, ls='--')
        axes.set_xscale('log')
        axes.set_xlim(row.weak_limit / 100, row.unobserved_limit * 30)
        axes.set_yticks([2, 1, 0], [row.name for row in part])
        _plain(axes, '', f'standard deviation, {row.unit}', '')
    return figure


def _overview(data: ReportData) -> Figure:
    figure = _figure(11, 6.4, _title(data.result))
    grid = figure.add_gridspec(2, 3)
    tracks, clocks = data.tracks, data.clocks
    axes: Any = figure.add_subplot(grid[0, 0], projection='3d')
    for poses, colour, name in (
            (tracks.poses_c, _B, data.result.frame_b), (tracks.pairs.poses_a, _A,
                                                        data.result.frame_a)):
        axes.plot(*poses[:, :3, 3].T, color=colour, lw=1.0, label=name)
    axes.set_aspect('equal', adjustable='datalim')
    axes.set_title('both tracks, m', fontsize=9, loc='left')
    axes.tick_params(labelsize=7)
    axes.legend(fontsize=8, frameon=False)
    axes = figure.add_subplot(grid[0, 1])
    axes.plot(tracks.seconds, tracks.distance_m, color=_A, lw=1)
    axes.plot(tracks.seconds[tracks.jumps], tracks.distance_m[tracks.jumps], '.', color=_JUMP)
    _plain(axes, 'distance between the tracks', 'time, s', 'm')
    axes = figure.add_subplot(grid[0, 2])
    axes.bar(range(3), data.result.observability.excitation_deg, color=_A, width=0.5)
    if data.need_deg is not None:
        axes.axhline(data.need_deg, color=_SOFT, ls='--', lw=1)
    axes.set_yscale('log')
    axes.set_xticks(range(3), ['about x', 'about y', 'about z'])
    _plain(axes, 'rotation by axis; dashed: need', '', 'deg per motion, rms')
    axes = figure.add_subplot(grid[1, 0])
    for k in range(3):
        axes.plot(data.parts.growth_s, data.parts.growth_std[:, k], _LINES[k], color=_AXIS[k],
                  label='xyz'[k])
    axes.set_yscale('log')
    axes.axhline(data.result.config.weak_translation, color=_SOFT, ls='--', lw=1)
    axes.legend(fontsize=8, frameon=False)
    _plain(axes, 'translation against driving time', 'driven, s', 'standard deviation, m')
    axes = figure.add_subplot(grid[1, 1])
    axes.plot(clocks.seconds, clocks.rate_b, color=_B, lw=2.4, alpha=0.6)
    axes.plot(clocks.seconds, clocks.rate_a, color=_A, lw=1)
    _plain(axes, 'angular rates', 'time, s', 'deg/s')
    axes = figure.add_subplot(grid[1, 2])
    axes.plot(clocks.offsets_s, clocks.correlation, color=_A)
    axes.axvline(0, color=_SOFT, ls='--', lw=1)
    _plain(axes, 'agreement by clock offset', 'further clock offset, s', 'correlation')
    return figure


def _parts(data: ReportData) -> Figure:
    figure = _figure(10, 5, f'{_title(data.result)}: parts of the data, minus the answer')
    for k in range(6):
        axes = figure.add_subplot(2, 3, k + 1)
        found = data.of_parts(k)
        place = np.arange(len(found.names))
        axes.errorbar(place[found.known], found.values[found.known], 2 * found.std[found.known],
                      fmt='o', ms=3, color=_A, capsize=2, lw=1)
        axes.axhline(0, color=_SOFT, lw=0.8)
        if not found.is_open:
            axes.axhspan(-2 * found.own, 2 * found.own, color=_A, alpha=0.12, lw=0)
        axes.set_xticks(place, [name if name.startswith('Q') else f'{name} s'
                                for name in found.names], rotation=45)
        _plain(axes, AXES[k] + (': unknown' if found.is_open else ''), '', unit_of(k))
    return figure


def _residuals(data: ReportData) -> Figure:
    figure = _figure(10, 5, f'{_title(data.result)}: residuals')
    found = data.residuals
    every = slice(None, None, max(1, len(found.seconds) // _POINTS))
    seconds, sigma = found.seconds[every], found.sigma[every]
    values = np.where(found.excluded[:, None], np.nan, found.values)[every]
    for k in range(6):
        axes = figure.add_subplot(2, 3, k + 1)
        axes.fill_between(seconds, -3 * sigma[:, k], 3 * sigma[:, k], color=_A, alpha=0.12, lw=0)
        axes.plot(seconds, values[:, k], color=_A, lw=0.6)
        _plain(axes, AXES[k], 'time, s', unit_of(k))
    return figure


# Name of the file -> function of the data.
_FIGURES: dict[str, Callable[[ReportData], Figure]] = {
    'overview': _overview, 'deviations': lambda data: _deviations(data.result), 'parts': _parts,
    'residuals': _residuals}
