# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""TUM, KITTI and EuRoC files: exact round trips, and what is wrong with a file in one line."""

import bz2
from decimal import Decimal
import gzip
import lzma
from pathlib import Path
import re
import shlex

from bag_writing import make_track
from hypothesis import example, given, HealthCheck, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from trajectory_calibration import ConfigError, SourceError
from trajectory_calibration.cli.main import main
from trajectory_calibration.geometry.se3 import quaternion_to_rotation
from trajectory_calibration.outputs.extrinsic_file import read_extrinsic
from trajectory_calibration.sources.files import FileSource

_SECOND = 10**9


def _tum_rows(stamps_ns, poses):
    return [
        f'{stamp // _SECOND}.{stamp % _SECOND:09d} ' + ' '.join(repr(float(v)) for v in pose)
        for stamp, pose in zip(stamps_ns.tolist(), poses, strict=True)]


def _write(path, lines, end='\n'):
    path.write_text('\n'.join(lines) + end, encoding='utf-8')
    return path


@pytest.fixture
def track():
    return make_track(5)


def _expect(trajectory, track):
    stamps_ns, poses = track
    np.testing.assert_array_equal(trajectory.stamps_ns, stamps_ns)
    np.testing.assert_array_equal(trajectory.positions, poses[:, :3])
    np.testing.assert_allclose(
        trajectory.rotations, quaternion_to_rotation(poses[:, 3:]), atol=1e-12)
    assert trajectory.warnings == ()


def test_tum(tmp_path, track):
    path = _write(tmp_path / 'a.txt', ['# t x y z qx qy qz qw', '', *_tum_rows(*track)])
    trajectory = FileSource(path, sensor_frame='lidar', world_frame='odom').load()
    _expect(trajectory, track)
    assert (trajectory.sensor_frame, trajectory.world_frame) == ('lidar', 'odom')


def test_tum_with_tabs_crlf_and_byte_order_mark(tmp_path, track):
    path = tmp_path / 'a.txt'
    rows = '\r\n'.join(row.replace(' ', '\t') for row in _tum_rows(*track))
    path.write_bytes(b'\xef\xbb\xbf' + rows.encode() + b'\r\n')
    _expect(FileSource(path).load(), track)


@settings(max_examples=50, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.integers(0, 2**62), min_size=2, max_size=20, unique=True))
def test_stamps_are_exact_to_the_nanosecond(tmp_path, stamps):
    stamps_ns = np.array(sorted(stamps))
    _, poses = make_track(len(stamps))
    path = _write(tmp_path / 'a.txt', _tum_rows(stamps_ns, poses))
    np.testing.assert_array_equal(FileSource(path).load().stamps_ns, stamps_ns)


def test_numpy_savetxt_is_read_to_its_last_digit(tmp_path, track):
    stamps_ns, poses = track
    seconds = stamps_ns / _SECOND
    np.savetxt(tmp_path / 'a.txt', np.column_stack([seconds, poses]))
    np.testing.assert_array_equal(
        FileSource(tmp_path / 'a.txt').load().stamps_ns,
        [round(Decimal(value) * _SECOND) for value in seconds.tolist()])


def test_kitti_with_times(tmp_path, track):
    _, poses = track
    R = quaternion_to_rotation(poses[:, 3:])
    matrices = np.concatenate([R, poses[:, :3, None]], axis=2).reshape(-1, 12)
    path = _write(tmp_path / 'poses.txt',
                  [' '.join(repr(v) for v in row) for row in matrices.tolist()])
    times = _write(tmp_path / 'times.txt', [row.split()[0] for row in _tum_rows(*track)])
    _expect(FileSource(path, times=times).load(), track)


def _euroc_rows(stamps_ns, poses, extra=''):
    return [
        f'{stamp},' + ','.join(repr(float(v)) for v in pose[[0, 1, 2, 6, 3, 4, 5]]) + extra
        for stamp, pose in zip(stamps_ns.tolist(), poses, strict=True)]


def test_euroc_has_w_first_and_more_columns(tmp_path, track):
    header = '#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x []'
    path = _write(tmp_path / 'data.csv', [header, *_euroc_rows(*track, extra=',0.1,0.2,0.3')])
    _expect(FileSource(path).load(), track)


