# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The numbered sections of a report: figures with one sentence of what they say here."""

from __future__ import annotations

import numpy as np

from trajectory_calibration.assessment.observability import OBSERVED
from trajectory_calibration.errors import counted
from trajectory_calibration.outputs.report import drawings as draw
from trajectory_calibration.outputs.report.data import ReportData
from trajectory_calibration.outputs.report.page import figure, metres, section
from trajectory_calibration.outputs.report.parts import Parts
from trajectory_calibration.outputs.report.sensors import Mounted, sensor_views
from trajectory_calibration.outputs.report.tracks import MOST_JUMPS
from trajectory_calibration.outputs.report.view3d import track_view
from trajectory_calibration.outputs.screen import reference_words

NAVIGATION = ('Tracks', 'Motion', 'Parts', 'Residuals', 'Clock and scale', 'Record')

PARTS = ('Translation', 'Rotation')

# Share of normalised residuals beyond three deviations that a normal distribution has.
_NORMAL_TAIL = 0.0027


def sections(data: ReportData) -> str:
    """Return sections 1 to 5."""
    return ''.join((_tracks(data), _motion(data), _parts(data), _residuals(data), _clocks(data)))


def _tracks(data: ReportData) -> str:
    tracks, result = data.tracks, data.result
    usual, largest = metres(np.median(tracks.distance_m)), metres(tracks.distance_m.max())
    path = tracks.path_m[-1]
    share = (f' ({100 * tracks.distance_m.max() / path:.2g} % of {metres(path)} driven)'
             if path > 0 else '')
    key = [('a', f'a: {result.frame_a}'), ('b', f'b carried over: {result.frame_b}')]
    if len(tracks.jumps):
        key.append(('jump', 'jump' if len(tracks.jumps) <= MOST_JUMPS else
                    f'jump, the largest {MOST_JUMPS}'))
    if len(tracks.gaps):
        key.append(('gap', 'gap'))
    jumps = counted(len(tracks.jumps), 'jump') if len(tracks.jumps) else 'no jumps'
    figures = (
        figure('tracks', track_view(tracks), f'The tracks are {usual} apart in the median and '
               f'{largest} at most{share}; {jumps}.', wide=True, legend=key)
        + figure('distance', draw.apart_over_time(data),
                 f'Median {usual}, largest {largest}. Driven: {data.driven}.')
        + figure('orientation', draw.apart_over_time(data, rotation=True),
                 f'Median {np.median(tracks.angle_deg):.2g} deg, largest '
                 f'{tracks.angle_deg.max():.2g} deg.'))
    return section(1, 'Do the two tracks coincide?', figures,
                   'b is carried over to a with the extrinsic and laid on the track of a as a '
                   'whole. Drag to turn, wheel to zoom.', columns=2)


