# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The report of a rig: one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

import numpy as np

from trajectory_calibration.assessment.observability import limits_of
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import counted
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.chi_squared import FALSE_ALARM
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.answer import CARE, FAILED, GOOD, INCOMPLETE, sizes, TITLES
from trajectory_calibration.outputs.report.figures import evenly, from_zero, Plot, Scene
from trajectory_calibration.outputs.report.page import (
    Figure,
    next_step,
    page,
    section,
    sentence,
    table,
    verdict_section,
)
from trajectory_calibration.outputs.report.record import Record, record_cards
from trajectory_calibration.outputs.report.sensors import Mounted, sensor_views
from trajectory_calibration.outputs.report.view3d import HIGH, WIDE
from trajectory_calibration.outputs.rig_screen import (
    clock_text,
    loops_text,
    noise_texts,
    scale_text,
    sensor_rows,
)
from trajectory_calibration.rig.result import RigResult
from trajectory_calibration.rig.windows import base_track, common_grid, Grid

# Points of a track, and of a curve over time, that are drawn.
_POINTS = 500

_NAVIGATION = ('The rig', 'Pairs', 'Noise', 'Tracks', 'Record')


def render_rig(
    rig: RigResult, trajectories: Mapping[str, Trajectory] | None = None,
    record: Record | None = None,
) -> str:
    """Return the report of a rig; ``trajectories``, by sensor, add the tracks in the base."""
    views = sensor_views([
        Mounted(name, rig.sensors[name].T_base_sensor, rig.sensors[name].covariance,
                rig.sensors[name].status, _colour(rig, name)) for name in rig.trees[rig.base]])
    title = f'Rig of {counted(len(rig.sensors), "sensor")}'
    return page(f'{title}: calibration report', ''.join((
        _box(rig, title),
        section(1, 'Where is each sensor?', views, 'Every pose is in the frame of the base.'),
        section(2, 'Do the pairs agree?', [_misfits(rig)],
                'Every pair was calibrated alone; the table has its residual from the rig.'),
        section(3, 'How noisy is each sensor?', [_noise(rig)],
                'Estimated from the differences of pairs, which needs three sensors or more.'),
        section(4, 'Do the tracks coincide?', _tracks(rig, trajectories or {}),
                'All tracks as poses of the base, in its clock and unit, aligned as a whole.'),
        section(5, 'Record', record_cards(
            record, rig.config.calibration, rig.findings, rig.version)))), navigation=_NAVIGATION)


def _colour(rig: RigResult, name: str) -> str:
    """Return the colour of a sensor, legible on light and dark backgrounds."""
    return f'hsl({(205 + 137 * list(rig.sensors).index(name)) % 360} 65% 48%)'


def _box(rig: RigResult, title: str) -> str:
    weak = any('weak' in sensor.status.values() for sensor in rig.sensors.values())
    level = (FAILED if any(item.kind != 'clock' for item in rig.contradictions) else
             INCOMPLETE if rig.unobserved or rig.unplaced else
             CARE if weak or rig.p_value < FALSE_ALARM else GOOD)
    badge = 'A sensor contradicts the others' if level == FAILED else TITLES[level]
    rows: list[tuple[str, ...]] = []
    for sensor in rig.sensors.values():
        if sensor.name != sensor.base:
            marked = (f'{row} {row.word}' if row.word in ('weak', 'prior') else str(row)
                      for row in sensor_rows(rig, sensor))
            # With several trees the table needs the frame of each pose.
            rows.append((*(sensor.name, sensor.base)[:len(rig.trees)], *marked,
                         clock_text(sensor), scale_text(sensor)))
    rows += [(f'{name} (no answer)',) for name in rig.unplaced if name not in rig.sensors]
    head = (*('sensor', 'in')[:len(rig.trees)], 'x, m', 'y, m', 'z, m', 'roll, deg',
            'pitch, deg', 'yaw, deg', 'clock offset, ms', 'scale')
    worst = next((found.text for found in rig.findings if found.level == 'serious'), '')
    return verdict_section(
        level, f'{title} in {escape(rig.base)}', badge,
        f'<p class="sentence">{escape(sentence(loops_text(rig)))}</p>{table(head, rows)}'
        f'{next_step(worst)}')


