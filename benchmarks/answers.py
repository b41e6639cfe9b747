# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Save the answers of all solvers at all references, to compare two versions of the package.

    python -m benchmarks.answers save before.json --data ../shared/data
    python -m benchmarks.answers compare before.json after.json

A refactoring changes none. The comparison prints each answer that differs: by how many metres and
degrees, how much the deviations changed, and which directions have another status.
"""

import argparse
import json
from pathlib import Path
import time

import numpy as np

from trajectory_calibration import calibrate, CalibrationConfig, CalibrationError
from trajectory_calibration.sources import FileSource

SOLVERS = ('dnl', 'dnlo', 'ali', 'park', 'taylor', 'zhuang', 'drift_aware')
REFERENCES = ('A', 'B1', 'B5', 'C5', 'auto')
REAL = ('euroc_MH_01_gt_stereo', 'kitti00_lidar_sptam', 'kitti05_lidar_gnss',
        'tum_fr1xyz_gt_rgbdslam', 'mulran_DCC_01_gnss_lidar')


def pairs_of_files(data):
    """Yield a name and two files."""
    drive = data / 'kitti' / '2011_09_30_drive_0027'
    track = 'KeyFrameTrajectory_TUM_Format.txt'
    yield 'kitti 09_30', drive / 'LIDAR_HDL64E/traj_HDL_aft_opt.csv', drive / 'cam01' / track
    drive = data / 'kitti' / '2011_10_03_drive_0027'
    yield 'kitti 10_03', drive / 'cam01' / track, drive / 'cam23' / track
    for kind in ('noise/noise_0.006000', 'outliers/outliers_6', 'drift/drift_0.020000', 'mixture'):
        for run in sorted((data / 'simulation' / kind).glob('run_*'))[:2]:
            yield f'{kind} {run.name}', run / 'T_S1_W1.txt', run / 'T_S2_W2.txt'
    for name in REAL:
        yield name, data / 'real' / name / 'a.tum', data / 'real' / name / 'b.tum'


def answer(a, b, solver, reference):
    """Return plain data: the answer or the error."""
    started = time.process_time()
    try:
        found = calibrate(a, b, CalibrationConfig(solver=solver, reference=reference))
    except CalibrationError as error:
        return {'error': type(error).__name__, 'text': str(error)}
    return {'T_a_b': np.asarray(found.T_a_b).tolist(),
            'covariance': np.asarray(found.covariance).tolist(),
            'status': dict(found.observability.status), 'scale': found.scale,
            'reference': found.reference, 'warnings': list(found.warnings),
            'seconds': time.process_time() - started}


def save(path, data):
    """Write the answers on all pairs."""
    found = {}
    for name, file_a, file_b in pairs_of_files(data):
        a, b = FileSource(file_a).load(), FileSource(file_b).load()
        for solver in SOLVERS:
            for reference in REFERENCES if solver != 'drift_aware' else ('B5',):
                found[f'{name} | {solver} | {reference}'] = answer(a, b, solver, reference)
        path.write_text(json.dumps(found, indent=1), encoding='utf-8')
        print(name, flush=True)


def compare(before, after):
    """Print every answer that differs."""
    old, new = (json.loads(path.read_text(encoding='utf-8')) for path in (before, after))
    same = 0
    for key, one in old.items():
        difference = 'missing' if key not in new else difference_of(one, new[key])
        same += not difference
        if difference:
            print(f'{key} | {difference}')
    print(f'{same} of {len(old)} the same')


def difference_of(one, other):
    """Return how two answers differ, or an empty text."""
    if 'error' in one or 'error' in other:
        if one.get('error') == other.get('error'):
            return ''
        return f'{one.get("text", "answered")} -> {other.get("text", "answered")}'
    T, U = np.array(one['T_a_b']), np.array(other['T_a_b'])
    shift = np.linalg.norm(T[:3, 3] - U[:3, 3])
    turn = np.rad2deg(np.linalg.norm(T[:3, :3] - U[:3, :3]) / np.sqrt(2))
    ratio = np.sqrt(np.diag(other['covariance']) / np.diag(one['covariance']))
    changed = [f'{name}: {status} -> {other["status"][name]}'
               for name, status in one['status'].items() if status != other['status'][name]]
    if one['reference'] != other['reference']:
        changed.append(f'{one["reference"]} -> {other["reference"]}')
    if shift < 1e-6 and turn < 1e-4 and np.abs(np.log(ratio)).max() < 1e-3 and not changed:
        return ''
    return (f'{shift:.2g} m {turn:.2g} deg | deviations x {ratio.min():.3g} .. {ratio.max():.3g} '
            f'| {"; ".join(changed)}')


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('action', choices=('save', 'compare'))
    parser.add_argument('files', nargs='+', type=Path)
    parser.add_argument('--data', type=Path, default=Path('../shared/data'))
    given = parser.parse_args()
    if given.action == 'save':
        save(given.files[0], given.data)
    else:
        compare(*given.files)
