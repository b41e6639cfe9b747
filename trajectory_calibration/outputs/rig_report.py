# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""One self-contained HTML page that shows what a rig rests on."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

import numpy as np

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.report.drawings import evenly
from trajectory_calibration.outputs.report.figures import drawing, limits, path, Plot, ticks
from trajectory_calibration.outputs.report.page import page
from trajectory_calibration.outputs.report.record import Record, record_cards, versions
from trajectory_calibration.outputs.report.render import finding_list
from trajectory_calibration.outputs.report.text import figure, section, table
from trajectory_calibration.outputs.rig_screen import sensor_rows
from trajectory_calibration.rig.result import PairReport, RigResult
from trajectory_calibration.rig.windows import common_grid, Grid, Track

_WIDTH, _HEIGHT, _MARGIN = 360, 260, 34

# Points of a track, and of a curve over time, that are drawn.
_POINTS = 500

# Probabilities of a chi-squared from which on a pair is marked.
_DOUBTFUL, _WRONG = 0.05, 1e-3

# Square root of the chi-squared of two degrees of freedom that chance exceeds once in 20.
_ELLIPSE = 2.448

_MAX_GAP_NS = 500_000_000

_NAVIGATION = ('The rig', 'Pairs', 'Noise', 'Tracks', 'Record')


def render_rig(
    rig: RigResult, trajectories: Mapping[str, Trajectory] | None = None,
    record: Record | None = None,
) -> str:
    """Return the page of a rig.

    ``trajectories``, by the names of the sensors, add the tracks carried into the base.
    """
    views = ''.join(_view(rig, *axes) for axes in ((0, 1), (0, 2), (1, 2)))
    parts = [
        _box(rig),
        section(1, 'Where is each sensor?', _tree(rig) + views,
                'Every pose is in the frame of the base; ellipses hold a sensor with 95 %.'),
        section(2, 'Do the pairs agree?', _matrix(rig) + _misfits(rig),
                'Every pair was calibrated alone; here is how far it is from the rig.'),
        section(3, 'How noisy is each sensor?', _noise(rig),
                'From what pairs of sensors differ by; three sensors or more tell whose it is.'),
        section(4, 'Do the tracks coincide?', _tracks(rig, trajectories or {}),
                'All tracks carried into the base, in its clock and unit, laid on each other.'),
        section(5, 'Record', record_cards(
            record or Record(), rig.config.calibration, finding_list(rig.findings),
            rig.version)),
    ]
    return page(f'Rig of {len(rig.sensors)} sensors: calibration report', ''.join(parts),
                navigation=_NAVIGATION, made_by=versions())


def _colour(rig: RigResult, name: str) -> str:
    """Return a colour that reads on light and dark paper, one for each sensor."""
    names = list(rig.sensors)
    return f'hsl({(205 + 137 * names.index(name)) % 360} 65% 48%)'


def _box(rig: RigResult) -> str:
    doubted = [item for item in rig.contradictions if item.kind != 'clock']
    style, badge = (
        ('failed', 'A sensor contradicts the others') if doubted else
        ('open', 'Part of it is unknown') if rig.unobserved else
        ('care', 'Usable with care') if any(
            'weak' in sensor.status.values() for sensor in rig.sensors.values()) or
        rig.p_value < 1e-3 else ('good', 'Usable'))
    loops = (f'The loops close with chi-squared {rig.chi_squared:.1f} of {rig.degrees} degrees '
             f'of freedom (p = {rig.p_value:.2g}).' if rig.degrees else
             'No loop checks the answer.')
    rows = []
    for sensor in rig.sensors.values():
        if sensor.name == sensor.base:
            continue
        cells = [sensor.name, sensor.base]
        for row in sensor_rows(rig, sensor):
            mark = f' {row.word}' if row.word in ('weak', 'prior') else ''
            cells.append(f'{row}{mark}'.replace('+-', '±'))
        cells += [f'{1e3 * sensor.clock.offset_s:+.1f} ± {1e3 * sensor.clock.offset_std_s:.1f}',
                  '1' if sensor.scale == 1 else f'{sensor.scale:.4f} ± {sensor.scale_std:.4f}']
        rows.append(tuple(cells))
    head = ('sensor', 'in', 'x, m', 'y, m', 'z, m', 'roll, deg', 'pitch, deg', 'yaw, deg',
            'clock, ms', 'scale')
    worst = next((found.text for found in rig.findings if found.level == 'serious'), '')
    step = f'<p class="next"><b>Next</b>{escape(worst)}</p>' if worst else ''
    return (f'<section class="verdict {style}"><div class="head">'
            f'<h1>Rig of {len(rig.sensors)} sensors in {escape(rig.base)}</h1>'
            f'<p class="badge">{badge}</p></div><p class="sentence">{escape(loops)}</p>'
            f'{table(head, rows)}{step}</section>')


