# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The prior of the extrinsic: from a tape measure, a drawing, a mounting plate.

A prior is written as text, so that a ROS parameter and a command line can hold it:
``prior_translation: '0.3,-,0.1'`` and ``prior_translation_std: '0.01'``. ``-`` is an unknown
component, a single number is for all three, and a standard deviation of 0 fixes a component.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from trajectory_calibration.errors import ConfigError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# A fixed component: small enough to be exact, large enough to divide by.
FIXED = 1e-12


@dataclass(frozen=True, eq=False)
class Prior:
    """A normal distribution of the extrinsic; unknown components have an infinite std.

    Attributes
    ----------
    translation : (3,), metres, of b in a; zero where unknown.
    rotation : (3, 3), of b in a.
    std : (6,), metres and radians, in the order of the covariance.

    """

    translation: FloatArray
    rotation: FloatArray
    std: FloatArray

    @property
    def given(self) -> bool:
        """Whether any component is known."""
        return bool(np.isfinite(self.std).any())

    def step_from(self, T_a_b: FloatArray) -> FloatArray:
        """Return the (6,) step from an extrinsic to the prior, metres and radians."""
        return se3.step_between(
            T_a_b, se3.from_rotation_translation(self.rotation, self.translation))


def parse_prior(
    translation: str, translation_std: str, rotation_rpy_deg: str, rotation_std_deg: str,
) -> Prior:
    """Read a prior from the four settings; an empty text is no prior.

    A standard deviation without a value is ignored: parameters that are set one at a time can
    start with it.

    Raises
    ------
    ConfigError
        A text is not three numbers, or a value has no standard deviation.

    """
    t, t_std = _component('prior_translation', translation, translation_std)
    angles, angle_std = _component('prior_rotation', rotation_rpy_deg, rotation_std_deg)
    if np.isfinite(angle_std).any() and np.isnan(angles).any():
        raise ConfigError(
            f'prior_rotation is {rotation_rpy_deg!r}, needed roll, pitch and yaw: they mean '
            'nothing one without the other; write - for an axis in prior_rotation_std')
    R = se3.rotation_from_roll_pitch_yaw(np.deg2rad(np.nan_to_num(angles)))
    return Prior(np.nan_to_num(t), R, np.concatenate([t_std, np.deg2rad(angle_std)]))


def _component(name: str, values: str, std: str) -> tuple[FloatArray, FloatArray]:
    """Return (3,) values, NaN if unknown, and (3,) standard deviations, infinite if unknown."""
    if values.strip() and not std.strip():
        raise ConfigError(
            f'{name}_std is empty, but {name} is {values!r}, needed both; give {name}_std too (of '
            f'a running node, set {name}_std first and clear it last)')
    value, sigma = _three_numbers(name, values), _three_numbers(f'{name}_std', std)
    if (sigma < 0).any():
        raise ConfigError(f'{name}_std is {std!r}, needed numbers from 0 up')
    if len(std.split(',')) == 1:
        sigma = np.where(np.isnan(value), np.nan, sigma)
    if (np.isnan(sigma) & ~np.isnan(value)).any() and name == 'prior_translation':
        raise ConfigError(f'{name}_std is {std!r}, needed a number for each one of {values!r}')
    if values.strip() and (np.isnan(value) & ~np.isnan(sigma)).any():
        raise ConfigError(f'{name} is {values!r}, needed a number for each one of {std!r}')
    return value, np.where(np.isnan(value) | np.isnan(sigma), np.inf, sigma)


def _three_numbers(name: str, text: str) -> FloatArray:
    """Return the (3,) numbers of a text, NaN if unknown; an empty text is three unknowns."""
    parts = [part.strip() for part in (text if text.strip() else '-,-,-').split(',')]
    if len(parts) == 1 and name.endswith('_std'):
        parts *= 3
    try:
        finite = all(math.isfinite(float(part)) for part in parts if part != '-')
    except ValueError:
        finite = False
    if len(parts) != 3 or not finite:
        raise ConfigError(
            f'{name} is {text!r}, needed three numbers with commas, "-" for an unknown one, '
            'such as 0.3,-,0.1')
    return np.array([math.nan if part == '-' else float(part) for part in parts])
