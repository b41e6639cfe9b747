# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The two tracks as a drawing from above, and as numbers for the view that can be turned."""

from __future__ import annotations

import json

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.report.figures import evenly, Scene
from trajectory_calibration.outputs.report.tracks import Tracks

# Poses of a track that are drawn.
_POSES = 900
# Of a drawing as wide as the page.
WIDE, HIGH = 720, 430
_MOST_GAPS = 300


def track_view(tracks: Tracks) -> str:
    """Return the view from above, which a script makes one that can be turned."""
    names, turned = upright(tracks.pairs.poses_a[:, :3, 3])
    a, c = (poses[:, :3, 3] @ turned.T for poses in (tracks.pairs.poses_a, tracks.poses_c))
    # With both ends of each jump and gap.
    ends = np.concatenate([tracks.largest_jumps(), tracks.gaps[:_MOST_GAPS]])
    ends = np.clip(np.add.outer([-1, 0, 1], ends).ravel(), 0, len(a) - 1)
    keep = np.union1d(evenly(len(a), _POSES), ends)
    middle, size = a[keep].mean(axis=0), max(np.ptp(a[keep], axis=0).max(), 1e-6)
    # To less than a thousandth of the track.
    digits = int(np.ceil(3 - np.log10(size)))
    words = json.dumps({
        'a': np.round(a[keep] - middle, digits).tolist(),
        'b': np.round(c[keep] - middle, digits).tolist(),
        'jumps': np.round(c[tracks.largest_jumps()] - middle, digits).tolist(),
        'gaps': np.searchsorted(keep, tracks.gaps).tolist(), 'axes': names,
    }, separators=(',', ':'))
    drawn = _from_above(a[:, :2], c[:, :2], keep, tracks).svg('both tracks from above')
    return (f'<div class="view3d" id="view">{drawn}'
            f'<script type="application/json" id="tracks">{words}</script></div>')


def upright(positions: FloatArray) -> tuple[list[str], FloatArray]:
    """Return the names of three axes of which the last is up, and the (3, 3) turn to them.

    Up is the axis in which a track is shortest. The world of a camera has y down.
    """
    up = int(np.argmin(np.ptp(positions, axis=0)))
    if up == 1:
        return ['x', 'z', '-y'], np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    order = [1, 2, 0] if up == 0 else [0, 1, 2]
    return ['xyz'[k] for k in order], np.eye(3)[order]


def _from_above(a: FloatArray, c: FloatArray, keep: FloatArray, tracks: Tracks) -> Scene:
    """Draw both (K, 2) tracks."""
    scene = Scene.around(np.concatenate([a, c]), WIDE, HIGH)
    # The step over a gap is dashed, and parts the pieces of the track.
    gaps = np.flatnonzero(np.isin(keep, tracks.gaps))
    gaps = gaps[gaps + 1 < len(keep)]
    for points, style in ((c[keep], 'line-b wide'), (a[keep], 'line-a')):
        broken = np.full((len(gaps), 2), np.nan)
        scene.line(np.insert(points, gaps + 1, broken, axis=0), style)
        if len(gaps):
            over = np.stack([points[gaps], points[gaps + 1], broken], axis=1)
            scene.line(over.reshape(-1, 2), f'{style} dashed')
    for point in c[tracks.largest_jumps()]:
        scene.dot(scene.place(point), 3.4, 'jump')
    x, y = at = scene.place(a[0])
    scene.dot(at, 5, 'start')
    scene.text(x + 8, y - 6, 'start')
    scene.scale_bar()
    return scene


def single_track(positions: FloatArray, style: str) -> Scene:
    """Draw one track along the two axes in which it is longest."""
    axes, turned = upright(positions)
    points = (positions[evenly(len(positions), _POSES)] @ turned.T)[:, :2]
    scene = Scene.around(points, 360, 240)
    scene.line(points, style)
    scene.dot(scene.place(points[0]), 4, 'start')
    scene.legend(axes[0], axes[1])
    return scene
