# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Is every direction that the motion did not show flagged, and no other?

    python -m benchmarks.observability [--seeds 100] [--solvers drift_aware,dnl]

For drives on flat ground, exactly and nearly, under several kinds of noise: in how many seeds
the height is called unobservable (a drive that is refused for it counts), or only weak. For drives
that turn about all axes: in how many seeds anything is flagged. All settings but the solver are
the defaults.
"""

import argparse
from dataclasses import replace
import time

import numpy as np

from trajectory_calibration import calibrate, CalibrationConfig, MotionError
from trajectory_calibration.simulation import (
    flat,
    Noise,
    Scenario,
    SCENARIOS,
    simulate,
    Unicycle,
    Wander,
    with_noise,
)


def nearly_flat(x, y):
    """Ground that undulates by 0.2 degrees, less than a suspension moves."""
    k, height = 0.6, np.deg2rad(0.2) / 0.6
    return (height * (np.sin(k * x) + np.cos(k * y)), height * k * np.cos(k * x) + 0 * y,
            -height * k * np.sin(k * y) + 0 * x)


NOISE = {
    'none': Noise(),
    'white 2 mm, 1 mrad': Noise(white=0.002, white_rotation=0.001),
    'white 10 mm, 20 mrad': Noise(white=0.01, white_rotation=0.02),
    'walk': Noise(white=0.001, walk=0.02, walk_rotation=0.01),
    'jumps': Noise(white=0.005, jumps=5),
    'coloured': Noise(white=0.001, coloured=0.01, coloured_rotation=0.005, coloured_time=1.0),
}
MILD = Noise(white=0.005, white_rotation=0.002, walk=0.005, walk_rotation=0.001)


def planar():
    """Yield name and scenario of drives that do not show the height."""
    for ground in (flat, nearly_flat):
        for name, noise in NOISE.items():
            if name == 'none' and ground is nearly_flat:
                # Without noise 0.2 degrees are enough.
                continue
            yield f'{ground.__name__}, {name}', with_noise(
                Scenario(motion=Unicycle(ground=ground)), noise, noise)
    yield 'road, 15 m/s, 120 s', SCENARIOS['road']


def excited():
    """Yield name and scenario of drives that turn about all axes."""
    for name in ('noise', 'outliers', 'drift', 'mixture'):
        yield name, SCENARIOS[name]
    yield 'wander 30 s, mild noise', with_noise(Scenario(30.0, Wander()), MILD, MILD)
    for name in ('offroad', 'drone', 'handheld'):
        yield f'{name} 30 s', replace(SCENARIOS[name], duration=30.0)


def flags(scenario, seed, solver):
    """Return which directions are unobservable, and which weak, or None where it is refused."""
    run = simulate(scenario, seed)
    try:
        found = calibrate(run.a, run.b, CalibrationConfig(solver=solver))
    except MotionError:
        return None
    return found.observability.unobserved, found.observability.weak


def counted(scenario, solver, seeds, flagged):
    """Return the cells of a row: refused, unobservable, only weak, seconds; and what is left.

    ``flagged`` tells from names of directions whether they are the ones in question.
    """
    start = time.process_time()
    found = [flags(scenario, seed, solver) for seed in range(seeds)]
    seconds = (time.process_time() - start) / seeds
    answers = [item for item in found if item is not None]
    unobserved = sum(flagged(item[0]) for item in answers)
    weak = sum(flagged(item[1]) and not flagged(item[0]) for item in answers)
    return seeds - len(answers), unobserved, weak, len(answers) - unobserved - weak, seconds


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seeds', type=int, default=100)
    parser.add_argument('--solvers', default='drift_aware,dnl')
    arguments = parser.parse_args()
    solvers = arguments.solvers.split(',')
    for drives, flagged, what in ((planar(), lambda names: 'z' in names, 'z'),
                                  (excited(), bool, 'anything')):
        print(f'| drive | solver | refused | {what} unobservable | only weak | not flagged | '
              'CPU s a run |\n|---|---|---|---|---|---|---|')
        for name, scenario in drives:
            for solver in solvers:
                *cells, seconds = counted(scenario, solver, arguments.seeds, flagged)
                print(f'| {name} | {solver} | ' + ' | '.join(map(str, cells))
                      + f' | {seconds:.2f} |', flush=True)
        print()


if __name__ == '__main__':
    main()
