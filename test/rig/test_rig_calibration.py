# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``calibrate_rig`` from trajectories to poses, findings and files."""

from dataclasses import replace
from itertools import combinations
import os
import re

import numpy as np
import pytest
from thinning import thinned

from benchmarks.simulated_rig import Fault, rig_scenario, RigScenario, simulate_rig
from trajectory_calibration import calibrate, CalibrationConfig, CalibrationError, ConfigError
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import ResultError, TrajectoryError
from trajectory_calibration.geometry import se3
from trajectory_calibration.rig import (
    calibrate_rig,
    fuse_results,
    RigConfig,
    RigResult,
    SensorSettings,
)
from trajectory_calibration.rig.contradictions import clock_contradictions
from trajectory_calibration.rig.pairs import calibrate_pairs
from trajectory_calibration.rig.windows import Clock
from trajectory_calibration.simulation.noise import Noise
from trajectory_calibration.simulation.paths import flat, Unicycle
from trajectory_calibration.simulation.scenario import Sensor

# What they hold is arithmetic: one set of dependencies tells it.
pytestmark = pytest.mark.once

SLAM = Noise(white=0.005, white_rotation=0.0005, walk=0.003, walk_rotation=0.0003)
FREE = {'mono': SensorSettings(scale='free')}


def vehicle(names='abc', duration=40.0, noise=SLAM, **more):
    return RigScenario({name: Sensor(noise=noise) for name in names}, duration, **more)


@pytest.fixture(scope='module')
def mixed():
    """Three sensors with different rates and clocks, one of them monocular, and their rig."""
    run = simulate_rig(rig_scenario(3, 60.0), 1)
    return run, calibrate_rig(run.trajectories, RigConfig(sensors=FREE))


def error(result, run, name):
    return se3.step_between(run.T_base_sensor[name], result.sensors[name].T_base_sensor)


def test_every_sensor_is_found_within_its_standard_deviations(mixed):
    run, rig = mixed
    assert list(rig.sensors) == ['lidar', 'gnss', 'mono']
    for name in rig.free:
        e, P = error(rig, run, name), rig.sensors[name].covariance
        assert e @ np.linalg.solve(P, e) / 6 < 4
    assert rig.sensors['mono'].scale == pytest.approx(1 / 0.37, rel=0.01)
    assert rig.sensors['mono'].clock.offset_s == pytest.approx(-0.035, abs=0.003)
    assert [item.kind for item in rig.contradictions] == ['clock']
    assert rig.p_value > 0.01


def test_loops_close(mixed):
    rig = mixed[1]
    for a, b, c in combinations(rig.sensors, 3):
        T = rig.transform(a, b) @ rig.transform(b, c) @ rig.transform(c, a)
        np.testing.assert_allclose(T, np.eye(4), atol=1e-12)


def test_covariance_between_two_sensors_is_that_of_both(mixed):
    rig = mixed[1]
    np.testing.assert_allclose(
        rig.covariance_of('lidar', 'gnss'), rig.sensors['gnss'].covariance, atol=1e-15)
    both = rig.covariance_of('gnss', 'mono')
    assert np.linalg.eigvalsh(both).min() > 0
    assert np.linalg.eigvalsh(rig.covariance).min() > 0


def test_a_rig_is_saved_and_loaded(mixed, tmp_path):
    rig = mixed[1]
    rig.save(tmp_path / 'rig.yaml')
    loaded = RigResult.load(tmp_path / 'rig.yaml')
    again = RigResult.from_dict(loaded.to_dict())
    assert again.findings == rig.findings
    assert again.contradictions == rig.contradictions
    np.testing.assert_allclose(again.transform('gnss', 'mono'), rig.transform('gnss', 'mono'),
                               atol=1e-14)
    np.testing.assert_array_equal(loaded.covariance, rig.covariance)


