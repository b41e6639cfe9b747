# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calibrations in a process of their own, beside a node that keeps receiving.

A thread would share the interpreter lock with the callbacks: a solver that computes for a second
without releasing it stops them for a second. A process shares nothing, can be stopped when it
takes too long, returns its memory, and cannot take the node down with it.

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

# The process knows the node's, and finds every module where the node found it.
_BOOTSTRAP = f"""
import sys
node, sys.path[:] = int(sys.argv[1]), sys.argv[2:]
from {__name__} import main
sys.exit(main(node))
"""


class StoppedError(SolverError):
    """The calibration was stopped because somebody asked for it."""


# What stands as the outcome until there is one.
_UNFINISHED = SolverError(
    'the calibration ended without an answer; the reason is in the log of the node')


class SolverJob(Protocol[Answer_co]):
    """What the process runs: plain data with a method that may raise CalibrationError."""

    def run(self) -> Answer_co:
        """Return the answer."""
        ...


class SolverProcess(Generic[Answer]):
    """Runs one job at a time.

    ``done`` is called without arguments, as a rule from another thread, when the outcome can be
    taken: once for every ``start``, whatever happened. ``busy`` until it is taken, ``ready`` when
    that waits for nothing. ``cpu_s`` is the CPU time of the last job, its process included; of one
    that was stopped, its duration.
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
        """Start a job; the caller has checked that none is running."""
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
        """Stop the running calibration, if any; its outcome is a StoppedError."""
        with self._lock:
            self._cancelled = reason
            if self._process is not None:
                self._process.kill()

    def take_outcome(self) -> Answer | CalibrationError:
        """Return the outcome and be free for the next calibration; waits where it must."""
        if self._thread is not None:
            self._thread.join()
        outcome = self._outcome
        self.busy = self.ready = False
        self._thread, self._outcome = None, _UNFINISHED
        return outcome if self._cancelled is None else StoppedError(self._cancelled)

    def shutdown(self) -> None:
        """Stop whatever runs and wait for its end."""
        self.cancel('stopped: the node is shutting down')
        if self._thread is not None:
            self._thread.join()

    def _run(self, job: SolverJob[Answer], timeout_s: float) -> None:
        # What is not foreseen here ends this thread with a traceback in the log. The node hears
        # of the end all the same, or it would be busy for ever.
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
            # A session of its own, so that Ctrl-C in a terminal reaches the node only.
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
                # Does nothing to a process that has ended by itself.
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
    """Read a job, run it, write its outcome; end with the process ``node``, however that ends."""
    if sys.platform == 'linux':
        # A node that is killed stops nothing, and a session of its own hears of no terminal.
        pr_set_pdeathsig = 1
        ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL)
    if os.getppid() != node:
        # It went before that took effect.
        sys.stderr.write(f'no calibration: the node, process {node}, has gone\n')
        return 1
    # The solver gives way to whatever else the vehicle's computer has to do.
    os.nice(10)
    # Solvers written in C print where they like; the answer alone goes to the pipe.
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
