# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The plots of the report, each drawn from ``ReportData``."""

from __future__ import annotations

import numpy as np

from trajectory_calibration.assessment.observability import DEGREES_OF_FREEDOM
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.report.clocks import Clocks
from trajectory_calibration.outputs.report.data import PathScale, ReportData
from trajectory_calibration.outputs.report.figures import label, limits, Plot, WIDTH

AXES = DEGREES_OF_FREEDOM
# A share of the range that the largest values may be cut off at.
_MOST = 0.995


def unit_of(k: int) -> str:
    """Return the unit of the k-th of the six numbers."""
    return 'm' if k < 3 else 'deg'


def distance_over_time(data: ReportData) -> Plot:
    """Draw the distance between the tracks, with jumps."""
    return _apart_over_time(data, data.tracks.distance_m, 'distance between the tracks', 'm')


def angle_over_time(data: ReportData) -> Plot:
    """Draw the difference of orientation between the tracks, with jumps."""
    return _apart_over_time(data, data.tracks.angle_deg, 'difference of orientation', 'deg')


def _apart_over_time(data: ReportData, apart: FloatArray, name: str, unit: str) -> Plot:
    seconds, jumps = data.tracks.seconds, data.tracks.largest_jumps()
    high = max(apart.max(), 1e-6) * 1.08
    plot = Plot((0.0, seconds[-1]), (0.0, high), name=name, x_label='time, s', y_label=unit)
    plot.line(seconds, apart, 'line-a')
    plot.dots(seconds[jumps], np.full(len(jumps), 0.97 * high), 'jump', 2.4)
    return plot


def distance_over_path(data: ReportData) -> Plot:
    """Draw the distance between the tracks against the distance driven."""
    path, apart = data.tracks.path_m, data.tracks.distance_m
    unit, name = (1e-3, 'km') if path[-1] > 3000 else (1.0, 'm')
    plot = Plot((0.0, max(path[-1] * unit, 1e-6)),
                (0.0, max(apart.max(), 1e-6) * 1.08), name='distance over the path',
                x_label=f'driven, {name}', y_label='m')
    plot.line(path * unit, apart, 'line-a')
    return plot


def rotation_by_axis(data: ReportData) -> Plot:
    """Draw the rotation of a motion about each axis, with what is needed."""
    found, need = np.array(data.result.observability.excitation_deg), data.need_deg
    values = found if need is None else np.append(found, need)
    low = 10.0 ** np.floor(np.log10(max(values[values > 0].min(initial=1.0) / 1.5, 1e-4)))
    high = max(values.max() * 1.7, 10 * low)
    plot = Plot((-0.6, 2.6), (low, high), name='rotation by axis', log_y=True,
                y_label='deg per motion, rms', x_ticks=[
                    (k, f'about {name}: {value:.3g}')
                    for k, (name, value) in enumerate(zip('xyz', found, strict=True))])
    for k, value in enumerate(found):
        style = 'fill-a' if need is None or value >= need else 'fill-weak'
        plot.rectangle((k - 0.28, k + 0.28), (low, max(value, low)), style, f'{value:.3g} deg')
    if need is not None and low < need < high:
        # At the end where the bar is lower.
        plot.horizontal(need, 'need', f'need {need:.2g}', at_left=bool(found[0] <= found[2]))
    return plot


def deviation_over_time(data: ReportData, *, rotation: bool) -> Plot:
    """Draw the standard deviations against driving time."""
    part = slice(3, 6) if rotation else slice(0, 3)
    values, limit = data.parts.growth_std[:, part], data.rows[part.start].weak_limit
    shown = values[np.isfinite(values) & (values > 0)]
    low = max(min(shown.min(initial=limit), limit) / 1.6, 1e-5)
    high = max(shown.max(initial=limit), limit) * 1.6
    plot = Plot((0.0, data.tracks.seconds[-1]), (low, high), log_y=True,
                name='standard deviation against driving time', x_label='driven, s',
                y_label=f'{unit_of(part.start)}, standard deviation')
    if low < limit < high:
        # At the end where the curves are not.
        plot.horizontal(limit, 'need', 'weak above', at_left=bool((values[-1:] > limit).any()))
    for axis, std in zip('xyz', values.T, strict=True):
        plot.line(data.parts.growth_s, std, f'line-{axis}')
    return plot


def part_plot(data: ReportData, k: int) -> Plot:
    """Draw what quarters and time scales say of one number, relative to the answer."""
    found, row = data.of_parts(k), data.rows[k]
    # One wild part must not flatten the others.
    reach = max(2.2 * found.own, 1e-3, *(np.abs(found.values) + 2 * found.std)[found.known])
    reach = min(reach, max(8 * found.own, 3 * row.weak_limit))
    # A free place parts the quarters from the time scales.
    places = [n + (n >= found.quarters) for n in range(len(found.names))]
    x = (-0.6, (places or [1])[-1] + 0.6)
    plot = Plot(x, (-reach, reach), height=150, name=f'{AXES[k]} from parts of the data',
                x_ticks=list(zip(places, found.names, strict=True)),
                x_label='quarters | time scales, s', y_label=f'{AXES[k]}, {unit_of(k)}')
    if found.unobserved:
        plot.write(sum(x) / 2, 0.0, 'not determined by the motion', 'middle')
        return plot
    plot.band(x, [-2 * found.own] * 2, [2 * found.own] * 2, 'band-answer')
    plot.horizontal(0.0, 'zero')
    for n, place in enumerate(places):
        if found.known[n]:
            plot.error_bar(place, found.values[n], found.std[n], 'far' if found.far[n] else 'near')
        else:
            plot.write(place, 0.0, '?', 'middle')
    return plot


