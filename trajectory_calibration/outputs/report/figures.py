# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures as inline SVG, coloured by the style sheet: plots with axes, and scenes to scale.

A figure is 360 units wide, the width of a phone, so that its text is as large as that of the
page. Wide screens show several figures side by side.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trajectory_calibration.geometry.chi_squared import quantile
from trajectory_calibration.geometry.se3 import FloatArray

WIDTH, HEIGHT = 360, 190
_LEFT, _RIGHT, _TOP, _BOTTOM = 48, 10, 20, 34
# Columns that a screen can show: of longer lines, the minimum and maximum of each column.
_COLUMNS = 220
# Points of a band, which is smooth.
_BAND_COLUMNS = 70
_TICKS = 5
# An axis that is shorter in the picture points at the reader, and is not drawn.
_SHORTEST_AXIS = 4
# Radius of the 95 % ellipse, standard deviations.
REACH = float(np.sqrt(quantile(2, 0.05)))

# Places and labels of ticks; a label may have several lines.
Ticks = Sequence[tuple[float, str]]


def ticks(low: float, high: float, count: int = _TICKS) -> FloatArray:
    """Return about ``count`` round numbers from low to high."""
    if not high > low:
        return np.array([low])
    raw = (high - low) / count
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * next(factor for factor in (1, 2, 5, 10) if factor * power >= 0.999 * raw)
    return step * np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1)


def log_ticks(low: float, high: float) -> FloatArray:
    """Return the powers of ten from low to high; in a short interval their 2 and 5, too."""
    powers = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    factors = [1.0] if np.log10(high / low) > 2 else [1.0, 2.0, 5.0]
    found = np.outer(10.0**powers, factors).ravel()
    return found[(found >= 0.999 * low) & (found <= 1.001 * high)]


def label(value: float) -> str:
    """Return the label of a tick: 0, 0.05, 1200."""
    return f'{value + 0.0:.6g}'


def limits(*arrays: ArrayLike, log: bool = False) -> tuple[float, float]:
    """Return the limits of an axis for all finite numbers, with a margin; never empty.

    A logarithmic axis has only positive numbers.
    """
    values = np.concatenate([np.ravel(array) for array in arrays])
    values = values[np.isfinite(values) & (values > (0.0 if log else -np.inf))]
    if not len(values):
        return 0.1, 1.0
    low, high = float(values.min()), float(values.max())
    if log:
        return max(low / 1.6, 1e-6), max(high * 1.6, 1e-5)
    room = 0.06 * (high - low) or max(abs(low), 1e-3) * 0.5
    return low - room, high + room


def from_zero(*arrays: ArrayLike) -> tuple[float, float]:
    """Return the limits of an axis that starts at zero."""
    return 0.0, limits(*arrays, [0.0, 1e-6])[1]


