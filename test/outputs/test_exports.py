# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Every export holds the same transform, in the direction of its sentence."""

import io
import json
import re
import shlex
import sys
from types import ModuleType, SimpleNamespace

from motion_data import random_pose
import numpy as np
import pytest

from trajectory_calibration import ConfigError, ResultError, SourceError
from trajectory_calibration.config.yaml_file import parse_yaml
from trajectory_calibration.geometry import se3
from trajectory_calibration.outputs.exports import EXPORTS, write_exports
from trajectory_calibration.outputs.extrinsic_file import (
    parse_transform,
    read_extrinsic,
    transform_of,
)
from trajectory_calibration.outputs.frame_tree import FrameTree
from trajectory_calibration.outputs.placement import Placement

# Names that are special in YAML, XML, a shell, xacro or Python.
NAMES = [('lidar', 'camera'), ('off', 'y'), ('1:30', '2020-01-01'), ("a'b", 'c"d'), ('<a>', '&b'),
         ('a b', '#c'), ('é', 'a--b'), ('${x}', '$y'), ('\\n', 'c:d')]


def poses():
    rng = np.random.default_rng(0)
    yield from (random_pose(rng) for _ in range(5))
    yield np.eye(4)
    # Pitch near and at 90 degrees, an optical frame, numbers that need an exponent.
    for rpy in ([0.3, np.pi / 2, -1.0], [0.3, np.pi / 2 - 1e-9, 2.0], [-np.pi / 2, 0, -np.pi / 2],
                [1e-7, -3e-9, 1e-5]):
        yield se3.from_rotation_translation(
            se3.rotation_from_roll_pitch_yaw(rpy), [1e-5, -2e-7, 12345.678])


def item(T, parent='lidar', child='camera', **more):
    return Placement(parent, child, T, **more)


def yaml_1_1(text):
    return pytest.importorskip('yaml').safe_load(text)


def yaml_1_2(text):
    return parse_yaml(text, 'test', ResultError)


def from_xyz_rpy(xyz, rpy):
    return se3.from_rotation_translation(se3.rotation_from_roll_pitch_yaw(rpy), xyz)


def from_publisher(arguments):
    given = dict(zip(arguments[::2], arguments[1::2], strict=True))
    q = np.array([float(given[f'--q{name}']) for name in 'xyzw'])
    assert abs(np.linalg.norm(q) - 1) < 1e-12
    T = se3.from_rotation_translation(
        se3.quaternion_to_rotation(q), [float(given[f'--{name}']) for name in 'xyz'])
    return T, given['--frame-id'], given['--child-frame-id']


def command(text):
    """Return the arguments as a shell splits them, comments left out."""
    words = shlex.split(text, comments=True)
    assert words[:4] == ['ros2', 'run', 'tf2_ros', 'static_transform_publisher']
    return words[4:]


@pytest.mark.parametrize('T', poses())
def test_all_formats_hold_one_transform(T):
    out = {name: exporter.write(item(T)) for name, exporter in EXPORTS.items()
           if not exporter.is_binary}
    found = {
        'npy': np.load(io.BytesIO(EXPORTS['npy'].encode(item(T)))),
        'matrix': np.loadtxt(out['matrix'].splitlines()),
        'json': np.array(json.loads(out['json'])['T_parent_child']),
        'yaml': np.array(yaml_1_2(out['yaml'])['T_parent_child']),
        'static-tf': from_publisher(command(out['static-tf']))[0],
        'kalibr': se3.inverse(np.array(yaml_1_2(out['kalibr'])['cam1']['T_cn_cnm1'])),
    }
    for name in ('npy', 'matrix', 'json', 'yaml'):
        np.testing.assert_array_equal(found[name], T, name)
    pose = yaml_1_2(out['autoware'])['lidar']['camera']
    found['autoware'] = from_xyz_rpy(
        [pose[k] for k in 'xyz'], [pose[k] for k in ('roll', 'pitch', 'yaw')])
    row = np.loadtxt(out['tum'].splitlines())
    found['tum'] = se3.from_rotation_translation(se3.quaternion_to_rotation(row[4:]), row[1:4])
    joint = re.search(r'xyz="(.*?)" rpy="(.*?)"', out['urdf'])
    found['urdf'] = from_xyz_rpy(*(np.array(group.split(), float) for group in joint.groups()))
    for name, other in found.items():
        # The translation of Kalibr's inverse, rotated twice, has the rounding of 12 km.
        np.testing.assert_allclose(other, T, atol=1e-12, rtol=1e-14, err_msg=name)


