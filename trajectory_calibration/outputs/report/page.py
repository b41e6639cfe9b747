# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""HTML pages and their elements: one file with style and scripts, without external resources."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from configparser import RawConfigParser
from dataclasses import dataclass, field
from functools import cache
from html import escape
from importlib.resources import files
import platform
from string import Template

import numpy as np

from trajectory_calibration.outputs.report.figures import Canvas, Plot
from trajectory_calibration.version import __version__


def asset(name: str) -> str:
    """Return the text of a file beside this module."""
    return (files(__package__) / name).read_text(encoding='utf-8')


def filled(name: str, **texts: str) -> str:
    """Return a template beside this module with HTML inserted."""
    return Template(asset(name)).substitute(texts)


def versions() -> str:
    """Return the versions of this package, Python, NumPy and the system."""
    return (f'trajectory_calibration {__version__}, Python {platform.python_version()}, '
            f'NumPy {np.__version__}, {platform.system()} {platform.machine()}')


def page(
    title: str, sections: str, *, navigation: tuple[str, ...] = (),
    scripts: tuple[str, ...] = ('page.js', 'view3d.js'),
) -> str:
    """Return a page; ``navigation`` has the names of its sections."""
    links = ''.join(f'<a href="#s{k}">{k} {escape(name)}</a>'
                    for k, name in enumerate(navigation, 1))
    script = f'<script>{"".join(map(asset, scripts))}</script>' if scripts else ''
    return filled(
        'page.html', title=escape(title), made_by=escape(versions()), style=asset('page.css'),
        links=links, sections=sections, script=script)


def metres(value: float) -> str:
    """Return a length with a suitable unit: '1.72 m', '3.1 km', '4 mm'."""
    if value >= 1000:
        return f'{1e-3 * value:.3g} km'
    if value >= 1 or value == 0:
        return f'{value:.3g} m'
    return f'{1e3 * value:.3g} mm' if value < 0.01 else f'{value:.2g} m'


def sentence(text: str) -> str:
    """Return a text with a capital and a full stop; names (x, sensor_a, a.tum) keep their case."""
    first, _, rest = text.partition(' ')
    named = len(first) == 1 or not first.isalpha() or not first.islower()
    start = first if named else first.capitalize()
    return f'{start} {rest}'.rstrip() + ('' if text.endswith('.') else '.')


def verdict_section(level: str, title: str, badge: str, inside: str) -> str:
    """Return the box at the top of a page; ``title`` and ``inside`` are HTML."""
    return (f'<section class="verdict {level}"><div class="head"><h1>{title}</h1>'
            f'<p class="badge">{escape(badge)}</p></div>{inside}</section>')


def next_step(text: str) -> str:
    """Return the line with the next step, '' for none."""
    return f'<p class="next"><b>Next</b> {escape(sentence(text))}</p>' if text else ''


@cache
def _captions() -> RawConfigParser:
    found = RawConfigParser()
    found.read_string(asset('captions.ini'))
    return found


@dataclass(frozen=True)
class Figure:
    """A picture with its interpretation, and examples of good and bad; ``str`` gives the HTML.

    ``kind`` is a section of captions.ini, and ``names`` fill the fields of its title. ``legend``
    has a style class or colour, and a name, for each element. ``reading`` interprets the picture,
    which may be HTML.
    """

    kind: str
    picture: Canvas | Plot | str
    reading: str
    legend: Sequence[tuple[str, str]] = ()
    wide: bool = False
    names: Mapping[str, str] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Return the title above the picture."""
        return _captions()[self.kind]['title'].format(**self.names)

    def __str__(self) -> str:
        """Return the figure as HTML."""
        keys = ''.join(
            f'<span><i class="key {style}" style="--key:{style}"></i>{escape(name)}</span>'
            for style, name in self.legend)
        keys = f'<p class="legend">{keys}</p>' if keys else ''
        style = ' class="wide"' if self.wide else ''
        drawn = (self.picture if isinstance(self.picture, str) else
                 self.picture.svg(self.title))
        good, bad = (escape(_captions()[self.kind][key]) for key in ('good', 'bad'))
        return (f'<figure{style}><h3>{escape(self.title)}</h3>{keys}{drawn}<figcaption>'
                f'<p class="reading">{escape(self.reading)}</p>'
                f'<p><b>Good:</b> {good}. <b>Bad:</b> {bad}.</p></figcaption></figure>')


def section(
    number_: int, title: str, inside: Iterable[Figure | str], lead: str = '', *, columns: int = 3,
) -> str:
    """Return a numbered section; ``lead`` is text, ``inside`` are figures or HTML."""
    words = f'<p class="lead">{escape(lead)}</p>' if lead else ''
    return (f'<section id="s{number_}"><h2><span>{number_}</span>{escape(title)}</h2>{words}'
            f'<div class="grid of{columns}">{"".join(map(str, inside))}</div></section>')


def table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]], style: str = '') -> str:
    """Return a table of escaped cells; '+-' becomes one character."""
    top = ''.join(f'<th>{escape(cell)}</th>' for cell in head)
    body = ''.join(
        '<tr>' + ''.join(f'<td>{escape(cell)}</td>' for cell in row) + '</tr>' for row in rows)
    text = f'<thead><tr>{top}</tr></thead><tbody>{body}</tbody>'.replace('+-', '±')
    return f'<div class="scroll"><table class="{style}">{text}</table></div>'
