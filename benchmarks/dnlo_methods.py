# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The three ways to a minimum of dnlo, side by side: cost, error against the truth, time.

    python -m benchmarks.dnlo_methods --data ../shared/data

Prints two Markdown tables: both KITTI drives with c = 1e-4, and the published simulations with
c = 0.01.
"""

import argparse
from collections import defaultdict
from pathlib import Path
import time

import numpy as np

from benchmarks.paper.kitti import paper_pairs, PUBLISHED_C, STATED_C
from benchmarks.paper.published import read_kitti, SEQUENCES, simulation_runs
from trajectory_calibration import CalibrationConfig
from trajectory_calibration.assessment.metrics import absolute_errors
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.solvers import load_solver
from trajectory_calibration.time_alignment.pairing import associate_by_interpolation

METHODS = ('ipopt', 'path', 'alternating', 'auto')
REFERENCES = ('B1', 'B5', 'B10', 'C5', 'C10')


def solve(motions, truth, c):
    """Return, by method, cost, e_at (m), e_aR (degrees), milliseconds."""
    found = {}
    for method in METHODS:
        config = CalibrationConfig(dnlo_c=c, dnlo_method=method)
        load_solver('dnlo')(motions, config)
        start = time.perf_counter()
        solution = load_solver('dnlo')(motions, config)
        ms = (time.perf_counter() - start) * 1e3
        error = absolute_errors(solution.T_a_b, truth)
        found[method] = solution.cost, error.e_at, np.rad2deg(error.e_aR), ms
    return found


def print_drives(data):
    """Print cost, errors and time of every method on the KITTI drives."""
    print('| drive | reference | ' + ' | '.join(METHODS) + ' |')
    print('|---|---|' + '---|' * len(METHODS))
    for sequence in SEQUENCES:
        drive = read_kitti(data, sequence)
        pairs = paper_pairs(drive.a, drive.b)
        for reference in REFERENCES:
            found = solve(select_motions(pairs, reference), drive.T_a_b_file, PUBLISHED_C)
            print(f'| {sequence[:10]} | {reference} | ' + ' | '.join(
                f'{cost:.5g}; {e_at:.3f} m {e_aR:.3f}°; {ms:.0f} ms'
                for cost, e_at, e_aR, ms in found.values()) + ' |', flush=True)


def print_simulations(data):
    """Print how often each method's cost is lower than Ipopt's, and the errors' mean ratio."""
    errors, costs = defaultdict(list), defaultdict(list)
    for run in simulation_runs(data):
        a, b, truth = run.load()
        pairs = associate_by_interpolation(a, b, max_gap_ns=None)
        for reference in REFERENCES:
            found = solve(select_motions(pairs, reference), truth, STATED_C)
            for method, (cost, e_at, e_aR, _) in found.items():
                errors[run.kind, run.level, reference, method].append((e_at, e_aR))
                costs[method].append(cost)
    cost = {method: np.array(values) for method, values in costs.items()}
    conditions = sorted({key[:-1] for key in errors})
    median = {key: np.median(values, axis=0) for key, values in errors.items()}
    # Where the error is zero but for rounding, a ratio says nothing.
    told = [key for key in conditions if (median[(*key, 'ipopt')] > 1e-6).all()]
    print('\n| method | cost lower than ipopt | cost higher | median e_at over that of ipopt, '
          'geometric mean (range) | the same of e_aR |\n|---|---|---|---|---|')
    for method in METHODS:
        lower = np.mean(cost[method] < cost['ipopt'] * (1 - 1e-3) - 1e-9)
        higher = np.mean(cost[method] > cost['ipopt'] * (1 + 1e-3) + 1e-9)
        ratio = np.array([median[(*key, method)] / median[(*key, 'ipopt')] for key in told])
        columns = ' | '.join(
            f'{np.exp(np.mean(np.log(np.maximum(r, 1e-3)))):.3f} ({r.min():.2f} - {r.max():.2f})'
            for r in ratio.T)
        print(f'| {method} | {lower:.1%} | {higher:.1%} | {columns} |')
    print(f'\n{len(cost["ipopt"])} calibrations, {len(told)} of {len(conditions)} conditions '
          'with an error above 1e-6')


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path, required=True)
    data = parser.parse_args().data
    print_drives(data)
    print_simulations(data)


if __name__ == '__main__':
    main()
