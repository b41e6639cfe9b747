# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""One answer for a whole drive, from two sensors that were measured apart, or a finding."""

from dataclasses import replace

import numpy as np
import pytest
from thinning import thinned

from benchmarks.drives import FAMILIES, make
from benchmarks.families import trajectory
from trajectory_calibration import calibrate
from trajectory_calibration.assessment import steadiness
from trajectory_calibration.geometry import chi_squared, se3
from trajectory_calibration.simulation import SCENARIOS, simulate
from trajectory_calibration.time_alignment.pairing import associate

# What they hold is arithmetic: one set of dependencies tells it.
pytestmark = pytest.mark.once

RUN = simulate(replace(SCENARIOS['offroad'], duration=80.0), 5)
AT = 0.5


def found(a, b, code):
    """Return the findings of a calibration with this code."""
    return [finding for finding in calibrate(a, b).findings if finding.code == code]


def changed(turn_deg=0.0, scale=1.0, *, slowly=False):
    """Return b after its mount turned, or its scale changed: at once, or all along."""
    share = np.linspace(0, 1, len(RUN.b))
    share = share if slowly else (share > AT).astype(float)
    poses = RUN.b.poses.copy()
    poses[:, :3, :3] = poses[:, :3, :3] @ se3.exp_so3(
        np.outer(share, [0.0, np.deg2rad(turn_deg), 0.0]))
    steps = np.diff(poses[:, :3, 3], axis=0) * scale**share[1:, None]
    poses[1:, :3, 3] = poses[0, :3, 3] + np.cumsum(steps, axis=0)
    return replace(RUN.b, poses=poses)


@pytest.mark.parametrize(('change', 'words'), [
    ({'turn_deg': 2.0}, 'move on its mount'),
    ({'turn_deg': 4.0, 'slowly': True}, 'move on its mount'),
    ({'scale': 0.6}, 'restart with another scale'),
    ({'scale': 0.8, 'slowly': True}, 'restart with another scale'),
])
def test_what_changes_on_the_way_is_named(change, words):
    finding, = found(RUN.a, changed(**change), 'extrinsic-unsteady')
    assert words in finding.text
    assert finding.level == 'serious'
    assert 0.3 < finding.values['at_s'] / 80.0 < 0.7
    if not change.get('slowly'):
        assert finding.values['at_s'] == pytest.approx(AT * 80.0, abs=80.0 / 12 + 2.0)
        assert finding.values['turned_deg'] == pytest.approx(
            change.get('turn_deg', 0.0), abs=0.3)


def test_an_exactly_flat_drive_has_no_change_of_its_height():
    # The height has no information at all, and what rounding leaves of it is no change.
    t = np.arange(0.0, 120.0, 0.1)
    yaw = 0.1 * np.cumsum(0.3 * np.sin(t / 5) + 0.2 * np.sin(t / 2.3))
    step = 0.1 * (1.5 + 0.5 * np.sin(t / 7))
    poses = se3.from_rotation_translation(
        se3.exp_so3(yaw[:, None] * [0.0, 0.0, 1.0]),
        np.cumsum(step[:, None] * np.stack([np.cos(yaw), np.sin(yaw), 0 * yaw], axis=1), axis=0))
    X = np.eye(4)
    X[:3, :3] = se3.rotation_from_roll_pitch_yaw(np.array([-1.57, 0.02, -1.57]))
    X[:3, 3] = [0.8, 0.1, -0.3]
    b = se3.inverse(X) @ poses @ X
    b[:, :3, 3] = np.round(b[:, :3, 3], 6)
    a = replace(RUN.a, stamps_ns=np.rint(1e9 * t).astype(np.int64), poses=poses)
    assert found(a, replace(a, poses=b, sensor_frame='b'), 'extrinsic-unsteady') == []


@thinned('seeds', 1, 3)
@pytest.mark.parametrize('scenario', ['offroad', 'road', 'drone', 'handheld'])
def test_sound_drives_have_no_such_finding(scenario, seeds):
    for seed in range(seeds):
        run = simulate(SCENARIOS[scenario], seed)
        assert not found(run.a, run.b, 'extrinsic-unsteady')
        assert not found(run.a, run.b, 'orientations-identical')


@pytest.mark.statistical
@thinned('seeds', 2, 12)
def test_false_alarms_are_as_rare_as_stated(monkeypatch, seeds):
    """Of whatever size, about true extrinsics; at limits that chance exceeds often enough."""
    monkeypatch.setattr(steadiness, '_MATTERS', 0.0)
    monkeypatch.setattr(steadiness, '_SCALE', 0.0)
    stated = np.array([0.3, 0.1])
    alarms = []
    for name in sorted(FAMILIES):
        for seed in range(seeds):
            run = make(name, seed)
            pairs = associate(trajectory(run.a, 'a'), trajectory(run.b, 'b'))
            for false_alarm in stated:
                monkeypatch.setattr(chi_squared, 'FALSE_ALARM', false_alarm)
                alarms.append(steadiness.unsteady(run.T_a_b, np.eye(6), pairs, ('a', 'b')) != ())
    rate = np.reshape(alarms, (-1, 2)).mean(axis=0)
    # Beyond this by chance once in a thousand.
    assert (rate < stated + 3.1 * np.sqrt(stated * (1 - stated) * 2 / len(alarms))).all()


@pytest.mark.parametrize('change', [
    {'turn_deg': 2.0}, {'turn_deg': 4.0, 'slowly': True}, {'scale': 0.8, 'slowly': True}])
def test_a_change_is_far_beyond_the_limit(monkeypatch, change):
    """It is found also where a false alarm is a million times rarer than stated."""
    monkeypatch.setattr(chi_squared, 'FALSE_ALARM', 1e-6 * chi_squared.FALSE_ALARM)
    assert found(RUN.a, changed(**change), 'extrinsic-unsteady')


def test_a_new_world_is_no_new_mount():
    poses = RUN.b.poses.copy()
    half = len(poses) // 2
    poses[half:] = se3.inverse(poses[half]) @ poses[half:]
    assert not found(RUN.a, replace(RUN.b, poses=poses), 'extrinsic-unsteady')


def test_a_smoothed_copy_is_no_second_sensor():
    poses = RUN.a.poses.copy()
    for axis in range(3):
        padded = np.pad(poses[:, axis, 3], 4, mode='edge')
        poses[:, axis, 3] = np.convolve(padded, np.full(9, 1 / 9), 'valid')
    finding, = found(RUN.a, replace(RUN.a, poses=poses, sensor_frame='copy'),
                     'orientations-identical')
    assert 'to the last digit' in finding.text


@pytest.mark.parametrize('scenario', ['outliers', 'drift'])
def test_simulated_jumps_and_drifts_without_noise_are_two_sensors(scenario):
    run = simulate(SCENARIOS[scenario], 1)
    assert not found(run.a, run.b, 'orientations-identical')
