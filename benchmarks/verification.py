# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""How often ``verify`` and ``fleet`` are right, on simulated drives of one mounting.

    python -m benchmarks.verification verify --scenario handheld --seeds 100
    python -m benchmarks.verification fleet --scenario handheld --seeds 100

``verify``: each seed calibrates one drive and verifies three others: of the same extrinsic, moved
by 3 cm along one axis, and turned by 0.5 degrees about it. ``fleet``: drives are calibrated once;
each seed draws 30 of them at random (unchanged), and 12 of which the last four were moved by 8 cm
and 1.5 degrees.
"""

import argparse
from collections import Counter
from dataclasses import replace

import numpy as np

from trajectory_calibration import calibrate, Trajectory
from trajectory_calibration.fleet.comparison import compare, Entry
from trajectory_calibration.fleet.verification import verify
from trajectory_calibration.geometry import se3
from trajectory_calibration.simulation import SCENARIOS, simulate

MOVED = np.array([0.08, 0, 0, 0, 0, np.deg2rad(1.5)])

# Drives of which the fleets are drawn.
POOL, MOVED_POOL = 120, 40


def drive(scenario, seed, T_a_b):
    """Return the trajectories of a drive whose sensor b is mounted at T_a_b."""
    pair = simulate(scenario, seed)
    poses = pair.b.poses @ se3.inverse(pair.T_a_b) @ T_a_b
    return pair.a, Trajectory(pair.b.stamps_ns, poses, pair.b.world_frame, pair.b.sensor_frame)


def verify_seed(scenario, seed):
    """Return the three verdicts of one seed, and the deviations of the comparison (6,)."""
    T = simulate(scenario, 0).T_a_b
    rng = np.random.default_rng(seed)
    result = calibrate(*drive(scenario, 2 * seed + 1, T))
    axis = rng.integers(3)
    shift, turn = np.zeros(6), np.zeros(6)
    shift[axis], turn[3 + axis] = 0.03, np.deg2rad(0.5)
    found = [verify(result, *drive(scenario, 2 * seed + 2, mounted)) for mounted in (
        T, se3.moved(T, shift), se3.moved(T, turn))]
    resolution = [item.difference.resolution for item in found]
    return {
        'same': found[0].verdict,
        '3 cm': found[1].verdict,
        '3 cm where noticeable': found[1].verdict if resolution[1][axis] < 0.03 else None,
        '0.5 deg': found[2].verdict,
    }


def run_verify(scenario, seeds):
    counts = {}
    for seed in range(seeds):
        for name, verdict in verify_seed(scenario, seed).items():
            if verdict is not None:
                counts.setdefault(name, Counter())[verdict] += 1
    for name, count in counts.items():
        print(f'{name:<24} {dict(count)}', flush=True)


def answers(scenario, seeds, T_a_b):
    return [calibrate(*drive(scenario, seed, T_a_b)) for seed in seeds]


def drawn(rng, pool, count):
    return [pool[k] for k in rng.choice(len(pool), count, replace=False)]


def entries(results):
    return [Entry(f'fleet{k}', replace(result, start_ns=k * 86_400 * 10**9))
            for k, result in enumerate(results)]


def run_fleet(scenario, seeds):
    T = simulate(scenario, 0).T_a_b
    pool = answers(scenario, range(1, 1 + POOL), T)
    moved = answers(scenario, range(5000, 5000 + MOVED_POOL), se3.moved(T, MOVED))
    unchanged, named, ratios = Counter(), Counter(), []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        found = compare(entries(drawn(rng, pool, 30)))
        unchanged[found.exit_status] += 1
        ratios.append(found.chi_squared / found.degrees_of_freedom)
        found = compare(entries(drawn(rng, pool, 8) + drawn(rng, moved, 4)))
        named['|'.join(str(len(item.names)) for item in found.stretches), found.exit_status] += 1
    print(found.describe()[0])
    print(f'30 unchanged: exit status {dict(unchanged)}, chi2/dof {np.mean(ratios):.2f}')
    print(f'8 + 4 moved by 8 cm and 1.5 deg: stretches and exit status {dict(named)}', flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('what', choices=('verify', 'fleet'))
    parser.add_argument('--scenario', choices=tuple(SCENARIOS), default='handheld')
    parser.add_argument('--duration', type=float, help='seconds (default: of the scenario)')
    parser.add_argument('--seeds', type=int, default=100)
    arguments = parser.parse_args()
    scenario = SCENARIOS[arguments.scenario]
    if arguments.duration is not None:
        scenario = replace(scenario, duration=arguments.duration)
    {'verify': run_verify, 'fleet': run_fleet}[arguments.what](scenario, arguments.seeds)


if __name__ == '__main__':
    main()
