# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The plots of the report, each drawn from ``ReportData``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.assessment.observability import DEGREES_OF_FREEDOM
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.report.clocks import Clocks
from trajectory_calibration.outputs.report.data import ReportData
from trajectory_calibration.outputs.report.figures import label, limits, Plot, ticks, WIDTH
from trajectory_calibration.outputs.report.page import metres
from trajectory_calibration.outputs.report.parts import QUARTERS

AXES = DEGREES_OF_FREEDOM
# A share of the range that the largest values may be cut off at.
_MOST = 0.995


def unit_of(k: int) -> str:
    """Return the unit of the k-th of the six numbers."""
    return 'm' if k < 3 else 'deg'


def from_zero(*arrays: FloatArray) -> tuple[float, float]:
    """Return the limits of an axis that begins at zero."""
    return 0.0, limits(*arrays, [0.0, 1e-6])[1]


def apart_over_time(data: ReportData, *, rotation: bool = False) -> Plot:
    """Draw the distance between the tracks, or of their orientation, over time and path."""
    tracks = data.tracks
    apart = tracks.angle_deg if rotation else tracks.distance_m
    seconds, jumps = tracks.seconds, tracks.largest_jumps()
    driven = [(at, f'{label(at)} s\n{metres(np.interp(at, seconds, tracks.path_m))}')
              for at in ticks(0.0, seconds[-1], 4)]
    plot = Plot((0.0, seconds[-1]), from_zero(apart), y_label=unit_of(3 * rotation),
                x_ticks=driven)
    plot.line(seconds, apart, 'line-a')
    plot.dots(seconds[jumps], np.full(len(jumps), 0.97 * plot.y[1]), 'jump', 2.4)
    return plot


def rotation_by_axis(data: ReportData) -> Plot:
    """Draw the rotation of a motion about each axis, with what is needed."""
    found, need = data.result.observability.excitation_deg, data.need_deg
    low, high = limits(found, [] if need is None else need, log=True)
    # The words of the need stand beside the bars.
    plot = Plot((-1.1, 2.5), (0.5 * low, high), log_y=True, y_label='deg per motion, rms',
                x_ticks=[(k, f'{name}: {value:.3g}')
                         for k, (name, value) in enumerate(zip('xyz', found, strict=True))])
    for k, value in enumerate(found):
        style = 'fill-a' if need is None or value >= need else 'fill-weak'
        plot.rectangle((k - 0.28, k + 0.28), (0.5 * low, value), style, f'{value:.3g} deg')
    if need is not None:
        plot.horizontal(need, 'need', f'need {need:.2g}', at_left=True)
    return plot


def deviation_over_time(data: ReportData, *, rotation: bool) -> Plot:
    """Draw the standard deviations against driving time."""
    part = slice(3, 6) if rotation else slice(0, 3)
    values, limit = data.parts.growth_std[:, part], data.rows[part.start].weak_limit
    plot = Plot((0.0, data.tracks.seconds[-1]), limits(values, limit, log=True), log_y=True,
                x_label='driven, s', y_label=f'{unit_of(part.start)}, standard deviation')
    # At the end where the curves are not.
    plot.horizontal(limit, 'need', 'weak above', at_left=bool((values[-1:] > limit).any()))
    for axis, std in zip('xyz', values.T, strict=True):
        plot.line(data.parts.growth_s, std, f'line-{axis}')
    return plot


def part_plot(data: ReportData, k: int) -> Plot:
    """Draw what quarters and time scales say of one number, relative to the answer."""
    parts, row = data.parts, data.rows[k]
    values, std, known, own = parts.values[:, k], parts.std[:, k], parts.known[:, k], parts.own[k]
    # One wild part must not flatten the others.
    reach = max(2.2 * own, 1e-3, *(np.abs(values) + 2 * std)[known])
    reach = min(reach, max(8 * own, 3 * row.weak_limit))
    # A free place parts the quarters from the time scales.
    places = np.arange(len(values)) + (np.arange(len(values)) >= QUARTERS)
    x = (-0.6, max(places, default=1) + 0.6)
    plot = Plot(x, (-reach, reach), height=150,
                x_ticks=list(zip(places, parts.names, strict=True)),
                x_label='quarters | time scales, s',
                y_label=f'{AXES[k]}, {unit_of(k)}')
    if parts.unobserved[k]:
        plot.write(sum(x) / 2, 0.0, 'not determined by the motion', 'middle')
        return plot
    plot.band(x, [-2 * own] * 2, [2 * own] * 2, 'band-answer')
    plot.horizontal(0.0, 'zero')
    for n, place in enumerate(places):
        if known[n]:
            plot.error_bar(place, values[n], std[n], 'far' if parts.far[n, k] else 'near')
        else:
            plot.write(place, 0.0, '?', 'middle')
    return plot


