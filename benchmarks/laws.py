# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Laws that an estimate must obey whatever the truth is: no truth is needed to test them.

    python -m benchmarks.laws [--data ../shared/data] [--seeds 4] [--only real] [--law swap]

Each law changes the input in a way whose effect on the answer is known, and compares:

swap       a and b exchanged give the inverse
reversed   time backwards gives the same answer
thinned    every 2nd, 5th, 10th pose of both agree with all of them
halves     both halves of a drive agree
rate       10, 50 and 200 Hz recordings of one drive agree, pairwise
world      other world frames, one of them at UTM coordinates, change nothing
third      X_ab X_bc = X_ac for three sensors (simulated drives)

The difference d of two answers is judged by chi2 / 6 = d' P^-1 d / 6. Halves share no data, so
that P is the sum of both covariances, and so for the three answers of ``third``. The other laws
compare answers from the same data: P is the larger of both covariances, which allows a change by
one deviation. A law holds where the median is at most 1 and more than 4 is found in at most 5 %.
Directions that either answer calls unobservable are left out.
"""

import argparse
from multiprocessing import Pool
from pathlib import Path

import numpy as np

from benchmarks.drives import FAMILIES, make, rotation
from benchmarks.families import trajectory
from trajectory_calibration import calibrate, CalibrationError, Trajectory
from trajectory_calibration.geometry import se3

LAWS = ('swap', 'reversed', 'thinned 2', 'thinned 5', 'thinned 10', 'halves', 'rate', 'world',
        'third')
SHARE_APART = 0.05
RATES_HZ = (10, 50, 200)
# Chains shorter than this say nothing of a law.
LEAST_POSES = 60


def backwards(t, about_ns):
    """Return the trajectory in reversed time, which mirrors at ``about_ns`` for both sensors."""
    return Trajectory(2 * about_ns - t.stamps_ns[::-1], t.poses[::-1],
                      sensor_frame=t.sensor_frame)


def every(t, n):
    return Trajectory(t.stamps_ns[::n], t.poses[::n], sensor_frame=t.sensor_frame)


def between(t, start_ns, end_ns):
    keep = (t.stamps_ns >= start_ns) & (t.stamps_ns < end_ns)
    return Trajectory(t.stamps_ns[keep], t.poses[keep], sensor_frame=t.sensor_frame)


def in_world(t, turn, shift):
    world = se3.from_rotation_translation(rotation(turn), shift)
    return Trajectory(t.stamps_ns, world @ t.poses, sensor_frame=t.sensor_frame)


def resampled(t, rate_hz):
    """Return the trajectory at another rate: what a faster or slower recorder had kept."""
    return every(t, max(1, round(1e9 / rate_hz / t.usual_step_ns)))


def inverted(T, P):
    """Return the inverse of an extrinsic and its covariance (axes of the new parent)."""
    back = se3.inverse(T)
    J = np.zeros((6, 6))
    J[:3, :3] = -back[:3, :3]
    J[:3, 3:] = -back[:3, :3] @ se3.skew(T[:3, 3])
    J[3:, 3:] = -back[:3, :3]
    return back, J @ P @ J.T


def told(result):
    """Return which of x, y, z, roll, pitch, yaw are observed, as (6,) bool."""
    return np.array([word != 'unobserved'
                     for word in result.observability.to_dict()['status'].values()])


def apart(one, other, P, keep):
    """Return chi2 / m over the axes to keep; None where none is left."""
    d = se3.step_between(one, other)[keep]
    if not keep.any():
        return None
    return float(d @ np.linalg.solve(P[np.ix_(keep, keep)], d) / keep.sum())


def larger(P, Q):
    """Return the upper bound of two covariances, eigenvalue by eigenvalue of one by the other."""
    values, vectors = np.linalg.eigh(P)
    root = vectors * np.sqrt(np.maximum(values, 1e-18))
    back = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(back @ Q @ back.T)
    half = root @ vectors
    return (half * np.maximum(values, 1.0)) @ half.T


def same_data(first, second):
    return apart(first.T_a_b, second.T_a_b, larger(first.covariance, second.covariance),
                 told(first) & told(second))


def judge(item):
    """Return a dictionary of the laws of one pair of trajectories: chi2 / 6 or a refusal."""
    name, a, b, third, laws = item
    found = {}

    def attempt(law, function):
        if law not in laws:
            return
        try:
            found[law] = function()
        except CalibrationError as error:
            found[law] = f'{type(error).__name__}: {error}'

    try:
        whole = calibrate(a, b)
    except CalibrationError as error:
        return name, {'refused': str(error)}

    def swap():
        back = calibrate(b, a)
        T, P = inverted(back.T_a_b, back.covariance)
        # b is in other units than a where the scale is free: the lever arm is in those of b.
        T[:3, 3] *= whole.scale
        P[:3] *= whole.scale
        P[:, :3] *= whole.scale
        keep = told(whole) if told(back).all() or told(whole).all() else told(whole) & False
        return apart(whole.T_a_b, T, larger(whole.covariance, P), keep)

    def halves():
        middle = int(max(a.stamps_ns[0], b.stamps_ns[0])
                     + min(a.stamps_ns[-1], b.stamps_ns[-1])) // 2
        first, second = (calibrate(between(a, *span), between(b, *span))
                         for span in ((0, middle), (middle, 2**62)))
        return apart(first.T_a_b, second.T_a_b, first.covariance + second.covariance,
                     told(first) & told(second))

    def rate():
        answers = [calibrate(resampled(a, hz), resampled(b, hz)) for hz in RATES_HZ
                   if hz <= 1.2e9 / max(a.usual_step_ns, b.usual_step_ns)]
        pairs = [same_data(p, q) for k, p in enumerate(answers) for q in answers[:k]]
        pairs = [value for value in pairs if value is not None]
        return max(pairs) if pairs else None

    def world():
        moved = calibrate(in_world(a, [0.4, -1.0, 2.0], [4.5e5, 5.4e6, 120.0]),
                          in_world(b, [1.0, 0.5, -0.7], [-30.0, 7.0, 2.0]))
        return same_data(whole, moved)

    def triangle():
        c = third
        bc, ac = calibrate(b, c), calibrate(a, c)
        T = whole.T_a_b @ bc.T_a_b
        J = np.zeros((6, 6))
        R = whole.T_a_b[:3, :3]
        J[:3, :3] = J[3:, 3:] = R
        Q = np.zeros((6, 6))
        Q[:3, :3] = Q[3:, 3:] = np.eye(3)
        Q[:3, 3:] = -se3.skew(R @ bc.T_a_b[:3, 3])
        P = Q @ whole.covariance @ Q.T + J @ bc.covariance @ J.T + ac.covariance
        keep = told(ac) if told(whole).all() and told(bc).all() else told(ac) & False
        return apart(ac.T_a_b, T, P, keep)

    attempt('swap', swap)
    about_ns = int(a.stamps_ns[len(a) // 2])
    attempt('reversed', lambda: same_data(
        whole, calibrate(backwards(a, about_ns), backwards(b, about_ns))))
    for n in (2, 5, 10):
        if min(len(a), len(b)) // n >= LEAST_POSES:
            attempt(f'thinned {n}',
                    lambda n=n: same_data(whole, calibrate(every(a, n), every(b, n))))
    attempt('halves', halves)
    if name.startswith('rate '):
        attempt('rate', rate)
    attempt('world', world)
    if third is not None:
        attempt('third', triangle)
    return name, found


def simulated(seeds, laws):
    """Yield drives of every family; those of the rate law are recorded at 200 Hz."""
    for family in FAMILIES:
        for seed in seeds:
            run = make(family, seed, third='wheels' not in family)
            third = None if run.third is None else trajectory(run.third[0], 'c')
            yield (family, trajectory(run.a, 'a'), trajectory(run.b, 'b'), third, laws)
    if 'rate' in laws:
        for seed in seeds:
            for kind, a, b in fast_drives(seed):
                yield f'rate {kind}', a, b, None, ('rate',)


def fast_drives(seed):
    """Yield a car and a hand recorded at 200 Hz, with noise that a rate does not change.

    The noise is coloured for longer than a step at 10 Hz, or walks with way and time; white noise
    of each pose would make a faster recording a better one.
    """
    from benchmarks.drives import car, drive, free, Sensor
    rng = np.random.default_rng([99, seed])
    walk = {'rate_hz': 200.0, 'walk': 0.005, 'walk_rad': 0.0006}
    run = drive(rng, car(rng, 60.0, 6.0, 0.3, hills=0.06), 60.0,
                [Sensor(**walk), Sensor(**walk, coloured=((0.01, 0.001, 1.0),))])
    yield 'car', trajectory(run.a, 'a'), trajectory(run.b, 'b')
    run = drive(rng, free(rng, 30.0, 0.6, 0.3, 1.2, 0.6), 30.0,
                [Sensor(rate_hz=200.0, coloured=((0.002, 0.002, 0.7),)), Sensor(**walk)], 0.2)
    yield 'hand', trajectory(run.a, 'a'), trajectory(run.b, 'b')


def real(data, laws):
    from benchmarks.real import load_pairs
    laws = tuple(law for law in laws if law not in ('rate', 'third'))
    for pair in load_pairs(data, ''):
        yield pair.name, pair.a, pair.b, None, laws


def show(title, judged):
    """Print one row a law over all pairs."""
    print(f'\n**{title}**\n\n| law | pairs | median chi2 / 6 | more than 4 | holds | refused | '
          'largest |\n|---|---|---|---|---|---|---|')
    for law in LAWS:
        found = [(name, laws[law]) for name, laws in judged if laws.get(law) is not None]
        values = [(value, name) for name, value in found if isinstance(value, float)]
        if not found:
            continue
        if not values:
            print(f'| {law} | 0 | | | | {len(found)} | |')
            continue
        numbers = np.array([value for value, _ in values])
        share, middle = np.mean(numbers > 4), np.median(numbers)
        worst = ', '.join(f'{name} {value:.1f}' for value, name in sorted(values)[::-1][:3])
        holds = 'yes' if middle <= 1 and share <= SHARE_APART else 'no'
        print(f'| {law} | {len(values)} | {middle:.2f} | {np.sum(numbers > 4)} ({share:.1%}) | '
              f'{holds} | {len(found) - len(values)} | {worst} |', flush=True)


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path, default=Path('../shared/data'))
    parser.add_argument('--seeds', type=int, default=4)
    parser.add_argument('--only', choices=('real', 'simulated'))
    parser.add_argument('--law', action='append', help='one of the laws; may be repeated')
    parser.add_argument('--jobs', type=int, default=1)
    parser.add_argument('--each', action='store_true', help='print every pair')
    arguments = parser.parse_args()
    laws = tuple(law for law in LAWS
                 if not arguments.law or any(law.startswith(word) for word in arguments.law))
    groups = []
    if arguments.only != 'real':
        groups.append(('Simulated drives', simulated(range(arguments.seeds), laws)))
    if arguments.only != 'simulated' and (arguments.data / 'real').is_dir():
        groups.append(('Real pairs', real(arguments.data, laws)))
    for title, items in groups:
        with Pool(arguments.jobs) as pool:
            judged = list(pool.imap(judge, items) if arguments.jobs > 1 else map(judge, items))
        show(title, judged)
        if arguments.each:
            for name, found in judged:
                print(f'- {name}: ' + ', '.join(
                    f'{law} {value:.2f}' if isinstance(value, float) else f'{law} {value}'
                    for law, value in found.items()))


if __name__ == '__main__':
    main()
