# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The two tracks as a drawing from above, and as data of the interactive 3D view."""

from __future__ import annotations

import json

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.report.figures import evenly, Scene
from trajectory_calibration.outputs.report.tracks import Indices, Tracks

# Most poses of a track.
_POSES = 900
# Size of a drawing as wide as the page.
WIDE, HIGH = 720, 430
_MOST_GAPS = 300


def track_view(tracks: Tracks) -> str:
    """Return the view from above as HTML, and the data for the script of the 3D view."""
    names, R = upright(tracks.pairs.poses_a[:, :3, 3])
    a, c = (poses[:, :3, 3] @ R.T for poses in (tracks.pairs.poses_a, tracks.poses_c))
    # Both ends of each jump and gap are kept.
    ends = np.concatenate([tracks.largest_jumps, tracks.gaps[:_MOST_GAPS]])
    ends = np.clip(np.add.outer([-1, 0, 1], ends).ravel(), 0, len(a) - 1)
    keep = np.union1d(evenly(len(a), _POSES), ends)
    middle, size = a[keep].mean(axis=0), max(np.ptp(a[keep], axis=0).max(), 1e-6)
    # Rounding is below a thousandth of the size of the track.
    digits = int(np.ceil(3 - np.log10(size)))
    words = json.dumps({
        'a': np.round(a[keep] - middle, digits).tolist(),
        'b': np.round(c[keep] - middle, digits).tolist(),
        'jumps': np.round(c[tracks.largest_jumps] - middle, digits).tolist(),
        'gaps': np.searchsorted(keep, tracks.gaps).tolist(), 'axes': names,
    }, separators=(',', ':'))
    drawn = _from_above(a[:, :2], c[:, :2], keep, tracks).svg('both tracks from above')
    return (f'<div class="view3d" id="view">{drawn}'
            f'<script type="application/json" id="tracks">{words}</script></div>')


def upright(positions: FloatArray) -> tuple[list[str], FloatArray]:
    """Return the names of three axes, the last one up, and the (3, 3) rotation to them.

    Up is the axis of the smallest extent of (N, 3) positions. In a camera's world y is down.
    """
    up = int(np.argmin(np.ptp(positions, axis=0)))
    if up == 1:
        return ['x', 'z', '-y'], np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    order = [1, 2, 0] if up == 0 else [0, 1, 2]
    return ['xyz'[k] for k in order], np.eye(3)[order]


def _from_above(a: FloatArray, c: FloatArray, keep: Indices, tracks: Tracks) -> Scene:
    """Draw both (K, 2) tracks."""
    scene = Scene.around(np.concatenate([a, c]), WIDE, HIGH)
    # A gap is a dashed line.
    gaps = np.flatnonzero(np.isin(keep, tracks.gaps))
    gaps = gaps[gaps + 1 < len(keep)]
    for points, style in ((c[keep], 'line-b wide'), (a[keep], 'line-a')):
        broken = np.full((len(gaps), 2), np.nan)
        scene.line(np.insert(points, gaps + 1, broken, axis=0), style)
        if len(gaps):
            over = np.stack([points[gaps], points[gaps + 1], broken], axis=1)
            scene.line(over.reshape(-1, 2), f'{style} dashed')
    for point in c[tracks.largest_jumps]:
        scene.dot(scene.place(point), 3.4, 'jump')
    x, y = at = scene.place(a[0])
    scene.dot(at, 5, 'start')
    scene.text(x + 8, y - 6, 'start')
    scene.scale_bar()
    return scene


def single_track(positions: FloatArray, style: str) -> Scene:
    """Draw a track of (N, 3) positions from above."""
    axes, R = upright(positions)
    points = (positions[evenly(len(positions), _POSES)] @ R.T)[:, :2]
    scene = Scene.around(points, 360, 240)
    scene.line(points, style)
    scene.dot(scene.place(points[0]), 4, 'start')
    scene.legend(axes[0], axes[1])
    return scene
