"""The parts of the drift-aware solver against numeric derivatives and dense algebra."""

from dataclasses import replace

from motion_data import random_pose, wander
import numpy as np
import pytest

from trajectory_calibration import Trajectory
from trajectory_calibration.errors import SolverError
from trajectory_calibration.geometry import se3
from trajectory_calibration.solvers.drift_aware.block_chain import BlockChain
from trajectory_calibration.solvers.drift_aware.fit import first_noise, fit
from trajectory_calibration.solvers.drift_aware.likelihood import (
    evaluate,
    global_likelihood,
    invert_information,
)
from trajectory_calibration.solvers.drift_aware.model import (
    Chain,
    columns_of,
    corrected_steps,
    linearise,
    PARAMETERS,
    perturb,
    State,
    TERM_COLUMNS,
)
from trajectory_calibration.solvers.drift_aware.noise import Noise
from trajectory_calibration.solvers.drift_aware.pool import Pool
from trajectory_calibration.time_alignment.pairing import associate_nearest

ALL_TERMS = tuple(TERM_COLUMNS)


def noisy_pairs(rng, poses, noise=0.02):
    """Return pose pairs at irregular times, with white noise on b."""
    T_a_b = random_pose(rng)
    poses_a = wander(rng, poses)
    poses_b = random_pose(rng, distance=5.0) @ poses_a @ T_a_b
    poses_b = poses_b @ se3.exp_se3(noise * rng.normal(size=(poses, 6)))
    stamps_ns = np.cumsum(rng.integers(50_000_000, 150_000_000, poses))
    pairs = associate_nearest(Trajectory(stamps_ns, poses_a), Trajectory(stamps_ns, poses_b),
                              max_difference_ns=0)
    return pairs, T_a_b


@pytest.fixture(name='problem')
def fixture_problem():
    """Return a chain of seven poses, a state away from the minimum, and a noise."""
    rng = np.random.default_rng(3)
    pairs, T_a_b = noisy_pairs(rng, 7)
    chain = Chain.from_pairs(pairs)
    state = State.start(chain, T_a_b).moved(
        0.02 * rng.normal(size=PARAMETERS), 0.05 * rng.normal(size=(7, 6)))
    noise = first_noise(chain, state, 0.5)
    gamma = rng.uniform(0.05, 0.4, size=(6, 2))
    return chain, state, replace(noise, jump_probability=gamma)


@pytest.mark.parametrize('blocks', [1, 2, 3, 4, 5, 8, 13])
def test_block_chain_against_dense_algebra(blocks):
    rng = np.random.default_rng(blocks)
    n = 3
    J = rng.normal(size=(blocks, n, n))
    K = rng.normal(size=(blocks - 1, n, 2 * n))
    H = np.zeros((blocks * n, blocks * n))
    for k in range(blocks):
        H[k * n:(k + 1) * n, k * n:(k + 1) * n] += J[k].T @ J[k] + 0.1 * np.eye(n)
    for k in range(blocks - 1):
        H[k * n:(k + 2) * n, k * n:(k + 2) * n] += K[k].T @ K[k]
    dense = H.reshape(blocks, n, blocks, n).transpose(0, 2, 1, 3)
    k = np.arange(blocks)
    right = rng.normal(size=(blocks, n, 2))
    chain = BlockChain.factor(dense[k, k], dense[k[:-1], k[1:]])
    diagonal, upper = chain.partial_inverse()
    inverse = np.linalg.inv(H).reshape(blocks, n, blocks, n).transpose(0, 2, 1, 3)
    np.testing.assert_allclose(
        chain.solve(right).reshape(-1, 2), np.linalg.solve(H, right.reshape(-1, 2)), atol=1e-11)
    np.testing.assert_allclose(
        chain.quadratic_form(right),
        right.reshape(-1, 2).T @ np.linalg.solve(H, right.reshape(-1, 2)), atol=1e-11)
    np.testing.assert_allclose(chain.log_determinant, np.linalg.slogdet(H)[1], atol=1e-11)
    np.testing.assert_allclose(diagonal, inverse[k, k], atol=1e-11)
    np.testing.assert_allclose(upper, inverse[k[:-1], k[1:]], atol=1e-11)


