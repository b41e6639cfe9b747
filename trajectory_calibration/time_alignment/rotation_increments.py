# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""How far two sensors turned over the same short times: what tells of their clocks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.interpolation import left_of
from trajectory_calibration.geometry.se3 import FloatArray

# Length of the windows, in cells and nanoseconds; of more than twice this many some are used.
_WINDOW_CELLS = 2
_WINDOW_NS = 300_000_000
_WINDOWS = 5_000

# Multiples of it, less their whole parts, fill an interval evenly and without a period.
_GOLDEN = (np.sqrt(5.0) - 1) / 2

# Cells that a window keeps from the ends of a.
_REACH_CELLS = 3

# Larger rotations (radians) are left out: half a turn one way is half a turn the other way.
_MAX_ANGLE = 2.5

# A difference of sums of squares that is this share of them is rounding.
ROUNDING = 1e-12

# Motion between the poses of a is not known; this share of their usual step is uncertain.
STEP_SHARE = 0.005

# What is told from zero exceeds so many standard deviations; clocks that are apart by so many
# seconds are so as if they were not.
_SIGNIFICANT = 5.0
_NEGLIGIBLE_S = 1e-3


@dataclass(frozen=True, eq=False)
class Turning:
    """The turning of b over K windows of time, and that of a over the same ones or moved ones.

    Attributes
    ----------
    a : the trajectory of a.
    starts_ns, ends_ns : (K,) int64, the windows in the clock of a.
    middle_ns : of the time that both have in common, in the clock of a.
    duration_s : of that time.
    of_b : (K, 3) rotation vectors in the axes of b.
    overlapping : windows that share their noise.

    """

    a: Trajectory
    starts_ns: NDArray[np.int64]
    ends_ns: NDArray[np.int64]
    middle_ns: int
    duration_s: float
    of_b: FloatArray
    overlapping: int

    @classmethod
    def over_windows(
        cls, a: Trajectory, b: Trajectory, offset_ns: int, cell_ns: int,
    ) -> Turning | None:
        """Return the turning of b in the clock of a; None where too little of it is known.

        ``offset_ns`` is added to the stamps of b; cells of ``cell_ns`` resolve the motion.
        """
        step = b.poses_in(max(_WINDOW_CELLS * cell_ns, _WINDOW_NS))
        if len(b) <= step:
            return None
        i, stride = _spread(len(b) - step)
        j = i + step
        times = b.stamps_ns + offset_ns
        reach = _REACH_CELLS * cell_ns
        usable = (_covered(a, times[i], reach) & _covered(a, times[j], reach)
                  & (times[j] - times[i] <= 2 * step * b.usual_step_ns))
        of_b = se3.log_so3(np.swapaxes(b.rotations[i], 1, 2) @ b.rotations[j])
        usable &= np.linalg.norm(of_b, axis=1) < _MAX_ANGLE
        if usable.sum() < 3 * step:
            return None
        first, last = max(a.stamps_ns[0], times[0]), min(a.stamps_ns[-1], times[-1])
        return cls(
            a, times[i[usable]], times[j[usable]], int(first + (last - first) // 2),
            float(last - first) * 1e-9, of_b[usable], -(-step // stride))

    def __len__(self) -> int:
        return len(self.of_b)

    @cached_property
    def turned(self) -> float:
        """Return the sum of the squared rotations of b, squared radians."""
        return float(np.sum(self.of_b**2))

    def of_a(self, shift_ns: int = 0, drift: float = 0.0) -> FloatArray:
        """Return the (K, 3) rotation vectors of a, in its axes, over the moved windows.

        These are later by ``shift_ns`` in the middle, and by ``drift`` (s/s) more from there on.
        """
        return self.of_a_with_noise(np.array([shift_ns]), drift)[0][0]

    def of_a_with_noise(
        self, shifts_ns: NDArray[np.int64], drift: float = 0.0,
    ) -> tuple[FloatArray, FloatArray]:
        """Return (S, K, 3), ``of_a`` for (S,) shifts, and (S,) how much of the noise is in it.

        That is the mean over the windows of the variances at both ends, for a variance of one of a
        pose: half-way between two poses half of it is left.
        """
        (start, at_start), (end, at_end) = map(
            self._rotation_at, self._moved(shifts_ns[:, None], drift))
        return _turn_between(start, end), at_start + at_end

    def known(self, shift_ns: int, drift: float, reach_ns: int) -> NDArray[np.bool_]:
        """Tell which of the moved windows begin and end in no gap of a, nor near its ends."""
        start, end = (_covered(self.a, times, reach_ns) for times in self._moved(shift_ns, drift))
        return start & end

    def _moved(
        self, shift_ns: int | NDArray[np.int64], drift: float,
    ) -> list[NDArray[np.int64]]:
        """Return the beginnings and the ends of the moved windows."""
        return [times + np.rint(drift * (times - self.middle_ns)).astype(np.int64) + shift_ns
                for times in (self.starts_ns, self.ends_ns)]

    def _rotation_at(self, times: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Return (4, S, K) quaternions of a at (S, K) times, and the (S,) noise in them."""
        left = left_of(self.a.stamps_ns, times)
        begin, step_ns, half, sine = (np.take(values, left) for values in (
            self.a.stamps_ns, *self._steps))
        fraction = (times - begin) / step_ns
        rest = 1.0 - fraction
        q = np.sin(rest * half) / sine * np.take(self._quaternions, left, axis=1)
        q += np.sin(fraction * half) / sine * np.take(self._quaternions, left + 1, axis=1)
        return q, np.mean(fraction * fraction + rest * rest, axis=1)

    @cached_property
    def _quaternions(self) -> FloatArray:
        """(4, N), x, y, z, w of a; neighbours on the same side, to be interpolated as they are."""
        q = np.ascontiguousarray(se3.rotation_to_quaternion(self.a.rotations).T)
        dots = np.einsum('in,in->n', q[:, :-1], q[:, 1:])
        q[:, 1:] *= np.cumprod(np.where(dots < 0, -1.0, 1.0))
        return q

    @cached_property
    def _steps(self) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
        """(N - 1,) of the steps of a: nanoseconds, half of the angle, its sine; never zero."""
        half = 0.5 * np.linalg.norm(self.a.turns, axis=1)
        half = np.maximum(half, 1e-150)
        return np.diff(self.a.stamps_ns), half, np.sin(half)


def _turn_between(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return (S, K, 3) rotation vectors from (4, S, K) quaternions to others, in their axes."""
    (x, y, z, w), (u, v, t, c) = start, end
    axis = np.stack([
        w * u - c * x - y * t + z * v,
        w * v - c * y - z * u + x * t,
        w * t - c * z - x * v + y * u])
    cosine = w * c + x * u + y * v + z * t
    sine = np.maximum(np.sqrt(np.einsum('isk,isk->sk', axis, axis)), 1e-150)
    axis *= np.copysign(2 * np.arctan2(sine, np.abs(cosine)) / sine, cosine)
    return np.moveaxis(axis, 0, -1)


def _spread(count: int) -> tuple[NDArray[np.intp], int]:
    """Return which of ``count`` windows are used, and one of how many.

    Even strides may be in step with what a driver does: turns that change every two seconds would
    all be cut at the same place, and a clock offset of 10 ms be proved that is none.
    """
    stride = max(1, count // _WINDOWS)
    first = np.arange(0, count - stride + 1, stride)
    return first + (stride * (_GOLDEN * np.arange(len(first)) % 1.0)).astype(np.intp), stride


def largest_gain(covariance: FloatArray) -> FloatArray:
    """Return the (S,) largest traces of (S, 3, 3) matrices times a rotation: Kabsch's gain."""
    singular = np.linalg.svd(covariance, compute_uv=False)
    # A mirror image is no rotation: with a negative determinant the least one counts against.
    gain: FloatArray = (
        singular.sum(axis=1) - 2 * singular[:, 2] * (np.linalg.det(covariance) < 0))
    return gain


def is_significant(value: float, std: float, seconds: float = 1.0) -> bool:
    """Tell whether a value is out of its error, and adds up to something in so many seconds."""
    return abs(value) > max(_SIGNIFICANT * std, _NEGLIGIBLE_S / seconds)


def _covered(a: Trajectory, times: NDArray[np.int64], reach: int) -> NDArray[np.bool_]:
    """Tell which times lie in no gap of a, and no nearer to its ends than ``reach``."""
    stamps = a.stamps_ns
    inside = (times - reach >= stamps[0]) & (times + reach <= stamps[-1])
    left = np.clip(np.searchsorted(stamps, times, side='right') - 1, 0, len(stamps) - 2)
    return inside & ~a.gaps[left]