def test_no_rig_is_no_rig(tmp_path):
    (tmp_path / 'x.yaml').write_text('rig_format_version: 1\nbase: a\n')
    with pytest.raises(ResultError, match=f'{tmp_path}/x.yaml: not a rig'):
        RigResult.load(tmp_path / 'x.yaml')
    (tmp_path / 'x.yaml').write_text('1\n')
    with pytest.raises(ResultError, match='holds no rig'):
        RigResult.load(tmp_path / 'x.yaml')


def test_two_sensors_give_the_answer_of_calibrate():
    run = simulate_rig(vehicle('ab'), 2)
    alone = calibrate(run.trajectories['a'], run.trajectories['b'])
    rig = calibrate_rig(run.trajectories)
    np.testing.assert_allclose(rig.transform('a', 'b'), alone.T_a_b, atol=1e-9)
    np.testing.assert_allclose(rig.covariance, alone.covariance, rtol=1e-9)


@pytest.mark.parametrize('saved', [False, True])
@pytest.mark.parametrize('names', ['ab', 'abc'])
def test_scale_and_clock_are_not_more_certain_than_their_pairs(names, saved):
    run = simulate_rig(vehicle(names), 2)
    pairs = {name: calibrate(run.trajectories['a'], run.trajectories[name])
             for name in names[1:]}
    rig = fuse_results(list(pairs.values())) if saved else calibrate_rig(run.trajectories)
    for name, pair in pairs.items():
        sensor = rig.sensors[name]
        stated = pair.diagnosis
        assert stated['scale_deviation'] > 0
        assert sensor.scale_std >= 0.99 * stated['scale_deviation']
        assert sensor.clock.offset_std_s >= 0.99 * stated['time_offset_deviation_s'] > 0


def test_two_sensors_with_a_prior_give_the_answer_of_calibrate():
    run = simulate_rig(vehicle('ab'), 2)
    x = run.T_base_sensor['b'][:3, 3]
    prior = {'prior_translation': ','.join(map(str, x)), 'prior_translation_std': '0.001'}
    alone = calibrate(run.trajectories['a'], run.trajectories['b'], CalibrationConfig(**prior))
    rig = calibrate_rig(run.trajectories, RigConfig(sensors={'b': SensorSettings(**prior)}))
    np.testing.assert_allclose(rig.transform('a', 'b'), alone.T_a_b, atol=1e-9)


def test_the_base_is_whichever_is_asked_for():
    run = simulate_rig(vehicle(), 3)
    one, other = (calibrate_rig(run.trajectories, RigConfig(base=name)) for name in 'ac')
    std = np.sqrt(np.diagonal(one.covariance_of('a', 'b')))
    step = se3.step_between(one.transform('a', 'b'), other.transform('a', 'b'))
    assert (np.abs(step) < 0.5 * std).all()


def test_processes_change_nothing(monkeypatch):
    def fork():
        raise AssertionError('a fork copies the locks of every thread, and not their owners')

    # A lock that a thread of ROS or of a notebook has is never released in a fork.
    monkeypatch.setattr(os, 'fork', fork)
    run = simulate_rig(vehicle(duration=20.0), 4)
    one, two = (calibrate_rig(run.trajectories, RigConfig(processes=k)) for k in (1, 2))
    np.testing.assert_array_equal(one.covariance, two.covariance)


def test_another_vehicle_is_named_and_the_rest_is_answered():
    run = simulate_rig(vehicle('abcd', faults={'c': Fault(elsewhere=True)}), 5)
    rig = calibrate_rig(run.trajectories)
    assert [item.sensor for item in rig.contradictions] == ['c']
    assert rig.contradictions[0].kind == 'vehicle'
    assert list(rig.sensors) == ['a', 'b', 'd']
    assert rig.findings[0].code == 'rig-other-motion'


def test_a_late_clock_is_named_and_corrected():
    run = simulate_rig(vehicle('abcd', faults={'b': Fault(late=0.08)}), 6)
    rig = calibrate_rig(run.trajectories)
    assert [(item.sensor, item.kind) for item in rig.contradictions] == [('b', 'clock')]
    assert re.search('(79|80|81) ms late', rig.contradictions[0].text)
    assert np.linalg.norm(error(rig, run, 'b')[:3]) < 0.03


