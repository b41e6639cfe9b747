# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``trajectory_calibration calibrate``: answers, formats, files, and wrong input of every kind."""

from dataclasses import replace
import errno
import json
import os
from pathlib import Path
import sys

from cli_helpers import run, write_pair, write_pair_bag, X
import numpy as np
import pytest
from ruamel.yaml import YAML

from trajectory_calibration import calibrate, CalibrationConfig, CalibrationResult
from trajectory_calibration.cli.options import join_negative_values
from trajectory_calibration.cli.writing import require_new
from trajectory_calibration.errors import ResultError
from trajectory_calibration.geometry import se3
from trajectory_calibration.online.answer import describe
from trajectory_calibration.outputs.extrinsic_file import read_extrinsic
from trajectory_calibration.outputs.screen import format_result, std_texts
from trajectory_calibration.sources.files import FileSource

SOLVER = ('--solver', 'taylor', '--reference', 'B5')


@pytest.fixture
def files(tmp_path):
    return write_pair(tmp_path)


def test_json_is_one_object_with_every_key(files, capsys):
    a, b, truth = files
    status, out, err = run(
        capsys, 'calibrate', a, b, *SOLVER, '--format', 'json', '--ground-truth', truth,
        '--frame-a', 'lidar', '--frame-b', 'camera')
    assert (status, err) == (0, '')
    result = json.loads(out)
    assert {'frame_a', 'frame_b', 'solver', 'reference', 'T_a_b', 'covariance', 'poses', 'motions',
            'e_rt_m', 'e_rR_deg', 'e_at_m', 'e_aR_deg', 'scale', 'time_offset_s', 'observability',
            'warnings'} <= set(result)
    assert (result['frame_a'], result['frame_b'], result['solver']) == (
        'lidar', 'camera', 'taylor')
    assert result['e_at_m'] < 1e-9
    assert result['e_aR_deg'] < 1e-6
    np.testing.assert_allclose(result['T_a_b']['translation'], X[:3, 3], atol=1e-9)
    np.testing.assert_allclose(
        se3.quaternion_to_rotation(result['T_a_b']['rotation_xyzw']), X[:3, :3], atol=1e-9)


def test_yaml_and_json_say_the_same(files, capsys):
    a, b, _ = files
    _, as_json, _ = run(capsys, 'calibrate', a, b, *SOLVER, '--format', 'json')
    status, as_yaml, _ = run(capsys, 'calibrate', a, b, *SOLVER, '--format', 'yaml')
    assert status == 0
    assert YAML(typ='safe', pure=True).load(as_yaml) == json.loads(as_json)
    assert json.loads(as_json)['e_at_m'] is None


def test_text_shows_the_answer_first_then_the_findings(files, tmp_path, capsys):
    a, b, truth = files
    with (tmp_path / 'a.txt').open('a', encoding='utf-8') as stream:
        stream.write('1700000100 nan nan nan nan nan nan nan\n')
    status, out, err = run(capsys, 'calibrate', a, b, *SOLVER, '--ground-truth', truth)
    assert (status, err) == (0, '')
    answer, _, findings = out.partition('\n\n')
    lines = answer.splitlines()
    assert lines[0].startswith('Pose of sensor_b in sensor_a')
    rows = {line.split()[0]: line.split() for line in lines[1:7]}
    assert list(rows) == ['x', 'y', 'z', 'roll', 'pitch', 'yaw']
    assert float(rows['x'][1]) == 0.334
    assert [rows['x'][k] for k in (2, 4, 5, 6)] == ['+-', 'm', 'ok', 'error']
    assert float(rows['z'][1]) == -0.076
    angles = np.rad2deg(se3.roll_pitch_yaw(X[:3, :3]))
    np.testing.assert_allclose([float(rows[name][1]) for name in ('roll', 'pitch', 'yaw')],
                               angles, atol=1e-3)
    assert 'error against the ground truth: 0.0000 m, 0.000 deg' in answer
    assert 'ok: at most 0.05 m, 0.5 deg; weak: more; unknown: not determined' in answer
    assert findings == (f'note: sensor_a: {a}: dropped 1 of 81 poses: not finite, or a '
                        'quaternion of zeros\n')


