# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``trajectory_calibration simulate``: what it writes is what was simulated."""

import argparse
from dataclasses import fields
import json
import re
import shlex
import sqlite3

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from trajectory_calibration import ConfigError, Trajectory
from trajectory_calibration.cli.main import main
from trajectory_calibration.cli.simulate import add_parser, FORMATS
from trajectory_calibration.geometry import se3
from trajectory_calibration.outputs.extrinsic_file import read_extrinsic
from trajectory_calibration.simulation import Noise, SCENARIOS, simulate
from trajectory_calibration.simulation.files import MESSAGES, STORAGES, write_bag, write_tum
from trajectory_calibration.sources.files import FileSource


def simulate_to(folder, *options):
    return main(['simulate', '--output', str(folder), *options])


def test_tum_files_hold_the_pair(tmp_path, capsys):
    tmp_path /= 'with a space'
    assert simulate_to(tmp_path, '--scenario', 'mixture', '--seed', '3') == 0
    pair = simulate(SCENARIOS['mixture'], 3)
    for name, expected in (('a', pair.a), ('b', pair.b)):
        read = FileSource(tmp_path / f'{name}.tum').load()
        np.testing.assert_array_equal(read.stamps_ns, expected.stamps_ns)
        np.testing.assert_allclose(read.poses, expected.poses, atol=1e-13)
        assert not read.warnings
    truth = read_extrinsic(tmp_path / 'truth.tum').T_a_b
    np.testing.assert_allclose(truth, pair.T_a_b, atol=1e-13)
    # The command that it proposes works, without options that change nothing.
    hint = re.search(r'try: trajectory_calibration (.*)', capsys.readouterr().out)[1]
    assert main([*shlex.split(hint), '--solver', 'park']) == 0


def test_the_proposed_command_starts_at_the_offset_and_looks_for_the_drift(tmp_path, capsys):
    options = '--scenario', 'noise', '--duration', '120', '--clock-offset-a', '2.5'
    assert simulate_to(tmp_path, *options, '--clock-drift-a', '8e-4') == 0
    hint = shlex.split(re.search(r'try: trajectory_calibration (.*)', capsys.readouterr().out)[1])
    assert hint[-2:] == ['--time-offset', '2.5']
    assert main([*hint, '--solver', 'park', '--format', 'json']) == 0
    assert json.loads(capsys.readouterr().out)['clock_drift'] == pytest.approx(8e-4, abs=2e-4)


def test_an_earlier_drive_is_overwritten_only_by_force(tmp_path, capsys):
    options = ('--scenario', 'noise', '--duration', '5')
    assert simulate_to(tmp_path, *options) == 0
    before = (tmp_path / 'a.tum').read_bytes()
    assert simulate_to(tmp_path, *options, '--seed', '1') == 2
    assert 'truth.tum and 2 more exist; give --force' in capsys.readouterr().err
    assert (tmp_path / 'a.tum').read_bytes() == before
    assert simulate_to(tmp_path, *options, '--seed', '1', '--force') == 0
    assert (tmp_path / 'a.tum').read_bytes() != before


def test_stamps_before_the_epoch_do_not_change(tmp_path):
    stamps_ns = np.array([-1_500_000_000, -200_000_000, -1, 700_000_001])
    poses = np.tile(np.eye(4), (4, 1, 1))
    write_tum(tmp_path / 'a.tum', Trajectory(stamps_ns, poses))
    np.testing.assert_array_equal(FileSource(tmp_path / 'a.tum').load().stamps_ns, stamps_ns)


@pytest.mark.parametrize('storage', STORAGES)
@pytest.mark.parametrize('message', MESSAGES)
def test_bags_hold_the_pair(tmp_path, storage, message):
    assert simulate_to(
        tmp_path, '--scenario', 'noise', '--seed', '4', '--format', storage,
        '--message', message, '--frame-a', 'velodyne') == 0
    pair = simulate(SCENARIOS['noise'], 4)
    stamps, poses, frames = {}, {}, set()
    last = 0
    with AnyReader([tmp_path / 'bag']) as reader:
        for connection, time, data in reader.messages():
            assert time >= last
            last = time
            read = reader.deserialize(data, connection.msgtype)
            pose = read.pose.pose if message == 'odometry' else read.pose
            stamp = read.header.stamp
            stamps.setdefault(connection.topic, []).append(
                stamp.sec * 10**9 + stamp.nanosec)
            p, q = pose.position, pose.orientation
            poses.setdefault(connection.topic, []).append([p.x, p.y, p.z, q.x, q.y, q.z, q.w])
            if message == 'odometry':
                frames.add((read.header.frame_id, read.child_frame_id))
    for topic, expected in (('/trajectory_a', pair.a), ('/trajectory_b', pair.b)):
        np.testing.assert_array_equal(stamps[topic], expected.stamps_ns)
        numbers = np.array(poses[topic])
        np.testing.assert_allclose(numbers[:, :3], expected.positions, atol=1e-13)
        np.testing.assert_allclose(
            se3.quaternion_to_rotation(numbers[:, 3:]), expected.rotations, atol=1e-13)
    if message == 'odometry':
        assert frames == {('lidar_map', 'velodyne'), ('camera_map', 'camera')}


