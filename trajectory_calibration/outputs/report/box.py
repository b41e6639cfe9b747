# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The verdict box: answer, standard deviations, next step, and text to copy."""

from __future__ import annotations

from html import escape

import numpy as np

from trajectory_calibration.errors import CalibrationError, in_sigmas
from trajectory_calibration.outputs.answer import Row, TITLES, verdict_of
from trajectory_calibration.outputs.exports import EXPORTS
from trajectory_calibration.outputs.placement import Placement
from trajectory_calibration.outputs.report.figures import Canvas
from trajectory_calibration.outputs.report.page import filled, next_step, sentence, verdict_section
from trajectory_calibration.outputs.screen import details
from trajectory_calibration.result import CalibrationResult

# Formats to copy, and the titles of their tabs.
_FORMATS = {
    'urdf': 'URDF', 'static-tf': 'static transform', 'autoware': 'Autoware', 'kalibr': 'Kalibr',
    'matrix': '4 × 4', 'tum': 'TUM', 'yaml': 'YAML'}
_MARKS = {'ok': '●', 'weak': '◐', 'unknown': '○', 'prior': '◆'}
# Decades of the gauge below and above the limit of 'weak'.
_BELOW, _ABOVE = 2.0, 1.5
_GAUGE = 120
# Errors beyond this many standard deviations contradict these, or the ground truth.
_FAR = 3.0
# Details beside the answer.
_FACTS = ('data', 'fit residual', 'scale', 'clock offset', 'clock drift', 'jumps', 'method')


def verdict_box(result: CalibrationResult, rows: tuple[Row, ...], driven: str = '') -> str:
    """Return the box of a report; without ``driven`` the shorter one of a notebook.

    ``driven`` is the path length and duration of sensor a as text.
    """
    a, b = escape(result.frame_a), escape(result.frame_b)
    config, verdict = result.config, verdict_of(result, rows)
    has_truth = any(row.error is not None for row in rows)
    names = ', '.join(row.name for row in rows if _is_far(row))
    inside = filled(
        'box.html', a=a, b=b, sentence=escape(sentence(verdict.sentence)),
        far=f' <span class="unknown">Error beyond {_FAR:g} σ in {names}: does the ground '
        'truth belong to these frames?</span>' if names else '',
        with_truth=' with-truth' if has_truth else '',
        error='<th class="num">error</th><th class="num">in σ</th>' if has_truth else '',
        rows=''.join(_row(row, with_error=has_truth) for row in rows),
        weak_translation=f'{config.weak_translation:g}',
        weak_rotation=f'{config.weak_rotation:g}', next=next_step(verdict.next_step),
        facts=_facts(result, driven) if driven else '', copies=_copies(result) if driven else '')
    return verdict_section(
        verdict.level, f'{a} <span class="arrow">→</span> {b}', TITLES[verdict.level], inside)


def _is_far(row: Row) -> bool:
    return row.sigma is not None and row.sigma > _FAR


def _facts(result: CalibrationResult, driven: str) -> str:
    """Return the details of the answer, worded as on the terminal."""
    facts = {'driven': driven, **details(result)}
    inside = ''.join(f'<dt>{name}</dt><dd>{escape(facts[name].replace("+-", "±"))}</dd>'
                     for name in ('driven', *_FACTS) if name in facts)
    return f'<dl class="facts">{inside}</dl>'


def _row(row: Row, *, with_error: bool) -> str:
    more = ''
    if row.unit == 'deg' and row.is_known:
        std = '' if row.std is None else f' ± {np.deg2rad(row.std):.2g}'
        more = f' title="{np.deg2rad(row.value):.5f}{std} rad"'
    cells = (
        f'<th scope="row">{row.name}</th><td class="num value"{more}>{row.value_text}</td>'
        f'<td class="num">{row.std_text}</td>'
        f'<td class="unit">{row.unit if row.is_known else ""}</td>'
        f'<td class="of-gauge">{_gauge(row)}</td>'
        f'<td class="{row.word}">{_MARKS[row.word]} {row.word}</td>')
    if with_error:
        sigma = '–' if row.sigma is None else escape(in_sigmas(row.sigma, 1))
        cells += (f'<td class="num">{row.error_text or "–"}</td>'
                  f'<td class="{"num unknown" if _is_far(row) else "num"}">{sigma}</td>')
    return f'<tr class="row-{row.word}">{cells}</tr>'


def _gauge(row: Row) -> str:
    """Return a bar on a logarithmic scale of the standard deviation, with ticks at both limits."""
    std = row.weak_limit if row.std is None else row.std
    values = np.array([std if row.is_known else np.inf, row.weak_limit, row.unobserved_limit])
    # Decades from the left end.
    share = np.log10(np.maximum(values, 1e-12) / max(row.weak_limit, 1e-9)) + _BELOW
    width, *limits = np.clip(share / (_BELOW + _ABOVE), 0.02, 1.0) * _GAUGE
    canvas = Canvas(_GAUGE, 16)
    for style, length in (('gauge', _GAUGE), (f'fill-{row.word}', width)):
        canvas.box(0, 5, length, 6, style)
    for x in limits:
        canvas.box(x, 1, 1, 14, 'tick')
    return canvas.svg(f'standard deviation {row.word}')


def _copies(result: CalibrationResult) -> str:
    """Return tabs with text to copy; they work without JavaScript, which adds the button."""
    forward = Placement.of(result)
    if forward.kept_back:
        return ('<div class="copies"><h3>Copy as</h3><p class="lead">Nothing yet: '
                f'{escape(forward.kept_back)} is unobservable.</p></div>')
    tabs = ''
    for name, title in _FORMATS.items():
        try:
            there, back = (EXPORTS[name].write(item) for item in (forward, forward.inverted()))
        except CalibrationError:
            # Two frames with the same name are no transform.
            return ''
        words = EXPORTS[name].sentence
        tabs += filled(
            'copy.html', format=name, title=title, checked='' if tabs else ' checked',
            sentence=escape(words[:1].upper() + words[1:]), forward=escape(there),
            inverse=escape(back))
    return filled('copies.html', a=escape(result.frame_a), b=escape(result.frame_b), tabs=tabs)