@pytest.mark.parametrize(('parent', 'child'), NAMES)
def test_no_name_breaks_a_format(parent, child):
    T = next(poses())
    out = {name: exporter.write(item(T, parent, child, unobserved=(f'z of {child} in {parent}',),
                                     origin='--'))
           for name, exporter in EXPORTS.items() if not exporter.is_binary and name != 'xacro'}
    for read in (yaml_1_1, yaml_1_2):
        data = read(out['yaml'])
        assert (data['parent'], data['child']) == (parent, child)
        assert data['unobserved'] == [f'z of {child} in {parent}']
        np.testing.assert_array_equal(data['T_parent_child'], T)
        assert list(read(out['autoware'])) == [parent]
        assert list(read(out['autoware'])[parent]) == [child]
        np.testing.assert_allclose(
            read(out['kalibr'])['cam1']['T_cn_cnm1'], se3.inverse(T), atol=1e-15)
    assert from_publisher(command(out['static-tf']))[1:] == (parent, child)
    joint = FrameTree.parse(out['urdf'], 'x').joints[child]
    assert (joint.parent, joint.child) == (parent, child)
    assert json.loads(out['json'])['child'] == child
    for name, text in out.items():
        assert 'unobserved' in text.lower(), name


@pytest.mark.parametrize(('parent', 'child'), NAMES)
def test_the_launch_file_publishes_it(monkeypatch, parent, child):
    started = []
    launch, actions = ModuleType('launch'), ModuleType('launch_ros.actions')
    launch.LaunchDescription = started.extend
    actions.Node = SimpleNamespace
    monkeypatch.setitem(sys.modules, 'launch', launch)
    monkeypatch.setitem(sys.modules, 'launch_ros', ModuleType('launch_ros'))
    monkeypatch.setitem(sys.modules, 'launch_ros.actions', actions)
    names = {}
    T = next(poses())
    exec(EXPORTS['launch'].write(item(T, parent, child)), names)
    names['generate_launch_description']()
    (node,) = started
    assert (node.package, node.executable) == ('tf2_ros', 'static_transform_publisher')
    found, *frames = from_publisher(node.arguments)
    np.testing.assert_allclose(found, T, atol=1e-12)
    assert frames == [parent, child]


@pytest.mark.parametrize('T', poses())
def test_urdf_through_its_own_parser(T):
    parser = pytest.importorskip('urdf_parser_py.urdf', reason='urdf_parser_py is not installed')
    robot = parser.URDF.from_xml_string(
        f'<robot name="r"><link name="lidar"/>{EXPORTS["urdf"].write(item(T))}</robot>')
    joint = robot.joint_map['lidar_to_camera']
    assert (joint.parent, joint.child, joint.type) == ('lidar', 'camera', 'fixed')
    np.testing.assert_allclose(from_xyz_rpy(joint.origin.xyz, joint.origin.rpy), T, atol=1e-12)


@pytest.mark.parametrize(('parent', 'child'), [
    *NAMES[:2], ('é', 'a--b'), ('/robot1/lidar', 'c.d')])
def test_xacro_expands_to_it(tmp_path, parent, child):
    xacro = pytest.importorskip('xacro', reason='xacro is not installed')
    T = next(poses())
    text = EXPORTS['xacro'].write(item(T, parent, child))
    (tmp_path / 'mount.xacro').write_text(text, encoding='utf-8')
    macro = re.search(r'call &lt;xacro:(\w+)|call <xacro:(\w+)', text)
    name = macro[1] or macro[2]
    (tmp_path / 'robot.xacro').write_text(
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        f'<xacro:include filename="{tmp_path}/mount.xacro"/><xacro:{name}/></robot>')
    expanded = xacro.process_file(str(tmp_path / 'robot.xacro')).toxml()
    joint = FrameTree.parse(expanded, 'x').joints[child]
    assert joint.parent == parent
    np.testing.assert_allclose(joint.T_parent_child, T, atol=1e-12)


