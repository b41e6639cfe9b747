# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Inputs that no extrinsic belongs to are refused before a solver runs, with what mends them."""

from dataclasses import replace
import re

import numpy as np
import pytest
from thinning import but_slow

from benchmarks.drives import (
    convoy,
    make,
)
from benchmarks.families import trajectory
from trajectory_calibration import (
    AssociationError,
    calibrate,
    CalibrationConfig,
    MotionError,
    Trajectory,
)
from trajectory_calibration.assessment.input_checks import check_orientations, check_pairs
from trajectory_calibration.assessment.offset_steadiness import offset_steadiness
from trajectory_calibration.assessment.orientation_checks import least_steps
from trajectory_calibration.assessment.rigid_fit import best_fit
from trajectory_calibration.geometry import se3
from trajectory_calibration.simulation import SCENARIOS, simulate
from trajectory_calibration.sources.files import FileSource
from trajectory_calibration.time_alignment.align import match

pytestmark = pytest.mark.once
CONFIG = CalibrationConfig()
# One of each way to move.
WAYS = ('car, scale and drift', 'hand-held', 'drone', 'legged', 'forklift (flat)')


def pair(name, seed=0, other_seed=None):
    run = make(name, seed)
    b = run.b if other_seed is None else make(name, other_seed).b
    return trajectory(run.a, 'a'), trajectory(b, 'b')


def checked(a, b):
    check_orientations(a, b, CONFIG)
    clock, pairs = match(a, b, CONFIG)
    return check_pairs(pairs, a, b, clock, CONFIG)


def with_rotations(t, rotations):
    return replace(t, poses=se3.from_rotation_translation(rotations, t.positions))


def inverted(t):
    return replace(t, poses=se3.inverse(t.poses))


def w_first(t):
    """Return what is read where w, x, y, z were written for x, y, z, w."""
    q = np.roll(se3.rotation_to_quaternion(t.rotations), 1, axis=1)
    return with_rotations(t, se3.quaternion_to_rotation(q))


def mirrored(t):
    """Return the trajectory in a world whose y points the other way."""
    M = np.diag([1.0, -1.0, 1.0])
    return replace(t, poses=se3.from_rotation_translation(M @ t.rotations @ M, t.positions @ M))


@pytest.mark.parametrize('name', WAYS)
def test_sensors_of_one_vehicle_pass(name):
    assert checked(*pair(name)) == ()


@pytest.mark.parametrize('name', WAYS)
def test_two_vehicles_are_refused(name):
    with pytest.raises(MotionError, match='did not turn together'):
        checked(*pair(name, 0, 50))


@pytest.mark.parametrize('name', WAYS)
def test_poses_that_are_both_inverted_are_named(name):
    with pytest.raises(MotionError, match='--invert-a --invert-b'):
        checked(*map(inverted, pair(name)))


@pytest.mark.parametrize('name', ['car, scale and drift', 'hand-held', 'drone', 'legged'])
def test_quaternions_of_both_in_another_order_are_named(name):
    with pytest.raises(MotionError, match=r'both hold .*Use --quaternion-order wxyz$'):
        checked(*map(w_first, pair(name)))


def test_checks_can_be_switched_off():
    a, b = map(inverted, pair('hand-held'))
    assert calibrate(a, b, CalibrationConfig(
        solver='park', reference='B5', input_checks=False)).poses > 100


@pytest.mark.parametrize('name', ['hand-held', 'drone', 'legged'])
def test_a_mirrored_world_is_named(name):
    a, b = pair(name)
    for one, other in ((mirrored(a), b), (a, mirrored(b))):
        with pytest.raises(MotionError, match='left-handed'):
            checked(one, other)


def test_a_constant_orientation_is_refused_before_anything_else():
    a, b = pair('drone')
    constant = with_rotations(a, np.broadcast_to(a.rotations[0], a.rotations.shape))
    for one, other in ((constant, b), (b, constant)):
        with pytest.raises(MotionError, match=r'the orientation never changes over .* m driven'):
            calibrate(one, other)


