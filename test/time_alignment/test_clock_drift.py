# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Clocks that run at different rates: found, corrected, said, and never made up."""

from dataclasses import replace

from motion_data import random_pose
import numpy as np
from published import kitti, SEQUENCES
import pytest
from thinning import thinned

from trajectory_calibration import calibrate, CalibrationConfig, CalibrationResult, Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.simulation import (
    flat,
    Noise,
    Scenario,
    SCENARIOS,
    Sensor,
    simulate,
    Unicycle,
    Wander,
)
from trajectory_calibration.time_alignment.clock_offset import ClockCorrection, synchronise

# What they hold is arithmetic: one set of dependencies tells it.
pytestmark = pytest.mark.once

PPM = 1e-6


def drive(name, seconds, *, drift=0.0, offset=0.0, of='b'):
    """Return a scenario in which one clock is ahead by ``offset`` and runs faster by ``drift``."""
    scenario = replace(SCENARIOS[name], duration=seconds)
    return replace(scenario, **{
        of: replace(getattr(scenario, of), clock_offset=offset, clock_drift=drift)})


def clock_of(run):
    return synchronise(run.a, run.b, 0.0, 'auto', 5.0)


def rested(rate, seconds, X, rng, name):
    """Return a sensor of a drone that flies for two minutes and then stands."""
    times = np.arange(int(seconds * rate)) / rate
    path = Wander(2.0, 0.1, 0.6, 0.2).draw(200.0, np.random.default_rng(0))
    noise = rng.normal(size=(len(times), 6)) * np.repeat([0.005, 0.0005], 3)
    poses = path(np.minimum(times, 120)) @ X @ se3.exp_se3(noise)
    return Trajectory(10**18 + np.rint(times * 1e9).astype(np.int64), poses, sensor_frame=name)


@pytest.mark.parametrize('drift', [20 * PPM, -100 * PPM, 400 * PPM])
@pytest.mark.parametrize(('name', 'seconds'), [('offroad', 1200), ('road', 1200), ('drone', 600)])
def test_finds_any_drift_within_its_own_error_bar(name, seconds, drift):
    run = simulate(drive(name, float(seconds), drift=drift, offset=1.5), 11)
    found = clock_of(run)
    # b must run slower again: its rate, seen from a, is one over that of its clock.
    assert abs(found.drift + drift / (1 + drift)) < 4 * found.drift_std
    assert found.drift_std < 3 * PPM
    assert found.uneven_s == 0.0
    middle = -1.5 - drift * seconds / 2
    assert found.offset_s == pytest.approx(middle, abs=2e-3)


@pytest.mark.statistical
@thinned('seeds', 8, 24)
def test_the_error_bar_of_a_drift_is_honest(seeds):
    scores = []
    for seed in range(seeds):
        run = simulate(drive('offroad', 300.0, drift=300 * PPM), 40 + seed)
        found = clock_of(run)
        scores.append((found.drift + 300 * PPM / (1 + 300 * PPM)) / found.drift_std)
    assert 0.25 < np.sqrt(np.mean(np.square(scores))) < 1.3


def test_the_clock_of_a_is_the_one_that_counts():
    run = simulate(drive('offroad', 1200.0, drift=50 * PPM, of='a'), 12)
    assert clock_of(run).drift == pytest.approx(50 * PPM, abs=4 * PPM)


@pytest.mark.statistical
@thinned('seeds', 4, 12)
@pytest.mark.parametrize('name', sorted(SCENARIOS))
def test_clocks_that_agree_never_drift(name, seeds):
    for seed in range(seeds):
        for seconds in (10.0, 60.0):
            run = simulate(drive(name, seconds, offset=0.4), 300 + seed)
            assert clock_of(run).drift == 0.0


def test_the_last_century_of_stamps_is_as_good_as_any():
    """Twice such a stamp is more than 64 bits hold."""
    run = simulate(drive('drone', 300.0, drift=100 * PPM), 3)
    far = [replace(one, stamps_ns=one.stamps_ns + 7 * 10**18) for one in (run.a, run.b)]
    near, found = clock_of(run), synchronise(*far, 0.0, 'auto', 5.0)
    assert found == replace(near, drift_from_ns=near.drift_from_ns + 7 * 10**18)


@pytest.mark.parametrize('seconds', [0.01, 0.2])
def test_a_clock_that_was_set_is_uneven(seconds):
    run = simulate(drive('handheld', 600.0), 6)
    late = run.b.stamps_ns > run.b.stamps_ns[0] + 3 * 10**11
    b = replace(run.b, stamps_ns=run.b.stamps_ns + np.where(late, round(seconds * 1e9), 0))
    assert seconds / 8 < synchronise(run.a, b, 0.0, 'auto', 5.0).uneven_s < seconds
    found = calibrate(run.a, b, CalibrationConfig(solver='park', reference='B5'))
    assert any(finding.code == 'clock-uneven' for finding in found.findings)


@pytest.mark.statistical
@thinned('seeds', 1, 3)
@pytest.mark.parametrize('rates', [(10.0, 10.0), (10.0, 10.002), (20.001, 10.0), (10.0, 100.0)])
def test_the_beat_of_two_rates_is_no_drift(rates, seeds):
    """Two sensors that hardly turn, so that the noise of a has a say."""
    noise = Noise(white=0.01, white_rotation=0.001)
    motion = Unicycle(speed=15.0, yaw_rate=0.05, hold=4.0, ground=flat)
    for seed in range(seeds):
        run = simulate(
            Scenario(600.0, motion, *(Sensor(rate, noise) for rate in rates)), seed)
        assert clock_of(run).drift == 0.0


