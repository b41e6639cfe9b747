# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Two trajectories that do not belong together get no answer."""

from dataclasses import replace

import numpy as np
import pytest
from thinning import thinned

from trajectory_calibration import (
    calibrate,
    CalibrationConfig,
    MotionError,
    SolverError,
    Trajectory,
)
from trajectory_calibration.assessment.input_checks import (
    check_pairs,
    orientation_jumps,
    require_fit,
)
from trajectory_calibration.geometry import se3
from trajectory_calibration.simulation import (
    flat,
    Noise,
    Scenario,
    SCENARIOS,
    simulate,
    Unicycle,
    Wander,
    with_noise,
)
from trajectory_calibration.time_alignment.clock_offset import ClockCorrection
from trajectory_calibration.time_alignment.pairing import associate

# What they hold is arithmetic: one set of dependencies tells it.
pytestmark = pytest.mark.once

DRIVE = replace(SCENARIOS['offroad'], duration=60.0)


@pytest.mark.parametrize('solver', ['drift_aware', 'dnl', 'dnlo', 'park'])
@pytest.mark.parametrize('seed', range(3))
def test_two_vehicles(solver, seed):
    a, b = simulate(DRIVE, seed).a, simulate(DRIVE, seed + 50).b
    config = CalibrationConfig(solver=solver, reference='B5', time_offset_mode='fixed')
    with pytest.raises(MotionError, match='did not turn together'):
        calibrate(a, b, config)


def inverted(trajectory):
    return replace(trajectory, poses=se3.inverse(trajectory.poses))


def w_first(trajectory):
    """Return what is read where w, x, y, z were written for x, y, z, w."""
    poses = trajectory.poses.copy()
    q = se3.rotation_to_quaternion(poses[:, :3, :3])
    poses[:, :3, :3] = se3.quaternion_to_rotation(np.roll(q, 1, axis=1))
    return replace(trajectory, poses=poses)


@pytest.mark.parametrize('name', ['offroad', 'drone', 'handheld'])
@pytest.mark.parametrize(('mistake', 'option'), [
    (inverted, '--invert{}'), (w_first, '--quaternion-order{} wxyz')])
def test_a_mistaken_convention_is_named_with_the_sensor_and_the_option(name, mistake, option):
    run = simulate(replace(SCENARIOS[name], duration=60.0), 2)
    for sensor, a, b in (('a', mistake(run.a), run.b), ('b', run.a, mistake(run.b))):
        with pytest.raises(MotionError, match=f'Use {option.format("-" + sensor)}$'):
            calibrate(a, b, CalibrationConfig(solver='park', reference='B5'))


@pytest.mark.parametrize(('solver', 'unit'), [('ali', 1 / 0.3048), ('zhuang', 1e-3)])
def test_a_wrong_unit_is_not_taken_for_two_vehicles(solver, unit):
    run = simulate(DRIVE, 0)
    b = run.b.scaled(unit)
    with pytest.raises(MotionError, match=(
            f'rotation that {solver} found .* did turn together. Check the unit and scale')):
        calibrate(run.a, b, CalibrationConfig(solver=solver, reference='B5'))
    assert calibrate(run.a, b).scale == pytest.approx(1 / unit, rel=0.05)


@pytest.mark.statistical
@thinned('seeds', 1, 4)
def test_two_vehicles_are_accused_of_no_mistaken_convention(seeds):
    for seed in range(seeds):
        a, b = simulate(DRIVE, seed).a, simulate(DRIVE, seed + 50).b
        with pytest.raises(MotionError, match='Check the topics or files'):
            calibrate(a, b, CalibrationConfig(solver='park', reference='B5'))


def test_two_vehicles_that_leave_a_solver_without_an_answer(monkeypatch):
    def unsolvable(*_):
        raise SolverError('numbers out of range')

    monkeypatch.setattr('trajectory_calibration.solvers.drift_aware.solve', unsolvable)
    config = CalibrationConfig(reference='B5')
    runs = [simulate(DRIVE, seed) for seed in (0, 50)]
    with pytest.raises(MotionError, match='did not turn together'):
        calibrate(runs[0].a, runs[1].b, replace(config, time_offset_mode='fixed'))
    with pytest.raises(SolverError, match='out of range'):
        calibrate(runs[0].a, runs[0].b, config)


def test_too_few_poses_are_what_is_wrong_whatever_they_turned_about():
    run = simulate(with_noise(Scenario(0.8, Unicycle(ground=flat)), Noise(), Noise()), 3)
    with pytest.raises(SolverError, match='9 pose pairs, needed at least 10'):
        calibrate(run.a, run.b)