def test_clocks_that_all_differ_are_not_reported():
    assert clock_contradictions('abcd', [Clock(0.1 * k) for k in range(4)]) == []
    found, = clock_contradictions('abc', [Clock(), Clock(), Clock(-0.08)])
    assert found.sensor == 'c'
    assert '80 ms late' in found.text


MOVED = vehicle('abcd', duration=120.0, faults={'c': Fault(moved=0.05)})


@pytest.fixture(scope='module')
def moved():
    run = simulate_rig(MOVED, 7)
    return run, calibrate_rig(run.trajectories)


def test_a_mount_that_moved_is_named(moved):
    rig = moved[1]
    assert [(item.sensor, item.kind) for item in rig.contradictions] == [('c', 'moved')]
    assert rig.contradictions[0].p_value < 1e-3
    assert 'near 6' in rig.contradictions[0].text or 'near 5' in rig.contradictions[0].text
    assert not any(pair.used for pair in rig.pairs if 'c' in (pair.parent, pair.child))


def test_a_moved_mount_does_not_influence_the_others(moved):
    run, rig = moved
    without = calibrate_rig({k: v for k, v in run.trajectories.items() if k != 'c'})
    for name in 'bd':
        step = se3.step_between(without.transform('a', name), rig.transform('a', name))
        assert np.abs(step).max() < 1e-5


def test_a_contradicting_sensor_is_left_out_on_request(moved):
    rig = calibrate_rig(moved[0].trajectories, RigConfig(leave_out_contradicting=True))
    assert list(rig.sensors) == ['a', 'b', 'd']
    assert rig.contradictions[0].left_out
    assert rig.covariance.shape == (12, 12)


@thinned('seeds', 1, 3)
def test_mounts_that_stay_are_not_named(seeds):
    for seed in range(seeds):
        run = simulate_rig(vehicle(duration=30.0), seed)
        assert not calibrate_rig(run.trajectories).contradictions


def halves(run):
    """Return two sensors of the first half of a drive, and two of the second."""
    cut = {}
    for name, trajectory in run.trajectories.items():
        middle = len(trajectory) // 2
        part = slice(None, middle - 20) if name in 'ab' else slice(middle + 20, None)
        cut[name] = Trajectory(trajectory.stamps_ns[part], trajectory.poses[part],
                               sensor_frame=name)
    return cut


def test_a_forest_is_answered_tree_by_tree():
    run = simulate_rig(vehicle('abcd', duration=60.0), 8)
    rig = calibrate_rig(halves(run), RigConfig(calibration=CalibrationConfig(max_time_offset=0.5)))
    assert rig.trees == {'a': ('a', 'b'), 'c': ('c', 'd')}
    assert rig.covariance.shape == (12, 12)
    assert [found.code for found in rig.findings] == ['rig-groups']
    with pytest.raises(ResultError, match='no common motion'):
        rig.transform('a', 'd')


def test_a_sensor_without_common_time_is_reported():
    run = simulate_rig(vehicle('abc'), 9)
    late = run.trajectories['c']
    given = {**run.trajectories, 'c': Trajectory(
        late.stamps_ns + 10**12, late.poses, sensor_frame='c')}
    rig = calibrate_rig(given)
    assert [(item.sensor, item.kind) for item in rig.contradictions] == [('c', 'time')]
    assert list(rig.sensors) == ['a', 'b']


def test_a_sensor_that_two_others_bridge_is_answered():
    run = simulate_rig(vehicle('abc', duration=60.0), 10)
    given = dict(run.trajectories)
    for name, part in (('a', slice(None, 300)), ('c', slice(320, None))):
        track = given[name]
        given[name] = Trajectory(track.stamps_ns[part], track.poses[part], sensor_frame=name)
    rig = calibrate_rig(given, RigConfig(calibration=CalibrationConfig(max_time_offset=0.5)))
    assert list(rig.sensors) == ['a', 'b', 'c']
    assert np.linalg.norm(error(rig, run, 'c')[:3]) < 0.05


