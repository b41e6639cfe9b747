"""What the fit says about the two trajectories, in numbers and in words."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.findings import Finding
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.fit import Fit
from trajectory_calibration.solvers.drift_aware.model import columns_of, TERM_COLUMNS

# A step is named a jump from this probability on.
_JUMP_PROBABILITY = 0.9
# A scale that far from one is no percentage any more.
_ANOTHER_UNIT = 0.3
# Jumps that a warning names; the diagnosis holds all of them.
_NAMED_JUMPS = 3


@dataclass(frozen=True)
class Jump:
    """A step in which the two trajectories part: a loop closure or a lost track.

    Attributes
    ----------
    stamp_ns : time of the pose after it.
    translation_m, rotation_rad : its size.

    """

    stamp_ns: int
    translation_m: float
    rotation_rad: float


@dataclass(frozen=True)
class Diagnosis:
    """The noise of a pair of trajectories, both sensors taken as equally noisy.

    Attributes
    ----------
    white_m, white_rad : standard deviation of the white noise of a pose, for each sensor.
    walk_m, walk_rad : of the drift after one metre; it grows with the root of the distance.
    walk_turn_m, walk_turn_rad : of the drift of a turn, per radian.
    jumps : steps in which the trajectories part, the largest first.
    scale, scale_deviation : metres of a per metre of b; the deviation is None where the scale
        was not estimated. Likewise the following.
    time_offset_s, time_offset_deviation_s : added to the stamps of b, on top of the setting.
    systematic_drift, systematic_drift_deviation : metres per metre along x, y, z of b.

    """

    white_m: float
    white_rad: float
    walk_m: float
    walk_rad: float
    walk_turn_m: float
    walk_turn_rad: float
    jumps: tuple[Jump, ...]
    scale: float
    scale_deviation: float | None
    time_offset_s: float
    time_offset_deviation_s: float | None
    systematic_drift: tuple[float, ...]
    systematic_drift_deviation: tuple[float, ...] | None

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON or YAML."""
        return asdict(self)


def diagnose(
    fit: Fit, covariance: FloatArray, stamps_ns: NDArray[np.int64], unit: float = 1.0,
) -> Diagnosis:
    """Collect the identified noise and terms; ``covariance`` is (m, m), stamps are (N,).

    The fit was to positions of b that were multiplied by ``unit``.
    """
    deviation = np.sqrt(np.diag(covariance))
    columns = columns_of(fit.terms)

    def deviations(name: str) -> tuple[float, ...] | None:
        wanted = TERM_COLUMNS[name]
        found = deviation[(columns >= wanted.start) & (columns < wanted.stop)]
        return tuple(found.tolist()) or None

    scale, offset = deviations('scale'), deviations('time_offset')
    noise = np.sqrt(fit.noise.variances).tolist()
    return Diagnosis(
        white_m=noise[0],
        white_rad=noise[1],
        walk_m=noise[2],
        walk_rad=noise[3],
        walk_turn_m=noise[4],
        walk_turn_rad=noise[5],
        jumps=_jumps(fit, stamps_ns),
        scale=unit * fit.state.scale,
        scale_deviation=unit * scale[0] if scale else None,
        time_offset_s=fit.state.time_offset,
        time_offset_deviation_s=offset[0] if offset else None,
        systematic_drift=tuple(fit.state.systematic_drift.tolist()),
        systematic_drift_deviation=deviations('systematic_drift'),
    )


def _jumps(fit: Fit, stamps_ns: NDArray[np.int64]) -> tuple[Jump, ...]:
    k = np.flatnonzero((fit.noise.jump_probability > _JUMP_PROBABILITY).any(axis=1))
    size = np.sqrt(fit.evaluation.walk_squares[k])
    order = np.argsort(-fit.evaluation.walk_squares[k].sum(axis=1), kind='stable')
    return tuple(
        Jump(int(stamps_ns[k[i] + 1]), float(size[i, 0]), float(size[i, 1])) for i in order)


def findings_of(diagnosis: Diagnosis) -> tuple[Finding, ...]:
    """Put into sentences what a person should know of the data."""
    found = []
    off = diagnosis.scale - 1
    known = ('' if diagnosis.scale_deviation is None
             else f' (+- {diagnosis.scale_deviation / diagnosis.scale:.2%})')
    if abs(off) > _ANOTHER_UNIT:
        found.append(Finding(
            'scale-unit', 'b is in another unit of length: its positions were multiplied by '
            f'{diagnosis.scale:.6g}{known}', {'scale': diagnosis.scale}))
    elif known:
        found.append(Finding(
            'scale', f'the two trajectories disagree in scale by {off:+.2%}{known}: the scale of '
            'b was corrected', {'scale': diagnosis.scale}))
    if diagnosis.time_offset_deviation_s is not None:
        deviation = 1e3 * diagnosis.time_offset_deviation_s
        # A long drive tells microseconds: no deviation of +- 0.0.
        digits = 1 if deviation >= 0.1 else 4
        found.append(Finding(
            'clock-offset', f'clock offset {1e3 * diagnosis.time_offset_s:+.{digits}f} ms'
            f' (+- {deviation:.{digits}f} ms) added to the stamps of b',
            {'offset_s': diagnosis.time_offset_s}))
    if diagnosis.systematic_drift_deviation is not None:
        x, y, z = (f'{value:+.2%}' for value in diagnosis.systematic_drift)
        found.append(Finding(
            'systematic-drift', f'b drifts by {x}, {y}, {z} of the distance along its x, y, z: '
            'corrected', {'drift_per_metre': list(diagnosis.systematic_drift)}))
    if diagnosis.jumps:
        named = ', '.join(
            f'{jump.translation_m:.2g} m and {np.rad2deg(jump.rotation_rad):.2g} deg at '
            f'{jump.stamp_ns * 1e-9:.3f} s' for jump in diagnosis.jumps[:_NAMED_JUMPS])
        found.append(Finding(
            'pose-jumps', f'{len(diagnosis.jumps)} pose jumps excluded (relocalisation or loop '
            f'closure?). Largest: {named}', {
                'jumps': len(diagnosis.jumps),
                'largest_m': max(jump.translation_m for jump in diagnosis.jumps)}))
    return tuple(found)