@pytest.mark.parametrize('T', poses())
@pytest.mark.parametrize('name', [
    'urdf', 'matrix', 'npy', 'json', 'yaml', 'tum', 'autoware', 'kalibr'])
def test_what_is_written_reads_back(tmp_path, T, name):
    exporter = EXPORTS[name]
    path = tmp_path / exporter.file_name
    path.write_bytes(exporter.encode(item(T)))
    np.testing.assert_allclose(read_extrinsic(path).T_a_b, T, atol=1e-11, rtol=1e-14)


def test_a_folder_of_all(tmp_path):
    written = write_exports(item(np.eye(4)), tmp_path / 'new' / 'folder')
    assert len({path.name for path in written}) == len(EXPORTS)
    assert all(path.stat().st_size for path in written)
    (tmp_path / 'file').write_text('')
    with pytest.raises(ResultError, match='cannot be made: File exists'):
        write_exports(item(np.eye(4)), tmp_path / 'file')


def test_a_name_that_xacro_cannot_hold_is_refused(tmp_path):
    for name in ('a b', '$y', "a'"):
        with pytest.raises(ConfigError, match='xacro cannot hold the frame name'):
            EXPORTS['xacro'].write(item(np.eye(4), name))
    write_exports(item(np.eye(4)), tmp_path)
    assert len(write_exports(item(np.eye(4), 'a b'), tmp_path)) == len(EXPORTS) - 1
    # The file of the earlier frames is removed.
    assert not (tmp_path / 'extrinsic.xacro').exists()


def test_two_frames_of_one_name_are_refused():
    with pytest.raises(ConfigError, match='cannot be its own parent'):
        EXPORTS['urdf'].write(item(np.eye(4), 'lidar', 'lidar'))
    with pytest.raises(ConfigError, match='binary'):
        EXPORTS['npy'].write(item(np.eye(4)))


def sampled(P, T, change):
    """Return the covariance of ``change`` applied to random poses with covariance P about T."""
    rng = np.random.default_rng(0)
    steps = rng.multivariate_normal(np.zeros(6), P, 20000)
    moved = np.array([change(pose) for pose in se3.moved(T, steps)])
    return np.cov(se3.step_between(change(T), moved).T)


@pytest.mark.parametrize('which', ['inverted', 'with_parent', 'with_child'])
def test_a_covariance_moves_with_the_frames(which):
    rng = np.random.default_rng(1)
    T, other = random_pose(rng), random_pose(rng)
    root = rng.normal(size=(6, 6)) * 1e-3
    P = root @ root.T
    placed = Placement('a', 'b', T, P)
    found, change = {
        'inverted': (placed.inverted(), se3.inverse),
        'with_parent': (placed.with_parent('base', other), lambda X: other @ X),
        'with_child': (placed.with_child('link', other), lambda X: X @ se3.inverse(other)),
    }[which]
    np.testing.assert_allclose(found.T_parent_child, change(T), atol=1e-14)
    spread = sampled(P, T, change)
    scale = np.sqrt(np.outer(np.diag(spread), np.diag(spread)))
    np.testing.assert_allclose(found.covariance / scale, spread / scale, atol=0.05)


ROBOT = """<?xml version="1.0"?>
<robot name="r">
  <link name="base_link"/><link name="lidar"/><link name="camera_link"/><link name="optical"/>
  <joint name="l" type="fixed"><parent link="base_link"/><child link="lidar"/>
    <origin xyz="1 0 0.5" rpy="0 0 1.5707963267948966"/></joint>
  <joint name="c" type="fixed"><parent link="base_link"/><child link="camera_link"/>
    <origin xyz="0 2 0"/></joint>
  <joint name="o" type="fixed"><parent link="camera_link"/><child link="optical"/>
    <origin rpy="-1.5707963267948966 0 -1.5707963267948966"/></joint>
  <joint name="w" type="continuous"><parent link="base_link"/><child link="wheel"/></joint>
</robot>"""


