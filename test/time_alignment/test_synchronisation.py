# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The offset between two clocks, from the turning of two sensors."""

from motion_data import perturb, random_pose
import numpy as np
from published import kitti, SEQUENCES, simulations
import pytest
from thinning import thinned

from trajectory_calibration import Trajectory
from trajectory_calibration.errors import AssociationError
from trajectory_calibration.geometry import se3
from trajectory_calibration.simulation import flat, Noise, Scenario, simulate, Unicycle, with_noise
from trajectory_calibration.time_alignment.clock_offset import find_clock_offset, synchronise

SECOND = 1_000_000_000


def smooth_body(rng, *, planar=False):
    """Return a function from (K,) seconds to (K, 4, 4) poses on a smooth, lively path."""
    count = 8
    rate = rng.uniform(0.05, 0.6, size=(6, count))
    phase = rng.uniform(0, 2 * np.pi, size=(6, count))
    size = rng.normal(size=(6, count)) * 0.3
    if planar:
        size[3:5] = 0

    def pose(t):
        waves = np.sin(2 * np.pi * rate[None] * t[:, None, None] + phase) * size
        curve = waves.sum(axis=2)
        return se3.from_rotation_translation(se3.exp_so3(curve[:, 3:]), curve[:, :3] * 5)

    return pose


def sampled(pose, X, seconds, rate, start=0.0, clock=0.0, name='a'):
    """Return a sensor at X that samples the body at ``rate``; its clock is behind by ``clock``."""
    t = start + np.arange(0, seconds, 1 / rate)
    stamps = np.round((t - clock) * 1e9).astype(np.int64) + 10**18
    return Trajectory(stamps, pose(t) @ X, 'map', name)


@pytest.mark.parametrize('planar', [False, True])
@pytest.mark.parametrize('offset', [0.0, 0.013, -0.5, 2.0, -4.9])
@pytest.mark.parametrize('rates', [(10, 10), (10, 30), (50, 7), (400, 3)])
def test_finds_any_offset_within_its_own_error_bar(rates, offset, planar):
    rng = np.random.default_rng(round(1000 * (5 + offset)))
    pose = smooth_body(rng, planar=planar)
    a = perturb(rng, sampled(pose, np.eye(4), 60, rates[0]), 0.01, 0.002)
    b = perturb(rng, sampled(pose, random_pose(rng), 60, rates[1], 0.03, offset), 0.01, 0.002)
    found = find_clock_offset(a, b, 5.0)
    assert found.correlation > 0.9
    assert abs(found.seconds - offset) < max(5 * found.std, 2e-3)
    assert found.std < 0.02
    if abs(offset) > 0.1:
        assert found.significant


@pytest.mark.statistical
@thinned('seeds', 30, 60)
def test_the_error_bar_is_honest(seeds):
    """Offsets of zero over 60 seeds: never significant, and no farther than they say."""
    scores = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        pose = smooth_body(rng)
        a = perturb(rng, sampled(pose, np.eye(4), 40, 10), 0.01, 0.01)
        b = perturb(rng, sampled(pose, random_pose(rng), 40, 10), 0.01, 0.01)
        found = find_clock_offset(a, b, 5.0)
        assert not found.significant
        scores.append(found.seconds / found.std)
    assert 0.1 < np.sqrt(np.mean(np.square(scores))) < 1.2


def test_gaps_do_not_matter():
    rng = np.random.default_rng(1)
    pose = smooth_body(rng)
    a, b = sampled(pose, np.eye(4), 60, 10), sampled(pose, random_pose(rng), 60, 20, clock=1.25)
    keep_a = np.r_[0:150, 190:600]
    keep_b = np.r_[0:500, 580:1200]
    holed_a = Trajectory(a.stamps_ns[keep_a], a.poses[keep_a], 'map', 'a')
    holed_b = Trajectory(b.stamps_ns[keep_b], b.poses[keep_b], 'map', 'b')
    assert find_clock_offset(holed_a, holed_b, 5.0).seconds == pytest.approx(1.25, abs=2e-3)


@pytest.mark.parametrize('days', [2, 30, 20_000])
def test_pauses_between_drives_do_not_matter(days):
    """Two bags: what lies between them must not make the cells of the search any longer."""
    rng = np.random.default_rng(7)
    pose, X = smooth_body(rng), random_pose(rng)
    a = perturb(rng, sampled(pose, np.eye(4), 60, 10), 0.01, 0.002)
    b = perturb(rng, sampled(pose, X, 60, 10, 0.03, -0.4), 0.01, 0.002)
    pause_ns = days * 86_400 * 10**9
    a, b = (Trajectory(part.stamps_ns + (part.stamps_ns > 10**18 + 30 * 10**9) * pause_ns,
                       part.poses) for part in (a, b))
    found = find_clock_offset(a, b, 5.0)
    assert abs(found.seconds + 0.4) < max(5 * found.std, 2e-3)
    assert found.significant