def _view(rig: RigResult, first: int, second: int) -> str:
    """Draw the sensors along two axes of the base, with their ellipses."""
    sensors = [rig.sensors[name] for name in rig.trees[rig.base]]
    at = np.stack([sensor.T_base_sensor[:3, 3][[first, second]] for sensor in sensors])
    # With their ellipses, but for those of what is unknown.
    reach = _ELLIPSE * np.array([
        [0.0 if sensor.status.get('xyz'[axis]) == 'unobserved' else
         float(np.sqrt(max(sensor.covariance[axis, axis], 0.0))) for axis in (first, second)]
        for sensor in sensors])
    low, high = (at - reach).min(axis=0), (at + reach).max(axis=0)
    middle = 0.5 * (low + high)
    room = np.array([_WIDTH - 2 * _MARGIN, _HEIGHT - 2 * _MARGIN])
    pixels = float(np.min(room / np.maximum(high - low, 0.1)))

    def place(points: FloatArray) -> FloatArray:
        found: FloatArray = (np.atleast_2d(points) - middle) * [pixels, -pixels] + [
            _WIDTH / 2, _HEIGHT / 2]
        return found

    parts = []
    circle = np.linspace(0, 2 * np.pi, 49)
    round_ = np.column_stack([np.cos(circle), np.sin(circle)])
    for sensor, where in zip(sensors, at, strict=True):
        colour = _colour(rig, sensor.name)
        origin = place(where)[0]
        open_ = [axis for axis in (first, second)
                 if sensor.status['xyz'[axis]] == 'unobserved']
        if sensor.name != sensor.base and not open_:
            P = sensor.covariance[np.ix_([first, second], [first, second])]
            values, vectors = np.linalg.eigh(P)
            points = place(where + _ELLIPSE * round_ @ (
                vectors * np.sqrt(np.maximum(values, 0))).T)
            parts.append(f'<path class="ellipse" style="stroke:{colour}" '
                         f'd="{path(points[:, 0], points[:, 1])}Z"/>')
        arm = 18 / pixels
        for k in range(3):
            end = place(where + arm * sensor.T_base_sensor[[first, second], k])[0]
            parts.append(f'<path class="axis-{"xyz"[k]}" d="M{origin[0]:.1f} {origin[1]:.1f}'
                         f'L{end[0]:.1f} {end[1]:.1f}"/>')
        words = f'{sensor.name} ({", ".join("xyz"[k] for k in open_)} unknown)' if open_ else (
            sensor.name)
        anchor = 'end' if origin[0] > 0.7 * _WIDTH else 'start'
        parts.append(
            f'<circle style="fill:{colour}" cx="{origin[0]:.1f}" cy="{origin[1]:.1f}" r="4"/>'
            f'<text class="note" x="{origin[0] + (-7 if anchor == "end" else 7):.1f}" '
            f'y="{origin[1] - 7:.1f}" text-anchor="{anchor}">{escape(words)}</text>')
    length = float(ticks(0.0, 0.35 * _WIDTH / pixels, 2)[-1])
    parts.append(f'<path class="axis" d="M6 {_HEIGHT - 8}v4h{length * pixels:.1f}v-4"/>'
                 f'<text class="note" x="10" y="{_HEIGHT - 11}">{length:g} m</text>')
    names = f'{"xyz"[first]} to the right, {"xyz"[second]} up'
    parts.append(f'<text class="unit" x="2" y="11">{names}</text>')
    return figure(
        f'Sensors in {rig.base}, {names}', drawing(_WIDTH, _HEIGHT, names, ''.join(parts)),
        'Lines are the axes x (red), y (green), z (blue) of each sensor.',
        'small ellipses, sensors where they are mounted',
        'a sensor far from where it is, or unknown')


