# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The paper's figures. For print: readable in grey, one legend, units on every axis.

Matplotlib is loaded here, and this module only where figures are drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
import numpy as np

from benchmarks.paper.relative import MotionSizes
from benchmarks.paper.statistics import E_AR, E_AT, Groups, mean, mean_interval, mean_of
from benchmarks.paper.tasks import (
    Cell,
    LEVELS,
    PAPER_SOLVERS,
    REFERENCE_FREE,
    REFERENCES,
    references_of,
)
from trajectory_calibration.errors import ResultError
from trajectory_calibration.geometry.se3 import FloatArray

# Colours of rising lightness, so that they stay apart in grey; markers and dashes say it again.
_COLOURS = ('#000000', '#7f1d5a', '#1f5fa8', '#c4572b', '#3d9a76', '#a8a13c', '#8c8c8c')
_MARKERS = ('s', 'o', '^', 'D', 'v', 'P', '*')
_DASHES: tuple[Any, ...] = (
    '-', '--', '-.', (0, (1, 1.2)), (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), '-')

_STYLE: Any = {
    'font.family': 'DejaVu Sans',
    'font.size': 8,
    'axes.titlesize': 8.5,
    'axes.labelsize': 8,
    'axes.spines.top': False,
    'axes.spines.right': False,
    'axes.grid': True,
    'axes.axisbelow': True,
    'grid.color': '#dddddd',
    'grid.linewidth': 0.5,
    'legend.frameon': False,
    'legend.fontsize': 7.5,
    'xtick.labelsize': 7.5,
    'ytick.labelsize': 7.5,
    'lines.linewidth': 1.2,
    'lines.markersize': 4,
    'svg.fonttype': 'none',
    # The same figure is the same file.
    'svg.hashsalt': 'trajectory_calibration',
}

# How the errors are shown: label, factor, and the least value that a logarithmic axis shows. What
# is exact but for rounding is drawn there.
_SHOWN = {E_AT: ('translation error [mm]', 1e3, 0.1), E_AR: ('rotation error [°]', 1.0, 0.01)}

_NAMES = {'ali': 'Ali', 'park': 'Park', 'taylor': 'Taylor', 'zhuang': 'Zhuang', 'dnl': 'DNL',
          'dnlo': 'DNLO'}

_CLASSES = {
    'noise': ('white noise', 'standard deviation [mm]', 1e3),
    'outliers': ('outliers', 'jumps in each trajectory', 1.0),
    'drift': ('drift', 'drift [mm per m]', 1e3),
    'mixture': ('mixture', '', 1.0),
}
_LINES = ('noise', 'outliers', 'drift')


@dataclass(frozen=True)
class _Variant:
    """What one line or box shows."""

    solver: str
    reference: str
    label: str


def draw_references(groups: Groups, source: str, solver: str) -> Figure:
    """Draw a solver at all references over the levels of noise, outliers and drift."""
    variants = [_Variant(solver, name, name) for name in REFERENCES]
    figure = Figure(figsize=(7.2, 4.6), layout='constrained')
    axes = figure.subplots(2, 3, sharex='col', sharey='row')
    for row, error in enumerate((E_AT, E_AR)):
        for ax, kind in zip(axes[row], _LINES, strict=True):
            _draw_levels(ax, groups, source, kind, error, variants)
        _finish_row(axes[row], error)
    _name_columns(axes, _LINES)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=len(labels),
                  title=f'reference of {_name(solver)}; mean and its 95 % interval')
    return figure


def draw_mixture(groups: Groups, source: str, solver: str) -> Figure:
    """Draw boxes of a solver's errors at all references under the mixture."""
    figure = Figure(figsize=(7.2, 2.7), layout='constrained')
    axes = figure.subplots(1, 2)
    for ax, error in zip(axes, (E_AT, E_AR), strict=True):
        _draw_boxes(ax, groups, source, error, [_Variant(solver, r, r) for r in REFERENCES])
        ax.set_ylabel(_SHOWN[error][0])
        ax.set_xlabel(f'reference of {_name(solver)}')
    return figure


