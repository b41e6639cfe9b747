# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Views of the positions and axes of sensors, with 95 % ellipses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from trajectory_calibration.assessment.observability import UNOBSERVED
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.report.figures import ellipse, REACH, Scene
from trajectory_calibration.outputs.report.page import Figure

_WIDTH, _HEIGHT, _MARGIN = 360, 240, 38
# Length of the axes of a sensor, units of the picture.
_ARM = 22
# Smallest extent of a view, metres.
_LEAST = 0.06
# Beyond this share of the width a name is left of its sensor.
_AT_RIGHT = 0.7


class Mounted(NamedTuple):
    """A sensor in the frame of the first sensor: ``T`` (4, 4), metres.

    ``covariance`` is (6, 6), zero if exact; ``status`` is by component; ``colour`` is of CSS.
    """

    name: str
    T: FloatArray
    covariance: FloatArray
    status: Mapping[str, str]
    colour: str

    @property
    def unobserved(self) -> list[str]:
        """Return the unobservable components of the translation."""
        return [axis for axis in 'xyz' if self.status[axis] == UNOBSERVED]


def sensor_views(sensors: Sequence[Mounted]) -> list[Figure]:
    """Return views of sensors along z, y and x of the frame of the first one."""
    known = np.array([[axis not in sensor.unobserved for axis in 'xyz'] for sensor in sensors])
    # An unobservable component is drawn at 0, without an ellipse.
    places = np.where(known, [sensor.T[:3, 3] for sensor in sensors], 0.0)
    P = np.array([sensor.covariance[:3, :3] for sensor in sensors]) * (
        known[:, :, None] & known[:, None, :])
    reach = REACH * np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 0.0))
    low, high = (places - reach).min(axis=0), (places + reach).max(axis=0)
    extent = np.maximum(high - low, _LEAST)
    # One scale for all views; x is always horizontal, and z always vertical.
    pixels = float(min((_WIDTH - 2 * _MARGIN) / extent[:2].max(),
                       (_HEIGHT - 2 * _MARGIN) / extent[1:].max()))
    figures = []
    for axes, along in (([0, 1], 'z'), ([0, 2], 'y'), ([1, 2], 'x')):
        scene = Scene(_WIDTH, _HEIGHT, 0.5 * (low + high)[axes], pixels)
        scene.legend(*('xyz'[axis] for axis in axes))
        for sensor, place, part in zip(sensors, places[:, axes], P, strict=True):
            _draw(scene, sensor, axes, place, part[np.ix_(axes, axes)])
        for k, (sensor, (x, y)) in enumerate(zip(
                sensors, scene.place(places[:, axes]), strict=True)):
            words = f' ({", ".join(sensor.unobserved)} unknown)' if sensor.unobserved else ''
            at_right = x > _AT_RIGHT * _WIDTH
            # Names are alternately above and below, so that they do not overlap.
            scene.text(x + (-7 if at_right else 7), y + (16 if k % 2 else -7),
                       sensor.name + words, 'end' if at_right else 'start')
        unobserved = '; '.join(f'{", ".join(names)} of {sensor.name}' for sensor in sensors
                               if (names := sensor.unobserved))
        where = ' along the stripe' if not known[:, axes].all() else ''
        figures.append(Figure(
            'sensors', scene, f'{unobserved}: unknown{where}.' if unobserved else
            'Each sensor lies in its ellipse with 95 % probability.',
            names={'axis': along, 'base': sensors[0].name}))
    return figures


def _draw(
    scene: Scene, sensor: Mounted, axes: list[int], place: FloatArray, covariance: FloatArray,
) -> None:
    x, y = at = scene.place(place)
    if 'xyz'[axes[0]] in sensor.unobserved:
        scene.box(0, y - 7, _WIDTH, 14, 'unobserved')
    if 'xyz'[axes[1]] in sensor.unobserved:
        scene.box(x - 7, 0, 14, _HEIGHT, 'unobserved')
    if covariance.any():
        scene.line(place + ellipse(covariance), 'ellipse', f'stroke:{sensor.colour}')
    scene.line(np.stack([np.zeros(2), place]), 'lever')
    scene.axes(place, sensor.T[axes, :3], _ARM / scene.pixels)
    scene.dot(at, 4, css=f'fill:{sensor.colour}')