def residual_over_time(data: ReportData, k: int) -> Plot:
    """Draw the residuals of one number with three standard deviations of the noise."""
    found = data.residuals
    values, sigma = found.values[:, k], found.sigma[:, k]
    size = np.quantile(np.abs(found.of_used()[0][:, k]), _MOST)
    reach = max(size * 1.15, 3.3 * np.median(sigma), 1e-9)
    plot = Plot((0.0, found.seconds[-1]), (-reach, reach), height=150,
                name=f'residual {AXES[k]} over time', x_label='time, s',
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
    plot = Plot((-5, 5), (0.0, min(peak, 2.0)), name='histogram of normalised residuals',
                x_label='residual / expected standard deviation', y_label='share')
    grid = np.linspace(-5, 5, 101)
    plot.band(grid, 0 * grid, np.exp(-grid**2 / 2) / np.sqrt(2 * np.pi), 'band-noise')
    for share, style in zip(shares, ('line-a', 'line-b'), strict=True):
        plot.line(np.repeat(edges, 2)[1:-1], np.repeat(share, 2), style)
    return plot


def box_by_scale(data: ReportData, kind: int) -> Plot:
    """Draw the size of the residuals against the length of the motions."""
    found = data.residuals
    if not len(found.scales_s):
        return Plot((0, 1), (0, 1), name='no time scale', x_ticks=[], y_ticks=[])
    values = found.by_scale[:, kind]
    shown = np.concatenate([values[values > 0], found.expected[:, kind]])
    low, high = max(shown.min() / 1.5, 1e-6), max(shown.max() * 1.5, 1e-5)
    names = [(k, label(value)) for k, value in enumerate(found.scales_s)]
    plot = Plot((-0.6, len(names) - 0.4), (low, high), log_y=True, x_ticks=names,
                name='size of the residuals by time scale', x_label='length of the motions, s',
                y_label='deg' if kind else 'm')
    plot.line(np.arange(len(names)), found.expected[:, kind], 'need')
    for k, (least, lower, middle, upper, most) in enumerate(np.maximum(values, low)):
        plot.line([k, k], [least, most], 'line-thin')
        plot.rectangle((k - 0.2, k + 0.2), (lower, upper), 'fill-b' if kind else 'fill-a')
        plot.line([k - 0.2, k + 0.2], [middle, middle], 'median')
    return plot


def rates(clocks: Clocks) -> Plot:
    """Draw the angular rates of both over each other."""
    _, high = limits(clocks.rate_a, clocks.rate_b, include=(0.0,))
    plot = Plot((clocks.seconds[0], clocks.seconds[-1]), (0.0, high),
                name='angular rates', x_label='time, s', y_label='deg/s')
    plot.line(clocks.seconds, clocks.rate_b, 'line-b wide')
    plot.line(clocks.seconds, clocks.rate_a, 'line-a')
    return plot


def offset_curve(clocks: Clocks) -> Plot:
    """Draw how well the rotations agree at other clock offsets."""
    low = max(-0.2, clocks.correlation.min() - 0.05)
    plot = Plot((clocks.offsets_s[0], clocks.offsets_s[-1]), (low, 1.03),
                name='agreement of the rotations by clock offset',
                x_label='further clock offset, s', y_label='correlation')
    plot.vertical(0.0, 'need', 'used')
    plot.line(clocks.offsets_s, clocks.correlation, 'line-a')
    return plot


def gap_strip(clocks: Clocks) -> Plot:
    """Draw when each sensor has poses."""
    plot = Plot((0.0, clocks.duration_s), (-0.5, 1.5), name='times with poses', height=110,
                x_label='time, s', y_ticks=[(1, 'a'), (0, 'b')])
    for row, spans, style in ((1, clocks.spans_a, 'fill-a'), (0, clocks.spans_b, 'fill-b')):
        for start, end in spans[:400]:
            # A single pose is seen, too.
            end_ = max(end, start + clocks.duration_s / WIDTH)
            plot.rectangle((start, end_), (row - 0.3, row + 0.3), style)
    return plot


def scale_over_path(scale: PathScale) -> Plot:
    """Draw the ratio of the lengths of both over the drive."""
    low, high = limits(scale.ratio - 2 * scale.std, scale.ratio + 2 * scale.std,
                       include=(0.999, 1.001))
    plot = Plot((0.0, scale.seconds[-1] * 1.07), (low, high), name='scale over the drive',
                x_label='time, s', y_label='scale of b, relative to the answer')
    plot.horizontal(1.0, 'zero')
    for x, y, std in zip(scale.seconds, scale.ratio, scale.std, strict=True):
        plot.error_bar(x, y, std, 'near')
    return plot


def evenly(count: int, most: int) -> FloatArray:
    """Return the indices of at most so many of ``count`` points, with the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.intp))
