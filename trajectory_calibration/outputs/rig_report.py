# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""One self-contained HTML page that shows what a rig rests on."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

import numpy as np

from trajectory_calibration.assessment.observability import limits_of
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import counted
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.answer import CARE, FAILED, GOOD, INCOMPLETE, TITLES
from trajectory_calibration.outputs.report.drawings import evenly
from trajectory_calibration.outputs.report.figures import Canvas, limits, Plot, Scene
from trajectory_calibration.outputs.report.page import (
    figure,
    next_step,
    page,
    section,
    sentence,
    table,
    verdict_section,
)
from trajectory_calibration.outputs.report.record import Record, record_cards
from trajectory_calibration.outputs.report.sensors import Mounted, sensor_views
from trajectory_calibration.outputs.report.tracks import registration
from trajectory_calibration.outputs.report.view3d import HIGH, WIDE
from trajectory_calibration.outputs.rig_screen import (
    clock_text,
    loops_text,
    scale_text,
    sensor_rows,
)
from trajectory_calibration.rig.result import PairReport, RigResult
from trajectory_calibration.rig.windows import common_grid, Grid, track_of

_WIDTH, _HEIGHT = 360, 260

# Points of a track, and of a curve over time, that are drawn.
_POINTS = 500

# Probabilities of a chi-squared from which on a pair is marked.
_DOUBTFUL, _WRONG = 0.05, 1e-3

_NAVIGATION = ('The rig', 'Pairs', 'Noise', 'Tracks', 'Record')


def render_rig(
    rig: RigResult, trajectories: Mapping[str, Trajectory] | None = None,
    record: Record | None = None,
) -> str:
    """Return the page of a rig.

    ``trajectories``, by the names of the sensors, add the tracks carried into the base.
    """
    views = sensor_views([
        Mounted(name, rig.sensors[name].T_base_sensor, rig.sensors[name].covariance,
                rig.sensors[name].status, _colour(rig, name)) for name in rig.trees[rig.base]])
    title = f'Rig of {counted(len(rig.sensors), "sensor")}: calibration report'
    return page(title, ''.join((
        _box(rig),
        section(1, 'Where is each sensor?', _tree(rig) + views,
                'Every pose is in the frame of the base.',
                columns=2),
        section(2, 'Do the pairs agree?', _matrix(rig) + _misfits(rig),
                'Every pair was calibrated alone; here is its difference from the rig.'),
        section(3, 'How noisy is each sensor?', _noise(rig),
                'Found from the differences of pairs, which needs three sensors or more.',
                columns=2),
        section(4, 'Do the tracks coincide?', _tracks(rig, trajectories or {}),
                'All tracks carried into the base, in its clock and unit, laid on each other.'),
        section(5, 'Record', record_cards(
            record, rig.config.calibration, rig.findings, rig.version)))), navigation=_NAVIGATION)


def _colour(rig: RigResult, name: str) -> str:
    """Return a colour that reads on light and dark paper, one for each sensor."""
    names = list(rig.sensors)
    return f'hsl({(205 + 137 * names.index(name)) % 360} 65% 48%)'


def _box(rig: RigResult) -> str:
    weak = any('weak' in sensor.status.values() for sensor in rig.sensors.values())
    level = (FAILED if any(item.kind != 'clock' for item in rig.contradictions) else
             INCOMPLETE if rig.unobserved or rig.unplaced else
             CARE if weak or rig.p_value < _WRONG else GOOD)
    badge = 'A sensor contradicts the others' if level == FAILED else TITLES[level]
    rows = []
    for sensor in rig.sensors.values():
        if sensor.name != sensor.base:
            marked = (f'{row} {row.word}' if row.word in ('weak', 'prior') else str(row)
                      for row in sensor_rows(rig, sensor))
            # One table of several trees says in which frame a pose is.
            cells = (*(sensor.name, sensor.base)[:len(rig.trees)], *marked,
                     clock_text(sensor), scale_text(sensor))
            rows.append(tuple(cell.replace('+-', '±') for cell in cells))
    head = (*('sensor', 'in')[:len(rig.trees)], 'x, m', 'y, m', 'z, m', 'roll, deg',
            'pitch, deg', 'yaw, deg', 'clock offset, ms', 'scale')
    worst = next((found.text for found in rig.findings if found.level == 'serious'), '')
    return verdict_section(
        level, f'Rig of {counted(len(rig.sensors), "sensor")} in {escape(rig.base)}', badge,
        f'<p class="sentence">{escape(sentence(loops_text(rig)))}</p>{table(head, rows)}'
        f'{next_step(worst)}')


