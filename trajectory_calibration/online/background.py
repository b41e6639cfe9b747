# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Background work of the node: advice, and checks of the published extrinsic.

One process at a time, at low priority, within a budget of CPU time. A call of ``~/calibrate``
stops it.
"""

from __future__ import annotations

from collections.abc import Callable

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.errors import CalibrationError
from trajectory_calibration.fleet.verification import CANNOT_TELL
from trajectory_calibration.online.advice import Advice, AdviceJob, FEWEST_S
from trajectory_calibration.online.motion import Motion, NO_MOTION
from trajectory_calibration.online.options import in_node_words
from trajectory_calibration.online.session import CalibrationSession
from trajectory_calibration.online.verification import Monitor, MonitorJob, MonitorVerdict
from trajectory_calibration.online.worker import SolverProcess, StoppedError

# Largest unused CPU time, seconds, that can be saved up: a drive begins with many short
# calibrations.
CPU_CREDIT_S = 10.0


class Budget:
    """Token bucket of CPU time."""

    def __init__(self, now_s: float) -> None:
        self._credit_s, self._at_s = CPU_CREDIT_S, now_s

    def allows(self, now_s: float) -> bool:
        """Return whether CPU time is available."""
        # The long-term average is 3 % of one core.
        earned = 0.03 * (now_s - self._at_s)
        self._credit_s, self._at_s = min(self._credit_s + earned, CPU_CREDIT_S), now_s
        return self._credit_s > 0.0

    def spend(self, cpu_s: float) -> None:
        """Subtract used CPU time; the credit may become negative."""
        self._credit_s -= cpu_s


class Background:
    """Runs the advice of one session and the checks of a monitor, and stores their last results.

    ``done`` is called from another thread when an outcome is ready for ``take``.
    """

    def __init__(self, session: CalibrationSession, done: Callable[[], None], now_s: float,
                 monitor: Monitor | None = None) -> None:
        self._session, self.monitor = session, monitor
        self._process: SolverProcess[Advice | MonitorVerdict] = SolverProcess(done)
        self._budget = Budget(now_s)
        self._ended_s = now_s
        # Motion and settings of the last advice.
        self._advised: Motion = NO_MOTION
        self._settings: tuple[object, ...] = ()
        self._monitoring = False
        self.advice: Advice | None = None
        self.verdict: MonitorVerdict | None = None

    def poll(self, motion: Motion, config: CalibrationConfig, frames: tuple[str, str],
             timeout_s: float, now_s: float) -> None:
        """Start the next job if one is due; call it about once a second."""
        settings = config, frames
        if not motion.continues(self._advised):
            # The last advice is about other poses.
            self.advice, self._advised = None, NO_MOTION
        if (self._process.busy or not self._budget.allows(now_s)
                or now_s - self._ended_s < 2):
            return
        job: AdviceJob | MonitorJob | None
        if len(motion) >= FEWEST_S and (
                motion.is_news_after(self._advised) or settings != self._settings):
            self._advised, self._settings = motion, settings
            track_a, track_b = self._session.tracks(frames)
            job = AdviceJob(track_a, track_b, config)
        else:
            job = (self.monitor.job(self._session, frames, config, now_s)
                   if self.monitor else None)
        if job is not None:
            self._monitoring = isinstance(job, MonitorJob)
            self._process.start(job, timeout_s)

    def take(self, now_s: float) -> Advice | MonitorVerdict | None:
        """Store and return the outcome of the process, None if it was stopped or is idle."""
        if not self._process.busy:
            return None
        outcome = self._process.take_outcome()
        self._budget.spend(self._process.cpu_s)
        self._ended_s = now_s
        if isinstance(outcome, StoppedError):
            # The next poll then starts it again.
            self._settings = ()
            return None
        if isinstance(outcome, CalibrationError):
            # A failure is advice, too. A failed check is no evidence about the extrinsic.
            outcome = (
                MonitorVerdict(CANNOT_TELL, 3, f'cannot tell: {outcome}') if self._monitoring
                else Advice(failure=in_node_words(str(outcome))))
        if isinstance(outcome, Advice):
            self.advice = outcome
        else:
            self.verdict = outcome.following(self.verdict)
        return outcome

    def stop(self, reason: str) -> None:
        """Stop the running job; it gives no outcome."""
        if self._process.busy:
            self._process.cancel(reason)

    def reset(self) -> None:
        """Stop the running job and drop the advice."""
        self.stop('stopped by a reset')
        self.advice, self._advised, self._settings = None, NO_MOTION, ()

    def shutdown(self) -> None:
        """Stop the running job and wait for its end."""
        self._process.shutdown()
