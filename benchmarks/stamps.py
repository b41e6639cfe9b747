# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What stamps that do not coincide, and clocks that drift, cost.

    python -m benchmarks.stamps [--seeds 12]

Prints two Markdown tables, medians over the seeds with NEES / 6 (one where the covariance is
right) as the mean: poses of b half-way between those of a, by the geodesic and by what the
package does; and a faster clock, without and with correction. Set OMP_NUM_THREADS=1.
"""

import argparse
from dataclasses import replace

import numpy as np

from trajectory_calibration import calibrate, CalibrationConfig, Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.interpolation import left_of
from trajectory_calibration.simulation import Noise, SCENARIOS, simulate, with_noise
from trajectory_calibration.time_alignment import align as matching
from trajectory_calibration.time_alignment import pairing as association
from trajectory_calibration.time_alignment.clock_offset import ClockCorrection

CUBIC, SYNCHRONISE = association.interpolate, matching.synchronise
NOISES = {
    '0.1 mm, 0.1 mrad': Noise(white=1e-4, white_rotation=1e-4),
    '5 mm, 1 mrad': Noise(white=0.005, white_rotation=0.001),
    'SLAM': SCENARIOS['offroad'].a.noise,
    'SLAM, 10 jumps': replace(SCENARIOS['offroad'].a.noise, jumps=10),
}


def geodesic(stamps_ns, poses, at_ns, **_):
    left = left_of(stamps_ns, at_ns)
    fraction = (at_ns - stamps_ns[left]) / (stamps_ns[left + 1] - stamps_ns[left])
    return se3.geodesic(poses[left], poses[left + 1], fraction)


def constant_clock(*given):
    clock = SYNCHRONISE(*given)
    return ClockCorrection(clock.offset_s)


def judge(runs):
    """Return the medians of e_at (m), e_aR (deg) and |scale - 1|, and the mean of NEES / 6."""
    errors, squares = [], []
    for a, b, truth in runs:
        result = calibrate(a, b, CalibrationConfig(allow_unobserved=True))
        error = result.absolute_errors(truth)
        errors.append([error.e_at, np.rad2deg(error.e_aR), abs(result.scale - 1)])
        step = se3.step_between(truth, result.T_a_b)
        squares.append(step @ np.linalg.solve(result.covariance, step) / 6)
    return (*np.median(errors, axis=0), np.mean(squares))


def half_a_step_apart(seeds):
    print('| motion | Hz | noise | geodesic: e_at, m | e_aR, deg | scale off by | NEES / 6 '
          '| cubic: e_at, m | e_aR, deg | scale off by | NEES / 6 |\n' + '|---' * 11 + '|')
    for motion in ('offroad', 'drone', 'handheld'):
        for rate in (10.0, 3.0):
            for name, noise in NOISES.items():
                scenario = with_noise(SCENARIOS[motion], noise, noise)
                scenario = replace(scenario, a=replace(scenario.a, rate=rate),
                                   b=replace(scenario.b, rate=2 * rate))
                runs = []
                for seed in seeds:
                    run = simulate(scenario, seed)
                    between = Trajectory(run.b.stamps_ns[1::2], run.b.poses[1::2], 'map', 'b')
                    runs.append((run.a, between, run.T_a_b))
                cells = []
                for association.interpolate in (geodesic, CUBIC):
                    e_at, e_aR, scale, square = judge(runs)
                    cells.append(f'{e_at:.5f} | {e_aR:.4f} | {scale:.2%} | {square:.2f}')
                print(f'| {motion} | {rate:g} | {name} | {" | ".join(cells)} |', flush=True)


def drifting_clocks(seeds):
    print('\n| motion | minutes | clock of b, ppm | not corrected: e_at, m | e_aR, deg | NEES / 6 '
          '| corrected: e_at, m | e_aR, deg | NEES / 6 |\n' + '|---' * 9 + '|')
    for motion in ('offroad', 'drone'):
        for drift in (0.0, 2e-5, 1e-4):
            scenario = replace(SCENARIOS[motion], duration=1800.0)
            scenario = replace(scenario, b=replace(scenario.b, clock_drift=drift))
            runs = [(run.a, run.b, run.T_a_b) for run in (simulate(scenario, k) for k in seeds)]
            cells = []
            for matching.synchronise in (constant_clock, SYNCHRONISE):
                e_at, e_aR, _, square = judge(runs)
                cells.append(f'{e_at:.5f} | {e_aR:.4f} | {square:.2f}')
            print(f'| {motion} | 30 | {1e6 * drift:g} | {" | ".join(cells)} |', flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split('\n', maxsplit=1)[0])
    parser.add_argument('--seeds', type=int, default=12)
    arguments = parser.parse_args()
    half_a_step_apart(range(2000, 2000 + arguments.seeds))
    drifting_clocks(range(2000, 2000 + arguments.seeds))


if __name__ == '__main__':
    main()
