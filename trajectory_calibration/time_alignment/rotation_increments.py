# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Rotations of two sensors over the same short windows of time: the data of clock alignment."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.interpolation import left_of
from trajectory_calibration.geometry.se3 import FloatArray

# The motion between two poses of a is interpolated: uncertainty as a share of the median step.
STEP_SHARE = 0.005

# What differs by more than this many standard deviations is no chance.
SIGNIFICANT = 5.0


@dataclass(frozen=True, eq=False)
class RotationIncrements:
    """Rotations of b over K windows of time, and of a over the same or shifted windows.

    Attributes
    ----------
    a : trajectory a.
    starts_ns, ends_ns : (K,) int64, start and end of each window in the clock of a.
    middle_ns : middle of the common time span, in the clock of a.
    duration_s : length of the common time span, seconds.
    rotations_b : (K, 3) rotation vectors in the axes of b.
    overlapping : number of windows that overlap at any time and so share noise.

    """

    a: Trajectory
    starts_ns: NDArray[np.int64]
    ends_ns: NDArray[np.int64]
    middle_ns: int
    duration_s: float
    rotations_b: FloatArray
    overlapping: int

    @classmethod
    def over_windows(
        cls, a: Trajectory, b: Trajectory, offset_ns: int, cell_ns: int,
    ) -> RotationIncrements | None:
        """Return the rotations of b in the clock of a; None if there are too few windows.

        ``offset_ns`` is added to the stamps of b; ``cell_ns`` is the cell of the coarse search.
        """
        step = b.poses_in(max(2 * cell_ns, 300_000_000))
        if len(b) <= step:
            return None
        i, stride = _spread_evenly(len(b) - step)
        j = i + step
        times = b.stamps_ns + offset_ns
        reach = 3 * cell_ns
        usable = (_covered(a, times[i], reach) & _covered(a, times[j], reach)
                  & (times[j] - times[i] <= 2 * step * b.usual_step_ns))
        rotations_b = se3.log_so3(np.swapaxes(b.rotations[i], 1, 2) @ b.rotations[j])
        usable &= np.linalg.norm(rotations_b, axis=1) < se3.LARGEST_ROTATION
        if usable.sum() < 3 * step:
            return None
        first, last = max(a.stamps_ns[0], times[0]), min(a.stamps_ns[-1], times[-1])
        return cls(
            a, times[i[usable]], times[j[usable]], int(first + (last - first) // 2),
            float(last - first) * 1e-9, rotations_b[usable], -(-step // stride))

    def __len__(self) -> int:
        return len(self.rotations_b)

    @cached_property
    def energy_b(self) -> float:
        """Return the sum of the squared rotation angles of b, squared radians."""
        return float(np.sum(self.rotations_b**2))

    def rotations_a(self, shift_ns: int = 0, drift: float = 0.0) -> FloatArray:
        """Return the (K, 3) rotation vectors of a, in its axes, over shifted windows.

        The shift is ``shift_ns`` at ``middle_ns`` and changes by ``drift`` seconds per second.
        """
        return self.rotations_a_with_noise(np.array([shift_ns]), drift)[0][0]

    def rotations_a_with_noise(
        self, shifts_ns: NDArray[np.int64], drift: float = 0.0,
    ) -> tuple[FloatArray, FloatArray]:
        """Return ``rotations_a`` for (S,) shifts, (S, K, 3), and their (S,) noise variances.

        The variances are relative to that of a pose, summed over both ends of a window, averaged
        over the windows. Interpolation half-way between two poses halves the variance.
        """
        (start, at_start), (end, at_end) = map(
            self._rotation_at, self._moved(shifts_ns[:, None], drift))
        return _rotations_between(start, end), at_start + at_end

    def known(self, shift_ns: int, drift: float, reach_ns: int) -> NDArray[np.bool_]:
        """Return which shifted windows start and end outside the gaps of a and far from its ends.

        ``reach_ns`` is the required distance from both ends of a.
        """
        start, end = (_covered(self.a, times, reach_ns) for times in self._moved(shift_ns, drift))
        return start & end

    def _moved(
        self, shift_ns: int | NDArray[np.int64], drift: float,
    ) -> list[NDArray[np.int64]]:
        """Return the starts and the ends of the shifted windows."""
        return [times + np.rint(drift * (times - self.middle_ns)).astype(np.int64) + shift_ns
                for times in (self.starts_ns, self.ends_ns)]

    def _rotation_at(self, times: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Return (4, S, K) quaternions of a at (S, K) times, and their (S,) noise variances."""
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
        """(4, N) quaternions x, y, z, w of a, signs chosen so that neighbours can be blended."""
        q = np.ascontiguousarray(se3.rotation_to_quaternion(self.a.rotations).T)
        dots = np.einsum('in,in->n', q[:, :-1], q[:, 1:])
        q[:, 1:] *= np.cumprod(np.where(dots < 0, -1.0, 1.0))
        return q

    @cached_property
    def _steps(self) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
        """(N - 1,) duration (ns), half angle and its sine of each step of a; never zero."""
        half = 0.5 * np.linalg.norm(self.a.turns, axis=1)
        half = np.maximum(half, 1e-150)
        return np.diff(self.a.stamps_ns), half, np.sin(half)


def _rotations_between(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the (S, K, 3) rotation vectors between (4, S, K) quaternions, in body axes."""
    (x, y, z, w), (u, v, t, c) = start, end
    axis = np.stack([
        w * u - c * x - y * t + z * v,
        w * v - c * y - z * u + x * t,
        w * t - c * z - x * v + y * u])
    cosine = w * c + x * u + y * v + z * t
    sine = np.maximum(np.sqrt(np.einsum('isk,isk->sk', axis, axis)), 1e-150)
    axis *= np.copysign(2 * np.arctan2(sine, np.abs(cosine)) / sine, cosine)
    return np.moveaxis(axis, 0, -1)


def _spread_evenly(count: int) -> tuple[NDArray[np.intp], int]:
    """Return the indices of some 5,000 of ``count`` windows, and the mean stride.

    The strides vary: equal ones can be in phase with a periodic motion (a turn every two seconds),
    which biased the clock offset by 10 ms.
    """
    stride = max(1, count // 5_000)
    first = np.arange(0, count - stride + 1, stride)
    # Fractional parts of multiples of the golden ratio fill an interval without a period.
    golden = (np.sqrt(5.0) - 1) / 2
    return first + (stride * (golden * np.arange(len(first)) % 1.0)).astype(np.intp), stride


def kabsch_gain(covariance: FloatArray) -> FloatArray:
    """Return (S,) the maximum of trace(R M) over all rotations R, for (S, 3, 3) matrices M.

    W. Kabsch, Acta Cryst. A32, 1976, doi:10.1107/S0567739476001873.
    """
    singular = np.linalg.svd(covariance, compute_uv=False)
    # R must not be a reflection: with det M < 0 the smallest singular value is subtracted.
    gain: FloatArray = (
        singular.sum(axis=1) - 2 * singular[:, 2] * (np.linalg.det(covariance) < 0))
    return gain


def is_significant(value: float, std: float, seconds: float = 1.0) -> bool:
    """Return whether an offset, or a drift over ``seconds``, is significant and beyond 1 ms."""
    return abs(value) > max(SIGNIFICANT * std, 1e-3 / seconds)


def _covered(a: Trajectory, times: NDArray[np.int64], reach: int) -> NDArray[np.bool_]:
    """Return which times are outside the gaps of a and at least ``reach`` from its ends."""
    stamps = a.stamps_ns
    inside = (times - reach >= stamps[0]) & (times + reach <= stamps[-1])
    left = np.clip(np.searchsorted(stamps, times, side='right') - 1, 0, len(stamps) - 2)
    return inside & ~a.gaps[left]
