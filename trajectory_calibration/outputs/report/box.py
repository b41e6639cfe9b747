# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The verdict box: the answer, how well it is known, what to do, and text to copy."""

from __future__ import annotations

from html import escape

import numpy as np

from trajectory_calibration.errors import in_sigmas
from trajectory_calibration.outputs.answer import Row
from trajectory_calibration.outputs.report.text import next_step, verdict_section
from trajectory_calibration.outputs.screen import details
from trajectory_calibration.outputs.verdict import TITLES, Verdict
from trajectory_calibration.result import CalibrationResult

MARKS = {'ok': '●', 'weak': '◐', 'unknown': '○', 'prior': '◆'}
# Decades of the gauge below and above the limit of 'weak'.
_BELOW, _ABOVE = 2.0, 1.5
_GAUGE = 120
# Errors beyond this many standard deviations contradict the deviations, or the truth.
FAR = 3.0
# What stands beside the answer.
_FACTS = ('data', 'fit residual', 'scale', 'clock offset', 'clock drift', 'jumps', 'method')


def verdict_box(
    result: CalibrationResult, rows: tuple[Row, ...], verdict: Verdict, copies: str,
    facts: str = '',
) -> str:
    """Return the box that begins a report, also shown in a notebook."""
    a, b = escape(result.frame_a), escape(result.frame_b)
    has_truth = rows[0].error is not None
    body = ''.join(_row(row, with_error=has_truth) for row in rows)
    config = result.config
    limits = (
        f'<p class="marks"><span class="ok">● ok</span> deviation up to '
        f'{config.weak_translation:g} m, {config.weak_rotation:g} deg '
        f'<span class="weak">◐ weak</span> above '
        f'<span class="unknown">○ unknown</span> not determined '
        f'<span class="prior">◆ prior</span> given beforehand. Bars: standard deviation, '
        'logarithmic; ticks: limits of weak and unknown.</p>')
    error = '<th scope="col" class="num">error</th><th scope="col" class="num">in σ</th>' \
        if has_truth else ''
    with_truth = ' with-truth' if has_truth else ''
    inside = (
        f'<p class="sentence">{escape(verdict.sentence)}.{_against_truth(rows)}</p>'
        f'<div class="answer"><div><div class="scroll"><table class="answer-table{with_truth}">'
        f'<caption>Pose of {b} in {a}: <code>p<sub>{a}</sub> = T p<sub>{b}</sub></code></caption>'
        '<thead><tr>'
        '<th scope="col"></th><th scope="col" class="num">value</th>'
        '<th scope="col" class="num">± 1 σ</th><th scope="col" class="of-unit"></th>'
        '<th scope="col" class="of-gauge">deviation</th>'
        f'<th scope="col">status</th>{error}</tr></thead>'
        f'<tbody>{body}</tbody></table></div>{limits}</div>{facts}</div>'
        f'{next_step(verdict.next_step)}{copies}')
    return verdict_section(
        verdict.level, f'{a} <span class="arrow">→</span> {b}', TITLES[verdict.level], inside)


def _against_truth(rows: tuple[Row, ...]) -> str:
    far = [row.name for row in rows if row.sigma is not None and row.sigma > FAR]
    if not far:
        return ''
    return (f' <span class="unknown">Error beyond {FAR:g} σ in {", ".join(far)}: does the '
            'ground truth belong to these frames?</span>')


def facts_list(result: CalibrationResult, driven: str) -> str:
    """Return what the answer was made of, beside it, in the words of the screen."""
    made_of = details(result)
    facts = {'driven': driven, **{name: made_of[name] for name in _FACTS if name in made_of}}
    inside = ''.join(f'<dt>{name}</dt><dd>{escape(value.replace("+-", "±"))}</dd>'
                     for name, value in facts.items())
    return f'<dl class="facts">{inside}</dl>'


def _row(row: Row, *, with_error: bool) -> str:
    radians = ''
    if row.unit == 'deg' and row.is_known:
        std = '' if row.std is None else f' ± {np.deg2rad(row.std):.2g}'
        radians = f'{np.deg2rad(row.value):.5f}{std} rad'
    unit = row.unit if row.is_known else ''
    more = f' title="{radians}"' if radians else ''
    small = f'<small>{radians}</small>' if radians else ''
    cells = (
        f'<th scope="row">{row.name}</th><td class="num value"{more}>{row.value_text}</td>'
        f'<td class="num">{row.std_text}</td><td class="unit">{unit}{small}</td>'
        f'<td class="of-gauge">{gauge(row)}</td>'
        f'<td class="{row.word}">{MARKS[row.word]} {row.word}</td>')
    if with_error:
        cells += _error_cells(row)
    return f'<tr class="row-{row.word}">{cells}</tr>'


def _error_cells(row: Row) -> str:
    sigma = '–' if row.sigma is None else escape(in_sigmas(row.sigma, 1))
    style = 'num unknown' if row.sigma is not None and row.sigma > FAR else 'num'
    return f'<td class="num">{row.error_text or "–"}</td><td class="{style}">{sigma}</td>'


def gauge(row: Row) -> str:
    """Return a bar as long as the logarithm of the deviation, with the two limits as ticks."""
    limit = max(row.weak_limit, 1e-9)
    low, high = np.log10(limit) - _BELOW, np.log10(limit) + _ABOVE

    def place(value: float) -> float:
        share = (np.log10(max(value, 1e-12)) - low) / (high - low)
        return float(np.clip(share, 0.02, 1.0)) * _GAUGE

    std = row.std if row.std is not None else limit
    width = _GAUGE if not row.is_known else place(std)
    ticks = ''.join(
        f'<path class="tick" d="M{place(value):.1f} 1v14"/>'
        for value in (row.weak_limit, row.unobserved_limit) if value > 0)
    return (f'<svg class="gauge" viewBox="0 0 {_GAUGE} 16" role="img" aria-label="deviation '
            f'{row.word}"><rect class="track" x="0" y="5" width="{_GAUGE}" height="6" rx="3"/>'
            f'<rect class="fill-{row.word}" x="0" y="5" width="{width:.1f}" height="6" rx="3"/>'
            f'{ticks}</svg>')
