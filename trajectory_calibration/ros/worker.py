"""Calibrations in a process of their own, beside a node that keeps receiving.

A thread would share the interpreter lock with the callbacks: a solver that computes for a second
without releasing it stops them for a second. A process shares nothing, can be stopped when it
takes too long, returns its memory, and cannot take the node down with it.

``main`` is that process: one pickled job on standard input, one pickled result or error on
standard output. Both ends are this package on this machine; nothing else writes to these pipes.
"""

from __future__ import annotations

from collections.abc import Callable
import os
import pickle
import subprocess
import sys
import threading

from trajectory_calibration.errors import CalibrationError, SolverError
from trajectory_calibration.ros.session import Calibration, CalibrationJob

Outcome = Calibration | CalibrationError

# The solver gives way to whatever else the vehicle's computer has to do.
_NICENESS = 10

# The process finds every module where the node found it.
_BOOTSTRAP = f"""
import sys
sys.path[:] = sys.argv[1:]
from {__name__} import main
sys.exit(main())
"""


class SolverProcess:
    """Runs one calibration at a time.

    Parameters
    ----------
    done : callable
        Called without arguments from another thread when ``outcome`` has been set.

    Attributes
    ----------
    busy : True from ``start`` until the outcome is taken.

    """

    def __init__(self, done: Callable[[], None]) -> None:
        self._done = done
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._cancelled: str | None = None
        self._outcome: Outcome | None = None

    @property
    def busy(self) -> bool:
        """Whether a calibration runs or waits for its outcome to be taken."""
        return self._thread is not None

    def start(self, job: CalibrationJob, timeout_s: float) -> None:
        """Start a calibration; the caller has checked that none is running."""
        self._cancelled = None
        self._thread = threading.Thread(
            target=self._run, args=(job, timeout_s), name='solver', daemon=True)
        self._thread.start()

    def cancel(self, reason: str) -> None:
        """Stop the running calibration, if any; its outcome is an error with that reason."""
        with self._lock:
            self._cancelled = reason
            if self._process is not None:
                self._process.kill()

    def take_outcome(self) -> Outcome:
        """Return the outcome and be free for the next calibration; waits where it must."""
        if self._thread is None:
            raise SolverError('no calibration was started')
        self._thread.join()
        outcome = self._outcome
        self._thread = self._outcome = None
        if self._cancelled is not None:
            return SolverError(self._cancelled)
        if outcome is None:
            raise SolverError('the calibration ended without an outcome')
        return outcome

    def shutdown(self) -> None:
        """Stop whatever runs and wait for its end."""
        self.cancel('the node is shutting down')
        if self._thread is not None:
            self._thread.join()

    def _run(self, job: CalibrationJob, timeout_s: float) -> None:
        try:
            self._outcome = self._solve(job, timeout_s)
        except OSError as error:
            self._outcome = SolverError(f'the solver process could not be started: {error}')
        self._done()

    def _solve(self, job: CalibrationJob, timeout_s: float) -> Outcome:
        with self._lock:
            if self._cancelled is not None:
                return SolverError(self._cancelled)
            # A session of its own, so that Ctrl-C in a terminal reaches the node only.
            process = self._process = subprocess.Popen(
                [sys.executable, '-c', _BOOTSTRAP, *sys.path],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
        try:
            reply, _ = process.communicate(pickle.dumps(job, protocol=5), timeout=timeout_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            return SolverError(
                f'no answer within {timeout_s:g} s, stopped; reset and record less, raise '
                'calibration_timeout, or choose a faster solver')
        finally:
            with self._lock:
                self._process = None
        if process.returncode != 0:
            return SolverError(
                f'the solver process ended with status {process.returncode}; its last words are '
                'in the log of the node')
        outcome: Outcome = pickle.loads(reply)
        return outcome


def main() -> int:
    """Read a job, run it, write its outcome."""
    os.nice(_NICENESS)
    # Solvers written in C print where they like; the answer alone goes to the pipe.
    reply = os.fdopen(os.dup(sys.stdout.fileno()), 'wb')
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    job: CalibrationJob = pickle.load(sys.stdin.buffer)
    outcome: Outcome
    try:
        outcome = job.run()
    except CalibrationError as error:
        outcome = error
    try:
        with reply:
            pickle.dump(outcome, reply, protocol=5)
    except BrokenPipeError:
        return 1
    return 0