def test_euroc_header_that_names_w_last_is_believed(tmp_path, track):
    stamps_ns, poses = track
    rows = [f'{stamp},' + ','.join(repr(float(v)) for v in pose)
            for stamp, pose in zip(stamps_ns.tolist(), poses, strict=True)]
    path = _write(tmp_path / 'data.csv', ['#time,x,y,z,qx,qy,qz,qw', *rows])
    trajectory = FileSource(path).load()
    np.testing.assert_array_equal(trajectory.positions, poses[:, :3])
    assert 'read as ns' in trajectory.warnings[0]


def test_poses_of_a_lost_slam_are_dropped_with_a_count(tmp_path, track):
    rows = _tum_rows(*track)
    rows[1] = rows[1].split()[0] + ' nan nan nan nan nan nan nan'
    rows[3] = rows[3].split()[0] + ' 1 2 inf 0 0 0 1'
    rows.append('1700000009 0 0 0 0 0 0 0')
    trajectory = FileSource(_write(tmp_path / 'a.txt', rows), sensor_frame='cam').load()
    np.testing.assert_array_equal(trajectory.stamps_ns, track[0][[0, 2, 4]])
    assert trajectory.warnings[0].startswith('cam: ')
    assert 'dropped 3 of 6 poses: not finite, or a quaternion of zeros' in trajectory.warnings[0]


@pytest.mark.parametrize('first', ['1 0 0 0', '-1.0 0 -0.0 0'])
def test_quaternions_that_seem_to_begin_with_w_are_said(tmp_path, first):
    rows = [f'1 0 0 0 {first}', '2 1 0 0 0.6 0 0 0.8', '3 2 0 0 0.6 0 0 0.8']
    trajectory = FileSource(_write(tmp_path / 'a.txt', rows), sensor_frame='cam').load()
    assert 'w comes first: add --quaternion-order wxyz' in trajectory.warnings[0]
    trajectory = FileSource(_write(tmp_path / 'a.txt', rows[1:])).load()
    assert trajectory.warnings == ()


@pytest.mark.parametrize(('cut', 'poses'), [(1, 5), (8, 5), (20, 4), (60, 4)])
def test_last_line_cut_off_is_dropped_with_a_warning(tmp_path, track, cut, poses):
    """Unless what is missing is within rounding: the norm of the quaternion tells."""
    text = '\n'.join(_tum_rows(*track))
    path = tmp_path / 'a.txt'
    path.write_text(text[:-cut], encoding='utf-8')
    trajectory = FileSource(path).load()
    assert len(trajectory) == poses
    assert ['line, 5, is cut off: dropped' in note for note in trajectory.warnings] == (
        [] if poses == 5 else [True])


def test_last_line_without_an_end_is_used(tmp_path, track):
    path = _write(tmp_path / 'a.txt', _tum_rows(*track), end='')
    _expect(FileSource(path).load(), track)


