"""Clocks that run at different rates: found, corrected, said, and never made up."""

from dataclasses import replace

import numpy as np
from published import kitti, SEQUENCES
import pytest

from trajectory_calibration import calibrate, CalibrationConfig, CalibrationResult
from trajectory_calibration.simulation import (
    flat,
    Noise,
    Scenario,
    SCENARIOS,
    simulate,
    Unicycle,
    with_noise,
)
from trajectory_calibration.synchronisation import Clock, synchronise

PPM = 1e-6


def drive(name, seconds, *, drift=0.0, offset=0.0, of='b'):
    """Return a scenario in which one clock is ahead by ``offset`` and runs faster by ``drift``."""
    scenario = replace(SCENARIOS[name], duration=seconds)
    return replace(scenario, **{
        of: replace(getattr(scenario, of), clock_offset=offset, clock_drift=drift)})


def clock_of(run):
    return synchronise(run.a, run.b, 0.0, 'auto', 5.0)


@pytest.mark.parametrize('drift', [20 * PPM, -100 * PPM, 400 * PPM])
@pytest.mark.parametrize(('name', 'seconds'), [('offroad', 1200), ('road', 1200), ('drone', 600)])
def test_finds_any_drift_within_its_own_error_bar(name, seconds, drift):
    run = simulate(drive(name, float(seconds), drift=drift, offset=1.5), 11)
    found = clock_of(run)
    # b must run slower again: its rate, seen from a, is one over that of its clock.
    assert abs(found.drift + drift / (1 + drift)) < max(4 * found.drift_std, 0.3 * PPM)
    assert found.drift_std < 5 * PPM
    middle = -1.5 - drift * seconds / 2
    assert found.offset_s == pytest.approx(middle, abs=2e-3)


def test_the_clock_of_a_is_the_one_that_counts():
    run = simulate(drive('offroad', 1200.0, drift=50 * PPM, of='a'), 12)
    assert clock_of(run).drift == pytest.approx(50 * PPM, abs=4 * PPM)


@pytest.mark.parametrize('name', sorted(SCENARIOS))
def test_clocks_that_agree_never_drift(name):
    for seed in range(12):
        for seconds in (10.0, 60.0):
            run = simulate(drive(name, seconds, offset=0.4), 300 + seed)
            assert clock_of(run).drift == 0.0


@pytest.mark.parametrize('sequence', SEQUENCES)
def test_the_clocks_of_real_drives_do_not_drift(shared_data, sequence):
    a, b, _ = kitti(shared_data, sequence)
    assert synchronise(a, b, 0.0, 'auto', 5.0).drift == 0.0


def test_without_noise_it_is_exact():
    exact = Noise()
    scenario = drive('drone', 300.0, drift=30 * PPM)
    run = simulate(replace(scenario, a=replace(scenario.a, noise=exact),
                           b=replace(scenario.b, noise=exact)), 3)
    assert clock_of(run).drift == pytest.approx(-30 * PPM, abs=1 * PPM)


@pytest.mark.parametrize('white', [0.0, 0.002])
def test_turning_at_a_constant_rate_tells_of_no_drift(white):
    noise = Noise(white=white)
    circle = Scenario(300.0, Unicycle(speed=2.0, yaw_rate=0.4, hold=1e6, ground=flat))
    assert clock_of(simulate(with_noise(circle, noise, noise), 1)).drift == 0.0


def test_windows_are_not_in_step_with_the_driver():
    """Turns that change every two seconds, and a window every 0.2: a false 9.5 ms before."""
    run = simulate(drive('offroad', 1200.0), 8)
    assert clock_of(run) == Clock(0.0)


def test_a_fixed_clock_is_left_alone():
    run = simulate(drive('offroad', 600.0, drift=100 * PPM), 4)
    for given, mode, most in ((0.0, 'fixed', 5.0), (0.0, 'auto', 0.0)):
        assert synchronise(run.a, run.b, given, mode, most).drift == 0.0


def test_retiming_keeps_the_middle():
    run = simulate(drive('noise', 10.0), 0)
    b = run.b.retimed(1e-3)
    assert b.middle_ns == pytest.approx(run.b.middle_ns, abs=1)
    assert b.duration_s == pytest.approx(1.001 * run.b.duration_s, abs=1e-8)
    np.testing.assert_array_equal(b.poses, run.b.poses)
    assert run.b.retimed(0.0) is run.b


@pytest.mark.parametrize('solver', ['drift_aware', 'dnl'])
def test_an_answer_is_as_good_as_without_drift(tmp_path, solver):
    """Without the correction the rotation is off by 0.05 degrees."""
    config = CalibrationConfig(solver=solver, reference='auto')
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
    assert CalibrationResult.load(tmp_path / 'result.yaml').clock_drift == found.clock_drift