def test_verbose_tells_the_rest_and_quiet_the_transform_alone(files, capsys):
    a, b, _ = files
    status, out, _ = run(capsys, 'calibrate', a, b, *SOLVER, '-v')
    assert status == 0
    details = dict(line[2:].split('  ', 1) for line in out.splitlines() if line.startswith('  ')
                   and '  ' in line[3:])
    for name, words in (
            ('data', '80 pose pairs (a interpolated at the stamps of b) of 80 and 80 poses, 75'),
            ('method', 'taylor, version'),
            ('fit residual', '0.0000 m, 0.000 deg per motion of 5 poses (not the accuracy)')):
        assert details[name].strip().startswith(words)
    assert 'quaternion' in out
    status, out, err = run(capsys, 'calibrate', a, b, *SOLVER, '-q')
    assert (status, err, out.count('\n')) == (0, '', 1)
    np.testing.assert_allclose(
        np.array(out.split(), dtype=float)[:3], X[:3, 3], atol=1e-8)


@pytest.mark.parametrize('sigma, words', [
    ([0.01, 4.9, 5.0, 0.01, 1.5, np.pi / 2],
     ['0.0100', '4.9000', 'unknown', '0.573', '85.944', 'unknown']),
    ([10.0013, 11690.4, np.nan, 583.8, np.pi, np.nan], ['unknown'] * 6)])
def test_a_deviation_that_means_nothing_is_known_is_no_number(files, sigma, words):
    covariance = np.diag(np.square(sigma))
    assert std_texts(covariance) == words
    a, b = (FileSource(name).load() for name in map(Path, files[:2]))
    result = replace(calibrate(a, b, CalibrationConfig(solver='taylor', reference='B5')),
                     covariance=covariance)
    x, y, z, about_x, about_y, about_z = words
    text = format_result(result, verbose=True)
    assert f'x {x}  y {y}  z {z} m, along the axes of sensor' in text
    assert f'x {about_x}  y {about_y}  z {about_z} deg, about the axes of sensor' in text
    assert (f'[{x}, {y}, {z}] m, about xyz [{about_x}, {about_y}, {about_z}] deg'
            in describe(result))


@pytest.mark.parametrize('angles', [
    (10, 20, 30), (-170, 80, 99), (0, 90, 0), (25, 90, 0), (25, -90, 0), (180, 0, -90)])
def test_roll_pitch_yaw(angles):
    def about(axis, angle):
        return se3.exp_so3(np.deg2rad(angle) * np.eye(3)[axis])

    def compose(roll, pitch, yaw):
        return about(2, yaw) @ about(1, pitch) @ about(0, roll)

    R = compose(*angles)
    np.testing.assert_allclose(compose(*np.rad2deg(se3.roll_pitch_yaw(R))), R, atol=1e-9)


def test_output_folder(files, tmp_path, capsys):
    a, b, _ = files
    folder = tmp_path / 'new' / 'results'
    status, out, _ = run(
        capsys, 'calibrate', a, b, *SOLVER, '--format', 'json', '--output', folder)
    assert status == 0
    names = {item.name for item in folder.iterdir()}
    assert {'T_a_b.txt', 'result.yaml', 'extrinsic.urdf', 'static_transform.sh'} <= names
    saved = CalibrationResult.load(folder / 'result.yaml')
    printed = json.loads(out)
    for name, values in printed['T_a_b'].items():
        assert saved.to_dict()['T_a_b'][name] == pytest.approx(values, abs=1e-12)
    assert {**saved.to_dict(), 'T_a_b': None} == {**printed, 'T_a_b': None}
    np.testing.assert_allclose(read_extrinsic(folder / 'T_a_b.txt').T_a_b, saved.T_a_b, atol=1e-8)
    for truth in ('result.yaml', 'T_a_b.txt'):
        _, out, _ = run(capsys, 'calibrate', a, b, *SOLVER, '--format', 'json',
                        '--ground-truth', folder / truth)
        assert json.loads(out)['e_at_m'] < 1e-8


def test_output_holds_the_errors_against_the_truth(files, tmp_path, capsys):
    a, b, truth = files
    _, out, _ = run(capsys, 'calibrate', a, b, *SOLVER, '--ground-truth', truth,
                    '--output', tmp_path, '--format', 'json')
    saved = YAML(typ='safe', pure=True).load(tmp_path / 'result.yaml')
    assert saved == json.loads(out)
    assert saved['e_at_m'] < 1e-9
    CalibrationResult.load(tmp_path / 'result.yaml')


