"""The drift-aware covariance: averaged over the terms, widened where the lags disagree."""

from dataclasses import replace

from motion_data import random_pose
import numpy as np
import pytest
from test_drift_aware import (
    as_pairs,
    AUTO,
    drifted,
    error_of,
    FIXED,
    shaken,
    simulated,
    smooth_motion,
)

from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.geometry import se3
from trajectory_calibration.simulation import Noise, SCENARIOS, simulate, with_noise
from trajectory_calibration.solvers import quadratic
from trajectory_calibration.solvers.drift_aware import (
    averaging,
    covariance,
)
from trajectory_calibration.solvers.drift_aware import (
    noise_checks as consistency,
)
from trajectory_calibration.solvers.drift_aware.covariance import in_parent_axes
from trajectory_calibration.solvers.drift_aware.likelihood import (
    evaluate,
    global_likelihood,
    predict_step,
)
from trajectory_calibration.solvers.drift_aware.model import (
    Chain,
    columns_of,
    corrected_steps,
    PARAMETERS,
    State,
)
from trajectory_calibration.solvers.drift_aware.noise import Noise as DriftNoise
from trajectory_calibration.solvers.drift_aware.selection import estimate, PRIOR_SCALE, RIVALS
from trajectory_calibration.solvers.drift_aware.solver import solve_pairs
from trajectory_calibration.time_alignment.pairing import associate


def coloured(rng, poses, sigma, memory=0.95):
    """Return the poses with errors (m, rad) that go on for twenty poses."""
    noise = sigma * rng.normal(size=(len(poses), 6))
    for k in range(1, len(noise)):
        noise[k] = memory * noise[k - 1] + np.sqrt(1 - memory**2) * noise[k]
    return poses @ se3.from_rotation_translation(se3.exp_so3(noise[:, 3:]), noise[:, :3])


def test_the_answer_of_a_lag_is_that_of_dnl(monkeypatch):
    pairs, _ = simulated(30, poses=300, white=(0.01, 0.005), walk=(0.01, 0.002))
    fit = estimate(pairs, FIXED)
    for lag in (2, 10):
        monkeypatch.setattr(consistency, 'LAGS', (lag,))
        check = consistency.check_lags(fit.chain, fit.state, fit.noise)
        dnl = quadratic.minimise(quadratic.gram(select_motions(pairs, f'B{lag}'))).T_a_b
        R = fit.state.T_a_b[:3, :3]
        found = np.concatenate([R.T @ (dnl[:3, 3] - fit.state.T_a_b[:3, 3]),
                                se3.log_so3(R.T @ dnl[:3, :3])])
        deviation = np.sqrt(np.diag(check.covariance))
        assert np.abs(found / deviation).max() > 0.3
        np.testing.assert_allclose(check.difference, found, atol=0.15 * deviation.max())
        np.testing.assert_allclose(
            check.difference / deviation, found / deviation, atol=0.2)


def at_the_truth(seed, share):
    """Return a (6,) gradient at the truth, the expected (3,) and the covariance.

    ``share`` of the white noise of rotation is that of a. The drive turns by a tenth about the
    horizontal axes.
    """
    rng = np.random.default_rng(seed)
    T_a_b = se3.from_rotation_translation(se3.exp_so3([0.3, -0.5, 1.0]), [0.4, -0.3, 0.8])
    times, phi = 0.2 * np.arange(150), 0.02
    true_a = smooth_motion(np.random.default_rng(0), times, tilt=0.1)
    true_b = drifted(rng, true_a @ T_a_b, (0.01, 0.001), (), 1.0, np.zeros(3))
    pairs = as_pairs(times, shaken(rng, true_a, 0.005, phi * np.sqrt(2 * share)),
                     shaken(rng, true_b, 0.005, phi * np.sqrt(2 - 2 * share)))
    chain = Chain.from_pairs(pairs)
    state, steps = State.start(chain, T_a_b), (149, 2)
    noise = replace(
        DriftNoise.guess(chain, np.ones((149, 6)), 0.5), jump_probability=np.zeros(steps),
        log_variances=2 * np.log([0.005, phi, 0.01, 0.001, 1e-7, 1e-7]))
    columns = columns_of(())
    for _ in range(3):
        _, response = predict_step(chain, state, noise, columns, 0.0)
        state = state.moved(np.zeros(PARAMETERS), -response[:, :, -1])
    gradient = global_likelihood(chain, state, noise, 0.0).blocks.sum(axis=0)[:6, -1]
    found = evaluate(chain, state, noise, columns)
    expected = 0.5 * np.tensordot(noise.white_slopes(T_a_b), found.white_projected, 2)
    return gradient, expected, found.covariance


