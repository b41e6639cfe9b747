# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Real pairs whose extrinsic is known: error, honesty of the error bars, terms, processor time.

    python -m benchmarks.real --data ../shared/data [--only kitti00] [--no-rivals] [--jobs 1]

Every pair of ``<data>/real`` and both KITTI drives of the paper go through ``calibrate()`` with
its defaults. Beside it, on the same pose pairs: the paper's park, dnl and dnlo at B1, B5, B10, C5,
C10 and, where installed, kinhec and OpenCV at B5. Nothing is stored between runs.

Two truths: that of the file, and the consensus of many drives (README of the data), which differs
for KITTI. Each has an uncertainty of its own; NEES / 6 adds it to the stated covariance, all of
it for the first, a third of it for the consensus. One is right, more is too sure.

Printed are Markdown tables. The best of 15 is the smallest error of the paper's solvers and
references against the same truth, translation and rotation each by itself: nobody can choose so
without the truth. Set OMP_NUM_THREADS=1, or the processor times count idle threads.
"""

import argparse
from dataclasses import dataclass
from multiprocessing import Pool
from pathlib import Path
import re
import time

import numpy as np

from benchmarks.peers import installed, kinhec_methods, opencv_methods
from trajectory_calibration import calibrate, CalibrationConfig, CalibrationError, Trajectory
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.geometry import se3
from trajectory_calibration.solvers import load_solver
from trajectory_calibration.sources.files import FileSource
from trajectory_calibration.time_alignment.align import match

PAPER_SOLVERS = ('park', 'dnl', 'dnlo')
REFERENCES = ('B1', 'B5', 'B10', 'C5', 'C10')
PEER_REFERENCE = 'B5'
# OpenCV forms all pairs of the poses that it is given: minutes beyond a few hundred.
OPENCV_POSES = 300
PEER_MOTIONS = 600
# Of the uncertainty of the file's truth, that of the consensus.
CONSENSUS_SHARE = 1 / 3

KITTI_LIDAR, GNSS, EUROC, MOCAP, EXACT = (
    (0.04, 0.35), (0.04, 0.3), (0.01, 0.2), (0.02, 1.0), (0.002, 0.02))


@dataclass(frozen=True)
class Truth:
    """What is known of a kind of pairs.

    Attributes
    ----------
    pattern : regular expression of the folder's name.
    metres, degrees : standard deviation of the truth, of each component.
    turn : (3,) degrees about the fixed axes of a, from the truth of the file to the consensus.
    free_scale : b is a monocular track.
    clock_s : known clock offsets of b, seconds; None where unknown.
    nominal : the truth of the file is off by decimetres: only the scatter of such pairs counts.

    """

    pattern: str
    known: tuple[float, float]
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    free_scale: bool = False
    clock_s: tuple[float, ...] | None = (0.0,)
    nominal: bool = False


TRUTHS = (
    Truth('kitti0._lidar_gnss', KITTI_LIDAR, (0.0, 0.0, 0.24)),
    Truth('kitti00_lidar_sptam', KITTI_LIDAR, (0.0, -0.35, 0.0), clock_s=(-0.1037, 0.0, 0.1037)),
    Truth('kitti00_lidar_orbslam3mono', KITTI_LIDAR, (0.0, -0.35, 0.0), free_scale=True),
    Truth('kitti0._lidar_ov2', KITTI_LIDAR, (0.0, -0.35, 0.0), clock_s=None),
    Truth('kitti0._lidar_', KITTI_LIDAR, (0.0, -0.35, 0.0)),
    Truth('kitti00_orb_vins', EXACT, clock_s=None),
    Truth('mulran_', GNSS, (0.0, -1.3, 0.0), clock_s=None, nominal=True),
    Truth('euroc_MH_03_mono_stereo', EXACT),
    Truth('euroc_', EUROC),
    Truth('tum_fr2desk_orb_oamono', EXACT, free_scale=True),
    Truth('tum_', MOCAP),
    Truth('arm_tag', (0.005, 1.0), clock_s=None),
    Truth('mocap_tag', MOCAP, clock_s=None),
    Truth('2011_', KITTI_LIDAR, clock_s=None),
)
# Long-baseline robust fits of the data's README: translation, quaternion x, y, z, w.
TAGS = {
    'arm_tag_camera': ((-0.001, -0.019, 0.004), (0.606, -0.372, 0.367, -0.600)),
    'mocap_tag_camera_1': ((0.077, 0.042, 0.030), (-0.420, 0.365, -0.568, 0.606)),
}
# Pose of colour in grey after rectification; the file holds the unrectified one, inverted.
RECTIFIED = (-0.0599, 0.0011, -0.0038)


@dataclass(frozen=True)
class Pair:
    """Two trajectories with a known extrinsic (4, 4), or None."""

    name: str
    a: Trajectory
    b: Trajectory
    T_a_b: np.ndarray | None
    consensus: np.ndarray | None
    truth: Truth | None


def load_pairs(data, only):
    """Yield every pair whose name contains ``only``."""
    for folder in sorted((data / 'real').iterdir()):
        if only in folder.name:
            yield from _folder(folder)
    for folder in sorted((data / 'kitti').iterdir()):
        if only in folder.name:
            yield _drive(folder)


def _folder(folder):
    if folder.name in TAGS:
        a, b = _tag_pair(folder)
        t, q = TAGS[folder.name]
        q = np.array(q) / np.linalg.norm(q)
        truth = se3.from_rotation_translation(se3.quaternion_to_rotation(q), t)
        yield Pair(folder.name, a, b, truth, truth, _truth_of(folder.name))
    elif (folder / 'truth.tum').exists():
        a, b = _tum(folder / 'a.tum', 'a'), _tum(folder / 'b.tum', 'b')
        truth = _transform(np.atleast_2d(np.loadtxt(folder / 'truth.tum'))[0, 1:])
        known = _truth_of(folder.name)
        step = np.concatenate([np.zeros(3), np.deg2rad(known.turn)])
        yield Pair(folder.name, a, b, truth, se3.moved(truth, step), known)
    else:
        for other in sorted(folder.glob('INS*.tum')):
            a, b = _tum(other, 'ins'), _tum(folder / 'LO.tum', 'lidar')
            yield Pair(f'{folder.name} {other.stem}', a, b, None, None, None)


def _tag_pair(folder):
    """Return the carrier in its world and the camera in the target's."""
    (a,) = (_csv(path) for path in folder.glob('*.csv') if path.stem.startswith(('hand', 'mark')))
    (camera,) = folder.glob('*camera*.csv')
    # Whatever its name says, either file fits the truth as it is, and not inverted.
    return a, _csv(camera)


