# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Check the published answer against the recent poses, to detect that a sensor has moved.

The recent poses are calibrated separately and the result is compared with the answer, as
``trajectory_calibration verify`` does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.fleet.verification import CANNOT_TELL, HOLDS, MOVED, verify
from trajectory_calibration.online.session import CalibrationSession
from trajectory_calibration.online.snapshot import Snapshot
from trajectory_calibration.result import CalibrationResult


@dataclass(frozen=True)
class MonitorVerdict:
    """The result of a check of the published answer, with the exit status of ``verify``."""

    verdict: str
    exit_status: int
    sentence: str
    # Consecutive checks that found a moved sensor.
    checks: int = 0

    @property
    def level(self) -> int:
        """Return 0 (OK), 1 (WARN: moved once) or 2 (ERROR: moved, confirmed).

        The numbers are those of diagnostic_msgs/DiagnosticStatus.
        """
        return min(self.checks, 2)

    def following(self, before: MonitorVerdict | None) -> MonitorVerdict:
        """Return this verdict with the count continued: CANNOT_TELL does not change the count."""
        earlier = before.checks if before else 0
        checks = {HOLDS: 0, CANNOT_TELL: earlier, MOVED: earlier + 1}[self.verdict]
        recalled = f'; before: {before.sentence}' if (
            before and earlier and self.verdict == CANNOT_TELL) else ''
        return replace(self, checks=checks, sentence=self.sentence + recalled)


@dataclass(frozen=True, eq=False)
class MonitorJob:
    """A check of an answer against recent poses."""

    result: CalibrationResult
    track_a: Snapshot
    track_b: Snapshot
    config: CalibrationConfig

    def run(self) -> MonitorVerdict:
        """Check; raises CalibrationError if the calibration of the recent poses fails."""
        found = verify(self.result, self.track_a.thinned().trajectory(),
                       self.track_b.thinned().trajectory(), self.config)
        return MonitorVerdict(found.verdict, found.exit_status, found.describe())


class Monitor:
    """Decides when to check the published answer, and with which time window of poses."""

    def __init__(self, period_s: float, window_s: float) -> None:
        self._period_s, self._window_ns = period_s, round(window_s * 1e9)
        self._checked_s = -float('inf')
        self._result: CalibrationResult | None = None
        # Only poses after these stamps are independent of the answer.
        self._since_ns = [0, 0]
        # The newest stamps of the last check: a check of the same poses confirms nothing.
        self._last_ns = [0, 0]

    def watch(self, result: CalibrationResult, session: CalibrationSession, *, restored: bool,
              ) -> None:
        """Watch a new answer with the poses that arrive after it was estimated."""
        self._result, self._last_ns = result, [0, 0]
        self._since_ns = [0 if restored or buffer.span_ns is None else buffer.span_ns[1]
                          for buffer in session.buffers]

    def job(
        self, session: CalibrationSession, frames: tuple[str, str], config: CalibrationConfig,
        now_s: float,
    ) -> MonitorJob | None:
        """Return the check that is due now, or None."""
        if self._result is None or now_s - self._checked_s < self._period_s:
            return None
        starts_ns, ends_ns = [], []
        for buffer, *before_ns in zip(
                session.buffers, self._since_ns, self._last_ns, strict=True):
            first_ns, end_ns = buffer.span_ns or (0, 0)
            # If the clock went back, this is another recording.
            begin_ns, seen_ns = (
                stamp if stamp <= end_ns else first_ns for stamp in before_ns)
            starts_ns.append(max(begin_ns, end_ns - self._window_ns))
            ends_ns.append(end_ns)
            # Too few new poses of a sensor for a check.
            if np.count_nonzero(buffer.stamps_ns > max(starts_ns[-1], seen_ns)) < 30:
                return None
        self._checked_s, self._last_ns = now_s, ends_ns
        track_a, track_b = (track.after(start_ns) for track, start_ns in zip(
            session.tracks(frames), starts_ns, strict=True))
        return MonitorJob(self._result, track_a, track_b, config)
