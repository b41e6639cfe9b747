# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Between two poses: laws of the path, and what it must not take from neighbours."""

from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st
from motion_data import random_pose
import numpy as np
import pytest

from trajectory_calibration import calibrate, CalibrationConfig, Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.interpolation import interpolate
from trajectory_calibration.simulation import (
    Noise,
    paper_scenario,
    Scenario,
    Sensor,
    simulate,
    Wander,
)

MS = 1_000_000

# So few that a leap is not looked for.
uneven = st.lists(st.integers(1, 400), min_size=1, max_size=9).map(
    lambda steps: np.cumsum([0, *steps]).astype(np.int64) * MS)


def within(stamps_ns, rng, count=40):
    """Return times inside the span, the stamps themselves among them."""
    return np.sort(np.r_[stamps_ns, rng.integers(0, stamps_ns[-1] + 1, count)])


def curve(times_ns, seed=1, frequency=0.3):
    """Return poses on a smooth path that turns and moves about and along all axes."""
    path = Wander(2.0, 0.4, 1.0, frequency).draw(1.0, np.random.default_rng(seed))
    return path(np.asarray(times_ns) * 1e-9)


@given(uneven, st.integers(0, 99))
def test_a_constant_twist_is_exact_on_any_stamps(stamps_ns, seed):
    rng = np.random.default_rng(seed)
    twist, start = rng.normal(0, 0.5, 6), random_pose(rng)
    at = within(stamps_ns, rng)
    poses, expected = (
        start @ se3.exp_se3(times[:, None] * 1e-9 * twist) for times in (stamps_ns, at))
    np.testing.assert_allclose(
        interpolate(stamps_ns, poses, at, max_gap_ns=None), expected, atol=1e-9)


@given(uneven, st.integers(0, 99))
def test_the_path_is_the_same_in_all_frames(stamps_ns, seed):
    """Otherwise A X = X B would not hold between poses that are interpolated."""
    rng = np.random.default_rng(seed)
    G, X = random_pose(rng), random_pose(rng)
    poses, at = curve(stamps_ns, seed), within(stamps_ns, rng)
    np.testing.assert_allclose(
        interpolate(stamps_ns, G @ poses @ X, at, max_gap_ns=None),
        G @ interpolate(stamps_ns, poses, at, max_gap_ns=None) @ X, atol=1e-9)


@given(uneven, st.integers(0, 99))
def test_at_the_stamps_are_the_poses(stamps_ns, seed):
    poses = curve(stamps_ns, seed)
    np.testing.assert_allclose(
        interpolate(stamps_ns, poses, stamps_ns, max_gap_ns=None), poses, atol=1e-12)


@settings(max_examples=50)
@given(uneven, st.integers(0, 99))
def test_no_pose_is_noisier_than_those_it_comes_from(stamps_ns, seed):
    """Without rotations the path is linear in the positions: move each alone."""
    at = within(stamps_ns, np.random.default_rng(seed))
    weights = []
    for k in range(len(stamps_ns)):
        poses = np.tile(np.eye(4), (len(stamps_ns), 1, 1))
        poses[k, 0, 3] = 1.0
        weights.append(interpolate(stamps_ns, poses, at, max_gap_ns=None)[:, 0, 3])
    np.testing.assert_allclose(np.sum(weights, axis=0), 1.0, atol=1e-9)
    assert np.square(weights).sum(axis=0).max() <= 1 + 1e-9


