# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Advice is the answer: what it predicts, what it costs, and what a driver reads."""

from types import SimpleNamespace

import numpy as np
import pytest

from trajectory_calibration import calibrate, CalibrationConfig
from trajectory_calibration.errors import CalibrationError, SolverError
from trajectory_calibration.geometry import se3
from trajectory_calibration.online import background
from trajectory_calibration.online.advice import Advice, AdviceJob
from trajectory_calibration.online.background import Background, Budget
from trajectory_calibration.online.buffer import BufferLimits, PoseBuffer
from trajectory_calibration.online.motion import measure, NO_MOTION
from trajectory_calibration.online.session import CalibrationSession, CalibrationState
from trajectory_calibration.online.snapshot import Snapshot
from trajectory_calibration.online.verification import Monitor, MonitorJob, MonitorVerdict
from trajectory_calibration.online.worker import StoppedError

T_A_B = se3.exp_se3([0.3, -0.2, 0.1, 0.4, -0.3, 1.2])
SECOND = 10**9
HEIGHT = {'prior_translation': f'-,-,{T_A_B[2, 3]}', 'prior_translation_std': '0.005'}


def drive(seconds, axes=(0, 1, 2), seed=0, rate_hz=10.0, start_s=1000, extrinsic=T_A_B):
    """Return the tracks of two sensors with drift and white noise, turning about axes of a."""
    rng = np.random.default_rng(seed)
    poses = round(seconds * rate_hz)
    dt = 1.0 / rate_hz
    time_s = np.arange(poses) * dt
    twists = np.zeros((poses, 6))
    twists[:, 0] = dt
    for axis in axes:
        twists[:, 3 + axis] = 0.4 * dt * np.sin(
            rng.uniform(0.2, 0.9) * time_s + rng.uniform(0, 6))
    steps = se3.exp_se3(twists)
    walk = np.sqrt(dt) * np.repeat([0.003, 0.0005], 3)
    white = np.repeat([0.003, 0.0005], 3)
    tracks = []
    for own, names in ((steps, ('map', 'lidar')),
                       (se3.inverse(extrinsic) @ steps @ extrinsic, ('odom', 'camera'))):
        noisy = own @ se3.exp_se3(rng.normal(size=(poses, 6)) * walk)
        track = np.empty_like(noisy)
        track[0] = np.eye(4)
        for k in range(1, poses):
            track[k] = track[k - 1] @ noisy[k]
        track[:, :3, :3] = se3.nearest_rotation(track[:, :3, :3])
        track = track @ se3.exp_se3(rng.normal(size=(poses, 6)) * white)
        rows = np.column_stack([track[:, :3, 3], se3.rotation_to_quaternion(track[:, :3, :3])])
        stamps_ns = start_s * SECOND + np.round(time_s * 1e9).astype(np.int64)
        tracks.append(Snapshot(stamps_ns, rows, *names))
    return tracks


def advised(tracks, **settings):
    job = AdviceJob(*tracks, CalibrationConfig(max_time_offset=0, **settings))
    try:
        return job.run()
    except CalibrationError as error:
        return Advice(failure=str(error))


def std_of(result):
    std = np.sqrt(np.diagonal(result.covariance))
    return np.concatenate([std[:3], np.rad2deg(std[3:])])


@pytest.mark.parametrize('solver', ['drift_aware', 'taylor'])
def test_the_prediction_is_the_answer(solver):
    tracks = drive(90)
    config = CalibrationConfig(solver=solver, max_time_offset=0)
    answer = calibrate(*(track.trajectory() for track in tracks), config)
    advice = AdviceJob(*tracks, config).run()
    assert np.allclose(advice.std, std_of(answer), rtol=1e-4)
    assert np.allclose(advice.result.T_a_b, answer.T_a_b, atol=1e-9)


