# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""One consistent rig from pairs with correlated noise."""

from functools import partial
from itertools import combinations

import numpy as np
import pytest

from trajectory_calibration.assessment.observability import limits_of
from trajectory_calibration.config.prior import parse_prior
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.geometry import se3
from trajectory_calibration.rig import fusion
from trajectory_calibration.rig.fusion import fuse_numbers, pair_jacobian, spanning_start
from trajectory_calibration.rig.shared_noise import (
    half_shared,
    twist_to_step,
    with_own_share,
    with_stated_blocks,
)
from trajectory_calibration.simulation.scenario import random_pose

fuse = partial(fusion.fuse, limits=limits_of(CalibrationConfig()))


def rig(sensors, rng):
    return np.stack([np.eye(4), *(random_pose(rng) for _ in range(sensors - 1))])


def exact(X, pairs):
    return np.stack([se3.inverse(X[i]) @ X[j] for i, j in pairs])


def noisy_answers(X, pairs, sigma, rng):
    """Return answers with an independent twist per sensor: a pair has the difference of two."""
    twist = sigma[:, None] * rng.standard_normal((len(X), 6))
    return np.stack([
        se3.moved(se3.inverse(X[i]) @ X[j], twist_to_step(X[i], X[j]) @ (twist[j] - twist[i]))
        for i, j in pairs])


def covariance_of_pairs(X, pairs, sigma):
    C = np.zeros((len(pairs), 6, len(pairs), 6))
    L = [twist_to_step(X[i], X[j]) for i, j in pairs]
    for p, one in enumerate(pairs):
        for q, other in enumerate(pairs):
            shared = sum(sigma[s]**2 * (1 if one.index(s) == other.index(s) else -1)
                         for s in one if s in other)
            C[p, :, q] = shared * L[p] @ L[q].T
    return C


def error_of(fused, X):
    return np.concatenate([se3.step_between(X[s], fused.X[s]) for s in range(1, len(X))])


@pytest.mark.parametrize('sensors', [2, 3, 5, 8])
def test_exact_answers_give_the_rig_and_loops_close(sensors):
    rng = np.random.default_rng(sensors)
    X = rig(sensors, rng)
    pairs = list(combinations(range(sensors), 2))
    answers = exact(X, pairs)
    C = covariance_of_pairs(X, pairs, np.full(sensors, 0.01))
    start = spanning_start(sensors, pairs, answers, np.stack([C[p, :, p] for p in range(len(C))]))
    fused = fuse(start, pairs, answers, C)
    np.testing.assert_allclose(fused.X, X, atol=1e-12)
    assert fused.chi_squared < 1e-12
    assert fused.degrees == 6 * (len(pairs) - sensors + 1)


def test_loops_of_noisy_answers_close_exactly():
    rng = np.random.default_rng(1)
    X = rig(4, rng)
    pairs = list(combinations(range(4), 2))
    answers = np.stack([se3.moved(T, 0.05 * rng.standard_normal(6)) for T in exact(X, pairs)])
    C = covariance_of_pairs(X, pairs, np.full(4, 0.02))
    fused = fuse(X, pairs, answers, C)
    for a, b, c in combinations(range(4), 3):
        T = [se3.inverse(fused.X[i]) @ fused.X[j] for i, j in ((a, b), (b, c), (c, a))]
        np.testing.assert_allclose(T[0] @ T[1] @ T[2], np.eye(4), atol=1e-12)


def test_jacobian_of_a_pair_is_the_numeric_one():
    rng = np.random.default_rng(2)
    X = rig(3, rng)
    of_i, of_j = pair_jacobian(X[1], X[2])
    T = se3.inverse(X[1]) @ X[2]
    for k in range(6):
        step = 1e-6 * np.eye(6)[k]
        by_i = se3.step_between(T, se3.inverse(se3.moved(X[1], step)) @ X[2]) / 1e-6
        by_j = se3.step_between(T, se3.inverse(X[1]) @ se3.moved(X[2], step)) / 1e-6
        np.testing.assert_allclose(of_i[:, k], by_i, atol=1e-5)
        np.testing.assert_allclose(of_j[:, k], by_j, atol=1e-5)


def test_inverting_a_pair_changes_nothing():
    rng = np.random.default_rng(3)
    X = rig(3, rng)
    sigma = np.array([0.004, 0.002, 0.003])
    pairs = [(0, 1), (0, 2), (1, 2)]
    answers = noisy_answers(X, pairs, sigma, rng)
    answers[2] = se3.moved(answers[2], np.full(6, 0.002))
    other = [(0, 1), (0, 2), (2, 1)]
    turned = answers.copy()
    turned[2] = se3.inverse(answers[2])
    one = fuse(X, pairs, answers, covariance_of_pairs(X, pairs, sigma))
    two = fuse(X, other, turned, covariance_of_pairs(X, other, sigma))
    np.testing.assert_allclose(one.X, two.X, atol=2e-5)