def no_calibration(*_):
    raise AssertionError('calibrated, although the answer cannot be written')


@pytest.mark.parametrize('option, message', [
    ('--output={a}/below', '{a}/below cannot be made: {a} is a file; give another name'),
    ('--report={a}/x.html', '{a} cannot be made: {a} is a file; give another name'),
    ('--report={folder}', '{folder} cannot be written: it is a folder; give another name'),
    ('--plots={folder}', 'matplotlib is not installed; pip install matplotlib')])
def test_what_cannot_be_written_is_named_before_the_calibration(
        files, tmp_path, monkeypatch, capsys, option, message):
    monkeypatch.setattr('trajectory_calibration.cli.calibrate.calibrate', no_calibration)
    monkeypatch.setitem(sys.modules, 'matplotlib.figure', None)
    names = {'a': files[0], 'folder': tmp_path}
    status, out, err = run(capsys, 'calibrate', *files[:2], *SOLVER, option.format(**names))
    assert (status, out, err) == (1, '', f'error: {message.format(**names)}\n')


@pytest.mark.parametrize('taken', ['result.yaml', 'T_a_b.txt', 'extrinsic.urdf'])
def test_a_folder_in_the_place_of_a_file_leaves_no_part_of_an_answer(
        files, tmp_path, capsys, taken):
    a, b, _ = files
    folder = tmp_path / 'out'
    (folder / taken).mkdir(parents=True)
    assert run(capsys, 'calibrate', a, b, *SOLVER, '--output', folder)[0] == 1
    assert [item.name for item in folder.iterdir()] == [taken]


def test_a_full_disk_takes_no_answer_away(files, tmp_path, monkeypatch, capsys):
    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr('os.fsync', full)
    a, b, _ = files
    status, out, err = run(capsys, 'calibrate', a, b, *SOLVER, '--format', 'json',
                           '--output', tmp_path / 'out')
    assert status == 1
    np.testing.assert_allclose(json.loads(out)['T_a_b']['translation'], X[:3, 3], atol=1e-9)
    assert err == (f'error: {tmp_path}/out/result.yaml cannot be written: No space left on device'
                   '; give another --output\n')
    assert list((tmp_path / 'out').iterdir()) == []


def test_a_reader_that_has_gone_takes_no_files_away(files, tmp_path, monkeypatch, capsys):
    def gone(*_):
        raise BrokenPipeError

    monkeypatch.setattr('trajectory_calibration.cli.calibrate.print_as', gone)
    monkeypatch.setattr('trajectory_calibration.cli.main._discard_output', lambda: None)
    assert run(capsys, 'calibrate', *files[:2], *SOLVER, '--output', tmp_path / 'out')[0] == 0
    assert (tmp_path / 'out' / 'extrinsic.urdf').is_file()


def test_a_file_is_replaced_in_folders_that_can_be_written_to_only(tmp_path, monkeypatch):
    """A file is made anew beside the old one: the permissions of its folder count, not its own."""
    closed, opened = tmp_path / 'closed', tmp_path / 'opened'
    for folder in (closed, opened):
        folder.mkdir()
        (folder / 'x').write_text('')
    (opened / 'link').symlink_to(closed / 'x')
    (closed / 'link').symlink_to(opened / 'x')
    monkeypatch.setattr(os, 'access', lambda path, _: path != closed)
    for path in (closed / 'x', opened / 'link', closed / 'new'):
        with pytest.raises(ResultError, match=f'{closed} cannot be written to'):
            require_new([path], force=True)
    require_new([closed / 'link', opened / 'x', Path(os.devnull)], force=True)


def test_a_report_that_fails_hides_no_reason(files, tmp_path, monkeypatch, capsys):
    def full(*_):
        raise ResultError('disk full')

    monkeypatch.setattr('trajectory_calibration.cli.writing.write_text', full)
    status, out, err = run(capsys, 'calibrate', *files[:2], *SOLVER, '--time-offset', '100',
                           '--report', tmp_path / 'x.html')
    assert (status, out) == (1, '')
    assert err.startswith('no report: disk full\nerror: no overlap in time')


