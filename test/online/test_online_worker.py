# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The solver process: one job at a time, stopped when asked, nothing left behind. Needs no ROS."""

from dataclasses import replace
import os
import pickle
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from trajectory_calibration import CalibrationConfig, SolverError, TrajectoryError
from trajectory_calibration.geometry import se3
from trajectory_calibration.online import worker
from trajectory_calibration.online.buffer import Snapshot
from trajectory_calibration.online.session import Calibration, CalibrationJob
from trajectory_calibration.online.worker import SolverProcess, StoppedError

T_A_B = se3.exp_se3([0.3, -0.2, 0.1, 0.4, -0.3, 1.2])


def track(poses, frame):
    q = se3.rotation_to_quaternion(poses[:, :3, :3])
    rows = np.column_stack([poses[:, :3, 3], q])
    return Snapshot(np.arange(len(poses)) * 10**8, rows, 'map', frame)


def job(poses=60, solver='taylor'):
    rng = np.random.default_rng(2)
    a = se3.exp_se3(np.cumsum(rng.normal(size=(poses, 6)) * 0.1, axis=0))
    return CalibrationJob(track(a, 'lidar'), track(a @ T_A_B, 'camera'),
                          CalibrationConfig(solver=solver))


class Waiting:
    """A solver process and the news of its end."""

    def __init__(self):
        self.news = threading.Event()
        self.solver = SolverProcess(done=self.news.set)

    def outcome(self):
        assert self.news.wait(60)
        self.news.clear()
        return self.solver.take_outcome()


@pytest.fixture
def started(monkeypatch):
    """Return the list of the solver processes that were started; they are real."""
    processes = []

    class Recorded(subprocess.Popen):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            processes.append(self)

    monkeypatch.setattr(subprocess, 'Popen', Recorded)
    return processes


def test_jobs_are_solved_one_after_the_other():
    waiting = Waiting()
    for _ in range(2):
        assert not waiting.solver.busy
        waiting.solver.start(job(), 60.0)
        assert waiting.solver.busy
        outcome = waiting.outcome()
        assert isinstance(outcome, Calibration)
        assert np.allclose(outcome.result.T_a_b, T_A_B, atol=1e-10)
    assert not waiting.solver.busy


@pytest.mark.parametrize('allowed', [False, True])
def test_an_open_direction_is_an_answer_that_the_node_keeps_back(allowed):
    twists = np.zeros((400, 6))
    twists[:, 0], twists[:, 5] = 0.3, 0.1 * np.sin(0.07 * np.arange(400))
    a = se3.exp_se3(twists)
    for k in range(1, len(a)):
        a[k] = a[k - 1] @ a[k]
    track_a = track(a, 'lidar')
    answer = CalibrationJob(
        replace(track_a, warnings=('lidar: 2 poses refused (2 no stamp)',)),
        track(a @ T_A_B, 'camera'),
        CalibrationConfig(allow_unobserved=allowed)).run()
    assert answer.result.observability.unobserved == ('z',)
    if allowed:
        assert answer.refusal == ''
        return
    assert answer.refusal.startswith('not published: z of camera in lidar unobservable. ')
    assert 'prior_translation:=-,-,Z prior_translation_std:=0.01' in answer.refusal
    assert answer.refusal.endswith('; lidar: 2 poses refused (2 no stamp)')


def test_a_named_error_arrives_as_it_was_raised():
    waiting = Waiting()
    waiting.solver.start(job(poses=1), 60.0)
    outcome = waiting.outcome()
    assert isinstance(outcome, TrajectoryError)
    assert 'lidar: 1 pose received' in str(outcome)


def test_a_process_that_dies_is_an_error(capfd):
    waiting = Waiting()
    # A broken job ends the process with a traceback, as a crash of a solver would.
    waiting.solver.start('no job', 60.0)
    outcome = waiting.outcome()
    assert isinstance(outcome, SolverError)
    assert 'ended with status 1' in str(outcome)
    assert 'AttributeError' in capfd.readouterr().err


def test_too_slow_is_an_error_and_the_process_is_gone(started):
    waiting = Waiting()
    waiting.solver.start(job(), 0.01)
    assert 'no answer within 0.01 s' in str(waiting.outcome())
    # Reaped, not only killed.
    assert [process.returncode for process in started] == [-signal.SIGKILL]