def _tree(rig: RigResult) -> str:
    """Draw which pairs hold the sensors together."""
    names = list(dict.fromkeys([
        *rig.sensors, *(end for pair in rig.pairs for end in (pair.parent, pair.child))]))
    angles = np.pi / 2 - 2 * np.pi * np.arange(len(names)) / len(names)
    radius = min(_WIDTH, _HEIGHT) / 2 - 44
    at = {name: (_WIDTH / 2 + 1.25 * radius * np.cos(angle), _HEIGHT / 2 - radius * np.sin(angle))
          for name, angle in zip(names, angles, strict=True)}
    parts = []
    for pair in rig.pairs:
        (x0, y0), (x1, y1) = at[pair.parent], at[pair.child]
        style = _pair_style(pair)
        parts.append(f'<path class="{style}" style="stroke-width:1.5" '
                     f'd="M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}"><title>{escape(pair.parent)} - '
                     f'{escape(pair.child)}: {escape(pair.words)}</title></path>')
    for name, (px, py) in at.items():
        fill = _colour(rig, name) if name in rig.sensors else 'var(--unknown)'
        base = ' (base)' if name in rig.trees else ''
        lost = '' if name in rig.sensors else ' (no answer)'
        parts.append(f'<circle style="fill:{fill}" cx="{px:.1f}" cy="{py:.1f}" r="7"/>'
                     f'<text class="note" x="{px:.1f}" y="{py - 11:.1f}" text-anchor="middle">'
                     f'{escape(name)}{base}{lost}</text>')
    used = sum(pair.used and not pair.failure for pair in rig.pairs)
    return figure(
        'Pairs that hold the rig together', drawing(_WIDTH, _HEIGHT, 'pairs', ''.join(parts)),
        f'{used} of {len(rig.pairs)} pairs have part in the answer.',
        'every sensor in two pairs or more, solid lines',
        'dashed lines: no answer or not used; a sensor that hangs on one line')


def _pair_style(pair: PairReport) -> str:
    if pair.failure or not pair.used:
        return 'far dashed'
    return 'far' if pair.p_value < _WRONG else 'near'


