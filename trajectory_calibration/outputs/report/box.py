# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The verdict box: the answer, how well it is known, what to do, and text to copy."""

from __future__ import annotations

from html import escape

import numpy as np

from trajectory_calibration.errors import CalibrationError, in_sigmas
from trajectory_calibration.outputs.answer import judge, Row, TITLES
from trajectory_calibration.outputs.exports import EXPORTS
from trajectory_calibration.outputs.placement import Placement
from trajectory_calibration.outputs.report.page import filled, FORMATS, next_step, verdict_section
from trajectory_calibration.outputs.screen import details
from trajectory_calibration.result import CalibrationResult

_MARKS = {'ok': '●', 'weak': '◐', 'unknown': '○', 'prior': '◆'}
# Decades of the gauge below and above the limit of 'weak'.
_BELOW, _ABOVE = 2.0, 1.5
_GAUGE = 120
# Errors beyond this many standard deviations contradict the deviations, or the truth.
_FAR = 3.0
# What stands beside the answer.
_FACTS = ('data', 'fit residual', 'scale', 'clock offset', 'clock drift', 'jumps', 'method')


def verdict_box(result: CalibrationResult, rows: tuple[Row, ...], driven: str = '') -> str:
    """Return the box that begins a report; without ``driven`` that of a notebook, which is less.

    ``driven`` says how far sensor a went.
    """
    a, b = escape(result.frame_a), escape(result.frame_b)
    config, verdict = result.config, judge(result, rows)
    has_truth = rows[0].error is not None
    names = ', '.join(row.name for row in rows if _is_far(row))
    inside = filled(
        'box.html', a=a, b=b, sentence=escape(verdict.sentence),
        far=f' <span class="unknown">Error beyond {_FAR:g} σ in {names}: does the ground '
        'truth belong to these frames?</span>' if names else '',
        with_truth=' with-truth' if has_truth else '',
        error='<th scope="col" class="num">error</th><th scope="col" class="num">in σ</th>'
        if has_truth else '',
        rows=''.join(_row(row, with_error=has_truth) for row in rows),
        weak_translation=f'{config.weak_translation:g}',
        weak_rotation=f'{config.weak_rotation:g}', next=next_step(verdict.next_step),
        facts=_facts(result, driven) if driven else '', copies=_copies(result) if driven else '')
    return verdict_section(
        verdict.level, f'{a} <span class="arrow">→</span> {b}', TITLES[verdict.level], inside)


def _is_far(row: Row) -> bool:
    return row.sigma is not None and row.sigma > _FAR


def _facts(result: CalibrationResult, driven: str) -> str:
    """Return what the answer was made of, in the words of the screen."""
    made_of = {'driven': driven, **details(result)}
    inside = ''.join(f'<dt>{name}</dt><dd>{escape(made_of[name].replace("+-", "±"))}</dd>'
                     for name in ('driven', *_FACTS) if name in made_of)
    return f'<dl class="facts">{inside}</dl>'


def _row(row: Row, *, with_error: bool) -> str:
    more = small = ''
    if row.unit == 'deg' and row.is_known:
        std = '' if row.std is None else f' ± {np.deg2rad(row.std):.2g}'
        radians = f'{np.deg2rad(row.value):.5f}{std} rad'
        more, small = f' title="{radians}"', f'<small>{radians}</small>'
    cells = (
        f'<th scope="row">{row.name}</th><td class="num value"{more}>{row.value_text}</td>'
        f'<td class="num">{row.std_text}</td>'
        f'<td class="unit">{row.unit if row.is_known else ""}{small}</td>'
        f'<td class="of-gauge">{_gauge(row)}</td>'
        f'<td class="{row.word}">{_MARKS[row.word]} {row.word}</td>')
    if with_error:
        sigma = '–' if row.sigma is None else escape(in_sigmas(row.sigma, 1))
        cells += (f'<td class="num">{row.error_text or "–"}</td>'
                  f'<td class="{"num unknown" if _is_far(row) else "num"}">{sigma}</td>')
    return f'<tr class="row-{row.word}">{cells}</tr>'


def _gauge(row: Row) -> str:
    """Return a bar as long as the logarithm of the deviation, with the two limits as ticks."""
    limit = max(row.weak_limit, 1e-9)

    def place(value: float) -> float:
        share = (np.log10(max(value, 1e-12) / limit) + _BELOW) / (_BELOW + _ABOVE)
        return float(np.clip(share, 0.02, 1.0)) * _GAUGE

    width = place(limit if row.std is None else row.std) if row.is_known else _GAUGE
    ticks = ''.join(
        f'<path class="tick" d="M{place(value):.1f} 1v14"/>'
        for value in (row.weak_limit, row.unobserved_limit) if value > 0)
    return (f'<svg class="gauge" viewBox="0 0 {_GAUGE} 16" role="img" aria-label="deviation '
            f'{row.word}"><rect class="track" x="0" y="5" width="{_GAUGE}" height="6" rx="3"/>'
            f'<rect class="fill-{row.word}" x="0" y="5" width="{width:.1f}" height="6" rx="3"/>'
            f'{ticks}</svg>')


def _copies(result: CalibrationResult) -> str:
    """Return tabs with text to copy; they work without JavaScript, which adds the button."""
    forward = Placement.of(result)
    if forward.kept_back:
        return ('<div class="copies"><h3>Copy as</h3><p class="lead">Nothing yet: '
                f'{escape(forward.kept_back)} is unobserved.</p></div>')
    tabs = panels = ''
    for name, title in FORMATS.items():
        try:
            there, back = (EXPORTS[name].write(item) for item in (forward, forward.inverted()))
        except CalibrationError:
            # Two frames of one name have no place in a tree.
            return ''
        words = EXPORTS[name].sentence
        tabs += (f'<input type="radio" name="format" id="f-{name}"{"" if tabs else " checked"}>'
                 f'<label for="f-{name}">{title}</label>')
        panels += (
            f'<div class="panel" id="p-{name}"><p>{escape(words[:1].upper() + words[1:])}.</p>'
            f'<pre class="forward">{escape(there)}</pre><pre class="inverse">{escape(back)}</pre>'
            '</div>')
    return filled('copies.html', a=escape(result.frame_a), b=escape(result.frame_b), tabs=tabs,
                  panels=panels)
