# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The numbered sections of a report: figures with one sentence of what they say here."""

from __future__ import annotations

import numpy as np

from trajectory_calibration.assessment.observability import OBSERVED
from trajectory_calibration.errors import counted
from trajectory_calibration.outputs.report import drawings as draw
from trajectory_calibration.outputs.report.data import ReportData
from trajectory_calibration.outputs.report.sensors import Mounted, sensor_views
from trajectory_calibration.outputs.report.text import figure, legend, metres, section
from trajectory_calibration.outputs.report.view3d import MOST_JUMPS, track_view
from trajectory_calibration.outputs.screen import reference_words

NAVIGATION = ('Tracks', 'Motion', 'Parts', 'Residuals', 'Clock and scale', 'Record')

# Shares of normalised residuals beyond three deviations that a normal distribution has.
_NORMAL_TAIL = 0.0027
_AGREES = 2.0


def sections(data: ReportData) -> str:
    """Return sections 1 to 5."""
    return ''.join((
        _tracks(data), _motion(data), _parts(data), _residuals(data), _clocks(data)))


def _tracks(data: ReportData) -> str:
    tracks, result = data.tracks, data.result
    usual, largest = (float(np.quantile(tracks.distance_m, q)) for q in (0.5, 1.0))
    path = float(tracks.path_m[-1])
    share = f' ({100 * largest / path:.2g} % of {metres(path)} driven)' if path > 0 else ''
    a, b = result.frame_a, result.frame_b
    dots = 'jump' if len(tracks.jumps) <= MOST_JUMPS else f'jump, the largest {MOST_JUMPS}'
    key = legend(('a', f'a: {a}'), ('b', f'b carried over: {b}'), ('jump', dots), ('gap', 'gap'))
    jumps = counted(len(tracks.jumps), 'jump') if len(tracks.jumps) else 'no jumps'
    reading = (f'The tracks are {metres(usual)} apart in the median and {metres(largest)} at '
               f'most{share}; {jumps}.')
    angle = float(np.quantile(tracks.angle_deg, 0.5))
    figures = (
        figure('Both tracks', track_view(tracks), reading,
               'one line on top of the other, a distance that grows slowly as both drift',
               'another shape, a mirrored curve or another size: wrong pairing, frame or unit',
               wide=True, legend=key)
        + figure('Distance between a and b carried over', draw.distance_over_time(data),
                 f'Median {metres(usual)}, largest {metres(largest)}.',
                 'small, smooth, growing slowly with the distance',
                 'steps (jumps) or a wave in step with each turn (wrong lever arm)')
        + figure('Distance over the path', draw.distance_over_path(data),
                 f'Driven: {data.driven}.',
                 'growing slowly: ordinary drift', 'at once, where one SLAM lost its way')
        + figure('Difference of orientation', draw.angle_over_time(data),
                 f'Median {angle:.2g} deg, largest {float(tracks.angle_deg.max()):.2g} deg.',
                 'below a degree or two without steps',
                 'a constant level or a wave with the heading: wrong rotation'))
    return section(1, 'Do the two tracks coincide?', figures,
                   'b is carried over to a with the extrinsic and laid on the track of a as a '
                   'whole. Drag to turn, wheel to zoom.')


