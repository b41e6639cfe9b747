# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The two tracks as a drawing from above, and as numbers for the view that can be turned."""

from __future__ import annotations

import json

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.report.drawings import evenly
from trajectory_calibration.outputs.report.figures import drawing, path, ticks
from trajectory_calibration.outputs.report.tracks import Tracks

# Poses of a track that are drawn, and steps of the grid in which they are written.
_POSES, _GRID = 900, 4000
_WIDTH, _HEIGHT, _MARGIN = 720, 430, 24
_MOST_GAPS = 300
# Jumps that are drawn, the largest.
MOST_JUMPS = 80


def track_view(tracks: Tracks) -> str:
    """Return the view from above, over which a script lays one that can be turned."""
    names, turned = upright(tracks.pairs.poses_a[:, :3, 3])
    a, c = (poses[:, :3, 3] @ turned.T for poses in (tracks.pairs.poses_a, tracks.poses_c))
    keep = _kept(tracks)
    both = np.concatenate([a[keep], c[keep]])
    low, high = both.min(axis=0), both.max(axis=0)
    middle, size = 0.5 * (low + high), max(float((high - low).max()), 1e-6)
    jumps = tracks.largest_jumps(MOST_JUMPS)
    gaps = np.searchsorted(keep, tracks.gaps)
    numbers = {
        'size': size,
        'a': _grid(a[keep], middle, size), 'b': _grid(c[keep], middle, size),
        'jumps': _grid(c[jumps], middle, size),
        'gaps': gaps.tolist(), 'grid': _GRID, 'axes': names,
    }
    words = json.dumps(numbers, separators=(',', ':'))
    return (f'<div class="view3d" id="view"><div class="static">{_from_above(a, c, tracks)}'
            f'</div><script type="application/json" id="tracks">{words}</script></div>')


def upright(positions: FloatArray) -> tuple[list[str], FloatArray]:
    """Return the names of three axes of which the last is up, and the (3, 3) turn to them.

    Up is the axis in which a track is shortest. The world of a camera has y down.
    """
    up = int(np.argmin(np.ptp(positions, axis=0)))
    if up == 1:
        return ['x', 'z', '-y'], np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    order = [1, 2, 0] if up == 0 else [0, 1, 2]
    return ['xyz'[k] for k in order], np.eye(3)[order]


def _kept(tracks: Tracks) -> FloatArray:
    """Return the indices of poses that are drawn, with both ends of each jump and gap."""
    ends = np.concatenate([tracks.largest_jumps(MOST_JUMPS), tracks.gaps[:_MOST_GAPS]])
    ends = np.concatenate([ends, ends - 1, ends + 1])
    ends = ends[(ends >= 0) & (ends < len(tracks))]
    return np.unique(np.concatenate([evenly(len(tracks), _POSES), ends]))


def _grid(points: FloatArray, middle: FloatArray, size: float) -> list[int]:
    scaled = np.round((points - middle) / size * _GRID).astype(int)
    # Steps from point to point: shorter, and no digit is lost.
    found: list[int] = np.diff(scaled, axis=0, prepend=np.zeros((1, 3), int)).ravel().tolist()
    return found


def _from_above(a: FloatArray, c: FloatArray, tracks: Tracks) -> str:
    """Draw both tracks, upright, from above."""
    keep = _kept(tracks)
    both = np.concatenate([a, c])[:, :2]
    low, high = both.min(axis=0), both.max(axis=0)
    turn = (high - low)[1] > (high - low)[0]
    if turn:
        # A quarter turn: what is long lies.
        a, c, both = (np.column_stack([points[:, 1], -points[:, 0]]) for points in (a, c, both))
        low, high = both.min(axis=0), both.max(axis=0)
    room = np.array([_WIDTH - 2 * _MARGIN, _HEIGHT - 2 * _MARGIN])
    pixels = float(np.min(room / np.maximum(high - low, 1e-9)))
    middle = 0.5 * (low + high)

    def place(points: FloatArray) -> FloatArray:
        found: FloatArray = (points[:, :2] - middle) * [pixels, -pixels] + [
            _WIDTH / 2, _HEIGHT / 2]
        return found

    parts = []
    broken = np.isin(keep, tracks.gaps)
    for points, style in ((c[keep], 'line-b wide'), (a[keep], 'line-a')):
        drawn = place(points)
        pieces = np.split(np.arange(len(keep)), np.flatnonzero(broken) + 1)
        data = ''.join(path(drawn[piece, 0], drawn[piece, 1]) for piece in pieces if len(piece))
        parts.append(f'<path class="{style}" d="{data}"/>')
        ends = np.flatnonzero(broken)
        ends = ends[ends + 1 < len(keep)]
        if len(ends):
            data = ''.join(path(drawn[[k, k + 1], 0], drawn[[k, k + 1], 1]) for k in ends)
            parts.append(f'<path class="{style} dashed" d="{data}"/>')
    for px, py in place(c[tracks.largest_jumps(MOST_JUMPS)]):
        parts.append(f'<circle class="jump" cx="{px:.1f}" cy="{py:.1f}" r="3.4"/>')
    (px, py), = place(a[:1])
    parts.append(f'<circle class="start" cx="{px:.1f}" cy="{py:.1f}" r="5"/>'
                 f'<text class="note" x="{px + 8:.1f}" y="{py - 6:.1f}">start</text>')
    length = float(ticks(0.0, 0.3 * _WIDTH / pixels, 2)[-1])
    words = f'{length:g} m' if length >= 1 else f'{1e3 * length:g} mm'
    parts.append(f'<path class="axis" d="M12 {_HEIGHT - 16}v5h{length * pixels:.1f}v-5"/>'
                 f'<text class="note" x="14" y="{_HEIGHT - 20}">{words}</text>')
    return drawing(_WIDTH, _HEIGHT, 'both tracks from above', ''.join(parts))


def single_track(positions: FloatArray, style: str) -> str:
    """Draw one track along the two axes in which it is longest."""
    axes, turned = upright(positions)
    points = (positions[evenly(len(positions), _POSES)] @ turned.T)[:, :2]
    low, high = points.min(axis=0), points.max(axis=0)
    width, height, margin = 360, 240, 18
    room = np.array([width - 2 * margin, height - 2 * margin])
    pixels = float(np.min(room / np.maximum(high - low, 1e-9)))
    drawn = (points - 0.5 * (low + high)) * [pixels, -pixels] + [width / 2, height / 2]
    names = f'{axes[0]} to the right, {axes[1]} up'
    length = float(ticks(0.0, 0.3 * width / pixels, 2)[-1])
    return drawing(width, height, f'track, {names}', (
        f'<path class="{style}" d="{path(drawn[:, 0], drawn[:, 1])}"/>'
        f'<circle class="start" cx="{drawn[0, 0]:.1f}" cy="{drawn[0, 1]:.1f}" r="4"/>'
        f'<text class="unit" x="2" y="11">{names}</text>'
        f'<path class="axis" d="M6 {height - 8}v4h{length * pixels:.1f}v-4"/>'
        f'<text class="note" x="10" y="{height - 10}">{length:g} m</text>'))