@pytest.mark.parametrize('offset', [6.0, 20.0])
@pytest.mark.parametrize('solver', ['drift_aware', 'dnl'])
def test_clocks_farther_apart_than_was_looked_for(solver, offset):
    run = simulate(DRIVE, 4)
    late = replace(run.b, stamps_ns=run.b.stamps_ns + round(offset * 1e9))
    with pytest.raises(MotionError, match=rf'time_offset to -{offset}.*max_time_offset'):
        calibrate(run.a, late, CalibrationConfig(solver=solver, reference='B5'))
    found = calibrate(run.a, late, CalibrationConfig(
        solver=solver, reference='B5', max_time_offset=offset + 1))
    assert found.time_offset_s == pytest.approx(-offset, abs=0.01)


@pytest.mark.statistical
@thinned('seeds', 1, 2)
@pytest.mark.parametrize(
    'offset', [6.0, *(pytest.param(k, marks=pytest.mark.slow) for k in (8.0, 15.0))])
def test_clocks_too_far_apart_on_flat_ground(offset, seeds):
    """About one axis half of all turns have the right sign by chance."""
    motion = Unicycle(speed=5.0, yaw_rate=0.3, ground=flat)
    for seed in range(seeds):
        run = simulate(replace(DRIVE, duration=90.0, motion=motion), seed)
        late = replace(run.b, stamps_ns=run.b.stamps_ns + round(offset * 1e9))
        with pytest.raises(MotionError, match='did not turn together'):
            calibrate(run.a, late, CalibrationConfig(solver='park', reference='B5'))


@pytest.mark.statistical
@thinned('seeds', 4, 12)
@pytest.mark.parametrize('name', sorted(SCENARIOS))
def test_one_vehicle_is_never_suspected(name, seeds):
    scenario = replace(SCENARIOS[name], duration=min(SCENARIOS[name].duration, 30.0))
    for seed in range(seeds):
        run = simulate(scenario, seed)
        pairs = associate(run.a, run.b)
        assert check_pairs(pairs, run.a, run.b, ClockCorrection(0.0), CalibrationConfig()) == ()
        require_fit(run.T_a_b, pairs, ('a', 'b'), 'park')


def test_hardly_any_turning_is_not_judged():
    run = simulate(Scenario(10.0, Wander(tilt=0.01, turn=0.01)), 1)
    pairs = associate(run.a, run.b)
    assert check_pairs(pairs, run.a, run.b, ClockCorrection(0.0), CalibrationConfig()) == ()


def begun_anew(run, gap_s=600.0):
    """Return the drive twice, the second time in other worlds and ``gap_s`` later."""
    worlds = [se3.from_rotation_translation(se3.exp_so3([0.0, 0.0, angle]), [5.0, 0.0, 0.0])
              for angle in (0.5, 2.5)]
    return [Trajectory(
        np.concatenate([one.stamps_ns, one.stamps_ns + round((gap_s + 60) * 1e9)]),
        np.concatenate([one.poses, world @ one.poses]), sensor_frame=name)
        for one, world, name in zip((run.a, run.b), worlds, 'ab', strict=True)]


def test_a_slam_that_began_anew_is_said():
    run = simulate(DRIVE, 0)
    pairs = associate(*begun_anew(run))
    (warning,) = orientation_jumps(pairs)
    assert warning.text.startswith('1 orientation jump (')
    assert orientation_jumps(associate(run.a, run.b)) == ()
    a, b = begun_anew(run)
    assert warning in calibrate(a, b, CalibrationConfig(solver='dnl', reference='B5')).findings
    found = calibrate(a, b)
    assert warning not in found.findings
    assert found.absolute_errors(run.T_a_b).e_at < 0.03


@pytest.mark.statistical
@thinned('seeds', 4, 12)
@pytest.mark.parametrize('name', sorted(SCENARIOS))
def test_no_step_of_one_vehicle_parts(name, seeds):
    scenario = replace(SCENARIOS[name], duration=min(SCENARIOS[name].duration, 30.0))
    for seed in range(seeds):
        run = simulate(scenario, seed)
        assert orientation_jumps(associate(run.a, run.b)) == ()


def test_one_sensor_given_twice_is_said():
    a = simulate(DRIVE, 0).a
    again = replace(a, sensor_frame='camera')
    part = Trajectory(a.stamps_ns[50:500:2], np.round(a.poses[50:500:2], 6), 'map', 'camera')
    for other in (again, part):
        assert any(item.code == 'poses-identical' for item in calibrate(a, other).findings)
    b = simulate(DRIVE, 0).b
    assert not any(item.code == 'poses-identical' for item in calibrate(a, b).findings)


def test_a_drive_that_is_too_short_for_its_noise_is_said():
    for seconds, said in ((6.0, True), (30.0, False)):
        run = simulate(replace(SCENARIOS['handheld'], duration=seconds), 0)
        for solver in ('drift_aware', 'park'):
            found = calibrate(run.a, run.b, CalibrationConfig(solver=solver))
            assert any(item.code == 'short-drive' for item in found.findings) == said
    # Where there are no errors, none are hidden.
    exact = simulate(with_noise(replace(DRIVE, duration=6.0), Noise(), Noise()), 0)
    found = calibrate(exact.a, exact.b, CalibrationConfig(solver='park'))
    assert not any(item.code == 'short-drive' for item in found.findings)