def test_no_export_of_an_earlier_answer_stays_beside_an_open_one(files, tmp_path, capsys):
    out = tmp_path / 'out'
    assert run(capsys, 'calibrate', *files[:2], *SOLVER, '--output', out)[0] == 0
    (out / 'notes.txt').write_text('of a person')
    (tmp_path / 'flat').mkdir()
    a, b, _ = write_pair(tmp_path / 'flat', planar=True)
    status, _, err = run(capsys, 'calibrate', a, b, '--solver', 'ali', '--reference', 'B5',
                         '--output', out, '--force')
    assert status == 3
    assert sorted(path.name for path in out.iterdir()) == ['notes.txt', 'result.yaml']
    assert f'removed from {out}, as of an earlier answer: T_a_b.txt, extrinsic.urdf, ' in err


def test_exports_of_a_person_are_overwritten_with_force_only(files, tmp_path, capsys):
    (tmp_path / 'extrinsic.urdf').write_text('mine')
    assert run(capsys, 'calibrate', *files[:2], *SOLVER, '--output', tmp_path)[0] == 2
    assert (tmp_path / 'extrinsic.urdf').read_text() == 'mine'


def test_the_transform_names_what_was_not_observed(tmp_path, capsys):
    a, b, _ = write_pair(tmp_path, planar=True)
    status, _, _ = run(capsys, 'calibrate', a, b, *SOLVER, '--solver', 'ali',
                       '--allow-unobserved', '--output', tmp_path)
    assert status == 3
    lines = (tmp_path / 'T_a_b.txt').read_text().splitlines()
    assert lines[0].startswith('# UNOBSERVED: z of sensor_b in sensor_a. ')
    np.testing.assert_allclose(
        read_extrinsic(tmp_path / 'T_a_b.txt').T_a_b,
        CalibrationResult.load(tmp_path / 'result.yaml').T_a_b, atol=1e-8)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3', 'ros1'])
def test_topics_of_a_bag(files, tmp_path, capsys, storage):
    bag = write_pair_bag(tmp_path / f'bag{".bag" * (storage == "ros1")}', storage)
    status, out, err = run(
        capsys, 'calibrate', '--bag', bag, '/lidar/odom', '/camera/pose', *SOLVER,
        '--ground-truth', files[2], '--format', 'json')
    assert (status, err) == (0, '')
    result = json.loads(out)
    assert (result['frame_a'], result['frame_b']) == ('lidar', 'camera_pose')
    assert result['e_at_m'] < 1e-9
    _, out, _ = run(capsys, 'calibrate', '--bag', bag, '/lidar/odom', '/camera/pose', *SOLVER,
                    '--frame-a', 'velo', '--frame-b', 'cam0', '--format', 'json')
    assert (json.loads(out)['frame_a'], json.loads(out)['frame_b']) == ('velo', 'cam0')


def test_every_setting_is_an_option_and_changes_the_configuration(files, capsys):
    a, b, _ = files
    given, options = {'solver': 'taylor', 'reference': 'B5'}, []
    for option in CalibrationConfig.options():
        if option.choices:
            value = given.get(option.name, option.choices[-1])
        elif option.kind is bool:
            options.append(f'--{"no-" * option.default}{option.name.replace("_", "-")}')
            given[option.name] = not option.default
            continue
        elif option.kind in (int, float):
            # A value next to the default, inside the range.
            step = 1 if option.kind is int else 1e-3
            up = option.default + step
            value = up if option.maximum is None or up <= option.maximum else up - 2 * step
        else:
            value = given.get(option.name, option.default)
        given[option.name] = value
        options += [f'--{option.name.replace("_", "-")}', str(value)]
    status, out, err = run(
        capsys, 'calibrate', a, b, *options, '--format', 'json', '--association', 'nearest')
    given['association'] = 'nearest'
    assert (status, err) == (0, '')
    assert json.loads(out)['config'] == given


@pytest.mark.parametrize('options', [
    ('--prior-rotation', '-90,0,-90', '--prior-rotation-std', '1'),
    ('--prior-rotation=-90,0,-90', '--prior-rotation-std', '1'),
    ('--prior-translation', '-,-,-0.42', '--prior-translation-std', '1'),
    ('--prior-translation', '-0.1, 0, 0', '--prior-translation-std', '5'),
    ('--time-offset', '-1e-3')])
def test_values_may_begin_with_a_minus(files, capsys, options):
    a, b, _ = files
    status, out, err = run(capsys, 'calibrate', *options, a, b, '--format', 'json', *SOLVER)
    assert (status, err) == (0, '')
    config = json.loads(out)['config']
    given = options[0].partition('=')[2] or options[1]
    assert given in (config['prior_rotation'], config['prior_translation'], '-1e-3')
    assert config['time_offset'] == (-1e-3 if given == '-1e-3' else 0.0)


