# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The figures of a report in numbered sections, each with an interpretation."""

from __future__ import annotations

import numpy as np

from trajectory_calibration.assessment.observability import DEGREES_OF_FREEDOM, OBSERVED
from trajectory_calibration.errors import counted
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.answer import unit_of
from trajectory_calibration.outputs.report.clocks import Clocks
from trajectory_calibration.outputs.report.data import ReportData
from trajectory_calibration.outputs.report.figures import (
    from_zero,
    label,
    limits,
    Plot,
    ticks,
    WIDTH,
)
from trajectory_calibration.outputs.report.page import Figure, metres, section
from trajectory_calibration.outputs.report.parts import Parts, QUARTERS
from trajectory_calibration.outputs.report.sensors import Mounted, sensor_views
from trajectory_calibration.outputs.report.tracks import MOST_JUMPS, Tracks
from trajectory_calibration.outputs.report.view3d import track_view
from trajectory_calibration.outputs.screen import reference_text

NAVIGATION = ('Tracks', 'Motion', 'Parts', 'Residuals', 'Clock and scale', 'Record')

_PARTS = ('Translation', 'Rotation')
# Share of a normal distribution beyond three standard deviations.
_NORMAL_TAIL = 0.0027
# Quantile of the residuals that the axis shows; larger ones may be cut off.
_MOST = 0.995


def sections(data: ReportData) -> str:
    """Return sections 1 to 5."""
    result = data.result
    motions = reference_text(result.reference or result.config.reference)
    return ''.join((
        section(1, 'Do the two tracks coincide?', track_figures(data),
                'The track of b is transformed to a with the extrinsic, and aligned to that of a '
                'as a whole. Drag to turn, wheel to zoom.', columns=2),
        section(2, 'Was the motion enough?', motion_figures(data)),
        section(3, 'Do parts of the data agree?', part_figures(data) or [
            '<div class="card"><p>The drive is too short to be divided.</p></div>'],
            'The extrinsic from each quarter of the drive (Q1 to Q4), and from motions of one '
            'duration, minus the answer, with bars of 2 standard deviations; the band '
            'is 2 standard deviations of the answer. "?": this part alone does not determine it.'),
        section(4, 'Residuals', residual_figures(data),
                f'Motions {motions}: mean {result.metrics.e_rt:.3g} m, '
                f'{np.rad2deg(result.metrics.e_rR):.3g} deg per motion. This is the fit, not the '
                'accuracy of the extrinsic.'),
        section(5, 'Clock and scale', clock_figures(data), columns=2)))


def track_figures(data: ReportData) -> list[Figure]:
    """Return both tracks, and their distance and rotation over time and path, with jumps."""
    tracks, result = data.tracks, data.result
    median, largest = metres(np.median(tracks.distance_m)), metres(tracks.distance_m.max())
    path = tracks.path_m[-1]
    share = (f' ({100 * tracks.distance_m.max() / path:.2g} % of {metres(path)} driven)'
             if path > 0 else '')
    key = [('a', f'a: {result.frame_a}'), ('b', f'b transformed: {result.frame_b}')]
    if len(tracks.jumps):
        key.append(('jump', 'jump' if len(tracks.jumps) <= MOST_JUMPS else
                    f'jump, the largest {MOST_JUMPS}'))
    if len(tracks.gaps):
        key.append(('gap', 'gap'))
    jumps = counted(len(tracks.jumps), 'jump') if len(tracks.jumps) else 'no jumps'
    return [
        Figure('tracks', track_view(tracks), f'Distance of the tracks: median {median}, largest '
               f'{largest}{share}; {jumps}.', key, wide=True),
        Figure('distance', _over_time(tracks, tracks.distance_m, 'm'),
               f'Median {median}, largest {largest}. Driven: {data.driven}.'),
        Figure('orientation', _over_time(tracks, tracks.angle_deg, 'deg'),
               f'Median {np.median(tracks.angle_deg):.2g} deg, largest '
               f'{tracks.angle_deg.max():.2g} deg.')]


