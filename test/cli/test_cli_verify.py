# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``trajectory_calibration verify``, as a person calls it."""

import json
import shutil

from cli_helpers import make_pair, rows, run, write_pair, write_pair_bag, X
import numpy as np
import pytest

from trajectory_calibration import CalibrationResult
from trajectory_calibration.geometry import se3


def write_noisy(folder, seed, mounted=X, *, planar=False):
    """Write a.tum and b.tum of a drive with noise; return their paths."""
    stamps_ns, poses_a, poses_b = make_pair(planar=planar)
    noise = se3.exp_se3(np.random.default_rng(seed).normal(size=(2, len(stamps_ns), 6))
                        * ([2e-3] * 3 + [1e-3] * 3))
    paths = []
    for name, poses in (('a', poses_a @ noise[0]),
                        ('b', poses_b @ se3.inverse(X) @ mounted @ noise[1])):
        paths.append(folder / f'{name}{seed}.tum')
        paths[-1].write_text('\n'.join(rows(stamps_ns, poses)[1]) + '\n')
    return paths


@pytest.fixture(scope='module')
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp('verify')
    from trajectory_calibration.cli.main import main
    a, b = write_noisy(folder, 1)
    assert main(['calibrate', str(a), str(b), '--frame-a', 'lidar', '--frame-b', 'camera',
                 '--output', str(folder), '--solver', 'dnl', '--quiet']) == 0
    return folder / 'result.yaml'


def test_it_holds_it_moved_and_nobody_can_tell(saved, tmp_path, capsys):
    status, out, _ = run(capsys, 'verify', saved, *write_noisy(tmp_path, 2))
    assert status == 0
    assert out.startswith('holds')
    assert 'smallest shift that would have been noticed: ' in out
    assert '\nwarning: only 7.9 s of common motion' in out
    step = [0.3, 0, 0, 0, 0, 0.1]
    status, out, _ = run(capsys, 'verify', saved, *write_noisy(tmp_path, 3, se3.moved(X, step)))
    assert status == 4
    assert out.startswith('moved by +0.')
    assert 'deg about z' in out
    status, out, _ = run(capsys, 'verify', saved, *write_noisy(tmp_path, 4, planar=True))
    assert status == 3
    assert out.startswith('cannot tell z (needs: ')
    # The verdict names the direction; a prior, which is left out here, is no advice.
    assert 'unobserved' not in out


def test_json_has_the_verdict_and_the_new_result(saved, tmp_path, capsys):
    status, out, _ = run(
        capsys, 'verify', saved, *write_noisy(tmp_path, 2), '--format', 'json')
    found = json.loads(out)
    assert (status, found['exit_status'], found['verdict']) == (0, 0, 'holds')
    assert CalibrationResult.from_dict(found['result']).frame_a == 'lidar'
    # The settings are those of the saved result, unless others are given.
    assert found['result']['solver'] == 'dnl'
    _, out, _ = run(capsys, 'verify', saved, *write_noisy(tmp_path, 2), '--format', 'json',
                    '--solver', 'park')
    assert json.loads(out)['result']['solver'] == 'park'


def test_topics_of_a_bag(tmp_path, capsys):
    bag = write_pair_bag(tmp_path / 'x.mcap')
    topics = '/lidar/odom', '/camera/pose'
    run(capsys, 'calibrate', '--bag', bag, *topics, '--output', tmp_path / 'out')
    other = write_pair_bag(tmp_path / 'y.mcap', count=90)
    status, out, err = run(
        capsys, 'verify', tmp_path / 'out' / 'result.yaml', '--bag', other, *topics)
    assert status == 0, out + err


def test_the_recording_of_the_result_itself_tells_nothing(saved, tmp_path, capsys):
    # Under other names, and with another solver: its errors are the same.
    copies = [shutil.copy(saved.parent / f'{name}1.tum', tmp_path / f'{name}.txt')
              for name in 'ab']
    status, out, _ = run(capsys, 'verify', saved, *copies, '--solver', 'park')
    assert status == 3
    assert out == ('cannot tell: the saved result was made of this recording; give another '
                   'one\n')


def test_files_in_exchange_are_a_question_and_no_movement(saved, tmp_path, capsys):
    a, b = write_noisy(tmp_path, 2)
    status, out, err = run(capsys, 'verify', saved, b, a)
    assert (status, out) == (1, '')
    assert 'are A and B exchanged?' in err
    assert 'the trajectory of lidar, then that of camera' in err
    # A sensor that turned around is no file in exchange.
    around = se3.from_rotation_translation(se3.exp_so3([0, 0, np.pi]), [0, 0, 0])
    assert run(capsys, 'verify', saved, *write_noisy(tmp_path, 3, X @ around))[0] == 4


def test_directions_that_were_not_tested_are_no_plain_success(tmp_path, capsys):
    first, second = tmp_path / 'first', tmp_path / 'second'
    for folder in (first, second):
        folder.mkdir()
    a, b = write_noisy(first, 5, planar=True)
    assert run(capsys, 'calibrate', a, b, '--solver', 'dnl', '--output', tmp_path / 'flat')[0] == 3
    saved = tmp_path / 'flat' / 'result.yaml'
    status, out, _ = run(capsys, 'verify', saved, *write_noisy(second, 6, planar=True))
    assert status == 3
    assert out.splitlines()[0].startswith('holds in 5 of 6 directions')
    assert 'not tested: z (not in the saved result)' in out.splitlines()[0]
    status, out, _ = run(capsys, 'verify', saved, *write_noisy(second, 7, se3.moved(
        X, [0.3, 0, 0, 0, 0, 0.1]), planar=True))
    assert status == 4


def test_what_cannot_be_read_is_an_error(saved, tmp_path, capsys):
    a, b, _ = write_pair(tmp_path)
    assert run(capsys, 'verify', tmp_path / 'none.yaml', a, b)[0] == 1
    assert run(capsys, 'verify', saved, a, tmp_path / 'none.tum')[0] == 1
    assert run(capsys, 'verify', saved, a, a)[0] == 2


def test_settings_that_are_not_here_keep_nobody_from_what_needs_only_the_pose(
        saved, tmp_path, capsys):
    text = saved.read_text(encoding='utf-8').replace('  solver: dnl\n', '  solver: acme\n')
    assert 'solver: acme' in text
    other = tmp_path / 'other.yaml'
    other.write_text(text, encoding='utf-8')
    made_of = [saved.parent / 'a1.tum', saved.parent / 'b1.tum']
    later = write_noisy(tmp_path, 2)
    assert run(capsys, 'export', other, '--as', 'urdf')[0] == 0
    assert run(capsys, 'report', other, *made_of)[0] == 0
    run(capsys, 'calibrate', *later, '--frame-a', 'lidar', '--frame-b', 'camera', '--solver',
        'dnl', '--output', tmp_path / 'later')
    assert run(capsys, 'compare', other, tmp_path / 'later' / 'result.yaml')[0] == 0
    status, _, err = run(capsys, 'verify', other, *later)
    assert (status, err[:36]) == (2, f'error: settings of {other}'[:36])
    assert "solver 'acme' is unknown" in err
    assert run(capsys, 'verify', other, *later, '--solver', 'dnl')[0] == 0