def test_block_chain_in_pieces(monkeypatch):
    monkeypatch.setattr('trajectory_calibration.solvers.drift_aware.block_chain._PIECE', 2)
    for blocks in (4, 5, 6, 13):
        test_block_chain_against_dense_algebra(blocks)


def test_block_chain_refuses_what_is_not_positive_definite():
    with pytest.raises(np.linalg.LinAlgError):
        BlockChain.factor(-np.ones((3, 1, 1)), np.zeros((2, 1, 1)))


def test_jacobians_of_the_global_parameters(problem):
    chain, state, _ = problem
    found = linearise(chain, state, columns_of(ALL_TERMS), 0, len(chain))
    still = np.zeros((len(chain), 6))
    for j, step in enumerate(1e-6 * np.eye(PARAMETERS)):
        ahead, behind = (linearise(
            chain, state.moved(sign * step, still), columns_of(()), 0, len(chain))
            for sign in (1, -1))
        for name, first in (('observation', 6), ('walk', 12)):
            numeric = (getattr(ahead, name) - getattr(behind, name))[:, :, -1] / 2e-6
            np.testing.assert_allclose(
                getattr(found, name)[:, :, first + j], numeric, atol=1e-6, err_msg=f'{name} {j}')


def test_jacobians_of_the_bodies(problem):
    chain, state, _ = problem
    columns = columns_of(())
    found = linearise(chain, state, columns, 0, len(chain))
    for j in range(6):
        for parity in (0, 1):
            step = np.zeros((len(chain), 6))
            step[parity::2, j] = 1e-6
            ahead, behind = (linearise(
                chain, state.moved(np.zeros(PARAMETERS), sign * step), columns, 0, len(chain))
                for sign in (1, -1))
            observation = (ahead.observation - behind.observation)[:, :, -1] / 2e-6
            walk = (ahead.walk - behind.walk)[:, :, -1] / 2e-6
            np.testing.assert_allclose(
                observation[parity::2], found.observation[parity::2, :, j], atol=1e-6)
            # Of a step, the pose before it or the one after it has moved.
            np.testing.assert_allclose(walk[parity::2], found.walk[parity::2, :, j], atol=1e-6)
            np.testing.assert_allclose(
                walk[1 - parity::2], found.walk[1 - parity::2, :, 6 + j], atol=1e-6)


def test_steps_with_a_drift_are_restored():
    rng = np.random.default_rng(1)
    true = rng.normal(size=(50, 3))
    drift = np.array([0.03, -0.02, 0.05])
    reported = (true + np.linalg.norm(true, axis=1)[:, None] * drift) / 1.1
    arcs = np.linalg.norm(reported, axis=1)[:, None, None] * np.eye(3)
    restored, _ = corrected_steps(reported, arcs, 1.1, drift)
    np.testing.assert_allclose(restored, true, atol=1e-14)
    np.testing.assert_array_equal(corrected_steps(0 * true, 0 * arcs, 1.1, drift)[0], 0)


def test_a_thinned_chain_knows_that_the_drift_turned():
    rng = np.random.default_rng(2)
    drift = np.array([0.003, -0.002, 0.005])
    poses_a, T_a_b = wander(rng, 201), random_pose(rng)
    truth = poses_a @ T_a_b
    steps = se3.inverse(truth[:-1]) @ truth[1:]
    length = np.linalg.norm(steps[:, :3, 3], axis=1)
    steps[:, :3, 3] += length[:, None] * drift
    reported = [np.eye(4)]
    for step in steps:
        reported.append(reported[-1] @ step)
    stamps_ns = 100_000_000 * np.arange(201)
    pairs = associate_nearest(
        Trajectory(stamps_ns, poses_a), Trajectory(stamps_ns, np.array(reported)),
        max_difference_ns=0)
    second_order = np.linalg.norm(drift)**2 * length.max()

    def largest_residual(chain):
        state = replace(State.start(chain, T_a_b), systematic_drift=drift)
        return np.abs(linearise(chain, state, columns_of(()), 0, len(chain)).walk[:, :, -1]).max()

    assert largest_residual(Chain.from_pairs(pairs)) < 1e-12
    thinned = Chain.from_pairs(pairs, 10)
    chord = np.linalg.norm(thinned.step_translation, axis=1)[:, None, None] * np.eye(3)
    assert largest_residual(thinned) < 10 * second_order
    assert largest_residual(replace(thinned, step_arc=chord)) > 30 * second_order