def test_fixed_joints_are_chained():
    tree = FrameTree.parse(ROBOT, 'robot.urdf')
    up = tree.transform('base_link', 'optical')
    np.testing.assert_allclose(up[:3, 3], [0, 2, 0])
    # The z axis of an optical frame points forward.
    np.testing.assert_allclose(up[:3, 2], [1, 0, 0], atol=1e-15)
    across = tree.transform('lidar', 'optical')
    np.testing.assert_allclose(across, se3.inverse(tree.transform('base_link', 'lidar')) @ up)
    np.testing.assert_allclose(tree.transform('optical', 'lidar'), se3.inverse(across), atol=1e-15)
    for frames, message in ((('lidar', 'wheel'), 'continuous'), (('lidar', 'imu'), 'no link imu')):
        with pytest.raises(SourceError, match=message):
            tree.transform(*frames)


T_01 = se3.from_rotation_translation(
    se3.rotation_from_roll_pitch_yaw([0.1, -0.2, 0.3]), [0.5, -0.25, 0.125])
KITTI = 'calib_time: 15-Mar-2012 11:37:16\nR: {}\nT: {}\ndelta_f: 0 0\n'.format(
    ' '.join(map(repr, se3.inverse(T_01)[:3, :3].ravel().tolist())),
    ' '.join(map(repr, se3.inverse(T_01)[:3, 3].tolist())))


@pytest.mark.parametrize(('name', 'text', 'how'), [
    ('x.txt', '\n'.join(' '.join(map(repr, row)) for row in T_01.tolist()), 'pose of b in a'),
    ('x.txt', '\n'.join(','.join(map(repr, row)) for row in T_01[:3].tolist()), 'pose of b in a'),
    ('x.txt', ' '.join(map(repr, T_01[:3].ravel().tolist())), 'pose of b in a'),
    ('x.txt', '0.5 -0.25 0.125 0.1 -0.2 0.3', 'pose of b in a'),
    *(('x.txt', f'# b in a\n{stamp}0.5 -0.25 0.125 ' + ' '.join(
        map(repr, se3.rotation_to_quaternion(T_01[:3, :3]).tolist())), 'pose of b in a')
      for stamp in ('', '0 ')),
    ('x.urdf', '<origin xyz="0.5 -0.25 0.125" rpy="0.1 -0.2 0.3"/>', 'URDF'),
    ('calib_velo_to_cam.txt', KITTI, 'KITTI.*inverted'),
    ('calib.txt', 'P0: 1 0 0 0 0 1 0 0 0 0 1 0\nTr: ' + ' '.join(
        map(repr, se3.inverse(T_01)[:3].ravel().tolist())), 'KITTI.*inverted'),
    ('cam.txt', KITTI.replace('R:', 'R_02:').replace('T:', 'T_02:') + 'R_00: 1 0 0 0 1 0 0 0 1\n'
     'T_00: 0 0 0\n', 'KITTI'),
    ('camchain.yaml', f'cam0: {{}}\ncam1:\n  T_cn_cnm1: {se3.inverse(T_01).tolist()}', 'Kalibr'),
    ('kit.yaml', 'base: {s: {x: 0.5, y: -0.25, z: 0.125, roll: 0.1, pitch: -0.2, yaw: 0.3}}',
     'Autoware'),
])
def test_a_known_extrinsic_is_read(tmp_path, name, text, how):
    (tmp_path / name).write_text(text + '\n')
    found = read_extrinsic(tmp_path / name)
    np.testing.assert_allclose(found.T_a_b, T_01, atol=1e-12)
    assert re.search(how, found.how)


