# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Clock offset between two sensors, from their rotations.

Both sensors of a vehicle rotate by the same angles, about axes that differ by one constant
rotation. This gives the clock offset before the extrinsic is known. Candidates come from a grid
(``cross_correlation.py``) and are refined between its cells. Periodic or short motion fits several
offsets: of those that are not significantly worse, the one nearest to the given offset is taken,
and the others are reported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import AssociationError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.time_alignment.clock_drift import (
    find_clock_drift,
    half_width_ns,
    offset_deviation,
)
from trajectory_calibration.time_alignment.cross_correlation import (
    chance_ratio,
    find_coarse_offset,
)
from trajectory_calibration.time_alignment.rotation_increments import (
    is_significant,
    kabsch_gain,
    RotationIncrements,
    STEP_SHARE,
)

# Correlation below which the two sensors did not rotate together.
_LEAST_CORRELATION = 0.3


@dataclass(frozen=True)
class ClockOffset:
    """The clock offset of b, from the rotations.

    Attributes
    ----------
    seconds : offset to be added to the stamps of b.
    std : standard deviation of the offset, seconds.
    correlation : of the rotations at that offset, 0 to 1.
    cell_ns : length of a cell of the coarse search.
    alternatives : other offsets, seconds, that do not fit significantly worse.

    """

    seconds: float
    std: float
    correlation: float
    cell_ns: int
    alternatives: tuple[float, ...] = ()

    @property
    def significant(self) -> bool:
        """Return whether the sensors rotated together and the offset is not zero."""
        return self.correlation >= _LEAST_CORRELATION and is_significant(self.seconds, self.std)


@dataclass(frozen=True)
class ClockCorrection:
    """The correction of the stamps of b to the clock of a.

    Attributes
    ----------
    offset_s : seconds to add to the stamps of b after the drift correction.
    drift : correction of the rate of the clock of b, s/s (``Trajectory.retimed``).
    drift_from_ns : stamp of b at which the drift correction is zero.
    drift_std : standard deviation of the drift, s/s.
    uneven_s : largest deviation of the clock of b from a constant drift, seconds.
    alternatives_s : other clock offsets that fit as well, seconds.

    """

    offset_s: float
    drift: float = 0.0
    drift_from_ns: int = 0
    drift_std: float = 0.0
    uneven_s: float = 0.0
    alternatives_s: tuple[float, ...] = ()

    def findings(self, given_s: float, frame_b: str, duration_b_s: float) -> tuple[Finding, ...]:
        """Return the findings about the clocks; ``given_s`` is the offset of the settings."""
        found = []
        if self.offset_s != given_s:
            offset_s = self.offset_s - given_s
            found.append(Finding(
                'clock-offset', f'clock offset {1e3 * offset_s:+.1f} ms found from the rotation '
                f'of both sensors and added to the stamps of {frame_b}', {'offset_s': offset_s}))
        if self.alternatives_s:
            others = ', '.join(f'{seconds:+.3f} s' for seconds in self.alternatives_s[:3])
            fits = 'fits' if len(self.alternatives_s) == 1 else 'fit'
            found.append(Finding(
                'clock-ambiguous', f'Clock offset ambiguous: {others} {fits} as well, with '
                'another extrinsic. Record irregular motion, or fix time_offset with '
                'time_offset_mode fixed', {'others_s': list(self.alternatives_s)}))
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
    """Merge the clock offset of the alignment and that of the solver into one finding."""
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
) -> ClockCorrection:
    """Return the correction of the stamps of b.

    ``mode`` is 'fixed' (use ``time_offset_s``), 'estimate' (search within ``max_offset_s`` of it)
    or 'auto' (the same, used if significantly different). Unless the mode is 'fixed', a
    significant clock drift is corrected as well.

    Raise AssociationError if the mode is 'estimate' and no offset is found.
    """
    if mode == 'fixed' or max_offset_s == 0:
        return ClockCorrection(time_offset_s)
    shift_ns = round(time_offset_s * 1e9)
    shifted = b if shift_ns == 0 else replace(b, stamps_ns=b.stamps_ns + shift_ns)
    found = find_clock_offset(a, shifted, max_offset_s)
    if found is None or found.correlation < _LEAST_CORRELATION:
        if mode == 'auto':
            return ClockCorrection(time_offset_s)
        raise AssociationError(
            f'the clock offset within {max_offset_s:g} s cannot be found: {a.sensor_frame} and '
            f'{b.sensor_frame} did not turn together; set time_offset_mode to fixed, or '
            'raise max_time_offset')
    alternatives = tuple(time_offset_s + seconds for seconds in found.alternatives)
    seconds = found.seconds if mode == 'estimate' or found.significant else 0.0
    drift = find_clock_drift(a, shifted, round(seconds * 1e9), found.cell_ns)
    if drift is not None:
        retimed = find_clock_offset(
            a, shifted.retimed(drift.rate, drift.from_ns), max_offset_s)
        # The offset of the drifting clock is not that of the corrected one.
        if retimed is not None:
            return ClockCorrection(
                time_offset_s + retimed.seconds, drift.rate, drift.from_ns - shift_ns, drift.std,
                drift.uneven_s, alternatives)
    return ClockCorrection(time_offset_s + seconds, alternatives_s=alternatives)


