# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The certificate proves true minima, never a false one, and its bound always holds."""

import numpy as np
import pytest

from trajectory_calibration import CalibrationConfig
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.geometry import se3
from trajectory_calibration.simulation import SCENARIOS, simulate
from trajectory_calibration.solvers import load_solver, quadratic
from trajectory_calibration.solvers.certificate import _CONSTRAINTS, certify, PROVEN
from trajectory_calibration.solvers.dnl import lowest_minimum
from trajectory_calibration.time_alignment.pairing import associate

# Standard deviations of the noise of a motion, metres and radians: up to nothing but noise.
NOISE = (0.0, 1e-6, 1e-3, 0.01, 0.05, 0.2, 0.5, 1.0, 3.0)


def random_form(rng, noise):
    """Return the (13, 13) Gram matrix of 4 to 60 random motions."""
    count = int(rng.integers(4, 60))
    X = se3.exp_se3(rng.normal(size=6))
    A = se3.exp_se3(0.5 * rng.normal(size=(count, 6)))
    B = se3.inverse(X) @ A @ X @ se3.exp_se3(noise * rng.normal(size=(count, 6)))
    return quadratic.form(quadratic.features(A, B).sum(axis=1))


def rotations(rng, count):
    q = rng.normal(size=(count, 4))
    return se3.quaternion_to_rotation(q / np.linalg.norm(q, axis=1, keepdims=True))


def costs_at(G, R):
    v = quadratic.monomials(se3.from_rotation_translation(R, quadratic.best_translation(G, R)))
    return np.einsum('ki,ij,kj->k', v, G, v)


def test_constraints_hold_at_rotations_and_not_at_reflections():
    R = rotations(np.random.default_rng(0), 50)
    for sign, holds in ((1.0, True), (-1.0, False)):
        u = np.column_stack([sign * R.reshape(-1, 9), np.ones(50)])
        values = np.einsum('ki,cij,kj->kc', u, _CONSTRAINTS[:-1], u)
        assert bool(np.abs(values).max() < 1e-12) is holds


@pytest.mark.parametrize('noise', NOISE)
def test_minima_are_proven_and_bounds_hold(noise):
    """60 problems at each of nine levels of noise: 540 in all."""
    rng = np.random.default_rng(int(1e6 * noise))
    proven = 0
    for _ in range(60):
        G = random_form(rng, noise)
        found, gap = lowest_minimum(G)
        proven += gap <= PROVEN
        lowest = costs_at(G, rotations(rng, 50)).min()
        assert lowest >= found.cost * (1 - gap) - 1e-9 * np.trace(G)
    assert proven >= (60 if noise < 0.5 else 57)


def test_a_local_minimum_is_never_proven():
    rng = np.random.default_rng(7)
    seen = 0
    for _ in range(150):
        G = random_form(rng, 1.0)
        R, cost, _ = quadratic.minimise_rotations(G, rotations(rng, 24))
        worst = int(np.argmax(cost))
        if cost[worst] > cost.min() * (1 + 1e-4):
            seen += 1
            T = se3.from_rotation_translation(R[worst], quadratic.best_translation(G, R[worst]))
            gap = certify(G, T)
            assert gap > PROVEN
            assert cost[worst] * (1 - gap) <= cost.min() * (1 + 1e-9)
    assert seen > 7


def test_a_point_that_is_no_minimum_is_not_proven():
    rng = np.random.default_rng(3)
    G = random_form(rng, 0.05)
    best = quadratic.minimise(G).T_a_b
    R = se3.exp_so3([0.1, 0.0, 0.0]) @ best[:3, :3]
    T = se3.from_rotation_translation(R, quadratic.best_translation(G, R))
    gap = certify(G, T)
    assert gap > PROVEN
    assert costs_at(G, R[None])[0] * (1 - gap) <= quadratic.minimise(G).cost


@pytest.mark.parametrize('scenario', ['noise', 'outliers', 'drift', 'mixture'])
@pytest.mark.parametrize('reference', ['A', 'B1', 'B5', 'C10'])
def test_dnl_is_proven_on_the_scenarios_of_the_paper(scenario, reference):
    for seed in range(5):
        run = simulate(SCENARIOS[scenario], seed)
        motions = select_motions(associate(run.a, run.b), reference)
        found = load_solver('dnl')(motions, CalibrationConfig())
        assert found.findings == ()
        assert found.optimality_gap < 1e-6
