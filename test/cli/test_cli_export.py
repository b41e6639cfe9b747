# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``trajectory_calibration export``, as a person calls it."""

import json
from pathlib import Path

from cli_helpers import run, write_pair
import numpy as np
import pytest

from trajectory_calibration import CalibrationResult
from trajectory_calibration.geometry import se3
from trajectory_calibration.outputs.exports import EXPORTS
from trajectory_calibration.outputs.extrinsic_file import read_extrinsic


@pytest.fixture(scope='module')
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp('export')
    from trajectory_calibration.cli.main import main
    a, b, _ = write_pair(folder)
    assert main(['calibrate', a, b, '--frame-a', 'lidar', '--frame-b', 'optical', '--output',
                 str(folder), '--solver', 'dnl']) == 0
    return folder / 'result.yaml'


def parse(text, tmp_path):
    (tmp_path / 'x.txt').write_text(text)
    return read_extrinsic(tmp_path / 'x.txt').T_a_b


def test_every_format_is_printed_or_written(saved, capsys, tmp_path):
    for name, exporter in EXPORTS.items():
        path = tmp_path / exporter.file_name
        status, out, err = run(capsys, 'export', saved, '--as', name, '--output', path)
        assert (status, out) == (0, ''), err
        assert f'wrote {path}' in err
        if exporter.is_binary:
            status, _, err = run(capsys, 'export', saved, '--as', name)
            assert status == 2
            assert 'give a file with --output' in err
        else:
            assert run(capsys, 'export', saved, '--as', name)[1] == path.read_text()
        status, _, err = run(capsys, 'export', saved, '--as', name, '--output', path)
        assert status == 2
        assert 'exists; give --force to overwrite' in err
        assert run(capsys, 'export', saved, '--as', name, '--output', path, '--force')[0] == 0


def test_the_help_names_every_direction(capsys):
    out = ' '.join(run(capsys, 'export', '--help')[1].split())
    for name, exporter in EXPORTS.items():
        assert f'{name} ' in out
        assert exporter.sentence in out


def test_inverted_and_under_other_frames(saved, capsys, tmp_path):
    T = CalibrationResult.load(saved).T_a_b
    export = 'export', saved, '--as', 'matrix'
    np.testing.assert_allclose(
        parse(run(capsys, *export, '--invert')[1], tmp_path), se3.inverse(T), atol=1e-12)
    base = '1,2,3,0,0,1.5707963267948966'
    T_base = se3.from_rotation_translation(
        se3.rotation_from_roll_pitch_yaw([0, 0, np.pi / 2]), [1, 2, 3])
    status, out, _ = run(capsys, *export, '--parent', 'base_link', '--parent-transform', base)
    assert 'pose of optical in base_link' in out
    np.testing.assert_allclose(parse(out, tmp_path), T_base @ T, atol=1e-12)
    # Of an optical frame below a link: the link is placed so that the optical frame comes right.
    status, out, _ = run(capsys, *export, '--child', 'camera_link', '--child-transform', base)
    assert status == 0
    np.testing.assert_allclose(parse(out, tmp_path) @ T_base, T, atol=1e-12)
    (tmp_path / 'given.txt').write_text('1 2 3 0 0 1.5707963267948966\n')
    again = run(capsys, *export, '--child', 'camera_link', '--child-transform',
                tmp_path / 'given.txt')[1]
    assert again == out


ROBOT = """<robot name="r"><joint name="l" type="fixed"><parent link="base"/><child link="lidar"/>
<origin xyz="1 0 0"/></joint><joint name="o" type="fixed"><parent link="camera_link"/>
<child link="optical"/><origin xyz="0 0 0.1"/></joint></robot>"""