def _tree(rig: RigResult) -> str:
    """Draw which pairs hold the sensors together."""
    names = list(dict.fromkeys([*rig.sensors, *_ends(rig)]))
    angles = np.pi / 2 - 2 * np.pi * np.arange(len(names)) / len(names)
    radius = min(_WIDTH, _HEIGHT) / 2 - 44
    places = [_WIDTH / 2, _HEIGHT / 2] + radius * np.column_stack(
        [1.25 * np.cos(angles), -np.sin(angles)])
    at = dict(zip(names, places, strict=True))
    canvas = Canvas('pairs', _WIDTH, _HEIGHT)
    for pair in rig.pairs:
        style = ('far dashed' if pair.failure or not pair.used else
                 'far' if pair.p_value < _WRONG else 'near')
        canvas.path(np.stack([at[pair.parent], at[pair.child]]), style, title=_titled(pair))
    for name, (x, y) in at.items():
        fill = _colour(rig, name) if name in rig.sensors else 'var(--unknown)'
        note = (' (base)' if name in rig.trees else '' if name in rig.sensors else ' (no answer)')
        canvas.circle(x, y, 7, css=f'fill:{fill}')
        canvas.text(x, y - 11, f'{name}{note}', 'middle')
    used = sum(pair.used and not pair.failure for pair in rig.pairs)
    return figure('pairs', canvas,
                  f'{used} of {counted(len(rig.pairs), "pair")} are used in the answer.')


def _ends(rig: RigResult) -> list[str]:
    """Return the sensors of the pairs."""
    return list(dict.fromkeys(end for pair in rig.pairs for end in (pair.parent, pair.child)))


def _titled(pair: PairReport) -> str:
    return f'{pair.parent} - {pair.child}: {pair.words}'


