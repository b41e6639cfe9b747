# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What takes the stamps of one sensor into the clock of another, from when each of them turned.

Both sensors turn by the same angles about axes that differ by one constant rotation, wherever
they are mounted, so that the times of turning tell the offset before anything else is known. The
offsets that a grid leaves possible (``cross_correlation.py``) are refined between its cells.
Motion that repeats itself, or is over soon, agrees at several: of those that chance leaves
undecided the one nearest to what was given is taken, and the others are named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import AssociationError
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.time_alignment.clock_drift import (
    find_clock_drift,
    half_width_ns,
    offset_deviation,
)
from trajectory_calibration.time_alignment.cross_correlation import (
    chance_factor,
    find_coarse_offset,
)
from trajectory_calibration.time_alignment.rotation_increments import (
    is_significant,
    largest_gain,
    ROUNDING,
    STEP_SHARE,
    Turning,
)

# The parabolas that refine the offset go through this many points. The first ones reach over this
# many cells to either side; the last ones less, but not much less than a step of a: a narrower
# one would follow the noise, which interpolation halves between two samples, and find a valley
# where the stamps coincide.
_POINTS = 9
_REACH_CELLS, _LAST_REACH_CELLS, _LAST_REACH_STEPS = 1.5, 0.3, 0.75
_PARABOLAS = 2
# Noise that is the same at all points, but for this share, is no column.
_FLAT = 1e-3

# Correlation below which the two did not turn together.
_LEAST_CORRELATION = 0.3

# A refinement that runs to its end starts anew from there, so many times.
_STARTS = 6


@dataclass(frozen=True)
class ClockOffset:
    """The offset of the clock of b, as its turning tells it.

    Attributes
    ----------
    seconds : to be added to the stamps of b.
    std : its standard deviation, seconds, from the scatter of the motions.
    correlation : of the rotations at that offset, 0 to 1.
    cell_ns : of the grid on which they were compared.
    rivals : other offsets, seconds, at which the two agree as well, as far as chance can tell.

    """

    seconds: float
    std: float
    correlation: float
    cell_ns: int
    rivals: tuple[float, ...] = ()

    @property
    def significant(self) -> bool:
        """Tell whether the sensors turned together, and zero is out of the question."""
        return self.correlation >= _LEAST_CORRELATION and is_significant(self.seconds, self.std)


@dataclass(frozen=True)
class Clock:
    """What takes the stamps of b into the clock of a.

    Attributes
    ----------
    offset_s : seconds to add to the stamps of b, ``retimed`` by the drift.
    drift : seconds a second by which the clock of b must run faster (``Trajectory.retimed``).
    drift_from_ns : stamp of b at which that adds nothing.
    drift_std : standard deviation of the drift.
    uneven_s : by how much the clock of b is off these at some time, seconds.
    rivals_s : other offsets that the turning allows.

    """

    offset_s: float
    drift: float = 0.0
    drift_from_ns: int = 0
    drift_std: float = 0.0
    uneven_s: float = 0.0
    rivals_s: tuple[float, ...] = ()

    def findings(self, given_s: float, frame_b: str, duration_b_s: float) -> tuple[Finding, ...]:
        """Say what was found of the clocks; ``given_s`` is the offset of the settings."""
        found = []
        if self.offset_s != given_s:
            offset_s = self.offset_s - given_s
            found.append(Finding(
                'clock-offset', f'clock offset {1e3 * offset_s:+.1f} ms found from the rotation '
                f'of both sensors and added to the stamps of {frame_b}', {'offset_s': offset_s}))
        if self.rivals_s:
            others = ', '.join(f'{seconds:+.3f} s' for seconds in self.rivals_s[:3])
            fits = 'fits' if len(self.rivals_s) == 1 else 'fit'
            found.append(Finding(
                'clock-ambiguous', f'Clock offset ambiguous: {others} {fits} as well, with '
                'another extrinsic. Record irregular motion, or fix time_offset with '
                'time_offset_mode fixed', {'others_s': list(self.rivals_s)}))
        if self.drift:
            apart_ms = abs(1e3 * self.drift * duration_b_s)
            found.append(Finding(
                'clock-drift', f'the clock of {frame_b} runs '
                f'{"slow" if self.drift > 0 else "fast"} by {abs(1e6 * self.drift):.1f} ppm '
                f'(+- {1e6 * self.drift_std:.1f} ppm), '
                f'{apart_ms:.1f} ms over the drive: corrected', {'drift_ppm': 1e6 * self.drift}))
        if self.uneven_s:
            found.append(Finding(
                'clock-uneven', f'the clock of {frame_b} deviates from a constant drift by up to '
                f'{1e3 * self.uneven_s:.1f} ms. If it was stepped, calibrate the parts separately',
                {'deviation_s': self.uneven_s}))
        return tuple(found)


