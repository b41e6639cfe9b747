# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Association in time: other rates, other clocks, gaps, and what cannot be paired."""

from hypothesis import given, settings
from hypothesis import strategies as st
from motion_data import perturb, random_pose, sensor_pair, stamps, wander
import numpy as np
import pytest

from trajectory_calibration import (
    AssociationError,
    calibrate,
    CalibrationConfig,
    ConfigError,
    Trajectory,
)
from trajectory_calibration.geometry import se3
from trajectory_calibration.simulation import Noise, Scenario, Sensor, simulate, Wander
from trajectory_calibration.time_alignment.pairing import (
    associate,
    associate_by_interpolation,
    associate_nearest,
)

MS = 1_000_000
GAP = 500 * MS
INTERPOLATE = CalibrationConfig(association='interpolate')


def still(stamps_ns):
    """Return a trajectory that only has stamps: association looks at nothing else."""
    return Trajectory(np.asarray(stamps_ns), np.tile(np.eye(4), (len(stamps_ns), 1, 1)))


def helix(stamps_ns, T_body_sensor):
    """Return poses on a path of constant twist, on which interpolation is exact at any rate."""
    seconds = (np.asarray(stamps_ns) - stamps(1)[0]) * 1e-9
    twist = np.array([1.0, 0.0, 0.2, 0.1, -0.2, 0.4])
    return se3.exp_se3(seconds[:, None] * twist) @ T_body_sensor


times = st.lists(st.integers(0, 5_000), min_size=3, max_size=60, unique=True).map(
    lambda values: np.sort(np.array(values, dtype=np.int64)) * MS)


@given(times, times, st.integers(1, 300))
def test_nearest_is_one_to_one_and_within_the_tolerance(t_a, t_b, tolerance_ms):
    a, b = still(t_a), still(t_b)
    try:
        pairs = associate_nearest(a, b, max_difference_ns=tolerance_ms * MS)
    except AssociationError:
        return
    assert len(np.unique(pairs.stamps_ns)) == len(pairs) == pairs.summary.pairs
    assert set(pairs.stamps_ns) <= set(t_b)
    difference = np.abs(t_a[:, None] - pairs.stamps_ns).min(axis=0)
    assert difference.max() <= tolerance_ms * MS
    assert pairs.summary.max_difference_s == pytest.approx(difference.max() * 1e-9)


@given(times)
def test_nearest_pairs_equal_stamps_exactly(t):
    pairs = associate_nearest(still(t), still(t), max_difference_ns=0)
    np.testing.assert_array_equal(pairs.stamps_ns, t)


@given(times, times, st.integers(1, 5_000))
def test_interpolation_never_leaves_the_span_nor_bridges_a_gap(t_a, t_b, max_gap_ms):
    try:
        pairs = associate_by_interpolation(still(t_a), still(t_b), max_gap_ns=max_gap_ms * MS)
    except AssociationError:
        return
    assert t_a[0] <= pairs.stamps_ns[0]
    assert pairs.stamps_ns[-1] <= t_a[-1]
    for t in pairs.stamps_ns:
        right = t_a[t_a >= t][0]
        left = t_a[t_a <= t][-1]
        near = min(t - left, right - t) <= MS
        assert right - left <= max_gap_ms * MS or near
    summary = pairs.summary
    assert summary.pairs + summary.outside + summary.in_gaps == len(t_b)


