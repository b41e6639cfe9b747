# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors of a SLAM trajectory: drift, scale, loop closures, jumps, noise.

Every function takes (N, 4, 4) poses in time order and returns new ones. ``Noise.disturb`` first
adds the errors that accumulate, then jumps, then the noise of single poses.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
import itertools

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.errors import ConfigError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# Of each axis of a jump, square metres.
JUMP_VARIANCE = 0.02

# Limit of every parameter: beyond any sensor, and sums of squares do not overflow.
_LARGEST = 1e6


@dataclass(frozen=True)
class Noise:
    """The errors of one sensor's trajectory.

    Attributes
    ----------
    white : standard deviation of white noise on each translation axis of each pose, metres.
    white_rotation : the same for each rotation axis, radians; None: 2 rad/m times ``white``, as
        in the paper.
    jumps : number of position jumps, each of which persists to the end.
    drift : metres of drift per metre moved, along one random axis of the sensor's own frame.
    walk : standard deviation of the random walk of the position, metres after one metre.
    walk_rotation : the same for the orientation, radians after one metre.
    coloured : standard deviation of an exponentially correlated position error, metres.
    coloured_rotation : the same for the orientation, radians.
    coloured_time : correlation time of both, seconds.
    loop_closures : number of loop closures, each of which removes all accumulated errors.
    scale : factor on every translation.

    """

    white: float = 0.0
    white_rotation: float | None = None
    jumps: int = 0
    drift: float = 0.0
    walk: float = 0.0
    walk_rotation: float = 0.0
    coloured: float = 0.0
    coloured_rotation: float = 0.0
    coloured_time: float = 2.0
    loop_closures: int = 0
    scale: float = 1.0

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            # Written so that NaN fails.
            if value is not None and not 0 <= value <= _LARGEST:
                raise ConfigError(f'noise {item.name} is {value}, needed 0 to {_LARGEST:.0f}')
        if self.scale == 0 or self.coloured_time == 0:
            raise ConfigError('noise scale and coloured_time are needed above 0')

    def disturb(
        self, poses: FloatArray, interval: float, seed: np.random.SeedSequence,
    ) -> FloatArray:
        """Return the (N, 4, 4) poses that a SLAM reports for true ones ``interval`` s apart.

        Each kind of error has its own random stream: changing one leaves the others unchanged.
        """
        for_drift, for_closures, for_jumps, for_coloured, for_white = map(
            np.random.default_rng, seed.spawn(5))
        disturbed = accumulate(
            poses, drift=self.drift, walk=self.walk, walk_rotation=self.walk_rotation,
            scale=self.scale, rng=for_drift,
            closures=_random_indices(len(poses), self.loop_closures, for_closures))
        disturbed = jump(disturbed, self.jumps, for_jumps)
        disturbed = perturb(disturbed, ornstein_uhlenbeck(
            len(poses), interval, self.coloured, self.coloured_rotation, self.coloured_time,
            for_coloured))
        rotation = 2 * self.white if self.white_rotation is None else self.white_rotation
        return perturb(disturbed, _gaussian(len(poses), self.white, rotation, for_white))


def accumulate(
    poses: FloatArray, *, drift: float, walk: float, walk_rotation: float, scale: float,
    closures: NDArray[np.intp], rng: np.random.Generator,
) -> FloatArray:
    """Return the (N, 4, 4) poses of dead reckoning with errors.

    A step of length s gets ``drift * s`` along one axis of the frame at its start, then the
    factor ``scale``, then a random motion with the standard deviations ``walk * sqrt(s)`` and
    ``walk_rotation * sqrt(s)``. At the (K,) indices ``closures`` the pose is the true one of the
    scaled world.
    """
    axis = np.eye(3)[rng.integers(3)]
    steps = se3.inverse(poses[:-1]) @ poses[1:]
    length = np.linalg.norm(steps[:, :3, 3], axis=1)
    steps[:, :3, 3] = scale * (steps[:, :3, 3] + drift * length[:, None] * axis)
    errors = _gaussian(len(steps), walk, walk_rotation, rng) * np.sqrt(length)[:, None]
    if walk or walk_rotation:
        steps = steps @ se3.exp_se3(errors)
    anchors = se3.scaled(poses, scale)
    starts = np.concatenate([[0], closures, [len(poses)]]).astype(int)
    return np.concatenate([
        anchors[start] @ running_product(np.concatenate([np.eye(4)[None], steps[start:end - 1]]))
        for start, end in itertools.pairwise(starts)])


def jump(poses: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Return (N, 4, 4) poses with ``count`` random position jumps, each persists to the end."""
    offsets = np.zeros((len(poses), 3))
    indices = _random_indices(len(poses), count, rng)
    offsets[indices] = rng.normal(0.0, np.sqrt(JUMP_VARIANCE), (len(indices), 3))
    result = poses.copy()
    result[:, :3, 3] += offsets.cumsum(axis=0)
    return result


def perturb(poses: FloatArray, tangents: FloatArray) -> FloatArray:
    """Return (N, 4, 4) poses right-multiplied by small motions, (N, 6) metres and radians.

    The last three components are a rotation vector; for small angles it has the same
    distribution as the Euler angles of the paper.
    """
    return poses @ se3.from_rotation_translation(se3.exp_so3(tangents[:, 3:]), tangents[:, :3])


def ornstein_uhlenbeck(
    count: int, interval: float, translation: float, rotation: float, time: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Return (count, 6) stationary noise with the autocorrelation ``exp(-|lag| / time)``.

    ``translation`` (m) and ``rotation`` (rad) are its standard deviations; the samples are
    ``interval`` seconds apart.
    """
    correlation = float(np.exp(-interval / time))
    driven = _gaussian(count, translation, rotation, rng)
    driven[1:] *= np.sqrt(1 - correlation**2)
    # A million samples take a second, as long as the import of scipy.signal.
    columns = [list(itertools.accumulate(column, lambda before, new: correlation * before + new))
               for column in driven.T.tolist()]
    return np.ascontiguousarray(np.array(columns, dtype=np.float64).T)


def running_product(poses: FloatArray) -> FloatArray:
    """Return the (N, 4, 4) cumulative products of (N, 4, 4) poses.

    Computed in about sqrt(N) blocks of sqrt(N) poses: first within all blocks at once, then from
    block to block. This is 2 sqrt(N) array operations in place of N small products.
    """
    length = int(np.ceil(np.sqrt(len(poses))))
    blocks = np.tile(np.eye(4), (-(-len(poses) // length), length, 1, 1))
    blocks.reshape(-1, 4, 4)[:len(poses)] = poses
    for k in range(1, length):
        blocks[:, k] = blocks[:, k - 1] @ blocks[:, k]
    for i in range(1, len(blocks)):
        blocks[i] = blocks[i - 1, -1] @ blocks[i]
    return blocks.reshape(-1, 4, 4)[:len(poses)]


def _gaussian(
    count: int, translation: float, rotation: float, rng: np.random.Generator,
) -> FloatArray:
    return rng.standard_normal((count, 6)) * ([translation] * 3 + [rotation] * 3)


def _random_indices(poses: int, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return sorted indices of ``count`` different poses, never the first."""
    if count >= poses:
        raise ConfigError(
            f'{count} jumps or loop closures asked of {poses} poses; needed fewer than '
            'poses: ask for fewer, or for a longer duration')
    return np.sort(rng.permutation(np.arange(1, poses))[:count])