@pytest.mark.parametrize('share', [0.0, 0.5, 1.0])
def test_rotation_noise_of_a_pulls_at_the_lever_arm(share):
    """Half the gradient at the truth is tr(P dV/dt) / 2 with equal sensors, twice that of a."""
    gradients, expected, covariances = (
        np.array(values) for values in
        zip(*(at_the_truth(seed, share) for seed in range(60)), strict=True))
    expected = np.append(expected.mean(axis=0), np.zeros(3))
    off = gradients.mean(axis=0) - 2 * share * expected
    # A gradient scatters by its information, the inverse of the covariance: chi-squared of six.
    spread = 60 * covariances.mean(axis=0)
    assert expected @ spread @ expected > 100
    assert off @ spread @ off < 22.5


@pytest.mark.parametrize('mode', ['fixed', 'estimate'])
def test_the_shift_of_the_lever_arm_is_in_the_covariance(mode, monkeypatch):
    pairs, _ = simulated(30, poses=300, white=(0.01, 0.02), walk=(0.01, 0.002))
    fit = estimate(pairs, {**FIXED, 'scale': mode})
    bias = covariance.lever_arm_bias(fit, fit.evaluation.covariance)
    # Towards no lever arm, in the axes of b.
    T_b_a = se3.inverse(fit.state.T_a_b)
    assert bias[:3] @ T_b_a[:3, 3] > 0.1 * np.linalg.norm(bias[:3])
    found = covariance.parameter_covariance(fit)
    monkeypatch.setattr(covariance, 'lever_arm_bias', lambda *_: np.zeros(len(bias)))
    np.testing.assert_allclose(
        found - covariance.parameter_covariance(fit), 4 / 3 * np.outer(bias, bias),
        rtol=1e-3, atol=1e-9)


def test_a_direction_without_information_has_no_shift():
    pairs, _ = simulated(8, poses=200, planar=True)
    fit = estimate(pairs, FIXED)
    bias = covariance.lever_arm_bias(fit, fit.likelihood.estimate(columns_of(()))[1])
    assert np.abs(bias).max() < 1e-6


def test_lags_agree_where_the_noise_is_the_model_s():
    statistics = []
    for seed in range(12):
        pairs, _ = simulated(300 + seed, white=(0.01, 0.005), walk=(0.01, 0.002))
        statistics.append(estimate(pairs, FIXED).lags.statistic)
    assert max(statistics) < consistency.SIGNIFICANT
    # The largest of six, each conservative: near its expectation, not near zero.
    assert 2 < np.mean(statistics) < 12


def test_lags_that_disagree_are_a_warning_and_widen():
    warned = 0
    for seed in range(8):
        pairs, _ = simulated(400 + seed, poses=600, white=(0.001, 0.0005))
        poses_b = coloured(np.random.default_rng(seed), pairs.poses_b, 0.03)
        pairs = PosePairs(pairs.stamps_ns, pairs.poses_a, poses_b, pairs.summary)
        solution, fit = solve_pairs(pairs, FIXED), estimate(pairs, FIXED)
        check = fit.lags
        told = [text for text in solution.warnings if 'short and long motions disagree' in text]
        assert len(told) == (check.statistic >= consistency.SIGNIFICANT)
        warned += len(told)
        model = in_parent_axes(fit.evaluation.covariance, fit.state.T_a_b)
        assert np.all(np.diag(solution.covariance) > 0.99 * check.excess * np.diag(model))
        for text in told:
            assert f'over {check.lag} poses' in text
            assert f'at least {np.sqrt(check.excess):.1f} times' in text
    # Drives of two minutes with errors of four seconds: half of them show it.
    assert warned > 2


