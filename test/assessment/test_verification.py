# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A saved extrinsic is judged on other data: it holds, it has moved, or nobody can tell."""

import dataclasses
import json

from motion_data import perturb, random_pose, sensor_pair, stamps
import numpy as np
import pytest

from trajectory_calibration import calibrate, CalibrationConfig, ResultError, Trajectory
from trajectory_calibration.fleet.differences import difference
from trajectory_calibration.fleet.verification import verify
from trajectory_calibration.geometry import se3

CONFIG = CalibrationConfig(solver='dnl')


def noisy_pair(seed, T_a_b, **motion):
    rng = np.random.default_rng(seed)
    return tuple(perturb(rng, item, 2e-3, 1e-3) for item in sensor_pair(
        rng, T_a_b, poses=300, **motion))


@pytest.fixture(scope='module')
def saved():
    T_a_b = random_pose(np.random.default_rng(0))
    return T_a_b, calibrate(*noisy_pair(1, T_a_b), CONFIG)


def test_the_same_extrinsic_holds(saved):
    T_a_b, result = saved
    found = verify(result, *noisy_pair(2, T_a_b))
    assert (found.verdict, found.exit_status) == ('holds', 0)
    assert found.describe() == 'holds'
    assert found.result is not None
    assert 'm along x' in found.describe_resolution()
    data = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert data['sentence'] == 'holds'
    assert data['difference']['probability'] > 1e-3


@pytest.mark.parametrize('step, words', [
    ([0.08, 0, 0, 0, 0, 0], ' m along x'), ([0, 0, 0, 0, 0, 0.03], ' deg about z'),
    ([0, -0.08, 0, 0.03, 0, 0], ' deg about x')])
def test_a_sensor_that_moved_is_named_with_the_size(saved, step, words):
    T_a_b, result = saved
    found = verify(result, *noisy_pair(2, se3.moved(T_a_b, step)))
    assert (found.verdict, found.exit_status) == ('moved', 4)
    assert found.describe().startswith('moved by ')
    assert words in found.describe()
    assert 'sigma)' in found.describe()
    np.testing.assert_allclose(found.difference.step, step, atol=0.02)


def test_a_straight_drive_cannot_tell(saved):
    T_a_b, result = saved
    found = verify(result, *noisy_pair(
        3, T_a_b, rotation=(0.0, 0.0, 0.0), translation=(0.3, 0, 0)))
    assert (found.verdict, found.exit_status) == ('cannot tell', 3)
    assert found.describe().startswith('cannot tell x, y, z')
    assert 'needs: ' in found.describe()
    json.dumps(found.to_dict(), allow_nan=False)


def test_a_vehicle_that_stood_cannot_tell(saved):
    result = saved[1]
    still = np.tile(np.eye(4), (50, 1, 1))
    found = verify(result, Trajectory(stamps(50), still, 'w', 'lidar'),
                   Trajectory(stamps(50), still, 'w', 'camera'))
    assert found.verdict == 'cannot tell'
    assert found.exit_status == 3


def test_turns_about_one_axis_leave_that_axis_unobserved(saved):
    T_a_b, result = saved
    planar = {'rotation': (0.0, 0.0, 0.1), 'translation': (0.2, 0.0, 0.0)}
    found = verify(result, *noisy_pair(4, T_a_b, **planar))
    assert found.verdict == 'cannot tell'
    assert found.status['z'] == 'cannot tell'
    assert found.status['x'] == 'holds'
    assert 'another axis' in found.describe()
    # What the saved result does not know either is nothing to verify.
    flat = calibrate(*noisy_pair(5, T_a_b, **planar),
                     dataclasses.replace(CONFIG, allow_unobserved=True))
    found = verify(flat, *noisy_pair(6, T_a_b, **planar))
    assert (found.verdict, found.exit_status) == ('holds', 3)
    assert found.describe() == (
        'holds in 5 of 6 directions; not tested: z (not in the saved result)')


def test_a_prior_does_not_confirm_itself():
    T_a_b = random_pose(np.random.default_rng(0))
    z = T_a_b[2, 3]
    config = dataclasses.replace(
        CONFIG, prior_translation=f'-,-,{z}', prior_translation_std='0.001')
    planar = {'rotation': (0.0, 0.0, 0.1), 'translation': (0.2, 0.0, 0.0)}
    result = calibrate(*noisy_pair(5, T_a_b, **planar), config)
    found = verify(result, *noisy_pair(6, T_a_b, **planar))
    assert found.status['z'] == 'cannot tell'


def test_frames_in_exchange_and_a_result_without_covariance_are_refused(saved):
    T_a_b, result = saved
    a, b = noisy_pair(2, T_a_b)
    with pytest.raises(ResultError, match='exchange A and B'):
        verify(result, b, a)
    with pytest.raises(ResultError, match='no covariance'):
        verify(dataclasses.replace(result, covariance=None), a, b)
    files = [Trajectory(item.stamps_ns, item.poses, 'w', 'x') for item in (b, a)]
    with pytest.raises(ResultError, match='are A and B exchanged'):
        verify(result, *files)
    renamed = Trajectory(b.stamps_ns, b.poses, 'w', 'thermal')
    assert 'lidar and thermal' in verify(result, a, renamed).notes[0]


def test_the_difference_of_equal_answers_has_the_stated_false_alarms():
    rng = np.random.default_rng(0)
    T = random_pose(rng)
    root = rng.normal(size=(6, 6)) * 1e-3
    P = root @ root.T
    alarms = sum(
        difference((se3.moved(T, rng.multivariate_normal(np.zeros(6), P)), P),
                   (se3.moved(T, rng.multivariate_normal(np.zeros(6), P)), P),
                   CONFIG, 0.05).differs for _ in range(1000))
    # Half for all directions, half for single axes; the two overlap, so that it is a little less.
    assert 15 <= alarms <= 65


def test_what_is_unobserved_does_not_hide_what_is_known():
    rng = np.random.default_rng(1)
    T = random_pose(rng)
    # Rotation about z unobservable in one of them, and off by 2 radians there.
    P = np.diag([1e-4] * 3 + [1e-6] * 3)
    open_ = P + np.diag([0, 0, 0, 0, 0, 10.0])
    turned = se3.moved(T, [0, 0, 0, 0, 0, 2.0])
    same = difference((T, P), (turned, open_), CONFIG)
    assert not same.differs
    assert same.degrees_of_freedom == 5
    assert not same.testable[5]
    other = difference((T, P), (se3.moved(turned, [0, 0.2, 0, 0, 0, 0]), open_), CONFIG)
    assert other.differs
    assert other.describe() == '+0.200 m along y (14 sigma)'


def test_a_component_that_a_prior_fixes_can_be_compared():
    T, P = np.eye(4), np.zeros((6, 6))
    assert not difference((T, P), (T, P), CONFIG).differs
    assert difference((T, P), (se3.moved(T, [1e-3] * 6), P), CONFIG).differs
    moved = difference((T, P), (se3.moved(T, [0.1] + [1e-9] * 5), P), CONFIG)
    assert moved.describe() == '+0.100 m along x (> 1000 sigma)'


def test_one_trajectory_given_twice_confirms_nothing():
    result = calibrate(*noisy_pair(1, np.eye(4)), CONFIG)
    one = noisy_pair(2, np.eye(4))[0]
    found = verify(result, one, dataclasses.replace(one, sensor_frame='camera'))
    assert (found.verdict, found.exit_status) == ('cannot tell', 3)
    assert 'identical poses' in found.describe()