def _motion(data: ReportData) -> str:
    result, need = data.result, data.need_deg
    status = result.observability.status
    reading = 'Without a covariance, the needed rotation is not known.'
    if need is not None:
        enough = sum(value >= need for value in result.observability.excitation_deg)
        reading = (f'Axes with the needed {need:.2g} deg: {enough} of 3; at least 2 are needed, '
                   'because a rotation says nothing about the translation along its own axis.')
    growth = data.parts.growth_std
    gain = 'The drive is too short for this figure.'
    if len(growth) >= 4 and not np.isnan(growth[-1]).all():
        ratio = np.nanmedian(growth[len(growth) // 2] / np.maximum(growth[-1], 1e-300))
        gain = (f'The second half of the drive made the deviations {ratio:.2g} times smaller '
                '(1.4 is usual for more of the same motion).')
    none = np.zeros((6, 6))
    P = none if result.covariance is None else result.covariance
    figures = figure('motion', draw.rotation_by_axis(data), reading)
    step = ('A step down marks a manoeuvre that helped; a flat curve says that more of the same '
            'does not.')
    for rotation, words in enumerate((gain, step)):
        figures += figure(
            'growth', draw.deviation_over_time(data, rotation=bool(rotation)), words,
            legend=list(zip('xyz', 'xyz', strict=True)), part=PARTS[rotation])
    return section(2, 'Was the motion enough?', figures + sensor_views([
        Mounted(result.frame_a, np.eye(4), none, dict.fromkeys(status, OBSERVED), 'var(--a)'),
        Mounted(result.frame_b, result.T_a_b, P, status, 'var(--b)')]))


def _parts(data: ReportData) -> str:
    if not data.parts.names:
        return section(3, 'Do parts of the data agree?',
                       '<div class="card"><p>The drive is too short to be divided.</p></div>')
    figures = ''.join(
        figure('part', draw.part_plot(data, k), _agreement(data.parts, k),
               number=name.capitalize() if k >= 3 else f'Translation {name}')
        for k, name in enumerate(draw.AXES))
    return section(
        3, 'Do parts of the data agree?', figures,
        'The extrinsic again from each quarter of the drive (Q1 to Q4) and from motions of one '
        'length in time, minus the answer, with bars of 2 standard deviations; the band is 2 '
        'standard deviations of the answer. "?": this part alone does not determine it.')


def _agreement(parts: Parts, k: int) -> str:
    if parts.unobserved[k]:
        return 'Not determined by the motion.'
    if not parts.known[:, k].any():
        return 'No part alone determines it.'
    far = [name if name.startswith('Q') else f'{name} s'
           for name in np.array(parts.names)[parts.far[:, k]]]
    return (f'Disagree: {", ".join(far)}.' if far else
            f'All {parts.known[:, k].sum()} parts that determine it agree.')


def _residuals(data: ReportData) -> str:
    found, result = data.residuals, data.result
    values, z = found.of_used()
    figures = ''
    for k, name in enumerate(draw.AXES):
        rms = np.sqrt(np.mean(values[:, k] ** 2))
        figures += figure(
            'residual', draw.residual_over_time(data, k),
            f'Root mean square {rms:.2g} {draw.unit_of(k)}; '
            f'{100 * np.mean(np.abs(z[:, k]) > 3):.2g} % beyond 3 standard deviations.',
            number=name)
    figures += figure(
        'histogram', draw.histogram(data),
        f'Root mean square {np.sqrt(np.mean(np.minimum(z**2, 25))):.2g} (1 expected); '
        f'{100 * np.mean(np.abs(z) > 3):.2g} % beyond 3 ({100 * _NORMAL_TAIL:.1g} % expected).',
        legend=[('a', 'translation'), ('b', 'rotation'), ('noise', 'normal distribution')])
    for kind, part in enumerate(PARTS if len(found.scales_s) else ()):
        reading = ', '.join(
            f'{found.by_scale[end, kind, 2]:.2g} {draw.unit_of(3 * kind)} over '
            f'{found.scales_s[end]:g} s' for end in (0, -1))
        figures += figure('residual by scale', draw.box_by_scale(data, kind),
                          f'Median {reading}.', part=part)
    return section(
        4, 'Residuals', figures,
        f'Motions {reference_words(result.reference or result.config.reference)}: mean '
        f'{result.metrics.e_rt:.3g} m, {np.rad2deg(result.metrics.e_rR):.3g} deg per motion. '
        'This is the fit, not the accuracy of the extrinsic.')


def _clocks(data: ReportData) -> str:
    clocks, result, scale = data.clocks, data.result, data.scale
    applied = f'{result.time_offset_s:+.4f} s was added to the stamps of b'
    if result.clock_drift:
        applied += f', and a drift of {1e6 * result.clock_drift:+.1f} ppm'
    figures = figure(
        'rates', draw.rates(clocks), f'The {clocks.seconds[-1] - clocks.seconds[0]:.0f} s '
        f'with the most rotation; {applied}.',
        legend=[('a', f'a: {result.frame_a}'), ('b', f'b: {result.frame_b}')])
    if len(clocks.offsets_s):
        best = int(np.argmax(clocks.correlation))
        off, cell = clocks.offsets_s[best], clocks.offsets_s[1] - clocks.offsets_s[0]
        where = 'at the offset used' if abs(off) <= 1.5 * cell else f'{off:+.3f} s from it'
        figures += figure('offset', draw.offset_curve(clocks),
                          f'Highest correlation {clocks.correlation[best]:.3f}, {where}.')
    gaps = len(clocks.spans_a) + len(clocks.spans_b) - 2
    figures += figure(
        'times', draw.gap_strip(clocks),
        f'{counted(gaps, "gap")}; {result.poses:,} pose pairs of {result.association.poses_a:,} '
        f'poses of a and {result.association.poses_b:,} of b.')
    if len(scale) > 1:
        figures += figure(
            'scale', draw.scale_over_path(scale), f'Scale of b {result.scale:.6g}; it varies by '
            f'{100 * np.ptp(scale[:, 1]):.2g} % over the drive.')
    return section(5, 'Clock and scale', figures, columns=2)
