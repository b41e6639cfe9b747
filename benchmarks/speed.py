# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""How long each solver takes, on the longer published drive and as the drive grows.

    python -m benchmarks.speed --data ../shared/data

Prints a Markdown table: median and range of ten solves on one thread, association and selection
of motions not counted. The drive is 2011_10_03 at B5 (2,338 motions); the growing drives are
simulated, and have no targets. Set OMP_NUM_THREADS=1, or the linear algebra takes both cores.
"""

import argparse
from pathlib import Path
import statistics
import time

import numpy as np

from benchmarks.paper.environment import describe_machine, describe_versions
from benchmarks.paper.kitti import paper_pairs
from benchmarks.paper.published import read_kitti, SEQUENCES
from trajectory_calibration import CalibrationConfig, Trajectory
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.geometry import se3
from trajectory_calibration.solvers import load_solver
from trajectory_calibration.time_alignment.pairing import associate_by_interpolation

SOLVERS = {
    'park': {}, 'taylor': {}, 'zhuang': {}, 'ali': {}, 'dnl': {}, 'dnlo': {},
    'dnlo, ipopt': {'dnlo_method': 'ipopt'},
}
# Milliseconds on the published drive.
TARGETS_MS = {'park': 5, 'taylor': 5, 'zhuang': 200, 'dnl': 10, 'dnlo': 15}
PUBLISHED = '2011_10_03, B5'
REPEATS = 10


def published_drive(data):
    """Return the motions of 2011_10_03 at B5, poses of a interpolated everywhere."""
    return select_motions(paper_pairs(read_kitti(data, SEQUENCES[1])), 'B5')


def simulated_drive(poses):
    """Return the motions at B5 of a noisy random drive."""
    rng = np.random.default_rng(0)
    steps = se3.exp_se3(rng.normal(size=(poses, 6)) * [0.1, 0.01, 0.01, 0.02, 0.02, 0.1])
    body = np.empty((poses, 4, 4))
    body[0] = np.eye(4)
    for k in range(1, poses):
        body[k] = body[k - 1] @ steps[k]
    body[:, :3, :3] = se3.nearest_rotation(body[:, :3, :3])
    stamps = np.arange(poses) * 100_000_000
    noise = se3.exp_se3(rng.normal(size=(2, poses, 6)) * 0.002)
    X = se3.exp_se3([0.3, -0.1, 0.2, 0.5, 1.0, -0.5])
    a, b = Trajectory(stamps, body @ noise[0]), Trajectory(stamps, body @ X @ noise[1])
    return select_motions(associate_by_interpolation(a, b, max_gap_ns=None), 'B5')


def times_ms(name, motions, settings):
    """Return the milliseconds of ten solves after one that loads and builds what is kept."""
    solve, config = load_solver(name), CalibrationConfig(**settings)
    solve(motions, config)
    found = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        solve(motions, config)
        found.append((time.perf_counter() - start) * 1e3)
    return found


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path, required=True)
    parser.add_argument('--poses', type=int, nargs='*', default=[1_000, 10_000, 100_000])
    arguments = parser.parse_args()
    drives = {PUBLISHED: published_drive(arguments.data)}
    drives.update((f'simulated, {n:,} poses, B5', simulated_drive(n)) for n in arguments.poses)
    print(f'{describe_machine()}; {describe_versions()}\n')
    print('| drive | motions | solver | median ms | min - max ms | target ms |\n'
          '|---|---|---|---|---|---|')
    for drive, motions in drives.items():
        for label, settings in SOLVERS.items():
            if 'ipopt' in label and len(motions) > 5_000:
                continue  # minutes: the reason for the closed form
            ms = times_ms(label.split(',')[0], motions, settings)
            target = TARGETS_MS.get(label, '') if drive == PUBLISHED else ''
            print(f'| {drive} | {len(motions):,} | {label} | {statistics.median(ms):.1f} | '
                  f'{min(ms):.1f} - {max(ms):.1f} | {target} |'.replace('|  |', '| |'), flush=True)


if __name__ == '__main__':
    main()