def find_clock_offset(
    a: Trajectory, b: Trajectory, max_offset_s: float,
) -> ClockOffset | None:
    """Return the clock offset of b within ``max_offset_s``.

    None where the trajectories overlap or rotate too little, or fit best at the limit or beyond
    it. The offset is then unknown, which is no error if the clocks agree.
    """
    coarse = find_coarse_offset(a, b, max_offset_s)
    if coarse is None:
        return None
    minima: list[_Minimum] = []
    for start_ns in coarse.starts_ns:
        minimum = _local_minimum(a, b, start_ns, coarse.cell_ns)
        # Beyond the limit it is the edge of a minimum that was not searched.
        within = minimum is not None and abs(minimum.seconds) <= max_offset_s
        if not within and not minima:
            return None
        if minimum is not None and within:
            minima.append(minimum)
    best = min(minima, key=lambda minimum: minimum.disagreement)
    candidates = [minimum for minimum in minima if not minimum.is_worse_than(best)]
    nearest = min(candidates, key=lambda minimum: abs(minimum.seconds))
    # Several starts may lead to one minimum.
    cell_s = coarse.cell_ns * 1e-9
    alternatives = {round(minimum.seconds / cell_s): minimum.seconds for minimum in candidates
                    if abs(minimum.seconds - nearest.seconds) > cell_s}
    return ClockOffset(nearest.seconds, nearest.std, coarse.correlation, coarse.cell_ns,
                       tuple(sorted(alternatives.values(), key=abs)))


def _local_minimum(a: Trajectory, b: Trajectory, start_ns: int, cell_ns: int) -> _Minimum | None:
    """Return the local minimum of the disagreement near a first guess, or None."""
    # Restarted from the end of its range.
    for _ in range(6):
        increments = RotationIncrements.over_windows(a, b, start_ns, cell_ns)
        found = None if increments is None else _refine(increments, cell_ns * 1e-9)
        if increments is None or found is None:
            return None
        shift, minimum = found
        if minimum is not None:
            scatter = offset_deviation(increments, shift, half_width_ns(a, cell_ns))
            minimum = minimum._replace(
                seconds=start_ns * 1e-9 + shift, std=max(minimum.std, scatter))
            return _zero_unless_better(increments, minimum, start_ns)
        # The minimum is farther away: interpolated noise may put the first guess off by cells.
        start_ns += round(shift * 1e9)
    return None


class _Minimum(NamedTuple):
    """A local minimum of the disagreement.

    ``seconds`` and ``std`` are the offset and its standard deviation, ``disagreement`` is the mean
    squared difference of the rotations over a window, squared radians, and ``samples`` the number
    of independent windows.
    """

    seconds: float
    std: float
    disagreement: float
    samples: float

    def is_worse_than(self, other: _Minimum) -> bool:
        """Return whether the disagreement is significantly larger than at another minimum."""
        chance = chance_ratio(np.array(self.samples), other.samples)
        return self.disagreement > other.disagreement * float(chance)


def _refine(increments: RotationIncrements, cell_s: float) -> tuple[float, _Minimum | None] | None:
    """Return the shift to the least disagreement, seconds, and the minimum there.

    The minimum is None if it is out of reach in the direction of the shift. The result is None if
    there is no minimum at all.
    """
    step_a_s = increments.a.usual_step_ns * 1e-9
    # The last parabolas are narrower, but not much less than a step of a: interpolation halves
    # the noise between two poses, which has a minimum of its own where stamps coincide.
    widest = 1.5 * cell_s
    last = min(max(0.75 * step_a_s, 0.3 * cell_s), widest)
    around = np.linspace(-1.0, 1.0, 9)
    shift, curvature = 0.0, 0.0
    for reach_s in (widest, widest, last, last):
        values, noise = _disagreement(increments, shift + reach_s * around)
        # Interpolation averages noise, most half-way between two poses. The reduction is no
        # agreement: it is one more regressor.
        columns = np.column_stack([around**2, around, np.ones_like(around), noise - noise.mean()])
        square, slope, *_ = np.linalg.lstsq(columns, values, rcond=1e-3)[0]
        curvature, slope = 2 * float(square) / reach_s**2, float(slope) / reach_s
        # Rotation at a constant rate fits at any offset, but for rounding.
        if curvature * reach_s**2 <= se3.ROUNDING * increments.energy_b:
            return None
        shift -= slope / curvature
        if abs(shift) > widest:
            return float(np.clip(shift, -widest, widest)), None
    # Without noise the disagreement is rounding, maybe negative, plus the interpolation error.
    rest = (max(_disagreement_at(increments, shift), 0.0)
            + 0.5 * curvature * (STEP_SHARE * step_a_s)**2)
    variance = rest / (3 * len(increments)) * increments.overlapping
    std = np.hypot(np.sqrt(2 * variance / curvature), STEP_SHARE * step_a_s)
    return shift, _Minimum(
        shift, float(std), rest / len(increments), len(increments) / increments.overlapping)


def _disagreement(
    increments: RotationIncrements, shifts_s: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return (S,) sums of squared differences after (S,) shifts, and (S,) noise variances of a."""
    shifts_ns = np.rint(1e9 * shifts_s).astype(np.int64)
    rotations_a, noise = increments.rotations_a_with_noise(shifts_ns)
    M = np.moveaxis(rotations_a, -1, -2) @ increments.rotations_b
    return (rotations_a**2).sum(axis=(1, 2)) + increments.energy_b - 2 * kabsch_gain(M), noise


def _disagreement_at(increments: RotationIncrements, shift_s: float) -> float:
    return float(_disagreement(increments, np.array([shift_s]))[0][0])


def _zero_unless_better(
    increments: RotationIncrements, minimum: _Minimum, start_ns: int,
) -> _Minimum:
    """Return an offset of zero if the two sensors agree there as well as at the minimum.

    At low rates the interpolation error exceeds the noise and moves the minimum. It is zero where
    the stamps coincide.
    """
    if abs(start_ns) > increments.a.usual_step_ns:
        return minimum
    at_zero = _disagreement_at(increments, -start_ns * 1e-9) / len(increments)
    if at_zero > minimum.disagreement:
        return minimum
    return minimum._replace(seconds=0.0, std=max(minimum.std, abs(minimum.seconds)))