def draw_best(groups: Groups, source: str, solvers: Sequence[str]) -> Figure:
    """Draw each solver at its best reference, class by class.

    Best is the lowest mean translation error over all levels of the class.
    """
    figure = Figure(figsize=(7.2, 5.4), layout='constrained')
    axes = figure.subplots(2, 4, sharex='col', sharey='row')
    for column, kind in enumerate(_CLASSES):
        variants = [_best_variant(groups, source, kind, solver) for solver in solvers]
        for row, error in enumerate((E_AT, E_AR)):
            ax = axes[row, column]
            if kind == 'mixture':
                _draw_boxes(ax, groups, source, error, variants)
                ax.tick_params(axis='x', labelrotation=90)
            else:
                _draw_levels(ax, groups, source, kind, error, variants)
        if kind != 'mixture':
            # Below the column, because the best references differ from class to class.
            axes[1, column].legend(loc='upper center', bbox_to_anchor=(0.5, -0.24), ncols=1,
                                   handlelength=2.6, labelspacing=0.25)
    for row, error in enumerate((E_AT, E_AR)):
        _finish_row(axes[row], error)
    _name_columns(axes, tuple(_CLASSES))
    return figure


def draw_motions(sizes: Sequence[MotionSizes]) -> Figure:
    """Draw medians and quartiles of the relative motions at each reference."""
    figure = Figure(figsize=(7.2, 2.9), layout='constrained')
    axes = figure.subplots(1, 2)
    names = list(dict.fromkeys(item.data for item in sizes))
    for k, name in enumerate(names):
        rows = [item for item in sizes if item.data == name]
        x = np.arange(len(rows)) + 0.16 * (k - (len(names) - 1) / 2)
        for ax, values in zip(axes, (
                [(r.distance_q25_m, r.distance_median_m, r.distance_q75_m) for r in rows],
                [(r.angle_q25_deg, r.angle_median_deg, r.angle_q75_deg) for r in rows]),
                strict=True):
            low, middle, high = np.array(values).T
            ax.errorbar(x, middle, yerr=(middle - low, high - middle), label=name,
                        fmt=_MARKERS[k], color=_COLOURS[2 * k], elinewidth=1, capsize=2)
            ax.set_xticks(range(len(rows)), [r.reference for r in rows])
            _log_axis(ax)
            ax.grid(visible=False, axis='x')
    axes[0].set_ylabel('distance [m]')
    axes[1].set_ylabel('angle [°]')
    for ax in axes:
        ax.set_xlabel('reference')
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=len(names),
                  title='relative motions of sensor a; median and quartiles')
    return figure


def draw_all(
    folder: Path, groups: Groups, source: str, solvers: Sequence[str],
    sizes: Sequence[MotionSizes],
) -> list[str]:
    """Draw every figure that the runs allow into a folder; return their names without ending.

    Raises
    ------
    ResultError
        The folder cannot be written.

    """
    ran = [name for name in (*PAPER_SOLVERS, *REFERENCE_FREE) if name in solvers]
    with rc_context(_STYLE):
        figures = {f'{source}_motions': draw_motions(sizes)}
        if ran:
            figures[f'{source}_best'] = draw_best(groups, source, ran)
        if 'dnlo' in ran:
            figures[f'{source}_dnlo'] = draw_references(groups, source, 'dnlo')
            figures[f'{source}_mixture'] = draw_mixture(groups, source, 'dnlo')
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name, figure in figures.items():
                FigureCanvasAgg(figure)
                figure.savefig(folder / f'{name}.png', dpi=170, pil_kwargs={'optimize': True})
                # No date: the same figure is the same file.
                figure.savefig(folder / f'{name}.svg', metadata={'Date': None})
        except OSError as error:
            raise ResultError(
                f'{folder} cannot be written: {error.strerror or error}') from error
    return sorted(figures)


