# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Covariances are judged by coverage: errors against a known truth, over many seeds."""

from motion_data import random_pose
import numpy as np
import pytest
from thinning import thinned

from trajectory_calibration import calibrate, CalibrationConfig, SolverError
from trajectory_calibration.assessment.covariance import estimate_uncertainty
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.data.pose_pairs import PosePairs
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
from trajectory_calibration.solvers import linear, load_solver
from trajectory_calibration.solvers.solution import Solution
from trajectory_calibration.solvers.zhuang import linearise as zhuang
from trajectory_calibration.time_alignment.pairing import associate

pytestmark = pytest.mark.usefixtures('noise_identified_once')
WALK = Noise(white=0.001, walk=0.02, walk_rotation=0.01)
CASES = {'white': SCENARIOS['noise'], 'mixture': SCENARIOS['mixture'],
         'walk': with_noise(Scenario(), WALK, WALK), 'offroad': SCENARIOS['offroad']}
LINEARISE = {'dnl': linear.frobenius, 'ali': linear.translation_only, 'park': linear.separable,
             'zhuang': lambda *arguments: zhuang(np.eye(3), *arguments)}


def error_of(T_a_b, truth):
    """Return (6,) the step from an extrinsic to the truth, in the order of the covariance."""
    return np.concatenate([truth[:3, 3] - T_a_b[:3, 3],
                           se3.log_so3(truth[:3, :3] @ T_a_b[:3, :3].T)])


def moved(T_a_b, step):
    return se3.from_rotation_translation(
        se3.exp_so3(step[3:]) @ T_a_b[:3, :3], T_a_b[:3, 3] + step[:3])


def motions_of(scenario, seed, reference='B5'):
    run = simulate(scenario, seed)
    return select_motions(associate(run.a, run.b), reference), run.T_a_b


@pytest.mark.parametrize('name', LINEARISE)
def test_derivatives_agree_with_differences(name):
    """Check at the truth of exact motions, where alone all four are the solver's own."""
    rng = np.random.default_rng(3)
    X = random_pose(rng, angle=1.0)
    A = se3.exp_se3(rng.normal(size=(20, 6)) * 0.5)
    B = se3.inverse(X) @ A @ X
    found = LINEARISE[name](X, A, A)
    assert np.abs(found.residual).max() < 1e-12
    for k, step in enumerate(1e-6 * np.eye(6)):
        differences = [
            LINEARISE[name](Y, A, Y @ B @ se3.inverse(Y)).residual
            for Y in (moved(X, step), moved(X, -step))]
        np.testing.assert_allclose(
            (differences[0] - differences[1]) / 2e-6, found.jacobian[:, :, k], atol=1e-7)


@pytest.mark.statistical
@thinned('seeds', 10, 30)
@pytest.mark.parametrize(('solver', 'reference', 'case'), [
    ('dnl', 'B5', 'white'), ('dnl', 'B5', 'mixture'), ('dnl', 'B1', 'walk'),
    ('dnl', 'C10', 'mixture'), ('dnlo', 'B5', 'mixture'), ('park', 'B5', 'white'),
    ('taylor', 'B20', 'walk'), ('ali', 'B5', 'white'), ('park', 'B5', 'offroad'),
    ('dnl', 'B5', 'offroad'),
])
def test_intervals_cover_the_truth(solver, reference, case, seeds):
    if case == 'offroad':
        seeds = 8
    config = CalibrationConfig(solver=solver, reference=reference, dnlo_method='path')
    nees, inside = [], []
    for seed in range(500, 500 + seeds):
        motions, truth = motions_of(CASES[case], seed, reference)
        solution = load_solver(solver)(motions, config)
        covariance = estimate_uncertainty(solution, motions).covariance
        error = error_of(solution.T_a_b, truth)
        nees.append(error @ np.linalg.solve(covariance, error) / 6)
        inside.append(np.abs(error) < 1.96 * np.sqrt(np.diagonal(covariance)))
    # Below one: an inefficient solver's distance from the most likely answer counts in full.
    assert 0.2 < np.mean(nees) < 1.6
    assert np.mean(inside) > 0.88


