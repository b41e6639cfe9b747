# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sensor b in the frame of a, with the region that holds it with 95 % probability."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from trajectory_calibration.assessment.observability import UNOBSERVED
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.report.data import ReportData
from trajectory_calibration.outputs.report.figures import drawing, path, ticks

_WIDTH, _HEIGHT, _MARGIN = 360, 240, 30
# Chi-square of two degrees of freedom that chance exceeds in one of twenty.
_LARGEST = 5.991
# An ellipse smaller than this is drawn larger, and said so.
_VISIBLE = 5.0


def sensor_view(data: ReportData, first: int, second: int) -> str:
    """Draw both sensors seen along the third axis of a; ``first`` points right, ``second`` up."""
    result, axes = data.result, [first, second]
    status = result.observability.status
    unknown = [status['xyz'[axis]] == UNOBSERVED for axis in axes]
    t = np.where(unknown, 0.0, result.T_a_b[:3, 3][axes])
    P = np.zeros((2, 2)) if result.covariance is None else result.covariance[np.ix_(axes, axes)]
    ellipse = _ellipse(P, unknown)
    span = (_HEIGHT - 2 * _MARGIN) / 2
    middle = 0.5 * t
    reach = _reach(data)
    pixels = span / reach

    def place(points: FloatArray) -> FloatArray:
        found: FloatArray = (np.atleast_2d(points) - middle) * [pixels, -pixels] + [
            _WIDTH / 2, _HEIGHT / 2]
        return found

    arm = 0.32 * span / pixels
    parts = [*_scale_bar(reach, pixels)]
    parts += _unknown_band(place(t)[0], unknown)
    size = float(np.abs(ellipse).max()) * pixels
    larger = 1
    while size * larger < _VISIBLE and larger < 1e4 and size > 0:
        larger *= 10
    drawn = place(t + larger * ellipse)
    if size > 0 and not all(unknown):
        parts.append(f'<path class="ellipse" d="{path(drawn[:, 0], drawn[:, 1])}Z"/>')
    line = place(np.array([[0.0, 0.0], t]))
    parts.append(f'<path class="lever" d="{path(line[:, 0], line[:, 1])}"/>')
    parts += _frame(place, np.zeros(2), np.eye(3)[axes], arm, 'a')
    parts += _frame(place, t, result.T_a_b[:3, :3][axes], 0.75 * arm, 'b',
                    lettered=float(np.linalg.norm(t)) > 1.5 * arm)
    if larger > 1 and size > 0:
        parts.append(f'<text class="note" x="{_WIDTH - 6}" y="14" text-anchor="end">'
                     f'ellipse drawn {larger} times as large</text>')
    names = f'{"xyz"[first]} to the right, {"xyz"[second]} up'
    parts.append(f'<text class="unit" x="2" y="12">{names}</text>')
    return drawing(_WIDTH, _HEIGHT, f'sensors in the frame of a, {names}', ''.join(parts))


def _reach(data: ReportData) -> float:
    """Return metres from the middle to the border, the same for all three views."""
    result = data.result
    known = np.array([result.observability.status[name] != UNOBSERVED for name in 'xyz'])
    size = np.abs(result.T_a_b[:3, 3]) / 2
    if result.covariance is not None:
        size = size + np.sqrt(_LARGEST * np.maximum(np.diagonal(result.covariance)[:3], 0.0))
    return 1.2 * max(float((size * known).max()), 0.03)


def _ellipse(P: FloatArray, unknown: list[bool]) -> FloatArray:
    """Return (N, 2) points of the 95 % region about zero; flat along what is unknown."""
    known = ~np.array(unknown)
    values, vectors = np.linalg.eigh(P * np.outer(known, known))
    angle = np.linspace(0, 2 * np.pi, 49)[:-1]
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    points: FloatArray = circle * np.sqrt(_LARGEST * np.maximum(values, 0.0)) @ vectors.T
    return points


def _unknown_band(at: FloatArray, unknown: list[bool]) -> list[str]:
    """Return a stripe along each axis on which the place of b is not known."""
    found = []
    if unknown[0]:
        found.append(f'<rect class="open" x="0" y="{at[1] - 7:.1f}" width="{_WIDTH}" '
                     'height="14"/>')
    if unknown[1]:
        found.append(f'<rect class="open" x="{at[0] - 7:.1f}" y="0" width="14" '
                     f'height="{_HEIGHT}"/>')
    if any(unknown):
        name = 'unknown along the stripe'
        found.append(f'<text class="note" x="{_WIDTH - 6}" y="28" text-anchor="end">{name}'
                     '</text>')
    return found


def _frame(
    place: Callable[[FloatArray], FloatArray], origin: FloatArray, axes: FloatArray,
    arm: float, sensor: str, *, lettered: bool = True,
) -> list[str]:
    """Return the three axes of a sensor; an axis towards the reader is a dot."""
    start = place(origin)[0]
    parts = []
    for k in range(3):
        end = place(origin + arm * axes[:, k])[0]
        if np.linalg.norm(end - start) > 4:
            parts.append(f'<path class="axis-{"xyz"[k]}" d="M{start[0]:.1f} {start[1]:.1f}'
                         f'L{end[0]:.1f} {end[1]:.1f}"/>')
            if not lettered:
                continue
            out = start + (end - start) * (1 + 9 / np.linalg.norm(end - start))
            parts.append(f'<text class="note mini" x="{out[0]:.1f}" y="{out[1] + 3:.1f}" '
                         f'text-anchor="middle">{"xyz"[k]}</text>')
    parts.append(f'<circle class="dot-{sensor}" cx="{start[0]:.1f}" cy="{start[1]:.1f}" r="4"/>')
    return parts


def _scale_bar(reach: float, pixels: float) -> list[str]:
    length = float(ticks(0.0, reach, 3)[1]) if len(ticks(0.0, reach, 3)) > 1 else reach
    x, y = 10, _HEIGHT - 10
    words = f'{length:g} m' if length >= 0.1 else f'{1e3 * length:g} mm'
    return [(f'<path class="axis" d="M{x} {y - 4}v4h{length * pixels:.1f}v-4"/>'
            f'<text class="note" x="{x + length * pixels + 6:.1f}" y="{y}">{words}</text>')]