def in_total(
    before_s: float, after_s: float, findings: Sequence[Finding],
) -> tuple[Finding, ...]:
    """Return findings that tell of one clock offset where the solver found more of it."""
    parts = [found for found in findings if found.code == 'clock-offset']
    if len(parts) < 2:
        return tuple(findings)
    total = Finding(
        'clock-offset', f'clock offset {1e3 * (before_s + after_s):+.1f} ms found and added to '
        f'the stamps of b: {1e3 * before_s:+.1f} ms from the rotation of both sensors, '
        f'{1e3 * after_s:+.1f} ms by the solver', {'offset_s': before_s + after_s})
    return (total, *(found for found in findings if found not in parts))


def synchronise(
    a: Trajectory, b: Trajectory, time_offset_s: float, mode: str, max_offset_s: float,
) -> Clock:
    """Return what to do with the stamps of b.

    ``mode`` is 'fixed': ``time_offset_s`` as given; 'estimate': what the turning tells, within
    ``max_offset_s`` of it; 'auto': the same where it is significantly different. Unless the mode
    is fixed, a drift of the clock is told where it is significant.

    Raise AssociationError where 'estimate' was asked for, and the turning does not tell.
    """
    if mode == 'fixed' or max_offset_s == 0:
        return Clock(time_offset_s)
    shift_ns = round(time_offset_s * 1e9)
    shifted = b if shift_ns == 0 else replace(b, stamps_ns=b.stamps_ns + shift_ns)
    found = find_clock_offset(a, shifted, max_offset_s)
    if found is None or found.correlation < _LEAST_CORRELATION:
        if mode == 'auto':
            return Clock(time_offset_s)
        raise AssociationError(
            f'the clock offset within {max_offset_s:g} s cannot be found: {a.sensor_frame} and '
            f'{b.sensor_frame} did not turn together; set time_offset_mode to fixed, or '
            'raise max_time_offset')
    rivals = tuple(time_offset_s + seconds for seconds in found.rivals)
    seconds = found.seconds if mode == 'estimate' or found.significant else 0.0
    drift = find_clock_drift(a, shifted, round(seconds * 1e9), found.cell_ns)
    if drift is not None:
        retimed = find_clock_offset(
            a, shifted.retimed(drift.rate, drift.from_ns), max_offset_s)
        # An offset of the drifting clock is none of the other one.
        if retimed is not None:
            return Clock(time_offset_s + retimed.seconds, drift.rate,
                         drift.from_ns - shift_ns, drift.std, drift.uneven_s, rivals)
    return Clock(time_offset_s + seconds, rivals_s=rivals)


def find_clock_offset(
    a: Trajectory, b: Trajectory, max_offset_s: float,
) -> ClockOffset | None:
    """Return the offset within ``max_offset_s`` at which b turned with a.

    None where the trajectories have too little time in common or did not turn, or agree best at
    the limit or beyond it: an offset cannot be told then, which is no error as long as the clocks
    agree.
    """
    coarse = find_coarse_offset(a, b, max_offset_s)
    if coarse is None:
        return None
    valleys: list[_Valley] = []
    for start_ns in coarse.starts_ns:
        valley = _valley(a, b, start_ns, coarse.cell_ns)
        # Beyond the limit it is the slope of one whose ground was not looked at.
        within = valley is not None and abs(valley.seconds) <= max_offset_s
        if not within and not valleys:
            return None
        if valley is not None and within:
            valleys.append(valley)
    lowest = min(valleys, key=lambda valley: valley.disagreement)
    ahead = [valley for valley in valleys if not valley.is_above(lowest)]
    nearest = min(ahead, key=lambda valley: abs(valley.seconds))
    # Several starts may lead to one place.
    apart_s = coarse.cell_ns * 1e-9
    rivals = {round(valley.seconds / apart_s): valley.seconds for valley in ahead
              if abs(valley.seconds - nearest.seconds) > apart_s}
    return ClockOffset(nearest.seconds, nearest.std, coarse.correlation, coarse.cell_ns,
                       tuple(sorted(rivals.values(), key=abs)))