def test_rotation_noise_pulls_at_the_answer_of_a_lag(monkeypatch):
    """The predicted bias against the mean of answers; the bodies are b's poses, noise and all."""
    times, phi = 0.2 * np.arange(200), 0.01
    monkeypatch.setattr(consistency, 'LAGS', (2,))
    true = smooth_motion(np.random.default_rng(0), times, tilt=0.1, turn=0.3)
    true[:, 0, 3] += 30 * times
    T_a_b = se3.from_rotation_translation(se3.exp_so3([0.3, -0.5, 1.0]), [0.4, -0.3, 0.8])
    differences, squares = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        pairs = as_pairs(times, shaken(rng, true, 0.001, phi),
                         shaken(rng, true @ T_a_b, 0.001, phi))
        chain = Chain.from_pairs(pairs)
        noise = replace(DriftNoise.guess(chain, np.ones((199, 6)), 0.5),
                        log_variances=2 * np.log([0.001, phi, *[1e-7] * 4]))
        state = replace(State.start(chain, T_a_b), bodies=pairs.poses_b)
        found = []
        for share in (0.0, 1.0):
            monkeypatch.setattr(consistency, 'UNKNOWN_SHARE', share)
            found.append(consistency.check_lags(chain, state, noise))
        differences.append(found[0].difference)
        squares.append(found[1].covariance - found[0].covariance)
    mean = np.mean(differences, axis=0)
    error = np.std(differences, axis=0) / np.sqrt(60)
    expected = np.sqrt(np.diag(np.mean(squares, axis=0)))
    assert (expected / error).max() > 10
    np.testing.assert_array_less(np.abs(np.abs(mean) - expected), 0.1 * expected + 3.5 * error)


@pytest.mark.parametrize('of_a', [0.0, 1.0])
def test_white_noise_at_speed_is_no_disagreement(of_a):
    """Over steps of six metres two milliradians say more of a motion than the motion does."""
    times = 0.2 * np.arange(300)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        true = smooth_motion(rng, times, tilt=0.01, turn=0.05)
        true[:, 0, 3] += 30 * times
        T_a_b = random_pose(rng)
        pairs = as_pairs(times, shaken(rng, true, 0.005, 0.002 * of_a),
                         shaken(rng, true @ T_a_b, 0.005, 0.002))
        assert estimate(pairs, FIXED).lags.statistic < consistency.SIGNIFICANT


def bounded(seed, memory):
    """Return pairs of two minutes with errors of 2 mm and 2 mrad that go on for so many poses."""
    pairs, _ = simulated(seed, poses=600, white=(0.005, 0.0005))
    rng = np.random.default_rng(seed)
    poses_a, poses_b = (coloured(rng, poses, 0.002, np.exp(-1 / memory))
                        for poses in (pairs.poses_a, pairs.poses_b))
    return PosePairs(pairs.stamps_ns, poses_a, poses_b, pairs.summary)


@pytest.mark.parametrize('memory', [25, 40])
def test_errors_that_do_not_accumulate_are_named(memory):
    told = []
    for seed in range(6):
        fit = estimate(bounded(500 + seed, memory), FIXED)
        told.append(consistency.check_walk(fit.chain, fit.state, fit.noise).is_bounded)
    assert sum(told) >= 4
    texts = [text for text in solve_pairs(bounded(500, memory), FIXED).warnings
             if 'do not add up as a walk would' in text]
    assert len(texts) == told[0]


def test_a_walk_accumulates():
    """The mean square has the distribution that is assumed; nothing else is taken for bounded."""
    chances = []
    for seed in range(40):
        pairs, _ = simulated(600 + seed, white=(0.005, 0.0005), walk=(0.01, 0.002))
        fit = estimate(pairs, FIXED)
        check = consistency.check_walk(fit.chain, fit.state, fit.noise)
        assert check.walk_share > 0.8
        assert not check.is_bounded
        chances.append(check.probability)
    below = np.mean(np.array(chances)[:, None] < [0.1, 0.5, 0.9], axis=0)
    # Within three standard deviations of 40 draws.
    np.testing.assert_allclose(below, [0.1, 0.5, 0.9], atol=0.2)


def test_white_noise_and_rounding_are_no_walk_that_is_bounded():
    for white, jumps in (((0.01, 0.005), ()), ((0.0, 0.0), ((40, 0.3), (41, -0.3)))):
        pairs, _ = simulated(7, white=white, jumps=jumps)
        fit = estimate(pairs, FIXED)
        check = consistency.check_walk(fit.chain, fit.state, fit.noise)
        assert check.walk_share < 0.1
        assert check.findings() == ()
    short = estimate(simulated(7, poses=30, walk=(0.01, 0.002))[0], FIXED)
    assert consistency.check_walk(short.chain, short.state, short.noise) is None