@pytest.mark.statistical
@thinned('seeds', 1, 3)
@pytest.mark.parametrize('rates', [(10.0, 10.0), (10.0, 20.0), (10.0, 10.003)])
def test_a_long_rest_is_no_drift(rates, seeds):
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        a, b = (rested(rate, 1200.0, X, rng, name) for rate, X, name in zip(
            rates, (np.eye(4), random_pose(rng)), 'ab', strict=True))
        assert synchronise(a, b, 0.0, 'auto', 5.0).drift == 0.0


def test_the_drift_counts_from_the_middle_of_the_common_time():
    run = simulate(drive('offroad', 2400.0, drift=100 * PPM, offset=-0.2), 2)
    late = run.a.stamps_ns > run.a.stamps_ns[0] + 1_800_000_000_000
    a = replace(run.a, stamps_ns=run.a.stamps_ns[late], poses=run.a.poses[late])
    # Of 2100 s, which is in the middle, b has made 0.21 s too many.
    found = synchronise(a, run.b, 0.0, 'auto', 0.05)
    assert found.drift == pytest.approx(-100 * PPM, abs=15 * PPM)
    assert found.drift_from_ns == pytest.approx(run.a.stamps_ns[0] + 2100.01e9, abs=1e9)
    assert found.offset_s == pytest.approx(-0.01, abs=2e-3)
    ahead = replace(run.b, stamps_ns=run.b.stamps_ns + 10**9)
    same = synchronise(a, ahead, -1.0, 'estimate', 0.05)
    assert same.drift_from_ns == found.drift_from_ns + 10**9
    assert same.offset_s == pytest.approx(found.offset_s - 1.0, abs=1e-6)


@pytest.mark.parametrize('sequence', SEQUENCES)
def test_the_clocks_of_real_drives_do_not_drift(shared_data, sequence):
    a, b, _ = kitti(shared_data, sequence)
    assert synchronise(a, b, 0.0, 'auto', 5.0).drift == 0.0


def test_without_noise_it_is_exact():
    exact = Noise()
    scenario = drive('drone', 300.0, drift=30 * PPM)
    run = simulate(replace(scenario, a=replace(scenario.a, noise=exact),
                           b=replace(scenario.b, noise=exact)), 3)
    assert clock_of(run).drift == pytest.approx(-30 * PPM, abs=0.2 * PPM)


@pytest.mark.statistical
@thinned('seeds', 1, 4)
@pytest.mark.parametrize('rate', [10.0, 10.003])
@pytest.mark.parametrize('white', [0.0, 0.002])
def test_turning_at_a_constant_rate_tells_of_no_drift(white, rate, seeds):
    noise = Noise(white=white, white_rotation=white)
    motion = Unicycle(speed=2.0, yaw_rate=0.4, hold=1e6, ground=flat)
    for seed in range(seeds):
        run = simulate(Scenario(300.0, motion, Sensor(10.0, noise), Sensor(rate, noise)), seed)
        assert clock_of(run).drift == 0.0


def test_windows_are_not_in_step_with_the_driver():
    """Turns that change every two seconds, and a window every 0.2: a false 9.5 ms before."""
    run = simulate(drive('offroad', 1200.0), 8)
    assert clock_of(run) == ClockCorrection(0.0)


def test_a_fixed_clock_is_left_alone():
    run = simulate(drive('offroad', 600.0, drift=100 * PPM), 4)
    for given, mode, most in ((0.0, 'fixed', 5.0), (0.0, 'auto', 0.0)):
        assert synchronise(run.a, run.b, given, mode, most).drift == 0.0


def test_retiming_agrees_where_it_starts_from():
    b = simulate(drive('noise', 10.0), 0).b
    k = 37
    retimed = b.retimed(1e-3, b.stamps_ns[k])
    assert retimed.stamps_ns[k] == b.stamps_ns[k]
    assert retimed.duration_s == pytest.approx(1.001 * b.duration_s, abs=1e-8)
    np.testing.assert_array_equal(retimed.poses, b.poses)
    assert b.retimed(0.0, 0) is b


@pytest.mark.parametrize('solver', ['drift_aware', 'dnl'])
def test_an_answer_is_as_good_as_without_drift(tmp_path, solver):
    """Without the correction the rotation is off by 0.05 degrees."""
    # With one reference: auto may take another one for the other recording.
    config = CalibrationConfig(solver=solver, reference='B5')
    runs = [simulate(drive('offroad', 1200.0, drift=drift), 5) for drift in (0.0, 60 * PPM)]
    plain, found = (calibrate(run.a, run.b, config) for run in runs)
    assert plain.clock_drift == 0.0
    assert found.clock_drift == pytest.approx(-60 * PPM, abs=4 * PPM)
    assert any('the clock of camera runs fast by ' in text for text in found.warnings)
    assert not any('runs fast' in text for text in plain.warnings)
    better, worse = (result.absolute_errors(runs[0].T_a_b) for result in (plain, found))
    assert worse.e_at < better.e_at + 0.002
    assert worse.e_aR < better.e_aR + np.deg2rad(0.01)
    found.save(tmp_path / 'result.yaml')
    loaded = CalibrationResult.load(tmp_path / 'result.yaml')
    assert loaded.clock_drift == found.clock_drift
    assert loaded.clock_drift_from_ns == found.clock_drift_from_ns
    data = found.to_dict()
    del data['clock_drift'], data['clock_drift_from_ns']
    assert CalibrationResult.from_dict(data).clock_drift == 0.0
