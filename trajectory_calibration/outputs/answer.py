# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The six numbers of a pose with their standard deviations, status and verdict.

All outputs for a pair, a rig or many recordings show these rows, so that they cannot differ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trajectory_calibration.assessment.observability import (
    DEGREES_OF_FREEDOM,
    OBSERVED,
    PRIOR,
    UNOBSERVED,
    WEAK,
)
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.result import CalibrationResult

# The word for each status that is shown beside a number, worst first.
WORDS = {UNOBSERVED: 'unknown', WEAK: 'weak', PRIOR: 'prior', OBSERVED: 'ok'}
_WORST_FIRST = tuple(WORDS)

# Factors from metres and radians, in the order of a covariance, to metres and degrees.
TO_DEGREES = np.repeat([1.0, 180 / np.pi], 3)

NAMES = ('x', 'y', 'z', 'roll', 'pitch', 'yaw')

GOOD, CARE, INCOMPLETE, FAILED = 'good', 'care', 'incomplete', 'failed'
TITLES = {
    GOOD: 'Usable', CARE: 'Usable with care', INCOMPLETE: 'Incomplete', FAILED: 'No answer'}

# Level of findings that may make an answer wrong.
SERIOUS = 'serious'

# Cosine of a pitch near 90 degrees, where roll and yaw are rotations about the same axis.
_GIMBAL_LOCK = 1e-3

# An angle takes the status of each axis that contributes at least this share of its variance.
_MAIN_SHARE = 0.3


@dataclass(frozen=True)
class Row:
    """One number of the answer, 'x' ... 'yaw', with ``value`` in metres or degrees.

    Roll, pitch, yaw are rotations about the fixed x, then y, then z axis of a, as in URDF.
    ``std`` is None without a covariance, ``error`` (value minus truth) without a ground truth;
    both are None if the number is unobservable. ``status`` is 'observed', 'weak', 'unobserved'
    or 'prior', by the two limits of the settings.
    """

    name: str
    value: float
    std: float | None
    unit: str
    status: str
    weak_limit: float
    unobserved_limit: float
    error: float | None = None

    @property
    def word(self) -> str:
        """Return 'ok', 'weak', 'unknown' or 'prior'."""
        return WORDS[self.status]

    @property
    def is_known(self) -> bool:
        """Return whether the number is observable, so that it may be shown."""
        return self.status != UNOBSERVED

    @property
    def value_text(self) -> str:
        """Return the number with the digits of its standard deviation, or 'unknown'."""
        return fixed(self.value, self._digits) if self.is_known else self.word

    @property
    def std_text(self) -> str:
        """Return the standard deviation with two digits, or ''."""
        return '' if self.std is None else f'{self.std:.{self._digits}f}'

    @property
    def error_text(self) -> str:
        """Return the error with its sign, or ''."""
        return '' if self.error is None else (
            f'{round(self.error, self._digits) + 0.0:+.{self._digits}f}')

    @property
    def sigma(self) -> float | None:
        """Return the absolute error in standard deviations, or None."""
        return abs(self.error) / self.std if self.error is not None and self.std else None

    @property
    def _digits(self) -> int:
        """Return the decimals for two digits of the std: 3 to 6 for metres, 2 to 5 for degrees."""
        least = 3 if self.unit == 'm' else 2
        if self.std is None or not self.std > 0:
            return least + 1
        return int(np.clip(1 - np.floor(np.log10(self.std / 0.995)), least, least + 3))

    def __str__(self) -> str:
        """Return '0.209 +- 0.063', or 'unknown'."""
        return f'{self.value_text} +- {self.std_text}' if self.std_text else self.value_text


def answer_rows(
    result: CalibrationResult, T_a_b_true: FloatArray | None = None,
) -> tuple[Row, ...]:
    """Return the six rows of a result, with errors against ``T_a_b_true`` (4, 4)."""
    return pose_rows(result.T_a_b, result.covariance, result.observability.status,
                     result.config, T_a_b_true)


def pose_rows(
    T: FloatArray, covariance: FloatArray | None, status: Mapping[str, str],
    config: CalibrationConfig, T_true: FloatArray | None = None,
) -> tuple[Row, ...]:
    """Return the six rows of a (4, 4) pose, with errors against ``T_true`` (4, 4).

    ``covariance`` is (6, 6), order and side as in ``CalibrationResult``; ``status`` is by degree
    of freedom; ``config`` has the limits of weak and unobserved.
    """
    values = np.concatenate([T[:3, 3], np.rad2deg(se3.roll_pitch_yaw(T[:3, :3]))])
    # Of x, y, z, roll, pitch, yaw by the step of a covariance.
    J = np.eye(6)
    J[3:, 3:] = angle_jacobian(T[:3, :3])
    std = errors = np.full(6, np.nan)
    if covariance is not None:
        std = TO_DEGREES * np.sqrt(np.maximum(np.einsum('ij,jk,ik->i', J, covariance, J), 0.0))
    if T_true is not None:
        errors = TO_DEGREES * (J @ se3.step_between(T_true, T))
    statuses = [status[name] for name in DEGREES_OF_FREEDOM[:3]]
    statuses += _angle_statuses(covariance, status, J[3:, 3:])
    shown = (
        [None if np.isnan(number) or status == UNOBSERVED else float(number)
         for number, status in zip(numbers, statuses, strict=True)] for numbers in (std, errors))
    limits = (
        (config.weak_translation, config.unobserved_translation),
        (config.weak_rotation, config.unobserved_rotation))
    return tuple(
        Row(name, value + 0.0, sigma, unit_of(k), statuses[k], *limits[k >= 3], error)
        for k, (name, value, sigma, error) in enumerate(zip(
            NAMES, values.tolist(), *shown, strict=True)))


