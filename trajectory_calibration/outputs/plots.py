# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The figures of the report in Matplotlib, for notebooks, PNG, SVG and PDF.

``Figure`` is used without pyplot: no window, no global state, no backend.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from io import BytesIO
from pathlib import Path
import re
from typing import Any, TYPE_CHECKING

import numpy as np

from trajectory_calibration.config.yaml_file import write_text
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import require
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.answer import answer_rows, WORDS
from trajectory_calibration.outputs.report.data import report_data, ReportData
from trajectory_calibration.outputs.report.figures import Plot
from trajectory_calibration.outputs.report.page import asset
from trajectory_calibration.outputs.report.page import Figure as Shown
from trajectory_calibration.outputs.report.sections import (
    clock_figures,
    motion_figures,
    part_figures,
    residual_figures,
    track_figures,
)
from trajectory_calibration.result import CalibrationResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ('png', 'svg', 'pdf')

# Colour, width and dashes by class of the style sheet; others are plain lines of a.
_STYLES = {
    'line-b wide': ('b', 2.4, '-'), 'line-thin': ('a', 0.6, '-'), 'line-x': ('x', 1.2, '-'),
    'line-y': ('y', 1.2, '--'), 'line-z': ('z', 1.2, ':'), 'jump': ('jump', 1.0, '-'),
    'need': ('soft', 0.8, '--'), 'zero': ('soft', 0.8, '-'), 'far': ('unknown', 1.0, '-'),
    **{f'fill-{word}': (word, 1.0, '-') for word in WORDS.values()}}
_ANCHORS = {'start': 'left', 'middle': 'center', 'end': 'right'}


def plot(
    result: CalibrationResult, a: Trajectory | None = None, b: Trajectory | None = None,
    T_a_b_true: FloatArray | None = None,
) -> Figure:
    """Return a figure of a result: its standard deviations, or with trajectories an overview."""
    if a is None or b is None:
        return _deviations(result)
    return _overview(report_data(result, a, b, T_a_b_true))


def save_plots(data: ReportData, folder: Path) -> None:
    """Write every figure in each format; raises ResultError if a file cannot be written."""
    for name, drawn in _FIGURES.items():
        figure = drawn(data)
        # The layout is computed once, not for each format.
        figure.draw_without_rendering()
        figure.set_layout_engine('none')
        for kind in FORMATS:
            stream = BytesIO()
            figure.savefig(stream, format=kind, dpi=130)
            write_text(folder / f'{name}.{kind}', stream.getvalue())


def plot_files(folder: Path) -> list[Path]:
    """Return the files of ``save_plots``; raises MissingPackageError without Matplotlib."""
    require('matplotlib.figure')
    return [folder / f'{name}.{kind}' for name in _FIGURES for kind in FORMATS]


def _drawn(result: CalibrationResult, plots: dict[str, Plot | None], more: str = '') -> Figure:
    """Return a figure of plots by title; for None the axes are three-dimensional."""
    columns = min(3, len(plots))
    rows = -(-len(plots) // columns)
    figure: Figure = require('matplotlib.figure').Figure(
        figsize=(3.5 * columns, 3 * rows), layout='constrained')
    figure.suptitle(f'Pose of {result.frame_b} in {result.frame_a}{more}', fontsize=11,
                    fontweight='bold')
    for k, (title, plot) in enumerate(plots.items(), 1):
        axes = figure.add_subplot(rows, columns, k, projection=None if plot else '3d')
        axes.set_title(title, fontsize=9, loc='left')
        if plot is not None:
            _copy(plot, axes)
    return figure


def _deviations(result: CalibrationResult) -> Figure:
    """Return a figure of the standard deviation of each number, with its two limits."""
    rows = answer_rows(result)
    plots: dict[str, Plot | None] = {}
    for title, part in (('translation', rows[:3]), ('rotation', rows[3:])):
        weak, unobserved = part[0].weak_limit, part[0].unobserved_limit
        plots[title] = plot = Plot(
            (-0.6, 2.6), (weak / 100, unobserved * 5), log_y=True,
            y_label=f'standard deviation, {part[0].unit}', x_ticks=[
                (k, f'{row.name}\n{row.value_text}\n{row.std_text and row.word}')
                for k, row in enumerate(part)])
        for k, row in enumerate(part):
            std = unobserved if row.std is None else row.std
            plot.rectangle((k - 0.3, k + 0.3), (weak / 100, np.clip(
                std, weak / 90, unobserved * 3)), f'fill-{row.word}')
        for limit in (weak, unobserved):
            plot.horizontal(limit, 'need')
    return _drawn(result, plots)


def _titled(figures: list[Shown], *kinds: str) -> dict[str, Plot | None]:
    """Return the plots of these kinds by title."""
    return {shown.title: shown.picture for shown in figures
            if shown.kind in kinds and isinstance(shown.picture, Plot)}


def _overview(data: ReportData) -> Figure:
    result = data.result
    shown = _titled(
        [*track_figures(data), *motion_figures(data)[:2], *clock_figures(data)],
        'distance', 'motion', 'growth', 'rates', 'offset')
    figure = _drawn(result, {'both tracks, m': None, **shown})
    axes: Any = figure.axes[0]
    for poses, name, frame in ((data.tracks.poses_c, 'b', result.frame_b),
                               (data.tracks.pairs.poses_a, 'a', result.frame_a)):
        axes.plot(*poses[:, :3, 3].T, color=_colours()[name], lw=1.0, label=frame)
    axes.set_aspect('equal', adjustable='datalim')
    axes.tick_params(labelsize=7)
    axes.legend(fontsize=8, frameon=False)
    return figure


@cache
def _colours() -> dict[str, str]:
    """Return the colours of the light page, by name."""
    return dict(re.findall(r'--(\w+):(#\w+)', asset('page.css').partition('@media')[0]))


def _copy(plot: Plot, axes: Any) -> None:
    """Draw a plot of the report on Matplotlib axes, in data coordinates."""
    if plot.log_y:
        axes.set_yscale('log')
    axes.set(xlim=plot.x, ylim=plot.y)
    for ticks, put in ((plot.x_ticks, axes.set_xticks), (plot.y_ticks, axes.set_yticks)):
        put([value for value, _ in ticks], [words for _, words in ticks])
    axes.minorticks_off()
    axes.set_xlabel(plot.x_label, fontsize=8)
    axes.set_ylabel(plot.y_label, fontsize=8)
    axes.tick_params(labelsize=8)
    axes.spines[['top', 'right']].set_visible(False)
    for mark in plot.marks:
        name, width, dashes = _STYLES.get(mark.style.removesuffix(' bar'), ('a', 1.0, '-'))
        colour = _colours()[name]
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
                      label=name if name in 'xyz' else None)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8, frameon=False)


# Functions by file name.
_FIGURES: dict[str, Callable[[ReportData], Figure]] = {
    'overview': _overview,
    'deviations': lambda data: _deviations(data.result),
    'parts': lambda data: _drawn(data.result, _titled(part_figures(data), 'part'),
                                 ': parts of the data, minus the answer'),
    'residuals': lambda data: _drawn(data.result, _titled(residual_figures(data), 'residual'))}
