# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Does ``reference: auto`` choose as well as hindsight would?

    python -m benchmarks.reference_auto [--data DIR] [--seeds 40] [--solvers dnl,dnlo,park]

For each class of noise at its hardest level, over the published runs (with ``--data``, the
folder of the paper's data) and over simulated ones: the median error of the translation with
``auto``, with B1, and with the fixed reference that hindsight finds best for that class and
solver, and what ``auto`` loses against it.
"""

import argparse
from pathlib import Path
import time

import numpy as np

from benchmarks.paper.published import simulation_runs
from benchmarks.paper.tasks import HARDEST
from trajectory_calibration import CalibrationConfig
from trajectory_calibration.assessment.reference_selection import choose_reference
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.simulation import SCENARIOS, simulate
from trajectory_calibration.solvers import load_solver
from trajectory_calibration.time_alignment.pairing import associate, associate_nearest

FIXED = ('A', 'B1', 'B2', 'B3', 'B5', 'B8', 'B10', 'B15', 'B20', 'C5', 'C10')
FIRST_SEED = 20_000


def published(data):
    """Yield class, pose pairs and truth of the published runs."""
    for item in simulation_runs(data):
        if item.level == HARDEST.get(item.kind):
            a, b, T_a_b = item.load()
            yield item.kind, associate_nearest(a, b, max_difference_ns=1_000_000), T_a_b


def simulated(seeds):
    """Yield class, pose pairs and truth of simulated runs."""
    for kind in HARDEST:
        for seed in range(FIRST_SEED, FIRST_SEED + seeds):
            run = simulate(SCENARIOS[kind], seed)
            yield kind, associate(run.a, run.b), run.T_a_b


def error(pairs, solver, reference, T_a_b):
    """Return the error of the translation, metres."""
    motions = select_motions(pairs, reference)
    found = load_solver(solver)(motions, CalibrationConfig(solver=solver)).T_a_b
    return np.linalg.norm(found[:3, 3] - T_a_b[:3, 3])


def judge(source, runs, solvers):
    """Print a row for each class and solver."""
    errors, seconds = {}, {}
    for kind, pairs, T_a_b in runs:
        for solver in solvers:
            start = time.process_time()
            chosen = choose_reference(
                pairs, CalibrationConfig(solver=solver, reference='auto')).reference
            seconds.setdefault((kind, solver), []).append(time.process_time() - start)
            errors.setdefault((kind, solver), []).append(
                [error(pairs, solver, reference, T_a_b) for reference in (chosen, *FIXED)])
    for (kind, solver), found in errors.items():
        auto, *fixed = np.median(found, axis=0)
        best = int(np.argmin(fixed))
        print(f'| {source} | {kind} | {len(found)} | {solver} | {auto:.4f} | '
              f'{fixed[FIXED.index("B1")]:.4f} | {FIXED[best]} {fixed[best]:.4f} | '
              f'{100 * (auto / fixed[best] - 1):+.0f} % | '
              f'{np.median(seconds[kind, solver]):.2f} |', flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path)
    parser.add_argument('--seeds', type=int, default=40)
    parser.add_argument('--solvers', default='dnl,dnlo,park')
    arguments = parser.parse_args()
    solvers = arguments.solvers.split(',')
    print('| runs | class | number | solver | auto, m | B1, m | best with hindsight, m | '
          'auto loses | choice, CPU s |')
    print('|---|---|---|---|---|---|---|---|---|')
    if arguments.data:
        judge('published', published(arguments.data), solvers)
    judge('simulated', simulated(arguments.seeds), solvers)


if __name__ == '__main__':
    main()