def _over_time(tracks: Tracks, values: FloatArray, unit: str) -> Plot:
    seconds, jumps = tracks.seconds, tracks.largest_jumps
    driven = [(at, f'{label(at)} s\n{metres(np.interp(at, seconds, tracks.path_m))}')
              for at in ticks(0.0, seconds[-1], 4)]
    plot = Plot((0.0, seconds[-1]), from_zero(values), y_label=unit, x_ticks=driven)
    plot.line(seconds, values, 'line-a')
    plot.dots(seconds[jumps], np.full(len(jumps), 0.97 * plot.y[1]), 'jump', 2.4)
    return plot


def motion_figures(data: ReportData) -> list[Figure]:
    """Return rotation by axis, standard deviations over time, and views of the sensors."""
    result, need, growth = data.result, data.need_deg, data.parts.growth_std
    rotation, status = result.observability.excitation_deg, result.observability.status
    low, high = limits(rotation, [] if need is None else need, log=True)
    # The label of the needed rotation is beside the bars.
    plot = Plot((-1.1, 2.5), (0.5 * low, high), log_y=True, y_label='deg per motion, rms',
                x_ticks=[(k, f'{name}: {value:.3g}')
                         for k, (name, value) in enumerate(zip('xyz', rotation, strict=True))])
    for k, value in enumerate(rotation):
        style = 'fill-a' if need is None or value >= need else 'fill-weak'
        plot.rectangle((k - 0.28, k + 0.28), (0.5 * low, value), style, f'{value:.3g} deg')
    reading = 'Without a covariance, the needed rotation is not known.'
    if need is not None:
        plot.horizontal(need, 'need', f'need {need:.2g}', at_left=True)
        enough = sum(value >= need for value in rotation)
        reading = (f'Axes with the needed {need:.2g} deg: {enough} of 3; at least 2 are needed, '
                   'because a rotation does not determine the translation along its axis.')
    figures = [Figure('motion', plot, reading)]
    gain = 'The drive is too short for this figure.'
    if len(growth) >= 4 and not np.isnan(growth[-1]).all():
        ratio = np.nanmedian(growth[len(growth) // 2] / np.maximum(growth[-1], 1e-300))
        gain = ('The second half of the drive made the standard deviations '
                f'{ratio:.2g} times smaller (1.4 is usual for more of the same motion).')
    step = ('A step down marks a manoeuvre that helped; where the curve is flat, more of the same '
            'motion does not help.')
    for k, part, reading in zip((0, 3), _PARTS, (gain, step), strict=True):
        values, limit = growth[:, k:k + 3], data.rows[k].weak_limit
        plot = Plot((0.0, data.tracks.seconds[-1]), limits(values, limit, log=True), log_y=True,
                    x_label='driven, s', y_label=f'{unit_of(k)}, standard deviation')
        # The label is at the end that the curves do not reach.
        plot.horizontal(limit, 'need', 'weak above', at_left=bool((values[-1:] > limit).any()))
        for axis, std in zip('xyz', values.T, strict=True):
            plot.line(data.parts.growth_s, std, f'line-{axis}')
        figures.append(Figure('growth', plot, reading, [(axis, axis) for axis in 'xyz'],
                              names={'part': part}))
    none = np.zeros((6, 6))
    P = none if result.covariance is None else result.covariance
    return figures + sensor_views([
        Mounted(result.frame_a, np.eye(4), none, dict.fromkeys(status, OBSERVED), 'var(--a)'),
        Mounted(result.frame_b, result.T_a_b, P, status, 'var(--b)')])


def part_figures(data: ReportData) -> list[Figure]:
    """Return each component from quarters and time scales, relative to the answer."""
    return [Figure('part', _part_plot(data, k), _agreement(data.parts, k),
                   names={'number': name.capitalize() if k >= 3 else f'Translation {name}'})
            for k, name in enumerate(DEGREES_OF_FREEDOM) if data.parts.names]


def _part_plot(data: ReportData, k: int) -> Plot:
    parts = data.parts
    values, std, known, own = parts.values[:, k], parts.std[:, k], parts.known[:, k], parts.own[k]
    # A single outlier must not compress the axis.
    reach = max(2.2 * own, 1e-3, *(np.abs(values) + 2 * std)[known])
    reach = min(reach, max(8 * own, 3 * data.rows[k].weak_limit))
    # An empty place is between the quarters and the time scales.
    places = np.arange(len(values)) + (np.arange(len(values)) >= QUARTERS)
    x = (-0.6, places[-1] + 0.6)
    plot = Plot(x, (-reach, reach), height=150,
                x_ticks=list(zip(places, parts.names, strict=True)),
                x_label='quarters | time scales, s',
                y_label=f'{DEGREES_OF_FREEDOM[k]}, {unit_of(k)}')
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


def _agreement(parts: Parts, k: int) -> str:
    if parts.unobserved[k]:
        return 'Not determined by the motion.'
    if not parts.known[:, k].any():
        return 'No part alone determines it.'
    far = [name if name.startswith('Q') else f'{name} s'
           for name in np.array(parts.names)[parts.far[:, k]]]
    return (f'Disagree: {", ".join(far)}.' if far else
            f'All {parts.known[:, k].sum()} parts that determine it agree.')


def residual_figures(data: ReportData) -> list[Figure]:
    """Return the residuals over time, their distribution, and their size by time scale."""
    found = data.residuals
    used, z = found.of_used()
    figures = []
    out = np.flatnonzero(found.excluded)
    out = out[::max(1, len(out) // 60)]
    for k, name in enumerate(DEGREES_OF_FREEDOM):
        values, sigma, unit = found.values[:, k], found.sigma[:, k], unit_of(k)
        size = np.quantile(np.abs(used[:, k]), _MOST)
        reach = max(size * 1.15, 3.3 * np.median(sigma), 1e-9)
        plot = Plot((0.0, found.seconds[-1]), (-reach, reach), height=150, x_label='time, s',
                    y_label=f'{name}, {unit}')
        plot.band(found.seconds, -3 * sigma, 3 * sigma, 'band-noise')
        plot.line(found.seconds, np.where(found.excluded, np.nan, values), 'line-thin')
        plot.dots(found.seconds[out], values[out], 'jump', 1.8)
        figures.append(Figure(
            'residual', plot, f'Root mean square {np.sqrt(np.mean(used[:, k] ** 2)):.2g} {unit}; '
            f'{100 * np.mean(np.abs(z[:, k]) > 3):.2g} % beyond 3 standard deviations.',
            names={'number': name}))
    edges, grid, clipped = np.linspace(-5, 5, 41), np.linspace(-5, 5, 101), np.clip(z, -5, 5)
    shares = [np.histogram(part, edges, density=True)[0]
              for part in (clipped[:, :3], clipped[:, 3:])]
    plot = Plot((-5, 5), (0.0, min(max(0.45, 1.1 * np.max(shares)), 2.0)),
                x_label='residual / expected standard deviation', y_label='share')
    plot.band(grid, 0 * grid, np.exp(-grid**2 / 2) / np.sqrt(2 * np.pi), 'band-noise')
    for share, style in zip(shares, 'ab', strict=True):
        plot.line(np.repeat(edges, 2)[1:-1], np.repeat(share, 2), f'line-{style}')
    figures.append(Figure(
        'histogram', plot,
        f'Root mean square {np.sqrt(np.mean(np.minimum(z**2, 25))):.2g} (1 expected); '
        f'{100 * np.mean(np.abs(z) > 3):.2g} % beyond 3 ({100 * _NORMAL_TAIL:.1g} % expected).',
        [('a', 'translation'), ('b', 'rotation'), ('noise', 'normal distribution')]))
    names = [(k, label(value)) for k, value in enumerate(found.scales_s)]
    for kind, part in enumerate(_PARTS if names else ()):
        sizes, expected, unit = (
            found.by_scale[:, kind], found.expected[:, kind], unit_of(3 * kind))
        plot = Plot((-0.6, len(names) - 0.4), limits(sizes, expected, log=True), log_y=True,
                    x_ticks=names, x_label='duration of the motions, s', y_label=unit)
        plot.line(np.arange(len(names)), expected, 'need')
        for k, (least, lower, middle, upper, most) in enumerate(sizes):
            plot.line([k, k], [least, most], 'zero')
            plot.rectangle((k - 0.2, k + 0.2), (lower, upper), f'fill-{"ab"[kind]}')
            plot.line([k - 0.2, k + 0.2], [middle, middle], 'median')
        reading = ', '.join(f'{sizes[end, 2]:.2g} {unit} over {found.scales_s[end]:g} s'
                            for end in (0, -1))
        figures.append(Figure('residual by scale', plot, f'Median {reading}.',
                              names={'part': part}))
    return figures


def clock_figures(data: ReportData) -> list[Figure]:
    """Return angular rates, correlation by clock offset, gaps, and scale over the drive."""
    clocks, result, scale = data.clocks, data.result, data.scale
    applied = f'{result.time_offset_s:+.4f} s was added to the stamps of b'
    if result.clock_drift:
        applied += f', and a drift of {1e6 * result.clock_drift:+.1f} ppm'
    figures = [Figure(
        'rates', rates(clocks), f'The {clocks.seconds[-1] - clocks.seconds[0]:.0f} s '
        f'with the most rotation; {applied}.',
        [('a', f'a: {result.frame_a}'), ('b', f'b: {result.frame_b}')])]
    if len(clocks.offsets_s):
        best = int(np.argmax(clocks.correlation))
        off, cell = clocks.offsets_s[best], clocks.offsets_s[1] - clocks.offsets_s[0]
        where = 'at the offset used' if abs(off) <= 1.5 * cell else f'{off:+.3f} s from it'
        plot = Plot((clocks.offsets_s[0], clocks.offsets_s[-1]),
                    (max(-0.2, clocks.correlation.min() - 0.05), 1.03),
                    x_label='further clock offset, s', y_label='correlation')
        plot.vertical(0.0, 'need', 'used')
        plot.line(clocks.offsets_s, clocks.correlation, 'line-a')
        figures.append(Figure(
            'offset', plot, f'Highest correlation {clocks.correlation[best]:.3f}, {where}.'))
    gaps = sum(len(spans) - 1 for spans in clocks.spans)
    figures.append(Figure(
        'times', gap_strip(clocks),
        f'{counted(gaps, "gap")}; {result.poses:,} pose pairs of {result.association.poses_a:,} '
        f'poses of a and {result.association.poses_b:,} of b.'))
    if len(scale) > 1:
        middles, ratio, std = scale.T
        plot = Plot((0.0, middles[-1] * 1.07),
                    limits(ratio - 2 * std, ratio + 2 * std, [0.999, 1.001]),
                    x_label='time, s', y_label='scale of b, relative to the answer')
        plot.horizontal(1.0, 'zero')
        for middle, value, value_std in scale:
            plot.error_bar(middle, value, value_std, 'near')
        figures.append(Figure('scale', plot, f'Scale of b {result.scale:.6g}; it varies by '
                              f'{100 * np.ptp(ratio):.2g} % over the drive.'))
    return figures


def rates(clocks: Clocks) -> Plot:
    """Plot the angular rates of both sensors."""
    plot = Plot((clocks.seconds[0], clocks.seconds[-1]), from_zero(clocks.rates),
                x_label='time, s', y_label='deg/s')
    for rate, style in zip(clocks.rates[::-1], ('line-b wide', 'line-a'), strict=True):
        plot.line(clocks.seconds, rate, style)
    return plot


def gap_strip(clocks: Clocks) -> Plot:
    """Plot the times with poses of each sensor."""
    plot = Plot((0.0, clocks.duration_s), (-0.5, 1.5), height=110, x_label='time, s',
                y_ticks=[(1, 'a'), (0, 'b')])
    for row, spans, style in zip((1, 0), clocks.spans, ('fill-a', 'fill-b'), strict=True):
        for start, end in spans[:400]:
            # A single pose is visible, too.
            end_ = max(end, start + clocks.duration_s / WIDTH)
            plot.rectangle((start, end_), (row - 0.3, row + 0.3), style)
    return plot
