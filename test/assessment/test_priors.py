# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What is known beforehand enters as one more residual, and nothing else changes."""

from motion_data import perturb, random_pose, sensor_pair
import numpy as np
import pytest
from scipy.optimize import minimize
from thinning import thinned

from trajectory_calibration import (
    calibrate,
    CalibrationConfig,
    ConfigError,
    Trajectory,
)
from trajectory_calibration.assessment.prior_update import apply_prior
from trajectory_calibration.config.prior import parse_prior
from trajectory_calibration.geometry import se3
from trajectory_calibration.simulation import (
    flat,
    Noise,
    Scenario,
    SCENARIOS,
    simulate,
    Unicycle,
    with_noise,
)

# What they hold is arithmetic: one set of dependencies tells it.
pytestmark = [pytest.mark.once, pytest.mark.usefixtures('noise_identified_once')]
FLAT = Scenario(motion=Unicycle(ground=flat))
NOISY_FLAT = with_noise(FLAT, *[Noise(white=0.002, white_rotation=0.001)] * 2)


def run_with(scenario, seed, **settings):
    run = simulate(scenario, seed)
    return calibrate(run.a, run.b, CalibrationConfig(**settings)), run.T_a_b


def rpy(T):
    R = T[:3, :3]
    return np.rad2deg([np.arctan2(R[2, 1], R[2, 2]), np.arcsin(-R[2, 0]),
                       np.arctan2(R[1, 0], R[0, 0])])


def text(values):
    return ','.join(f'{value:.12f}' for value in values)


def test_reading():
    prior = parse_prior('0.3, -, 0.1', '0.01,-,0', '90,0,0', '1,-,2')
    np.testing.assert_array_equal(prior.std[:3], [0.01, np.inf, 0.0])
    np.testing.assert_allclose(np.rad2deg(prior.std[3:]), [1.0, np.inf, 2.0])
    np.testing.assert_allclose(prior.rotation @ [0, 1, 0], [0, 0, 1], atol=1e-15)
    assert prior.given
    assert not parse_prior('', '', '', '').given


def test_a_standard_deviation_alone_says_nothing_so_that_each_can_be_set_alone():
    for std in ('0.01', '0', '0.01,-,0.02'):
        prior = parse_prior('', std, ' ', std)
        assert not prior.given
        np.testing.assert_array_equal(prior.rotation, np.eye(3))
    with pytest.raises(ConfigError, match=(
            r'needed both; give prior_translation_std too .*set prior_translation_std first')):
        parse_prior('0.3,0,0', '', '', '')


def test_a_number_serves_as_text():
    config = CalibrationConfig(prior_translation='-,-,0.1', prior_translation_std=0.01)
    assert config.prior_translation_std == '0.01'
    np.testing.assert_array_equal(config.prior.std[:3], [np.inf, np.inf, 0.01])
    assert CalibrationConfig(prior_translation_std=0).prior_translation_std == '0'
    with pytest.raises(ConfigError, match='prior_translation_std is True, needed'):
        CalibrationConfig(prior_translation_std=True)


def test_one_number_stands_for_all_that_are_given():
    np.testing.assert_array_equal(
        parse_prior('0.3,-,0.1', '0.02', '', '').std[:3], [0.02, np.inf, 0.02])


@pytest.mark.parametrize('values', [
    ('0.3,0.1', '0.1', '', ''), ('a,b,c', '0.1', '', ''), ('0.3,0,0', '', '', ''),
    ('', '0.1,0.1', '', ''), ('', '-0.1', '', ''), ('0.3,0,nan', '0.1', '', ''),
    ('0.3,0,0', '-0.1', '', ''),
    ('0.3,0,0', '0.1,-,0.1', '', ''), ('-,0,0', '0.1,0.1,0.1', '', ''),
    ('', '', '0,-,0', '1'), ('', '', '0,0,0', ''), ('', '', '1', '1'),
])
def test_mistakes_are_named(values):
    names = ('prior_translation', 'prior_translation_std', 'prior_rotation', 'prior_rotation_std')
    with pytest.raises(ConfigError, match=r'prior_(translation|rotation)'):
        CalibrationConfig(**dict(zip(names, values, strict=True)))