def error_text(T: FloatArray, T_true: FloatArray, status: Mapping[str, str]) -> str:
    """Return the error of a (4, 4) pose as text, without its unobservable directions."""
    unobserved = np.array([status[name] == UNOBSERVED for name in DEGREES_OF_FREEDOM])
    t, R = sizes(np.where(unobserved, 0.0, se3.step_between(T_true, T)))
    error = ', '.join('unknown' if unobserved[part].all() else text for part, text in (
        (slice(0, 3), f'{t:.4f} m'), (slice(3, 6), f'{R:.3f} deg')))
    excluded = ', '.join(np.array(DEGREES_OF_FREEDOM)[unobserved])
    return f'{error} (without {excluded})' if excluded else error


def sizes(step: FloatArray) -> tuple[float, float]:
    """Return the norms (m, deg) of a (6,) step in metres and radians; NaN counts as 0."""
    t, R = np.sqrt(np.nansum(np.reshape(TO_DEGREES * step, (2, 3)) ** 2, axis=1))
    return float(t), float(R)


def status_sentence(rows: tuple[Row, ...]) -> str:
    """Return the numbers by status: 'rotation ok; x, y weak; z unknown'."""
    parts = []
    for word in ('ok', 'prior', 'weak', 'unknown'):
        names = ', '.join(row.name for row in rows if row.word == word)
        for group, name in ((NAMES, 'all six numbers' if word == 'ok' else 'all six'),
                            (NAMES[:3], 'translation'), (NAMES[3:], 'rotation')):
            names = names.replace(', '.join(group), name)
        parts += [f'{names} {word}'] if names else []
    return '; '.join(parts)


def unit_of(k: int) -> str:
    """Return the unit of the k-th of the six numbers."""
    return 'm' if k < 3 else 'deg'


class Verdict(NamedTuple):
    """The verdict on a result.

    ``level`` is 'good', 'care', 'incomplete' (a direction is unobservable) or 'failed';
    ``sentence`` is the status of the numbers, ``next_step`` what to do now.
    """

    level: str
    sentence: str
    next_step: str


def verdict_of(result: CalibrationResult, rows: tuple[Row, ...] | None = None) -> Verdict:
    """Return the verdict on a result."""
    rows = rows or answer_rows(result)
    worst = min((row.status for row in rows), key=_WORST_FIRST.index)
    sentence = status_sentence(rows)
    # Findings of directions are in the status of the numbers.
    serious = [found.text for found in result.findings
               if found.level == SERIOUS and not found.code.startswith('direction-')]
    if serious and worst != UNOBSERVED:
        return Verdict(CARE, f'{sentence}, but check the data first', serious[0])
    if worst in (UNOBSERVED, WEAK):
        advice = '; '.join(found.text for found in result.findings
                           if found.code == f'direction-{worst}')
        return Verdict(INCOMPLETE if worst == UNOBSERVED else CARE, sentence,
                       advice or 'drive curves, and a ramp or a bank')
    return Verdict(
        GOOD, sentence, 'Copy the transform below. Check it on another drive: '
        'trajectory_calibration verify result.yaml A B')


def fixed(value: float, digits: int) -> str:
    """Return a number with ``digits`` decimals, without a minus before zero."""
    return f'{round(float(value), digits) + 0.0:.{digits}f}'


def angle_jacobian(R: FloatArray) -> FloatArray:
    """Return the (3, 3) Jacobian of roll, pitch, yaw by a rotation vector in the axes of a."""
    pitch_axis = np.array([-R[1, 0], R[0, 0], 0.0])
    cosine = float(np.hypot(R[0, 0], R[1, 0]))
    if cosine < _GIMBAL_LOCK:
        # The common rotation of roll and yaw is assigned to roll, as in roll_pitch_yaw.
        return np.array([R[:, 0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    columns = np.column_stack([R[:, 0], pitch_axis / cosine, [0.0, 0.0, 1.0]])
    return np.linalg.inv(columns)


def _angle_statuses(
    covariance: FloatArray | None, status: Mapping[str, str], jacobian: FloatArray,
) -> list[str]:
    """Return the status of roll, pitch, yaw: the worst of the axes that affect each.

    ``jacobian`` is that of ``angle_jacobian``.
    """
    by_axis = np.array([status[name] for name in DEGREES_OF_FREEDOM[3:]])
    variance = 1.0 if covariance is None else np.maximum(np.diagonal(covariance)[3:], 1e-30)
    share = jacobian**2 * variance
    share /= np.maximum(share.sum(axis=1, keepdims=True), 1e-300)
    affects = share > _MAIN_SHARE
    # Every axis affects at least one angle, so that an unobservable axis is always shown.
    affects[np.abs(jacobian).argmax(axis=0), np.arange(3)] = True
    return [
        min(by_axis[row].tolist(), key=_WORST_FIRST.index, default=OBSERVED) for row in affects]