def _matrix(rig: RigResult) -> str:
    """Draw chi-squared of each pair as a square of a matrix."""
    names = list(dict.fromkeys(end for pair in rig.pairs for end in (pair.parent, pair.child)))
    left, top, size = 84, 24, min(44, 250 // len(names))
    parts = []
    for k, name in enumerate(names):
        parts.append(f'<text x="{left - 6}" y="{top + size * (k + 0.5) + 4:.1f}" '
                     f'text-anchor="end">{escape(name[-13:])}</text>'
                     f'<text x="{left + size * (k + 0.5):.1f}" y="{top - 6}" '
                     f'text-anchor="middle">{escape(name[:6])}</text>')
    for pair in rig.pairs:
        i, j = names.index(pair.parent), names.index(pair.child)
        known = pair.degrees > 0
        colour = ('var(--line)' if not known else
                  'var(--okbg)' if pair.p_value > _DOUBTFUL else
                  'var(--weakbg)' if pair.p_value > _WRONG else 'var(--unknownbg)')
        words = (f'{pair.chi_squared / pair.degrees:.1f}' if known else
                 'x' if pair.failure else '-')
        for row, column in ((i, j), (j, i)):
            x, y = left + size * column, top + size * row
            parts.append(
                f'<rect x="{x}" y="{y}" width="{size - 2}" height="{size - 2}" rx="3" '
                f'style="fill:{colour}"><title>{escape(pair.parent)} - {escape(pair.child)}: '
                f'{escape(pair.words)}</title></rect>'
                f'<text class="note" x="{x + size / 2 - 1:.1f}" y="{y + size / 2 + 4:.1f}" '
                f'text-anchor="middle">{words}</text>')
    checked = [pair.chi_squared / pair.degrees for pair in rig.pairs if pair.degrees]
    reading = (f'Largest: {max(checked):.1f}; x: no answer.' if checked else
               'No pair is checked by another one.')
    height = top + size * len(names) + 6
    return figure(
        'Chi-squared of each pair, per degree of freedom',
        drawing(_WIDTH, height, 'chi-squared of pairs', ''.join(parts)), reading,
        'about 1 and below', 'a red row and column of one sensor: it contradicts the rest')


def _misfits(rig: RigResult) -> str:
    rows: list[tuple[str, ...]] = []
    for pair in rig.pairs:
        if pair.failure:
            rows.append((f'{pair.parent} - {pair.child}', pair.failure[:80], '', '', ''))
            continue
        t, R = (np.linalg.norm(pair.residual[part]) for part in (slice(3), slice(3, 6)))
        s, r = (np.linalg.norm(pair.std[part]) for part in (slice(3), slice(3, 6)))
        rows.append((f'{pair.parent} - {pair.child}',
                     f'{1e3 * t:.1f} mm of {1e3 * s:.1f}',
                     f'{np.rad2deg(R):.3f} deg of {np.rad2deg(r):.3f}', f'{pair.poses:,}',
                     'yes' if pair.used else 'no'))
    head = ('pair', 'from the rig, of its own deviation', 'rotation', 'poses', 'used')
    return f'<div class="card" style="grid-column:1/-1">{table(head, rows)}</div>'


def _noise(rig: RigResult) -> str:
    known = [sensor for sensor in rig.sensors.values() if sensor.noise is not None]
    if not known:
        return '<p>The noise is not known: the rig was made of two sensors or of results.</p>'
    kinds = (('white_m', 1e3, 'White noise of positions', 'mm'),
             ('white_rad', 180 / np.pi, 'White noise of rotations', 'deg'),
             ('drift_m', 1e3, 'Drift of positions', 'mm after 1 m'),
             ('drift_rad', 180 / np.pi, 'Drift of rotations', 'deg after 1 m'))
    found = []
    for field, factor, title, unit in kinds:
        values = [factor * getattr(sensor.noise, field) for sensor in known]
        parts, row = [], 24
        longest = max(*values, 1e-12)
        for k, (sensor, value) in enumerate(zip(known, values, strict=True)):
            y = 14 + row * k
            parts.append(
                f'<text x="92" y="{y + 11}" text-anchor="end">{escape(sensor.name[-14:])}</text>'
                f'<rect x="98" y="{y}" width="{max(200 * value / longest, 1):.1f}" height="14" '
                f'rx="2" style="fill:{_colour(rig, sensor.name)}"/>'
                f'<text class="note" x="{104 + 200 * value / longest:.1f}" y="{y + 11}">'
                f'{value:.2g}</text>')
        worst = known[int(np.argmax(values))].name
        found.append(figure(
            f'{title}, {unit}', drawing(_WIDTH, 20 + row * len(known), title, ''.join(parts)),
            f'Largest: {worst}, {max(values):.2g} {unit}.', 'what the sensor is known for',
            'one sensor many times above its kind'))
    return ''.join(found)


def _tracks(rig: RigResult, trajectories: Mapping[str, Trajectory]) -> str:
    names = [name for name in rig.trees[rig.base] if name in trajectories]
    if len(names) < 2:
        return '<p>The tracks were not given.</p>'
    grid = common_grid([_carried(rig, name, trajectories[name]) for name in names], _MAX_GAP_NS)
    laid = _laid(grid)
    return _from_above(rig, names, laid) + _apart(names, laid, grid)


def _carried(rig: RigResult, name: str, trajectory: Trajectory) -> Track:
    sensor = rig.sensors[name]
    return Track(sensor.clock.apply(trajectory.stamps_ns),
                 trajectory.scaled(sensor.scale).poses @ se3.inverse(sensor.T_base_sensor))


def _laid(grid: Grid) -> FloatArray:
    """Return (S, K, 3) positions of the base in the world of the first sensor; NaN: unknown."""
    found = np.full((*grid.known.shape, 3), np.nan)
    positions = grid.poses[..., :3, 3]
    found[0, grid.known[0]] = positions[0, grid.known[0]]
    for s in range(1, len(found)):
        both = grid.known[0] & grid.known[s]
        if np.count_nonzero(both) < 3:
            continue
        p, q = positions[0, both], positions[s, both]
        # The rotation of the mean attitude: positions on a line would leave it open.
        R = se3.nearest_rotation(np.mean(
            grid.poses[0, both, :3, :3] @ np.swapaxes(grid.poses[s, both, :3, :3], 1, 2), axis=0))
        found[s, grid.known[s]] = positions[s, grid.known[s]] @ R.T + p.mean(0) - R @ q.mean(0)
    return found


def _from_above(rig: RigResult, names: list[str], laid: FloatArray) -> str:
    width, height, margin = 720, 430, 24
    points = laid[:, evenly(laid.shape[1], _POINTS).astype(int)]
    flat = laid.reshape(-1, 3)
    flat = flat[np.isfinite(flat).all(axis=1)]
    first, second = np.sort(np.argsort(-np.ptp(flat, axis=0), kind='stable')[:2])
    low, high = (getattr(flat[:, [first, second]], side)(axis=0) for side in ('min', 'max'))
    room = np.array([width - 2 * margin, height - 2 * margin])
    pixels = float(np.min(room / np.maximum(high - low, 1e-9)))
    parts, keys = [], []
    for k, name in reversed(list(enumerate(names))):
        drawn = ((points[k][:, [first, second]] - 0.5 * (low + high)) * [pixels, -pixels]
                 + np.array([width / 2, height / 2]))
        colour = _colour(rig, name)
        parts.append(f'<path style="stroke:{colour};stroke-width:{1.5 + 0.8 * k:.1f};'
                     f'opacity:.7" d="{path(drawn[:, 0], drawn[:, 1])}"/>')
        keys.append(f'<span><i class="key" style="background:{colour}"></i>{escape(name)}</span>')
    length = float(ticks(0.0, 0.3 * width / pixels, 2)[-1])
    parts.append(f'<path class="axis" d="M12 {height - 16}v5h{length * pixels:.1f}v-5"/>'
                 f'<text class="note" x="14" y="{height - 20}">{length:g} m</text>')
    return figure(
        'All tracks from above', drawing(width, height, 'tracks', ''.join(parts)),
        f'{len(names)} tracks, laid on that of {names[0]}.', 'one line of many colours',
        'a track that leaves the others', wide=True,
        legend=f'<p class="legend">{"".join(reversed(keys))}</p>')


def _apart(names: list[str], laid: FloatArray, grid: Grid) -> str:
    seconds = (grid.stamps_ns - grid.stamps_ns[0]) * 1e-9
    at = evenly(len(seconds), _POINTS).astype(int)
    apart = np.linalg.norm(laid[1:] - laid[:1], axis=2)[:, at]
    found = []
    for name, distance in zip(names[1:], apart, strict=True):
        if not np.isfinite(distance).any():
            continue
        plot = Plot((0.0, float(seconds[-1])), (0.0, limits(distance, include=[0.0])[1]),
                    name=f'{name} from {names[0]}', x_label='s', y_label='m')
        plot.line(seconds[at], distance, 'line-b')
        found.append(figure(
            f'{name} from {names[0]}', plot.svg(),
            f'Median {np.nanmedian(distance):.3g} m, largest {np.nanmax(distance):.3g} m.',
            'a slow wave: drift', 'steps: jumps of a track, or a mount that moved'))
    return ''.join(found)
