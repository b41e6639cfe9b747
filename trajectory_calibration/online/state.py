# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the node knows of its own calibrations: the last answer, the last failure, the motion."""

from __future__ import annotations

from trajectory_calibration.online.motion import Motion, NO_MOTION
from trajectory_calibration.result import CalibrationResult

# How much more motion, of that which it had, there must be before a calibration that failed says
# nothing about the next one: its message leaves the diagnostics, and auto_calibrate tries again.
_MORE_MOTION = 0.2


class CalibrationState:
    """The outcome of the calibrations so far."""

    def __init__(self) -> None:
        # The last answer, of this run or restored.
        self.result: CalibrationResult | None = None
        self.reset()

    def started(self, motion: Motion) -> None:
        """Note the motion that a calibration begins with."""
        self._tried = motion

    def succeeded(self, result: CalibrationResult) -> None:
        """Take a new answer."""
        self.result, self.calibrated = result, True
        self.last_failure = self.not_restored = ''

    def failed(self, why: str) -> None:
        """Take a failure; the answer before it stays."""
        self.last_failure = f'calibration failed: {why}'

    def reset(self) -> None:
        """Forget all but the answer."""
        # Whether the answer was found since, and why the last calibration failed.
        self.calibrated, self.last_failure = False, ''
        # Why a saved answer was refused: unlike a failure, no motion mends that.
        self.not_restored = ''
        self._tried = NO_MOTION

    def has_moved_on(self, motion: Motion) -> bool:
        """Return whether the data differ much from those of the last calibration."""
        return not motion.continues(self._tried) or (
            motion.since(self._tried) > _MORE_MOTION * len(self._tried))

    def time_offset_s(self, setting_s: float) -> float:
        """Return the clock offset that was found since the last reset, or else the setting."""
        return self.result.time_offset_s if self.calibrated and self.result else setting_s

    def found_offset(self) -> str:
        """Return the clock offset that a calibration since the last reset found, or ''."""
        if not (self.calibrated and self.result) or (
                self.result.config.mode('time_offset') == 'fixed'):
            return ''
        return f'{self.result.time_offset_s:.4f}'