def _matrix(rig: RigResult) -> str:
    """Draw chi-squared of each pair as a square of a matrix."""
    names = _ends(rig)
    left, top, size = 84, 24, min(44, 250 // len(names))
    canvas = Canvas('chi-squared of pairs', _WIDTH, top + size * len(names) + 6)
    for k, name in enumerate(names):
        middle = size * (k + 0.5)
        canvas.text(left - 6, top + middle + 4, name[-13:], 'end', '')
        canvas.text(left + middle, top - 6, name[:6], 'middle', '')
    for pair in rig.pairs:
        i, j = names.index(pair.parent), names.index(pair.child)
        known = pair.degrees > 0
        colour = ('line' if not known else
                  'okbg' if pair.p_value > _DOUBTFUL else
                  'weakbg' if pair.p_value > _WRONG else 'unknownbg')
        words = (f'{pair.chi_squared / pair.degrees:.1f}' if known else
                 'x' if pair.failure else '-')
        for row, column in ((i, j), (j, i)):
            x, y = left + size * column, top + size * row
            canvas.box(x, y, size - 2, size - 2, css=f'fill:var(--{colour})', title=_titled(pair))
            canvas.text(x + size / 2 - 1, y + size / 2 + 4, words, 'middle')
    checked = [pair.chi_squared / pair.degrees for pair in rig.pairs if pair.degrees]
    reading = (f'Largest: {max(checked):.1f}; x: no answer.' if checked else
               'No pair is checked by another one.')
    return figure('chi-squared', canvas, reading)


def _misfits(rig: RigResult) -> str:
    rows: list[tuple[str, ...]] = []
    for pair in rig.pairs:
        name = f'{pair.parent} - {pair.child}'
        if pair.failure:
            rows.append((name, pair.failure[:80], '', '', ''))
            continue
        # Components that the pair leaves unobserved agree with anything.
        known = pair.std < limits_of(rig.config.calibration)
        off, std = (np.linalg.norm(np.reshape(values * known, (2, 3)), axis=1)
                    for values in (pair.residual, pair.std))
        rows.append((name, f'{1e3 * off[0]:.1f} +- {1e3 * std[0]:.1f} mm' if std[0] else 'unknown',
                     f'{np.rad2deg(off[1]):.3f} +- {np.rad2deg(std[1]):.3f} deg'
                     if std[1] else 'unknown',
                     f'{pair.poses:,}', 'yes' if pair.used else 'no'))
    head = ('pair', 'difference +- deviation', 'rotation', 'poses', 'used')
    return f'<div class="card two">{table(head, rows, "numbers")}</div>'


def _noise(rig: RigResult) -> str:
    noises = {name: sensor.noise for name, sensor in rig.sensors.items()
              if sensor.noise is not None}
    if not noises:
        return '<p>The noise is not known: the rig was made of two sensors or of results.</p>'
    kinds = (('white_m', 1e3, 'White noise of positions', 'mm'),
             ('white_rad', 180 / np.pi, 'White noise of rotations', 'deg'),
             ('drift_m', 1e3, 'Drift of positions', 'mm after 1 m'),
             ('drift_rad', 180 / np.pi, 'Drift of rotations', 'deg after 1 m'))
    row, left, longest = 24, 98, 200
    figures = ''
    for field, factor, title, unit in kinds:
        values = {name: factor * getattr(noise, field) for name, noise in noises.items()}
        worst = max(values, key=values.__getitem__)
        canvas = Canvas(title, _WIDTH, 20 + row * len(values))
        for k, (name, value) in enumerate(values.items()):
            y, width = 14 + row * k, longest * value / max(values[worst], 1e-12)
            canvas.text(left - 6, y + 11, name[-14:], 'end', '')
            canvas.box(left, y, max(width, 1), 14, css=f'fill:{_colour(rig, name)}')
            canvas.text(left + width + 6, y + 11, f'{value:.2g}')
        figures += figure('noise', canvas, f'Largest: {worst}, {values[worst]:.2g} {unit}.',
                          noise=title, unit=unit)
    return figures


def _tracks(rig: RigResult, trajectories: Mapping[str, Trajectory]) -> str:
    names = [name for name in rig.trees[rig.base] if name in trajectories]
    if len(names) < 2:
        return '<p>The tracks were not given.</p>'
    grid = common_grid([
        track_of(trajectories[name], rig.sensors[name].clock, rig.sensors[name].scale,
                 rig.sensors[name].T_base_sensor) for name in names],
        round(1e9 * rig.config.calibration.max_gap))
    laid = _laid(grid)
    return _from_above(rig, names, laid) + _apart(names, laid, grid)


def _laid(grid: Grid) -> FloatArray:
    """Return (S, K, 3) positions of the base in the world of the first sensor; NaN: unknown."""
    found = np.full((*grid.known.shape, 3), np.nan)
    for s, (poses, known) in enumerate(zip(grid.poses, grid.known, strict=True)):
        both = grid.known[0] & known
        if np.count_nonzero(both) >= 3:
            Z = registration(grid.poses[0, both], poses[both])
            found[s, known] = (Z @ poses[known])[:, :3, 3]
    return found


def _from_above(rig: RigResult, names: list[str], laid: FloatArray) -> str:
    points = laid[:, evenly(laid.shape[1], _POINTS).astype(int)]
    known = laid.reshape(-1, 3)
    known = known[np.isfinite(known).all(axis=1)]
    axes = np.sort(np.argsort(-np.ptp(known, axis=0), kind='stable')[:2])
    scene = Scene.around(known[:, axes], 'tracks', WIDE, HIGH)
    keys: list[str] = []
    # The first on top, and thinnest.
    for k, name in reversed(list(enumerate(names))):
        colour = _colour(rig, name)
        scene.line(points[k][:, axes], css=f'stroke:{colour};stroke-width:{1.5 + 0.8 * k:.1f};'
                   'opacity:.7')
        keys.insert(0, f'<span><i class="key" style="background:{colour}"></i>'
                    f'{escape(name)}</span>')
    scene.scale_bar()
    return figure(
        'all tracks', scene, f'{len(names)} tracks, laid on that of {names[0]}.', wide=True,
        legend=f'<p class="legend">{"".join(keys)}</p>')


def _apart(names: list[str], laid: FloatArray, grid: Grid) -> str:
    seconds = (grid.stamps_ns - grid.stamps_ns[0]) * 1e-9
    at = evenly(len(seconds), _POINTS).astype(int)
    apart = np.linalg.norm(laid[1:] - laid[:1], axis=2)[:, at]
    figures = ''
    for name, distance in zip(names[1:], apart, strict=True):
        if not np.isfinite(distance).any():
            continue
        plot = Plot((0.0, seconds[-1]), (0.0, limits(distance, include=[0.0])[1]),
                    name=f'{name} from {names[0]}', x_label='s', y_label='m')
        plot.line(seconds[at], distance, 'line-b')
        figures += figure(
            'apart', plot,
            f'Median {np.nanmedian(distance):.3g} m, largest {np.nanmax(distance):.3g} m.',
            name=name, base=names[0])
    return figures