@pytest.mark.parametrize('given, joined', [
    (['x', '--a-b', '-1,2', 'y'], ['x', '--a-b=-1,2', 'y']),
    (['--a', '-'], ['--a=-']),
    (['--a', '-INF', '-5'], ['--a=-INF', '-5']),
    (['--a=1', '-5'], ['--a=1', '-5']),
    (['--a', '-h', '--b', '--c'], ['--a', '-h', '--b', '--c']),
    (['--', '--a', '-1,2'], ['--', '--a', '-1,2'])])
def test_negative_values_are_joined_to_their_option(given, joined):
    assert join_negative_values(given) == joined


@pytest.mark.parametrize('other', ['./a.txt', 'sub/../a.txt', 'link.txt'])
def test_one_file_under_two_names_is_refused(files, tmp_path, monkeypatch, capsys, other):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'sub').mkdir()
    (tmp_path / 'link.txt').symlink_to(files[0])
    status, out, err = run(capsys, 'calibrate', 'a.txt', other, *SOLVER)
    assert (status, out) == (2, '')
    assert err == (
        f'error: a.txt and {other} are the same; two sensors are needed\n')


def test_configuration_file_and_options_over_it(files, tmp_path, capsys):
    a, b, _ = files
    settings = tmp_path / 'settings.yaml'
    settings.write_text('solver: taylor\nreference: B2\nmax_gap: 2\n', encoding='utf-8')
    _, out, _ = run(capsys, 'calibrate', a, b, '--config', settings, '--reference', 'C4',
                    '--format', 'json')
    config = json.loads(out)['config']
    assert (config['solver'], config['reference'], config['max_gap']) == ('taylor', 'C4', 2.0)


def test_a_saved_result_is_a_configuration(files, tmp_path, capsys):
    a, b, _ = files
    _, first, _ = run(capsys, 'calibrate', a, b, *SOLVER, '--reference', 'B3', '--format', 'json',
                      '--output', tmp_path)
    _, second, _ = run(capsys, 'calibrate', a, b, '--config', tmp_path / 'result.yaml',
                       '--format', 'json')
    assert first == second


@pytest.mark.parametrize(('content', 'message'), [
    ('solvr: dnl', "setting 'solvr' is unknown; did you mean solver?"),
    ('max_gap: -1', 'max_gap is -1.0, needed 0 to 3600'),
    ('max_gap: [1]', 'needed a value of type float'),
    ('- 1', 'holds no settings; needed lines such as'),
    ('a: [', 'cannot be read as settings: while parsing a flow node'),
    ('a: 2023-13-45', 'cannot be read as settings: '),
    ('[' * 1000, 'cannot be read as settings: it is nested too deeply'),
])
def test_wrong_configuration_file(files, tmp_path, capsys, content, message):
    settings = tmp_path / 'settings.yaml'
    settings.write_text(content, encoding='utf-8')
    status, out, err = run(capsys, 'calibrate', *files[:2], '--config', settings)
    assert (status, out) == (2, '')
    assert message in err
    assert err.startswith('error: ')
    assert err.count('\n') == 1


