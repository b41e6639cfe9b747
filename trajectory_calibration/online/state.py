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
    """The outcome of the calibrations so far.

    Attributes
    ----------
    result : the last answer, of this run or restored; None where there is none.
    calibrated : whether it was found since the last reset.
    last_failure : why the last calibration failed, '' where it did not.

    """

    def __init__(self) -> None:
        self.result: CalibrationResult | None = None
        self.calibrated = False
        self.last_failure = ''
        # What was there when a calibration was tried last.
        self._tried: Motion = NO_MOTION

    def restored(self, result: CalibrationResult) -> None:
        """Take an answer of an earlier run."""
        self.result = result

    def started(self, motion: Motion) -> None:
        """Note the motion that a calibration begins with."""
        self._tried = motion

    def succeeded(self, result: CalibrationResult) -> None:
        """Take a new answer."""
        self.result, self.last_failure, self.calibrated = result, '', True

    def failed(self, why: str) -> None:
        """Take a failure; the answer before it stays."""
        self.last_failure = f'calibration failed: {why}'

    def reset(self) -> None:
        """Forget all but the answer."""
        self.calibrated, self.last_failure, self._tried = False, '', NO_MOTION

    def has_moved_on(self, motion: Motion) -> bool:
        """Return whether the data differ much from those of the last calibration."""
        if not motion.continues(self._tried):
            return True
        return motion.since(self._tried) > _MORE_MOTION * len(self._tried)

    def time_offset_s(self, setting_s: float) -> float:
        """Return the clock offset that was found since the last reset, or else the setting."""
        if self.calibrated and self.result is not None:
            return self.result.time_offset_s
        return setting_s

    def found_offset(self) -> str:
        """Return the clock offset that a calibration since the last reset found, or ''."""
        result = self.result
        if (result is None or not self.calibrated
                or result.config.mode('time_offset') == 'fixed'):
            return ''
        return f'{result.time_offset_s:.4f}'
