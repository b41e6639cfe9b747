# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""How long answers and solvers take, on the published drives and as a drive grows.

    python -m benchmarks.speed --data ../shared/data

Prints two Markdown tables of processor time, which other work on the machine changes less than
that of the clock: whole calibrations with all their stages, and solvers alone, association and
selection of motions not counted. The published drive of the solvers is 2011_10_03 at B5 (2,338
motions); the growing drives are simulated, and have no targets. Set OMP_NUM_THREADS=1, or the
linear algebra takes both cores.
"""

import argparse
from dataclasses import replace
from pathlib import Path
import resource
import statistics
import subprocess
import sys
import tempfile
import time

import numpy as np

from benchmarks.paper.environment import describe_machine, describe_versions
from benchmarks.paper.kitti import paper_pairs
from benchmarks.paper.published import read_kitti, SEQUENCES
from trajectory_calibration import calibrate, CalibrationConfig, Trajectory
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.geometry import se3
from trajectory_calibration.simulation import SCENARIOS, simulate
from trajectory_calibration.solvers import load_solver
from trajectory_calibration.sources import FileSource
from trajectory_calibration.time_alignment.pairing import associate_by_interpolation

SOLVERS = {
    'park': {}, 'taylor': {}, 'zhuang': {}, 'ali': {}, 'dnl': {}, 'dnlo': {},
    'dnlo, ipopt': {'dnlo_method': 'ipopt'},
}
# Milliseconds on the published drive.
TARGETS_MS = {'park': 5, 'taylor': 5, 'zhuang': 200, 'dnl': 10, 'dnlo': 15}
PUBLISHED = '2011_10_03, B5'
REPEATS = 10
# The files of the published drives, lidar or camera and camera.
TRACK = 'KeyFrameTrajectory_TUM_Format.txt'
DRIVES = {'2011_10_03': (f'cam01/{TRACK}', f'cam23/{TRACK}'),
          '2011_09_30': ('LIDAR_HDL64E/traj_HDL_aft_opt.csv', f'cam01/{TRACK}')}
LONG = 1_000_000
FILE_POSES = 448
LINES = 100_000


def published_drive(data):
    """Return the motions of 2011_10_03 at B5, poses of a interpolated everywhere."""
    drive = read_kitti(data, SEQUENCES[1])
    return select_motions(paper_pairs(drive.a, drive.b), 'B5')


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


def offroad(poses, rate):
    """Return the trajectories of a simulated drive over hills."""
    scenario = SCENARIOS['offroad']
    pair = simulate(replace(
        scenario, duration=(poses - 1) / rate, a=replace(scenario.a, rate=rate),
        b=replace(scenario.b, rate=rate)), seed=0)
    return pair.a, pair.b


def seconds_of(work, repeats=None):
    """Return the processor seconds of so many runs, by default of REPEATS."""
    found = []
    for _ in range(repeats or REPEATS):
        start = time.process_time()
        work()
        found.append(time.process_time() - start)
    return found


def spread(found):
    """Return the median, the least and the most."""
    return f'{statistics.median(found):.2f} ({min(found):.2f} - {max(found):.2f})'


def times_ms(name, motions, settings):
    """Return the milliseconds of ten solves after one that loads and builds what is kept."""
    solve, config = load_solver(name), CalibrationConfig(**settings)
    solve(motions, config)
    return [1e3 * seconds for seconds in seconds_of(lambda: solve(motions, config))]


def of_child(arguments):
    """Return the processor seconds of a process; the peak of all so far is in RUSAGE_CHILDREN."""
    def used():
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime
    before = used()
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
    return used() - before


def write_tum(path, trajectory):
    """Write a file as SLAM does."""
    q = se3.rotation_to_quaternion(trajectory.rotations)
    rows = np.column_stack([trajectory.stamps_ns * 1e-9, trajectory.positions, q])
    np.savetxt(path, rows, fmt=['%.9f', *['%.7f'] * 3, *['%.9f'] * 4])


def whole_answers(data, poses):
    """Yield what was done, how long it took, and how long it may."""
    for drive, files in DRIVES.items():
        a, b = (FileSource(data / 'kitti' / f'{drive}_drive_0027' / name).load()
                for name in files)
        calibrate(a, b)
        # Anew, as they come from a file: a trajectory keeps what was computed of it.
        found = seconds_of(lambda: calibrate(replace(a), replace(b)))  # noqa: B023
        yield f'`calibrate()`, {drive}', f'{spread(found)} s', '0.15 s'
    with tempfile.TemporaryDirectory() as folder:
        files = [str(Path(folder) / f'{name}.tum') for name in 'ab']
        for path, trajectory in zip(files, offroad(FILE_POSES, 10.0), strict=True):
            write_tum(path, trajectory)
        command = ['-m', 'trajectory_calibration', 'calibrate', *files]
        found = [of_child(command) for _ in range(REPEATS)]
        numpy = [of_child(['-c', 'import numpy']) for _ in range(REPEATS)]
        yield f'command line, two files of {FILE_POSES} poses', f'{spread(found)} s', '0.6 s'
        yield 'of which `import numpy`', f'{spread(numpy)} s', ''
        path = Path(folder) / 'long.tum'
        write_tum(path, offroad(LINES, 10.0)[0])
        found = seconds_of(lambda: FileSource(path).load())
        found = [1e6 * seconds / LINES for seconds in found]
        yield 'a line of a TUM file', f'{spread(found)} us', '2.5 us'
    a, b = offroad(poses, 100.0)
    (seconds,) = seconds_of(lambda: calibrate(a, b), 1)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    yield (f'`calibrate()`, {poses:,} poses per sensor at 100 Hz',
           f'{seconds:.1f} s, {peak:.1f} GiB', '30 s, 2 GiB')


def print_solvers(data, poses):
    """Print the table of the solvers."""
    print('| drive | motions | solver | median ms | min - max ms | target ms |\n'
          '|---|---|---|---|---|---|')
    drives = {PUBLISHED: published_drive(data)}
    drives.update((f'simulated, {n:,} poses, B5', simulated_drive(n)) for n in poses)
    for drive, motions in drives.items():
        for label, settings in SOLVERS.items():
            if 'ipopt' in label and len(motions) > 5_000:
                continue  # minutes: the reason for the closed form
            ms = times_ms(label.split(',')[0], motions, settings)
            target = TARGETS_MS.get(label, '') if drive == PUBLISHED else ''
            print(f'| {drive} | {len(motions):,} | {label} | {statistics.median(ms):.1f} | '
                  f'{min(ms):.1f} - {max(ms):.1f} | {target} |'.replace('|  |', '| |'), flush=True)


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path, required=True)
    parser.add_argument('--poses', type=int, nargs='*', default=[1_000, 10_000, 100_000],
                        help='of the drives of the solvers')
    parser.add_argument('--long', type=int, default=LONG, help='poses of the longest drive')
    arguments = parser.parse_args()
    print(f'{describe_machine()}; {describe_versions()}\n')
    print('| what | median (min - max) | target |\n|---|---|---|')
    for row in whole_answers(arguments.data, arguments.long):
        print(f'| {" | ".join(row)} |'.replace('|  |', '| |'), flush=True)
    print()
    print_solvers(arguments.data, arguments.poses)


if __name__ == '__main__':
    main()
