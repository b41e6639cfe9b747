# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the motion did not show is said, always; what it showed is never called unseen."""

import numpy as np
import pytest
from thinning import thinned

from trajectory_calibration import calibrate, CalibrationConfig, MotionError, Trajectory
from trajectory_calibration.assessment.excitation import split_pairs
from trajectory_calibration.assessment.observability import (
    DEGREES_OF_FREEDOM,
    Observability,
    observe,
)
from trajectory_calibration.config.yaml_file import parse_yaml, to_yaml
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.errors import ResultError
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
from trajectory_calibration.time_alignment.pairing import associate

pytestmark = pytest.mark.usefixtures('noise_identified_once')
FLAT = Scenario(motion=Unicycle(ground=flat))
SMALL = Noise(white=0.002, white_rotation=0.001)
WALK = Noise(white=0.001, walk=0.02, walk_rotation=0.01)
JUMPS = Noise(white=0.005, jumps=5)
MILD = Noise(white=0.005, white_rotation=0.002, walk=0.005, walk_rotation=0.001)
NAMED = set(DEGREES_OF_FREEDOM)


def calibrated(scenario, seed, **settings):
    run = simulate(scenario, seed)
    return calibrate(run.a, run.b, CalibrationConfig(**settings)), run.T_a_b


@pytest.mark.statistical
@thinned('seeds', 8, 100)
@pytest.mark.parametrize('noise', [SMALL, WALK, JUMPS], ids=['white', 'walk', 'jumps'])
def test_flat_ground_is_flagged_in_every_seed(noise, seeds):
    scenario = with_noise(FLAT, noise, noise)
    for seed in range(seeds):
        found, _ = calibrated(scenario, seed, solver='dnl', reference='B5')
        assert 'z' in found.observability.unobserved
        # Its rotation may be unobservable for the same reason: one warning names both.
        assert any(warning.startswith('translation along z') for warning in found.warnings)


@pytest.mark.statistical
@pytest.mark.parametrize('solver', ['dnlo', 'ali', 'park', 'taylor', 'drift_aware'])
def test_flat_ground_is_flagged_whoever_solves(solver):
    scenario = with_noise(FLAT, SMALL, SMALL)
    for seed in range(5):
        found, _ = calibrated(scenario, seed, solver=solver, dnlo_method='path')
        assert 'z' in found.observability.unobserved


@pytest.mark.statistical
@thinned('share', 10, 1)
@pytest.mark.parametrize(('scenario', 'seeds', 'solver'), [
    (with_noise(Scenario(30.0, Wander()), MILD, MILD), 40, 'dnl'),
    (with_noise(Scenario(30.0, Wander()), MILD, MILD), 10, 'park'),
    (SCENARIOS['noise'], 40, 'dnl'),
    (SCENARIOS['mixture'], 20, 'dnlo'),
    (SCENARIOS['handheld'], 3, 'drift_aware'),
    (SCENARIOS['drone'], 3, 'dnl'),
    (SCENARIOS['offroad'], 3, 'dnl'),
])
def test_well_excited_motion_is_never_flagged(scenario, seeds, solver, share):
    for seed in range(100, 100 + seeds, share):
        found, _ = calibrated(scenario, seed, solver=solver)
        assert found.observability.unobserved == ()


def at_rest_or_straight_ahead(seed, speed=0.0):
    """Return two sensors with noise (m, rad), at rest or on a straight line aslant of all axes."""
    rng = np.random.default_rng(seed)
    stamps_ns = 1_000_000_000 + 100_000_000 * np.arange(300)
    direction = np.array([1.0, 1.0, 1.0]) / np.sqrt(3)
    body = se3.from_rotation_translation(
        np.eye(3), speed * 0.1 * np.arange(300)[:, None] * direction)
    T_a_b = se3.from_rotation_translation(se3.exp_so3([0.1, 0.2, 1.0]), [0.5, 0.2, 0.1])
    return [Trajectory(stamps_ns, body @ pose @ se3.exp_se3(
        rng.normal(size=(300, 6)) * np.repeat([0.01, 0.003], 3))) for pose in (np.eye(4), T_a_b)]


