# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Many answers as one page: verdict, six control charts over the date, table. Works offline."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from trajectory_calibration.fleet.comparison import Comparison, Entry
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.comparison_table import values_of
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.version import __version__

_TITLES = ('x', 'y', 'z', 'about x', 'about y', 'about z')

# Of a chart in user units, and its margins.
_WIDTH, _HEIGHT = 420, 160
_LEFT, _RIGHT, _TOP, _BOTTOM = 58, 8, 12, 10

# Half a bar: two standard deviations, as 95 % of errors.
_BAR = 2.0

_STYLE = """
:root{color-scheme:light dark;--ink:#1c2430;--soft:#68727f;--line:#d5dae0;--paper:#fff;
--card:#f6f8fa;--good:#1a7f37;--bad:#cf222e;--dot:#0969da}
@media(prefers-color-scheme:dark){:root{--ink:#e6edf3;--soft:#9aa5b1;--line:#3a424c;
--paper:#0d1117;--card:#161b22;--good:#3fb950;--bad:#ff7b72;--dot:#58a6ff}}
*{box-sizing:border-box}body{font:15px/1.5 system-ui,sans-serif;color:var(--ink);
background:var(--paper);margin:0 auto;max-width:1320px;padding:16px}
h1{font-size:1.3rem;margin:.2em 0}h2{font-size:1.05rem;margin:1.6em 0 .4em}
.verdict{border-left:6px solid var(--good);background:var(--card);padding:10px 14px;margin:12px 0}
.verdict.bad{border-color:var(--bad)}.verdict p{margin:.2em 0;font-weight:600}
.bad p:first-child{color:var(--bad)}
.ends{display:flex;justify-content:space-between}
.charts{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,340px),1fr));gap:12px}
figure{margin:0;background:var(--card);padding:8px}figcaption{font-weight:600}
svg{width:100%;height:auto;display:block}svg text{font-size:11px;fill:var(--soft)}
.axis{stroke:var(--line)}.bar{stroke:var(--dot);stroke-width:1.5}.dot{fill:var(--dot)}
.weak .bar{opacity:.45}.weak .dot{fill:var(--card);stroke:var(--dot)}
.mean{stroke:var(--good);stroke-width:1.5}.band{fill:var(--good);opacity:.14}
.change{stroke:var(--bad);stroke-width:1.5;stroke-dasharray:4 3}
.scroll{overflow-x:auto}table{border-collapse:collapse;font-size:13px;white-space:nowrap}
td,th{padding:3px 9px;border-bottom:1px solid var(--line);text-align:right}
td:first-child,th:first-child,td:last-child,th:last-child{text-align:left}
td:last-child{white-space:normal;min-width:14em}.soft{color:var(--soft)}
@media print{body{max-width:none}figure{break-inside:avoid}}
"""


def fleet_page(comparison: Comparison, title: str = 'Extrinsic over time') -> str:
    """Return the page as HTML: no script, no file beside it."""
    answers = [(entry, entry.result) for entry in comparison.entries if entry.result is not None]
    frame_a, frame_b = answers[0][1].frame_a, answers[0][1].frame_b
    verdict = ''.join(f'<p>{escape(line)}</p>' for line in comparison.describe())
    bad = ' bad' if comparison.exit_status else ''
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f'<title>{escape(title)}</title><style>{_STYLE}</style></head><body>'
        f'<h1>{escape(frame_b)} in {escape(frame_a)}: {len(answers)} recordings</h1>'
        f'<div class="verdict{bad}">{verdict}</div>'
        f'<h2>Control charts</h2><p class="soft">Dot: one recording; bar: two standard deviations '
        'up and down; line and band: mean of the recordings that agree, with its own two '
        'standard deviations; dashed: a change. Good: all bars reach the line. Bad: a step, or '
        f'bars that miss the line. Axes of {escape(frame_a)}; rotations from the first mean.</p>'
        f'<div class="charts">{"".join(_charts(comparison))}</div>'
        f'<h2>Recordings</h2><div class="scroll">{_table(comparison)}</div>'
        f'<p class="soft">trajectory_calibration {escape(__version__)}; chi2 of all about one '
        f'mean: {comparison.chi_squared:.1f} at {comparison.degrees_of_freedom} degrees of '
        'freedom. What the words of the findings mean: docs/findings.md.</p></body></html>\n')


def _charts(comparison: Comparison) -> list[str]:
    results = [entry.result for entry in comparison.entries if entry.result is not None]
    base = comparison.stretches[0].T_a_b if comparison.stretches else results[0].T_a_b
    origin = np.concatenate([base[:3, 3], np.zeros(3)])
    values = np.array([origin + se3.step_between(base, item.T_a_b) for item in results])
    std = np.array([np.zeros(6) if item.std is None else item.std for item in results])
    means, edges = [], [0]
    for stretch in comparison.stretches:
        mean = origin + se3.step_between(base, stretch.T_a_b)
        means.append((mean, np.sqrt(np.diagonal(stretch.covariance))))
        edges.append(edges[-1] + len(stretch.names))
    places = _places(results)
    names = [entry.name for entry in comparison.entries if entry.result is not None]
    charts = []
    for k, title in enumerate(_TITLES):
        unit, factor = ('m', 1.0) if k < 3 else ('deg', float(np.rad2deg(1.0)))
        levels = [(edges[i], edges[i + 1], float(mean[k]) * factor, float(deviation[k]) * factor)
                  for i, (mean, deviation) in enumerate(means)]
        status = [list(item.observability.status.values())[k] for item in results]
        charts.append(
            f'<figure><figcaption>{title} <span class="soft">[{unit}]</span></figcaption>'
            f'{_chart(places, values[:, k] * factor, std[:, k] * factor, status, levels, names)}'
            f'{_ends(results)}</figure>')
    return charts