@pytest.mark.slow
def test_very_many_poses_are_thinned_and_predict_the_same_within_a_fifth():
    tracks = drive(500, rate_hz=200.0)
    thin = tracks[0].thinned()
    assert (len(tracks[0].stamps_ns), len(thin.stamps_ns)) == (100_000, 20_000)
    assert np.diff(thin.stamps_ns).max() <= SECOND // 10
    config = CalibrationConfig(max_time_offset=0)
    answer = calibrate(*(track.trajectory() for track in tracks), config)
    ratio = AdviceJob(*tracks, config).run().std / std_of(answer)
    assert (np.abs(ratio - 1) < 0.2).all(), ratio


def test_a_low_rate_is_not_thinned():
    stamps_ns = np.arange(50_000) * SECOND // 10
    track = Snapshot(stamps_ns, np.zeros((50_000, 7)), 'map', 'lidar')
    assert track.thinned() is track
    assert len(track.after(int(stamps_ns[-11])).stamps_ns) == 10


@pytest.mark.parametrize('settings, sentence', [
    ({}, ('drive a ramp or a bank, or give prior_translation along z of lidar: translation along '
          'z of lidar is unobservable, needed 0.02 m')),
    (HEIGHT, 'enough motion: call ~/calibrate'),
    ({'allow_unobserved': True},
     'enough motion: call ~/calibrate; translation along z of lidar remains unobservable'),
])
def test_on_flat_ground_it_says_what_is_missing_and_what_helps(settings, sentence):
    advice = advised(drive(240, axes=(2,)), **settings)
    assert advice.sentence(0.02, 0.2) == sentence
    assert advice.sufficient(0.02, 0.2) == sentence.startswith('enough')


def test_little_motion_names_the_worst_direction_and_its_deviation():
    advice = advised(drive(60))
    assert not advice.sufficient(0.001, 0.001)
    sentence = advice.sentence(0.001, 0.001)
    assert sentence.startswith('turn more about ') and sentence.endswith(', needed 0.001 deg')
    assert ' has a standard deviation of ' in sentence


def test_a_calibration_that_would_fail_is_advice():
    tracks = drive(30)
    later = Snapshot(tracks[1].stamps_ns + 3600 * SECOND, tracks[1].poses, 'odom', 'camera')
    advice = advised([tracks[0], later])
    assert not advice.sufficient(1.0, 10.0)
    assert advice.sentence(0.02, 0.2).startswith('drive on: a calibration would fail now: ')


def filled(tracks):
    session = CalibrationSession(('/a', '/b'), BufferLimits())
    for buffer, track in zip(session.buffers, tracks, strict=True):
        buffer.replace(track.stamps_ns, track.poses, (track.world_frame, track.sensor_frame))
    return session


def test_motion_is_counted_in_seconds_that_both_sensors_have():
    a, b = drive(30)
    session = filled([a, b.after(int(b.stamps_ns[99]))])
    motion = measure(session.buffers, (0, 0))
    assert len(motion) == 20
    assert len(measure(session.buffers, (0, 100 * SECOND))) == 0
    assert motion.since(NO_MOTION) == 20 and motion.since(motion) == 0
    assert motion.continues(NO_MOTION) and motion.continues(motion)
    assert not NO_MOTION.continues(motion)


def test_a_vehicle_that_waits_adds_no_motion():
    a, b = drive(20)
    session = filled([a, b])
    before = measure(session.buffers, (0, 0))
    for buffer, track in zip(session.buffers, (a, b), strict=True):
        for k in range(600):
            buffer.append(int(track.stamps_ns[-1]) + (k + 1) * SECOND // 10,
                          (track.world_frame, track.sensor_frame), tuple(track.poses[-1]))
    assert measure(session.buffers, (0, 0)).since(before) <= 4


