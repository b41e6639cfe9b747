# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calibrations in a separate process, while the node keeps receiving.

A thread shares the interpreter lock with the callbacks: a solver that does not release it for a
second blocks them for a second. A process does not, can be stopped at a timeout, frees its memory,
and cannot crash the node.

``main`` is that process: one pickled job on standard input, one pickled result or error on
standard output. Both ends are this package on this machine; nothing else writes to these pipes.
"""

from __future__ import annotations

from collections.abc import Callable
import ctypes
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from typing import Any, Generic, Protocol, TypeVar

from trajectory_calibration.errors import CalibrationError, missing_package, SolverError

Answer = TypeVar('Answer')
Answer_co = TypeVar('Answer_co', covariant=True)

# The process gets the process id of the node and its module search path.
_BOOTSTRAP = f"""
import sys
node, sys.path[:] = int(sys.argv[1]), sys.argv[2:]
from {__name__} import main
sys.exit(main(node))
"""


class StoppedError(SolverError):
    """The calibration was stopped on request."""


# The outcome of a job that ends without one.
_UNFINISHED = SolverError(
    'the calibration ended without an answer; the reason is in the log of the node')


class SolverJob(Protocol[Answer_co]):
    """A job for the process: plain data with a method that may raise CalibrationError."""

    def run(self) -> Answer_co:
        """Return the answer."""
        ...


class SolverProcess(Generic[Answer]):
    """Runs one job at a time.

    ``done`` is called without arguments, usually from another thread, when the outcome is ready:
    once for every ``start``, whatever happened. ``busy`` until the outcome is taken; ``ready``
    when taking it does not block. ``cpu_s`` is the CPU time of the last job including the start of
    the process, or the duration of a job that was stopped.
    """

    def __init__(self, done: Callable[[], None]) -> None:
        self._done = done
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._cancelled: str | None = None
        self._outcome: Answer | CalibrationError = _UNFINISHED
        self.busy = self.ready = False
        self.cpu_s = 0.0
        self.started_s = 0.0

    def start(self, job: SolverJob[Answer], timeout_s: float) -> None:
        """Start a job; none may be running."""
        self.started_s = time.monotonic()
        self.busy, self._cancelled, self._outcome = True, None, _UNFINISHED
        thread = threading.Thread(
            target=self._run, args=(job, timeout_s), name='solver', daemon=True)
        try:
            thread.start()
        except RuntimeError as error:
            self._outcome = SolverError(f'the calibration could not be started: {error}')
            self._end()
            return
        self._thread = thread

    def cancel(self, reason: str) -> None:
        """Stop the running job, if any; its outcome is a StoppedError."""
        with self._lock:
            self._cancelled = reason
            if self._process is not None:
                self._process.kill()

    def take_outcome(self) -> Answer | CalibrationError:
        """Return the outcome, waiting for it if necessary, and be ready for the next job."""
        if self._thread is not None:
            self._thread.join()
        outcome = self._outcome
        self.busy = self.ready = False
        self._thread, self._outcome = None, _UNFINISHED
        return outcome if self._cancelled is None else StoppedError(self._cancelled)

    def shutdown(self) -> None:
        """Stop the running job and wait for its end."""
        self.cancel('stopped: the node is shutting down')
        if self._thread is not None:
            self._thread.join()

    def _run(self, job: SolverJob[Answer], timeout_s: float) -> None:
        # An unexpected exception ends this thread with a traceback in the log. The node must be
        # notified nevertheless, or it would be busy for ever.
        try:
            self._outcome = self._solve(job, timeout_s)
        except OSError as error:
            self._outcome = SolverError(f'the solver process could not be started: {error}')
        except MemoryError:
            self._outcome = SolverError(
                'not enough memory to start the solver; lower max_poses, or free some')
        finally:
            self._end()

    def _end(self) -> None:
        self.ready = True
        self._done()

    def _solve(self, job: SolverJob[Answer], timeout_s: float) -> Answer | CalibrationError:
        work = pickle.dumps(job, protocol=5)
        with self._lock:
            if self._cancelled is not None:
                return StoppedError(self._cancelled)
            # A separate session, so that Ctrl-C in a terminal reaches only the node.
            process = self._process = subprocess.Popen(
                [sys.executable, '-c', _BOOTSTRAP, str(os.getpid()), *sys.path],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
        with process:
            try:
                reply, _ = process.communicate(work, timeout=timeout_s)
            except subprocess.TimeoutExpired:
                return SolverError(
                    f'no answer within {timeout_s:g} s, stopped; reset and record less, raise '
                    'calibration_timeout, or choose a faster solver')
            finally:
                # No effect if the process has ended already.
                process.kill()
                with self._lock:
                    self._process = None
                self.cpu_s = time.monotonic() - self.started_s
        if process.returncode != 0:
            return SolverError(
                f'the solver process ended with status {process.returncode}; its last words are '
                'in the log of the node')
        try:
            outcome: Answer | CalibrationError
            outcome, self.cpu_s = pickle.loads(reply)
        except (pickle.UnpicklingError, EOFError, TypeError, ValueError) as error:
            return SolverError(f'the answer of the solver process is damaged: {error}')
        return outcome


def main(node: int) -> int:
    """Read a job, run it, write its outcome; end when the process ``node`` ends."""
    if sys.platform == 'linux':
        # A killed node cannot stop this process, and no terminal signal reaches its session.
        pr_set_pdeathsig = 1
        ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL)
    if os.getppid() != node:
        # The node ended before that took effect.
        sys.stderr.write(f'no calibration: the node, process {node}, has gone\n')
        return 1
    # The other programs on the vehicle's computer have priority.
    os.nice(10)
    # Solvers in C may print to standard output: redirect it, the pipe must get only the answer.
    reply = os.fdopen(os.dup(sys.stdout.fileno()), 'wb')
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    job: SolverJob[Any] = pickle.load(sys.stdin.buffer)
    try:
        outcome = job.run()
    except CalibrationError as error:
        outcome = error
    except ModuleNotFoundError as error:
        outcome = missing_package(error)
    try:
        with reply:
            pickle.dump((outcome, time.process_time()), reply, protocol=5)
    except BrokenPipeError:
        return 1
    return 0