def test_what_was_cancelled_stays_cancelled_even_when_it_has_just_been_solved():
    waiting = Waiting()
    waiting.solver.start(job(), 60.0)
    assert waiting.news.wait(60)
    waiting.solver.cancel('stopped by a reset')
    outcome = waiting.outcome()
    assert isinstance(outcome, StoppedError)
    assert str(outcome) == 'stopped by a reset'
    waiting.solver.start(job(), 60.0)
    assert isinstance(waiting.outcome(), Calibration)


def test_cancelling_ends_the_process_at_once(started):
    waiting = Waiting()
    waiting.solver.start(job(poses=3000, solver='dnlo'), 60.0)
    waiting.solver.cancel('stopped by a reset')
    assert str(waiting.outcome()) == 'stopped by a reset'
    waiting.solver.shutdown()
    assert all(process.returncode == -signal.SIGKILL for process in started)


@pytest.mark.filterwarnings('ignore::pytest.PytestUnhandledThreadExceptionWarning')
@pytest.mark.parametrize('broken, sentence', [
    (MemoryError(), 'not enough memory'),
    (OSError(24, 'Too many open files'), 'could not be started'),
    (ValueError('nobody foresaw this'), 'ended without an answer'),
])
def test_whatever_ends_the_waiting_is_an_answer_and_leaves_no_process(
        started, monkeypatch, broken, sentence):
    def fail(*_args, **_kwargs):
        raise broken
    waiting = Waiting()
    with monkeypatch.context() as patch:
        patch.setattr(subprocess.Popen, 'communicate', fail)
        waiting.solver.start(job(), 60.0)
        outcome = waiting.outcome()
    assert isinstance(outcome, SolverError) and sentence in str(outcome)
    assert [process.returncode for process in started] == [-signal.SIGKILL]
    assert not waiting.solver.busy
    waiting.solver.start(job(), 60.0)
    assert isinstance(waiting.outcome(), Calibration)


@pytest.mark.filterwarnings('ignore::pytest.PytestUnhandledThreadExceptionWarning')
def test_a_job_that_cannot_be_sent_is_an_answer(started):
    waiting = Waiting()
    waiting.solver.start(lambda: None, 60.0)
    assert 'ended without an answer' in str(waiting.outcome())
    assert not started


@pytest.mark.parametrize('reply', [b'', b'no pickle', pickle.dumps(1.0)[:-1]])
def test_a_damaged_reply_is_an_answer(monkeypatch, reply):
    monkeypatch.setattr(worker, '_BOOTSTRAP', f'import os; os.write(1, {reply!r})')
    waiting = Waiting()
    waiting.solver.start(job(), 60.0)
    assert 'damaged' in str(waiting.outcome())


class Endless:
    """A job that says when it has begun; its process holds standard error until it ends."""

    def run(self):
        os.write(2, b'begun\n')
        time.sleep(600)


# What becomes of the solver process of a node that is killed.
NODE = """
import sys
sys.path[:] = {path!r}
from test_online_worker import Endless, Waiting
waiting = Waiting()
waiting.solver.start(Endless(), 600.0)
waiting.outcome()
"""


@pytest.mark.skipif(sys.platform != 'linux', reason='other systems have no such signal')
def test_the_process_ends_with_a_node_that_is_killed():
    code = NODE.format(path=sys.path)
    with subprocess.Popen([sys.executable, '-c', code], stderr=subprocess.PIPE) as node:
        assert node.stderr.readline() == b'begun\n'
        node.kill()
        assert node.communicate(timeout=120) == (None, b'')


def test_a_process_whose_node_is_gone_does_not_begin():
    done = subprocess.run(
        [sys.executable, '-c', worker._BOOTSTRAP, '0', *sys.path], stdin=subprocess.DEVNULL,
        capture_output=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (
        1, b'no calibration: the node, process 0, has gone\n')


def test_no_thread_left_is_an_answer(monkeypatch):
    def refuse(_thread):
        raise RuntimeError("can't start new thread")
    waiting = Waiting()
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, 'start', refuse)
        waiting.solver.start(job(), 60.0)
    assert waiting.solver.busy
    assert "can't start new thread" in str(waiting.outcome())
    assert not waiting.solver.busy