def _draw_levels(
    ax: Any, groups: Groups, source: str, kind: str, error: int, variants: Sequence[_Variant],
) -> None:
    """Draw the mean of each variant over the levels with noise, with its interval."""
    # At level zero every error is rounding, which a logarithmic axis cannot show.
    levels = LEVELS[kind][1:]
    _, factor, least = _SHOWN[error]
    x = _CLASSES[kind][2] * np.array(levels)
    step = x[1] - x[0]
    for k, variant in enumerate(variants):
        found = [_finite(groups, Cell(source, kind, level, variant.solver, variant.reference),
                         error) for level in levels]
        middle = np.maximum(factor * np.array([mean(values) for values in found]), least)
        low, high = np.maximum(
            factor * np.array([mean_interval(values) for values in found]).T, least)
        aside = 0.07 * step * (k - (len(variants) - 1) / 2)
        ax.errorbar(x + aside, middle, yerr=(middle - low, high - middle), label=variant.label,
                    color=_COLOURS[k], marker=_MARKERS[k], linestyle=_DASHES[k],
                    markerfacecolor='white', markeredgewidth=0.9, elinewidth=0.8)
    ax.set_xticks(x)
    ax.set_xlabel(_CLASSES[kind][1])
    _log_axis(ax, least)


def _draw_boxes(
    ax: Any, groups: Groups, source: str, error: int, variants: Sequence[_Variant],
) -> None:
    """Draw median, quartiles, range up to 1.5 of theirs, and the runs beyond."""
    _, factor, least = _SHOWN[error]
    values = [np.maximum(factor * _finite(groups, Cell(
        source, 'mixture', LEVELS['mixture'][0], item.solver, item.reference), error), least)
        for item in variants]
    ax.boxplot(values, widths=0.55, patch_artist=True,
               boxprops={'facecolor': '#d9d9d9', 'linewidth': 0.8},
               medianprops={'color': 'black', 'linewidth': 1.6},
               whiskerprops={'linewidth': 0.8}, capprops={'linewidth': 0.8},
               flierprops={'marker': '.', 'markersize': 3, 'markerfacecolor': 'black'})
    ax.set_xticks(range(1, len(variants) + 1), [item.label for item in variants])
    _log_axis(ax, least)
    ax.grid(visible=False, axis='x')


def _best_variant(groups: Groups, source: str, kind: str, solver: str) -> _Variant:
    references = references_of(solver)
    means = [np.mean([mean_of(groups, Cell(source, kind, level, solver, reference), E_AT)
                      for level in LEVELS[kind]]) for reference in references]
    # Of a class that was not run, every mean is NaN.
    best = references[int(np.argmin(np.nan_to_num(means, nan=np.inf)))]
    return _Variant(solver, best, f'{_name(solver)} {best}' if len(references) > 1
                    else _name(solver))


def _name(solver: str) -> str:
    return _NAMES.get(solver, solver.replace('_', '-'))


def _finite(groups: Groups, cell: Cell, error: int) -> FloatArray:
    values = groups.get(cell, np.empty((0, 4)))[:, error]
    return values[np.isfinite(values)]


def _name_columns(axes: Any, kinds: Sequence[str]) -> None:
    for ax, kind in zip(axes[0], kinds, strict=True):
        ax.set_title(_CLASSES[kind][0])
        ax.set_xlabel('')


def _finish_row(row: Any, error: int) -> None:
    label, _, least = _SHOWN[error]
    row[0].set_ylabel(label)
    # Nothing is drawn below the least value; nor are its ticks.
    if row[0].get_ylim()[0] < least:
        row[0].set_ylim(bottom=0.8 * least)


def _log_axis(ax: Any, least: float = 0.0) -> None:
    ax.set_yscale('log')
    ax.yaxis.set_major_locator(LogLocator(numticks=9))
    ax.yaxis.set_major_formatter(FuncFormatter(
        lambda value, _: f'≤ {value:g}' if np.isclose(value, least) else f'{value:g}'))
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.grid(visible=False, which='minor')