LEVEL = Unicycle(speed=5.0, yaw_rate=0.6, hold=2.0, ground=flat)


def test_heights_of_a_planar_vehicle_are_unobserved_for_every_sensor():
    run = simulate_rig(vehicle(motion=LEVEL), 11)
    rig = calibrate_rig(run.trajectories)
    assert rig.unobserved == {'b': ('z',), 'c': ('z',)}
    found = next(item for item in rig.findings if item.code == 'direction-unobserved')
    assert found.text.startswith('z of b, c unobservable')


def test_a_prior_anchors_a_height():
    run = simulate_rig(vehicle(motion=LEVEL), 11)
    z = run.T_base_sensor['b'][2, 3]
    rig = calibrate_rig(run.trajectories, RigConfig(sensors={'b': SensorSettings(
        prior_translation=f'-,-,{z}', prior_translation_std='-,-,0.005')}))
    assert rig.sensors['b'].status['z'] == 'prior'
    assert rig.unobserved == {'c': ('z',)}
    assert rig.transform('a', 'b')[2, 3] == pytest.approx(z, abs=0.02)


def test_a_prior_far_from_the_motion_is_named():
    run = simulate_rig(vehicle(), 12)
    x, y, z = run.T_base_sensor['b'][:3, 3]
    rig = calibrate_rig(run.trajectories, RigConfig(sensors={'b': SensorSettings(
        prior_translation=f'{x + 0.5},{y},{z}', prior_translation_std='0.01')}))
    assert [(item.sensor, item.kind) for item in rig.contradictions] == [('b', 'prior')]


def test_saved_pairs_make_a_rig():
    run = simulate_rig(vehicle(), 13)
    results = [calibrate(run.trajectories[i], run.trajectories[j], CalibrationConfig())
               for i, j in combinations('abc', 2)]
    rig = fuse_results(results)
    assert list(rig.sensors) == ['a', 'b', 'c']
    assert [found.code for found in rig.findings] == ['rig-shared-noise']
    # A single pair has no correlation with others.
    assert 'rig-shared-noise' not in {found.code for found in fuse_results(results[:1]).findings}
    known = calibrate_rig(run.trajectories)
    assert 'rig-shared-noise' not in {found.code for found in known.findings}
    np.testing.assert_allclose(np.sqrt(np.diagonal(rig.covariance)),
                               np.sqrt(np.diagonal(known.covariance)), rtol=0.3)
    for name in 'bc':
        e = error(rig, run, name)
        assert e @ np.linalg.solve(rig.sensors[name].covariance, e) / 6 < 4
    with pytest.raises(ConfigError, match='two results hold'):
        fuse_results([results[0], results[0]])


def test_no_pair_is_no_rig():
    faults = {name: Fault(elsewhere=True) for name in 'b'}
    run = simulate_rig(vehicle('abc', duration=30.0, faults=faults), 14)
    late = run.trajectories['c']
    given = {**run.trajectories, 'c': Trajectory(
        late.stamps_ns + 10**12, late.poses, sensor_frame='c')}
    with pytest.raises(CalibrationError, match='no two of 3 sensors'):
        calibrate_rig(given)


def test_eight_sensors_are_compared_with_three_of_them():
    run = simulate_rig(vehicle('abcdef', duration=20.0), 15)
    rig = calibrate_rig(run.trajectories)
    assert len(rig.pairs) == 5 + 4 + 3
    assert len(calibrate_rig(run.trajectories, RigConfig(pairs='base')).pairs) == 5


