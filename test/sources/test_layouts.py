# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Any layout of a table is read rightly, or refused with the option that reads it."""

from decimal import Decimal
import json
import re

from bag_writing import make_track
from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from trajectory_calibration import ConfigError, SourceError
from trajectory_calibration.geometry import se3
from trajectory_calibration.sources.files import FileSource
from trajectory_calibration.sources.layouts import TIME_UNITS

COUNT = 30
STAMPS_NS, POSES = make_track(COUNT, 5)
T = se3.from_rotation_translation(se3.quaternion_to_rotation(POSES[:, 3:]), POSES[:, :3])
TUM = ('t', 'x', 'y', 'z', 'qx', 'qy', 'qz', 'qw')


def _column(name, unit):
    """Return the values of a column as they may be written."""
    seconds, rest = np.divmod(STAMPS_NS, 10**9)
    if name == 't':
        digits = 9 - TIME_UNITS[unit]
        whole, part = np.divmod(STAMPS_NS, 10**digits)
        return [f'{a}.{b:0{digits}d}' if digits else str(a)
                for a, b in zip(whole, part, strict=True)]
    if name in ('sec', 'nsec', 'number'):
        return list(map(str, {'sec': seconds, 'nsec': rest, 'number': np.arange(COUNT)}[name]))
    if name in TUM:
        return list(map(repr, POSES[:, TUM.index(name) - 1].tolist()))
    if name.startswith('r'):
        return list(map(repr, T[:, int(name[1]) - 1, int(name[2]) - 1].tolist()))
    return list(map(repr, np.random.default_rng(3).uniform(2, 9, COUNT).tolist()))


def _write(path, names, *, separator=' ', heading=None, unit='s'):
    rows = list(zip(*(_column(name, unit) for name in names), strict=True))
    text = '\n'.join(separator.join(row) for row in rows) + '\n'
    path.write_text((f'{heading}\n' if heading else '') + text, encoding='utf-8')
    return path


def _is_right(trajectory):
    np.testing.assert_array_equal(trajectory.stamps_ns, STAMPS_NS)
    np.testing.assert_allclose(trajectory.poses, T, atol=1e-9)
    return True


SPELLINGS = {
    't': ['t', 'time', 'timestamp', 'Timestamp', 'header.stamp', 'time_{unit}',
          'timestamp [{unit}]'],
    **{axis: [f'{axis}', f't{axis}', f'p_{axis}', f'position.{axis}', f'pos_{axis} [m]',
              f'field.pose.pose.position.{axis}'] for axis in 'xyz'},
    **{f'q{axis}': [f'q{axis}', f'q_{axis}', f'orientation.{axis}', f'Q{axis.upper()}',
                    f'q_RS_{axis} []', f'field.pose.pose.orientation.{axis}'] for axis in 'xyzw'},
    'extra': ['id', 'cov_xx', 'v_RS_R_x [m s^-1]', 'twist.linear.x', 'confidence', 'seq'],
    'sec': ['sec', 'secs', 'field.header.stamp.secs'],
    'nsec': ['nsec', 'nanosec', 'field.header.stamp.nsecs'],
}


def _read_with_heading(tmp_path, data):
    time = data.draw(st.sampled_from([('t',), ('sec', 'nsec')]))
    names = data.draw(st.permutations([*time, *TUM[1:]]))
    extras = data.draw(st.lists(st.integers(0, len(names)), max_size=3))
    for place in sorted(extras, reverse=True):
        names.insert(place, 'extra')
    unit = data.draw(st.sampled_from(['s', 'ms', 'us', 'ns']))
    style = data.draw(st.integers(0, 5))
    words, used = [], set()
    for name in names:
        spelling = SPELLINGS[name][style % len(SPELLINGS[name])].format(unit=unit)
        while spelling in used:
            spelling += '_'
        used.add(spelling)
        words.append(spelling)
    separator = data.draw(st.sampled_from([',', ', ', ';', ' ', '\t']))
    if separator in ' \t':
        words = [word.replace(' ', '') for word in words]
    mark = data.draw(st.sampled_from(['', '#', '# ', '%']))
    path = _write(tmp_path / 'a.csv', names, separator=separator,
                  heading=mark + separator.join(words), unit=unit)
    assert _is_right(FileSource(path).load())