def test_is_the_minimum_of_both_costs():
    """Of all extrinsics near the answer, none has a lower sum of the two quadratic costs."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(6, 6)) * np.repeat([0.02, 0.01], 3)[:, None]
    covariance = root @ root.T
    T = se3.exp_se3(rng.normal(size=6))
    truth = T @ se3.exp_se3(0.02 * rng.normal(size=6))
    prior = parse_prior(text(truth[:3, 3]), '0.01,0.02,0.03', text(rpy(truth)), '1,2,-')
    found, posterior = apply_prior(T, covariance, prior)

    def cost(step):
        moved = se3.from_rotation_translation(
            se3.exp_so3(step[3:]) @ T[:3, :3], T[:3, 3] + step[:3])
        known = np.isfinite(prior.std)
        return (step @ np.linalg.solve(covariance, step)
                + np.sum((prior.step_from(moved)[known] / prior.std[known])**2))

    best = minimize(cost, np.zeros(6), method='BFGS', options={'gtol': 1e-9})
    step = np.concatenate([found[:3, 3] - T[:3, 3], se3.log_so3(found[:3, :3] @ T[:3, :3].T)])
    assert cost(step) <= best.fun * (1 + 1e-9)
    np.testing.assert_allclose(step, best.x, atol=1e-3 * np.abs(best.x).max())
    information = np.linalg.inv(covariance) + np.diag(1 / prior.std**2)
    np.testing.assert_allclose(posterior, np.linalg.inv(information), atol=5e-6)


@pytest.mark.parametrize('off', [0.0, 1.0, -2.5, np.pi])
def test_about_an_unobserved_axis_it_is_the_minimum_of_both_costs_from_anywhere(off):
    """Of a straight drive, both know its direction: the answer about it is arbitrary."""
    rng = np.random.default_rng(7)
    along = np.array([1.0, 0.2, -0.1]) / np.linalg.norm([1.0, 0.2, -0.1])
    truth = random_pose(rng)
    in_b = truth[:3, :3].T @ along
    sigma = np.deg2rad(0.05)
    across = sigma**2 * (np.eye(3) - np.outer(along, along))
    covariance = np.diag([100.0] * 6)
    covariance[3:, 3:] = across + np.pi**2 * np.outer(along, along)
    T = se3.moved(truth, np.r_[np.zeros(3), off * along])
    given = se3.moved(truth, np.r_[np.zeros(3), np.deg2rad([0.8, -0.5, 0.3])])
    prior = parse_prior('', '', text(rpy(given)), '1,0.5,2')
    found, posterior = apply_prior(T, covariance, prior)

    def cost(turn):
        moved = se3.moved(truth, np.r_[np.zeros(3), turn])
        return (np.sum((moved[:3, :3] @ in_b - along)**2) / sigma**2
                + np.sum((prior.step_from(moved)[3:] / prior.std[3:])**2))

    best = minimize(cost, np.zeros(3), method='BFGS', options={'gtol': 1e-9}).x
    turned = se3.step_between(truth, found)[3:]
    # Half a turn stands for "unknown": about the axis it counts, but next to nothing.
    np.testing.assert_allclose(turned, best, atol=1e-2 * np.deg2rad(1))
    assert along @ posterior[3:, 3:] @ along < np.deg2rad(2.1)**2


def straight_drive(seed):
    """Return a and b over 60 s straight ahead, with noise, and the pose of b in a."""
    rng = np.random.default_rng(seed)
    X = random_pose(rng)
    stamps_ns = np.arange(600) * 100_000_000
    ahead = np.tile(np.eye(4), (600, 1, 1))
    ahead[:, 0, 3] = 3e-9 * stamps_ns
    a, b = (perturb(rng, Trajectory(stamps_ns, T), 0.005, 0.001)
            for T in (ahead, se3.inverse(X) @ ahead @ X))
    return a, b, X


@thinned('seeds', 1, 2)
@pytest.mark.parametrize('solver', ['dnl', 'dnlo', 'ali', 'park', 'taylor', 'zhuang',
                                    'drift_aware'])
def test_what_a_straight_drive_leaves_open_comes_from_the_prior(solver, seeds):
    for seed in range(seeds):
        a, b, X = straight_drive(seed)
        config = CalibrationConfig(
            solver=solver, prior_rotation=text(rpy(X)), prior_rotation_std='1',
            prior_translation=text(X[:3, 3]), prior_translation_std='0.01')
        try:
            found = calibrate(a, b, config)
        except ConfigError as refused:
            # Noise may pass for a turn with them, and their translation then hangs on it.
            assert solver in ('park', 'taylor')
            assert 'unobservable for this solver; use' in str(refused)
            continue
        error = found.absolute_errors(X)
        assert error.e_aR < np.deg2rad(0.3)
        assert error.e_at < 1e-3
        assert found.observability.unobserved == ()
        assert found.observability.status['rotation x'] == 'prior'


def test_a_prior_that_contradicts_the_direction_of_a_straight_drive_is_refused():
    a, b, X = straight_drive(0)
    wrong = se3.exp_so3(np.deg2rad([0.0, 0.0, 40.0])) @ X[:3, :3]
    with pytest.raises(ConfigError, match='needed less than 15; check prior_rotation'):
        calibrate(a, b, CalibrationConfig(
            prior_rotation=text(rpy(wrong)), prior_rotation_std='0.01'))


def test_none_changes_nothing():
    T = se3.exp_se3(np.arange(6.0))
    found, covariance = apply_prior(T, np.eye(6), parse_prior('', '', '', ''))
    assert found is T
    np.testing.assert_array_equal(covariance, np.eye(6))


@pytest.mark.parametrize('solver', ['dnl', 'dnlo', 'ali', 'park', 'taylor', 'zhuang',
                                    'drift_aware'])
def test_a_fixed_component_is_exact(solver):
    found, truth = run_with(SCENARIOS['noise'], 2, solver=solver, dnlo_method='path',
                            prior_translation=f'-,{simulate(SCENARIOS["noise"], 2).T_a_b[1, 3]},-',
                            prior_translation_std='0')
    assert found.T_a_b[1, 3] == pytest.approx(truth[1, 3], abs=1e-9)
    assert found.covariance[1, 1] < 1e-15
    assert found.observability.status['y'] == 'prior'


@pytest.mark.parametrize('opened', [10.0, 1e3])
@pytest.mark.parametrize('known', [1e-9, 1e-5, 1e-2])
def test_a_fixed_component_is_exact_beside_an_unobserved_direction(opened, known):
    rng = np.random.default_rng(4)
    for _ in range(20):
        axes, _ = np.linalg.qr(rng.normal(size=(6, 6)))
        covariance = (axes * np.array([opened, *[known] * 5])**2) @ axes.T
        # Anything along the unobservable direction is possible; the prior asks for some of it.
        step = 0.05 * axes[:, 0]
        prior = parse_prior(text(step[:3]), '0', '', '')
        T_a_b, after = apply_prior(np.eye(4), covariance, prior)
        np.testing.assert_allclose(T_a_b[:3, 3], prior.translation, atol=1e-10)
        np.testing.assert_allclose(np.diag(after)[:3], 0, atol=1e-20)
        assert np.linalg.eigvalsh(after).min() > -1e-15 * after.max()


def test_a_fixed_rotation_is_exact():
    truth = simulate(SCENARIOS['noise'], 2).T_a_b
    found, _ = run_with(SCENARIOS['noise'], 2, solver='dnl', prior_rotation=text(rpy(truth)),
                        prior_rotation_std='0')
    assert found.absolute_errors(truth).e_aR < 1e-9


@pytest.mark.statistical
@thinned('seeds', 3, 10)
def test_a_tape_measure_closes_what_flat_ground_leaves_open(seeds):
    for seed in range(seeds):
        height = simulate(NOISY_FLAT, seed).T_a_b[2, 3]
        found, truth = run_with(NOISY_FLAT, seed, solver='dnl',
                                prior_translation=f'-,-,{height + 0.01}',
                                prior_translation_std='0.02')
        assert found.observability.unobserved == ()
        assert found.observability.status['z'] == 'prior'
        assert found.observability.status['x'] == 'observed'
        assert found.absolute_errors(truth).e_at < 0.03


@pytest.mark.parametrize('solver', ['dnl', 'dnlo', 'ali'])
def test_exactly_flat_ground_needs_nothing_but_the_height(solver):
    height = simulate(FLAT, 4).T_a_b[2, 3]
    found, truth = run_with(FLAT, 4, solver=solver, prior_translation=f'-,-,{height}',
                            prior_translation_std='0.01')
    assert found.absolute_errors(truth).e_at < 1e-8
    found, _ = run_with(FLAT, 4, solver=solver, prior_translation='0.1,-,-',
                        prior_translation_std='0.01')
    assert found.observability.unobserved == ('z',)


def test_a_separable_solver_takes_the_heading_from_a_prior():
    truth = simulate(FLAT, 4).T_a_b
    found, _ = run_with(
        FLAT, 4, solver='park', prior_translation=text(truth[:3, 3]), prior_translation_std='0.01',
        prior_rotation=text(rpy(truth)), prior_rotation_std='0.1')
    assert found.absolute_errors(truth).e_aR < np.deg2rad(0.1)
    assert found.observability.status['rotation z'] == 'prior'


def test_a_prior_far_from_the_motion_is_refused():
    with pytest.raises(ConfigError, match='prior turns the answer'):
        run_with(SCENARIOS['noise'], 2, solver='dnl', prior_rotation='0,0,0',
                 prior_rotation_std='0.01')


def test_a_prior_of_the_height_does_not_turn_an_unobserved_heading():
    """On flat ground park does not observe the heading, and the height says nothing of it."""
    found, _ = run_with(NOISY_FLAT, 5, solver='park', prior_translation='-,-,0.8',
                        prior_translation_std='0.02')
    assert found.T_a_b[2, 3] == pytest.approx(0.8, abs=0.05)
    assert found.observability.status['z'] == 'prior'
    assert 'rotation z' in found.observability.unobserved


def test_a_translation_that_hangs_on_an_unobserved_rotation_is_not_turned_with_it():
    """On flat ground park does not observe the heading; its translation fits that one."""
    truth = simulate(NOISY_FLAT, 5).T_a_b
    with pytest.raises(ConfigError, match='unobservable for this solver; use drift_aw'):
        run_with(NOISY_FLAT, 5, solver='park', prior_rotation=text(rpy(truth)),
                 prior_rotation_std='1')


def test_a_weak_prior_counts_little():
    free, _ = run_with(SCENARIOS['drone'], 2, solver='dnl')
    held, _ = run_with(SCENARIOS['drone'], 2, solver='dnl', prior_translation='0,0,0',
                       prior_translation_std='10')
    np.testing.assert_allclose(held.T_a_b, free.T_a_b, atol=1e-5)


def test_a_prior_that_contradicts_the_motion_is_said():
    rng = np.random.default_rng(5)
    X = random_pose(rng)
    a, b = sensor_pair(rng, X)
    a, b = perturb(rng, a, 1e-3, 1e-3), perturb(rng, b, 1e-3, 1e-3)
    for off, expected in ((0.0, 0), (0.5, 1)):
        found = calibrate(a, b, CalibrationConfig(
            solver='dnl', prior_translation=f'-,-,{X[2, 3] + off}',
            prior_translation_std='0.01')).findings
        said = [finding for finding in found if finding.code == 'prior-contradicts']
        assert len(said) == expected
    assert said[0].text.startswith('the prior of the translation z is 0.5')
