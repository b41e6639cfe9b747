# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Small figures as inline SVG, coloured by style sheet: plots with axes, and scenes to scale.

A figure is drawn 360 units wide, which is the width of a phone, so that its text stays as large
as that of the page; wide screens show several side by side.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
import itertools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from trajectory_calibration.geometry.chi_squared import quantile
from trajectory_calibration.geometry.se3 import FloatArray

WIDTH, HEIGHT = 360, 190
_LEFT, _RIGHT, _TOP, _BOTTOM = 48, 10, 20, 34
# Points of a line that a screen can show: beyond, the least and the largest of each part.
_COLUMNS = 220
# A band is smooth.
_BAND_COLUMNS = 70
_TICKS = 5
# Arms of an axis that are no longer look at the reader.
_SHORTEST_AXIS = 4
# Standard deviations that an ellipse reaches, which holds 95 %.
REACH = float(np.sqrt(quantile(2, 0.05)))


def ticks(low: float, high: float, count: int = _TICKS) -> FloatArray:
    """Return round numbers from low to high, about ``count``."""
    span = high - low
    if not np.isfinite(span) or span <= 0:
        return np.array([low])
    raw = span / count
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * next(factor for factor in (1, 2, 5, 10) if factor * power >= 0.999 * raw)
    first = np.ceil(low / step - 1e-9)
    return step * np.arange(first, np.floor(high / step + 1e-9) + 1)


def log_ticks(low: float, high: float) -> FloatArray:
    """Return powers of ten between low and high, or 1, 2, 5 where these are few."""
    powers = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    factors = (1.0,) if np.log10(high / low) > 2 else (1.0, 2.0, 5.0)
    found = np.sort(np.concatenate([factor * 10.0**powers for factor in factors]))
    return found[(found >= 0.999 * low) & (found <= 1.001 * high)]


def label(value: float) -> str:
    """Return a number of an axis: 0, 0.05, 1200."""
    return f'{value + 0.0:.6g}' if abs(value) > 1e-12 else '0'


def limits(*arrays: ArrayLike, include: Sequence[float] = (), pad: float = 0.06) -> tuple[
        float, float]:
    """Return an interval that holds all finite numbers with a little room; never empty."""
    values = np.concatenate([np.ravel(array) for array in (*arrays, include)])
    values = values[np.isfinite(values)]
    if not len(values):
        return 0.0, 1.0
    low, high = values.min(), values.max()
    room = pad * (high - low) or max(abs(low), 1e-3) * 0.5
    return low - room, high + room


class Canvas:
    """A picture in units of its own, from the upper left corner; ``svg`` returns it.

    ``style`` is a class of the style sheet, ``css`` what is of this one drawing, a colour.
    """

    def __init__(self, name: str, width: float = WIDTH, height: float = HEIGHT) -> None:
        self.width, self.height, self._name = width, height, name
        self._parts: list[str] = []

    def add(
        self, tag: str, style: str = '', css: str = '', inside: str = '', **places: float | str,
    ) -> None:
        """Add an element; of its places, numbers are written to a tenth."""
        words = [tag, *(f'{key}="{escape(value)}"' for key, value in (
            ('class', style), ('style', css)) if value)]
        words += [f'{key.replace("_", "-")}="{_place(value)}"' for key, value in places.items()]
        self._parts.append(f'<{" ".join(words)}' + (f'>{inside}</{tag}>' if inside else '/>'))

    def path(self, points: FloatArray, style: str = '', css: str = '', *, closed: bool = False,
             title: str = '') -> None:
        """Draw a line through (N, 2) points; NaN breaks it."""
        self.add('path', style, css, _title(title), d=_path(points) + 'Z' * closed)

    def circle(
        self, x: float, y: float, radius: float, style: str = '', css: str = '', title: str = '',
    ) -> None:
        """Draw a dot; ``title`` is shown under the pointer."""
        self.add('circle', style, css, _title(title), cx=x, cy=y, r=f'{radius:g}')

    def box(self, x: float, y: float, width: float, height: float, style: str = '',
            css: str = '', title: str = '') -> None:
        """Fill a rectangle."""
        self.add('rect', style, css, _title(title), x=x, y=y, width=width, height=height)

    def text(self, x: float, y: float, words: str, anchor: str = 'start', style: str = 'note',
             ) -> None:
        """Write words."""
        self.add('text', style, '', escape(words), x=x, y=y, text_anchor=anchor)

    def svg(self) -> str:
        """Return the picture."""
        return (f'<svg viewBox="0 0 {self.width} {self.height}" role="img" '
                f'aria-label="{escape(self._name)}">{"".join(self._parts)}</svg>')