def _read_without_heading(tmp_path, data):
    """Never a wrong trajectory in silence: the order of a quaternion is standard or refused."""
    time = data.draw(st.sampled_from([('t',), ('sec', 'nsec'), ()]))
    quaternion = data.draw(st.permutations(TUM[4:]))
    blocks = data.draw(st.permutations([TUM[1:4], quaternion]))
    names = ['number'] * data.draw(st.booleans()) + [*time, *blocks[0], *blocks[1]]
    names += ['extra'] * data.draw(st.integers(0, 3))
    separator = data.draw(st.sampled_from([',', ' ', ';']))
    unit = data.draw(st.sampled_from(['s', 'ms', 'us', 'ns']))
    path = _write(tmp_path / 'a.txt', names, separator=separator, unit=unit)
    columns = ','.join('-' if name in ('extra', 'number') else name for name in names)
    options = {}
    try:
        trajectory = FileSource(path).load()
    except SourceError as error:
        found = re.search(r'(\d+) columns', str(error))
        assert 'times' in str(error) or int(found[1]) == len(names)
        assert any(option in str(error) for option in
                   ('--columns', '--quaternion-order', '--times'))
    else:
        # What is read without a word is standard, or its order is for the user to say.
        standard = {' ': TUM[4:], ',': ('qw', *TUM[4:7]), ';': ('qw', *TUM[4:7])}[separator]
        if 'number' in names and not time:
            assert 'numbers of frames?' in trajectory.warnings[0]
        elif tuple(quaternion) == standard:
            assert _is_right(trajectory)
    if not time:
        options['times'] = _write(tmp_path / 'times.txt', ['t'])
    assert _is_right(FileSource(path, columns=columns, time_unit=unit if 't' in time else None,
                                **options).load())


