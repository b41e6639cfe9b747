# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The noise and the systematic errors of the two trajectories: numbers and findings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.findings import Finding
from trajectory_calibration.errors import counted, rounded
from trajectory_calibration.geometry.chi_squared import quantile
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.algebra import ROTATION, TRANSLATION
from trajectory_calibration.solvers.drift_aware.drive import (
    correct,
    DRIFT,
    LATENCY,
    OFFSET,
    residuals,
    SCALE,
)
from trajectory_calibration.solvers.drift_aware.fit import Fit
from trajectory_calibration.solvers.solution import Diagnosis, Jump


def diagnose(
    fit: Fit, covariance: FloatArray, stamps_ns: NDArray[np.int64], unit: float = 1.0,
) -> Diagnosis:
    """Return the identified noise and terms; ``covariance`` is (12, 12), ``stamps_ns`` (N,).

    ``unit`` is the factor by which the positions of b were multiplied before the fit.
    """
    deviation = np.sqrt(np.diag(covariance))
    terms = fit.state.terms
    scale = unit * float(np.exp(terms[SCALE - 6]))
    between = _between_worlds(fit)
    white, walk = _white_and_walk(fit, between)
    return Diagnosis(
        white_m=float(white[0]),
        white_rad=float(white[1]),
        walk_m=float(walk[0]),
        walk_rad=float(walk[1]),
        apart=_noise_by_lag(fit, between),
        jumps=_jumps(fit, stamps_ns),
        scale=scale,
        scale_deviation=scale * float(deviation[SCALE]) if fit.free[SCALE] else None,
        time_offset_s=float(terms[OFFSET - 6]),
        time_offset_deviation_s=float(deviation[OFFSET]) if fit.free[OFFSET] else None,
        systematic_drift=tuple((-terms[1:4]).tolist()),
        systematic_drift_deviation=(
            tuple(deviation[DRIFT].tolist()) if fit.free[DRIFT].all() else None),
        latency_s=float(terms[LATENCY - 6]),
        latency_deviation_s=float(deviation[LATENCY]),
        saturation=fit.rho,
    )


def _between_worlds(fit: Fit) -> FloatArray:
    """Return the (octaves, 2) variances between worlds, the noise of the scale included."""
    octaves = fit.tree.octaves
    n = np.bincount(fit.tree.octave, minlength=octaves)
    along = np.bincount(fit.tree.octave, (fit.contrasts.J[:, TRANSLATION, SCALE]**2).mean(
        axis=1), octaves) * fit.noise.of_scale(octaves) / np.maximum(n, 1)
    result: FloatArray = fit.noise.walk[:octaves] + along[:, None] * [1.0, 0.0]
    return result


