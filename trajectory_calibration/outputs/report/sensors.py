# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sensor b in the frame of a, with the region that holds it with 95 % probability."""

from __future__ import annotations

import numpy as np

from trajectory_calibration.assessment.observability import UNOBSERVED
from trajectory_calibration.outputs.report.data import ReportData
from trajectory_calibration.outputs.report.figures import ellipse, Scene

_WIDTH, _HEIGHT, _MARGIN = 360, 240, 30
# An ellipse smaller than this is drawn larger, and said so.
_VISIBLE = 5.0
# Standard deviations that a view has room for.
_ROOM = 2.45


def sensor_view(data: ReportData, first: int, second: int) -> Scene:
    """Draw both sensors seen along the third axis of a; ``first`` points right, ``second`` up."""
    result, axes = data.result, [first, second]
    unknown = np.array([result.observability.status['xyz'[axis]] == UNOBSERVED for axis in axes])
    t = np.where(unknown, 0.0, result.T_a_b[:3, 3][axes])
    P = np.zeros((2, 2)) if result.covariance is None else result.covariance[np.ix_(axes, axes)]
    region = ellipse(P * np.outer(~unknown, ~unknown))
    span = (_HEIGHT - 2 * _MARGIN) / 2
    scene = Scene('sensors in the frame of a', _WIDTH, _HEIGHT, 0.5 * t, span / _reach(data))
    arm = 0.32 * span / scene.pixels
    scene.legend('xyz'[first], 'xyz'[second])
    x, y = scene.place(t)
    if unknown[0]:
        scene.box(0, y - 7, _WIDTH, 14, 'open')
    if unknown[1]:
        scene.box(x - 7, 0, 14, _HEIGHT, 'open')
    if unknown.any():
        scene.text(_WIDTH - 6, 28, 'unknown along the stripe', 'end')
    size = float(np.abs(region).max()) * scene.pixels
    if size > 0 and not unknown.all():
        # By how many powers of ten it must grow to be seen.
        larger = 10 ** int(np.clip(np.ceil(np.log10(_VISIBLE / size)), 0, 4))
        scene.line(t + larger * region, 'ellipse', closed=True)
        if larger > 1:
            scene.text(_WIDTH - 6, 14, f'ellipse drawn {larger} times as large', 'end')
    scene.line(np.array([[0.0, 0.0], t]), 'lever')
    far = float(np.linalg.norm(t)) > 1.5 * arm
    for name, origin, R, length, lettered in (
            ('a', np.zeros(2), np.eye(3), arm, True),
            ('b', t, result.T_a_b[:3, :3], 0.75 * arm, far)):
        scene.axes(origin, R[axes], length, lettered=lettered)
        scene.dot(origin, 4, f'dot-{name}')
    return scene


def _reach(data: ReportData) -> float:
    """Return metres from the middle to the border, the same for all three views."""
    result = data.result
    known = np.array([result.observability.status[name] != UNOBSERVED for name in 'xyz'])
    size = np.abs(result.T_a_b[:3, 3]) / 2
    if result.covariance is not None:
        size = size + _ROOM * np.sqrt(np.maximum(np.diagonal(result.covariance)[:3], 0.0))
    return 1.2 * max(float((size * known).max()), 0.03)