def _csv(path):
    rows = [line.replace(',', ' ').split() for line in path.read_text().splitlines()]
    stamps = [_nanoseconds(row[0]) for row in rows]
    values = np.array([[float(word) for word in row[1:8]] for row in rows])
    q = values[:, 3:] / np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
    return Trajectory.from_quaternions(stamps, values[:, :3], q, sensor_frame=path.stem)


def _nanoseconds(text):
    whole, _, part = text.partition('.')
    return int(whole) * 10**9 + int(part[:9].ljust(9, '0'))


def _drive(folder):
    keyframes = 'KeyFrameTrajectory_TUM_Format.txt'
    (truth_file,) = folder.glob('camera*.txt')
    truth = _any_transform(np.loadtxt(truth_file).ravel())
    if folder.name.startswith('2011_09_30'):
        a = _tum(folder / 'LIDAR_HDL64E' / 'traj_HDL_aft_opt.csv', 'lidar')
        b = _tum(folder / 'cam01' / keyframes, 'camera')
        return Pair(folder.name, a, b, truth, truth, _truth_of(folder.name))
    a, b = (_tum(folder / camera / keyframes, camera) for camera in ('cam01', 'cam23'))
    consensus = se3.from_rotation_translation(np.eye(3), RECTIFIED)
    return Pair(folder.name, a, b, truth, consensus, _truth_of(folder.name))


def _tum(path, name):
    return FileSource(path, 'tum', sensor_frame=name).load()


def _transform(values):
    q = values[3:7] / np.linalg.norm(values[3:7])
    return se3.from_rotation_translation(se3.quaternion_to_rotation(q), values[:3])


def _any_transform(values):
    """Return a transform of 16 or 12 numbers, or of 8 with a stamp, or 7."""
    if len(values) in (12, 16):
        T = np.eye(4)
        T.flat[:len(values)] = values
        T[:3, :3] = se3.nearest_rotation(T[:3, :3])
        return T
    return _transform(values[-7:])


def _truth_of(name):
    return next(truth for truth in TRUTHS if re.match(truth.pattern, name))