def test_a_long_drive_is_asked_in_stretches(monkeypatch):
    monkeypatch.setattr(consistency, '_STRETCH', 70)
    pairs, _ = simulated(31, poses=600, white=(0.005, 0.0005), walk=(0.01, 0.002))
    fit = estimate(pairs, FIXED)
    check = consistency.check_walk(fit.chain, fit.state, fit.noise)
    assert not check.is_bounded
    assert 0.5 < check.ratio < 1.5


def test_evidence_counts_by_degrees():
    def excess(statistic):
        return consistency.LagCheck(1, np.zeros(6), np.eye(6), statistic).excess

    statistics = np.linspace(5, 40, 3501)
    found = np.array([excess(statistic) for statistic in statistics])
    assert np.abs(np.diff(found)).max() < 0.02
    assert np.all(found[statistics < 14.4] == 1)
    np.testing.assert_allclose(found[statistics > 19.6], statistics[statistics > 19.6] / 6)

    # The sums of the blocks scatter by this many times what the model says, along one axis.
    gradients = np.tile(np.repeat([1.0, -1.0], 6).reshape(2, 6), (10, 1))
    gradients[:, 1:] = 0
    gradients /= np.linalg.norm(gradients) * np.sqrt(20 / 19)
    ratios = np.linspace(0.5, 10, 951)
    widened = np.array([covariance._widened(np.eye(6), np.sqrt(ratio) * gradients, 1.0)[0, 0]
                        for ratio in ratios])
    assert np.abs(np.diff(widened)).max() < 0.1
    assert np.all(widened[ratios < 2.4] == 1)
    np.testing.assert_allclose(widened[ratios > 3.1], ratios[ratios > 3.1])


def test_long_drives_are_judged_by_stretches(monkeypatch):
    pairs, _ = simulated(31, poses=600, white=(0.01, 0.005), walk=(0.01, 0.002))
    fit = estimate(pairs, FIXED)
    whole = fit.lags
    monkeypatch.setattr(consistency, '_STRETCH', 60)
    parts = consistency.check_lags(fit.chain, fit.state, fit.noise)
    assert np.all(np.diag(parts.covariance) > 0)
    assert parts.statistic < consistency.SIGNIFICANT > whole.statistic


def test_moments_are_those_of_the_prior_by_sampling():
    rng = np.random.default_rng(0)
    columns = columns_of(('scale', 'time_offset'))
    root = rng.normal(size=(8, 8)) * 0.01
    found = averaging.Gaussian(columns, 0.01 * rng.normal(size=8), root @ root.T)
    chain = Chain.from_pairs(simulated(1)[0])
    state = replace(State.start(chain, np.eye(4)), scale=1.01)
    result = averaging.weigh(found, state, 'scale', 'time_offset').mean()
    sigma = averaging._SIGMAS[rng.integers(1, 13, size=(400_000, 2))]
    sigma[rng.uniform(size=sigma.shape) < 0.75] = 0.0
    term = (rng.normal(size=sigma.shape) * sigma
            * [PRIOR_SCALE['scale'], PRIOR_SCALE['time_offset']])
    off = term - np.array([0.01 + found.mean[6], found.mean[7]])
    spread = found.covariance[6:, 6:]
    log_weight = -0.5 * np.einsum('ki,ij,kj->k', off, np.linalg.inv(spread), off)
    weight = np.exp(log_weight - log_weight.max())
    gain = found.covariance[:6, 6:] @ np.linalg.inv(spread)
    step = found.mean[:6] + off @ gain.T
    expected = (np.einsum('k,ki,kj->ij', weight / weight.sum(), step, step)
                + found.covariance[:6, :6] - gain @ found.covariance[6:, :6])
    deviation = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        result / np.outer(deviation, deviation), expected / np.outer(deviation, deviation),
        atol=0.02)


