# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Rigs of several sensors: accuracy, honesty, faults by name, speed.

    python -m benchmarks.rig accuracy --sensors 3 5 8 --seeds 20
    python -m benchmarks.rig faults --seeds 20
    python -m benchmarks.rig speed
    python -m benchmarks.rig real ../shared/data/real
    python -m benchmarks.rig bound --sensors 5

Errors are those of the rig, and in brackets those of the pair with the base alone.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from itertools import combinations, product
from pathlib import Path
import resource
import time

from joblib.externals.loky import get_reusable_executor
import numpy as np

from benchmarks.simulated_rig import Fault, rig_scenario, RigScenario, simulate_rig
from trajectory_calibration.geometry import se3
from trajectory_calibration.rig import calibrate_rig, RigConfig, SensorSettings
from trajectory_calibration.rig.noise import covariances, sensor_variances
from trajectory_calibration.rig.pairs import calibrate_pairs
from trajectory_calibration.rig.windows import base_track, Clock, common_grid, window_levels
from trajectory_calibration.simulation.noise import Noise
from trajectory_calibration.simulation.scenario import Sensor
from trajectory_calibration.sources.files import FileSource

FREE = RigConfig(sensors={'mono': SensorSettings(scale='free')})

# A sensor whose track drifts by 3 mm and 0.02 deg after one metre.
_SLAM = Noise(white=0.005, white_rotation=0.0005, walk=0.003, walk_rotation=0.0003)

# Standard deviations within which a normal number is with 95 %.
_95 = 1.96


def scenario(
    sensors: int, duration: float, *, outages: bool, base: str = 'lidar', steady: bool = False,
) -> RigScenario:
    """Return a vehicle; with outages, every sensor but one is lost for a while, at any time."""
    found = rig_scenario(sensors, duration)
    found = replace(found, sensors={
        name: found.sensors[name] for name in sorted(found.sensors, key=lambda n: n != base)})
    if outages:
        lost = {'lidar': (1, 0.1), 'gnss': (1, 0.25), 'mono': (2, 0.12), 'stereo': (1, 0.2),
                'radar': (1, 0.15), 'lidar_rear': (1, 0.1), 'camera_rear': (2, 0.1)}
        found = replace(found, sensors={
            name: replace(sensor, gaps=lost.get(name, (0, 0))[0],
                          gap=lost.get(name, (0, 0))[1] * duration)
            for name, sensor in found.sensors.items()})
    return replace(found, steady_drift=0.003, latency=0.005) if steady else found


def error_of(rig, run, name):
    """Return (6,), the error of one sensor in the base."""
    return se3.step_between(run.T_base_sensor[name], rig.sensors[name].T_base_sensor)


def direct_answers(rig, run, config):
    """Return by sensor what its pair with the base alone says: (error, (6, 6))."""
    found = {}
    for answer in calibrate_pairs(run.trajectories, rig.base, replace(config, pairs='base'))[0]:
        if answer.parent == rig.base:
            found[answer.child] = (
                se3.step_between(run.T_base_sensor[answer.child], answer.result.T_a_b),
                answer.covariance)
    return found