@pytest.mark.parametrize(('line', 'message'), [
    ('1 2 3 4 0 0 0', 'line 3: 7 columns, the other lines have 8'),
    ('1 2 3 4 0 0 0 1 9', 'line 3: 9 columns, the other lines have 8'),
    ('1 2 3 x 0 0 0 1', "line 3, column 4: 'x' is no number"),
    ('1 2 3 1_0 0 0 0 1', "line 3, column 4: '1_0' is no number"),
    ('1 2 3 \u00e9 0 0 0 1', 'line 3, column 4: .* is no number'),
    ('1700000000123 2 3 4 0 0 0 1', 'line 3, column 1: .* is out of range'),
    ('1700000000123456789 2 3 4 0 0 0 1', 'line 3, column 1: .* is out of range'),
    ('1 2 3 4 0.5 0 0 0', 'line 3: the norm of the quaternion is 0.5, needed 1'),
    ('1 2 3 4 1e200 0 0 0', 'line 3: the norm of the quaternion is inf'),
])
def test_garbage_names_the_line(tmp_path, track, line, message):
    rows = _tum_rows(*track)
    path = _write(tmp_path / 'a.txt', ['# header', rows[0], line, *rows[2:]])
    with pytest.raises(SourceError, match=message) as caught:
        FileSource(path).load()
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(('content', 'message'), [
    (b'', r'holds no poses \(0 bytes\)'),
    (b'# only a comment\n\n', 'holds no poses'),
    (b'\x7fELF\x02\x00\x01', 'is not text: it holds a zero byte at 5'),
    (b'a,b,c\n', 'holds no poses'),
    (b'<?xml version="1.0"?>\n<robot/>\n', 'is XML; needed a table of poses'),
    (b'[{"x": 1}]\n', 'is JSON; needed a table of poses'),
    (b'header:\n  stamp:\n    sec: 1\n', r'is YAML \(as ros2 topic echo without --csv\); needed'),
    (b'{"x": 1}\n', r'is JSON, but no transforms.json with .* \(frames is missing\)'),
    (b'1 2 3\n', '3 columns and no heading .*: positions without an orientation'),
    (b'%INSPVASA,1;1,2\n' * 3, r'holds no poses \(48 bytes, all of them comments: # % //\)'),
    (b'1.5,1,2,3,1,0,0,0\n', '8 columns .* separated by commas: .*--quaternion-order'),
    (b'1 2 3 4 0 0 0 1\n', 'poses in 1 of 1 row, needed at least 2; record'),
    (b'1 2 3 4 0 0 0 1\n' * 2, '1 pose with a stamp of its own, needed at least 2'),
    (b'nan nan nan nan nan nan nan nan\n' * 3,
     r'poses in 0 of 3 rows, needed at least 2 \(dropped 3 of 3 poses: not finite, or'),
    (b'1 2 3 4 0 0 0 1\n2 nan 3 4 0 0 0 1\n3 4',
     'poses in 1 of 2 rows.*dropped 1 of 2 poses: not finite'),
])
def test_files_that_hold_no_trajectory(tmp_path, content, message):
    path = tmp_path / 'a.txt'
    path.write_bytes(content)
    with pytest.raises(SourceError, match=message) as caught:
        FileSource(path).load()
    assert str(path) in str(caught.value)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(SourceError, match=r'nothing.txt cannot be read: No such file'):
        FileSource(tmp_path / 'nothing.txt').load()
    with pytest.raises(SourceError, match='give the bag with --bag'):
        FileSource(tmp_path).load()
    with pytest.raises(SourceError, match='give the bag with --bag'):
        FileSource(tmp_path / 'x.mcap').load()


def test_seconds_with_commas_are_read_where_the_format_is_said(tmp_path, track):
    path = _write(tmp_path / 'a.csv', [row.replace(' ', ',') for row in _tum_rows(*track)])
    with pytest.raises(SourceError, match='say --quaternion-order xyzw or --quat'):
        FileSource(path).load()
    _expect(FileSource(path, 'tum').load(), track)
    _expect(FileSource(path, quaternion_order='xyzw').load(), track)


@pytest.mark.parametrize('separator', [' ', ','])
@pytest.mark.parametrize('file_format', [None, 'tum'])
def test_a_heading_needs_no_mark(tmp_path, track, separator, file_format):
    rows = ['t x y z qx qy qz qw', *_tum_rows(*track)]
    path = _write(tmp_path / 'a.txt', [row.replace(' ', separator) for row in rows])
    _expect(FileSource(path, file_format).load(), track)


@pytest.mark.parametrize('pack', [gzip.compress, bz2.compress, lzma.compress])
def test_a_compressed_file_is_to_be_unpacked(tmp_path, track, pack):
    path = tmp_path / 'a.tum'
    path.write_bytes(pack('\n'.join(_tum_rows(*track)).encode()))
    with pytest.raises(SourceError, match=r'a\.tum is compressed; unpack it first'):
        FileSource(path).load()


def test_a_workbook_is_to_be_saved_as_csv(tmp_path):
    (tmp_path / 'a.xlsx').write_bytes(b'PK\x03\x04')
    with pytest.raises(SourceError, match=r'a\.xlsx is a workbook; save it as CSV'):
        FileSource(tmp_path / 'a.xlsx').load()


