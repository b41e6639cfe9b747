# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What every sensor says of the same stretches of time.

All tracks are carried into the base and sampled on one grid. Each window of a dyadic grid (2, 4,
8 ... samples) is halved. A sensor that drifts sees its two halves apart: the *difference* of a
window is the step from where the first half says that the base is at the middle to where the
second half says so, against a reference track, as a twist (rho, phi) in the frame of the base.
These are Haar's wavelets: the differences of one length are uncorrelated with those of another
for white noise, and nearly so for a random walk, and together they hold all that the track says
about an extrinsic (A. Haar, Math. Ann. 69, 1910, doi:10.1007/BF01456326).

The reference track cancels in what two sensors differ by, so it need not be good.
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

# More samples of the grid than this change no covariance.
_MOST_SAMPLES = 8192

# Both halves of a window hold at least this share of a sensor's samples, or the window has none.
_COVERED = 0.7

# Fewer windows of a length than this do not tell its noise.
_FEWEST_WINDOWS = 4


@dataclass(frozen=True)
class Clock:
    """Stamps t of a sensor are ``t + drift (t - epoch_ns) + offset_s`` in the base.

    Attributes
    ----------
    offset_s : seconds added to the stamps at the epoch.
    drift : seconds a second.
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
    samples : of the grid in half a window; the windows follow one another from the first sample.
    metres : driven from the middle of the first half to that of the second, on average.
    differences : (S, W, 6), of each sensor and window, base frame, metres and radians.
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
    """One sensor in the clock and unit of the base, (N,) nanoseconds and (N, 4, 4) poses."""

    stamps_ns: NDArray[np.int64]
    poses: FloatArray


@dataclass(frozen=True, eq=False)
class Grid:
    """All sensors carried into the base, at common times.

    Attributes
    ----------
    stamps_ns : (K,).
    poses : (S, K, 4, 4), the base in the world of each sensor; identity where unknown.
    known : (S, K).

    """

    stamps_ns: NDArray[np.int64]
    poses: FloatArray
    known: NDArray[np.bool_]


def track_of(trajectory: Trajectory, clock: Clock, scale: float, X: FloatArray) -> Track:
    """Return the track of the base that a sensor with the pose ``X`` (4, 4) in it has driven."""
    late_ns = np.rint(1e9 * clock.at(trajectory.stamps_ns)).astype(np.int64)
    return Track(trajectory.stamps_ns + late_ns,
                 trajectory.scaled(scale).poses @ se3.inverse(X))


def common_grid(tracks: list[Track], max_gap_ns: int) -> Grid:
    """Sample (S,) tracks, which are carried into the base, from the first pose to the last."""
    begin = min(int(track.stamps_ns[0]) for track in tracks)
    end = max(int(track.stamps_ns[-1]) for track in tracks)
    step = float(np.median([np.median(np.diff(track.stamps_ns)) for track in tracks]))
    count = int(np.clip((end - begin) / step + 1, 2, _MOST_SAMPLES))
    stamps_ns = np.linspace(begin, end, count).astype(np.int64)
    poses = np.broadcast_to(np.eye(4), (len(tracks), count, 4, 4)).copy()
    known = np.zeros((len(tracks), count), dtype=np.bool_)
    for s, track in enumerate(tracks):
        left = left_of(track.stamps_ns, stamps_ns)
        known[s] = ((stamps_ns >= track.stamps_ns[0]) & (stamps_ns <= track.stamps_ns[-1])
                    & (np.diff(track.stamps_ns)[left] <= max_gap_ns))
        poses[s, known[s]] = interpolate(
            track.stamps_ns, track.poses, stamps_ns[known[s]], max_gap_ns=max_gap_ns)
    return Grid(stamps_ns, poses, known)


def levels_of(grid: Grid) -> list[WindowLevel]:
    """Return the windows of every length, the shortest first."""
    # A node: where the base is (its sample of the reference) and what each sensor says of it.
    (at, of_pose), said = _reference(grid), grid.poses
    jacobian = np.broadcast_to(-np.eye(6), (len(at), 6, 6))
    covered = grid.known.astype(np.float64)
    information = np.broadcast_to(of_pose, (len(at), 6, 6))
    levels: list[WindowLevel] = []
    while len(at) >= 2 * _FEWEST_WINDOWS:
        count = len(at) // 2 * 2
        left, right = slice(0, count, 2), slice(1, count, 2)
        to_middle = se3.inverse(at[left]) @ at[right]
        carry = se3.adjoint(se3.inverse(to_middle))
        from_left = said[:, left] @ to_middle
        apart = se3.log_se3(se3.inverse(from_left) @ said[:, right])
        of_left = carry @ jacobian[left]
        both = (covered[:, left] >= _COVERED) & (covered[:, right] >= _COVERED)
        levels.append(WindowLevel(
            samples=2**len(levels),
            metres=float(np.mean(np.linalg.norm(to_middle[:, :3, 3], axis=1))),
            differences=np.where(both[:, :, None], apart, 0.0),
            jacobian=jacobian[right] - of_left,
            known=both))
        # What both halves know, where the second one begins.
        carried = se3.adjoint(to_middle)
        of_first = np.swapaxes(carried, 1, 2) @ information[left] @ carried
        share = np.linalg.solve(of_first + information[right], information[right])
        step_to = np.einsum('wij,swj->swi', share, apart)
        only_right = (covered[:, left] == 0) & (covered[:, right] > 0)
        only_left = (covered[:, right] == 0) & (covered[:, left] > 0)
        merged = from_left @ se3.exp_se3(np.where(only_left[:, :, None], 0.0, step_to))
        said = np.where(only_right[:, :, None, None], said[:, right], merged)
        jacobian = of_left + share @ (jacobian[right] - of_left)
        information = of_first + information[right]
        covered = 0.5 * (covered[:, left] + covered[:, right])
        at = at[right]
    return levels


def _reference(grid: Grid) -> tuple[FloatArray, FloatArray]:
    """Return (K, 4, 4) the base in one world: its steps as the best covered sensor has them.

    Also the (6, 6) information of one pose: how positions and attitudes compare.
    """
    order = np.argsort(-grid.known.sum(axis=1), kind='stable')
    both = grid.known[:, :-1] & grid.known[:, 1:]
    steps = se3.inverse(grid.poses[:, :-1]) @ grid.poses[:, 1:]
    best = steps[order[np.argmax(both[order], axis=0)], np.arange(both.shape[1])]
    # What nobody covers is no window of anybody: any step will do.
    best[~both.any(axis=0)] = np.eye(4)
    squares = se3.log_se3((se3.inverse(best) @ steps)[both])**2
    squares = squares[squares.any(axis=1)].reshape(-1, 2, 3).sum(axis=2)
    usual = np.median(squares, axis=0) if len(squares) else np.ones(2)
    return (np.stack(list(accumulate(best, np.matmul, initial=np.eye(4)))),
            np.diag(np.repeat(1.0 / np.maximum(usual, 1e-20), 3)))