@pytest.mark.parametrize('read', [_read_with_heading, _read_without_heading])
@settings(max_examples=50, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_layout(tmp_path, read, data):
    read(tmp_path, data)


@pytest.mark.slow
@pytest.mark.parametrize('read', [_read_with_heading, _read_without_heading])
@settings(max_examples=1000, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_thousand_layouts(tmp_path, read, data):
    read(tmp_path, data)


@pytest.mark.parametrize(('names', 'options'), [
    ([*TUM, *['extra'] * 6], {}),
    (['number', *TUM], {}),
    (['sec', 'nsec', *TUM[1:]], {}),
    (['number', 'sec', 'nsec', *TUM[1:]], {}),
    (['t', *(f'r{i}{j}' for i in '123' for j in '1234')], {}),
    (['number', 't', *(f'r{i}{j}' for i in '123' for j in '1234')], {}),
    (['number', *TUM[1:]], {'times': True}),
    (TUM[1:], {'times': True}),
    ([f'r{i}{j}' for i in '123' for j in '1234'], {'times': True}),
    ([*TUM[:4], 'qw', 'qx', 'qy', 'qz'], {'quaternion_order': 'wxyz'}),
    (['t', *(f'r{i}{j}' for i in '123' for j in '123'), 'x', 'y', 'z'],
     {'columns': 't,r11,r12,r13,r21,r22,r23,r31,r32,r33,x,y,z'}),
])
def test_layouts_of_real_tools(tmp_path, names, options):
    if options.get('times'):
        options = {**options, 'times': _write(tmp_path / 'times.txt', ['t'])}
    assert _is_right(FileSource(_write(tmp_path / 'a.txt', names), **options).load())


# What stands above the rows, how a row is written, and the options that are needed.
EXPORTS = {
    'AirSim: tabs, an empty field, semicolons in a name': (
        'VehicleName\tTimeStamp\tPOS_X\tPOS_Y\tPOS_Z\tQ_X\tQ_Y\tQ_Z\tQ_W\tImageFile',
        lambda row: '\t'.join(['', *row, 'a.png;b.png']), {}),
    'tabs, blanks in the names': (
        ('Time [s]\tPosition X [m]\tPosition Y [m]\tPosition Z [m]\tQuaternion W\tQuaternion X'
         '\tQuaternion Y\tQuaternion Z\tIs Valid'),
        lambda row: '\t'.join([*row[:4], row[7], *row[4:7], '1']), {}),
    'Stray Scanner: columns that are empty at the end': (
        't, frame, x, y, z, qx, qy, qz, qw, center_x, center_y',
        lambda row: ', '.join([row[0], '000001', *row[1:], '', '']), {}),
    'a spreadsheet with decimal commas': (
        't;x;y;z;qx;qy;qz;qw', lambda row: ';'.join(row).replace('.', ','), {}),
    'decimal commas between tabs, no heading': (
        '', lambda row: '\t'.join(row).replace('.', ','), {}),
    'OptiTrack Motive: lines above the table': (
        ('Format Version,1.23,Take Name,a\n\n,Type,Rigid Body\n,ID,1,1,1,1,1,1,1,1\n'
         ',,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error\n'
         'Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,'),
        lambda row: ','.join(['7', row[0], *row[4:], *row[1:4], '.0003']),
        {'columns': '-,t,qx,qy,qz,qw,x,y,z'}),
    'Argoverse 2: tx_m': (
        ',timestamp,qx,qy,qz,qw,tx_m,ty_m,tz_m',
        lambda row: ','.join(['7', row[0], *row[4:], *row[1:4]]), {}),
    'PlotJuggler: semicolons in the names': (
        '__time,/o/pose/covariance[0;0],/o/pose/position/x,/o/pose/position/y,/o/pose/position/z,'
        + ','.join(f'/o/pose/orientation/{axis}' for axis in 'xyzw'),
        lambda row: ','.join([row[0], '0.1', *row[1:]]), {}),
    'ros2 topic echo --csv: frames between the numbers': (
        '', lambda row: ','.join([*row[0].split('.'), 'map', 'base_link', *row[1:], *'000']),
        {'quaternion_order': 'xyzw'}),
    'quotes': (
        '"t","x","y","z","qx","qy","qz","qw"',
        lambda row: ','.join(f'"{item}"' for item in row), {}),
    'seconds and nanoseconds by their names': (
        'timestamp_sec,timestamp_nsec,x,y,z,qx,qy,qz,qw',
        lambda row: ','.join([*row[0].split('.'), *row[1:]]), {}),
}


@pytest.mark.parametrize('encoding', ['utf-8', 'utf-16'])
@pytest.mark.parametrize('name', EXPORTS)
def test_tables_as_exporters_write_them(tmp_path, name, encoding):
    above, write, options = EXPORTS[name]
    rows = [write(row) for row in zip(*(_column(item, 's') for item in TUM), strict=True)]
    path = tmp_path / 'a.csv'
    path.write_text('\n'.join([above, *rows]) + '\n', encoding=encoding)
    assert _is_right(FileSource(path, **options).load())


@pytest.mark.parametrize(('heading', 'names', 'message'), [
    ('source_timestamp,destination_timestamp,x,y,z,roll,pitch,yaw',
     't,t,x,y,z,r11,r12,r13', 'names 2 columns for t: source_timestamp, destination_timestamp'),
    ('time,timestamp_ns,x,y,z,qx,qy,qz,qw', 't,t,x,y,z,qx,qy,qz,qw', 'names 2 columns for t'),
    ('stamp,p.x,p.y,p.z,q.x,q.y,q.z,q.w,imu.orientation.x',
     't,x,y,z,qx,qy,qz,qw,r11', 'names 2 columns for qx: q.x, imu.orientation.x'),
    ('frame,x,y,z,qx,qy,qz,qw', 't,x,y,z,qx,qy,qz,qw', 'carry no time'),
    (',x,y,z,qx,qy,qz,qw', 't,x,y,z,qx,qy,qz,qw', 'carry no time'),
    ('Frame,Time,X,Y,Z,W,X,Y,Z,Error', 'number,t,qx,qy,qz,qw,x,y,z,r11', 'the order of'),
])
def test_the_option_that_a_heading_asks_for_reads_the_file(tmp_path, heading, names, message):
    path = _write(tmp_path / 'a.csv', names.split(','), separator=',', heading=heading)
    with pytest.raises(SourceError, match=message) as caught:
        FileSource(path).load()
    columns = re.search(r'--columns ([^\s)]+)', str(caught.value))[1]
    found = FileSource(path, columns=columns).load()
    np.testing.assert_array_equal(found.stamps_ns, STAMPS_NS)
    if 'qx' in columns:
        np.testing.assert_allclose(found.poses, T, atol=1e-9)


def test_two_times_in_microseconds_are_no_seconds_and_nanoseconds(tmp_path):
    times = 200_000_000 + 50_000 * np.arange(COUNT)
    rows = [','.join(map(repr, [time, time - 500, *pose])) for time, pose in
            zip(times.tolist(), POSES.tolist(), strict=True)]
    path = tmp_path / 'vehicle_odometry.csv'
    path.write_text('timestamp,timestamp_sample,position[0],position[1],position[2],q[0],q[1],'
                    'q[2],q[3]\n' + '\n'.join(rows) + '\n', encoding='utf-8')
    with pytest.raises(SourceError, match=r'9 columns .*; no known layout fits'):
        FileSource(path).load()


@pytest.mark.parametrize('unit', ['ms', 'us', 'ns'])
def test_the_size_of_the_times_tells_their_unit(tmp_path, unit):
    trajectory = FileSource(_write(tmp_path / 'a.txt', TUM, unit=unit)).load()
    assert _is_right(trajectory)
    assert f'its times are read as {unit}, judged by their size' in trajectory.warnings[0]


@pytest.mark.parametrize(('columns', 'message'), [
    ('t,x,y,z,qx,qy,qz,qw,a', "'a' is unknown"),
    ('t,x,y,z,qx,qy,qz,qw,-,-', 'names 10 columns, the file has 9'),
    ('t,x,x,z,qx,qy,qz,qw', 'names x twice'),
    ('t,x,y,z,qx,qy,qz', 'names no complete pose'),
])
def test_columns_that_are_none(tmp_path, columns, message):
    path = _write(tmp_path / 'a.txt', [*TUM, 'extra'])
    with pytest.raises(ConfigError, match=message):
        FileSource(path, columns=columns).load()


def test_a_heading_that_names_a_column_twice_is_refused(tmp_path):
    path = _write(tmp_path / 'a.csv', [*TUM, 'x'], separator=',', heading=','.join([*TUM, 'tx']))
    with pytest.raises(SourceError, match='the heading names 2 columns for x: x, tx; say which'):
        FileSource(path).load()


def test_angles_are_read_where_the_user_says_so(tmp_path):
    yaw = np.linspace(0, 1, COUNT)
    rows = [f'{stamp} 0 0 0 0.1 0.2 {angle}' for stamp, angle in
            zip(_column('t', 's'), yaw.tolist(), strict=True)]
    path = tmp_path / 'a.txt'
    path.write_text('\n'.join(rows), encoding='utf-8')
    with pytest.raises(SourceError, match=r'7 columns .* three angles\? .*roll,pitch,yaw .rad'):
        FileSource(path).load()
    R = FileSource(path, columns='t,x,y,z,roll,pitch,yaw').load().rotations
    expected = (se3.exp_so3(np.outer(yaw, [0, 0, 1])) @ se3.exp_so3([0, 0.2, 0])
                @ se3.exp_so3([0.1, 0, 0]))
    np.testing.assert_allclose(R, expected, atol=1e-12)


def test_g2o_colmap_nerfstudio_and_numpy(tmp_path):
    times = _write(tmp_path / 'times.txt', ['t'])
    vertices = [f'VERTEX_SE3:QUAT {k} ' + ' '.join(map(repr, pose))
                for k, pose in enumerate(POSES.tolist())]
    g2o = tmp_path / 'graph.g2o'
    edge = 'EDGE_SE3:QUAT 0 1 ' + '0 ' * 28
    g2o.write_text('\n'.join([edge, *reversed(vertices), edge]), encoding='utf-8')
    assert _is_right(FileSource(g2o, times=times).load())
    # Whatever its name, and what else it begins with.
    g2o.write_text('\n'.join(['PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1', *vertices]), encoding='utf-8')
    g2o = g2o.rename(tmp_path / 'graph.txt')
    assert _is_right(FileSource(g2o, times=times).load())
    with pytest.raises(SourceError, match=r'carry no time \(g2o\); give the file'):
        FileSource(g2o).load()

    inverted = se3.inverse(T)
    q = se3.rotation_to_quaternion(inverted[:, :3, :3])
    lines = ['#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME']
    for k in range(COUNT):
        numbers = [q[k, 3], *q[k, :3], *inverted[k, :3, 3]]
        lines += [f'{k + 1} {" ".join(map(repr, map(float, numbers)))} 1 cam/{STAMPS_NS[k]}.png',
                  '1.0 2.0 -1' if k % 2 else '']
    colmap = tmp_path / 'images.txt'
    colmap.write_text('\n'.join(lines) + '\n', encoding='utf-8')
    assert _is_right(FileSource(colmap).load())

    frames = [{'file_path': f'images/frame_{k:05d}.jpg', 'transform_matrix': T[k].tolist()}
              for k in reversed(range(COUNT))]
    nerfstudio = tmp_path / 'transforms.json'
    nerfstudio.write_text(json.dumps({'frames': frames}), encoding='utf-8')
    assert _is_right(FileSource(nerfstudio, times=times).load())

    np.save(tmp_path / 'poses.npy', T)
    assert _is_right(FileSource(tmp_path / 'poses.npy', times=times).load())
    # An array is one whatever its name.
    (tmp_path / 'poses.npy').rename(tmp_path / 'poses.dat')
    assert _is_right(FileSource(tmp_path / 'poses.dat', times=times).load())


def test_times_of_an_array_are_read_as_it_writes_them(tmp_path):
    np.save(tmp_path / 'a.npy', np.column_stack([0.1 * np.arange(COUNT), POSES]))
    trajectory = FileSource(tmp_path / 'a.npy').load()
    np.testing.assert_array_equal(trajectory.stamps_ns, np.arange(COUNT) * 100_000_000)
    assert trajectory.findings == ()
    np.save(tmp_path / 'a.npy', np.column_stack([STAMPS_NS * 1e-9, POSES]))
    expected = [round(Decimal(repr(stamp)) * 10**9) for stamp in (STAMPS_NS * 1e-9).tolist()]
    assert FileSource(tmp_path / 'a.npy').load().stamps_ns.tolist() == expected


@pytest.mark.parametrize(('name', 'content', 'message'), [
    ('a.json', '{"frames": 3}', 'is JSON, but no transforms.json'),
    ('a.json', '{', 'is JSON, but no transforms.json'),
    ('a.g2o', 'VERTEX_SE2 0 1 2 3\n', 'holds no VERTEX_SE3:QUAT: planar poses cannot be'),
    ('a.npy', 'x', 'cannot be read as an array of numbers'),
    ('images.txt', '# IMAGE_ID CAMERA_ID\n', 'holds no images of COLMAP'),
    ('a.txt', 'version https://git-lfs.github.com/spec/v1\noid sha256:1\n', 'git lfs pull'),
])
def test_structured_files_that_are_none(tmp_path, name, content, message):
    (tmp_path / name).write_text(content, encoding='utf-8')
    with pytest.raises(SourceError, match=message):
        FileSource(tmp_path / name).load()


def test_times_of_kitti_raw_and_of_lists_of_images(tmp_path):
    path = _write(tmp_path / 'poses.txt', [f'r{i}{j}' for i in '123' for j in '1234'])
    dates = np.array(STAMPS_NS, dtype='datetime64[ns]').astype(str)
    times = tmp_path / 'times.txt'
    times.write_text('\n'.join(dates).replace('T', ' ') + '\n', encoding='utf-8')
    assert _is_right(FileSource(path, times=times).load())
    times.write_text('#timestamp [ns],filename\n' + ''.join(
        f'{stamp},{stamp}.png\n' for stamp in STAMPS_NS), encoding='utf-8')
    assert _is_right(FileSource(path, times=times).load())
    times.write_text('frame,time,exposure\n' + ''.join(
        f'{k:05d},{stamp}, 0.01\n' for k, stamp in enumerate(STAMPS_NS)), encoding='utf-8')
    assert _is_right(FileSource(path, times=times).load())


def _unpadded(stamps_ns):
    return [f'{stamp // 10**9}.{stamp % 10**9}' for stamp in stamps_ns.tolist()]


def _tum(path, times, poses=POSES):
    path.write_text('\n'.join(
        f'{time} {" ".join(map(repr, pose))}' for time, pose in
        zip(times, poses.tolist(), strict=True)) + '\n', encoding='utf-8')
    return path


def test_fractions_without_leading_zeros_are_repaired(tmp_path):
    trajectory = FileSource(_tum(tmp_path / 'a.txt', _unpadded(STAMPS_NS))).load()
    assert _is_right(trajectory)
    assert [found.code for found in trajectory.findings] == ['stamps-unpadded']


@pytest.mark.parametrize('digits', [1, 3, 6, 9])
@pytest.mark.parametrize('rate', [1, 7, 50])
def test_fractions_without_trailing_zeros_are_not(tmp_path, digits, rate):
    stamps_ns = np.round(STAMPS_NS[0] + np.arange(COUNT) * 10**9 / rate).astype(np.int64)
    stamps_ns = stamps_ns // 10**(9 - digits) * 10**(9 - digits)
    if len(np.unique(stamps_ns)) < COUNT:
        pytest.skip('the rounding makes some equal')
    times = [f'{stamp // 10**9}.{stamp % 10**9:09d}'.rstrip('0') for stamp in stamps_ns.tolist()]
    trajectory = FileSource(_tum(tmp_path / 'a.txt', times)).load()
    np.testing.assert_array_equal(trajectory.stamps_ns, stamps_ns)
    assert trajectory.warnings == ()


@pytest.mark.parametrize(('digits', 'message'), [
    (6, r'all 30 poses have the same time, 1.7e\+09 s; needed the time of each pose'),
    (9, (r'26 of 30 poses share their time with another: two sensors in one, or the times are '
         r'rounded to 1 s \(10 digits\); write them with nine decimals'))])
def test_times_that_were_rounded_are_named(tmp_path, digits, message):
    times = [f'{stamp * 1e-9:.{digits}e}' for stamp in STAMPS_NS.tolist()]
    with pytest.raises(SourceError, match=message):
        FileSource(_tum(tmp_path / 'a.txt', times)).load()


def test_rows_that_are_repeated_as_a_whole_are_harmless(tmp_path):
    path = _tum(tmp_path / 'a.txt', _column('t', 's'))
    path.write_text(path.read_text(encoding='utf-8') * 2, encoding='utf-8')
    assert _is_right(FileSource(path).load())


@pytest.mark.parametrize('form', ['{:d}', '{:.4f}', '{:.18e}'])
def test_numbers_of_frames_are_asked_about_and_serve_with_times(tmp_path, form):
    path = _tum(tmp_path / 'a.txt', map(form.format, range(COUNT)))
    found = FileSource(path).load().findings
    assert [item.code for item in found] == ['stamps-are-numbers']
    assert 'are its times 0, 1, 2, ... numbers of frames?' in found[0].text
    assert _is_right(FileSource(path, times=_write(tmp_path / 'times.txt', ['t'])).load())


def test_rows_of_the_identity_far_from_their_neighbours_are_dropped(tmp_path):
    poses = POSES.copy()
    poses[:, :3] = np.linspace([0, 0, 0], [30, 5, 0], COUNT)
    start = poses.copy()
    start[0, 3:], start[[11, 12, 20]] = [0, 0, 0, 1], [0, 0, 0, 0, 0, 0, 1]
    trajectory = FileSource(_tum(tmp_path / 'a.txt', _column('t', 's'), start)).load()
    np.testing.assert_array_equal(
        trajectory.stamps_ns, np.delete(STAMPS_NS, [11, 12, 20]))
    assert 'dropped 3 of 30 poses: identity, far from the neighbours' in trajectory.warnings[0]


@pytest.mark.parametrize(('heading', 'factor'), [
    ('time,x,y,z,roll_deg,pitch_deg,yaw_deg', 180 / np.pi),
    ('time [s],x [m],y [m],z [m],roll [deg],pitch [deg],yaw [deg]', 180 / np.pi),
    ('time,x,y,z,roll_rad,pitch_rad,yaw_rad', 1.0),
    ('time [s],x [m],y [m],z [m],roll [rad],pitch [rad],yaw [rad]', 1.0),
])
def test_angles_whose_unit_the_heading_says(tmp_path, heading, factor):
    angles = np.array([[0.1, -0.2, 0.3], [0.2, 0.1, 2.9]])
    rows = [f'{k},1,2,3,' + ','.join(map(repr, row)) for k, row in enumerate(
        (factor * angles).tolist())]
    path = tmp_path / 'a.csv'
    path.write_text('\n'.join([heading, *rows]) + '\n', encoding='utf-8')
    read = FileSource(path).load()
    for R, (roll, pitch, yaw) in zip(read.rotations, angles, strict=True):
        x, y, z = (se3.exp_so3(angle * axis) for angle, axis in zip(
            (roll, pitch, yaw), np.eye(3), strict=True))
        np.testing.assert_allclose(R, z @ y @ x, atol=1e-12)


def test_a_rotation_vector_is_read_where_the_user_says_so(tmp_path):
    vectors = se3.log_so3(T[:, :3, :3])
    rows = [','.join(map(repr, [stamp, *w, *p])) for stamp, w, p in zip(
        STAMPS_NS.tolist(), vectors.tolist(), POSES[:, :3].tolist(), strict=True)]
    path = tmp_path / 'a.csv'
    path.write_text('time,rx,ry,rz,x,y,z\n' + '\n'.join(rows) + '\n', encoding='utf-8')
    with pytest.raises(SourceError, match=(
            r'--columns t,rx,ry,rz,x,y,z \(a .* or --columns t,roll,pitch,yaw,x,y,z')):
        FileSource(path).load()
    assert _is_right(FileSource(path, columns='t,rx,ry,rz,x,y,z').load())


def test_angles_without_a_unit_are_refused_with_both_options(tmp_path):
    path = tmp_path / 'a.csv'
    path.write_text('time,x,y,z,roll,pitch,yaw\n0,1,2,3,.1,.2,.3\n1,1,2,3,.1,.2,.4\n',
                    encoding='utf-8')
    with pytest.raises(SourceError, match='without their unit') as refused:
        FileSource(path).load()
    for columns in re.findall(r'--columns (\S+)', str(refused.value)):
        assert len(FileSource(path, columns=columns).load()) == 2