@pytest.mark.parametrize('name', ['/trajectory_a', '/lidar/odometry'])
def test_a_topic_needs_its_bag(tmp_path, name):
    with pytest.raises(SourceError, match='directory; if it is a topic, give its bag with --bag'):
        FileSource(Path(name)).load()
    with pytest.raises(SourceError, match=r'No such file or directory$'):
        FileSource(tmp_path / 'a').load()


def test_format_can_be_forced(tmp_path, track):
    path = _write(tmp_path / 'a.txt', _tum_rows(*track))
    with pytest.raises(SourceError, match='8 columns, KITTI needs at least 12'):
        FileSource(path, 'kitti', times=path).load()
    with pytest.raises(SourceError, match='nanoseconds have no fraction'):
        FileSource(_write(path, ['1.5,1,2,3,1,0,0,0'] * 3), 'euroc').load()


def test_kitti_needs_as_many_times_as_poses(tmp_path):
    pose = '1 0 0 0 0 1 0 0 0 0 1 0'
    path = _write(tmp_path / 'poses.txt', [pose] * 4)
    with pytest.raises(SourceError, match=(
            r'carry no time \(12 columns\); give the file of their times .*--times-a, --times-b')):
        FileSource(path).load()
    with pytest.raises(SourceError, match=r'holds 4 poses and .* 3 times'):
        FileSource(path, times=_write(tmp_path / 't.txt', ['0', '1', '2'])).load()
    with pytest.raises(SourceError, match="line 2, column 1: 'x' is no number"):
        FileSource(path, times=_write(tmp_path / 't.txt', ['0', 'x', '2', '3'])).load()
    with pytest.raises(SourceError, match='carries its own times'):
        tum = _write(tmp_path / 'tum.txt', ['1 2 3 4 0 0 0 1'] * 3)
        FileSource(tum, times=tmp_path / 't.txt').load()


def test_kitti_matrix_that_is_no_rotation(tmp_path):
    path = _write(tmp_path / 'poses.txt', ['1 0 0 0 0 2 0 0 0 0 1 0'] * 3)
    times = _write(tmp_path / 't.txt', ['0', '1', '2'])
    with pytest.raises(SourceError, match='the deviation from a rotation is'):
        FileSource(path, times=times).load()


def test_kitti_without_two_poses(tmp_path):
    path = _write(tmp_path / 'poses.txt', ['1 0 0 0 0 1 0 0 0 0 1 0', 'nan ' * 12] * 2)
    times = _write(tmp_path / 't.txt', ['nan', '1', '2', '3'])
    with pytest.raises(SourceError, match=r'poses in 1 of 4 rows.* \(dropped 3 of 4'):
        FileSource(path, times=times).load()


def test_kitti_cut_off_last_row_leaves_its_time_over(tmp_path):
    path = _write(tmp_path / 'poses.txt', ['1 0 0 0 0 1 0 0 0 0 1 0'] * 3 + ['1 0 0'], end='')
    times = _write(tmp_path / 't.txt', ['0', '1', '2', '3'])
    trajectory = FileSource(path, times=times).load()
    assert len(trajectory) == 3
    assert 'cut off' in trajectory.warnings[0]


@settings(max_examples=200, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=300), st.sampled_from([None, 'tum', 'kitti', 'euroc']))
@example(b'\x93NUMPY', None)
def test_any_bytes_give_a_named_error(tmp_path, content, file_format):
    path = tmp_path / 'a.txt'
    path.write_bytes(content)
    with pytest.raises(SourceError, match=r'a.txt'):
        FileSource(path, file_format, times=path if file_format == 'kitti' else None).load()


@settings(max_examples=100, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 2**31), st.integers(1, 4))
@example(2795, 2)
@example(470, 1)
def test_flipped_bytes_give_a_trajectory_or_a_named_error(tmp_path, seed, flips):
    path = tmp_path / 'a.txt'
    data = bytearray('\n'.join(_tum_rows(*make_track(5))).encode())
    rng = np.random.default_rng(seed)
    for _ in range(flips):
        data[rng.integers(len(data))] ^= rng.integers(1, 256)
    path.write_bytes(data)
    try:
        assert len(FileSource(path).load()) >= 2
    except SourceError as error:
        assert 'a.txt' in str(error)


