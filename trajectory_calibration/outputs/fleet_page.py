# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""HTML page of many answers: verdict, six control charts over the date, table."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from itertools import pairwise

import numpy as np

from trajectory_calibration.assessment.observability import (
    DEGREES_OF_FREEDOM,
    deviations_of,
    OBSERVED,
    UNOBSERVED,
    WEAK,
)
from trajectory_calibration.errors import counted
from trajectory_calibration.fleet.comparison import Comparison, Entry
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.answer import NAMES, Row, TO_DEGREES, unit_of
from trajectory_calibration.outputs.comparison_table import cells_of
from trajectory_calibration.outputs.report.figures import limits, Plot
from trajectory_calibration.outputs.report.page import (
    Figure,
    page,
    section,
    table,
    verdict_section,
)
from trajectory_calibration.result import CalibrationResult

# Half length of an error bar, standard deviations: 95 %.
_BAR = 2.0


def fleet_page(comparison: Comparison) -> str:
    """Return the page as self-contained HTML without scripts."""
    results = [entry.result for entry in comparison.entries if entry.result is not None]
    frame_a, frame_b = results[0].frame_a, results[0].frame_b
    style, badge = ('failed', 'They differ') if comparison.exit_status else ('good', 'They agree')
    verdict = ''.join(f'<p class="sentence">{escape(line)}</p>' for line in comparison.describe())
    box = verdict_section(
        style, f'{escape(frame_b)} in {escape(frame_a)}: {counted(len(results), "recording")}',
        badge, verdict)
    charts = section(
        1, 'Control charts', _charts(comparison, results),
        'Dot: one recording, pale if weak; bar: two standard deviations up and down. '
        'Line and band: mean of the recordings that agree, with its own two standard deviations; '
        f'dashed: a change. Axes of {frame_a}; rotations from the first mean.')
    head = ('', 'date', *(f'{name}, {unit_of(k)}' for k, name in enumerate(NAMES)),
            'residual, m', 'findings')
    rows = table(head, map(_row, comparison.entries), 'numbers')
    recordings = section(
        2, 'Recordings', [f'<div class="card">{rows}</div>'],
        f'Chi-squared about one mean of all: {comparison.chi_squared:,.1f} of '
        f'{comparison.degrees_of_freedom} degrees of freedom. docs/findings.md explains the '
        'findings.')
    return page('Extrinsic over time', box + charts + recordings, scripts=())


def _charts(comparison: Comparison, results: Sequence[CalibrationResult]) -> list[Figure]:
    stretches = comparison.stretches
    base = stretches[0].T_a_b if stretches else results[0].T_a_b
    origin = np.concatenate([base[:3, 3], np.zeros(3)])
    values, means = (
        np.array([TO_DEGREES * (origin + se3.step_between(base, item.T_a_b)) for item in items])
        for items in (results, stretches))
    std = TO_DEGREES * [np.zeros(6) if item.std is None else item.std for item in results]
    mean_std = [deviations_of(item.covariance) for item in stretches]
    x = _date_coordinates(results)
    # Boundaries of the stretches.
    edges = np.concatenate([[-0.05], 0.5 * (x[1:] + x[:-1]), [1.05]])[
        np.cumsum([0, *(len(item.names) for item in stretches)])].tolist()
    dates = [(item.start_utc or '').partition('T')[0] for item in (results[0], results[-1])]
    names = [entry.name for entry in comparison.entries if entry.result is not None]
    charts = []
    for k, name in enumerate(DEGREES_OF_FREEDOM):
        unit = unit_of(k)
        status = [item.observability.status[name] for item in results]
        known = np.flatnonzero([item != UNOBSERVED for item in status]).tolist()
        reach = _BAR * std[known, k]
        plot = Plot((-0.1, 1.1), limits(values[known, k] - reach, values[known, k] + reach),
                    y_label=unit, x_ticks=[(0, dates[0]), (1, dates[1])])
        texts = []
        for n, (left, right) in enumerate(pairwise(edges) if known else ()):
            mean, bar = means[n, k], _BAR * mean_std[n][k]
            plot.band([left, right], [mean - bar] * 2, [mean + bar] * 2, 'band-answer')
            plot.line([left, right], [mean, mean], 'mean')
            if n:
                plot.vertical(left, 'change')
            row = Row(name, mean, mean_std[n][k], unit, OBSERVED, 0.0, 0.0)
            texts.append(f'{row} {unit}'.replace('+-', '±'))
        for i in known:
            plot.error_bar(
                x[i], values[i, k], std[i, k],
                'near pale' if status[i] == WEAK else 'near',
                f'{names[i]}: {values[i, k]:.4g} +- {std[i, k]:.2g} {unit}')
        if not known:
            plot.write(0.5, 0.5, 'unknown in every recording', 'middle')
        charts.append(Figure(
            'chart', plot, 'Unknown.' if not known else f'Mean {", then ".join(texts)}.'
            if texts else 'No mean is formed.', names={'number': name.replace(' ', ' about ')}))
    return charts


def _date_coordinates(results: Sequence[CalibrationResult]) -> FloatArray:
    """Return (N,) places of the recordings from 0 to 1: by date, or evenly for close dates."""
    dates = np.array([item.start_ns or 0 for item in results])
    even = np.linspace(0, 1, len(results))
    span = dates[-1] - dates[0]
    # Recordings of one day would overlap beside one of another year.
    if span <= 0 or np.min(np.diff(dates)) < 0.3 / len(results) * span:
        return even
    return (dates - dates[0]) / span


def _row(entry: Entry) -> tuple[str, ...]:
    name, date, *numbers, last = cells_of(entry)
    if entry.result is None:
        return (name, date, *[''] * 7, last)
    return (name, date, *numbers, f'{entry.result.metrics.e_rt:.3f}', last)
