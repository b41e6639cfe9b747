# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Advice for the driver: the present result of a calibration, and the motion that is missing.

The advice is a real calibration in the solver process, with the buffered poses (thinned if they
are very many). So it predicts the answer of ``~/calibrate``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajectory_calibration.assessment.observability import axis_name, DEGREES_OF_FREEDOM
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.online.snapshot import Snapshot
from trajectory_calibration.pipeline import calibrate
from trajectory_calibration.result import CalibrationResult

# Least motion of both sensors for a calibration, seconds.
FEWEST_S = 5


@dataclass(frozen=True, eq=False)
class Advice:
    """The result of a calibration with the buffered poses, or why it failed."""

    result: CalibrationResult | None = None
    failure: str = ''
    # (3,) unit vector in a: the direction of the translation that is allowed to be unobservable.
    missing: FloatArray | None = None

    @property
    def std(self) -> FloatArray | None:
        """Return (6,) standard deviations, metres and degrees, or None."""
        std = None if self.result is None else self.result.std
        return None if std is None else np.concatenate([std[:3], np.rad2deg(std[3:])])

    def sufficient(self, translation_limit: float, rotation_limit_deg: float) -> bool:
        """Return whether all required standard deviations are within the limits, m and deg."""
        ratios = self._ratios(translation_limit, rotation_limit_deg)
        return ratios is not None and bool((ratios <= 1.0).all())

    def sentence(self, translation_limit: float, rotation_limit_deg: float) -> str:
        """Return one sentence for the driver."""
        ratios, std, result = (
            self._ratios(translation_limit, rotation_limit_deg), self.std, self.result)
        if ratios is None or std is None or result is None:
            return f'drive on: a calibration would fail now: {self.failure}'
        if (ratios <= 1.0).all():
            left_out = ('' if self.missing is None else
                        f'; translation along {axis_name(self.missing)} of {result.frame_a} '
                        'remains unobservable')
            return f'enough motion: call ~/calibrate{left_out}'
        worst = int(np.argmax(ratios))
        name = DEGREES_OF_FREEDOM[worst]
        direction = f'{"translation along" if worst < 3 else "rotation about"} {name[-1]}'
        limit, unit = (translation_limit, 'm') if worst < 3 else (rotation_limit_deg, 'deg')
        # Beyond a hundred times its limit the number is meaningless.
        unobserved = name in result.observability.unobserved or ratios[worst] > 100
        known = ('is unobservable' if unobserved else
                 f'has a standard deviation of {std[worst]:.2g} {unit}')
        return (f'{_manoeuvre(worst, result)}: {direction} of {result.frame_a} {known}, '
                f'needed {limit:g} {unit}')

    def _ratios(self, translation_limit: float, rotation_limit_deg: float) -> FloatArray | None:
        """Return (6,) standard deviations over their limits, without ``missing``; or None."""
        std = self.std
        if std is None or self.result is None or self.result.covariance is None:
            return None
        if self.missing is not None:
            across = np.eye(3) - np.outer(self.missing, self.missing)
            translation = across @ self.result.covariance[:3, :3] @ across
            std[:3] = np.sqrt(np.maximum(np.diagonal(translation), 0.0))
        ratios: FloatArray = std / np.repeat([translation_limit, rotation_limit_deg], 3)
        return ratios


@dataclass(frozen=True, eq=False)
class AdviceJob:
    """A calibration for advice, with copies of the poses."""

    track_a: Snapshot
    track_b: Snapshot
    config: CalibrationConfig

    def run(self) -> Advice:
        """Calibrate; raises CalibrationError as ``calibrate``."""
        # A reference such as C10 counts poses, so thinning would change it.
        a, b = (track.thinned() if self.config.reference == 'auto' else track
                for track in (self.track_a, self.track_b))
        result = calibrate(a.trajectory(), b.trajectory(),
                           replace(self.config, allow_unobserved=True))
        if result.covariance is None:
            return Advice(failure='the solver gives no standard deviations')
        # The diagnostics do not need the mask of inliers, which is large.
        return Advice(
            replace(result, inliers=None), missing=_allowed_direction(result, self.config))


def _allowed_direction(result: CalibrationResult, config: CalibrationConfig) -> FloatArray | None:
    if not config.allow_unobserved or result.covariance is None:
        return None
    variances, axes = np.linalg.eigh(result.covariance[:3, :3])
    unobserved = np.sqrt(max(float(variances[2]), 0.0)) > config.unobserved_translation
    return axes[:, 2] if unobserved else None


def _manoeuvre(worst: int, result: CalibrationResult) -> str:
    """Return the manoeuvre, or the prior, for the component with the largest ratio."""
    observed = result.observability
    if observed.hardly_turned:
        return 'drive curves, and a ramp or a bank'
    if observed.single_axis:
        most = int(np.argmax(np.abs(observed.single_axis)))
        if worst == most:
            return ('drive a ramp or a bank, or give prior_translation along '
                    f'{"xyz"[most]} of {result.frame_a}')
        if worst == 3 + most:
            return 'drive farther, not on the spot, and curves both ways'
    return f'turn more about {"xyz"[np.argmin(observed.excitation_deg)]} of {result.frame_a}'