@pytest.mark.parametrize(('terms', 'needed'), [
    (('scale', 'systematic_drift'), 'scale_mode or systematic_drift_mode auto'),
    (('systematic_drift',), 'check units and frames')])
def test_terms_that_run_away_are_named(problem, terms, needed):
    chain, state, noise = problem
    state = replace(state, systematic_drift=np.array([0.6, 0, 0]))
    with pytest.raises(SolverError, match=needed):
        fit(chain, state, noise, terms)


def test_variances_by_length_and_turn_carry_over_to_a_thinned_chain():
    pairs, _ = noisy_pairs(np.random.default_rng(4), 205)
    full, thinned = Chain.from_pairs(pairs), Chain.from_pairs(pairs, 10)
    assert len(thinned) == 21
    for part in ('step_length', 'step_turn'):
        np.testing.assert_allclose(
            getattr(thinned, part), getattr(full, part)[:200].reshape(20, 10).sum(axis=1))


@pytest.fixture(name='pooled')
def fixture_pooled(monkeypatch):
    """Treat arrays of a few hundred kilobytes as large."""
    monkeypatch.setattr('trajectory_calibration.solvers.drift_aware.pool._SMALL', 1 << 15)


@pytest.mark.usefixtures('pooled')
def test_memory_is_given_out_again_when_nothing_refers_to_it():
    pool = Pool()
    large = (1000, 6, 10)

    def address(array):
        return array.__array_interface__['data'][0]

    first = pool.empty(large)
    part = first[10:].transpose(0, 2, 1)[::3]
    where = address(first)
    del first
    # A view of a view is left.
    other = pool.zeros(large)
    assert address(other) != where
    assert not other.any()
    del part
    assert address(pool.empty((900, 60))) == where
    # A little larger, then far smaller: neither takes that memory.
    assert not np.shares_memory(larger := pool.empty((1000, 6, 11)), other)
    assert larger.shape == (1000, 6, 11)
    assert pool.empty((3, 3)).shape == (3, 3)


@pytest.mark.usefixtures('pooled')
def test_evaluations_that_share_memory_do_not_share_results():
    rng = np.random.default_rng(6)
    pairs, T_a_b = noisy_pairs(rng, 3000)
    chain = Chain.from_pairs(pairs)
    state = State.start(chain, T_a_b)
    noise = first_noise(chain, state, 0.5)
    moved = replace(state, T_a_b=T_a_b @ se3.exp_se3(np.full(6, 0.01)))
    cases = [(columns_of(terms), at) for terms in ((), ALL_TERMS) for at in (state, moved)]
    shared = [evaluate(chain, at, noise, columns) for columns, at in cases]
    for found, (columns, at) in zip(shared, cases, strict=True):
        alone = evaluate(Chain.from_pairs(pairs), at, noise, columns)
        for name in ('objective', 'covariance', 'body_response', 'leverage', 'walk_spread'):
            np.testing.assert_array_equal(getattr(found, name), getattr(alone, name))