def _motion(data: ReportData) -> str:
    result = data.result
    observability = result.observability
    found = np.array(observability.excitation_deg)
    need = data.need_deg
    if need is None:
        reading = 'Without a covariance, the needed rotation is not known.'
    else:
        enough = int(np.sum(found >= need))
        reading = (f'Axes with the needed {need:.2g} deg: {enough} of 3; at least 2 are needed, '
                   'because a rotation says nothing about the translation along its own axis.')
    key = legend(('x', 'x'), ('y', 'y'), ('z', 'z'))
    growth = data.parts.growth_std
    flat = ''
    if len(growth) >= 4 and not np.isnan(growth[-1]).all():
        half = growth[len(growth) // 2]
        gain = float(np.nanmedian(half / np.maximum(growth[-1], 1e-300)))
        flat = (f'The second half of the drive made the deviations {gain:.2g} times smaller '
                '(1.4 is usual for more of the same motion).')
    figures = (
        figure('Rotation by axis of a', draw.rotation_by_axis(data), reading,
               'two or three bars above the line', 'one bar only: a flat floor')
        + figure('Translation against driving time',
                 draw.deviation_over_time(data, rotation=False),
                 flat or 'The drive is too short for this figure.',
                 'falling below the dashed line, then flat', 'above the line at the end',
                 legend=key)
        + figure('Rotation against driving time', draw.deviation_over_time(data, rotation=True),
                 'A step down marks a manoeuvre that helped; a flat curve says that more of the '
                 'same does not.',
                 'falling below the dashed line, then flat', 'above the line at the end',
                 legend=key)
        + sensor_views([
            Mounted(result.frame_a, np.eye(4), np.zeros((6, 6)),
                    dict.fromkeys(observability.status, OBSERVED), 'var(--a)'),
            Mounted(result.frame_b, result.T_a_b,
                    np.zeros((6, 6)) if result.covariance is None else result.covariance,
                    observability.status, 'var(--b)')]))
    return section(2, 'Was the motion enough?', figures)


def _parts(data: ReportData) -> str:
    parts = data.parts
    if not len(parts.scales_s):
        return section(3, 'Do parts of the data agree?',
                       '<div class="card"><p>The drive is too short to be divided.</p></div>')
    figures = ''.join(
        figure(draw.AXES[k].capitalize() if k >= 3 else f'Translation {draw.AXES[k]}',
               draw.part_plot(data, k), _agreement(data, k),
               'error bars cross the band', 'parts that miss the band by more than their bars')
        for k in range(6))
    return section(
        3, 'Do parts of the data agree?', figures,
        'The extrinsic again from each quarter of the drive (Q1 to Q4) and from motions of one '
        'length in time, minus the answer, with bars of 2 standard deviations; the band is 2 '
        'standard deviations of the answer. "?": this part alone does not determine it.')


def _agreement(data: ReportData, k: int) -> str:
    found = data.of_parts(k)
    if found.is_open:
        return 'Not determined by the motion.'
    if not found.known.any():
        return 'No part alone determines it.'
    if not found.far.any():
        return f'All {int(found.known.sum())} parts that determine it agree.'
    names = (name if name.startswith('Q') else f'{name} s'
             for name in np.array(found.names)[found.far])
    return f'Disagree: {", ".join(names)}.'


def _residuals(data: ReportData) -> str:
    found, result = data.residuals, data.result
    used = ~found.excluded
    z = found.values[used] / np.maximum(found.sigma[used], 1e-300) if used.any() \
        else found.values / np.maximum(found.sigma, 1e-300)
    figures = ''
    for k in range(6):
        beyond = float(np.mean(np.abs(z[:, k]) > 3))
        rms = float(np.sqrt(np.mean(found.values[used][:, k] ** 2))) if used.any() else 0.0
        figures += figure(
            f'Residual {draw.AXES[k]}', draw.residual_over_time(data, k),
            f'Root mean square {rms:.2g} {draw.unit_of(k)}; {100 * beyond:.2g} % beyond 3 '
            'standard deviations.',
            'a level stripe inside the band', 'waves, steps or a slope')
    tail = float(np.mean(np.abs(z) > 3))
    scale = float(np.sqrt(np.mean(np.minimum(z**2, 25))))
    figures += figure(
        'Histogram', draw.histogram(data),
        f'Root mean square {scale:.2g} (1 expected); {100 * tail:.2g} % beyond 3 '
        f'({100 * _NORMAL_TAIL:.1g} % expected).',
        'curves that follow the bell', 'narrow with long tails: outliers; wide: noise is more '
        'than identified', legend=legend(('a', 'translation'), ('b', 'rotation'),
                                         ('noise', 'normal distribution')))
    for kind, title in enumerate(('Translation by time scale', 'Rotation by time scale')):
        figures += figure(
            title, draw.box_by_scale(data, kind), _growth(data, kind),
            'boxes on the dashed line (the identified noise)',
            'boxes far above it on long scales: drift or jumps that the noise does not explain')
    lag = result.reference or result.config.reference
    lead = (f'Motions {reference_words(lag)}: mean {result.metrics.e_rt:.3g} m, '
            f'{float(np.rad2deg(result.metrics.e_rR)):.3g} deg per motion. This is the fit, '
            'not the accuracy of the extrinsic.')
    return section(4, 'Residuals', figures, lead)


def _growth(data: ReportData, kind: int) -> str:
    found = data.residuals
    if not len(found.scales_s):
        return 'The drive is too short for this figure.'
    median = found.by_scale[:, kind, 2]
    unit = 'deg' if kind else 'm'
    return (f'Median {median[0]:.2g} {unit} over {found.scales_s[0]:g} s, {median[-1]:.2g} {unit} '
            f'over {found.scales_s[-1]:g} s.')


def _clocks(data: ReportData) -> str:
    clocks, result = data.clocks, data.result
    key = legend(('a', f'a: {result.frame_a}'), ('b', f'b: {result.frame_b}'))
    applied = f'{result.time_offset_s:+.4f} s was added to the stamps of b'
    if result.clock_drift:
        applied += f', and a drift of {1e6 * result.clock_drift:+.1f} ppm'
    figures = figure(
        'Angular rates', draw.rates(clocks), f'The {clocks.seconds[-1] - clocks.seconds[0]:.0f} s '
        f'with the most rotation; {applied}.',
        'the curves rise and fall together', 'one runs ahead of the other, or has another shape',
        legend=key)
    if len(clocks.offsets_s):
        best = int(np.argmax(clocks.correlation))
        off = float(clocks.offsets_s[best])
        where = 'at the offset used' if abs(off) <= 1.5 * float(
            clocks.offsets_s[1] - clocks.offsets_s[0]) else f'{off:+.3f} s from it'
        figures += figure(
            'Agreement by clock offset', draw.offset_curve(clocks),
            f'Highest correlation {float(clocks.correlation[best]):.3f}, {where}.',
            'one sharp peak at 0', 'several peaks, a flat top or a peak elsewhere')
    gaps = len(clocks.spans_a) + len(clocks.spans_b) - 2
    figures += figure(
        'Times with poses', draw.gap_strip(clocks),
        f'{counted(gaps, "gap")}; {result.poses:,} pose pairs of {result.association.poses_a:,} '
        f'poses of a and {result.association.poses_b:,} of b.',
        'two full bars of equal length', 'bars that overlap little, or are full of holes')
    if len(data.scale.seconds):
        spread = float(np.ptp(data.scale.ratio))
        figures += figure(
            'Scale over the drive', draw.scale_over_path(data.scale),
            f'Scale of b {result.scale:.6g}; it varies by {100 * spread:.2g} % over the drive.',
            'level within the error bars', 'a slope or steps: scale drift of a monocular SLAM')
    return section(5, 'Clock and scale', figures, columns=2)
