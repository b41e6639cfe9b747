# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The difference of two extrinsics, tested against their covariances."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.assessment.observability import limits_of
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.errors import in_sigmas
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.chi_squared import exceedance, FALSE_ALARM, quantile
from trajectory_calibration.geometry.observed import along, misfit, unobserved_directions
from trajectory_calibration.geometry.se3 import FloatArray

# In the order of a covariance, as sentences need them.
AXES = ('along x', 'along y', 'along z', 'about x', 'about y', 'about z')


@dataclass(frozen=True, eq=False)
class Difference:
    """The step from one extrinsic to another, tested against both covariances.

    Attributes
    ----------
    step : (6,) metres and radians along and about the axes of a, for ``geometry.se3.moved``;
        without the directions that are unobservable in one of the two.
    std : (6,) standard deviations of the step, metres and radians.
    chi_squared, degrees_of_freedom : of all directions that are observable in both.
    testable : (6,) bool, the axes that are observable in both.
    weak : (6,) bool, the testable axes along which only a large shift is detected.
    resolution : (6,) metres and radians, the shift along each axis that is detected in 95 % of
        the cases.
    differs : whether the step is significant at the given probability of a false alarm.
    named : indices of the significant axes, the most significant first.

    """

    step: FloatArray
    std: FloatArray
    chi_squared: float
    degrees_of_freedom: int
    testable: NDArray[np.bool_]
    weak: NDArray[np.bool_]
    resolution: FloatArray
    differs: bool
    named: tuple[int, ...]

    @property
    def sigma(self) -> float:
        """Return the largest component of the step in standard deviations."""
        return float(np.max(np.abs(self.step) / self.std))

    @property
    def probability(self) -> float:
        """Return the p-value: the probability of a larger chi-squared for equal extrinsics."""
        return exceedance(self.chi_squared, self.degrees_of_freedom)

    def describe(self) -> str:
        """Return the step in words: '0.078 m along x, 1.47 deg about z (12 sigma)'."""
        return f'{describe_step(self.step, self.named)} ({in_sigmas(self.sigma)} sigma)'

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON, with the unit in each name."""
        return {
            **in_units('step_', self.step),
            **in_units('std_', self.std),
            'chi_squared': self.chi_squared,
            'degrees_of_freedom': self.degrees_of_freedom,
            'probability': self.probability,
            'sigma': self.sigma,
            'axes': [AXES[k] for k in self.named],
        }


def difference(
    start: tuple[FloatArray, FloatArray],
    end: tuple[FloatArray, FloatArray],
    config: CalibrationConfig,
    probability: float = FALSE_ALARM,
) -> Difference:
    """Compare two independent answers, each a (4, 4) extrinsic and a (6, 6) covariance.

    ``config`` has the limits of unobservable and weak directions; ``probability`` is that of a
    false alarm for equal extrinsics.
    """
    (T_0, P_0), (T_1, P_1) = start, end
    P = floored(P_0) + floored(P_1)
    # The variances add up: if both answers are at the limit, so is their difference.
    limits = np.sqrt(2.0) * limits_of(config)
    weak_limit = np.sqrt(2.0) * np.repeat(
        [config.weak_translation, np.deg2rad(config.weak_rotation)], 3)
    step = aligned_step(T_0, T_1, P, limits)
    chi_squared, dof = misfit(step, P, limits)
    std = np.sqrt(np.diagonal(P))
    # Half of the false-alarm probability is for the joint test, half for the six single axes.
    limit = np.sqrt(quantile(1, 0.5 * probability / 6))
    testable = std <= limits
    significant = testable & (np.abs(step) > limit * std)
    differs = bool(significant.any() or (dof and chi_squared > quantile(dof, 0.5 * probability)))
    order = np.argsort(-np.abs(step) / std)
    named = tuple(int(k) for k in order if significant[k]) or tuple(map(int, order[:1]))
    # For detection in 95 % of the cases: one-sided, hence 0.1.
    power = quantile(1, 0.1)**0.5
    return Difference(
        step, std, chi_squared, max(dof, 1), testable, testable & (std > weak_limit),
        (limit + power) * std, differs, named)


def aligned_step(
    T_0: FloatArray, T_1: FloatArray, covariance: FloatArray, limits: FloatArray,
) -> FloatArray:
    """Move T_1 along its unobservable directions as close to T_0 as possible.

    Returns the remaining (6,) step; a direction is unobservable beyond the (6,) limits, metres
    and radians.
    """
    unobserved = unobserved_directions(covariance, limits)
    step = se3.step_between(T_0, T_1)
    # Iterated, because an arbitrary rotation about an unobservable axis changes the other axes.
    for _ in range(10):
        correction = along(unobserved, step, limits)
        if np.abs(correction / limits).max() < 1e-9:
            break
        T_1 = se3.moved(T_1, -correction)
        step = se3.step_between(T_0, T_1)
    return step


def floored(covariance: FloatArray) -> FloatArray:
    """Return an invertible (6, 6) covariance, also if a prior fixes a component."""
    return covariance + se3.ROUNDING * np.eye(6)


def in_units(name: str, values: FloatArray) -> dict[str, list[float]]:
    """Return (6,) metres and radians as plain data: 'name_m', and 'name_deg' in degrees."""
    return {f'{name}m': values[:3].tolist(), f'{name}deg': np.rad2deg(values[3:]).tolist()}


def describe_step(step: FloatArray, axes: Iterable[int], sign: str = '+') -> str:
    """Return the given axes of a (6,) step as text; the sign '-' shows lengths without '+'."""
    return ', '.join(
        f'{step[k]:{sign}.3f} m {AXES[k]}' if k < 3 else
        f'{np.rad2deg(step[k]):{sign}.2f} deg {AXES[k]}' for k in sorted(axes))