def errors_of(T_a_b, truth):
    """Return e_at (m) and e_aR (deg)."""
    d = se3.step_between(truth, T_a_b)
    return np.array([np.linalg.norm(d[:3]), np.rad2deg(np.linalg.norm(d[3:]))])


def scores(T_a_b, covariance, truth, metres, degrees):
    """Return NEES / 6 and the (6,) deviations by axis, the truth's own uncertainty added."""
    d = se3.step_between(truth, T_a_b)
    own = np.repeat([metres, np.deg2rad(degrees)], 3)
    P = covariance + np.diag(own**2)
    return d @ np.linalg.solve(P, d) / 6, d / np.sqrt(np.diag(P))


def measure(item):
    """Return one pair's row as a dictionary."""
    pair, rivals = item
    config = CalibrationConfig()
    row = {'pair': pair}
    start = time.process_time()
    try:
        row['result'] = calibrate(pair.a, pair.b, config)
    except CalibrationError as error:
        row['error'] = str(error)
    row['cpu'] = time.process_time() - start
    if rivals and pair.T_a_b is not None:
        try:
            _, pairs = match(pair.a, pair.b, config)
            row['fifteen'] = {
                (name, reference): _solve(name, reference, pairs, config)
                for name in PAPER_SOLVERS for reference in REFERENCES}
            row['peers'] = _peers(pairs)
        except CalibrationError as error:
            row.setdefault('error', str(error))
    return row


def _solve(name, reference, pairs, config):
    try:
        return load_solver(name)(select_motions(pairs, reference), config).T_a_b
    except CalibrationError:
        return None