@pytest.mark.parametrize('step_ms', [200, 100])
def test_half_the_step_is_a_sixteenth_of_the_error(step_ms):
    def error(step_ms):
        stamps_ns = np.arange(0, 20_000 + step_ms, step_ms, dtype=np.int64) * MS
        at = stamps_ns[1:-2] + step_ms * MS // 2
        found = interpolate(stamps_ns, curve(stamps_ns), at, max_gap_ns=None)
        return np.median(np.linalg.norm(se3.step_between(curve(at), found), axis=1))

    assert error(step_ms) / error(step_ms // 2) == pytest.approx(16, rel=0.1)


def test_what_lies_beyond_a_gap_or_half_a_turn_away_changes_nothing():
    stamps_ns = np.array([0, 100, 200, 300, 1000, 1100, 1200, 1300]) * MS
    at, poses = np.array([50, 250, 1050, 1150]) * MS, curve(stamps_ns)
    found = interpolate(stamps_ns, poses, at, max_gap_ns=500 * MS)
    other = poses.copy()
    other[4:] = other[4:] @ random_pose(np.random.default_rng(3))
    np.testing.assert_array_equal(
        interpolate(stamps_ns, other, at, max_gap_ns=500 * MS)[:2], found[:2])
    turned, further = poses.copy(), poses.copy()
    turned[6] = turned[6] @ se3.exp_se3(np.array([0, 0, 0, 0, 0, 2.0]))
    further[6] = further[6] @ se3.exp_se3(np.array([9.0, 0, 0, 0, 0, 3.0]))
    np.testing.assert_array_equal(
        interpolate(stamps_ns, turned, at[2:3], max_gap_ns=500 * MS),
        interpolate(stamps_ns, further, at[2:3], max_gap_ns=500 * MS))


@pytest.mark.parametrize('jump', [
    [0.2, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0.1, 0], [3.0, -2.0, 0, 0.3, 0, 0]])
def test_a_jump_stays_in_its_interval(jump):
    stamps_ns = np.arange(0, 10_000, 100) * MS
    jumped = curve(stamps_ns, frequency=0.1)
    jumped[50:] = jumped[50:] @ se3.exp_se3(np.array(jump))
    at = stamps_ns[:-1] + 50 * MS
    found = interpolate(stamps_ns, jumped, at, max_gap_ns=None)
    expected = curve(at, frequency=0.1)
    expected[50:] = expected[50:] @ se3.exp_se3(np.array(jump))
    error = np.linalg.norm(se3.step_between(expected, found), axis=1)
    assert error[[48, 50]].max() < 2e-3
    assert error[49] > 0.04


def test_jumps_of_a_sensor_do_not_hide_in_the_intervals_beside_them():
    for seed in range(4):
        scenario = paper_scenario(jumps=3)
        run = simulate(replace(scenario, b=replace(scenario.b, rate=20.0)), 4000 + seed)
        between = Trajectory(run.b.stamps_ns[1::2], run.b.poses[1::2])
        result = calibrate(run.a, between, CalibrationConfig(time_offset_mode='fixed'))
        # With what leaks out of a jump: 0.01 m.
        assert result.absolute_errors(run.T_a_b).e_at < 0.001


def test_two_poses_have_a_geodesic_between_them():
    stamps_ns, poses = np.array([0, 100]) * MS, curve(np.array([0, 100]) * MS)
    found = interpolate(stamps_ns, poses, np.array([25 * MS]), max_gap_ns=None)
    np.testing.assert_allclose(found, se3.geodesic(poses[:1], poses[1:], [0.25]), atol=1e-12)


@pytest.mark.parametrize('rate', [5.0, 10.0])
def test_stamps_half_a_step_apart_cost_no_accuracy(rate):
    """A hand that waves at half a hertz; the geodesic takes 1 to 3 % off the scale."""
    noise = Noise(white=0.001, white_rotation=0.001)
    motion = Wander(reach=0.8, tilt=0.5, turn=0.8, frequency=0.5)
    run = simulate(Scenario(60.0, motion, Sensor(rate, noise), Sensor(2 * rate, noise)), 7)
    between = Trajectory(run.b.stamps_ns[1::2], run.b.poses[1::2])
    result = calibrate(run.a, between)
    assert result.scale == pytest.approx(1.0, abs=2e-3)
    error = np.r_[se3.step_between(run.T_a_b, result.T_a_b)]
    assert result.absolute_errors(run.T_a_b).e_at < 0.002
    assert np.all(np.abs(error) < 4 * np.sqrt(np.diag(result.covariance)))