def test_counting_costs_little_with_a_hundred_thousand_poses():
    import time
    buffers = [PoseBuffer(BufferLimits()) for _ in range(2)]
    rows = np.zeros((100_000, 7))
    rows[:, 0], rows[:, 6] = np.arange(100_000), 1.0
    for buffer in buffers:
        buffer.replace(np.arange(1, 100_001) * SECOND // 10, rows, ('map', ''))
    seconds = []
    for _ in range(3):
        start = time.process_time()
        measure(buffers, (0, 0))
        seconds.append(time.process_time() - start)
    assert min(seconds) < 0.02


class Process:
    """Stands for the solver process: every job costs so many CPU seconds, and ends when told."""

    outcome = Advice(failure='not tried')
    cost_s = 1.0

    def __init__(self, done):
        del done
        self.jobs, self.busy, self.cpu_s = [], False, 0.0

    def start(self, job, timeout_s):
        del timeout_s
        self.jobs.append(job)
        self.busy = True

    def take_outcome(self):
        self.busy, self.cpu_s = False, self.cost_s
        return self.outcome

    def cancel(self, reason):
        self.outcome = StoppedError(reason)


@pytest.fixture
def scene(monkeypatch):
    """Return a background without a process, and a session that can be given poses."""
    monkeypatch.setattr(background, 'SolverProcess', Process)
    session = CalibrationSession(('/a', '/b'), BufferLimits())
    return Background(session, lambda: None, -10.0), session


def poll(worker, session, now_s, **settings):
    worker.poll(measure(session.buffers, (0, 0)), CalibrationConfig(**settings), ('', ''), 60.0,
                now_s)


@pytest.mark.parametrize('cost_s', [0.5, 5.0, 20.0])
def test_it_takes_three_percent_of_a_core_and_a_credit(scene, monkeypatch, cost_s):
    monkeypatch.setattr(Process, 'cost_s', cost_s)
    worker, session = scene
    tracks = drive(1000, rate_hz=2.0)
    for second in range(1000):
        for buffer, track in zip(session.buffers, tracks, strict=True):
            for k in range(2 * second, 2 * second + 2):
                buffer.append(int(track.stamps_ns[k]), ('map', 's'), tuple(track.poses[k]))
        poll(worker, session, float(second))
        worker.take(second + 0.5)
    jobs = worker._process.jobs
    assert len(jobs) >= 2
    # The last one may go beyond: nobody knows its cost before.
    assert (len(jobs) - 1) * cost_s <= background.CPU_CREDIT_S + 0.03 * 1000


def test_a_new_setting_asks_anew_at_once_and_the_same_does_not(scene):
    worker, session = scene
    for buffer, track in zip(session.buffers, drive(30), strict=True):
        buffer.replace(track.stamps_ns, track.poses, ('map', 's'))
    for now_s in (0.0, 3.0, 6.0):
        poll(worker, session, now_s)
        worker.take(now_s)
    assert len(worker._process.jobs) == 1
    poll(worker, session, 9.0, **HEIGHT)
    assert len(worker._process.jobs) == 2
    worker.take(9.0)
    assert worker.advice is Process.outcome
    worker.reset()
    assert worker.advice is None
    poll(worker, session, 12.0)
    assert len(worker._process.jobs) == 3


def test_what_was_stopped_for_a_call_is_asked_again(scene):
    worker, session = scene
    for buffer, track in zip(session.buffers, drive(30), strict=True):
        buffer.replace(track.stamps_ns, track.poses, ('map', 's'))
    poll(worker, session, 0.0)
    worker.stop('a calibration was called for')
    assert worker.take(1.0) is None
    worker._process.outcome = Advice(failure='x')
    poll(worker, session, 4.0)
    assert worker.take(5.0) is worker.advice
    assert len(worker._process.jobs) == 2


def test_too_little_motion_starts_nothing(scene):
    worker, session = scene
    for buffer, track in zip(session.buffers, drive(4), strict=True):
        buffer.replace(track.stamps_ns, track.poses, ('map', 's'))
    poll(worker, session, 0.0)
    assert not worker._process.jobs


def test_a_process_that_fails_is_advice_or_a_verdict(scene):
    worker, session = scene
    for buffer, track in zip(session.buffers, drive(30), strict=True):
        buffer.replace(track.stamps_ns, track.poses, ('map', 's'))
    worker._process.outcome = SolverError('no memory')
    poll(worker, session, 0.0)
    worker.take(0.0)
    assert worker.advice.failure == 'no memory'
    check = MonitorJob(None, None, None, None)
    worker.monitor = SimpleNamespace(job=lambda *_: check)
    poll(worker, session, 3.0)
    worker.take(3.0)
    assert worker.verdict.sentence == 'cannot tell: no memory'


def test_the_budget_never_holds_more_than_its_credit():
    budget = Budget(0.0)
    assert budget.allows(1e6)
    budget.spend(background.CPU_CREDIT_S + 3.0)
    assert not budget.allows(1e6 + 99.0)
    assert budget.allows(1e6 + 101.0)


def test_moved_once_is_a_warning_twice_an_error_and_poor_motion_neither():
    moved, poor, holds = (MonitorVerdict(name, status, name) for name, status in (
        ('moved', 4), ('cannot tell', 3), ('holds', 0)))
    verdict, levels = None, []
    for found in (holds, moved, poor, moved, moved, poor, holds):
        verdict = found.following(verdict)
        levels.append(verdict.level)
    assert levels == [0, 1, 1, 2, 2, 2, 0]


@pytest.mark.parametrize('shift, verdict', [(0.0, 'holds'), (0.1, 'moved')])
def test_a_sensor_that_was_knocked_is_found(shift, verdict):
    result = calibrate(*(track.trajectory() for track in drive(240, seed=1)),
                       CalibrationConfig(max_time_offset=0))
    moved = se3.from_rotation_translation(np.eye(3), [shift, 0, 0]) @ T_A_B
    session = filled(drive(240, seed=2, start_s=5000, extrinsic=moved))
    monitor = Monitor(60.0, 600.0)
    assert monitor.job(session, ('', ''), result.config, 0.0) is None
    monitor.watch(result, session, restored=True)
    job = monitor.job(session, ('', ''), result.config, 0.0)
    found = job.run()
    assert (found.verdict, found.exit_status) == (verdict, {'holds': 0, 'moved': 4}[verdict])
    # The same poses confirm nothing.
    assert monitor.job(session, ('', ''), result.config, 60.0) is None
    more = drive(280, seed=2, start_s=5000, extrinsic=moved)
    for buffer, track in zip(session.buffers, more, strict=True):
        buffer.replace(track.stamps_ns, track.poses, (track.world_frame, track.sensor_frame))
    assert monitor.job(session, ('', ''), result.config, 59.0) is None
    assert monitor.job(session, ('', ''), result.config, 60.0) is not None
    # An answer from these very poses is confirmed by others only.
    monitor.watch(result, session, restored=False)
    assert monitor.job(session, ('', ''), result.config, 200.0) is None


def test_a_check_looks_at_the_window_only():
    session = filled(drive(240))
    result = calibrate(*(track.trajectory() for track in session.tracks()),
                       CalibrationConfig(max_time_offset=0))
    monitor = Monitor(1.0, 30.0)
    monitor.watch(result, session, restored=True)
    job = monitor.job(session, ('', ''), result.config, 0.0)
    assert len(job.track_a.stamps_ns) == 300


def test_a_failure_is_old_news_after_a_fifth_more_motion():
    state, session = CalibrationState(), filled(drive(100))
    motion = measure(session.buffers, (0, 0))
    assert state.has_moved_on(motion)
    state.started(motion)
    state.failed('because')
    assert state.last_failure == 'calibration failed: because'
    assert not state.has_moved_on(motion)
    longer = measure(filled(drive(122)).buffers, (0, 0))
    assert state.has_moved_on(longer)
    # A buffer that began anew.
    assert state.has_moved_on(NO_MOTION)
    state.reset()
    assert state.last_failure == ''


def test_a_refused_answer_of_before_is_told_until_there_is_another():
    state, session = CalibrationState(), filled(drive(100))
    result = session.job(CalibrationConfig(solver='taylor')).run().result
    for end in (lambda: state.succeeded(result), state.reset):
        state.not_restored = 'not restored: because'
        state.failed('because')
        assert state.not_restored == 'not restored: because'
        end()
        assert (state.not_restored, state.last_failure) == ('', '')