def test_no_pair_is_calibrated_twice():
    # The two most certain sensors are paired with all others, and once with each other.
    run = simulate_rig(vehicle('abcdef', duration=10.0), 15)
    answers, failures = calibrate_pairs(run.trajectories, 'a', RigConfig())
    seen = [frozenset((pair.parent, pair.child)) for pair in (*answers, *failures)]
    assert len(seen) == len(set(seen))


@pytest.mark.parametrize('names', ['ab', 'abc'])
def test_a_solver_that_states_no_covariance_makes_no_rig(names, monkeypatch):
    def without(*given):
        return replace(calibrate(*given), covariance=None)

    run = simulate_rig(vehicle('abc', duration=5.0), 0)
    for module in ('calibration', 'pairs'):
        monkeypatch.setattr(f'trajectory_calibration.rig.{module}.calibrate', without)
    with pytest.raises(CalibrationError, match='gave an answer: a - b: the solver states no cov'):
        calibrate_rig({name: run.trajectories[name] for name in names},
                      RigConfig(processes=1))


def test_a_free_scale_needs_a_solver_that_finds_it():
    free, park = {'b': SensorSettings(scale='free')}, CalibrationConfig(solver='park')
    trajectories = simulate_rig(vehicle('abc', duration=5.0), 0).trajectories
    for names in ('ab', 'abc'):
        with pytest.raises(ConfigError, match='sensor b has scale free, which solver park cannot'):
            calibrate_rig({name: trajectories[name] for name in names}, RigConfig(
                sensors=free, calibration=park, processes=1))
    config = RigConfig(sensors=free, calibration=CalibrationConfig(scale=2.0))
    assert config.scale_of('b') == {'scale_mode': 'estimate', 'scale': 1.0}
    assert config.scale_of('a') == {}


@pytest.mark.parametrize(('values', 'message'), [
    ({'bases': 'a'}, "key 'bases' of the rig is unknown"),
    ({'sensors': {'a': {'skale': 'free'}}}, "key 'skale' of sensor a is unknown"),
    ({'sensors': {'a': {'scale': 'any'}}}, "scale 'any' is unknown"),
    ({'sensors': {'a': {'prior_translation': '1,2,3'}}}, 'sensor a: prior_translation_std'),
    ({'sensors': {'a': 3}}, 'sensor a is 3'),
    ({'calibration': {'solvr': 'dnl'}}, "'solvr' is unknown"),
    ({'calibration': {'prior_translation': '1,2,3', 'prior_translation_std': '1'}},
     'a rig has a prior for each sensor'),
    ({'pairs': 'some'}, "pairs 'some' is unknown"),
    ({'sensors': {'b': {'scale': 'free'}}, 'calibration': {'solver': 'park'}},
     'sensor b has scale free, which solver park cannot find; use solver drift_aware'),
    ({'processes': -1}, 'processes is -1'),
])
def test_wrong_settings_are_errors(values, message):
    with pytest.raises(ConfigError, match=message):
        RigConfig.from_dict(values)


def test_settings_survive_plain_data():
    config = RigConfig(base='a', sensors={'a': SensorSettings(scale='free')}, pairs='all')
    assert RigConfig.from_dict(config.to_dict()) == config


@pytest.mark.parametrize(('given', 'config', 'error_type', 'message'), [
    ('a', RigConfig(), ConfigError, '1 sensors'),
    ('abc', RigConfig(base='x'), ConfigError, "sensor 'x' is unknown"),
    ('abc', RigConfig(sensors={'y': SensorSettings()}), ConfigError, "sensor 'y' is unknown"),
    ('abc', RigConfig(sensors={'a': SensorSettings(scale='free')}), ConfigError, 'no metric'),
])
def test_names_that_do_not_fit_are_errors(given, config, error_type, message):
    run = simulate_rig(vehicle(duration=5.0), 0)
    with pytest.raises(error_type, match=message):
        calibrate_rig({name: run.trajectories[name] for name in given}, config)


def test_a_trajectory_is_needed():
    with pytest.raises(TrajectoryError, match='needed a Trajectory'):
        calibrate_rig({'a': 1, 'b': 2})
