# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Common windows of time of all sensors.

All tracks are transformed to the base and sampled on one grid. Each window of a dyadic grid (2, 4,
8 ... samples) has two halves. The *difference* of a window is the step from the pose of the base
at the middle according to the first half, to that according to the second half. It is relative to
a reference track, as a twist (rho, phi) in the frame of the base. These are Haar wavelets: the
differences of two lengths are uncorrelated for white noise, and nearly so for a random walk, and
together they are equivalent to the track (A. Haar, Math. Ann. 69, 1910, doi:10.1007/BF01456326).

The reference track cancels between two sensors, so it need not be accurate.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.interpolation import interpolate, left_of
from trajectory_calibration.geometry.se3 import FloatArray

# Most samples of the grid: more do not change the covariances.
_MOST_SAMPLES = 8192

# A sensor covers a window if both halves have at least this share of its samples.
_COVERED = 0.7

# Fewest windows of a length, to estimate its noise.
_FEWEST_WINDOWS = 4


@dataclass(frozen=True)
class Clock:
    """Stamps t of a sensor are ``t + drift (t - epoch_ns) + offset_s`` in the base.

    Attributes
    ----------
    offset_s : seconds added to the stamps at the epoch.
    drift : s/s.
    epoch_ns : stamp of the sensor.
    offset_std_s : standard deviation of the offset.

    """

    offset_s: float = 0.0
    drift: float = 0.0
    epoch_ns: int = 0
    offset_std_s: float = 0.0

    def at(self, stamps_ns: ArrayLike) -> FloatArray:
        """Return (N,) seconds to add to (N,) stamps of the sensor."""
        return self.offset_s + self.drift * 1e-9 * (np.asarray(stamps_ns) - self.epoch_ns)


@dataclass(frozen=True, eq=False)
class WindowLevel:
    """All windows of one length.

    Attributes
    ----------
    samples : of the grid in half a window; windows are consecutive from the first sample.
    metres : mean distance from the middle of the first half to that of the second.
    differences : (S, W, 6), by sensor and window, in the base, metres and radians.
    jacobian : (W, 6, 6), of a difference by a twist of the extrinsic of its sensor.
    known : (S, W), whether the sensor covers the window.

    """

    samples: int
    metres: float
    differences: FloatArray
    jacobian: FloatArray
    known: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Track:
    """A track in the clock and unit of the base: (N,) nanoseconds and (N, 4, 4) poses."""

    stamps_ns: NDArray[np.int64]
    poses: FloatArray


@dataclass(frozen=True, eq=False)
class Grid:
    """The tracks of all sensors as poses of the base, at common times.

    Attributes
    ----------
    stamps_ns : (K,).
    poses : (S, K, 4, 4), the base in the world of each sensor; identity where unknown.
    known : (S, K).

    """

    stamps_ns: NDArray[np.int64]
    poses: FloatArray
    known: NDArray[np.bool_]


def base_track(trajectory: Trajectory, clock: Clock, scale: float, X: FloatArray) -> Track:
    """Return the track of the base from a sensor with the pose ``X`` (4, 4) in the base."""
    shift_ns = np.rint(1e9 * clock.at(trajectory.stamps_ns)).astype(np.int64)
    return Track(trajectory.stamps_ns + shift_ns,
                 trajectory.scaled(scale).poses @ se3.inverse(X))


def common_grid(tracks: list[Track], max_gap_ns: int) -> Grid:
    """Sample (S,) tracks of the base from the first pose to the last."""
    start = min(int(track.stamps_ns[0]) for track in tracks)
    end = max(int(track.stamps_ns[-1]) for track in tracks)
    step = float(np.median([np.median(np.diff(track.stamps_ns)) for track in tracks]))
    count = int(np.clip((end - start) / step + 1, 2, _MOST_SAMPLES))
    stamps_ns = np.linspace(start, end, count).astype(np.int64)
    poses = np.broadcast_to(np.eye(4), (len(tracks), count, 4, 4)).copy()
    known = np.zeros((len(tracks), count), dtype=np.bool_)
    for s, track in enumerate(tracks):
        left = left_of(track.stamps_ns, stamps_ns)
        known[s] = ((stamps_ns >= track.stamps_ns[0]) & (stamps_ns <= track.stamps_ns[-1])
                    & (np.diff(track.stamps_ns)[left] <= max_gap_ns))
        poses[s, known[s]] = interpolate(
            track.stamps_ns, track.poses, stamps_ns[known[s]], max_gap_ns=max_gap_ns)
    return Grid(stamps_ns, poses, known)


