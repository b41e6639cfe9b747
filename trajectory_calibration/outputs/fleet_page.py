# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Many answers as one page: verdict, six control charts over the date, table. Works offline."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from trajectory_calibration.assessment.observability import DEGREES_OF_FREEDOM, UNOBSERVED, WEAK
from trajectory_calibration.errors import counted
from trajectory_calibration.fleet.comparison import Comparison, Entry
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.answer import NAMES
from trajectory_calibration.outputs.comparison_table import cells_of
from trajectory_calibration.outputs.report.drawings import unit_of
from trajectory_calibration.outputs.report.figures import limits, Plot
from trajectory_calibration.outputs.report.page import page
from trajectory_calibration.outputs.report.text import figure, section, table, verdict_section
from trajectory_calibration.result import CalibrationResult

# Half a bar: two standard deviations, as 95 % of errors.
_BAR = 2.0


def fleet_page(comparison: Comparison, title: str = 'Extrinsic over time') -> str:
    """Return the page as HTML: no script, no file beside it."""
    results = [entry.result for entry in comparison.entries if entry.result is not None]
    frame_a, frame_b = results[0].frame_a, results[0].frame_b
    style, badge = ('failed', 'They differ') if comparison.exit_status else ('good', 'They agree')
    verdict = ''.join(f'<p class="sentence">{escape(line)}</p>' for line in comparison.describe())
    box = verdict_section(
        style, f'{escape(frame_b)} in {escape(frame_a)}: {counted(len(results), "recording")}',
        badge, verdict)
    charts = section(
        1, 'Control charts', ''.join(_charts(comparison, results)),
        'Dot: one recording, pale where it is weak; bar: two standard deviations up and down. '
        'Line and band: mean of the recordings that agree, with its own two standard deviations; '
        f'dashed: a change. Axes of {frame_a}; rotations from the first mean.')
    recordings = section(
        2, 'Recordings', f'<div class="card">{_table(comparison)}</div>',
        f'Chi-squared about one mean of all: {comparison.chi_squared:,.1f} of '
        f'{comparison.degrees_of_freedom} degrees of freedom. docs/findings.md explains the '
        'findings.')
    return page(title, box + charts + recordings, scripts=())


def _charts(comparison: Comparison, results: Sequence[CalibrationResult]) -> list[str]:
    base = comparison.stretches[0].T_a_b if comparison.stretches else results[0].T_a_b
    origin = np.concatenate([base[:3, 3], np.zeros(3)])
    to_unit = np.repeat([1.0, 180 / np.pi], 3)
    values = to_unit * [origin + se3.step_between(base, item.T_a_b) for item in results]
    std = to_unit * [np.zeros(6) if item.std is None else item.std for item in results]
    means = [(to_unit * (origin + se3.step_between(base, item.T_a_b)),
              to_unit * np.sqrt(np.diagonal(item.covariance))) for item in comparison.stretches]
    edges = np.cumsum([0, *(len(item.names) for item in comparison.stretches)]).tolist()
    places = _places(results)
    dates = [(item.start_utc or '').partition('T')[0] for item in (results[0], results[-1])]
    names = [entry.name for entry in comparison.entries if entry.result is not None]
    charts = []
    for k, name in enumerate(DEGREES_OF_FREEDOM):
        status = [item.observability.status[name] for item in results]
        known = np.array([item != UNOBSERVED for item in status])
        reach = _BAR * std[known, k]
        plot = Plot((-0.1, 1.1), limits(values[known, k] - reach, values[known, k] + reach),
                    name=name, y_label=unit_of(k), x_ticks=list(zip((0, 1), dates, strict=True)))
        for mean, first, last in zip(means, edges[:-1], edges[1:], strict=True):
            if known.any():
                _draw_mean(plot, places, (first, last), float(mean[0][k]), float(mean[1][k]))
        for i in np.flatnonzero(known).tolist():
            plot.error_bar(
                places[i], values[i, k], std[i, k],
                'near pale' if status[i] == WEAK else 'near',
                f'{names[i]}: {values[i, k]:.4g} +- {std[i, k]:.2g} {unit_of(k)}')
        if not known.any():
            plot.write(0.5, 0.5, 'unknown in every recording', 'middle')
        charts.append(figure(
            'chart', plot,
            _reading([(mean[k], deviation[k]) for mean, deviation in means], unit_of(k))
            if known.any() else 'Unknown.',
            number=name.replace(' ', ' about ')))
    return charts


def _reading(means: Sequence[tuple[float, float]], unit: str) -> str:
    words = [f'{mean:.3f} ± {std:.2g} {unit}' for mean, std in means]
    return f'Mean {", then ".join(words)}.' if words else 'No mean is formed.'


def _draw_mean(
    plot: Plot, places: FloatArray, stretch: tuple[int, int], mean: float, std: float,
) -> None:
    """Draw the mean of the recordings ``[first, last)``, and the change before them."""
    first, last = stretch
    between = np.concatenate([[-0.05], 0.5 * (places[1:] + places[:-1]), [1.05]])
    left, right = float(between[first]), float(between[last])
    plot.band([left, right], [mean - _BAR * std] * 2, [mean + _BAR * std] * 2, 'band-answer')
    plot.line([left, right], [mean, mean], 'mean')
    if first:
        plot.vertical(left, 'change')


def _places(results: Sequence[CalibrationResult]) -> FloatArray:
    """Return where each recording stands from 0 to 1: by date, or evenly where dates are equal."""
    dates = np.array([float(item.start_ns or 0) for item in results])
    even = np.linspace(0, 1, len(results))
    span = dates[-1] - dates[0]
    if span <= 0:
        return even
    by_date: FloatArray = (dates - dates[0]) / span
    # Recordings of one day beside one of another year would be a single blot.
    crowded = np.min(np.diff(by_date)) < 0.3 / len(results)
    return even if crowded else by_date


def _table(comparison: Comparison) -> str:
    units = ('m', 'm', 'm', 'deg', 'deg', 'deg')
    head = ('', 'date', *(f'{name}, {unit}' for name, unit in zip(NAMES, units, strict=True)),
            'residual, m', 'findings')
    return table(head, [_row(entry) for entry in comparison.entries], 'numbers')


def _row(entry: Entry) -> tuple[str, ...]:
    name, date, *numbers, last = cells_of(entry)
    if entry.result is None:
        return (name, date, *[''] * 7, last)
    return (name, date, *(value.replace('+-', '±') for value in numbers),
            f'{entry.result.metrics.e_rt:.3f}', last)