def _white_and_walk(fit: Fit, between: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (2,) standard deviations of the white noise of one sensor, and of drift after 1 m.

    A random walk of variance q per step gives D = 2^octave q / 2, and adds q / 2 to the white
    noise.
    """
    n = np.bincount(fit.tree.octave, minlength=len(between))[1:]
    rate = between[1:] / 2.0**np.arange(1, len(between))[:, None]
    of_walk = (n[:, None] * rate).sum(axis=0) / max(n.sum(), 1)
    white = np.maximum(fit.noise.white - of_walk, 0.0)
    way = np.linalg.norm(fit.drive.step_b, axis=1).mean()
    # The white noise is of a pair of poses; each sensor has half of its variance.
    return np.sqrt(white / 2), np.sqrt(2 * of_walk / max(way, 1e-12))


def _noise_by_lag(fit: Fit, between: FloatArray) -> tuple[tuple[float, float, float], ...]:
    """Return by octave the lag (s) and the standard deviations of motion differences (m, rad).

    A motion has the white noise of two poses and the noise between worlds of all octaves up to its
    own. Student's t with nu degrees of freedom has nu / (nu - 2) times the variance of its scale.
    """
    tail = fit.noise.tail
    variance = tail / (tail - 2.0) * (2 * fit.noise.white + np.cumsum(between, axis=0))
    seconds = fit.drive.step_s * 2.0**np.arange(len(between))
    return tuple((float(s), float(m), float(rad)) for s, (m, rad) in zip(
        seconds, np.sqrt(variance), strict=True))


def _jumps(fit: Fit, stamps_ns: NDArray[np.int64]) -> tuple[Jump, ...]:
    k = np.flatnonzero((fit.jumps > 0).any(axis=1) & ~fit.drive.gap)
    e = residuals(fit.drive, correct(fit.drive, fit.state), k, k + 1)
    size = np.stack([np.linalg.norm(e[:, part], axis=1) for part in (TRANSLATION, ROTATION)])
    order = np.lexsort((-size[1], -size[0]))
    return tuple(Jump(int(stamps_ns[k[i] + 1]), float(size[0, i]), float(size[1, i]))
                 for i in order)


def findings_of(diagnosis: Diagnosis, start_ns: int) -> tuple[Finding, ...]:
    """Return the findings of a diagnosis."""
    return (*_of_scale(diagnosis), *_of_times(diagnosis), *_of_drift(diagnosis),
            *_of_jumps(diagnosis, start_ns))


def _is_significant(value: float, deviation: float | None, smallest: float) -> bool:
    """Return whether a term is significant, and of a size that matters."""
    return deviation is not None and abs(value) > max(quantile(1)**0.5 * deviation, smallest)


def _of_scale(diagnosis: Diagnosis) -> tuple[Finding, ...]:
    scale, deviation = diagnosis.scale, diagnosis.scale_deviation
    off = scale - 1
    known = '' if deviation is None else f' (+- {deviation / scale:.2%})'
    # So far from one, a scale is another unit of length.
    if abs(off) > 0.3:
        return (Finding(
            'scale-unit', 'b is in another unit of length: its positions were multiplied by '
            f'{scale:.4g}{known}', {'scale': scale}),)
    if not _is_significant(off, deviation, 0.002):
        return ()
    return (Finding(
        'scale', f'the two trajectories disagree in scale by {off:+.2%}{known}: the scale of '
        'b was corrected', {'scale': scale}),)


def _of_times(diagnosis: Diagnosis) -> tuple[Finding, ...]:
    found = []
    offset, deviation = diagnosis.time_offset_s, diagnosis.time_offset_deviation_s
    if deviation is not None and _is_significant(offset, deviation, 0.005):
        found.append(Finding(
            'clock-offset', f'remaining clock offset {1e3 * offset:+.1f} ms (+- '
            f'{1e3 * deviation:.1f} ms) added to the stamps of b', {'offset_s': offset}))
    latency, deviation = diagnosis.latency_s, diagnosis.latency_deviation_s
    if _is_significant(latency, deviation, 0.01):
        which = 'b' if latency > 0 else 'a'
        found.append(Finding(
            'position-latency', f'the position of {which} is older than its orientation by '
            f'{1e3 * abs(latency):.0f} ms (+- {1e3 * deviation:.0f} ms): corrected',
            {'latency_s': latency}))
    return tuple(found)


def _of_drift(diagnosis: Diagnosis) -> tuple[Finding, ...]:
    drift, deviations = diagnosis.systematic_drift, diagnosis.systematic_drift_deviation
    named = [] if deviations is None else [
        k for k in range(3) if _is_significant(drift[k], deviations[k], 0.005)]
    if not named:
        return ()
    shares, axes = (' and '.join(words) for words in (
        [f'{drift[k]:+.2%}' for k in named], ['xyz'[k] for k in named]))
    return (Finding(
        'systematic-drift', f'b drifts by {shares} of the distance along its {axes}: corrected',
        {'drift_per_metre': list(drift)}),)


def _size(value: float) -> str:
    # Rounding of a component without a jump is 0.
    return rounded(round(value, 6))


def _of_jumps(diagnosis: Diagnosis, start_ns: int) -> tuple[Finding, ...]:
    jumps = diagnosis.jumps
    if not jumps:
        return ()
    named = ', '.join(
        f'{_size(jump.translation_m)} m and {_size(np.rad2deg(jump.rotation_rad))} deg at '
        f'{(jump.stamp_ns - start_ns) * 1e-9:.1f} s' for jump in jumps[:3])
    return (Finding(
        'pose-jumps', f'{counted(len(jumps), "pose jump")} excluded (relocalisation or loop '
        f'closure?). Largest, in seconds from the start: {named}', {
            'jumps': len(jumps), 'largest_m': max(jump.translation_m for jump in jumps),
            'stamps_ns': [jump.stamp_ns for jump in jumps]}),)