@pytest.mark.parametrize('noise', [0.0, 0.02])
def test_course_over_ground_is_refused(noise):
    rng = np.random.default_rng(0)
    a, b = pair('car, scale and drift')
    measured = replace(a, poses=se3.from_rotation_translation(
        a.rotations, a.positions + noise * rng.normal(size=(len(a), 3))))
    step = np.gradient(a.positions if noise else measured.positions, axis=0)
    yaw = np.arctan2(step[:, 1], step[:, 0])
    course = with_rotations(measured, se3.exp_so3(yaw[:, None] * [0.0, 0.0, 1.0]))
    with pytest.raises(MotionError, match='course over ground'):
        calibrate(course, b)


def test_a_planar_vehicle_has_no_course_for_its_yaw():
    for seed in range(3):
        run = make('wheels with gain (flat)', seed)
        check_orientations(trajectory(run.a, 'a'), trajectory(run.b, 'b'), CONFIG)


@pytest.mark.parametrize(('seed',), but_slow([(k,) for k in range(6)], kept=[(0,), (1,)]))
def test_two_cars_on_one_road_are_refused(seed):
    a, b = (trajectory(recorded, name) for recorded, name in zip(convoy(seed), 'ab', strict=True))
    with pytest.raises(MotionError, match=r'two vehicles on one road|did not turn together'):
        checked(a, b)


def test_a_large_offset_of_one_car_is_steady():
    a, b = pair('car, scale and drift')
    late = replace(b, stamps_ns=b.stamps_ns + 3_000_000_000)
    clock, _ = match(a, late, CONFIG)
    assert clock.offset_s == pytest.approx(-3.0, abs=0.02)
    assert offset_steadiness(a, late, clock).scatter_s < 0.01
    assert checked(a, late) == ()


def test_a_target_in_view_all_the_time_is_not_taken_for_inverted_poses():
    """Around a target at 1 m the camera moves much, the target in it hardly."""
    rng = np.random.default_rng(1)
    t = np.arange(0, 20, 0.05)
    angle = np.stack([0.8 * np.sin(0.7 * t), 0.8 * np.cos(0.9 * t), 0.4 * np.sin(0.4 * t)], axis=1)
    R = se3.exp_so3(angle)
    poses = se3.from_rotation_translation(
        R, -R[:, :, 2] + 0.002 * rng.normal(size=(len(t), 3)))
    camera = Trajectory(np.rint(t * 1e9).astype(np.int64), poses)
    as_read, turned_round = least_steps(camera)
    assert as_read < 1.1 * turned_round