def _misfits(rig: RigResult) -> Figure:
    """Return a table of the residuals of the pairs."""
    rows: list[tuple[str, ...]] = []
    for pair in rig.pairs:
        name = f'{pair.parent} - {pair.child}'
        if pair.failure:
            rows.append((name, '', pair.failure[:80], '', '', 'no'))
            continue
        # Components that are unobservable by the pair are left out.
        known = pair.std < limits_of(rig.config.calibration)
        (t, R), (s_t, s_R) = sizes(pair.residual * known), sizes(pair.std * known)
        rows.append((
            name, f'{pair.chi_squared / pair.degrees:.1f}' if pair.degrees else '–',
            f'{1e3 * t:.1f} +- {1e3 * s_t:.1f} mm' if s_t else 'unknown',
            f'{R:.3f} +- {s_R:.3f} deg' if s_R else 'unknown',
            f'{pair.poses:,}', 'yes' if pair.used else 'no'))
    wrong = [f'{pair.parent} - {pair.child}' for pair in rig.pairs if pair.p_value < FALSE_ALARM]
    used = sum(pair.used and not pair.failure for pair in rig.pairs)
    return Figure(
        'chi-squared', table(('pair', 'chi-squared', 'translation +- std', 'rotation +- std',
                              'poses', 'used'), rows, 'numbers'),
        f'{used} of {counted(len(rig.pairs), "pair")} are used in the answer'
        + (f'; contradictions: {", ".join(wrong)}.' if wrong else '.'), wide=True)


def _noise(rig: RigResult) -> Figure | str:
    rows = [(name, *noise_texts(sensor)) for name, sensor in rig.sensors.items()]
    if not any(sensor.noise for sensor in rig.sensors.values()):
        return '<p>The noise is not known: the rig was made of two sensors or of results.</p>'
    return Figure(
        'noise', table(('sensor', 'positions, mm', 'rotations, deg',
                        'drift of positions, mm after 1 m', 'drift of rotations, deg after 1 m'),
                       rows, 'numbers'), 'One standard deviation along or about each axis.',
        wide=True)


def _tracks(rig: RigResult, trajectories: Mapping[str, Trajectory]) -> list[Figure | str]:
    names = [name for name in rig.trees[rig.base] if name in trajectories]
    if len(names) < 2:
        return ['<p>The tracks were not given.</p>']
    grid = common_grid([
        base_track(trajectories[name], rig.sensors[name].clock, rig.sensors[name].scale,
                   rig.sensors[name].T_base_sensor) for name in names],
        round(1e9 * rig.config.calibration.max_gap))
    aligned = _aligned(grid)
    return [_from_above(rig, names, aligned), *_distances(names, aligned, grid)]


def _aligned(grid: Grid) -> FloatArray:
    """Return (S, K, 3) positions of the base in the world of the first sensor; NaN: unknown."""
    found = np.full((*grid.known.shape, 3), np.nan)
    for s, (poses, known) in enumerate(zip(grid.poses, grid.known, strict=True)):
        both = grid.known[0] & known
        if np.count_nonzero(both) >= 3:
            Z = se3.registration(grid.poses[0, both], poses[both])
            found[s, known] = (Z @ poses[known])[:, :3, 3]
    return found


def _from_above(rig: RigResult, names: list[str], aligned: FloatArray) -> Figure:
    points = aligned[:, evenly(aligned.shape[1], _POINTS)]
    known = aligned.reshape(-1, 3)
    known = known[np.isfinite(known).all(axis=1)]
    axes = np.sort(np.argsort(-np.ptp(known, axis=0), kind='stable')[:2])
    scene = Scene.around(known[:, axes], WIDE, HIGH)
    # The first on top, and thinnest.
    for k, name in reversed(list(enumerate(names))):
        scene.line(points[k][:, axes], css=f'stroke:{_colour(rig, name)};stroke-width:'
                   f'{1.5 + 0.8 * k:.1f};opacity:.7')
    scene.scale_bar()
    return Figure(
        'all tracks', scene, f'{len(names)} tracks, aligned to that of {names[0]}.',
        [(_colour(rig, name), name) for name in names], wide=True)


def _distances(names: list[str], aligned: FloatArray, grid: Grid) -> list[Figure]:
    at = evenly(len(grid.stamps_ns), _POINTS)
    seconds = (grid.stamps_ns[at] - grid.stamps_ns[0]) * 1e-9
    distances = np.linalg.norm(aligned[1:, at] - aligned[:1, at], axis=2)
    figures = []
    for name, distance in zip(names[1:], distances, strict=True):
        if not np.isfinite(distance).any():
            continue
        plot = Plot((0.0, seconds[-1]), from_zero(distance), x_label='s', y_label='m')
        plot.line(seconds, distance, 'line-b')
        figures.append(Figure(
            'apart', plot,
            f'Median {np.nanmedian(distance):.3g} m, largest {np.nanmax(distance):.3g} m.',
            names={'name': name, 'base': names[0]}))
    return figures
