# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What other libraries make of the same motions: accuracy and time, side by side.

    pip install 'trajectory_calibration[benchmark,peers]'
    python -m benchmarks.peers --data ../shared/data

Prints Markdown tables: medians over the published runs (or, without --data, over simulated ones)
of the hardest level of each class, and the published drive 2011_09_30. OpenCV's calibrateHandEye
takes poses, not motions, and forms every pair of them itself; all others get the motions of one
reference. A library that is not installed is left out, and said so.
"""

import argparse
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from time import thread_time

import numpy as np

from benchmarks.paper.environment import describe_machine, describe_versions, in_order
from benchmarks.paper.kitti import paper_pairs
from benchmarks.paper.published import read_kitti, SEQUENCES, simulation_runs
from benchmarks.paper.tasks import HARDEST, published_tasks, SETTINGS, simulated_tasks
from trajectory_calibration import CalibrationConfig, CalibrationError
from trajectory_calibration.assessment.metrics import absolute_errors
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.executor import Executor
from trajectory_calibration.solvers import load_solver
from trajectory_calibration.time_alignment.pairing import associate_by_interpolation

OURS = ('park', 'zhuang', 'dnl', 'dnlo', 'drift_aware')
PACKAGES = {'cv2': 'opencv-python-headless', 'kinhec': 'kinhec'}
SIMULATED_RUNS = 38

# What dnlo takes for an outlier, in the units of kinhec: a residual of sqrt(c), metres or radians.
LIMITS = {'rot_thresh_deg': np.rad2deg(SETTINGS['dnlo_c']**0.5),
          'trans_thresh_mm': 1e3 * SETTINGS['dnlo_c']**0.5}


def own_methods():
    """Return our solvers by name, as functions of the motions."""
    def make(name):
        config = CalibrationConfig(solver=name, **SETTINGS)
        return lambda motions: load_solver(name)(motions, config).T_a_b
    return {name: make(name) for name in OURS}


def opencv_methods():
    """Return the five methods of calibrateHandEye."""
    cv2 = import_module('cv2')

    def make(method):
        def solve(motions):
            a, b = motions.pairs.poses_a, np.linalg.inv(motions.pairs.poses_b)
            R, t = cv2.calibrateHandEye(
                list(a[:, :3, :3]), list(a[:, :3, 3]), list(b[:, :3, :3]), list(b[:, :3, 3]),
                method=method)
            return transform(R, t.ravel())
        return solve
    return {f'OpenCV {name}': make(getattr(cv2, f'CALIB_HAND_EYE_{name.upper()}'))
            for name in ('Tsai', 'Park', 'Horaud', 'Andreff', 'Daniilidis')}


def kinhec_methods():
    """Return the solvers of kinhec for A X = X B, its refinements and its RANSAC."""
    solvers = import_module('kinhec.solvers')

    def plain(solve):
        return lambda motions: solve(motions.A, motions.B)

    def refined(loss):
        return lambda motions: solvers.refine_lm(
            motions.A, motions.B, solvers.park_martin(motions.A, motions.B), loss=loss)

    def ransac(**limits):
        return lambda motions: solvers.ransac_axxb(
            motions.A, motions.B, np.random.default_rng(0), **limits)[0]

    found = {f'kinhec {name}': plain(solve) for name, solve in solvers.AXXB_SOLVERS.items()}
    return found | {'kinhec LM': refined('linear'), 'kinhec Cauchy LM': refined('cauchy'),
                    'kinhec RANSAC': ransac(), 'kinhec RANSAC, limits of dnlo': ransac(**LIMITS)}


def methods():
    """Return every method of what is installed, ours first."""
    found = own_methods()
    for module, build in (('cv2', opencv_methods), ('kinhec', kinhec_methods)):
        if installed(module):
            found |= build()
    return found


def installed(module):
    try:
        return import_module(module) is not None
    except ModuleNotFoundError:
        return False


def transform(R, t):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


def measure(pairs, truth, reference):
    """Return e_at (m), e_aR (deg) and ms of each method; NaN where it gives no rigid motion."""
    motions = select_motions(pairs, reference)
    found = {}
    for name, solve in methods().items():
        start = thread_time()
        try:
            T_a_b = np.asarray(solve(motions), dtype=float)
        except (CalibrationError, np.linalg.LinAlgError, ValueError):
            T_a_b = np.full((4, 4), np.nan)
        ms = 1e3 * (thread_time() - start)
        errors = (np.nan, np.nan)
        if np.isfinite(T_a_b).all():
            distance = absolute_errors(T_a_b, truth)
            errors = distance.e_at, np.rad2deg(distance.e_aR)
        found[name] = (*errors, ms)
    return found


def measure_run(item):
    task, reference = item
    a, b, truth = task.load()
    return measure(associate_by_interpolation(a, b, max_gap_ns=None), truth, reference)


def measure_drive(item):
    data, sequence, reference = item
    drive = read_kitti(data, sequence)
    return measure(paper_pairs(drive.a, drive.b), drive.T_a_b_corrected, reference)


def show(name, found):
    """Print medians over runs of each method."""
    print(f'\n{name}, medians of {len(found)}:\n')
    print('| method | e_at mm | e_aR ° | ms | no answer |\n|---|---|---|---|---|')
    for method in found[0]:
        values = np.array([run[method] for run in found])
        good = np.isfinite(values[:, 0])
        e_at, e_aR, ms = np.median(values[good], axis=0) if good.any() else [np.nan] * 3
        print(f'| {method} | {1e3 * e_at:.2f} | {e_aR:.3f} | {ms:.1f} | {np.sum(~good)} |',
              flush=True)


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path, help='folder of the published data')
    parser.add_argument('--reference', default='B5', help='of the motions (default: B5)')
    parser.add_argument('--jobs', type=int, help='processes (default: one per core)')
    arguments = parser.parse_args()
    names = [f'{PACKAGES[module]} {version(PACKAGES[module])}' if installed(module)
             else f'{PACKAGES[module]} is not installed' for module in PACKAGES]
    print(f'{describe_machine()}; {describe_versions()}; {", ".join(names)}; '
          f'reference {arguments.reference}')
    tasks = (simulated_tasks(SIMULATED_RUNS, 0, ()) if arguments.data is None
             else published_tasks(simulation_runs(arguments.data), ()))
    executor = Executor(processes=arguments.jobs)
    for kind, level in HARDEST.items():
        items = [(task, arguments.reference) for task in tasks
                 if (task.kind, task.level) == (kind, level)]
        title = kind if kind == 'mixture' else f'{kind} {level:g}'
        show(f'{items[0][0].source} {title}', list(in_order(executor, measure_run, items)))
    if arguments.data is not None:
        items = [(arguments.data, SEQUENCES[0], arguments.reference)]
        show(SEQUENCES[0], list(in_order(executor, measure_drive, items)))


if __name__ == '__main__':
    main()