@settings(max_examples=25)
@given(st.integers(2, 400), st.integers(2, 400), st.integers(0, 99))
def test_any_two_rates_meet_on_the_same_path(rate_a, rate_b, phase_ms):
    """10 Hz against 30 Hz, or anything else: on a constant twist the poses are exact."""
    start = stamps(1)[0]
    a_t = start + np.arange(0, 4_000 * MS, 1_000 * MS // rate_a, dtype=np.int64)
    b_t = start + phase_ms * MS + np.arange(0, 4_000 * MS, 1_000 * MS // rate_b, dtype=np.int64)
    X = random_pose(np.random.default_rng(rate_a))
    a, b = Trajectory(a_t, helix(a_t, np.eye(4))), Trajectory(b_t, helix(b_t, X))
    pairs = associate_by_interpolation(a, b, max_gap_ns=GAP)
    np.testing.assert_allclose(pairs.poses_a @ X, pairs.poses_b, atol=1e-9)


@pytest.mark.parametrize('offset_s', [0.0, 101e-3, -7.25, 1.7e9])
def test_an_offset_is_added_to_the_stamps_of_b(offset_s):
    offset_ns = round(offset_s * 1e9)
    t = stamps(50)
    a = Trajectory(t, helix(t, np.eye(4)))
    b = Trajectory(t - offset_ns, helix(t, np.eye(4)))
    for method in ('nearest', 'interpolate'):
        pairs = associate(a, b, CalibrationConfig(association=method), offset_ns)
        np.testing.assert_array_equal(pairs.stamps_ns, t)
        np.testing.assert_allclose(pairs.poses_a, pairs.poses_b, atol=1e-9)
        assert pairs.summary.time_offset_s == pytest.approx(offset_s)


def test_lidar_at_10_hz_against_keyframes_at_30_hz_just_works():
    rng = np.random.default_rng(4)
    X = random_pose(rng)
    start = stamps(1)[0]
    fine = wander(rng, poses=1200, translation=(0.02, 0.002, 0.002), rotation=(0.01,) * 3)
    fine_t = start + np.arange(1200) * 33_333_333
    keep = np.sort(rng.choice(1200, 800, replace=False))
    b = Trajectory(fine_t[keep], fine[keep] @ X, 'map_b', 'camera')
    a_t = start + 13 * MS + np.arange(390) * 100 * MS
    left = np.searchsorted(fine_t, a_t, side='right') - 1
    a = Trajectory(a_t, se3.geodesic(
        fine[left], fine[left + 1], (a_t - fine_t[left]) / 33_333_333), 'map_a', 'lidar')
    result = calibrate(a, b, CalibrationConfig(solver='dnl', reference='B10'))
    # What is left is the path between two poses of a, of which nothing is known.
    error = result.absolute_errors(X)
    assert error.e_at < 0.05
    assert error.e_aR < np.deg2rad(0.5)


def test_coinciding_stamps_need_no_neighbours():
    """At 0.5 Hz every gap is longer than max_gap, but the poses are there."""
    t = stamps(20, step_ns=2_000 * MS)
    pairs = associate_by_interpolation(still(t), still(t), max_gap_ns=GAP)
    assert len(pairs) == 20


def test_auto_keeps_to_coinciding_stamps_where_most_coincide():
    """Two keyframe lists of one 10 Hz trigger: half a millisecond apart, or a frame apart."""
    frames = stamps(400)
    rng = np.random.default_rng(7)
    t_a = frames[np.sort(rng.choice(400, 300, replace=False))]
    t_b = frames[np.sort(rng.choice(400, 300, replace=False))] + MS // 2
    a, b = Trajectory(t_a, helix(t_a, np.eye(4))), Trajectory(t_b, helix(t_b, np.eye(4)))
    pairs = associate(a, b)
    assert pairs.summary.max_difference_s < 1e-3
    assert len(pairs) == np.isin(t_b - MS // 2, t_a).sum() - pairs.summary.outside
    assert pairs.summary.between > 0
    everywhere = associate(a, b, INTERPOLATE)
    assert len(everywhere) == len(pairs) + pairs.summary.between
    np.testing.assert_allclose(pairs.poses_a, pairs.poses_b, atol=1e-6)


def test_auto_interpolates_where_few_coincide():
    t_a, t_b = stamps(300, step_ns=33_333_333), stamps(100) + 13 * MS
    a, b = Trajectory(t_a, helix(t_a, np.eye(4))), Trajectory(t_b, helix(t_b, np.eye(4)))
    assert associate(a, b).summary == associate(a, b, INTERPOLATE).summary
    assert associate(a, b).summary.between == 0
    assert associate(a, b).summary.stamps_of == 'b'


@pytest.mark.parametrize('offset_ns', [0, 250 * MS, -4_000_000_000_000_000_001])
def test_auto_interpolates_the_denser_whichever_it_is(offset_ns):
    """A receiver at 1 Hz, whose gaps no interpolation bridges, and a camera at 30 Hz."""
    rng = np.random.default_rng(3)
    X = random_pose(rng)
    t_a, t_b = stamps(40, step_ns=1_000 * MS) + 11 * MS, stamps(1000, step_ns=33_333_333)
    a = Trajectory(t_a, helix(t_a, np.eye(4)), sensor_frame='receiver')
    b = Trajectory(t_b - offset_ns, helix(t_b, X), sensor_frame='camera')
    pairs = associate(a, b, time_offset_ns=offset_ns)
    swapped = associate(b, a, time_offset_ns=-offset_ns)
    np.testing.assert_array_equal(pairs.stamps_ns, t_a[t_a <= t_b[-1]])
    np.testing.assert_array_equal(pairs.stamps_ns, swapped.stamps_ns + offset_ns)
    np.testing.assert_array_equal(pairs.poses_a, swapped.poses_b)
    np.testing.assert_array_equal(pairs.poses_b, swapped.poses_a)
    np.testing.assert_allclose(pairs.poses_b, pairs.poses_a @ X, atol=1e-6)
    summary = pairs.summary
    assert (summary.poses_a, summary.poses_b, summary.stamps_of) == (40, 1000, 'a')
    assert summary.time_offset_s == offset_ns * 1e-9
    assert summary.pairs + summary.outside + summary.in_gaps == 40
    with pytest.raises(AssociationError, match='fall in gaps of receiver longer than'):
        associate(a, b, INTERPOLATE, offset_ns)


def test_poses_of_the_sparser_without_a_partner_are_a_warning():
    t_a, t_b = stamps(40, step_ns=1_000 * MS), stamps(300)
    a = Trajectory(t_a, helix(t_a, np.eye(4)), sensor_frame='receiver')
    b = Trajectory(t_b, helix(t_b, random_pose(np.random.default_rng(1))), sensor_frame='camera')
    result = calibrate(a, b, CalibrationConfig(solver='dnl', reference='B1',
                                               time_offset_mode='fixed', allow_unobserved=True))
    assert '25% of the poses of receiver lie outside the time of camera: unused' in result.warnings


@pytest.mark.parametrize('rates', [(3.0, 10.0), (10.0, 3.0), (2.0, 30.0)])
def test_a_sparse_parent_is_no_error_of_scale(rates):
    """Chords of sparse poses are shorter than the way between them."""
    motion, noise = Wander(2.0, 0.4, 1.0, 0.3), Noise(white=0.002, white_rotation=0.001)
    sensors = [Sensor(rate, noise, sensor_frame=name)
               for rate, name in zip(rates, 'ab', strict=True)]
    run = simulate(Scenario(60.0, motion, *sensors), 5)
    result = calibrate(run.a, run.b)
    assert result.scale == pytest.approx(1.0, abs=1e-3)
    assert result.absolute_errors(run.T_a_b).e_at < 0.002


def test_no_overlap_names_the_ends_and_the_offset():
    rng = np.random.default_rng(5)
    a, b = sensor_pair(rng, random_pose(rng))
    later = Trajectory(b.stamps_ns + 3_600_000 * MS, b.poses, 'w', 'camera')
    with pytest.raises(AssociationError) as error:
        calibrate(a, later)
    ends = 'lidar ends at 1700000009.900 s, camera starts at 1700003600.000 s'
    assert f'no overlap in time: {ends}' in str(error.value)
    assert 'set time_offset to about -3600.000' in str(error.value)
    # The advice is a setting: it holds what is set already.
    with pytest.raises(AssociationError, match=r'set time_offset to about -3600\.000'):
        calibrate(a, later, CalibrationConfig(time_offset=100.0))
    result = calibrate(a, later, CalibrationConfig(solver='dnl', time_offset=-3600.0))
    assert result.poses == 100


@pytest.mark.parametrize('method', ['nearest', 'interpolate'])
def test_too_few_pairs_say_where_the_others_went(method):
    a = still(stamps(3, step_ns=10_000 * MS))
    b = still(stamps(30, step_ns=700 * MS) + 5 * MS)
    with pytest.raises(AssociationError, match=r'pose pairs of 3 and 30 poses .*at least 3'):
        associate(a, b, CalibrationConfig(association=method, max_time_difference=1e-3))


def test_two_poses_are_too_few_whatever_the_settings():
    two, many = still(stamps(2)), still(stamps(30))
    for a, b in ((two, many), (many, two)):
        with pytest.raises(AssociationError, match=r'only 2 poses of .*, needed at least 3'):
            associate(a, b)


def test_gaps_are_a_warning_in_the_result():
    rng = np.random.default_rng(6)
    a, b = sensor_pair(rng, random_pose(rng))
    keep = np.r_[0:40, 60:100]
    holed = perturb(rng, Trajectory(a.stamps_ns[keep], a.poses[keep], 'm', 'lidar'), 0, 0)
    result = calibrate(holed, b, CalibrationConfig(solver='dnl'))
    assert result.association.in_gaps == 20
    assert '20% of the poses of camera fall in gaps of lidar: unused' in result.warnings


def test_an_unknown_method_is_refused():
    with pytest.raises(ConfigError, match=r"'near' .* needed one of auto, interpolate, nearest"):
        CalibrationConfig(association='near')