def nees(own_share, sensors=5, draws=150):
    """Return the mean NEES per degree of freedom if pairs have the noise of their sensors."""
    rng = np.random.default_rng(4)
    pairs = list(combinations(range(sensors), 2))
    found = []
    for _ in range(draws):
        X = rig(sensors, rng)
        sigma = rng.uniform(0.001, 0.004, sensors)
        answers = noisy_answers(X, pairs, sigma, rng)
        C = covariance_of_pairs(X, pairs, sigma)
        V = with_own_share(C, own_share).reshape(C.shape)
        fused = fuse(X, pairs, answers, V)
        error = error_of(fused, X)
        found.append(error @ np.linalg.solve(fused.covariance, error) / len(error))
    return np.mean(found)


def test_correlated_pairs_give_a_consistent_covariance():
    assert 0.9 < nees(0.0) < 1.1


def test_assuming_independent_pairs_is_wrong():
    # The noise of the base is in all its pairs, and is not averaged out.
    assert nees(1.0) > 1.8


def test_half_for_each_sensor_is_consistent_if_pairs_are_correlated():
    rng = np.random.default_rng(5)
    pairs = list(combinations(range(4), 2))
    found = []
    for _ in range(100):
        X = rig(4, rng)
        sigma = np.array([0.002, 0.001, 0.003, 0.002])
        answers = noisy_answers(X, pairs, sigma, rng)
        C = covariance_of_pairs(X, pairs, sigma)
        stated = np.stack([C[p, :, p] for p in range(6)])
        half = np.einsum('pq,ab->paqb', half_shared(4, pairs), np.eye(6))
        guess = with_stated_blocks(half, stated, X, pairs)
        fused = fuse(X, pairs, answers, guess)
        error = error_of(fused, X)
        found.append(error @ np.linalg.solve(fused.covariance, error) / len(error))
    assert 0.8 < np.mean(found) < 1.3


def test_stated_covariances_are_kept():
    rng = np.random.default_rng(6)
    X = rig(3, rng)
    pairs = [(0, 1), (0, 2), (1, 2)]
    sigma = np.array([1e-3, 2e-3, 3e-3])
    M = covariance_of_pairs(np.broadcast_to(np.eye(4), X.shape), pairs, sigma)
    A = rng.standard_normal((3, 6, 6))
    stated = 1e-4 * (A @ np.swapaxes(A, 1, 2) + np.eye(6))
    C = with_stated_blocks(M, stated, X, pairs)
    for p in range(3):
        np.testing.assert_allclose(C[p, :, p], stated[p], rtol=1e-9)
    assert np.linalg.eigvalsh(C.reshape(18, 18)).min() > -1e-12
    wanted = covariance_of_pairs(X, pairs, sigma)
    np.testing.assert_allclose(with_stated_blocks(
        M, np.stack([wanted[p, :, p] for p in range(3)]), X, pairs), wanted, atol=1e-12)


def test_a_prior_fixes_what_it_knows():
    rng = np.random.default_rng(7)
    X = rig(3, rng)
    pairs = [(0, 1), (0, 2), (1, 2)]
    answers = exact(X, pairs)
    C = covariance_of_pairs(X, pairs, np.full(3, 0.01))
    height = X[1, 2, 3] + 0.02
    prior = parse_prior(f'-,-,{height}', '-,-,0', '', '')
    fused = fuse(X, pairs, answers, C, priors={1: prior})
    assert fused.X[1, 2, 3] == pytest.approx(height, abs=1e-9)
    assert fused.covariance[2, 2] < 1e-12


def test_an_untrusted_sensor_does_not_influence_the_others():
    rng = np.random.default_rng(8)
    X = rig(4, rng)
    pairs = list(combinations(range(4), 2))
    answers = exact(X, pairs)
    for p, pair in enumerate(pairs):
        if 2 in pair:
            answers[p] = se3.moved(answers[p], rng.uniform(-0.3, 0.3, 6))
    C = covariance_of_pairs(X, pairs, np.full(4, 0.01))
    trusted = np.array([2 not in pair for pair in pairs])
    fused = fuse(X, pairs, answers, C, trusted=trusted)
    np.testing.assert_allclose(fused.X[[1, 3]], X[[1, 3]], atol=1e-6)
    assert fused.chi_squared < 1e-6
    assert fused.degrees == 6


def test_numbers_are_consistent_round_loops():
    pairs = [(0, 1), (1, 2), (0, 2)]
    found, std = fuse_numbers(3, pairs, np.array([0.1, 0.2, 0.33]), np.full(3, 0.01))
    np.testing.assert_allclose(found, [0, 0.11, 0.32], atol=1e-12)
    # With the noise of common sensors, a loop does not reduce the standard deviation.
    np.testing.assert_allclose(std, [0, 0.01, 0.01], rtol=1e-9)