def test_a_robot_gives_the_transforms(saved, capsys, tmp_path):
    robot = tmp_path / 'robot.urdf'
    robot.write_text(ROBOT)
    T = CalibrationResult.load(saved).T_a_b
    export = 'export', saved, '--as', 'matrix', '--parent-urdf', robot
    status, _, err = run(capsys, *export)
    assert status == 2
    assert 'optical already has the parent camera_link' in err
    assert 'give --child camera_link' in err
    status, out, err = run(capsys, *export, '--child', 'camera_link', '--parent', 'base')
    assert status == 0, err
    expected = np.eye(4)
    expected[0, 3] = 1
    link = np.eye(4)
    link[2, 3] = -0.1
    np.testing.assert_allclose(parse(out, tmp_path), expected @ T @ link, atol=1e-12)
    status, _, err = run(capsys, *export, '--parent', 'nowhere')
    assert status == 1
    assert 'has no link nowhere; it has base, camera_link, lidar, optical' in err


@pytest.mark.parametrize(('options', 'message'), [
    (['--parent', 'base'], 'needs the pose of lidar in it'),
    (['--parent-transform', '0,0,0,0,0,0'], 'needs the name of its frame, --parent FRAME'),
    (['--parent', 'base', '--parent-transform', '1,2'], 'has 2 numbers, needed'),
    (['--parent', 'optical', '--parent-transform', '0,0,0,0,0,0'], 'cannot be its own parent'),
])
def test_wrong_usage_is_named(saved, capsys, options, message):
    status, _, err = run(capsys, 'export', saved, '--as', 'urdf', *options)
    assert status == 2
    assert message in err


def test_an_unobserved_direction_is_flagged_in_every_format(capsys, tmp_path):
    a, b, _ = write_pair(tmp_path, planar=True)
    run(capsys, 'calibrate', a, b, '--output', tmp_path, '--solver', 'drift_aware',
        '--allow-unobserved')
    assert CalibrationResult.load(tmp_path / 'result.yaml').observability.unobserved
    for name, exporter in EXPORTS.items():
        status, out, err = run(
            capsys, 'export', tmp_path / 'result.yaml', '--as', name, '--output',
            Path(tmp_path, exporter.file_name), '--force')
        assert (status, out) == (3, '')
        assert 'unobservable: z of' in err
        if not exporter.is_binary:
            assert 'unobserved' in Path(tmp_path, exporter.file_name).read_text().lower()


def test_an_arbitrary_number_leaves_the_result_only_when_it_is_asked_for(capsys, tmp_path):
    a, b, _ = write_pair(tmp_path, planar=True)
    folder = tmp_path / 'my out'
    status, _, err = run(capsys, 'calibrate', a, b, '--output', folder, '--solver', 'ali')
    assert status == 3
    assert [path.name for path in folder.iterdir()] == ['result.yaml']
    assert err == (
        'not exported: z of sensor_b in sensor_a unobservable. To write it anyway: '
        f"--allow-unobserved, here or in export '{folder}/result.yaml' --as FORMAT\n")
    assert CalibrationResult.load(folder / 'result.yaml').to_dict()['T_a_b']['status'][
        'z'] == 'unobserved'
    for name in EXPORTS:
        export = 'export', folder / 'result.yaml', '--as', name, '--output', tmp_path / 'x'
        status, out, err = run(capsys, *export, '--force')
        assert (status, out) == (1, '')
        assert err.startswith('error: not exported: z of sensor_b in sensor_a unobservable. ')
        assert not (tmp_path / 'x').exists()
    status, out, err = run(
        capsys, 'export', folder / 'result.yaml', '--as', 'urdf', '--allow-unobserved')
    assert status == 3
    assert out.startswith('<!-- UNOBSERVED: z of sensor_b in sensor_a.')


def test_a_ground_truth_that_is_inverted_is_said(capsys, tmp_path):
    a, b, truth = write_pair(tmp_path)
    T = read_extrinsic(truth).T_a_b
    chain = tmp_path / 'camchain.yaml'
    chain.write_text(f'cam1: {{T_cn_cnm1: {se3.inverse(T).tolist()}}}')
    status, out, err = run(
        capsys, 'calibrate', a, b, '--ground-truth', chain, '--solver', 'dnl', '--format', 'json')
    assert status == 0
    assert 'Kalibr, whose T_cn_cnm1 maps points' in err
    assert json.loads(out)['e_at_m'] < 1e-6
