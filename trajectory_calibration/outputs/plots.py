# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The figures of the report in Matplotlib: for notebooks, papers, PNG, SVG and PDF.

``Figure`` is used without pyplot: no window, no global state, no backend to choose.
"""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np

from trajectory_calibration.config.yaml_file import write_text
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import require
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.answer import answer_rows
from trajectory_calibration.outputs.report import drawings as draw
from trajectory_calibration.outputs.report.data import report_data, ReportData
from trajectory_calibration.outputs.report.figures import Plot
from trajectory_calibration.result import CalibrationResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ('png', 'svg', 'pdf')

_A, _B, _SOFT = '#1769aa', '#c4570a', '#7a828a'
# Colour, width and dashes of the classes of the style sheet that are no plain line of a.
_STYLES = {
    'line-b wide': (_B, 2.4, '-'), 'line-thin': (_A, 0.6, '-'), 'line-x': ('#c0392b', 1.2, '-'),
    'line-y': ('#2e8b57', 1.2, '--'), 'line-z': ('#2c6fbb', 1.2, ':'),
    'jump': ('#c2185b', 1.0, '-'), 'need': (_SOFT, 0.8, '--'), 'zero': (_SOFT, 0.8, '-'),
    'far': ('#b3261e', 1.0, '-'), 'fill-weak': ('#96600a', 1.0, '-')}
_LABELS = {f'line-{axis}': axis for axis in 'xyz'}
_ANCHORS = {'start': 'left', 'middle': 'center', 'end': 'right'}
_STATUS = {'ok': '#1b7a48', 'weak': '#96600a', 'unknown': '#b3261e', 'prior': '#6a4bb4'}


def plot(
    result: CalibrationResult, a: Trajectory | None = None, b: Trajectory | None = None,
    T_a_b_true: FloatArray | None = None,
) -> Figure:
    """Return a figure of a result: its deviations, and with both trajectories what they show."""
    if a is None or b is None:
        return _deviations(result)
    return _overview(report_data(result, a, b, T_a_b_true))


def save_plots(data: ReportData, folder: Path) -> None:
    """Write every figure in each format; raises ResultError where that cannot be."""
    for name, drawn in _FIGURES.items():
        figure = drawn(data)
        # Laid out once, not for each format.
        figure.draw_without_rendering()
        figure.set_layout_engine('none')
        for kind in FORMATS:
            stream = BytesIO()
            figure.savefig(stream, format=kind, dpi=130)
            write_text(folder / f'{name}.{kind}', stream.getvalue())


def plot_files(folder: Path) -> list[Path]:
    """Return the files that ``save_plots`` writes; MissingPackageError where it cannot draw."""
    require('matplotlib.figure')
    return [folder / f'{name}.{kind}' for name in _FIGURES for kind in FORMATS]


def _figure(width: float, height: float, title: str) -> Figure:
    figure: Figure = require('matplotlib.figure').Figure(
        figsize=(width, height), layout='constrained')
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
        weak, unobserved = part[0].weak_limit, part[0].unobserved_limit
        for k, row in enumerate(part):
            std = row.std if row.is_known and row.std is not None else unobserved
            std = np.clip(std, weak / 90, unobserved * 3)
            axes.barh(2 - k, std, color=_STATUS[row.word], height=0.5)
            words = f' {row.value:.3f} {row.unit}, {row.word}' if row.is_known else ' unknown'
            axes.text(std, 2 - k, words, va='center', fontsize=8)
        for limit in (weak, unobserved):
            axes.axvline(limit, color=_SOFT, lw=0.8, ls='--')
        axes.set(xscale='log', xlim=(weak / 100, unobserved * 30))
        axes.set_yticks([2, 1, 0], [row.name for row in part])
        _plain(axes, '', f'standard deviation, {part[0].unit}', '')
    return figure


def _overview(data: ReportData) -> Figure:
    figure = _figure(11, 6.4, _title(data.result))
    axes: Any = figure.add_subplot(2, 3, 1, projection='3d')
    for poses, colour, name in ((data.tracks.poses_c, _B, data.result.frame_b),
                                (data.tracks.pairs.poses_a, _A, data.result.frame_a)):
        axes.plot(*poses[:, :3, 3].T, color=colour, lw=1.0, label=name)
    axes.set_aspect('equal', adjustable='datalim')
    axes.set_title('both tracks, m', fontsize=9, loc='left')
    axes.tick_params(labelsize=7)
    axes.legend(fontsize=8, frameon=False)
    plots = [draw.distance_over_time(data), draw.rotation_by_axis(data),
             draw.deviation_over_time(data, rotation=False), draw.rates(data.clocks)]
    if len(data.clocks.offsets_s):
        plots.append(draw.offset_curve(data.clocks))
    for k, item in enumerate(plots, 2):
        _copy(item, figure.add_subplot(2, 3, k))
    return figure


def _copy(plot: Plot, axes: Any) -> None:
    """Draw a plot of the report on Matplotlib axes, which keep its numbers."""
    if plot.log_y:
        axes.set_yscale('log')
    axes.set(xlim=plot.x, ylim=plot.y)
    for given, put in ((plot.x_ticks, axes.set_xticks), (plot.y_ticks, axes.set_yticks)):
        if given is not None:
            put([value for value, _ in given], [words for _, words in given])
    _plain(axes, plot.name, plot.x_label, plot.y_label)
    for mark in plot.marks:
        colour, width, dashes = _STYLES.get(mark.style.removesuffix(' bar'), (_A, 1.0, '-'))
        if mark.kind == 'words':
            x, y = mark.shift
            axes.annotate(mark.words, (mark.x[0], mark.y[0]), (x, -y), fontsize=7,
                          textcoords='offset points', ha=_ANCHORS[mark.style])
        elif mark.kind == 'area':
            axes.fill(mark.x, mark.y, color=colour, lw=0,
                      alpha=0.12 if mark.style.startswith('band') else 0.8)
        elif mark.kind == 'dots':
            axes.plot(mark.x, mark.y, 'o', ms=mark.size, color=colour)
        else:
            axes.plot(mark.x, mark.y, color=colour, lw=width, ls=dashes,
                      label=_LABELS.get(mark.style))
    if any(mark.style in _LABELS for mark in plot.marks):
        axes.legend(fontsize=8, frameon=False)


def _of_each(
    plot_of: Callable[[ReportData, int], Plot], title: str,
) -> Callable[[ReportData], Figure]:
    """Return the function that draws a plot of each of the six numbers."""
    def drawn(data: ReportData) -> Figure:
        figure = _figure(10, 5, f'{_title(data.result)}: {title}')
        for k in range(6):
            _copy(plot_of(data, k), figure.add_subplot(2, 3, k + 1))
        return figure
    return drawn


# Name of the file -> function of the data.
_FIGURES: dict[str, Callable[[ReportData], Figure]] = {
    'overview': _overview, 'deviations': lambda data: _deviations(data.result),
    'parts': _of_each(draw.part_plot, 'parts of the data, minus the answer'),
    'residuals': _of_each(draw.residual_over_time, 'residuals')}