def dense_likelihood(chain, state, noise, columns):
    """Return the objective, the (m, m) covariance and P, all from one dense matrix."""
    N, m = len(chain), len(columns)
    linear = linearise(chain, state, columns, 0, N)
    design = np.zeros((12 * N - 6, 6 * N + m))
    R = np.zeros((12 * N - 6, 12 * N - 6))
    white = noise.white_parts(state.T_a_b).sum(axis=0)
    variance = np.repeat(1 / noise.walk_precision(noise.walk_parts().sum(axis=0)), 3, axis=1)
    for k in range(N):
        rows = slice(6 * k, 6 * k + 6)
        design[rows, 6 * k:6 * k + 6] = linear.observation[k, :, :6]
        design[rows, 6 * N:] = linear.observation[k, :, 6:-1]
        R[rows, rows] = white
    for k in range(N - 1):
        rows = slice(6 * (N + k), 6 * (N + k) + 6)
        design[rows, 6 * k:6 * k + 12] = linear.walk[k, :, :12]
        design[rows, 6 * N:] = linear.walk[k, :, 12:-1]
        R[rows, rows] = np.diag(variance[k])
    y = np.concatenate([linear.observation[:, :, -1].ravel(), linear.walk[:, :, -1].ravel()])
    W = np.linalg.inv(R)
    H = design.T @ W @ design
    P = W - W @ design @ np.linalg.solve(H, design.T @ W)
    objective = (np.linalg.slogdet(R)[1] + np.linalg.slogdet(H)[1] + y @ P @ y)
    return objective, np.linalg.inv(H)[6 * N:, 6 * N:], P


@pytest.mark.parametrize('terms', [(), ALL_TERMS])
def test_likelihood_against_dense_algebra(problem, terms):
    chain, state, noise = problem
    noise = replace(noise, jump_probability=np.zeros((6, 2)))
    columns = columns_of(terms)
    objective, covariance, P = dense_likelihood(chain, state, noise, columns)
    found = evaluate(chain, state, noise, columns)
    # Without jumps what is left of the mixture is the prior of there being none.
    prior = -2 * len(noise.jump_probability) * np.log1p(-noise.jump_share).sum()
    np.testing.assert_allclose(found.objective, objective + prior, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-6, atol=1e-12)
    projected = sum(P[6 * k:6 * k + 6, 6 * k:6 * k + 6] for k in range(7))
    np.testing.assert_allclose(found.white_projected, projected, rtol=1e-6)


def test_score_of_the_variances(problem):
    chain, state, noise = problem
    noise = replace(noise, jump_variance=np.array([1e4, 1e4]))
    columns = columns_of(('scale',))

    def objective(log_variances):
        return evaluate(
            chain, state, replace(noise, log_variances=log_variances), columns).objective

    numeric = [(objective(noise.log_variances + step) - objective(noise.log_variances - step))
               / 2e-5 for step in 1e-5 * np.eye(6)]
    found = evaluate(chain, state, noise, columns).score
    # The wide component moves with the narrow one too; that part is left out.
    np.testing.assert_allclose(found, numeric, rtol=1e-3, atol=1e-3)


def test_what_the_noise_does_to_the_answer(problem):
    chain, state, noise = problem
    noise = replace(noise, jump_variance=np.array([1e4, 1e4]))
    columns = columns_of(('scale', 'time_offset'))

    def step(of_noise):
        return evaluate(chain, state, of_noise, columns).parameter_step

    found = evaluate(chain, state, noise, columns)
    numeric = np.stack([
        step(replace(noise, log_variances=noise.log_variances + change))
        - step(replace(noise, log_variances=noise.log_variances - change))
        for change in 1e-5 * np.eye(6)], axis=1) / 2e-5
    np.testing.assert_allclose(found.sensitivity, numeric, rtol=1e-3, atol=1e-6)
    narrow = noise.walk_parts().sum(axis=0)
    reweighted = np.zeros(noise.jump_probability.shape)
    for k, part in ((0, 0), (2, 1), (5, 0)):
        change = 1e-4 * np.eye(reweighted.size)[2 * k + part].reshape(reweighted.shape)
        ahead, behind = (replace(noise, jump_probability=noise.jump_probability + sign * change)
                         for sign in (1, -1))
        reweighted = ahead.walk_precision(narrow) - behind.walk_precision(narrow)
        expected = -found.covariance @ np.tensordot(reweighted, found.leverage, 2)
        np.testing.assert_allclose(step(ahead) - step(behind), expected, rtol=1e-3, atol=1e-9)