def test_few_poses_of_two_arms_are_refused_and_of_one_are_not():
    a, b = pair('arm')
    few = [Trajectory(t.stamps_ns[::200 * len(t) // len(b)], t.poses[::200 * len(t) // len(b)])
           for t in (a, b)]
    assert len(few[0]) < 12
    _, pairs = match(*few, CalibrationConfig(association='nearest'))
    assert best_fit(pairs) is None or best_fit(pairs).one_body


@pytest.mark.parametrize(('case', 'reason'), [
    ('w_first_both', '--quaternion-order wxyz'),
    ('inverted_both', '--invert-a --invert-b'),
    ('left_handed', 'left-handed'),
    ('gps_without_orientation', 'orientation never changes'),
    ('course_as_yaw', 'course over ground'),
])
def test_inputs_that_failed_once(shared_data, case, reason):
    folder = shared_data / 'cases' / case
    if not folder.exists():
        pytest.skip(f'no {folder}')
    a, b = (FileSource(folder / f'{name}.tum', sensor_frame=name).load() for name in 'ab')
    with pytest.raises(MotionError, match=reason):
        calibrate(a, b)


def test_captures_of_a_vehicle_that_stands_still_are_named_with_their_setting(shared_data):
    folder = shared_data / 'cases' / 'stop_and_go'
    if not folder.exists():
        pytest.skip(f'no {folder}')
    a, b = (FileSource(folder / f'{name}.tum', sensor_frame=name).load() for name in 'ab')
    setting = '--association=nearest --max-time-difference=0.74'
    with pytest.raises(AssociationError, match=setting):
        calibrate(a, b)
    found = calibrate(a, b, CalibrationConfig(association='nearest', max_time_difference=0.74))
    assert found.poses == 20
    assert np.sqrt(np.diag(found.covariance)[:3]).max() < 0.01


@pytest.mark.parametrize('name', ['legged', 'forklift (flat)'])
def test_one_that_is_inverted_is_named_where_the_vehicle_hardly_tilts(name):
    a, b = pair(name)
    with pytest.raises(MotionError, match=r'does a hold inverted poses .* Use --invert-a$'):
        checked(inverted(a), b)


def conjugated(t):
    return with_rotations(t, np.swapaxes(t.rotations, 1, 2))


@pytest.mark.parametrize('name', ['drone', 'car, scale and drift'])
def test_rotations_of_the_world_beside_positions_of_the_sensor_are_named(name):
    a, b = pair(name)
    with pytest.raises(MotionError, match='b hold rotations of the world in'):
        checked(a, conjugated(b))


def test_both_of_them_are_named_too():
    a, b = pair('drone')
    with pytest.raises(MotionError, match=r'do both hold rotations of the .* x, y and z neg'):
        checked(conjugated(a), conjugated(b))


@pytest.mark.parametrize('offset_s', [18.0, -37.0])
def test_clocks_that_are_farther_apart_than_was_searched_are_named(offset_s):
    a, b = pair('car, scale and drift')
    apart = replace(b, stamps_ns=b.stamps_ns + round(offset_s * 1e9))
    with pytest.raises(MotionError, match=rf'time_offset to {-offset_s:.0f}') as refused:
        checked(a, apart)
    (advised,) = re.findall(r'time_offset to ([-.\d]+)', str(refused.value))
    assert calibrate(a, apart, replace(CONFIG, time_offset=float(advised))).time_offset_s == (
        pytest.approx(-offset_s, abs=0.05))


def test_a_vehicle_that_stands_still_is_asked_whether_it_does():
    rng = np.random.default_rng(4)

    def standing(stamps_ns, name):
        n = len(stamps_ns)
        return Trajectory(stamps_ns, se3.from_rotation_translation(
            se3.exp_so3(0.001 * rng.standard_normal((n, 3))),
            0.005 * rng.standard_normal((n, 3))), sensor_frame=name)

    stamps_ns = 10**18 + 10**8 * np.arange(600)
    with pytest.raises(MotionError, match='Does the vehicle stand still'):
        checked(standing(stamps_ns, 'a'), standing(stamps_ns, 'b'))
    # One that stands beside one that moves is named.
    a, _ = pair('drone')
    with pytest.raises(MotionError, match='b alone does not turn: did its SLAM stop'):
        checked(a, standing(a.stamps_ns, 'b'))


def in_world(t, turn):
    """Return the poses with their orientations, but not their positions, in another world."""
    return with_rotations(t, se3.exp_so3(np.asarray(turn)) @ t.rotations)


@pytest.mark.parametrize('turn_deg', [10.0, 90.0])
def test_an_orientation_in_another_world_than_the_position_is_named(turn_deg):
    run = simulate(SCENARIOS['offroad'], 10)
    b = in_world(run.b, [0.0, 0.0, np.deg2rad(turn_deg)])
    try:
        said = [finding.text for finding in calibrate(run.a, b).findings
                if finding.code == 'worlds-differ']
    except MotionError as refused:
        said = [str(refused)]
    assert len(said) == 1
    assert 'positions and orientations of one sensor in two worlds' in said[0]


@pytest.mark.parametrize('scenario', ['offroad', 'road', 'drone', 'handheld'])
def test_of_sound_drives_turns_and_ways_tell_one_rotation(scenario):
    for seed in range(3):
        run = simulate(replace(SCENARIOS[scenario], duration=120.0), seed)
        assert 'worlds-differ' not in [
            finding.code for finding in calibrate(run.a, run.b).findings]
