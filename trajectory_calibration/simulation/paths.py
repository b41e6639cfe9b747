# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Paths of a base as functions of time.

A path maps (N,) seconds to the (N, 4, 4) poses ``T_world_base`` at those times: sensors of any
rate and phase sample the same motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

Path = Callable[[FloatArray], FloatArray]

# Height (m) of the ground at (N,) x and (N,) y (m), and its slopes along x and y.
Ground = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]]


def flat(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Level ground."""
    zero = np.zeros(np.broadcast_shapes(x.shape, y.shape))
    return zero, zero, zero


def peaks(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """0.1 times MATLAB's ``peaks``: the terrain of the paper."""
    u = 1 - x
    v = x / 5 - x**3 - y**5
    first = 3 * u**2 * np.exp(-x**2 - (y + 1)**2)
    wave = np.exp(-x**2 - y**2)
    last = np.exp(-(x + 1)**2 - y**2) / 3
    height = first - 10 * v * wave - last
    slope_x = (-6 * u * np.exp(-x**2 - (y + 1)**2) - 2 * x * first
               - 10 * (1 / 5 - 3 * x**2 - 2 * x * v) * wave + 2 * (x + 1) * last)
    slope_y = (-2 * (y + 1) * first - 10 * (-5 * y**4 - 2 * y * v) * wave + 2 * y * last)
    return 0.1 * height, 0.1 * slope_x, 0.1 * slope_y


def hills(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Periodic hills, 1 m high and 25 m apart."""
    k = 2 * np.pi / 25
    return (np.sin(k * x) + np.cos(k * y), k * np.cos(k * x) + 0 * y, -k * np.sin(k * y) + 0 * x)


@dataclass(frozen=True)
class Unicycle:
    """A vehicle on wheels: constant horizontal speed, piecewise constant random yaw rate.

    With a constant yaw rate it drives an exact arc. Its z axis is the normal of the ground, its
    x axis the heading; it starts at x = 0, y = 0.5 m, heading along x.

    Attributes
    ----------
    speed : horizontal speed, metres per second.
    yaw_rate : the yaw rate is uniform in plus or minus this, radians per second.
    hold : duration of each yaw rate, seconds.
    ground : height and slopes of the ground.
    as_published : use the orientations of the paper's published trajectories. They are not those
        of a vehicle but the inverse of ``Rz(heading) Ry(asin(n_x)) Rx(asin(n_y))`` with the
        normal n of the ground, so that the direction of motion in the sensor frame varies. A
        vehicle moves along its x axis, where a constant drift of b looks like a rotation of b.

    """

    speed: float = 0.5
    yaw_rate: float = 2.0
    hold: float = 0.5
    ground: Ground = peaks
    as_published: bool = False

    def draw(self, duration: float, rng: np.random.Generator) -> Path:
        """Draw a path of ``duration`` seconds."""
        orient = _published_rotations if self.as_published else _vehicle_rotations
        rates = rng.uniform(-self.yaw_rate, self.yaw_rate, int(duration / self.hold) + 1)
        headings = np.concatenate([[0.0], np.cumsum(rates * self.hold)])
        arcs = self._chord(headings[:-1], rates, np.full(len(rates), self.hold))
        corners = np.concatenate([[[0.0, 0.5]], arcs]).cumsum(axis=0)

        def path(times: FloatArray) -> FloatArray:
            k = np.clip((times / self.hold).astype(int), 0, len(rates) - 1)
            elapsed = times - k * self.hold
            xy = corners[k] + self._chord(headings[k], rates[k], elapsed)
            z, slope_x, slope_y = self.ground(xy[:, 0], xy[:, 1])
            R = orient(slope_x, slope_y, headings[k] + rates[k] * elapsed)
            return se3.from_rotation_translation(R, np.column_stack([xy, z]))

        return path

    def _chord(
        self, heading: FloatArray, rate: FloatArray, duration: FloatArray,
    ) -> FloatArray:
        """Return (N, 2) displacements along arcs with (N,) initial headings, metres."""
        half = 0.5 * rate * duration
        length = self.speed * duration * np.sinc(half / np.pi)
        return np.column_stack([length * np.cos(heading + half), length * np.sin(heading + half)])


@dataclass(frozen=True)
class Wander:
    """A drone or a hand: smooth random motion in all six degrees of freedom.

    Each coordinate is a sum of five sinusoids with random phases and with random frequencies
    from 0.2 to 1.0 times ``frequency``.

    Attributes
    ----------
    reach : standard deviation of the position along each axis, metres.
    tilt : standard deviation of roll and pitch, radians.
    turn : standard deviation of yaw, radians.
    frequency : the highest frequency, hertz.

    """

    reach: float = 5.0
    tilt: float = 0.25
    turn: float = 1.5
    frequency: float = 0.25

    def draw(self, duration: float, rng: np.random.Generator) -> Path:
        """Draw a path, which is defined for any time; ``duration`` is not used."""
        del duration
        omega = 2 * np.pi * self.frequency * rng.uniform(0.2, 1.0, (6, 5))
        phase = rng.uniform(0, 2 * np.pi, (6, 5))
        # The mean square of a sinusoid is 1/2.
        scale = np.sqrt(2 / 5) * np.array([self.reach] * 3 + [self.tilt, self.tilt, self.turn])

        def path(times: FloatArray) -> FloatArray:
            waves = scale * np.sin(omega * times[:, None, None] + phase).sum(axis=-1)
            R = se3.rotation_from_roll_pitch_yaw(waves[:, 3:])
            return se3.from_rotation_translation(R, waves[:, :3])

        return path


def _vehicle_rotations(
    slope_x: FloatArray, slope_y: FloatArray, heading: FloatArray,
) -> FloatArray:
    """Return (N, 3, 3) rotations with z along the normal of the ground and x along the heading."""
    cosine, sine = np.cos(heading), np.sin(heading)
    forward = np.column_stack([cosine, sine, slope_x * cosine + slope_y * sine])
    forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
    normal = _normal(slope_x, slope_y)
    return np.stack([forward, np.cross(normal, forward), normal], axis=-1)


def _published_rotations(
    slope_x: FloatArray, slope_y: FloatArray, heading: FloatArray,
) -> FloatArray:
    """Return the (N, 3, 3) rotations of the paper's published trajectories."""
    pitch, roll, _ = np.arcsin(_normal(slope_x, slope_y)).T
    R = se3.rotation_from_roll_pitch_yaw(np.column_stack([roll, pitch, heading]))
    return np.swapaxes(R, -1, -2)


def _normal(slope_x: FloatArray, slope_y: FloatArray) -> FloatArray:
    normal = np.column_stack([-slope_x, -slope_y, np.ones(len(slope_x))])
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)