def test_rivals_share_the_prior_of_a_term_that_is_there():
    """Against the sum over every hypothesis of one joint likelihood of scale and drift."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(10, 10))
    information = 1e4 * root @ root.T
    gradient = information @ (0.01 * rng.normal(size=10))

    def given(columns, precision):
        """Return log evidence and (6, 6) moments with this (n,) precision of a prior at zero."""
        total = information[np.ix_(columns, columns)] + np.diag(precision)
        spread = np.linalg.inv(total)
        mean = spread @ gradient[columns]
        prior = np.log(precision[6:]).sum()
        return (0.5 * (gradient[columns] @ mean - np.linalg.slogdet(total)[1] + prior),
                (spread + np.outer(mean, mean))[:6, :6])

    expected = [(np.exp(averaging._LOG_PRIOR[0]), *given(np.arange(6), np.zeros(6)))]
    weighed = []
    for name in RIVALS:
        columns = columns_of((name,))
        for sigma in averaging._SIGMAS[1:]:
            precision = np.zeros(len(columns))
            precision[6:] = 1 / (PRIOR_SCALE[name] * sigma)**2
            expected.append((0.5 * np.exp(averaging._LOG_PRIOR[1]), *given(columns, precision)))
        spread = np.linalg.inv(information[np.ix_(columns, columns)])
        weighed.append(averaging.weigh(
            averaging.Gaussian(columns, spread @ gradient[columns], spread),
            State.start(Chain.from_pairs(simulated(1)[0]), np.eye(4)), name, None))
    prior, log_evidence, moments = (np.array(column) for column in zip(*expected, strict=True))
    assert prior.sum() == pytest.approx(1)
    weight = prior * np.exp(log_evidence - log_evidence.max())
    np.testing.assert_allclose(
        averaging.joined(*weighed).mean(), np.tensordot(weight / weight.sum(), moments, 1),
        rtol=1e-9)


def test_a_drift_along_the_motion_does_what_a_scale_does():
    lengths = np.array([0.5, 2.0, 1.0])[:, None]
    steps = lengths * [0.6, 0.0, -0.8]
    corrected, _ = corrected_steps(
        steps, lengths[:, None] * np.eye(3), 1.0, averaging.drift_for_scale(steps, 0.96))
    np.testing.assert_allclose(corrected, 0.96 * steps, atol=1e-12)


def test_a_drift_in_place_of_a_scale_is_judged_by_its_size(monkeypatch):
    """About a state with a scale, as about the one in which the drift was fitted."""
    noise = Noise(white=0.01, white_rotation=0.002, walk=0.005, walk_rotation=0.0005)
    run = simulate(with_noise(replace(SCENARIOS['offroad'], duration=40.0),
                              noise, replace(noise, scale=1.03)), 0)
    pairs = associate(run.a, run.b)
    seen = []
    monkeypatch.setattr(
        covariance, 'weigh', lambda *given: seen.append(averaging.weigh(*given)) or seen[-1])
    for name in RIVALS:
        covariance.extrinsic_covariance(estimate(pairs, {**FIXED, name: 'estimate'}), RIVALS)
    # The scale comes first, then the drift that takes its place, then the drift itself.
    _, instead, itself = (found.log_evidence[1:] - found.log_evidence[0] for found in seen)
    assert itself.min() > 100
    np.testing.assert_allclose(instead, itself, rtol=0.1)


def test_the_axes_of_a_warning_are_those_of_a():
    turn = se3.from_rotation_translation(se3.exp_so3([0.0, 0.0, np.pi / 2]), np.zeros(3))
    variances = np.diag([1e-4, 1.0, 1.0, 1.0, 1.0, 1e-6])
    along_x = consistency.LagCheck(5, np.array([0.1, 0, 0, 0, 0, 0]), variances, 60.0)
    (warning,) = along_x.findings(turn)
    assert 'over 5 poses alone would move b by +0.1 m along y of a, 10.0 times' in warning.text
    turn[:3, :3] = se3.exp_so3([0.0, np.pi / 2, 0.0])
    about_z = consistency.LagCheck(2, np.array([0, 0, 0, 0, 0, -0.02]), variances, 60.0)
    (warning,) = about_z.findings(turn)
    assert 'would turn b by -1.1 deg about x of a, 20.0 times' in warning.text


@pytest.mark.parametrize('seed', [105, 106])
def test_a_drift_that_was_not_proven_counts(seed):
    # On flat ground b drifts by half a percent, which the data hint at without a proof.
    run = simulate(SCENARIOS['road'], seed)
    pairs = associate(run.a, run.b)
    solution = solve_pairs(pairs, AUTO)
    assert solution.diagnosis.systematic_drift_deviation is None
    error = error_of(solution, run.T_a_b)
    assert error @ np.linalg.solve(solution.covariance, error) / 6 < 4
