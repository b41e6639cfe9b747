# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The noise of a drive: of poses, and between the world frames of windows.

The white noise of a pose is split equally between the sensors. Noise of its stamp acts along the
twist. The world frames of neighbouring windows differ by noise of each octave, and by a change of
scale, which acts along the distance moved.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.algebra import (
    adjoint_of_inverse,
    ROTATION,
    TRANSLATION,
)

PARTS = (TRANSLATION, ROTATION)

# How variances grow from octave to octave: between flicker (1) and a random walk (2).
GROWTH = 1.4


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Variances, those with two columns of (translation, rotation).

    Attributes
    ----------
    white : (2,) of a pose, both sensors together, per axis.
    stamps : of the stamp of a pose, s^2.
    walk : (octaves, 2) between the worlds of neighbouring windows, per axis.
    scale : of the log scale between the worlds of neighbouring windows of octave 1.
    tail : degrees of freedom of Student's t for the contrasts.

    """

    white: FloatArray
    stamps: float
    walk: FloatArray
    scale: float
    tail: float

    def resized(self, octaves: int) -> NoiseModel:
        """Return the noise for at least so many octaves; the last one is repeated."""
        more = octaves - len(self.walk)
        return self if more <= 0 else replace(self, walk=np.concatenate(
            [self.walk, np.repeat(self.walk[-1:], more, axis=0)]))

    def refined(self, octaves: int) -> NoiseModel:
        """Return the noise with so many shorter octaves added below."""
        below = self.walk[1:2] / 2.0**np.arange(octaves, 0, -1)[:, None]
        return replace(self, walk=np.concatenate([0 * self.walk[:1], below, self.walk[1:]]),
                       scale=self.scale / GROWTH**octaves)

    def of_poses(self, T_a_b: FloatArray, twists: FloatArray) -> FloatArray:
        """Return the (N, 6, 6) covariances of poses with (N, 6) twists, in the axes of b."""
        result: FloatArray = np.tensordot(self.white, units(T_a_b), axes=1) + along(
            np.sqrt(self.stamps) * twists)
        return result

    def of_scale(self, octaves: int) -> FloatArray:
        """Return the (octaves,) variances of the log scale between worlds."""
        return self.scale * scale_growth(octaves)


def scale_growth(octaves: int) -> FloatArray:
    """Return the (octaves,) variances of the scale relative to octave 1; zero for poses."""
    k = np.arange(octaves)
    return np.where(k > 0, GROWTH**(k - 1.0), 0.0)


def along(directions: FloatArray) -> FloatArray:
    """Return the (n, 6, 6) covariances of noise in (n, 6) directions."""
    return directions[:, :, None] * directions[:, None, :]


def units(T_a_b: FloatArray) -> FloatArray:
    """Return (2, 6, 6): unit variance of translation or rotation, half on each sensor.

    In the axes of b; that of a is carried over the lever arm: ``Ad(X^-1) S Ad(X^-1)'``.
    """
    Ad = adjoint_of_inverse(T_a_b[None, :3, :3], T_a_b[None, :3, 3])[0]
    result = np.zeros((2, 6, 6))
    for unit, part in zip(result, PARTS, strict=True):
        unit[part, part] = np.eye(3)
        unit[:] = 0.5 * (unit + Ad @ unit @ Ad.T)
    return result