def test_the_storage_is_what_was_asked_for(tmp_path):
    simulate_to(tmp_path / 'm', '--format', 'mcap')
    simulate_to(tmp_path / 's', '--format', 'sqlite3')
    (mcap,) = (tmp_path / 'm' / 'bag').glob('*.mcap')
    assert mcap.read_bytes().startswith(b'\x89MCAP')
    (database,) = (tmp_path / 's' / 'bag').glob('*.db3')
    with sqlite3.connect(database) as connection:
        assert connection.execute('select count(*) from messages').fetchone() == (200,)
    connection.close()


def test_options_change_the_scenario(tmp_path):
    options = (
        '--scenario', 'noise', '--duration', '5', '--rate-a', '20', '--clock-offset-b', '2',
        '--noise', 'white=0')
    assert simulate_to(tmp_path / 'steady', *options) == 0
    assert simulate_to(tmp_path / 'jumping', *options, '--noise', 'b.jumps=1') == 0
    read = {
        (folder, name): FileSource(tmp_path / folder / f'{name}.tum').load()
        for folder in ('steady', 'jumping') for name in 'ab'}
    a, b = read['steady', 'a'], read['steady', 'b']
    assert len(a) == 101
    assert len(b) == 51
    assert b.stamps_ns[0] - a.stamps_ns[0] == 2_000_000_000
    np.testing.assert_array_equal(read['jumping', 'a'].poses, a.poses)
    moved = np.diff(read['jumping', 'b'].positions - b.positions, axis=0)
    assert np.count_nonzero(np.linalg.norm(moved, axis=1) > 1e-9) == 1


@pytest.mark.parametrize('options', [
    ('--scenario', 'mars'),
    ('--seed', '-1'),
    ('--noise', 'whit=1'),
    ('--noise', 'c.white=1'),
    ('--noise', 'white=much'),
    ('--noise', 'jumps=1.5'),
    ('--noise', 'white=-1'),
    ('--rate-b', '0'),
    ('--clock-offset-a', 'nan'),
    ('--clock-offset-a', '1e300'),
    ('--noise', 'white=1e308'),
])
def test_wrong_use(tmp_path, capsys, options):
    assert simulate_to(tmp_path, *options) == 2
    output = capsys.readouterr()
    assert output.err.count('\n') == 1
    assert output.err.startswith('error: ')
    assert not list(tmp_path.iterdir())


def test_a_single_pose_is_refused_in_words_of_what_was_asked(tmp_path, capsys):
    assert simulate_to(tmp_path, '--duration', '0.01') == 2
    assert capsys.readouterr().err == (
        'error: 0.01 s at 10.0 hertz are 1 pose of lidar, needed at least 2; raise the duration '
        'or the rate\n')
    assert simulate_to(tmp_path, '--duration', '0.01', '--rate-a', '1e3', '--rate-b', '1e3',
                       '--noise', 'jumps=0') == 0


def test_more_poses_than_fit_are_refused_before_they_are_drawn(tmp_path, capsys):
    assert simulate_to(tmp_path, '--duration', '1e6', '--rate-b', '1e6') == 2
    assert capsys.readouterr().err == (
        'error: 1000000.0 s at 1000000.0 hertz are 1,000,000,000,001 poses of camera, needed at '
        'most 20,000,000; lower the duration or the rate\n')
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize('offset', ['-1700000000', '400000000'])
def test_the_largest_clock_offsets_can_be_written(tmp_path, capsys, offset):
    for file_format in FORMATS:
        assert simulate_to(tmp_path / file_format, '--clock-offset-a', offset, '--scenario',
                           'noise', '--format', file_format) == 0
        assert f'--time-offset {offset}\n' in capsys.readouterr().out
    first = FileSource(tmp_path / 'tum' / 'a.tum').load().stamps_ns[0]
    assert first == (int(offset) + 1_700_000_000) * 10**9


def test_a_folder_that_cannot_be_written(tmp_path, capsys):
    (tmp_path / 'file').touch()
    assert simulate_to(tmp_path / 'file') == 1
    assert 'cannot be made' in capsys.readouterr().err
    (tmp_path / 'taken' / 'a.tum').mkdir(parents=True)
    assert simulate_to(tmp_path / 'taken') == 1
    assert capsys.readouterr().err == (
        f'error: {tmp_path}/taken/a.tum cannot be written: it is a folder; give another name\n')
    assert simulate_to(tmp_path / 'twice', '--format', 'mcap') == 0
    assert simulate_to(tmp_path / 'twice', '--format', 'mcap') == 1
    err = capsys.readouterr().err
    assert 'cannot be written as a bag' in err
    assert err.endswith(
        ' exists already, not overwriting; remove what is there, or choose another folder\n')


def test_only_what_can_be_written_is_accepted(tmp_path):
    for message, storage in (('x', 'mcap'), ('odometry', 'x')):
        with pytest.raises(ConfigError, match=r"'x' is unknown; needed one of \w+, \w+$"):
            write_bag(tmp_path / 'bag', {}, message=message, storage=storage)
    assert not list(tmp_path.iterdir())


def test_help_names_everything_there_is():
    parser = argparse.ArgumentParser()
    subparsers = parser.add_subparsers()
    add_parser(subparsers)
    help_text = ' '.join(subparsers.choices['simulate'].format_help().split())
    for name in (*SCENARIOS, *(item.name for item in fields(Noise)), *MESSAGES, *FORMATS):
        assert re.search(rf'\b{name}\b', help_text), name
