# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Unobserved directions are not tested: a height on flat ground contradicts nothing."""

import numpy as np
import pytest
from thinning import thinned

from benchmarks.simulated_rig import Fault, RigScenario, simulate_rig
from trajectory_calibration import CalibrationConfig
from trajectory_calibration.assessment.observability import limits_of
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.chi_squared import exceedance
from trajectory_calibration.geometry.observed import (
    drawn_near,
    misfit,
    unobserved_directions,
    without,
)
from trajectory_calibration.outputs.comparison_table import rig_to_data, rig_to_text
from trajectory_calibration.rig import calibrate_rig
from trajectory_calibration.rig.comparison import compare_rigs
from trajectory_calibration.simulation.noise import Noise
from trajectory_calibration.simulation.paths import flat, Unicycle
from trajectory_calibration.simulation.scenario import random_pose, Sensor

# What they hold is arithmetic: one set of dependencies tells it.
pytestmark = pytest.mark.once

LIMITS = limits_of(CalibrationConfig())
SLAM = Noise(white=0.005, white_rotation=0.0005, walk=0.003, walk_rotation=0.0003)
LEVEL = Unicycle(speed=5.0, yaw_rate=0.6, hold=2.0, ground=flat)


def covariance(rng):
    A = np.diag(np.repeat([0.02, 0.002], 3)) @ rng.standard_normal((6, 6))
    return A @ A.T


def turned(rng):
    """Return a (6, 6) rotation of both halves."""
    return np.kron(np.eye(2), random_pose(rng)[:3, :3])


def level(seed, noise=SLAM, **more):
    sensors = {name: Sensor(noise=noise) for name in 'abcd'[:more.pop('sensors', 3)]}
    return simulate_rig(RigScenario(sensors, 40.0, motion=LEVEL, **more), seed)


def test_without_unobserved_directions_it_is_chi_squared():
    rng = np.random.default_rng(0)
    V, error = covariance(rng), 0.01 * rng.standard_normal(6)
    value, degrees = misfit(error, V, LIMITS)
    assert degrees == 6
    assert value == pytest.approx(error @ np.linalg.solve(V, error), rel=1e-9)


def test_an_unobserved_direction_has_no_influence_in_any_axes():
    rng = np.random.default_rng(1)
    known, error = covariance(rng), 0.01 * rng.standard_normal(6)
    height = np.eye(6)[2]
    V = known + 100.0 * np.outer(height, height)
    wanted = misfit(error, V, LIMITS)
    assert wanted[1] == 5
    for _ in range(5):
        R = turned(rng)
        value, degrees = misfit(R @ (error + 7.0 * height), R @ V @ R.T, LIMITS)
        assert degrees == 5
        # Seven metres along an unobservable direction change little: 1e-4 of its standard
        # deviation.
        assert value == pytest.approx(wanted[0], rel=0.01)


def test_a_weight_without_a_direction_is_that_of_the_best_step_along_it():
    rng = np.random.default_rng(3)
    W, step = np.linalg.inv(covariance(rng)), 0.01 * rng.standard_normal(6)
    height = 0.5 * np.eye(6)[:, [2]] + 0.01 * np.eye(6)[:, [4]]
    value = step @ without(W, height) @ step
    # For any step along the unobservable direction, and never larger than with it.
    moved = step + 7.0 * height[:, 0]
    assert moved @ without(W, height) @ moved == pytest.approx(value, rel=1e-6)
    best = -(height[:, 0] @ W @ step) / (height[:, 0] @ W @ height[:, 0])
    nearest = step + best * height[:, 0]
    assert value == pytest.approx(nearest @ W @ nearest, rel=1e-6)
    np.testing.assert_array_equal(without(W, np.zeros((6, 0))), W)


def test_chance_of_nothing_is_one():
    assert exceedance(0.0, 0) == 1.0
    assert exceedance(float('nan'), 6) == 1.0
    assert exceedance(16.748, 5) == pytest.approx(0.005, rel=1e-3)


def test_an_answer_comes_near_along_unobserved_directions_only():
    rng = np.random.default_rng(2)
    near, P = random_pose(rng), np.diag(np.repeat([1e-4, 1e-6], 3))
    far = se3.moved(near, [0.01, -0.02, 300.0, 0.001, 0.0, 0.0])
    same, unchanged = drawn_near(far, P, near, LIMITS)
    np.testing.assert_array_equal(same, far)
    np.testing.assert_array_equal(unchanged, P)
    P[2, 2] = 100.0
    np.testing.assert_allclose(
        np.abs(unobserved_directions(P, LIMITS)), LIMITS[2] * np.eye(6)[:, [2]])
    drawn, wider = drawn_near(far, P, near, LIMITS)
    np.testing.assert_allclose(
        se3.step_between(near, drawn), [0.01, -0.02, 0, 0.001, 0, 0], atol=1e-9)
    # 300 m along a direction that is known to a milliradian are 0.3 m sideways.
    np.testing.assert_allclose(np.diagonal(wider - P), [0.09, 0.09, 0, 0, 0, 0], atol=1e-12)


@thinned('seeds', 2, 5)
@pytest.mark.parametrize('noise', [SLAM, Noise()])
def test_correct_sensors_on_flat_ground_do_not_contradict(noise, seeds):
    for seed in range(11, 11 + seeds):
        rig = calibrate_rig(level(seed, noise).trajectories)
        assert not rig.contradictions
        assert rig.degrees == 5
        assert rig.p_value > 1e-3
        assert rig.unobserved == {'b': ('z',), 'c': ('z',)}
        assert all(0 < pair.degrees <= 5 for pair in rig.pairs)


def test_another_vehicle_on_flat_ground_is_named():
    run = level(11, sensors=4, faults={'c': Fault(elsewhere=True)})
    assert [(item.sensor, item.kind) for item in calibrate_rig(
        run.trajectories).contradictions] == [('c', 'vehicle')]


def test_rigs_of_flat_drives_are_compared_without_their_heights():
    one, other = (calibrate_rig(level(seed, sensors=3).trajectories) for seed in (12, 13))
    # Another drive, the same mounts.
    for name in 'bc':
        X = one.sensors[name].T_base_sensor
        other.sensors[name].T_base_sensor[:] = se3.moved(X, [0.001, 0.001, 4.0, 0, 0, 0])
    same = compare_rigs(one, other)
    assert same.holds
    assert same.degrees == 10
    other.sensors['c'].T_base_sensor[1, 3] += 0.5
    table = rig_to_text(same)
    assert table.count('holds (z not compared)') == 2
    assert [row['dz_m'] for row in rig_to_data(same)['sensors']] == [None, None]
    assert all(np.nansum(item.std[:3]) < 0.5 for item in same.sensors)
    moved = compare_rigs(one, other)
    assert [change.sensor for change in moved.changes] == ['c']
    assert moved.changes[0].degrees == 5