def test_one_stamp_from_before_the_clock_was_set_does_not_matter():
    rng = np.random.default_rng(8)
    pose = smooth_body(rng)
    a = perturb(rng, sampled(pose, np.eye(4), 60, 10), 0.01, 0.002)
    b = perturb(rng, sampled(pose, random_pose(rng), 60, 30, 0.03, 1.2), 0.01, 0.002)
    b = Trajectory(np.concatenate([[7], b.stamps_ns[1:]]), b.poses)
    found = find_clock_offset(a, b, 5.0)
    assert abs(found.seconds - 1.2) < max(5 * found.std, 2e-3)


def rocking(rng, rate, start, clock=0.0, seconds=40.0):
    """Return a sensor on a body that yaws to and fro, 30 degrees either way, in four seconds."""
    t = start + np.arange(0, seconds, 1 / rate)
    yaw = np.zeros((len(t), 3))
    yaw[:, 2] = 0.5 * np.sin(0.5 * np.pi * t + 0.7)
    path = np.column_stack([0.2 * np.sin(0.5 * np.pi * t + 1), 0.2 * np.cos(np.pi * t), 0 * t])
    poses = se3.from_rotation_translation(se3.exp_so3(yaw), path)
    return perturb(rng, Trajectory(np.round((t - clock) * 1e9).astype(np.int64), poses),
                   0.002, 0.001)


@pytest.mark.parametrize('seed', range(4))
def test_of_offsets_that_are_as_good_the_nearest_is_taken_and_the_others_named(seed):
    """Half a period the other way round is the same motion, with the sensor the other way up."""
    rng = np.random.default_rng(seed)
    a, b = rocking(rng, 10, 0.0), rocking(rng, 20, 0.013)
    found = find_clock_offset(a, b, 5.0)
    assert abs(found.seconds) < 0.01
    assert {round(seconds) for seconds in found.alternatives} >= {-2, 2}
    clock = synchronise(a, b, 0.0, 'auto', 5.0)
    assert clock.offset_s == 0.0
    assert clock.alternatives_s == found.alternatives
    assert not synchronise(a, b, 0.0, 'fixed', 5.0).alternatives_s
    # What is known beforehand decides.
    late = rocking(rng, 20, 0.013, -2.0)
    assert abs(synchronise(a, late, -1.9, 'auto', 5.0).offset_s + 2.0) < 0.01


def test_no_rivals_where_the_motion_tells():
    for seed in range(6):
        rng = np.random.default_rng(seed)
        pose = smooth_body(rng, planar=bool(seed % 2))
        a = perturb(rng, sampled(pose, np.eye(4), 60, 10), 0.01, 0.002)
        b = perturb(rng, sampled(pose, random_pose(rng), 60, 20, 0.03, 1.3), 0.01, 0.002)
        assert find_clock_offset(a, b, 5.0).alternatives == ()


@pytest.mark.statistical
@thinned('seeds', 10, 30)
def test_a_short_drive_gives_no_false_offset(seeds):
    """Of six seconds any two agree well for two of them."""
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        pose = smooth_body(rng, planar=bool(seed % 2))
        a = perturb(rng, sampled(pose, np.eye(4), 6, 10), 0.005, 0.001)
        b = perturb(rng, sampled(pose, random_pose(rng), 6, 10, 0.013), 0.005, 0.001)
        assert abs(synchronise(a, b, 0.0, 'auto', 5.0).offset_s) < 0.02


@pytest.mark.parametrize('phase', [0.0, 0.003, 0.005, 0.007])
def test_noise_that_interpolation_averages_is_no_agreement(phase):
    """At 100 Hz a step is turned by no more than the noise of a pose."""
    rng = np.random.default_rng(9)
    pose = smooth_body(rng)
    a = perturb(rng, sampled(pose, np.eye(4), 100, 100), 0.005, 0.005)
    b = perturb(rng, sampled(pose, random_pose(rng), 100, 100, phase), 0.005, 0.005)
    found = find_clock_offset(a, b, 5.0)
    assert abs(found.seconds) < max(4 * found.std, 1e-3)
    assert not found.significant


@pytest.mark.statistical
@thinned('seeds', 10, 20)
def test_one_pose_a_second_gives_no_false_offset(seeds):
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        pose = smooth_body(rng)
        a = perturb(rng, sampled(pose, np.eye(4), 30, 1), 0.005, 0.001)
        b = perturb(rng, sampled(pose, random_pose(rng), 30, 1), 0.005, 0.001)
        assert synchronise(a, b, 0.0, 'auto', 5.0).offset_s == 0.0


def test_little_time_in_common_is_enough_where_it_tells():
    """Of ten minutes each, the last 25 s of one are the first of the other."""
    rng = np.random.default_rng(3)
    pose = smooth_body(rng)
    a = perturb(rng, sampled(pose, np.eye(4), 600, 10), 0.005, 0.001)
    b = perturb(rng, sampled(pose, random_pose(rng), 600, 10, 575.03, 2.0), 0.005, 0.001)
    found = find_clock_offset(a, b, 5.0)
    assert abs(found.seconds - 2.0) < 0.01


