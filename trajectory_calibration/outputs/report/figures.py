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

import numpy as np
from numpy.typing import ArrayLike

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
# Chi-squared of two degrees of freedom that chance exceeds in one of twenty.
_ELLIPSE = 5.991


def ticks(low: float, high: float, count: int = _TICKS) -> FloatArray:
    """Return round numbers from low to high, about ``count``."""
    span = high - low
    if not np.isfinite(span) or span <= 0:
        return np.array([low])
    raw = span / count
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * next(factor for factor in (1, 2, 5, 10) if factor * power >= 0.999 * raw)
    first = np.ceil(low / step - 1e-9)
    found: FloatArray = step * np.arange(first, np.floor(high / step + 1e-9) + 1)
    return found


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
    values = np.concatenate([np.ravel(np.asarray(array, dtype=np.float64)) for array in arrays]
                            + [np.asarray(include, dtype=np.float64)])
    values = values[np.isfinite(values)]
    if not len(values):
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
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

    Parameters
    ----------
    name, width, height : of the picture.
    middle : (2,), what stands in its centre.
    pixels : units of the picture per metre.

    """

    def __init__(
        self, name: str, width: float, height: float, middle: FloatArray, pixels: float,
    ) -> None:
        super().__init__(name, width, height)
        self._middle, self.pixels = middle, pixels

    @classmethod
    def around(
        cls, points: FloatArray, name: str, width: float, height: float, *, margin: float = 24,
        least: float = 1e-9,
    ) -> Scene:
        """Return a scene that holds (N, 2) points; ``least`` metres fill it."""
        low, high = points.min(axis=0), points.max(axis=0)
        room = np.array([width - 2 * margin, height - 2 * margin])
        return cls(name, width, height, 0.5 * (low + high),
                   float(np.min(room / np.maximum(high - low, least))))

    def place(self, points: ArrayLike) -> FloatArray:
        """Return where (N, 2) points, or one, stand in the picture."""
        placed: FloatArray = (np.asarray(points, dtype=np.float64) - self._middle) * [
            self.pixels, -self.pixels] + [self.width / 2, self.height / 2]
        return placed

    def line(self, points: FloatArray, style: str = '', css: str = '', *, closed: bool = False,
             ) -> None:
        """Draw a line through (N, 2) points."""
        self.path(self.place(points), style, css, closed=closed)

    def dot(self, point: FloatArray, radius: float, style: str = '', css: str = '') -> None:
        """Mark a point."""
        x, y = self.place(point)
        self.circle(x, y, radius, style, css)

    def axes(self, origin: FloatArray, axes: FloatArray, arm: float, *, lettered: bool = False,
             ) -> None:
        """Draw the three axes of a sensor, (2, 3) each; one towards the reader is left out."""
        start = self.place(origin)
        for k, letter in enumerate('xyz'):
            end = self.place(origin + arm * axes[:, k])
            length = float(np.linalg.norm(end - start))
            if length <= _SHORTEST_AXIS:
                continue
            self.path(np.stack([start, end]), f'axis-{letter}')
            if lettered:
                x, y = start + (end - start) * (1 + 9 / length)
                self.text(x, y + 3, letter, 'middle', 'note mini')

    def legend(self, across: str, up: str) -> None:
        """Write which axis points where, and draw a scale bar."""
        self.text(2, 11, f'{across} to the right, {up} up', style='unit')
        self.scale_bar()

    def scale_bar(self) -> None:
        """Draw a bar of a round length, and write how long it is."""
        length = float(ticks(0.0, 0.3 * self.width / self.pixels, 2)[-1])
        words = f'{length:g} m' if length >= 0.1 else f'{1e3 * length:g} mm'
        x, y = 10, self.height - 8
        self.add('path', 'axis', d=f'M{x} {y - 5}v5h{length * self.pixels:.1f}v-5')
        self.text(x + 2, y - 4, words)


def ellipse(covariance: FloatArray) -> FloatArray:
    """Return (N, 2) points, about zero, of the ellipse that holds 95 % of a (2, 2) covariance."""
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0, 2 * np.pi, 49)[:-1]
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    points: FloatArray = circle * np.sqrt(_ELLIPSE * np.maximum(values, 0.0)) @ vectors.T
    return points


class Plot(Canvas):
    """One pair of axes; methods draw onto it in its numbers."""

    def __init__(
        self, x: tuple[float, float], y: tuple[float, float], *, name: str, x_label: str = '',
        y_label: str = '', log_y: bool = False, height: int = HEIGHT,
        x_ticks: Sequence[tuple[float, str]] | None = None,
        y_ticks: Sequence[tuple[float, str]] | None = None,
    ) -> None:
        super().__init__(name, WIDTH, height)
        self._y = y
        self._bottom, self._right = height - _BOTTOM, WIDTH - _RIGHT
        self._to_x = _axis(x, _LEFT, self._right, log=False)
        self._to_y = _axis(y, self._bottom, _TOP, log=log_y)
        of_y = log_ticks(*y) if log_y else ticks(*y)
        for value, words in _labelled(of_y) if y_ticks is None else y_ticks:
            self.horizontal(value, 'grid')
            self.text(_LEFT - 6, float(self._to_y(np.array(value))) + 4, words, 'end', '')
        for value, words in _labelled(ticks(*x)) if x_ticks is None else x_ticks:
            self.text(float(self._to_x(np.array(value))), self._bottom + 15, words, 'middle', '')
        self.add('path', 'axis', d=f'M{_LEFT} {self._bottom}H{self._right}')
        # Beside its axis, in a corner where no curve ends.
        self.text(self._right, height - 3, x_label, 'end', 'unit')
        self.text(2, 9, y_label, style='unit')

    def line(self, x: ArrayLike, y: ArrayLike, style: str) -> None:
        """Draw a line; NaN breaks it."""
        xs, ys = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        if len(xs) > 2 * _COLUMNS:
            xs, ys = _envelope(xs, ys)
        self.path(self._points(xs, ys), style)

    def band(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, style: str) -> None:
        """Fill between two lines."""
        xs, lows, highs = (np.asarray(v, dtype=np.float64) for v in (x, low, high))
        every = slice(None, None, max(1, len(xs) // _BAND_COLUMNS))
        xs, lows, highs = xs[every], lows[every], highs[every]
        self.path(self._points(np.concatenate([xs, xs[::-1]]),
                               np.concatenate([highs, lows[::-1]])), style, closed=True)

    def dots(self, x: ArrayLike, y: ArrayLike, style: str, radius: float = 2.6) -> None:
        """Draw a dot at each point."""
        points = self._points(x, y)
        for px, py in points[np.isfinite(points).all(axis=1)]:
            self.circle(px, py, radius, style)

    def error_bar(self, x: float, y: float, std: float, style: str, title: str = '') -> None:
        """Draw a point with two standard deviations on either side."""
        (px, low), (_, py), (_, high) = self._points([x] * 3, [y - 2 * std, y, y + 2 * std])
        self.add('path', f'{style} bar', d=(
            f'M{px:.1f} {low:.1f}V{high:.1f}M{px - 3:.1f} {low:.1f}h6M{px - 3:.1f} {high:.1f}h6'))
        if self._y[0] <= y <= self._y[1]:
            self.circle(px, py, 3.2, style, title=title)

    def rectangle(
        self, x: tuple[float, float], y: tuple[float, float], style: str, title: str = '',
    ) -> None:
        """Fill a rectangle."""
        low, high = np.sort(self._points(x, y), axis=0)
        width, height = np.maximum(high - low, 0.6)
        self.box(low[0], low[1], width, height, style, title=title)

    def horizontal(self, y: float, style: str, words: str = '', *, at_left: bool = False) -> None:
        """Draw a level line with its name at one end."""
        py = float(self._to_y(np.array(y)))
        self.add('path', style, d=f'M{_LEFT} {py:.1f}H{self._right}')
        if words:
            self.text(_LEFT + 3 if at_left else self._right - 2, py - 4, words,
                      'start' if at_left else 'end')

    def vertical(self, x: float, style: str, words: str = '') -> None:
        """Draw an upright line with its name at the top."""
        px = float(self._to_x(np.array(x)))
        self.add('path', style, d=f'M{px:.1f} {_TOP}V{self._bottom}')
        if words:
            self.text(px + 4, _TOP + 9, words)

    def write(self, x: float, y: float, words: str, anchor: str = 'start') -> None:
        """Write words at a point of the axes."""
        (px, py), = self._points([x], [y])
        self.text(px, py, words, anchor)

    def _points(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Return (N, 2) places in the picture; NaN stays."""
        ys = np.clip(np.asarray(y, dtype=np.float64), *self._y)
        return np.column_stack([self._to_x(np.asarray(x, dtype=np.float64)), self._to_y(ys)])


def _labelled(values: FloatArray) -> list[tuple[float, str]]:
    return [(float(value), label(value)) for value in values]


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
        at = round(10 * float(px)), round(10 * float(py))
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
) -> Callable[[FloatArray], FloatArray]:
    low, high = (np.log10(interval) if log else np.asarray(interval))
    scale = (end - start) / (high - low if high > low else 1.0)

    def place(values: FloatArray) -> FloatArray:
        if log:
            values = np.log10(np.maximum(values, 1e-12))
        placed: FloatArray = start + (np.clip(values, low, high) - low) * scale
        return placed

    return place


def _envelope(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest point of each column, in their order."""
    edges = np.linspace(0, len(x), _COLUMNS + 1).astype(np.intp)
    keep: list[int] = []
    for first, last in itertools.pairwise(edges):
        part = y[first:last]
        if len(part) == 0 or np.isnan(part).all():
            keep.append(min(first, len(x) - 1))
            continue
        low, high = first + int(np.nanargmin(part)), first + int(np.nanargmax(part))
        keep += sorted({low, high})
    return x[keep], y[keep]