class Scene(Canvas):
    """A picture to scale of places in metres, two axes of a frame seen along the third.

    ``middle``, (2,), stands in its centre; ``pixels`` are units of the picture per metre.
    """

    def __init__(
        self, name: str, width: float, height: float, middle: FloatArray, pixels: float,
    ) -> None:
        super().__init__(name, width, height)
        self._middle, self.pixels = middle, pixels

    @classmethod
    def around(
        cls, points: FloatArray, name: str, width: float, height: float, *, margin: float = 24,
    ) -> Scene:
        """Return a scene that holds (N, 2) points."""
        low, high = points.min(axis=0), points.max(axis=0)
        room = np.array([width - 2 * margin, height - 2 * margin])
        return cls(name, width, height, 0.5 * (low + high),
                   np.min(room / np.maximum(high - low, 1e-9)))

    def place(self, points: ArrayLike) -> FloatArray:
        """Return where (N, 2) points, or one, stand in the picture."""
        return (np.asarray(points, dtype=np.float64) - self._middle) * [
            self.pixels, -self.pixels] + np.array([self.width / 2, self.height / 2])

    def line(self, points: FloatArray, style: str = '', css: str = '', *, closed: bool = False,
             ) -> None:
        """Draw a line through (N, 2) points."""
        self.path(self.place(points), style, css, closed=closed)

    def dot(self, point: FloatArray, radius: float, style: str = '', css: str = '') -> None:
        """Mark a point."""
        x, y = self.place(point)
        self.circle(x, y, radius, style, css)

    def axes(self, origin: FloatArray, axes: FloatArray, arm: float) -> None:
        """Draw the three axes of a sensor, (2, 3) each; one towards the reader is left out."""
        start = self.place(origin)
        for k, letter in enumerate('xyz'):
            end = self.place(origin + arm * axes[:, k])
            if np.linalg.norm(end - start) > _SHORTEST_AXIS:
                self.path(np.stack([start, end]), f'axis-{letter}')

    def legend(self, across: str, up: str) -> None:
        """Write which axis points where, and draw a scale bar."""
        self.text(2, 11, f'{across} to the right, {up} up', style='unit')
        self.scale_bar()

    def scale_bar(self) -> None:
        """Draw a bar of a round length, and write how long it is."""
        longest = 0.3 * self.width / self.pixels
        length = log_ticks(0.1 * longest, longest)[-1]
        words = f'{length:g} m' if length >= 0.1 else f'{1e3 * length:g} mm'
        x, y = 10, self.height - 8
        self.add('path', 'axis', d=f'M{x} {y - 5}v5h{length * self.pixels:.1f}v-5')
        self.text(x + 2, y - 4, words)


def ellipse(covariance: FloatArray) -> FloatArray:
    """Return (N, 2) points, about zero, of the ellipse that holds 95 % of a (2, 2) covariance."""
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0, 2 * np.pi, 49)[:-1]
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    return REACH * circle * np.sqrt(np.maximum(values, 0.0)) @ vectors.T