def test_pieces_do_not_change_the_result(problem, monkeypatch):
    chain, state, noise = problem
    columns = columns_of(ALL_TERMS)
    whole = evaluate(chain, state, noise, columns)
    monkeypatch.setattr('trajectory_calibration.solvers.drift_aware.likelihood.PIECE', 3)
    pieces = evaluate(chain, state, noise, columns)
    for name in ('objective', 'parameter_step', 'score', 'score_information', 'walk_spread',
                 'leverage'):
        np.testing.assert_allclose(getattr(pieces, name), getattr(whole, name), rtol=1e-8,
                                   atol=1e-12, err_msg=name)


@pytest.mark.parametrize('terms', [(), ('scale',), ALL_TERMS])
@pytest.mark.parametrize('piece', [3, 100])
def test_one_elimination_serves_all_terms(problem, monkeypatch, terms, piece):
    chain, state, noise = problem
    monkeypatch.setattr('trajectory_calibration.solvers.drift_aware.likelihood.PIECE', piece)
    columns = columns_of(terms)
    expected = evaluate(chain, state, noise, columns, 3.0)
    every = global_likelihood(chain, state, noise, 3.0)
    step, covariance = every.estimate(columns)
    deviation = np.sqrt(np.diag(expected.covariance))
    np.testing.assert_allclose(
        step / deviation, expected.parameter_step / deviation, atol=1e-6)
    np.testing.assert_allclose(covariance / np.outer(deviation, deviation),
                               expected.covariance / np.outer(deviation, deviation), atol=1e-6)
    # At the minimum the parts of the gradient cancel, but for the factor s^T.
    slope = np.where(columns == TERM_COLUMNS['scale'].start, 3.0 / state.scale, 0.0)
    parts = every.gradients(columns, step)
    assert np.abs(parts @ np.diag(deviation)).max() > 1e-2
    np.testing.assert_allclose(deviation * (parts.sum(axis=0) - slope), 0, atol=1e-6)


def test_directions_without_information_do_not_move():
    axis = np.array([1.0, 2.0, 2.0]) / 3
    information = 4.0 * (np.eye(3) - np.outer(axis, axis))
    inverse, free, log_determinant = invert_information(information, 10 * np.eye(3))
    np.testing.assert_allclose(inverse, 0.25 * (np.eye(3) - np.outer(axis, axis)), atol=1e-12)
    np.testing.assert_allclose(free, np.outer(axis, axis), atol=1e-12)
    assert np.isfinite(log_determinant)


def test_white_noise_follows_the_lever_arm():
    rng = np.random.default_rng(5)
    T_a_b = random_pose(rng)
    noise = Noise(np.log([0.01**2, 0.02**2, 1, 1, 1, 1]), np.ones((2, 3)), np.zeros((3, 1)),
                  np.zeros((3, 2)), np.ones(2), np.full(2, 0.1))
    samples = 200_000
    n_a, n_b = (rng.normal(size=(samples, 6)) * np.repeat([0.01, 0.02], 3) for _ in range(2))
    poses_a = se3.from_rotation_translation(se3.exp_so3(n_a[:, 3:]), n_a[:, :3])
    moved = se3.inverse(T_a_b) @ poses_a @ T_a_b
    seen = np.concatenate([moved[:, :3, 3], se3.log_so3(moved[:, :3, :3])], axis=1)
    expected = np.cov((n_b - seen).T)
    np.testing.assert_allclose(noise.white_parts(T_a_b).sum(axis=0), expected, atol=2e-5)
    numeric = [(noise.white_parts(ahead) - noise.white_parts(behind)).sum(axis=0) / 2e-4
               for ahead, behind in zip(*(perturb(T_a_b, sign * 1e-4 * np.eye(6)[:3])
                                          for sign in (1, -1)), strict=True)]
    np.testing.assert_allclose(noise.white_slopes(T_a_b), numeric, atol=1e-12)