@pytest.mark.parametrize('solver', ['drift_aware', 'dnl', 'dnlo', 'park', 'taylor'])
def test_noise_alone_is_no_answer(solver):
    a, b = at_rest_or_straight_ahead(1)
    for allow_unobserved in (False, True):
        with pytest.raises(MotionError, match=(
                r'no motion beyond the noise in 300 pose pairs|did not turn together')):
            calibrate(a, b, CalibrationConfig(
                solver=solver, reference='B5', allow_unobserved=allow_unobserved))


def test_strict_limits_flag_a_good_answer_and_keep_it():
    found, _ = calibrated(
        SCENARIOS['drone'], 1, solver='dnl', reference='B5', weak_translation=1e-9,
        unobserved_translation=1e-8, weak_rotation=1e-9, unobserved_rotation=1e-8)
    assert found.observability.unobserved == DEGREES_OF_FREEDOM


def test_what_a_straight_line_tells_is_an_answer():
    found = calibrate(*at_rest_or_straight_ahead(1, speed=2.0))
    assert found.observability.unobserved == DEGREES_OF_FREEDOM
    # Every axis of the sensor has a part of the one rotation that is unobserved.
    rotations = [item for item in found.observability.weak_axes if item.kind == 'rotation']
    assert [item.status for item in rotations] == ['unobserved']
    np.testing.assert_allclose(rotations[0].axis, np.ones(3) / np.sqrt(3), atol=0.02)


def findings_of(*axes, gain=2.0):
    """Return the findings where the deviation (m, or rad) is that along some of six axes."""
    run = simulate(SCENARIOS['drone'], 1)
    motions = select_motions(associate(run.a, run.b), 'B5')
    covariance = 1e-8 * np.eye(6) + sum(gain**2 * np.outer(axis, axis) for axis in axes)
    return observe(motions, covariance, covariance, CalibrationConfig(), 'lidar').findings


def test_one_number_is_advised_along_an_axis_only():
    upright, = findings_of([0.0, 0.1, 0.995, 0, 0, 0])
    aslant, = findings_of([0.6, 0.0, 0.8, 0, 0, 0])
    assert ' add --prior-translation=-,-,Z ' in upright.text
    assert ' add --prior-translation=X,Y,Z ' in aslant.text


def test_noise_is_no_turn_about_another_axis():
    noise = Noise(white=0.002, white_rotation=0.06)
    for motion, single in ((Unicycle(ground=flat), True), (Unicycle(), False)):
        scenario = with_noise(Scenario(motion=motion), noise, noise)
        found = calibrated(scenario, 1, solver='park', reference='B5')[0].observability
        # To one sensor alone both drives look alike.
        assert found.translation_gain[0] > 0.25 * found.translation_gain[1]
        assert bool(found.single_axis) == single
        # It can be saved: YAML knows no number of NumPy.
        assert parse_yaml(to_yaml(found.to_dict()), '', ResultError) == found.to_dict()


def test_directions_with_one_cause_are_one_finding_of_two_lines():
    found, = calibrate(*at_rest_or_straight_ahead(1, speed=2.0)).observability.findings
    assert found.text.startswith(
        'translation and part of the rotation of sensor unobservable: noise too large')
    assert [item['kind'] for item in found.values['directions']] == [
        *['translation'] * 3, 'rotation']
    every, = findings_of(*np.eye(6))
    assert every.text.startswith('translation and rotation of lidar unobservable: ')
    assert len(f'serious: {every.text}') <= 2 * 99
    flat_, weak = findings_of([0, 0, 1, 0, 0, 0], gain=9.0) + findings_of(
        [0, 0, 0, 0, 1, 0], [0, 0, 0, 1, 0, 0], gain=0.03)
    assert len(f'serious: {flat_.text}') <= 2 * 97
    assert weak.text.startswith('rotation about x, y of lidar weak: standard deviation 1.7, 1.7')