class Mark(NamedTuple):
    """One thing on a plot, in its numbers: a 'line', an 'area', 'dots' or 'words'.

    ``style`` is a class of the style sheet, of words where they stand ('start', 'middle', 'end');
    ``words`` are written, or shown under the pointer; ``size`` is the radius of a dot; ``shift``
    moves words, in units of the picture.
    """

    kind: str
    x: FloatArray
    y: FloatArray
    style: str
    words: str = ''
    size: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)


class Plot:
    """One pair of axes and what is drawn on it, in its numbers; ``svg`` returns the picture.

    ``x`` and ``y`` are limits, ``x_ticks`` and ``y_ticks`` places and words, None for round
    numbers; ``marks`` is what is drawn, the lowest first.
    """

    def __init__(
        self, x: tuple[float, float], y: tuple[float, float], *, name: str, x_label: str = '',
        y_label: str = '', log_y: bool = False, height: int = HEIGHT,
        x_ticks: Sequence[tuple[float, str]] | None = None,
        y_ticks: Sequence[tuple[float, str]] | None = None,
    ) -> None:
        self.name, self.x, self.y, self.log_y, self._height = name, x, y, log_y, height
        self.x_label, self.y_label = x_label, y_label
        self.x_ticks, self.y_ticks = x_ticks, y_ticks
        self.marks: list[Mark] = []

    def line(self, x: ArrayLike, y: ArrayLike, style: str) -> None:
        """Draw a line; NaN breaks it."""
        self._mark('line', x, y, style)

    def dots(
        self, x: ArrayLike, y: ArrayLike, style: str, radius: float = 2.6, title: str = '',
    ) -> None:
        """Draw a dot at each point."""
        self._mark('dots', x, y, style, title, radius)

    def write(
        self, x: float, y: float, words: str, anchor: str = 'start',
        shift: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Write words at a point."""
        if words:
            self._mark('words', [x], [y], anchor, words, shift=shift)

    def _mark(self, kind: str, x: ArrayLike, y: ArrayLike, *how: Any, **more: Any) -> None:
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        self.marks.append(Mark(kind, x, y, *how, **more))

    def band(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, style: str) -> None:
        """Fill between two lines."""
        sides = np.array([x, low, high], dtype=np.float64)
        xs, lows, highs = sides[:, ::max(1, sides.shape[1] // _BAND_COLUMNS)]
        self._mark('area', [*xs, *xs[::-1]], [*highs, *lows[::-1]], style)

    def rectangle(
        self, x: tuple[float, float], y: tuple[float, float], style: str, title: str = '',
    ) -> None:
        """Fill a rectangle; ``title`` is shown under the pointer."""
        self._mark('area', [*x, *x[::-1]], np.repeat(y, 2), style, title)

    def error_bar(self, x: float, y: float, std: float, style: str, title: str = '') -> None:
        """Draw a point with two standard deviations on either side."""
        low, high, cap = y - 2 * std, y + 2 * std, 0.008 * (self.x[1] - self.x[0])
        self.line([x - cap, x + cap, x, x, x - cap, x + cap],
                  [low, low, low, high, high, high], f'{style} bar')
        if self.y[0] <= y <= self.y[1]:
            self.dots([x], [y], style, 3.2, title)

    def horizontal(self, y: float, style: str, words: str = '', *, at_left: bool = False) -> None:
        """Draw a level line with its name at one end."""
        self.line(self.x, [y, y], style)
        end, anchor, shift = (0, 'start', 3) if at_left else (1, 'end', -2)
        self.write(self.x[end], y, words, anchor, (shift, -4))

    def vertical(self, x: float, style: str, words: str = '') -> None:
        """Draw an upright line with its name at the top."""
        self.line([x, x], self.y, style)
        self.write(x, self.y[1], words, shift=(4, 9))

    def svg(self) -> str:
        """Return the picture."""
        canvas = Canvas(self.name, WIDTH, self._height)
        bottom, right = self._height - _BOTTOM, WIDTH - _RIGHT
        to_x = _axis(self.x, _LEFT, right, log=False)
        to_y = _axis(self.y, bottom, _TOP, log=self.log_y)
        y_ticks = log_ticks(*self.y) if self.log_y else ticks(*self.y)
        for value, words in _labelled(y_ticks) if self.y_ticks is None else self.y_ticks:
            py = float(to_y(value))
            canvas.path(np.array([[_LEFT, py], [right, py]]), 'grid')
            canvas.text(_LEFT - 6, py + 4, words, 'end', '')
        for value, words in _labelled(ticks(*self.x)) if self.x_ticks is None else self.x_ticks:
            canvas.text(float(to_x(value)), bottom + 15, words, 'middle', '')
        canvas.path(np.array([[_LEFT, bottom], [right, bottom]]), 'axis')
        # Beside its axis, in a corner where no curve ends.
        canvas.text(right, self._height - 3, self.x_label, 'end', 'unit')
        canvas.text(2, 9, self.y_label, style='unit')
        for mark in self.marks:
            x, y = mark.x, mark.y
            if mark.kind == 'line' and len(x) > 2 * _COLUMNS:
                x, y = _envelope(x, y)
            points = np.column_stack([to_x(x), to_y(np.clip(y, *self.y))])
            if mark.kind == 'words':
                px, py = points[0] + mark.shift
                canvas.text(px, py, mark.words, mark.style)
            elif mark.kind == 'dots':
                for px, py in points[np.isfinite(points).all(axis=1)]:
                    canvas.circle(px, py, mark.size, mark.style, title=mark.words)
            else:
                canvas.path(points, mark.style, closed=mark.kind == 'area', title=mark.words)
        return canvas.svg()


def _labelled(values: FloatArray) -> list[tuple[float, str]]:
    return [(value, label(value)) for value in values]


def _title(words: str) -> str:
    return f'<title>{escape(words)}</title>' if words else ''


def _place(value: float | str) -> str:
    return value if isinstance(value, str) else f'{round(value, 1):.6g}'


def _path(points: FloatArray) -> str:
    """Return the data of a path through (N, 2) points of the picture; NaN breaks it."""
    # Whole tenths, so that rounding does not add up over the steps.
    words, before, pen = [], (0, 0), False
    for px, py in points:
        if not (np.isfinite(px) and np.isfinite(py)):
            pen = False
            continue
        at = round(10 * px), round(10 * py)
        if pen:
            step = _tenths(at[0] - before[0]), _tenths(at[1] - before[1])
            words.append('l' + step[0] + ('' if step[1].startswith('-') else ' ') + step[1])
        else:
            words.append(f'M{at[0] / 10:g} {at[1] / 10:g}')
        before, pen = at, True
    return ''.join(words) or 'M0 0'


def _tenths(value: int) -> str:
    """Return the shortest text of tenths: '.5', '-12', '-.3'."""
    words = f'{value / 10:g}'
    return words.replace('0.', '.', 1) if abs(value) < 10 else words


def _axis(
    interval: tuple[float, float], start: float, end: float, *, log: bool,
) -> Callable[[ArrayLike], FloatArray]:
    low, high = np.log10(interval) if log else interval
    scale = (end - start) / (high - low if high > low else 1.0)

    def place(values: ArrayLike) -> FloatArray:
        if log:
            values = np.log10(np.maximum(values, 1e-12))
        return start + (np.clip(values, low, high) - low) * scale

    return place


def _envelope(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest point of each column, in their order."""
    edges = np.linspace(0, len(x), _COLUMNS + 1).astype(np.intp)
    keep: list[int] = []
    for first, last in itertools.pairwise(edges):
        part = y[first:last]
        if np.isnan(part).all():
            keep.append(first)
        else:
            keep += sorted({first + int(np.nanargmin(part)), first + int(np.nanargmax(part))})
    return x[keep], y[keep]