@pytest.mark.parametrize(('arguments', 'status', 'message'), [
    ([], 2, 'the following arguments are required: A, B'),
    (['{a}'], 2, 'the following arguments are required: B'),
    (['{a}', '{b}', '--time-ofset', '1'], 2,
     'error: calibrate takes no option --time-ofset; did you mean --time-offset? See calibrate'),
    (['{a}', '{b}', 'c'], 2, 'error: calibrate takes no argument c. See calibrate --help'),
    (['my x.mcap', '/a', '/b'], 2,
     "error: calibrate takes no argument /b; a bag is an option: --bag 'my x.mcap'. See calibra"),
    (['{a}', '{b}', '--solver', 'magic'], 2, "solver 'magic' is unknown; needed one of dnl"),
    (['{a}', '{b}', '--max-gap', 'x'], 2, "argument --max-gap: invalid float value: 'x'"),
    (['{a}', '{b}', '--max-gap', '-1'], 2, 'error: max_gap is -1.0, needed 0 to 3600'),
    (['{a}', '{b}', '--max-gap', 'nan'], 2, 'error: max_gap is nan, needed'),
    (['{a}', '{b}', '--reference', 'D4'], 2, "error: reference 'D4' is unknown"),
    (['{a}', '{b}', '--config', '{a}.no'], 2,
     'cannot be read as settings: No such file or directory\n'),
    (['{a}', '{a}'], 2, 'error: {a} is given twice; two sensors are needed'),
    (['/x', '/y', '--bag', '{bag}', '--times-a', '{a}'], 2, 'error: times is for files; /x is'),
    (['{a}.no', '{b}'], 1, 'error: {a}.no cannot be read: No such file or directory'),
    (['{bag}', '{b}'], 1, 'give the bag with --bag'),
    (['{a}', '{b}', '--format-a', 'euroc'], 1,
     'error: {a}: nanoseconds have no fraction'),
    (['{a}', '{b}', '--format-a', 'kitti'], 1,
     'error: {a}: 8 columns, KITTI needs at least 12'),
    (['{a}', '{b}', '--times-b', '{a}'], 1, 'error: {b} carries its own times'),
    (['{a}', '{b}', '--ground-truth', '{a}'], 1, 'error: {a} holds 80 rows of 8 numbers'),
    (['{a}', '{b}', '--ground-truth', '{a}.no'], 1, 'error: {a}.no cannot be read'),
    (['{a}', '{b}', '--reference', 'B79'], 1, 'error: reference B79 leaves 1 motion of 80 poses'),
    (['{a}', '{b}', '--time-offset', '100'], 1, 'error: no overlap in time: '),
    (['/lidar/odom', '/nothing', '--bag', '{bag}'], 1,
     'no topic /nothing; usable topics: /camera/pose (PoseStamped, 80 messages), /lidar'),
    (['/lidar/odom', '/words', '--bag', '{bag}'], 1, 'topic /words is std_msgs/msg/String'),
    (['/x', '/y', '--bag', '{a}.no'], 1,
     'error: {a}.no does not exist; needed a rosbag2 folder'),
])
def test_wrong_input(files, tmp_path, capsys, arguments, status, message):
    names = {'a': files[0], 'b': files[1], 'bag': write_pair_bag(tmp_path / 'bag')}
    found, out, err = run(
        capsys, 'calibrate', *SOLVER, *(argument.format(**names) for argument in arguments))
    assert (found, out) == (status, '')
    assert message.format(**names) in err
    assert 'Traceback' not in err
    assert status == 2 or err.count('\n') == 1


def test_motion_about_one_axis_is_status_3(tmp_path, capsys):
    a, b, _ = write_pair(tmp_path, planar=True)
    status, out, err = run(capsys, 'calibrate', a, b, *SOLVER)
    assert (status, err) == (3, '')
    assert next(line.split() for line in out.splitlines() if line.startswith('  z ')) == [
        'z', 'unknown', 'unknown']
    assert 'z of sensor_a unobservable' in out or 'along z of sensor_a' in out
    assert '--prior-translation=' in out


def test_no_motion_is_status_1(tmp_path, capsys):
    a, b, _ = write_pair(tmp_path)
    for name in (a, b):
        lines = Path(name).read_text(encoding='utf-8').splitlines()
        still = [f'{line.split()[0]} 0 0 0 0 0 0 1' for line in lines if not line.startswith('#')]
        Path(name).write_text('\n'.join(still) + '\n', encoding='utf-8')
    status, out, err = run(capsys, 'calibrate', a, b, *SOLVER)
    assert (status, out) == (1, '')
    assert err.startswith('error: ')
    assert 'Drive curves' in err


def test_published_drive(shared_data, capsys):
    drive = shared_data / 'kitti/2011_09_30_drive_0027'
    status, out, _ = run(
        capsys, 'calibrate', drive / 'LIDAR_HDL64E/traj_HDL_aft_opt.csv',
        drive / 'cam01/KeyFrameTrajectory_TUM_Format.txt', *SOLVER,
        '--ground-truth', drive / 'camera_gray_left_in_velo_link.txt', '--format', 'json')
    assert status == 0
    result = json.loads(out)
    # 447 of 449 lie within the time of the lidar, 35 of them between two scans.
    assert result['poses'] == 412
    assert result['association']['between'] == 35
    assert result['e_at_m'] < 0.5
    assert result['e_aR_deg'] < 0.7