@pytest.mark.statistical
def test_reference_a_counts_what_all_motions_share():
    """All motions of A begin at one pose, whose error no spread of residuals shows."""
    inside = []
    for seed in range(20):
        motions, truth = motions_of(SCENARIOS['noise'], seed, 'A')
        solution = load_solver('dnl')(motions, CalibrationConfig())
        sigma = np.sqrt(np.diagonal(estimate_uncertainty(solution, motions).covariance))
        inside.append(np.abs(error_of(solution.T_a_b, truth)) < 1.96 * sigma)
    assert np.mean(inside) > 0.9


def test_more_overlap_is_not_more_data():
    """Half the motions of B20 say almost as much as all: their covariances are alike."""
    motions, _ = motions_of(SCENARIOS['offroad'], 1, 'B20')
    every = load_solver('dnl')(motions, CalibrationConfig())
    half = motions.picked(slice(None, None, 2))
    fewer = load_solver('dnl')(half, CalibrationConfig())
    ratio = np.sqrt(np.diagonal(estimate_uncertainty(fewer, half).covariance)
                    / np.diagonal(estimate_uncertainty(every, motions).covariance))
    assert (ratio < 1.4).all()
    assert (ratio > 0.8).all()


@pytest.mark.statistical
@thinned('seeds', 3, 10)
@pytest.mark.parametrize('solver', ['dnl', 'park', 'ali'])
def test_noise_does_not_pass_for_excitation(solver, seeds):
    """On flat ground nothing fixes the height: each direction found must contain it."""
    scenario = with_noise(Scenario(motion=Unicycle(ground=flat)),
                          Noise(white=0.005), Noise(white=0.005))
    for seed in range(seeds):
        motions, _ = motions_of(scenario, seed)
        solution = load_solver(solver)(motions, CalibrationConfig())
        found = estimate_uncertainty(solution, motions)
        assert len(found.unobserved) >= 1
        assert np.sqrt(found.covariance[2, 2]) > 5.0
        assert solver == 'park' or np.sqrt(found.covariance[0, 0]) < 0.5


def test_what_a_solver_cannot_correct_is_counted_and_said():
    scenario = with_noise(SCENARIOS['offroad'], Noise(white=0.002, white_rotation=0.0005),
                          Noise(white=0.002, white_rotation=0.0005, drift=0.03))
    motions, truth = motions_of(scenario, 4)
    solution = load_solver('dnl')(motions, CalibrationConfig())
    found = estimate_uncertainty(solution, motions, CalibrationConfig(solver='dnl'))
    (finding,) = found.findings
    assert finding.code == 'uncorrected'
    assert 'a steady drift' in finding.text
    assert 'dnl cannot correct' in finding.text
    error = error_of(solution.T_a_b, truth)
    assert (np.abs(error) < 3 * np.sqrt(np.diagonal(found.covariance))).all()


@pytest.mark.parametrize('solver', ['dnl', 'park', 'zhuang'])
def test_too_few_poses_for_the_noise_leave_the_residuals(solver):
    run = simulate(SCENARIOS['noise'], 1)
    pairs = associate(run.a, run.b)
    few = PosePairs(pairs.stamps_ns[:8], pairs.poses_a[:8], pairs.poses_b[:8], pairs.summary)
    motions = select_motions(few, 'B1')
    solution = load_solver(solver)(motions, CalibrationConfig())
    covariance = estimate_uncertainty(solution, motions).covariance
    assert np.linalg.eigvalsh(covariance).min() > -1e-9
    assert 1e-3 < np.sqrt(covariance.diagonal()).max() < 20


@pytest.mark.parametrize('solver', ['dnl', 'dnlo', 'ali', 'park', 'taylor', 'zhuang'])
def test_every_result_carries_a_covariance(solver):
    run = simulate(SCENARIOS['mixture'], 2)
    found = calibrate(run.a, run.b, CalibrationConfig(solver=solver)).covariance
    np.testing.assert_allclose(found, found.T)
    assert np.linalg.eigvalsh(found).min() > 0


def test_a_solver_of_its_own_covariance_is_believed():
    motions, truth = motions_of(SCENARIOS['mixture'], 1)
    covariance = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    given = estimate_uncertainty(Solution(truth, 0.0, 1, covariance=covariance), motions)
    np.testing.assert_allclose(given.covariance, covariance, atol=1e-12)
    with pytest.raises(SolverError, match='neither'):
        estimate_uncertainty(Solution(truth, 0.0, 1), motions)