def accuracy(
    sensors: int, duration: float, seeds: range, *, outages: bool, base: str, steady: bool,
) -> None:
    """Print the errors of rigs beside those of the pairs with the base."""
    config = FREE if sensors > 2 else RigConfig()
    errors, singles, nees, marginal, pair_nees, inside, closure, alarms = (
        [], [], [], [], [], [], [], 0)
    for seed in seeds:
        run = simulate_rig(
            scenario(sensors, duration, outages=outages, base=base, steady=steady), seed)
        rig = calibrate_rig(run.trajectories, config)
        direct = direct_answers(rig, run, config)
        if set(rig.free) != set(direct):
            print(f'seed {seed}: answered {rig.free}, direct {sorted(direct)}')
            continue
        error = {name: error_of(rig, run, name) for name in rig.free}
        joint = np.concatenate([error[name] for name in rig.free])
        nees.append(joint @ np.linalg.solve(rig.covariance, joint) / len(joint))
        std = np.sqrt(np.diagonal(rig.covariance))
        inside.append(np.abs(joint) < _95 * std)
        marginal.append([error[name] @ np.linalg.solve(rig.sensors[name].covariance, error[name])
                         / 6 for name in rig.free])
        pair_nees.append([e @ np.linalg.solve(P, e) / 6
                          for e, P in (direct[name] for name in rig.free)])
        errors.append([_sizes(error[name]) for name in rig.free])
        singles.append([_sizes(direct[name][0]) for name in rig.free])
        closure.append(max(np.abs(
            rig.transform(a, b) @ rig.transform(b, c) @ rig.transform(c, a) - np.eye(4)).max()
            for a, b, c in combinations(rig.sensors, 3)) if sensors > 2 else 0.0)
        alarms += any(item.kind != 'clock' for item in rig.contradictions)
    ours, alone = np.array(errors), np.array(singles)
    print(f'{sensors} sensors, base {base}, {duration:.0f} s, outages {outages}, '
          f'steady errors {steady}, {len(ours)} seeds')
    names = rig.free
    for k, kind in enumerate(('translation, mm', 'rotation, mrad')):
        for part, word in ((np.median, 'median'), (_rms, 'rms')):
            one, other = 1e3 * part(ours[:, :, k], axis=0), 1e3 * part(alone[:, :, k], axis=0)
            print(f'  {kind:16} {word:6} ' + '  '.join(
                f'{name} {a:.2f} ({b:.2f})' for name, a, b in zip(names, one, other, strict=True))
                + f'  ratio, median over sensors {np.median(one / other):.3f}')
    print(f'  joint NEES per degree of freedom {np.mean(nees):.2f}, of single sensors '
          f'{np.mean(marginal):.2f}, of pairs with the base {np.mean(pair_nees):.2f}')
    print(f'  coverage of 95 % intervals {100 * np.mean(inside):.1f} %, loops close to '
          f'{max(closure):.0e}, false alarms {alarms} of {len(ours)}')


def faults(duration: float, seeds: range, kinds: list[str], *, mixed: bool) -> None:
    """Print how often the sensor at fault is named, and what that does to the others."""
    known = {'moved': Fault(moved=0.05), 'late': Fault(late=0.08),
             'elsewhere': Fault(elsewhere=True), 'none': Fault()}
    wanted = {'moved': 'moved', 'late': 'clock', 'elsewhere': 'vehicle'}
    base = rig_scenario(4, duration) if mixed else RigScenario(
        {name: Sensor(noise=_SLAM) for name in ('lidar', 'front', 'rear', 'left')}, duration)
    base = replace(base, sensors={
        name: replace(sensor, clock_offset=0.0) for name, sensor in base.sensors.items()})
    names = list(base.sensors)
    for kind in kinds:
        named, others, wrong = 0, [], 0
        for seed in seeds:
            culprit = names[seed % len(names)]
            run = simulate_rig(replace(base, faults={culprit: known[kind]}), seed)
            rig = calibrate_rig(run.trajectories, _config(run.trajectories))
            found = [(item.sensor, item.kind) for item in rig.contradictions]
            named += kind != 'none' and (culprit, wanted[kind]) in found
            extra = [item for item in found if item[0] != culprit or kind == 'none']
            wrong += bool(extra)
            if (kind != 'none' and (culprit, wanted[kind]) not in found) or extra:
                print(f'    seed {seed}: {culprit} {kind}, found {found}', flush=True)
            if kind != 'none' and culprit != names[0]:
                rest = {k: v for k, v in run.trajectories.items() if k != culprit}
                without = calibrate_rig(rest, _config(rest))
                others += [
                    [*_sizes(error_of(rig, run, name)), *_sizes(error_of(without, run, name))]
                    for name in without.free if name in rig.free]
        print(f'{kind}, {duration:.0f} s: named {named} of {len(seeds)}, others named {wrong}',
              flush=True)
        if others:
            rms = _rms(np.array(others), axis=0)
            print(f'  errors of the others against those without it: {rms[0] / rms[2]:.3f}, '
                  f'{rms[1] / rms[3]:.3f}', flush=True)