def evenly(count: int, most: int) -> NDArray[np.intp]:
    """Return indices of at most ``most`` of ``count`` points, with the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.intp))


class Canvas:
    """An SVG picture; the origin is the upper left corner.

    In all methods ``style`` is a class of the style sheet, ``css`` an inline style, and ``words``
    the tooltip, or the text of a text element.
    """

    def __init__(self, width: float = WIDTH, height: float = HEIGHT) -> None:
        self.width, self.height = width, height
        self._parts: list[str] = []

    def add(
        self, tag: str, style: str = '', css: str = '', words: str = '', **places: float | str,
    ) -> None:
        """Add an element; numbers are rounded to a tenth."""
        found = {'class': style, 'style': css} | {
            key.replace('_', '-'): value if isinstance(value, str) else f'{round(value, 1):.6g}'
            for key, value in places.items()}
        start = ' '.join([tag, *(f'{key}="{value}"' for key, value in found.items() if value)])
        inside = escape(words)
        if words and tag != 'text':
            inside = f'<title>{inside}</title>'
        self._parts.append(f'<{start}>{inside}</{tag}>' if inside else f'<{start}/>')

    def path(self, points: FloatArray, style: str = '', css: str = '', words: str = '') -> None:
        """Draw a line through (N, 2) points, or fill its inside; NaN breaks it."""
        self.add('path', style, css, words, d=_path(points), transform='scale(.1)')

    def dot(self, at: FloatArray, radius: float, style: str = '', css: str = '', words: str = '',
            ) -> None:
        """Mark a point, (2,)."""
        self.add('circle', style, css, words, cx=at[0], cy=at[1], r=radius)

    def box(self, x: float, y: float, width: float, height: float, style: str) -> None:
        """Fill a rectangle."""
        self.add('rect', style, x=x, y=y, width=width, height=height)

    def text(self, x: float, y: float, words: str, anchor: str = 'start', style: str = 'note',
             ) -> None:
        """Write words."""
        self.add('text', style, '', words, x=x, y=y, text_anchor=anchor)

    def svg(self, name: str) -> str:
        """Return the picture; ``name`` is for screen readers."""
        return (f'<svg viewBox="0 0 {self.width} {self.height}" role="img" '
                f'aria-label="{escape(name)}">{"".join(self._parts)}</svg>')


class Scene(Canvas):
    """A picture to scale: two axes of a frame, in metres, seen along the third.

    ``middle`` (2,) is the point at the centre; ``pixels`` are units of the picture per metre.
    """

    def __init__(self, width: float, height: float, middle: FloatArray, pixels: float) -> None:
        super().__init__(width, height)
        self._middle, self.pixels = middle, pixels

    @classmethod
    def around(cls, points: FloatArray, width: float, height: float) -> Scene:
        """Return a scene that shows (N, 2) points."""
        low, high = points.min(axis=0), points.max(axis=0)
        room = np.array([width, height]) - 2 * 24
        return cls(width, height, 0.5 * (low + high), np.min(room / np.maximum(high - low, 1e-9)))

    def place(self, points: ArrayLike) -> FloatArray:
        """Return the picture coordinates of (N, 2) points, or of one."""
        return (np.asarray(points, dtype=np.float64) - self._middle) * [
            self.pixels, -self.pixels] + np.array([self.width / 2, self.height / 2])

    def line(self, points: FloatArray, style: str = '', css: str = '') -> None:
        """Draw a line through (N, 2) points."""
        self.path(self.place(points), style, css)

    def axes(self, origin: FloatArray, axes: FloatArray, arm: float) -> None:
        """Draw the axes of a sensor: ``origin`` (2,), ``axes`` (2, 3), ``arm`` in metres."""
        for k, letter in enumerate('xyz'):
            ends = self.place([origin, origin + arm * axes[:, k]])
            if np.linalg.norm(ends[1] - ends[0]) > _SHORTEST_AXIS:
                self.path(ends, f'axis-{letter}')

    def legend(self, across: str, up: str) -> None:
        """Write the names of the axes, and draw a scale bar."""
        self.text(2, 11, f'{across} to the right, {up} up', style='unit')
        self.scale_bar()

    def scale_bar(self) -> None:
        """Draw a bar of a round length with its label."""
        longest = 0.3 * self.width / self.pixels
        length = log_ticks(0.1 * longest, longest)[-1]
        x, y = 10, self.height - 8
        right = x + length * self.pixels
        self.path(np.array([[x, y - 5], [x, y], [right, y], [right, y - 5]]), 'axis')
        self.text(x + 2, y - 4,
                  f'{length:g} m' if length >= 0.1 else f'{1e3 * length:g} mm')


def ellipse(covariance: FloatArray) -> FloatArray:
    """Return (N, 2) points of the 95 % ellipse of a (2, 2) covariance, about zero."""
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0, 2 * np.pi, 49)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    return REACH * circle * np.sqrt(np.maximum(values, 0.0)) @ vectors.T


class Mark(NamedTuple):
    """One element of a plot, in data coordinates; ``kind``: 'line', 'area', 'dots' or 'words'.

    ``style`` is a class of the style sheet, or the anchor of words ('start', 'middle', 'end');
    ``words`` are the text or the tooltip; ``size`` is the radius of a dot; ``shift`` moves words,
    in units of the picture.
    """

    kind: str
    x: FloatArray
    y: FloatArray
    style: str
    words: str = ''
    size: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)


class Plot:
    """A pair of axes and its elements, in data coordinates; ``svg`` returns the picture.

    ``x`` and ``y`` are limits; ``x_ticks`` and ``y_ticks`` are at round numbers by default;
    ``marks`` are the elements in drawing order.
    """

    def __init__(
        self, x: tuple[float, float], y: tuple[float, float], *, x_label: str = '',
        y_label: str = '', log_y: bool = False, height: int = HEIGHT,
        x_ticks: Ticks | None = None, y_ticks: Ticks | None = None,
    ) -> None:
        self.x, self.y, self.log_y, self._height = x, y, log_y, height
        self.x_label, self.y_label = x_label, y_label
        self.x_ticks = x_ticks or _labelled(ticks(*x))
        self.y_ticks = y_ticks or _labelled(log_ticks(*y) if log_y else ticks(*y))
        self.marks: list[Mark] = []

    def line(self, x: ArrayLike, y: ArrayLike, style: str) -> None:
        """Draw a line; NaN breaks it."""
        self._mark('line', x, y, style)

    def dots(self, x: ArrayLike, y: ArrayLike, style: str, radius: float, title: str = '') -> None:
        """Draw a dot at each point."""
        self._mark('dots', x, y, style, title, radius)

    def write(
        self, x: float, y: float, words: str, anchor: str = 'start',
        shift: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Write words at a point."""
        if words:
            self._mark('words', [x], [y], anchor, words, 0.0, shift)

    def _mark(self, kind: str, x: ArrayLike, y: ArrayLike, *how: Any) -> None:
        self.marks.append(Mark(kind, np.asarray(x, float), np.asarray(y, float), *how))

    def band(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, style: str) -> None:
        """Fill between two lines."""
        sides = np.array([x, low, high], dtype=np.float64)
        xs, lows, highs = sides[:, ::max(1, sides.shape[1] // _BAND_COLUMNS)]
        self._mark('area', [*xs, *xs[::-1]], [*highs, *lows[::-1]], style)

    def rectangle(
        self, x: tuple[float, float], y: tuple[float, float], style: str, title: str = '',
    ) -> None:
        """Fill a rectangle; ``title`` is the tooltip."""
        self._mark('area', [*x, *x[::-1]], np.repeat(y, 2), style, title)

    def error_bar(self, x: float, y: float, std: float, style: str, title: str = '') -> None:
        """Draw a point with two standard deviations on either side."""
        low, high, cap = y - 2 * std, y + 2 * std, 0.008 * (self.x[1] - self.x[0])
        self.line([x - cap, x + cap, x, x, x - cap, x + cap],
                  [low, low, low, high, high, high], f'{style} bar')
        if self.y[0] <= y <= self.y[1]:
            self.dots([x], [y], style, 3.2, title)

    def horizontal(self, y: float, style: str, words: str = '', *, at_left: bool = False) -> None:
        """Draw a horizontal line with a label at one end."""
        self.line(self.x, [y, y], style)
        end, anchor, shift = (0, 'start', 3) if at_left else (1, 'end', -2)
        self.write(self.x[end], y, words, anchor, (shift, -4))

    def vertical(self, x: float, style: str, words: str = '') -> None:
        """Draw a vertical line with a label at the bottom."""
        self.line([x, x], self.y, style)
        self.write(x, self.y[0], words, shift=(4, -4))

    def svg(self, name: str) -> str:
        """Return the picture; ``name`` is for screen readers."""
        canvas = Canvas(WIDTH, self._height)
        bottom, right = self._height - _BOTTOM, WIDTH - _RIGHT

        def place(x: ArrayLike, y: ArrayLike) -> FloatArray:
            return np.column_stack([_scaled(x, self.x, (_LEFT, right)),
                                    _scaled(y, self.y, (bottom, _TOP), log=self.log_y)])

        for value, words in self.y_ticks:
            ends = place(self.x, [value, value])
            canvas.path(ends, 'gridline')
            canvas.text(_LEFT - 6, ends[0, 1] + 4, words, 'end', '')
        for value, words in self.x_ticks:
            for k, line in enumerate(words.split('\n')):
                canvas.text(place(value, self.y[0])[0, 0], bottom + 15 + 13 * k, line, 'middle',
                            '')
        canvas.path(place(self.x, [self.y[0]] * 2), 'axis')
        # In corners that no curve reaches.
        canvas.text(right, self._height - 3, self.x_label, 'end', 'unit')
        canvas.text(2, 9, self.y_label, style='unit')
        for mark in self.marks:
            x, y = mark.x, mark.y
            if mark.kind == 'line' and len(x) > 2 * _COLUMNS:
                x, y = _envelope(x, y)
            points = place(x, y)
            if mark.kind == 'words':
                px, py = points[0] + mark.shift
                canvas.text(px, py, mark.words, mark.style)
            elif mark.kind == 'dots':
                for at in points[np.isfinite(points).all(axis=1)]:
                    canvas.dot(at, mark.size, mark.style, words=mark.words)
            else:
                canvas.path(points, mark.style, '', mark.words)
        return canvas.svg(name)


def _labelled(values: FloatArray) -> Ticks:
    return [(value, label(value)) for value in values]


def _scaled(
    values: ArrayLike, interval: tuple[float, float], ends: tuple[float, float], *,
    log: bool = False,
) -> FloatArray:
    """Map values of an interval linearly to that between two ends; values outside are clipped."""
    values = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if log:
        return np.interp(np.log10(np.maximum(values, 1e-12)), np.log10(interval), ends)
    return np.interp(values, interval, ends)


def _path(points: FloatArray) -> str:
    """Return the SVG path data of (N, 2) points, in tenths of a unit; NaN breaks the line."""
    # Integers, so that rounding errors of relative steps do not accumulate.
    tenths = np.round(10 * points)
    known = np.append(np.isfinite(tenths).all(axis=1), False)
    words = ''
    for start, end in np.flatnonzero(np.diff(known, prepend=False)).reshape(-1, 2):
        (x, y), *more = np.diff(tenths[start:end].astype(int), axis=0, prepend=0).tolist()
        words += f'M{x} {y}' + ''.join(f'l{dx} {dy}' for dx, dy in more).replace(' -', '-')
    return words or 'M0 0'


def _envelope(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the minimum and the maximum of each column, in the order of x."""
    width = -(-len(y) // _COLUMNS)
    padded = np.append(y, np.full(_COLUMNS * width - len(y), np.nan)).reshape(_COLUMNS, width)
    first = width * np.arange(_COLUMNS)
    keep = np.unique([first + np.where(np.isnan(padded), np.inf, sign * padded).argmin(axis=1)
                      for sign in (1, -1)])
    keep = keep[keep < len(y)]
    return x[keep], y[keep]
