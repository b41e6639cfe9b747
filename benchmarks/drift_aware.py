# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The drift-aware solver against its targets.

    python -m benchmarks.drift_aware --data ../shared/data [--seeds 40] [--sizes 2343,10000]
    python -m benchmarks.drift_aware --only-published
    python -m benchmarks.drift_aware --only-simulated [--seeds 40] [--first-seed 1000]
    python -m benchmarks.drift_aware --only-times [--sizes 10000,1000000] [--noise white]

Prints Markdown tables: the published runs and drives; what the answers of a drive scatter by where
a twentieth of b is left out, each in turn; simulated pairs that the published data do
not have, with the normalised squared error of the extrinsic (NEES / 6, one where the covariance
is right), the share of the truth inside 95 % intervals and the warnings that short and long
motions disagree, then the same for the package's scenarios, which drift steadily; the bias of the
scale under pure white noise; seconds of processor time and the peak memory of the process, its
drive included. A million poses take two minutes for each kind of noise. Set OMP_NUM_THREADS=1.
"""

import argparse
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
import resource
import time

import numpy as np

from benchmarks.paper.published import read_kitti, SEQUENCES, simulation_runs
from benchmarks.paper.tasks import HARDEST
from trajectory_calibration import calibrate, CalibrationConfig, Trajectory
from trajectory_calibration.assessment.metrics import absolute_errors
from trajectory_calibration.geometry import se3
from trajectory_calibration.simulation import (
    Noise,
    peaks,
    Scenario,
    SCENARIOS,
    simulate,
    Unicycle,
    Wander,
    with_noise,
)
from trajectory_calibration.solvers.drift_aware.solver import solve_pairs
from trajectory_calibration.time_alignment.pairing import associate, associate_nearest

TERMS = ('scale', 'systematic_drift', 'time_offset')
AUTO = dict.fromkeys(TERMS, 'auto')
SCALE_ONLY = {**dict.fromkeys(TERMS, 'fixed'), 'scale': 'estimate'}

# Metres and degrees that are asked for at the hardest level of each class.
PUBLISHED = {
    'mixture': (0.0085, 0.25),
    'outliers': (0.0005, 0.26),
    'drift': (0.001, 0.26),
    'noise': (0.0073, 0.31),
}

# Of which one is left out.
PARTS = 20

_SLAM = Noise(white=0.005, white_rotation=0.003, walk=0.01, walk_rotation=0.001, jumps=3)
SIMULATED = {
    'white, 3-D': (Wander(3.0, 0.4, 1.0, 0.3), 30.0, 10.0, (
        Noise(white=0.01, white_rotation=0.01),) * 2),
    'walk, 3-D': (Wander(5.0, 0.3, 1.0, 0.2), 40.0, 10.0, (
        Noise(walk=0.01, walk_rotation=0.002),) * 2),
    'all, 3-D, 5 Hz': (Wander(), 60.0, 5.0, (_SLAM, _SLAM)),
    'hand-held, 30 Hz': (Wander(0.8, 0.5, 0.8, 0.5), 20.0, 30.0, (
        Noise(white=0.01, white_rotation=0.01),) * 2),
    'vehicle on peaks': (Unicycle(3.0, 0.8, 1.5, peaks), 30.0, 10.0, (
        replace(_SLAM, white=0.01, jumps=2), replace(_SLAM, white=0.01, jumps=2))),
    'unequal sensors': (Wander(), 60.0, 5.0, (
        Noise(white=0.002, white_rotation=0.001, walk=0.005),
        Noise(white=0.02, white_rotation=0.01, walk=0.005, jumps=2))),
    'scale 1.03': (Wander(), 60.0, 5.0, (
        Noise(white=0.01, white_rotation=0.005, walk=0.01),
        Noise(white=0.01, white_rotation=0.005, walk=0.01, scale=1.03))),
}
# Noise of both sensors, and the scale of b. Jumps: one of them in a thousand poses.
DRIVES = {
    'white': (Noise(white=0.01, white_rotation=0.003), 1.0),
    'walk': (Noise(walk=0.01, walk_rotation=0.001), 1.0),
    'white, walk': (
        Noise(white=0.01, white_rotation=0.003, walk=0.005, walk_rotation=0.0005), 1.0),
    'white, walk, jumps, scale': (
        Noise(white=0.01, white_rotation=0.003, walk=0.005, walk_rotation=0.0005, jumps=1), 1.02),
    'white, walk, drift': (
        Noise(white=0.01, white_rotation=0.003, walk=0.005, walk_rotation=0.0005, drift=0.01),
        1.0),
}


def normalised_square(solution, T_a_b):
    d = se3.step_between(solution.T_a_b, T_a_b)
    return d @ np.linalg.solve(solution.covariance, d) / 6


def published_runs(data):
    print('| class | median e_at, m | target | median e_aR, deg | target |\n|---|---|---|---|---|')
    runs = simulation_runs(data)
    for kind, (metres, degrees) in PUBLISHED.items():
        found = []
        for run in runs:
            if (run.kind, run.level) != (kind, HARDEST[kind]):
                continue
            a, b, T_a_b = run.load()
            pairs = associate_nearest(a, b, max_difference_ns=1_000_000)
            error = absolute_errors(solve_pairs(pairs, AUTO).T_a_b, T_a_b)
            found.append([error.e_at, np.rad2deg(error.e_aR)])
        at, aR = np.median(found, axis=0)
        title = kind if kind == 'mixture' else f'{kind} {HARDEST[kind]:g}'
        print(f'| {title} | {at:.4f} | {metres} | {aR:.3f} | {degrees} |')


def published_drives(data):
    print('\n| drive | pairs | e_at, m | e_aR, deg | corrected truth | scale | NEES / 6 | CPU, s |'
          '\n|---|---|---|---|---|---|---|---|')
    for sequence in reversed(SEQUENCES):
        drive = read_kitti(data, sequence)
        both = drive.a, drive.b
        interpolated = associate(*both, CalibrationConfig(association='interpolate'))
        coinciding = associate_nearest(*both, max_difference_ns=12_000_000)
        for name, solve, given, poses in (
                ('calibrate()', calibrate, both, None),
                ('interpolated', solve_pairs, (interpolated, AUTO), len(interpolated)),
                ('coinciding', solve_pairs, (coinciding, AUTO), len(coinciding))):
            start = time.process_time()
            solution = solve(*given)
            seconds = time.process_time() - start
            error = absolute_errors(solution.T_a_b, drive.T_a_b_file)
            beside = ''
            if drive.T_a_b_corrected is not drive.T_a_b_file:
                corrected = absolute_errors(solution.T_a_b, drive.T_a_b_corrected)
                beside = f'{corrected.e_at:.4f} m, {np.rad2deg(corrected.e_aR):.3f} deg'
            print(f'| {sequence[:10]}, {name} | {poses or solution.poses} | {error.e_at:.4f} | '
                  f'{np.rad2deg(error.e_aR):.3f} | {beside} | {solution.scale:.4f} | '
                  f'{normalised_square(solution, drive.T_a_b_corrected):.1f} | {seconds:.2f} |')


def published_parts(data):
    print('\n| drive without a twentieth | e_at, m | e_aR, deg | scale | a drift instead |'
          '\n|---|---|---|---|---|')
    for sequence in reversed(SEQUENCES):
        drive = read_kitti(data, sequence)
        found, drifts = [], 0
        for left_out in np.array_split(np.arange(len(drive.b)), PARTS):
            stamps_ns, poses = (
                np.delete(values, left_out, axis=0)
                for values in (drive.b.stamps_ns, drive.b.poses))
            result = calibrate(drive.a, Trajectory(stamps_ns, poses))
            error = result.absolute_errors(drive.T_a_b_corrected)
            found.append([error.e_at, np.rad2deg(error.e_aR), result.scale])
            drifts += any('drifts steadily' in text for text in result.warnings)
        low, middle, high = np.percentile(found, [25, 50, 75], axis=0)
        columns = [f'{middle[k]:.{digits}f} ({low[k]:.{digits}f} to {high[k]:.{digits}f})'
                   for k, digits in enumerate((3, 3, 4))]
        print(f'| {sequence[:10]} | {" | ".join(columns)} | {drifts} of {PARTS} |', flush=True)


def drawn(motion, duration, rate, noise, seed):
    scenario = with_noise(Scenario(duration, motion), *noise)
    pair = simulate(replace(scenario, a=replace(scenario.a, rate=rate),
                            b=replace(scenario.b, rate=rate)), seed)
    return associate_nearest(pair.a, pair.b, max_difference_ns=1_000_000), pair.T_a_b


def drawn_scenario(name, seed):
    pair = simulate(SCENARIOS[name], seed)
    return associate(pair.a, pair.b), pair.T_a_b


def simulated_pairs(seeds):
    print('\n| simulated | poses | median e_at, m | e_aR, deg | NEES / 6 | largest | coverage | '
          'lags disagree |\n|---|---|---|---|---|---|---|---|')
    cases = {name: partial(drawn, *setting) for name, setting in SIMULATED.items()}
    cases.update((name, partial(drawn_scenario, name))
                 for name in ('offroad', 'road', 'drone', 'handheld'))
    for name, draw in cases.items():
        errors, squares, inside, disagree = [], [], [], 0
        for seed in seeds:
            pairs, T_a_b = draw(seed)
            solution = solve_pairs(pairs, AUTO)
            d = se3.step_between(solution.T_a_b, T_a_b)
            errors.append([np.linalg.norm(d[:3]), np.rad2deg(np.linalg.norm(d[3:]))])
            squares.append(normalised_square(solution, T_a_b))
            inside.append(np.abs(d) < 1.96 * np.sqrt(np.diag(solution.covariance)))
            disagree += any('motions disagree' in text for text in solution.warnings)
        at, aR = np.median(errors, axis=0)
        print(f'| {name} | {len(pairs)} | {at:.4f} | {aR:.3f} | {np.mean(squares):.2f} | '
              f'{max(squares):.1f} | {np.mean(inside):.3f} | {disagree} of {len(seeds)} |',
              flush=True)


def scale_bias(seeds):
    print('\n| white noise, m | rate, Hz | mean of scale - 1 | standard error |'
          '\n|---|---|---|---|')
    for white, rate in ((0.05, 30.0), (0.01, 5.0)):
        noise = (Noise(white=white, white_rotation=0.02),) * 2
        found = [solve_pairs(drawn(Wander(0.8, 0.5, 0.8, 0.4), 10.0, rate, noise, seed)[0],
                             SCALE_ONLY).scale - 1 for seed in range(seeds)]
        print(f'| {white} | {rate:g} | {np.mean(found):+.5f} | '
              f'{np.std(found) / np.sqrt(seeds):.5f} |', flush=True)


def timed(name, poses):
    """Print one row; in a process of its own, whose peak memory is its own."""
    noise, scale = DRIVES[name]
    if noise.jumps:
        noise = replace(noise, jumps=poses // 1000)
    pairs, _ = drawn(Wander(), (poses - 1) / 10, 10.0, (noise, replace(noise, scale=scale)), 0)
    start = time.process_time()
    solution = solve_pairs(pairs, AUTO)
    seconds = time.process_time() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    settled = 'no' if any('before it settled' in text for text in solution.warnings) else 'yes'
    print(f'| {name} | {poses} | {seconds:.2f} | {1e6 * seconds / poses:.0f} | '
          f'{solution.iterations} | {settled} | {peak:.2f} |', flush=True)


def speed(names, sizes):
    print('\n| noise | poses | CPU, s | CPU a pose, us | iterations on all poses | settled | '
          'peak memory, GiB |\n|---|---|---|---|---|---|---|', flush=True)
    for name in names:
        for poses in sizes:
            process = get_context('spawn').Process(target=timed, args=(name, poses))
            process.start()
            process.join()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path, default=Path('../shared/data'))
    parser.add_argument('--seeds', type=int, default=40)
    parser.add_argument('--first-seed', type=int, default=0)
    parser.add_argument('--scale-seeds', type=int, default=200)
    parser.add_argument('--sizes', default='2343,10000,100000')
    parser.add_argument('--only-published', action='store_true')
    parser.add_argument('--only-simulated', action='store_true')
    parser.add_argument('--only-times', action='store_true')
    parser.add_argument('--noise', action='append', choices=DRIVES, help='of the timed drives')
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    if options.only_simulated:
        simulated_pairs(seeds)
        return
    if not options.only_times:
        published_runs(options.data)
        published_drives(options.data)
        published_parts(options.data)
        if options.only_published:
            return
        simulated_pairs(seeds)
        scale_bias(options.scale_seeds)
    speed(options.noise or DRIVES, [int(size) for size in options.sizes.split(',')])


if __name__ == '__main__':
    main()