@pytest.mark.parametrize(('name', 'text', 'message'), [
    ('x.txt', '', 'holds no numbers, needed one transform'),
    ('x.txt', '1 2 3', 'holds 1 row of 3 numbers'),
    ('x.txt', 'hello', 'holds no transform'),
    ('x.txt', '1 2 3 0 0 0 1\n1 2 3 0 0 0 1', 'holds 2 rows of 7 numbers, needed one transform'),
    ('x.txt', '1 2 3 0 0 0 x', 'holds no transform'),
    ('x.txt', '1 2 nan 0 0 0 1', 'needed x,y,z'),
    ('x.txt', '1 0 0 0\n0 1 0 0\n0 0 2 0\n0 0 0 1', 'no rotation'),
    ('x.txt', '0 0 0 0 0 0 2', 'norm 2, needed 1'),
    ('x.txt', 'R: 1 2\nT: 1 2 3', 'R has 2 numbers, needed 9'),
    ('x.txt', 'P0: 1 0 0 0 0 1 0 0 0 0 1 0', 'holds 0 transforms'),
    ('x.yaml', 'a: 5', 'holds no transform'), ('x.yaml', '[1]', 'holds no transform'),
    ('x.yaml', 'cam1: {T_cn_cnm1: 5}', 'needed 4 x 4'),
    ('x.yaml', 'T_a_b: {translation: [0, 0, 0]}', ' is missing'),
    ('x.yaml', 'b: {s: {x: 0}}', ' is missing'),
    ('x.yaml', f'cam1: {{T_cn_cnm1: [{"9" * 400}]}}', 'too large to convert'),
    ('x.urdf', '<robot/>', 'no <joint>'), ('x.urdf', '<a', 'cannot be read as URDF'),
    ('x.urdf', '<origin xyz="${x} 0 0"/>', 'xacro must be expanded'),
    ('x.urdf', ROBOT, 'holds 4 joints, needed one: append #JOINT'),
    ('x.bin', '\x00\xff', 'no transform'),
])
def test_other_files_are_named(tmp_path, name, text, message):
    (tmp_path / name).write_text(text, encoding='utf-8')
    with pytest.raises(SourceError, match=message):
        read_extrinsic(tmp_path / name)


def test_one_of_several_is_picked(tmp_path):
    (tmp_path / 'x.urdf').write_text(ROBOT)
    np.testing.assert_allclose(
        read_extrinsic(f'{tmp_path}/x.urdf#c').T_a_b[:3, 3], [0, 2, 0])
    np.testing.assert_allclose(
        read_extrinsic(tmp_path / 'x.urdf', 'camera_link', 'lidar').T_a_b[:3, 3], [1, -2, 0.5])
    chain = {f'cam{k}': {'T_cn_cnm1': se3.inverse(T_01).tolist()} for k in (1, 2)}
    (tmp_path / 'chain.json').write_text(json.dumps(chain))
    with pytest.raises(SourceError, match='append #cam1 or #cam2'):
        read_extrinsic(tmp_path / 'chain.json')
    np.testing.assert_allclose(
        read_extrinsic(f'{tmp_path}/chain.json#cam2').T_a_b, T_01 @ T_01, atol=1e-14)
    kit = {'base': {'one': {}, 'two': {}}}
    for pose in kit['base'].values():
        pose.update(x=1, y=2, z=3, roll=0, pitch=0, yaw=0)
    (tmp_path / 'kit.json').write_text(json.dumps(kit))
    with pytest.raises(SourceError, match='append #one or #two'):
        read_extrinsic(tmp_path / 'kit.json')
    assert read_extrinsic(f'{tmp_path}/kit.json#two').how.startswith('Autoware, the pose of two')
    assert read_extrinsic(tmp_path / 'kit.json', 'base', 'one').T_a_b[0, 3] == 1


def test_a_transform_in_an_option():
    np.testing.assert_allclose(
        parse_transform('0.5, -0.25, 0.125, 0.1, -0.2, 0.3'), T_01, atol=1e-15)
    np.testing.assert_allclose(parse_transform('1 2 3 0 0 0 1')[:3, 3], [1, 2, 3])
    for text in ('', '1 2', 'x', 'x' * 5000, '0 0 0 0 0 0 3', '1 2 3 0 0 nan'):
        with pytest.raises(ConfigError, match=r'x,y,z,roll|norm'):
            transform_of(text)
