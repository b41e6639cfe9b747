# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Do the covariances hold? Errors against the truth over many simulated runs.

    python -m benchmarks.coverage [--seeds 100] [--solvers dnl,dnlo,park] [--references B1,B5,B20]

For each kind of noise, solver and reference: the mean normalised squared error per degree of
freedom (NEES / 6, one if the covariance is right, more if it is too small) and the share of the
errors of single components within 1.96 standard deviations (0.95 if it is right). Runs whose
motion leaves a direction open are counted, and left out of both.
"""

import argparse

import numpy as np

from trajectory_calibration import CalibrationConfig
from trajectory_calibration.assessment.covariance import estimate_uncertainty
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.geometry import se3
from trajectory_calibration.simulation import Noise, Scenario, SCENARIOS, simulate, with_noise
from trajectory_calibration.solvers import load_solver
from trajectory_calibration.time_alignment.pairing import associate

WALK = Noise(white=0.001, walk=0.02, walk_rotation=0.01)
COLOURED = Noise(white=0.002, coloured=0.01, coloured_rotation=0.005, coloured_time=1.0)
CASES = {
    'white, 5 mm': with_noise(Scenario(), Noise(white=0.005), Noise(white=0.005)),
    'white, 10 mm': SCENARIOS['noise'],
    'walk': with_noise(Scenario(), WALK, WALK),
    'coloured, 60 s': with_noise(Scenario(60.0), COLOURED, COLOURED),
    'jumps': SCENARIOS['outliers'],
    'mixture': SCENARIOS['mixture'],
    'constant drift': SCENARIOS['drift'],
    'off-road SLAM': SCENARIOS['offroad'],
}
FIRST_SEED = 10_000


def judge(scenario, solver, reference, seeds):
    """Return NEES per degree of freedom, coverage, and how many runs leave a direction open."""
    config = CalibrationConfig(solver=solver, reference=reference, dnlo_method='path')
    nees, inside, unobserved = [], [], 0
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        run = simulate(scenario, seed)
        motions = select_motions(associate(run.a, run.b), reference)
        solution = load_solver(solver)(motions, config)
        found = estimate_uncertainty(solution, motions)
        if len(found.unobserved):
            unobserved += 1
            continue
        error = se3.step_between(solution.T_a_b, run.T_a_b)
        nees.append(error @ np.linalg.solve(found.covariance, error) / 6)
        inside.append(np.abs(error) < 1.96 * np.sqrt(np.diagonal(found.covariance)))
    return np.mean(nees), np.mean(inside), unobserved


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seeds', type=int, default=100)
    parser.add_argument('--solvers', default='dnl,dnlo,park')
    parser.add_argument('--references', default='B1,B5,B20')
    arguments = parser.parse_args()
    print('| noise | solver | reference | NEES / 6 | coverage | open |')
    print('|---|---|---|---|---|---|')
    for name, scenario in CASES.items():
        # The long drives have ten times the poses.
        seeds = arguments.seeds if scenario.duration < 30 else max(arguments.seeds // 5, 2)
        for solver in arguments.solvers.split(','):
            for reference in arguments.references.split(','):
                nees, inside, unobserved = judge(scenario, solver, reference, seeds)
                print(f'| {name} | {solver} | {reference} | {nees:.2f} | {inside:.3f} | '
                      f'{unobserved} of {seeds} |', flush=True)


if __name__ == '__main__':
    main()