def _peers(pairs):
    found = {}
    for module, build in (('kinhec', kinhec_methods), ('cv2', opencv_methods)):
        if not installed(module):
            continue
        few = pairs
        if module == 'cv2' and len(pairs) > OPENCV_POSES:
            few = pairs.thinned(-(-len(pairs) // OPENCV_POSES))
        motions = select_motions(few, PEER_REFERENCE)
        # Some of kinhec form matrices of all pairs of motions.
        motions = motions.picked(slice(None, None, -(-len(motions) // PEER_MOTIONS)))
        for name, solve in build().items():
            try:
                T = np.asarray(solve(motions), dtype=float)
            except Exception:  # noqa: BLE001 - a peer raises what it likes
                continue
            if np.isfinite(T).all() and T.shape == (4, 4):
                T = T.copy()
                T[:3, :3] = se3.nearest_rotation(T[:3, :3])
                found[name] = T
    return found


# --- tables ----------------------------------------------------------------------------------


def show_answers(rows):
    """Print errors against both truths, how honest they are, and time."""
    print('| pair | e_at, m | e_aR, deg | NEES / 6 | e_at, consensus | e_aR, consensus | '
          'NEES / 6, a third | z of x, y, z, roll, pitch, yaw | findings | CPU, s |')
    print('|---' * 10 + '|')
    for row in rows:
        pair, result = row['pair'], row.get('result')
        if result is None:
            print(f'| {pair.name} | {row["error"][:90]} |' + ' |' * 7 + f' {row["cpu"]:.2f} |')
            continue
        cells = [pair.name]
        if pair.T_a_b is None:
            yaw = np.rad2deg(np.arctan2(result.T_a_b[1, 0], result.T_a_b[0, 0]))
            stated = np.rad2deg(np.sqrt(result.covariance[5, 5]))
            cells += ['', '', '', f'yaw {yaw:.2f} +- {stated:.2f} deg', '', '', '']
        else:
            metres, degrees = pair.truth.known
            e_at, e_aR = errors_of(result.T_a_b, pair.T_a_b)
            nees, _ = scores(result.T_a_b, result.covariance, pair.T_a_b, metres, degrees)
            c_at, c_aR = errors_of(result.T_a_b, pair.consensus)
            third, z = scores(result.T_a_b, result.covariance, pair.consensus,
                              metres * CONSENSUS_SHARE, degrees * CONSENSUS_SHARE)
            if not pair.truth.nominal:
                row.update(nees=nees, third=third)
            cells += [f'{e_at:.4f}', f'{e_aR:.3f}', f'{nees:.2f}', f'{c_at:.4f}', f'{c_aR:.3f}',
                      f'{third:.2f}', ' '.join(f'{value:+.1f}' for value in z)]
        cells += [str(len(result.warnings)), f'{row["cpu"]:.2f}']
        print('| ' + ' | '.join(cells) + ' |', flush=True)
    for name, title in (('nees', 'truth of the file, its uncertainty added'),
                        ('third', 'consensus, a third of it added')):
        values = np.array([row[name] for row in rows if name in row])
        if len(values):
            print(f'\nNEES / 6, {title}: median {np.median(values):.2f}, more than 4 in '
                  f'{np.sum(values > 4)} of {len(values)}')


def show_scatter(rows):
    """Print how far answers of one mounting are apart, by their stated deviations."""
    alike = [row for row in rows if 'result' in row and row['pair'].truth is not None
             and row['pair'].truth.nominal]
    if len(alike) < 2:
        return
    print('\n| two drives with one mounting (truth nominal) | apart, m | apart, deg | chi2 / 6 |\n'
          '|---|---|---|---|')
    for k, one in enumerate(alike):
        for other in alike[:k]:
            d = se3.step_between(one['result'].T_a_b, other['result'].T_a_b)
            P = one['result'].covariance + other['result'].covariance
            print(f'| {one["pair"].name}, {other["pair"].name} | {np.linalg.norm(d[:3]):.3f} | '
                  f'{np.rad2deg(np.linalg.norm(d[3:])):.3f} | '
                  f'{d @ np.linalg.solve(P, d) / 6:.2f} |')


def spread_scale(pair, T_a_b):
    """Return the scale of b by the spread of positions at common times: no fit of motions.

    S. Umeyama, IEEE PAMI 13(4), 1991: the best similarity of two sets of points.
    """
    _, pairs = match(pair.a, pair.b, CalibrationConfig())
    a = (pairs.poses_a @ T_a_b)[:, :3, 3]
    b = pairs.poses_b[:, :3, 3]
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    U, sizes, Vt = np.linalg.svd(a.T @ b)
    sizes[2] *= np.sign(np.linalg.det(U @ Vt))
    return sizes.sum() / np.sum(b**2)


def show_terms(rows):
    """Print the nuisance terms, and which of them cannot be."""
    print('\n| pair | scale | drift along x, y, z, % | clock offset, ms | clock drift, ppm | '
          'latency, ms | false terms |')
    print('|---' * 7 + '|')
    false_pairs = 0
    for row in rows:
        pair, result = row['pair'], row.get('result')
        if result is None:
            continue
        said = result.diagnosis or {}
        false = _false_terms(pair, result, said)
        false_pairs += bool(false)
        drift = said.get('systematic_drift') or ()
        late = said.get('latency_s')
        scale_std = said.get('scale_deviation')
        print('| ' + ' | '.join([
            pair.name,
            f'{result.scale:.4f}' + ('' if scale_std is None else f' +- {scale_std:.4f}'),
            ' '.join(f'{100 * value:+.2f}' for value in drift),
            f'{1e3 * result.time_offset_s:+.1f}',
            f'{1e6 * result.clock_drift:+.0f}',
            '' if late is None else f'{1e3 * np.max(np.abs(late)):.1f}',
            ', '.join(false)]) + ' |', flush=True)
    print(f'\nFalse terms in {false_pairs} of {sum("result" in row for row in rows)} answers. '
          'A term is false if the drift exceeds 1 %; if both are metric and the scale differs by '
          '3 standard deviations and 1 % from both one and the spread of positions; if both share '
          'a clock and there is an offset beyond 3 standard deviations or any clock drift.')


def _false_terms(pair, result, said):
    """Name terms that a metric pair of one clock does not have."""
    false = []
    drift = np.asarray(said.get('systematic_drift') or [0.0], dtype=float)
    if np.abs(drift).max() > 0.01:
        false.append('drift')
    if pair.truth is None:
        return false
    std = said.get('scale_deviation') or 0.0
    known = (1.0, spread_scale(pair, result.T_a_b))
    if not pair.truth.free_scale and min(
            abs(result.scale - value) for value in known) > max(3 * std, 0.01):
        false.append('scale')
    if pair.truth.clock_s is not None:
        apart = min(abs(result.time_offset_s - known) for known in pair.truth.clock_s)
        std = said.get('time_offset_deviation_s') or 0.0
        if apart > max(3 * std, 1e-4):
            false.append('clock offset')
        if result.clock_drift:
            false.append('clock drift')
    return false


def show_rivals(rows):
    """Print the paper's solvers on the same pairs, and what hindsight makes of them."""
    columns = [(name, reference) for name in PAPER_SOLVERS for reference in REFERENCES]
    print('\n| pair | calibrate() | best of 15 | ratio | '
          + ' | '.join(f'{name} {reference}' for name, reference in columns) + ' |')
    print('|---' * (4 + len(columns)) + '|')
    ratios = []
    for row in rows:
        pair = row['pair']
        if 'fifteen' not in row or pair.truth.nominal:
            continue
        found = {key: np.full(2, np.nan) if T is None else errors_of(T, pair.consensus)
                 for key, T in row['fifteen'].items()}
        best = np.nanmin(list(found.values()), axis=0)
        cells = [pair.name, 'none']
        ratio = np.full(2, np.inf)
        if 'result' in row:
            ours = errors_of(row['result'].T_a_b, pair.consensus)
            ratio = ours / best
            cells[1] = _both(ours)
        ratios.append(ratio)
        cells += [_both(best), f'{ratio[0]:.2f}, {ratio[1]:.2f}']
        cells += [_both(found[key]) for key in columns]
        print('| ' + ' | '.join(cells) + ' |', flush=True)
    if ratios:
        ratios = np.array(ratios)
        middle = np.median(ratios, axis=0)
        print(f'\nAgainst the best of 15 with hindsight (consensus truth; e_at, e_aR): median '
              f'ratio {middle[0]:.2f}, {middle[1]:.2f}; worse than 1.1 times in '
              f'{np.sum(ratios[:, 0] > 1.1)}, {np.sum(ratios[:, 1] > 1.1)} and than 1.5 times in '
              f'{np.sum(ratios[:, 0] > 1.5)}, {np.sum(ratios[:, 1] > 1.5)} of {len(ratios)}')


def show_choices(rows):
    """Print medians over the pairs of every fixed choice, and of the peers."""
    print('\n| method | pairs | median e_at, m | median e_aR, deg |\n|---|---|---|---|')
    found = {}
    for row in rows:
        if 'fifteen' not in row or row['pair'].truth.nominal:
            continue
        consensus = row['pair'].consensus
        if 'result' in row:
            found.setdefault('calibrate()', []).append(
                errors_of(row['result'].T_a_b, consensus))
        named = {f'{name} {reference}': T for (name, reference), T in row['fifteen'].items()}
        for name, T in {**named, **row['peers']}.items():
            if T is not None:
                found.setdefault(name, []).append(errors_of(T, consensus))
    for name, values in found.items():
        e_at, e_aR = np.median(values, axis=0)
        print(f'| {name} | {len(values)} | {e_at:.4f} | {e_aR:.3f} |')
    for module, name in (('kinhec', 'kinhec'), ('cv2', 'OpenCV')):
        if not installed(module):
            print(f'\n{name} is not installed and was left out.')


def show_findings(rows):
    """Print the texts of the findings."""
    print('\n| pair | findings |\n|---|---|')
    for row in rows:
        if 'result' in row and row['result'].warnings:
            texts = '<br>'.join(text.replace('|', '/') for text in row['result'].warnings)
            print(f'| {row["pair"].name} | {texts} |')


def _both(values):
    return f'{values[0]:.3f} m, {values[1]:.2f}'


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path, default=Path('../shared/data'))
    parser.add_argument('--only', default='', help='part of the names of the pairs')
    parser.add_argument('--no-rivals', action='store_true', help='calibrate() alone')
    parser.add_argument('--findings', action='store_true', help='print them too')
    parser.add_argument('--jobs', type=int, default=1)
    arguments = parser.parse_args()
    if not (arguments.data / 'real').is_dir():
        parser.error(f'{arguments.data} holds no folder real: nothing to measure')
    items = [(pair, not arguments.no_rivals)
             for pair in load_pairs(arguments.data, arguments.only)]
    if items:
        # What loads and caches on the first call is no time of the first pair.
        measure((items[0][0], False))
    if arguments.jobs == 1:
        rows = [measure(item) for item in items]
    else:
        with Pool(arguments.jobs) as pool:
            rows = list(pool.imap(measure, items, chunksize=1))
    show_answers(rows)
    show_scatter(rows)
    show_terms(rows)
    if not arguments.no_rivals:
        show_rivals(rows)
        show_choices(rows)
    if arguments.findings:
        show_findings(rows)



if __name__ == '__main__':
    main()