def bound(
    sensors: int, duration: float, seeds: range, *, outages: bool, base: str,
) -> None:
    """Print what all sensors together could gain over a pair, at the most (Cramer-Rao).

    For every sensor: the deviation under the joint likelihood of all windows, relative to that
    of its pair with the base, both with the noise that was identified and the true poses.
    """
    found = []
    for seed in seeds:
        vehicle = scenario(sensors, duration, outages=outages, base=base)
        run = simulate_rig(vehicle, seed)
        X = np.stack(list(run.T_base_sensor.values()))
        tracks = [
            base_track(track, Clock(-vehicle.sensors[name].clock_offset),
                       1 / vehicle.sensors[name].noise.scale, x)
            for (name, track), x in zip(run.trajectories.items(), X, strict=True)]
        levels = window_levels(common_grid(tracks, 500_000_000))
        noise = covariances(sensor_variances(levels, X), X)
        together = np.zeros((sensors, 6, sensors, 6))
        alone = np.zeros((sensors, 6, 6))
        for level, N in zip(levels, noise, strict=True):
            known = level.known[:, level.known.any(axis=0)]
            J = level.jacobian[level.known.any(axis=0)]
            W = known[:, :, None, None] * np.linalg.inv(N)[:, None]
            total = np.linalg.inv(W.sum(axis=0))
            for i, j in product(range(sensors), repeat=2):
                K = (W[i] if i == j else 0) - W[i] @ total @ W[j]
                together[i, :, j] += np.einsum('wca,wcd,wdb->ab', J, K, J)
            for i in range(1, sensors):
                both = J[known[0] & known[i]]
                alone[i] += np.einsum('wca,cd,wdb->ab', both, np.linalg.inv(N[0] + N[i]), both)
        C = np.linalg.inv(together[1:, :, 1:].reshape(6 * sensors - 6, -1))
        own = np.stack([np.diagonal(np.linalg.inv(part)) for part in alone[1:]])
        found.append(np.sqrt(np.diagonal(C).reshape(-1, 6) / own))
    ratio = np.mean(found, axis=0)
    print(f'{sensors} sensors, base {base}, outages {outages}: '
          'deviation together / of the pair with the base')
    for name, row in zip(list(run.trajectories)[1:], ratio, strict=True):
        print(f'  {name:12} translation {row[:3].mean():.3f}  rotation {row[3:].mean():.3f}')
    print(f'  median over sensors {np.median(ratio[:, :3].mean(1)):.3f}, '
          f'{np.median(ratio[:, 3:].mean(1)):.3f}')