def test_a_good_drive_has_nothing_to_say():
    found, _ = calibrated(SCENARIOS['drone'], 1, solver='dnl')
    assert found.observability.status == dict.fromkeys(DEGREES_OF_FREEDOM, 'observed')
    assert found.observability.weak_axes == ()
    assert found.observability.warnings == ()


def test_the_horizontal_is_still_good_on_flat_ground():
    found, truth = calibrated(with_noise(FLAT, SMALL, SMALL), 3, solver='dnl')
    assert set(found.observability.unobserved) == {'z'}
    np.testing.assert_allclose(found.T_a_b[:2, 3], truth[:2, 3], atol=0.02)
    weak = found.observability.weak_axes[0]
    assert (weak.kind, weak.status) == ('translation', 'unobserved')
    assert abs(weak.axis[2]) > 0.999
    assert weak.std > 1.0


@pytest.mark.parametrize('solver', ['dnl', 'dnlo', 'ali', 'park', 'taylor'])
def test_exactly_flat_ground_is_answered_and_flagged(solver):
    found, truth = calibrated(FLAT, 3, solver=solver)
    assert 'z' in found.observability.unobserved
    assert found.T_a_b[2, 3] == pytest.approx(0.0, abs=1e-6)
    if solver in ('dnl', 'dnlo', 'ali'):
        # The joint solvers find the heading from the path; only the height is unobserved.
        assert found.observability.unobserved == ('z',)
        np.testing.assert_allclose(found.T_a_b[:2, 3], truth[:2, 3], atol=1e-6)
    else:
        assert 'rotation z' in found.observability.unobserved


def test_limits_are_settings():
    scenario = SCENARIOS['noise']
    tight, _ = calibrated(scenario, 1, solver='dnl', weak_translation=1e-6,
                          unobserved_translation=1e-5)
    assert {'x', 'y', 'z'} <= set(tight.observability.unobserved)
    loose, _ = calibrated(scenario, 1, solver='dnl', weak_translation=10.0, weak_rotation=90.0)
    assert loose.observability.weak == ()
    weak, _ = calibrated(scenario, 1, solver='dnl', weak_rotation=1e-6)
    assert {'rotation x', 'rotation y', 'rotation z'} <= set(weak.observability.weak)
    assert any(finding.code == 'direction-weak' for finding in weak.findings)


def test_a_covariance_that_is_not_finite_counts_as_unobserved():
    run = simulate(SCENARIOS['drone'], 1)
    motions = select_motions(associate(run.a, run.b), 'B5')
    covariance = np.diag([1e-6, 1e-6, 1e-6, 1e-9, 1e-9, np.nan])
    found = observe(motions, covariance[:, :], covariance[:, :], CalibrationConfig(), 'lidar')
    assert found.unobserved == ('rotation z',)


def test_an_oblique_axis_is_named_by_numbers():
    run = simulate(SCENARIOS['drone'], 1)
    motions = select_motions(associate(run.a, run.b), 'B5')
    axis = np.array([0.6, 0.0, 0.8])
    covariance = 1e-6 * np.eye(6)
    covariance[:3, :3] += np.outer(axis, axis)
    found = observe(motions, covariance, covariance, CalibrationConfig(), 'lidar')
    assert set(found.unobserved) == {'x', 'z'}
    assert '(0.60, 0.00, 0.80)' in found.warnings[0] or '(0.60, -0.00, 0.80)' in found.warnings[0]


def test_survives_a_dictionary():
    found, _ = calibrated(with_noise(FLAT, SMALL, SMALL), 3, solver='dnl')
    again = Observability.from_dict(found.observability.to_dict())
    assert again.status == found.observability.status
    assert again.weak_axes == found.observability.weak_axes
    assert again.unobserved == found.observability.unobserved


def test_standing_still_opens_every_translation():
    """Noise alone, on two sensors that never moved, determines nothing."""
    rng = np.random.default_rng(0)
    run = simulate(with_noise(Scenario(30.0, Wander(reach=1e-9, tilt=1e-9, turn=1e-9)),
                              SMALL, SMALL), int(rng.integers(100)))
    assert len(split_pairs(run.T_a_b, associate(run.a, run.b)).unobserved) == 6
