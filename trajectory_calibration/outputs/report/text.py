# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""HTML in small pieces: escaped text, numbers, figures with their captions."""

from __future__ import annotations

from collections.abc import Iterable
from configparser import RawConfigParser
from functools import cache
from html import escape

from trajectory_calibration.outputs.report.figures import Canvas, Plot
from trajectory_calibration.outputs.report.page import asset


def metres(value: float) -> str:
    """Return a length for a person: '1.72 m', '3.1 km', '4 mm'."""
    if value >= 1000:
        return f'{1e-3 * value:.3g} km'
    if value >= 1:
        return f'{value:.3g} m'
    return f'{1e3 * value:.3g} mm' if value < 0.01 else f'{value:.2g} m'


def sentence(text: str) -> str:
    """Return a text with a capital and a full stop; names (sensor_a, a.tum) keep their case."""
    first, _, rest = text.partition(' ')
    start = first.capitalize() if first.isalpha() and first.islower() else first
    return f'{start} {rest}'.rstrip() + ('' if text.endswith('.') else '.')


def verdict_section(level: str, title: str, badge: str, inside: str) -> str:
    """Return the box that begins a page; ``title`` and ``inside`` are HTML."""
    return (f'<section class="verdict {level}"><div class="head"><h1>{title}</h1>'
            f'<p class="badge">{escape(badge)}</p></div>{inside}</section>')


def next_step(text: str) -> str:
    """Return what a person should do now, '' for nothing."""
    return f'<p class="next"><b>Next</b> {escape(sentence(text))}</p>' if text else ''


@cache
def _captions() -> RawConfigParser:
    found = RawConfigParser()
    found.read_string(asset('captions.ini'))
    return found


def figure(
    kind: str, picture: Canvas | Plot | str, reading: str, *, wide: bool = False,
    legend: str = '', **names: str,
) -> str:
    """Return a figure with what it says here, and what good and bad look like.

    ``kind`` is a section of captions.ini, whose title has gaps for ``names``.
    """
    title, good, bad = (_captions()[kind][key] for key in ('title', 'good', 'bad'))
    style = ' class="wide"' if wide else ''
    drawn = picture if isinstance(picture, str) else picture.svg()
    return (
        f'<figure{style}><h3>{escape(title.format(**names))}</h3>{legend}{drawn}<figcaption>'
        f'<p class="reading">{escape(reading)}</p>'
        f'<p><b>Good:</b> {escape(good)}. <b>Bad:</b> {escape(bad)}.</p>'
        '</figcaption></figure>')


def legend(*items: tuple[str, str]) -> str:
    """Return a legend of (style, name)."""
    inside = ''.join(f'<span><i class="key {style}"></i>{escape(name)}</span>'
                     for style, name in items)
    return f'<p class="legend">{inside}</p>'


def section(number_: int, title: str, inside: str, lead: str = '', *, columns: int = 3) -> str:
    """Return a numbered section of the page."""
    words = f'<p class="lead">{escape(lead)}</p>' if lead else ''
    return (f'<section id="s{number_}"><h2><span>{number_}</span>{escape(title)}</h2>{words}'
            f'<div class="grid of{columns}">{inside}</div></section>')


def table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]], style: str = '') -> str:
    """Return a table of escaped cells."""
    top = ''.join(f'<th scope="col">{escape(cell)}</th>' for cell in head)
    body = ''.join(
        '<tr>' + ''.join(f'<td>{escape(cell)}</td>' for cell in row) + '</tr>' for row in rows)
    return (f'<div class="scroll"><table class="{style}"><thead><tr>{top}</tr></thead>'
            f'<tbody>{body}</tbody></table></div>')