def speed() -> None:
    """Print the time and memory of eight sensors, ten minutes, ten hertz."""
    found = rig_scenario(8, 600.0)
    run = simulate_rig(replace(found, sensors={
        name: replace(sensor, rate=10.0) for name, sensor in found.sensors.items()}), 0)
    start, used = time.perf_counter(), _cpu()
    rig = calibrate_rig(run.trajectories, FREE)
    lasted = time.perf_counter() - start
    # The time and memory of processes count once they have ended.
    get_reusable_executor().shutdown(wait=True)
    own, other = (resource.getrusage(who).ru_maxrss / 1024 for who in (
        resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    print(f'{len(rig.sensors)} sensors, {len(rig.pairs)} pairs: {lasted:.1f} s, CPU '
          f'{_cpu() - used:.1f} s, {own:.0f} MiB and at most {other:.0f} in each process')


def real(folder: Path) -> None:
    """Print the triples of the drive kitti00 and how their loops close."""
    names = {'lidar': 'kitti00_lidar_orb/a', 'orb': 'kitti00_lidar_orb/b',
             'sptam': 'kitti00_lidar_sptam/b', 'gnss': 'kitti00_lidar_gnss/b',
             'vins': 'kitti00_orb_vins/b', 'mono': 'kitti00_lidar_orbslam3mono/b'}
    tracks = {name: FileSource(folder / f'{file}.tum', sensor_frame=name).load()
              for name, file in names.items()}
    for three in (('lidar', 'orb', 'gnss'), ('lidar', 'sptam', 'gnss'), ('lidar', 'orb', 'sptam'),
                  ('lidar', 'orb', 'vins'), ('lidar', 'orb', 'mono'), tuple(names)):
        config = FREE if 'mono' in three else RigConfig()
        start = time.perf_counter()
        rig = calibrate_rig({name: tracks[name] for name in three}, config)
        worst = max((pair.chi_squared for pair in rig.pairs if np.isfinite(pair.chi_squared)),
                    default=np.nan)
        print(f'{", ".join(three)}: chi-squared {rig.chi_squared:.1f} of {rig.degrees}, '
              f'p {rig.p_value:.2g}, worst pair {worst / 6:.1f} a degree, '
              f'{[(item.sensor, item.kind) for item in rig.contradictions]}, '
              f'{time.perf_counter() - start:.1f} s')
        for name in rig.free:
            sensor = rig.sensors[name]
            std = np.sqrt(np.diagonal(sensor.covariance))
            rpy = np.rad2deg(se3.roll_pitch_yaw(sensor.T_base_sensor[:3, :3]))
            print(f'  {name:6} t {np.round(sensor.T_base_sensor[:3, 3], 3)} +- '
                  f'{np.round(std[:3], 3)}, rpy {np.round(rpy, 2)} +- '
                  f'{np.round(np.rad2deg(std[3:]), 2)}, clock {1e3 * sensor.clock.offset_s:.1f} '
                  f'ms, scale {sensor.scale:.4f}')


def _config(sensors):
    return FREE if 'mono' in sensors else RigConfig()


def _sizes(step):
    return float(np.linalg.norm(step[:3])), float(np.linalg.norm(step[3:]))


def _rms(values, axis):
    return np.sqrt(np.mean(values**2, axis=axis))


def _cpu():
    return sum(sum(resource.getrusage(who)[:2]) for who in (
        resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def main() -> None:
    """Run one of the benchmarks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('what', choices=('accuracy', 'faults', 'bound', 'speed', 'real'))
    parser.add_argument('folder', nargs='?', type=Path, default=Path('../shared/data/real'))
    parser.add_argument('--sensors', type=int, nargs='+', default=[3, 5, 8])
    parser.add_argument('--seeds', type=int, default=20)
    parser.add_argument('--first-seed', type=int, default=0)
    parser.add_argument('--duration', type=float, default=None, help='seconds')
    parser.add_argument('--kinds', nargs='+', default=['moved', 'late', 'elsewhere', 'none'])
    parser.add_argument('--base', default='lidar')
    parser.add_argument('--outages', action='store_true')
    parser.add_argument('--steady', action='store_true', help='accuracy: steady drift, latencies')
    parser.add_argument('--mixed', action='store_true', help='faults: the noisier, mixed rig')
    given = parser.parse_args()
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    if given.what == 'speed':
        speed()
    elif given.what == 'real':
        real(given.folder)
    elif given.what == 'faults':
        faults(given.duration or 120.0, seeds, given.kinds, mixed=given.mixed)
    else:
        common = {'outages': given.outages, 'base': given.base}
        for sensors in given.sensors:
            if given.what == 'bound':
                bound(sensors, given.duration or 120.0, seeds, **common)
            else:
                accuracy(sensors, given.duration or 120.0, seeds, steady=given.steady, **common)


if __name__ == '__main__':
    main()