def test_published_ground_truth(shared_data):
    truth = read_extrinsic(
        shared_data / 'kitti/2011_09_30_drive_0027/camera_gray_left_in_velo_link.txt').T_a_b
    np.testing.assert_array_equal(truth[:3, 3], [0.334, -0.005, -0.076])


def test_the_sample_of_the_readme_runs_on_what_its_commands_make(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    readme = (Path(__file__).parents[2] / 'README.md').read_text(encoding='utf-8')
    (command,) = re.findall(r'^ +trajectory_calibration (simulate .*)$', readme, re.MULTILINE)
    assert main(shlex.split(command)) == 0
    (sample,) = re.findall(r'```python\n(.*?)```', readme, re.DOTALL)
    names = {}
    exec(sample, names)
    truth = read_extrinsic('drive/truth.tum').T_a_b
    assert names['result'].absolute_errors(truth).e_at < 0.05
    assert (names['result'].frame_a, names['result'].frame_b) == ('lidar', 'camera')


def test_a_format_that_is_none_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"'csv' is unknown; needed one of tum, euroc, kitti"):
        FileSource(tmp_path / 'a', 'csv').load()


@pytest.mark.parametrize('word', ['', 'None', 'null', 'NaN', 'N/A'])
def test_fields_without_a_number_are_poses_that_were_lost(tmp_path, word):
    path = tmp_path / 'a.csv'
    rows = ['t,x,y,z,qx,qy,qz,qw', '0,' + ','.join([word] * 7)]
    rows += [f'{k},{k},0,0,0,0,0,1' for k in range(1, 5)]
    path.write_text('\n'.join(rows) + '\n', encoding='utf-8')
    trajectory = FileSource(path).load()
    assert np.array_equal(trajectory.positions[:, 0], [1, 2, 3, 4])
    assert trajectory.findings[0].code == 'poses-lost'


NAMES = 't,x,y,z,qx,qy,qz,qw'


@pytest.mark.parametrize('written', ['{}', '{}Z', '{}+00:00'])
def test_dates_serve_as_times(tmp_path, track, written):
    stamps_ns, poses = track
    rows = [f'{written.format(np.datetime64(int(stamp), "ns"))},{",".join(map(repr, pose))}'
            for stamp, pose in zip(stamps_ns, poses.tolist(), strict=True)]
    path = _write(tmp_path / 'a.csv', [NAMES, *rows, ',0,0,0,0,0,0,1'])
    assert np.array_equal(FileSource(path).load().stamps_ns, stamps_ns)
    path = _write(path, rows)
    with pytest.raises(SourceError, match=r'column 1 is no number \(a date\? Then it is t\)'):
        FileSource(path).load()
    _expect(FileSource(path, columns=NAMES).load(), track)


def test_times_of_day_are_no_dates(tmp_path):
    path = tmp_path / 'a.csv'
    path.write_text('t,x,y,z,qx,qy,qz,qw\n' + ''.join(
        f'10:00:0{k},{k},0,0,0,0,0,1\n' for k in range(5)), encoding='utf-8')
    with pytest.raises(SourceError, match="line 2, column 1: '10:00:00' is no time: seconds"):
        FileSource(path).load()


def test_nanoseconds_from_the_start_ask_for_their_unit(tmp_path):
    path = tmp_path / 'a.txt'
    path.write_text(''.join(f'{k}00000000 {k} 0 0 0 0 0 1\n' for k in range(95)), encoding='utf-8')
    with pytest.raises(SourceError, match='in which unit are the times'):
        FileSource(path).load()
    assert FileSource(path, time_unit='ns').load().duration_s == pytest.approx(9.4)


def test_two_recordings_in_one_file_are_not_rounded_times(tmp_path):
    path = tmp_path / 'a.txt'
    path.write_text(''.join(
        f'{k / 10} {k + more} 0 0 0 0 0 1\n' for more in (0, 500) for k in range(40 + more // 50)),
        encoding='utf-8')
    trajectory = FileSource(path).load()
    assert len(trajectory) == 50
    assert 'time restarted' in ' '.join(trajectory.warnings)