def test_no_turning_tells_nothing():
    t = np.arange(0, 100) * SECOND // 10
    poses = np.tile(np.eye(4), (100, 1, 1))
    poses[:, 0, 3] = np.linspace(0, 10, 100)
    straight = Trajectory(t, poses)
    assert find_clock_offset(straight, straight, 5.0) is None


def unrelated(seed):
    rng = np.random.default_rng(seed)
    return (sampled(smooth_body(rng), np.eye(4), 300, 10),
            sampled(smooth_body(rng), np.eye(4), 300, 10, name='b'))


@pytest.mark.statistical
@thinned('seeds', 4, 10)
def test_unrelated_turning_is_not_significant(seeds):
    for seed in range(seeds):
        found = find_clock_offset(*unrelated(seed), 5.0)
        if found is None:
            continue
        assert found.correlation < 0.75
        assert not found.significant


@pytest.mark.parametrize('seed', [0, 1])
def test_unrelated_turning_is_no_offset_to_add(seed):
    a, b = unrelated(seed)
    assert synchronise(a, b, 0.25, 'auto', 5.0).offset_s == 0.25
    with pytest.raises(
            AssociationError, match=r'within 5 s cannot be found: a and b did not turn'):
        synchronise(a, b, 0.25, 'estimate', 5.0)


@pytest.mark.parametrize(('mode', 'given', 'most', 'expected'), [
    ('fixed', 0.5, 5.0, 0.5), ('estimate', 0.5, 0.0, 0.5), ('auto', 0.0, 5.0, 0.8),
    ('auto', 0.5, 0.4, 0.8), ('estimate', 0.5, 0.4, 0.8), ('estimate', 2.0, 5.0, 0.8),
    # Too far from what was given.
    ('auto', 0.5, 0.2, 0.5),
])
def test_an_offset_is_what_was_given_and_what_was_found(mode, given, most, expected):
    rng = np.random.default_rng(4)
    pose = smooth_body(rng)
    a = sampled(pose, np.eye(4), 60, 10)
    b = sampled(pose, random_pose(rng), 60, 10, clock=0.8)
    assert synchronise(a, b, given, mode, most).offset_s == pytest.approx(expected, abs=1e-3)


def test_an_offset_without_any_noise_is_certain():
    """What is left of the disagreement is rounding: on flat ground every other one is negative."""
    flat_drive = with_noise(Scenario(20.0, Unicycle(ground=flat)), Noise(), Noise())
    for seed in range(12):
        run = simulate(flat_drive, seed)
        found = find_clock_offset(run.a, shifted(run.b, 0.1), 5.0)
        assert found.significant
        assert found.std < 1e-3
        assert found.seconds == pytest.approx(0.1, abs=1e-6)


@pytest.mark.parametrize('rate_deg', [1.0, 30.0, 100.0])
@pytest.mark.parametrize('seed', range(5))
def test_turning_at_a_constant_rate_tells_nothing(rate_deg, seed):
    """All offsets fit the same; which one is least is rounding."""
    rng = np.random.default_rng(seed)
    turns = np.deg2rad(rate_deg)

    def circle(t):
        R = se3.exp_so3(t[:, None] * [0.0, 0.0, turns])
        return se3.from_rotation_translation(R, R @ [10.0, 0.0, 0.0])

    a = sampled(circle, np.eye(4), 20.0, 10.0)
    b = sampled(circle, random_pose(rng), 20.0, 10.0)
    world = random_pose(rng, distance=5.0)
    found = find_clock_offset(a, Trajectory(b.stamps_ns, world @ b.poses), 5.0)
    assert found is None or not found.significant


def test_too_short_for_an_offset():
    rng = np.random.default_rng(2)
    pose = smooth_body(rng)
    a = sampled(pose, np.eye(4), 0.4, 10)
    assert find_clock_offset(a, a, 5.0) is None


def shifted(b, seconds):
    return Trajectory(b.stamps_ns - round(seconds * 1e9), b.poses, b.world_frame, b.sensor_frame)


@pytest.mark.parametrize('sequence', SEQUENCES)
def test_injected_offsets_on_kitti(shared_data, sequence):
    """Two seconds more are two seconds more, to 5 ms, relative to what is there without."""
    a, b, _ = kitti(shared_data, sequence)
    before = find_clock_offset(a, b, 5.0)
    # The triggers of the cameras are stamped 4.6 and 6.1 ms before lidar and other camera.
    assert before.seconds == pytest.approx(0.005, abs=0.004)
    for offset in (2.0, -2.0):
        found = find_clock_offset(a, shifted(b, offset), 5.0)
        assert found.seconds - before.seconds == pytest.approx(offset, abs=0.005)
        assert found.significant


def test_injected_offsets_on_the_mixture(shared_data):
    """Half a sample (50 ms) is asked for."""
    for *_, a, b, _ in simulations(shared_data, cases=[('mixture', None)]):
        before = find_clock_offset(a, b, 5.0)
        assert not before.significant
        for offset in (2.0, -2.0):
            found = find_clock_offset(a, shifted(b, offset), 5.0)
            assert found.seconds - before.seconds == pytest.approx(offset, abs=0.05)