def _valley(a: Trajectory, b: Trajectory, start_ns: int, cell_ns: int) -> _Valley | None:
    """Return the offset of least disagreement near a first guess, or None where none is."""
    for _ in range(_STARTS):
        turning = Turning.over_windows(a, b, start_ns, cell_ns)
        found = None if turning is None else _refine(turning, cell_ns * 1e-9)
        if turning is None or found is None:
            return None
        shift, valley = found
        if valley is not None:
            scatter = offset_deviation(turning, shift, half_width_ns(a, cell_ns))
            valley = valley._replace(
                seconds=start_ns * 1e-9 + shift, std=max(valley.std, scatter))
            return _no_better_than_none(turning, valley, start_ns)
        # It goes on beyond: noise that interpolation averages may put the first guess cells off.
        start_ns += round(shift * 1e9)
    return None


class _Valley(NamedTuple):
    """An offset at which the two agree better than at those around it, and its deviation.

    ``disagreement`` is the mean squared difference of their turns over a window, squared radians,
    ``samples`` the number of independent windows.
    """

    seconds: float
    std: float
    disagreement: float
    samples: float

    def is_above(self, other: _Valley) -> bool:
        """Tell whether the two agree less here, by more than chance."""
        chance = chance_factor(np.array(self.samples), other.samples)
        return self.disagreement > other.disagreement * float(chance)


def _refine(turning: Turning, cell_s: float) -> tuple[float, _Valley | None] | None:
    """Return the shift of least disagreement near that of the windows, and how good it is.

    No valley where it lies farther away than was looked, in the direction of the shift; None alone
    where there is no least disagreement.
    """
    step_a_s = turning.a.usual_step_ns * 1e-9
    widest = _REACH_CELLS * cell_s
    last = min(max(_LAST_REACH_STEPS * step_a_s, _LAST_REACH_CELLS * cell_s), widest)
    shift, curvature = 0.0, 0.0
    for reach_s in [widest] * _PARABOLAS + [last] * _PARABOLAS:
        around = np.linspace(-1.0, 1.0, _POINTS)
        values, noise = _disagreement(turning, shift + reach_s * around)
        # Interpolation averages noise, the most half-way between two poses: what it takes away
        # there is no agreement, but one more column.
        columns = np.column_stack([around**2, around, np.ones(_POINTS), noise - noise.mean()])
        square, slope, *_ = np.linalg.lstsq(columns, values, rcond=_FLAT)[0]
        curvature, slope = 2 * float(square) / reach_s**2, float(slope) / reach_s
        # Who turns at a constant rate agrees at any offset, but for rounding.
        if curvature * reach_s**2 <= ROUNDING * turning.turned:
            return None
        shift -= slope / curvature
        if abs(shift) > widest:
            return float(np.clip(shift, -widest, widest)), None
    # Without noise the disagreement is rounding, which may fall below zero, and what the motion
    # between the poses of a leaves open.
    rest = (max(_disagreement_at(turning, shift), 0.0)
            + 0.5 * curvature * (STEP_SHARE * step_a_s)**2)
    variance = rest / (3 * len(turning)) * turning.overlapping
    std = np.hypot(np.sqrt(2 * variance / curvature), STEP_SHARE * step_a_s)
    return shift, _Valley(
        shift, float(std), rest / len(turning), len(turning) / turning.overlapping)


def _disagreement(turning: Turning, shifts_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (S,) sums of squared differences after shifts, and (S,) the shares of noise in a."""
    turned_a, noise = turning.of_a_with_noise(np.rint(1e9 * shifts_s).astype(np.int64))
    M = np.moveaxis(turned_a, -1, -2) @ turning.of_b
    return (turned_a**2).sum(axis=(1, 2)) + turning.turned - 2 * largest_gain(M), noise


def _disagreement_at(turning: Turning, shift_s: float) -> float:
    return float(_disagreement(turning, np.array([shift_s]))[0][0])


def _no_better_than_none(turning: Turning, valley: _Valley, start_ns: int) -> _Valley:
    """Return an offset of zero where the two disagree there no more than at the one found.

    Of sensors with few poses a second, interpolation is worse than noise: what is found then is
    where it does the least harm, and where their stamps coincide it does none.
    """
    if abs(start_ns) > turning.a.usual_step_ns:
        return valley
    at_zero = _disagreement_at(turning, -start_ns * 1e-9) / len(turning)
    if at_zero > valley.disagreement:
        return valley
    return valley._replace(seconds=0.0, std=max(valley.std, abs(valley.seconds)))