def window_levels(grid: Grid) -> list[WindowLevel]:
    """Return the windows of every length, the shortest first."""
    # Each node has a pose of the reference, and the pose of the base from each sensor.
    (reference, of_pose), poses = _reference(grid), grid.poses
    jacobian = np.broadcast_to(-np.eye(6), (len(reference), 6, 6))
    covered = grid.known.astype(np.float64)
    information = np.broadcast_to(of_pose, (len(reference), 6, 6))
    levels: list[WindowLevel] = []
    while len(reference) >= 2 * _FEWEST_WINDOWS:
        count = len(reference) // 2 * 2
        left, right = slice(0, count, 2), slice(1, count, 2)
        to_middle = se3.inverse(reference[left]) @ reference[right]
        carry = se3.adjoint(se3.inverse(to_middle))
        from_left = poses[:, left] @ to_middle
        differences = se3.log_se3(se3.inverse(from_left) @ poses[:, right])
        of_left = carry @ jacobian[left]
        both = (covered[:, left] >= _COVERED) & (covered[:, right] >= _COVERED)
        levels.append(WindowLevel(
            samples=2**len(levels),
            metres=float(np.mean(np.linalg.norm(to_middle[:, :3, 3], axis=1))),
            differences=np.where(both[:, :, None], differences, 0.0),
            jacobian=jacobian[right] - of_left,
            known=both))
        # Weighted mean of both halves, at the start of the second one.
        carried = se3.adjoint(to_middle)
        of_first = np.swapaxes(carried, 1, 2) @ information[left] @ carried
        share = np.linalg.solve(of_first + information[right], information[right])
        step_to = np.einsum('wij,swj->swi', share, differences)
        only_right = (covered[:, left] == 0) & (covered[:, right] > 0)
        only_left = (covered[:, right] == 0) & (covered[:, left] > 0)
        merged = from_left @ se3.exp_se3(np.where(only_left[:, :, None], 0.0, step_to))
        poses = np.where(only_right[:, :, None, None], poses[:, right], merged)
        jacobian = of_left + share @ (jacobian[right] - of_left)
        information = of_first + information[right]
        covered = 0.5 * (covered[:, left] + covered[:, right])
        reference = reference[right]
    return levels


def _reference(grid: Grid) -> tuple[FloatArray, FloatArray]:
    """Return the (K, 4, 4) reference track and the (6, 6) information of one pose.

    Each step is from the sensor with the most samples that covers it. The information weights
    positions against orientations.
    """
    order = np.argsort(-grid.known.sum(axis=1), kind='stable')
    both = grid.known[:, :-1] & grid.known[:, 1:]
    steps = se3.inverse(grid.poses[:, :-1]) @ grid.poses[:, 1:]
    best = steps[order[np.argmax(both[order], axis=0)], np.arange(both.shape[1])]
    # Steps that no sensor covers are in no window.
    best[~both.any(axis=0)] = np.eye(4)
    squares = se3.log_se3((se3.inverse(best) @ steps)[both])**2
    squares = squares[squares.any(axis=1)].reshape(-1, 2, 3).sum(axis=2)
    medians = np.median(squares, axis=0) if len(squares) else np.ones(2)
    return (np.stack(list(accumulate(best, np.matmul, initial=np.eye(4)))),
            np.diag(np.repeat(1.0 / np.maximum(medians, 1e-20), 3)))
