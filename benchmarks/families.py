# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Do the stated deviations hold on vehicles that the package's own simulator does not know?

    python -m benchmarks.families [--seeds 40] [--first-seed 0] [--only car] [--jobs 1]
                                  [--seconds 80] [--false-alarm 0.001]

The drives are those of ``drives.py`` beside this file. For each family: the share of the truth
within 1.96 stated deviations, by axis of a and in all (0.95 is right), NEES / 6 (one is right),
the share of runs with an axis beyond five deviations and no finding that says so, medians of the
errors, processor time. Axes that the answer calls unobservable are left out of all of these;
``open`` counts them. A family on flat ground must leave some open, any other none. Below the
table: how many of these sound drives have a serious finding, but for open directions.
"""

import argparse
from collections import Counter
from dataclasses import replace
from functools import partial
from multiprocessing import Pool
import time

import numpy as np

from benchmarks.drives import FAMILIES, make
from trajectory_calibration import calibrate, CalibrationError, Trajectory
from trajectory_calibration.geometry import chi_squared, se3

AXES = ('x', 'y', 'z', 'roll', 'pitch', 'yaw')


def trajectory(recorded, name):
    stamps, poses = recorded
    return Trajectory(np.rint((1.6e9 + stamps) * 1e9).astype(np.int64), poses, sensor_frame=name)


def shortened(t, seconds):
    """Return the first so many seconds of a trajectory."""
    kept = t.stamps_ns < t.stamps_ns[0] + seconds * 1e9
    return replace(t, stamps_ns=t.stamps_ns[kept], poses=t.poses[kept])


def says_something(result):
    """Tell whether a finding above a note stands in the result."""
    findings = getattr(result, 'findings', None)
    if findings is None:
        return bool(result.warnings)
    from trajectory_calibration.data.findings import CATALOGUE
    return any(CATALOGUE[finding.code][0] != 'note' for finding in findings)


def measure(item, duration_s=np.inf, false_alarm=chi_squared.FALSE_ALARM):
    """Return one run as a dictionary, or the text of its refusal."""
    name, seed = item
    chi_squared.FALSE_ALARM = false_alarm
    run = make(name, seed)
    a, b = (shortened(trajectory(recorded, name), duration_s)
            for recorded, name in ((run.a, 'a'), (run.b, 'b')))
    start = time.process_time()
    try:
        result = calibrate(a, b)
    except CalibrationError as error:
        return str(error)
    seconds = time.process_time() - start
    d = se3.step_between(run.T_a_b, result.T_a_b)
    status = list(result.observability.to_dict()['status'].values())
    told = np.array([word != 'unobserved' for word in status])
    P = result.covariance[np.ix_(told, told)]
    return {
        'z': np.where(told, d / np.sqrt(np.diag(result.covariance)), np.nan),
        'nees': d[told] @ np.linalg.solve(P, d[told]) / max(told.sum(), 1),
        'errors': (np.linalg.norm(d[:3][told[:3]]), np.rad2deg(np.linalg.norm(d[3:][told[3:]]))),
        'open': not told.all(), 'said': says_something(result), 'cpu': seconds,
        'scale': result.scale,
        'serious': {found.code for found in result.findings if found.level == 'serious'},
    }


def row(name, runs):
    """Return one line of the table."""
    good = [run for run in runs if isinstance(run, dict)]
    if not good:
        return f'| {name} | {len(runs)} |' + ' |' * 11
    z = np.array([run['z'] for run in good])
    inside = np.where(np.isnan(z), np.nan, np.abs(z) < 1.96)
    nees = np.array([run['nees'] for run in good])
    beyond = [bool(np.nanmax(np.abs(run['z'])) > 5) for run in good]
    silent = np.mean([far and not run['said'] for far, run in zip(beyond, good, strict=True)])
    e_at, e_aR = np.median([run['errors'] for run in good], axis=0)
    return (
        f'| {name} | {len(runs) - len(good)} of {len(runs)} | {sum(run["open"] for run in good)} '
        f'| {_mean(inside[:, :3])} | {_mean(inside[:, 3:])} | '
        + ' '.join(_mean(column, 2) for column in inside.T)
        + f' | {np.mean(nees):.2f} | {np.median(nees):.2f} | {np.mean(nees > 3):.1%} | '
        f'{np.mean(beyond):.1%} | {silent:.1%} | {e_at:.4f} | {e_aR:.3f} | '
        f'{np.median([run["cpu"] for run in good]):.2f} |')


def _mean(values, digits=3):
    """Write the mean of what is not NaN; a dash where nothing is left."""
    return '-' if np.isnan(values).all() else f'{np.nanmean(values):.{digits}f}'


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seeds', type=int, default=40)
    parser.add_argument('--first-seed', type=int, default=0)
    parser.add_argument('--only', default='', help='part of the names of the families')
    parser.add_argument('--jobs', type=int, default=1)
    parser.add_argument('--runs', action='store_true', help='print every run')
    parser.add_argument('--seconds', type=float, default=np.inf, help='of each drive, at most')
    parser.add_argument('--false-alarm', type=float, default=chi_squared.FALSE_ALARM)
    arguments = parser.parse_args()
    measured = partial(
        measure, duration_s=arguments.seconds, false_alarm=arguments.false_alarm)
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    print('| family | refused | open | coverage, translation | rotation | by axis (x y z, roll '
          'pitch yaw) | NEES / 6 mean | median | > 3 | beyond 5 | without a finding | '
          'median e_at, m | e_aR, deg | CPU, s |')
    print('|---' * 14 + '|')
    everything = []
    with Pool(arguments.jobs) as pool:
        for name in FAMILIES:
            if arguments.only not in name:
                continue
            items = [(name, seed) for seed in seeds]
            runs = list((pool.imap if arguments.jobs > 1 else map)(measured, items))
            everything += runs
            print(row(name, runs), flush=True)
            if arguments.runs:
                for seed, run in zip(seeds, runs, strict=True):
                    print(seed, run if isinstance(run, str) else
                          (run['z'].round(1), round(run['nees'], 2), run['scale']))
    print(row('all', everything))
    answered = [run['serious'] for run in everything if isinstance(run, dict)]
    alarms = Counter(code for codes in answered for code in codes - {'direction-unobserved'})
    print(f'\nSerious findings in {len(answered)} sound drives: {dict(alarms) or "none"}')


if __name__ == '__main__':
    main()