def residual_over_time(data: ReportData, k: int) -> Plot:
    """Draw the residuals of one number with three standard deviations of the noise."""
    found = data.residuals
    values, sigma = found.values[:, k], found.sigma[:, k]
    size = np.quantile(np.abs(found.of_used()[0][:, k]), _MOST)
    reach = max(size * 1.15, 3.3 * np.median(sigma), 1e-9)
    plot = Plot((0.0, found.seconds[-1]), (-reach, reach), height=150, x_label='time, s',
                y_label=f'{AXES[k]}, {unit_of(k)}')
    plot.band(found.seconds, -3 * sigma, 3 * sigma, 'band-noise')
    plot.line(found.seconds, np.where(found.excluded, np.nan, values), 'line-thin')
    out = np.flatnonzero(found.excluded)
    out = out[::max(1, len(out) // 60)]
    plot.dots(found.seconds[out], values[out], 'jump', 1.8)
    return plot


def histogram(data: ReportData) -> Plot:
    """Draw the residuals over their likely size, beside a normal distribution."""
    z = np.clip(data.residuals.of_used()[1], -5, 5)
    shares = [np.histogram(part, 40, (-5, 5), density=True)[0] for part in (z[:, :3], z[:, 3:])]
    edges = np.linspace(-5, 5, 41)
    peak = max(0.45, 1.1 * np.max(shares))
    plot = Plot((-5, 5), (0.0, min(peak, 2.0)),
                x_label='residual / expected standard deviation', y_label='share')
    grid = np.linspace(-5, 5, 101)
    plot.band(grid, 0 * grid, np.exp(-grid**2 / 2) / np.sqrt(2 * np.pi), 'band-noise')
    for share, style in zip(shares, ('line-a', 'line-b'), strict=True):
        plot.line(np.repeat(edges, 2)[1:-1], np.repeat(share, 2), style)
    return plot


def box_by_scale(data: ReportData, kind: int) -> Plot:
    """Draw the size of the residuals against the length of the motions."""
    found = data.residuals
    values, expected = found.by_scale[:, kind], found.expected[:, kind]
    names = [(k, label(value)) for k, value in enumerate(found.scales_s)]
    plot = Plot((-0.6, len(names) - 0.4), limits(values, expected, log=True), log_y=True,
                x_ticks=names,
                x_label='length of the motions, s', y_label=unit_of(3 * kind))
    plot.line(np.arange(len(names)), expected, 'need')
    for k, (least, lower, middle, upper, most) in enumerate(values):
        plot.line([k, k], [least, most], 'zero')
        plot.rectangle((k - 0.2, k + 0.2), (lower, upper), 'fill-b' if kind else 'fill-a')
        plot.line([k - 0.2, k + 0.2], [middle, middle], 'median')
    return plot


def rates(clocks: Clocks) -> Plot:
    """Draw the angular rates of both over each other."""
    plot = Plot((clocks.seconds[0], clocks.seconds[-1]), from_zero(clocks.rate_a, clocks.rate_b),
                x_label='time, s', y_label='deg/s')
    plot.line(clocks.seconds, clocks.rate_b, 'line-b wide')
    plot.line(clocks.seconds, clocks.rate_a, 'line-a')
    return plot


def offset_curve(clocks: Clocks) -> Plot:
    """Draw how well the rotations agree at other clock offsets."""
    low = max(-0.2, clocks.correlation.min() - 0.05)
    plot = Plot((clocks.offsets_s[0], clocks.offsets_s[-1]), (low, 1.03),
                x_label='further clock offset, s', y_label='correlation')
    plot.vertical(0.0, 'need', 'used')
    plot.line(clocks.offsets_s, clocks.correlation, 'line-a')
    return plot


def gap_strip(clocks: Clocks) -> Plot:
    """Draw when each sensor has poses."""
    plot = Plot((0.0, clocks.duration_s), (-0.5, 1.5), height=110, x_label='time, s',
                y_ticks=[(1, 'a'), (0, 'b')])
    for row, spans, style in ((1, clocks.spans_a, 'fill-a'), (0, clocks.spans_b, 'fill-b')):
        for start, end in spans[:400]:
            # A single pose is seen, too.
            end_ = max(end, start + clocks.duration_s / WIDTH)
            plot.rectangle((start, end_), (row - 0.3, row + 0.3), style)
    return plot


def scale_over_path(scale: FloatArray) -> Plot:
    """Draw the ratio of the lengths of both over the drive."""
    seconds, ratio, std = scale.T
    plot = Plot((0.0, seconds[-1] * 1.07),
                limits(ratio - 2 * std, ratio + 2 * std, [0.999, 1.001]),
                x_label='time, s', y_label='scale of b, relative to the answer')
    plot.horizontal(1.0, 'zero')
    for middle, value, deviation in scale:
        plot.error_bar(middle, value, deviation, 'near')
    return plot


def evenly(count: int, most: int) -> NDArray[np.intp]:
    """Return the indices of at most so many of ``count`` points, with the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.intp))
