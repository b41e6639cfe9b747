# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Small figures as inline SVG: axes, lines, bands, points and bars, coloured by style sheet.

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
_LEFT, _RIGHT, _TOP, _BOTTOM = 48, 10, 12, 34
# Points of a line that a screen can show: beyond, the least and the largest of each part.
_COLUMNS = 220
# A band is smooth.
_BAND_COLUMNS = 70
_TICKS = 5


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


class Plot:
    """One pair of axes; methods draw onto it, ``svg`` returns the picture."""

    def __init__(
        self, x: tuple[float, float], y: tuple[float, float], *, name: str, x_label: str = '',
        y_label: str = '', log_x: bool = False, log_y: bool = False, height: int = HEIGHT,
        x_ticks: Sequence[tuple[float, str]] | None = None,
        y_ticks: Sequence[tuple[float, str]] | None = None, left: int = _LEFT,
    ) -> None:
        self._x, self._y, self._name, self._height = x, y, name, height
        self._left, self._labels = left, (x_label, y_label)
        self._to_x = _axis(x, left, WIDTH - _RIGHT, log=log_x)
        self._to_y = _axis(y, height - _BOTTOM, _TOP, log=log_y)
        self._ticks_x = self._of_axis(x, x_ticks, log=log_x)
        self._ticks_y = self._of_axis(y, y_ticks, log=log_y)
        self._parts: list[str] = []

    @staticmethod
    def _of_axis(
        interval: tuple[float, float], given: Sequence[tuple[float, str]] | None, *, log: bool,
    ) -> list[tuple[float, str]]:
        if given is not None:
            return list(given)
        return [(value, label(value))
                for value in (log_ticks(*interval) if log else ticks(*interval))]

    def line(self, x: ArrayLike, y: ArrayLike, style: str, *, thin: bool = True) -> None:
        """Draw a line; NaN breaks it."""
        xs, ys = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        if thin and len(xs) > 2 * _COLUMNS:
            xs, ys = _envelope(xs, ys)
        self._parts.append(f'<path class="{style}" d="{self._path(xs, ys)}"/>')

    def band(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, style: str) -> None:
        """Fill between two lines."""
        xs, lows, highs = (np.asarray(v, dtype=np.float64) for v in (x, low, high))
        every = slice(None, None, max(1, len(xs) // _BAND_COLUMNS))
        xs, lows, highs = xs[every], lows[every], highs[every]
        around = self._path(np.concatenate([xs, xs[::-1]]), np.concatenate([highs, lows[::-1]]))
        self._parts.append(f'<path class="{style}" d="{around}Z"/>')

    def dots(self, x: ArrayLike, y: ArrayLike, style: str, radius: float = 2.6) -> None:
        """Draw a dot at each point."""
        self._parts += [
            f'<circle class="{style}" cx="{px:.1f}" cy="{py:.1f}" r="{radius}"/>'
            for px, py in self._points(x, y)]

    def error_bar(self, x: float, y: float, std: float, style: str) -> None:
        """Draw a point with two standard deviations on either side."""
        px = float(self._to_x(np.array(x)))
        low, high = (float(self._to_y(np.clip(y + side * 2 * std, *self._y)))
                     for side in (-1, 1))
        self._parts.append(
            f'<path class="{style} bar" d="M{px:.1f} {low:.1f}V{high:.1f}M{px - 3:.1f} '
            f'{low:.1f}h6M{px - 3:.1f} {high:.1f}h6"/>')
        if self._y[0] <= y <= self._y[1]:
            self.dots([x], [y], style, 3.2)

    def rectangle(
        self, x: tuple[float, float], y: tuple[float, float], style: str, title: str = '',
    ) -> None:
        """Fill a rectangle."""
        (x0, x1), (y1, y0) = (np.sort(to(np.array(v))) for to, v in (
            (self._to_x, x), (self._to_y, (y[1], y[0]))))
        y0, y1 = min(y0, y1), max(y0, y1)
        inside = f'<title>{escape(title)}</title>' if title else ''
        self._parts.append(
            f'<rect class="{style}" x="{x0:.1f}" y="{y0:.1f}" width="{max(x1 - x0, 0.6):.1f}" '
            f'height="{max(y1 - y0, 0.6):.1f}">{inside}</rect>')

    def horizontal(self, y: float, style: str, text: str = '', *, at_left: bool = False) -> None:
        """Draw a level line with its name at one end."""
        py = float(self._to_y(np.array(y)))
        self._parts.append(
            f'<path class="{style}" d="M{self._left} {py:.1f}H{WIDTH - _RIGHT}"/>')
        if text:
            if at_left:
                self.text(self._left + 3, py - 4, text)
            else:
                self.text(WIDTH - _RIGHT - 2, py - 4, text, 'end')

    def vertical(self, x: float, style: str, text: str = '') -> None:
        """Draw an upright line with its name at the top."""
        px = float(self._to_x(np.array(x)))
        self._parts.append(
            f'<path class="{style}" d="M{px:.1f} {_TOP}V{self._height - _BOTTOM}"/>')
        if text:
            self.text(px + 4, _TOP + 9, text)

    def text(self, px: float, py: float, words: str, anchor: str = 'start') -> None:
        """Write words at a place of the picture."""
        self._parts.append(
            f'<text class="note" x="{px:.1f}" y="{py:.1f}" text-anchor="{anchor}">'
            f'{escape(words)}</text>')

    def write(self, x: float, y: float, words: str, anchor: str = 'start') -> None:
        """Write words at a point of the axes."""
        (px, py), = self._points([x], [y])
        self.text(px, py, words, anchor)

    def svg(self) -> str:
        """Return the picture."""
        bottom, right = self._height - _BOTTOM, WIDTH - _RIGHT
        frame = []
        for value, words in self._ticks_y:
            py = float(self._to_y(np.array(value)))
            frame.append(f'<path class="grid" d="M{self._left} {py:.1f}H{right}"/>'
                         f'<text x="{self._left - 6}" y="{py + 4:.1f}" text-anchor="end">'
                         f'{escape(words)}</text>')
        for value, words in self._ticks_x:
            px = float(self._to_x(np.array(value)))
            frame.append(f'<text x="{px:.1f}" y="{bottom + 15}" text-anchor="middle">'
                         f'{escape(words)}</text>')
        x_label, y_label = self._labels
        frame.append(f'<path class="axis" d="M{self._left} {bottom}H{right}"/>')
        # Beside its axis, in a corner where no curve ends.
        frame.append(f'<text class="unit" x="{right}" y="{self._height - 3}" text-anchor="end">'
                     f'{escape(x_label)}</text>')
        frame.append(f'<text class="unit" x="2" y="9">{escape(y_label)}</text>')
        return _svg(WIDTH, self._height, self._name, ''.join(frame),
                    ''.join(self._parts))

    def _points(self, x: ArrayLike, y: ArrayLike) -> list[tuple[float, float]]:
        xs = self._to_x(np.asarray(x, dtype=np.float64))
        ys = self._to_y(np.clip(np.asarray(y, dtype=np.float64), *self._y))
        return [(float(px), float(py)) for px, py in zip(xs, ys, strict=True)
                if np.isfinite(px) and np.isfinite(py)]

    def _path(self, x: FloatArray, y: FloatArray) -> str:
        return path(self._to_x(x), self._to_y(np.clip(y, *self._y)))


def path(xs: FloatArray, ys: FloatArray, digits: int = 1) -> str:
    """Return the data of a path through (N,) points of the picture; NaN breaks it."""
    # Whole numbers of the last digit, so that rounding does not add up over the steps.
    scale = 10**digits
    words, before, pen = [], (0, 0), False
    for px, py in zip(xs, ys, strict=True):
        if not (np.isfinite(px) and np.isfinite(py)):
            pen = False
            continue
        at = round(scale * float(px)), round(scale * float(py))
        if pen:
            step = _digits(at[0] - before[0], scale), _digits(at[1] - before[1], scale)
            words.append('l' + step[0] + ('' if step[1].startswith('-') else ' ') + step[1])
        else:
            words.append(f'M{at[0] / scale:g} {at[1] / scale:g}')
        before, pen = at, True
    return ''.join(words) or 'M0 0'


def _digits(value: int, scale: int) -> str:
    """Return the shortest text of a fraction: '.5', '-12', '-.3'."""
    words = f'{value / scale:g}'
    return words.replace('0.', '.', 1) if abs(value) < scale else words


def _svg(
    width: int, height: int, name: str, frame: str, inside: str,
) -> str:
    return (f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{escape(name)}">'
            f'<g class="frame">{frame}</g><g>{inside}</g></svg>')


def drawing(width: int, height: int, name: str, inside: str) -> str:
    """Return a picture without axes."""
    return _svg(width, height, name, '', inside)


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