def _places(results: Sequence[CalibrationResult]) -> FloatArray:
    """Return where each recording stands from 0 to 1: by date, or evenly where dates are equal."""
    dates = np.array([float(item.start_ns or 0) for item in results])
    span = dates[-1] - dates[0]
    even = np.linspace(0, 1, len(results)) if len(results) > 1 else np.array([0.5])
    if span <= 0:
        return even
    by_date: FloatArray = (dates - dates[0]) / span
    # Recordings of one day beside one of another year would be a single blot.
    crowded = np.min(np.diff(by_date)) < 0.3 / len(results)
    return even if crowded else by_date


def _ends(results: Sequence[CalibrationResult]) -> str:
    first, last = ((item.start_utc or '').partition('T')[0]
                   for item in (results[0], results[-1]))
    return f'<div class="soft ends"><span>{first}</span><span>{last}</span></div>'


def _chart(
    places: FloatArray, values: FloatArray, std: FloatArray, status: Sequence[str],
    levels: Sequence[tuple[int, int, float, float]], names: Sequence[str],
) -> str:
    known = np.array([item != 'unobserved' for item in status])
    if not known.any():
        return _svg(f'<text x="{_WIDTH / 2}" y="{_HEIGHT / 2}" text-anchor="middle">unknown in '
                    'every recording</text>')
    low = float((values - _BAR * std)[known].min())
    high = float((values + _BAR * std)[known].max())
    margin = 0.06 * (high - low) or 1e-6
    low, high = low - margin, high + margin
    x = _LEFT + 10 + places * (_WIDTH - _LEFT - _RIGHT - 20)

    def y(value: float) -> float:
        inside = min(max(value, low), high)
        return _TOP + (high - inside) / (high - low) * (_HEIGHT - _TOP - _BOTTOM)

    parts = [f'<line class="axis" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y(tick):.1f}" '
             f'y2="{y(tick):.1f}"/><text x="{_LEFT - 5}" y="{y(tick) + 4:.1f}" '
             f'text-anchor="end">{tick:.{_digits(high - low)}f}</text>'
             for tick in _ticks(low, high)]
    for start, end, mean, deviation in levels:
        left = x[start] - 8 if start == 0 else 0.5 * (x[start - 1] + x[start])
        right = x[end - 1] + 8 if end == len(x) else 0.5 * (x[end - 1] + x[end])
        if deviation < high - low:
            top, bottom = y(mean + _BAR * deviation), y(mean - _BAR * deviation)
            parts.append(f'<rect class="band" x="{left:.1f}" width="{right - left:.1f}" '
                         f'y="{top:.1f}" height="{bottom - top:.1f}"/>')
            parts.append(f'<line class="mean" x1="{left:.1f}" x2="{right:.1f}" y1="{y(mean):.1f}" '
                         f'y2="{y(mean):.1f}"/>')
        if start:
            parts.append(f'<line class="change" x1="{left:.1f}" x2="{left:.1f}" y1="{_TOP}" '
                         f'y2="{_HEIGHT - _BOTTOM}"/>')
    for k in np.flatnonzero(known).tolist():
        weak = ' class="weak"' if status[k] == 'weak' else ''
        parts.append(
            f'<g{weak}><title>{escape(names[k])}: {values[k]:.4g} +- {std[k]:.2g}</title>'
            f'<line class="bar" x1="{x[k]:.1f}" x2="{x[k]:.1f}" '
            f'y1="{y(values[k] + _BAR * std[k]):.1f}" y2="{y(values[k] - _BAR * std[k]):.1f}"/>'
            f'<circle class="dot" cx="{x[k]:.1f}" cy="{y(values[k]):.1f}" r="3"/></g>')
    return _svg(''.join(parts))


def _svg(content: str) -> str:
    return f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img">{content}</svg>'


def _ticks(low: float, high: float) -> list[float]:
    """Return three to six round numbers in between."""
    rough = (high - low) / 4
    power = 10.0 ** np.floor(np.log10(rough))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough * 0.8)
    return [float(k * step) for k in range(int(np.ceil(low / step)), int(high / step) + 1)
            if low <= k * step <= high]


def _digits(span: float) -> int:
    return int(np.clip(np.ceil(1 - np.log10(span)), 0, 7))


def _table(comparison: Comparison) -> str:
    head = ('', 'date', 'x [m]', 'y [m]', 'z [m]', 'roll [deg]', 'pitch [deg]', 'yaw [deg]',
            'residual [m]', 'findings')
    rows = ''.join(f'<tr>{_row(entry)}</tr>' for entry in comparison.entries)
    return (f'<table><thead><tr>{"".join(f"<th>{name}</th>" for name in head)}</tr></thead>'
            f'<tbody>{rows}</tbody></table>')


def _row(entry: Entry) -> str:
    name = f'<td>{escape(entry.name)}</td>'
    if entry.result is None:
        return f'{name}<td colspan="9">no answer: {escape(entry.failure)}</td>'
    date = (entry.result.start_utc or '').replace('T', ' ').removesuffix('Z')
    numbers = ''.join(f'<td>{value.replace("+-", "&plusmn;")}</td>' for value in values_of(entry))
    codes = ' '.join(dict.fromkeys(found.code for found in entry.result.findings))
    return (f'{name}<td>{date}</td>{numbers}<td>{entry.result.metrics.e_rt:.3f}</td>'
            f'<td>{escape(codes)}</td>')
