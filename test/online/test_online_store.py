# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Saved results survive whatever happens to the process. Needs no ROS."""

from dataclasses import replace
import os
import signal
import stat
import subprocess
import sys
import time

import numpy as np
import pytest

from trajectory_calibration import (
    calibrate,
    CalibrationConfig,
    ConfigError,
    ResultError,
    Trajectory,
)
from trajectory_calibration.geometry import se3
from trajectory_calibration.online.store import ResultStore


@pytest.fixture(scope='module')
def result():
    rng = np.random.default_rng(0)
    steps = se3.exp_se3(rng.normal(size=(40, 6)) * 0.2)
    poses = np.array([np.linalg.multi_dot([np.eye(4), np.eye(4), *steps[:k]])
                      for k in range(40)])
    stamps_ns = np.arange(40) * 100_000_000
    moved = poses @ se3.exp_se3([0.3, -0.2, 0.1, 0.4, -0.3, 1.2])
    return calibrate(Trajectory(stamps_ns, poses), Trajectory(stamps_ns, moved),
                     CalibrationConfig(solver='taylor'))


def test_every_result_gets_a_file_of_its_own_and_the_newest_is_found(tmp_path, result):
    store = ResultStore(str(tmp_path / 'a' / 'b'), '/front/trajectory_calibration')
    assert store.latest() is None
    paths = [store.save(result) for _ in range(3)]
    assert [path.name for path in paths] == [
        f'front.trajectory_calibration_{k:06d}.yaml' for k in (1, 2, 3)]
    path, loaded = store.latest()
    assert path == paths[-1]
    assert np.allclose(loaded.T_a_b, result.T_a_b, atol=1e-15)


def test_the_exports_of_a_result_lie_beside_it_and_are_no_results(tmp_path, result):
    store = ResultStore(str(tmp_path), '/node')
    named = replace(result, frame_a='lidar', frame_b='camera')
    path = store.save(named)
    folder = store.export(named, path)
    assert folder == path.with_suffix('')
    assert '<child link="camera"/>' in (folder / 'extrinsic.urdf').read_text()
    assert store.latest()[0] == path
    with pytest.raises(ConfigError, match='its own parent'):
        store.export(replace(result, frame_a='x', frame_b='x'), path)


def test_nodes_that_share_a_folder_do_not_mix_their_results(tmp_path, result):
    ResultStore(str(tmp_path), '/front/node').save(result)
    assert ResultStore(str(tmp_path), '/rear/node').latest() is None


@pytest.mark.parametrize('mine, other', [
    ('/front/left', '/front_left'), ('/a/b_c', '/a_b/c'), ('/a_/b', '/a/_b'), ('/a/b', '/a_b'),
    ('/node', '/node_000001')])
def test_no_two_names_share_a_file(tmp_path, result, mine, other):
    stores = [ResultStore(str(tmp_path), name) for name in (mine, other)]
    stores[0].save(result)
    assert stores[1].latest() is None
    stores[1].save(replace(result, frame_b='other'))
    assert [store.latest()[1].frame_b for store in stores] == [result.frame_b, 'other']


def test_files_of_a_name_without_namespace_are_named_after_it(tmp_path, result):
    result.save(tmp_path / 'trajectory_calibration_000007.yaml')
    store = ResultStore(str(tmp_path), '/trajectory_calibration')
    assert store.latest()[0].name == 'trajectory_calibration_000007.yaml'


def test_what_is_no_regular_file_is_no_result(tmp_path, result):
    store = ResultStore(str(tmp_path), '/node')
    path = store.save(result)
    os.mkfifo(tmp_path / 'node_000009.yaml')
    (tmp_path / 'node_000010.yaml').mkdir()
    (tmp_path / 'node_000002.yaml').symlink_to(tmp_path / 'node_000009.yaml')
    # In a process of its own, which a FIFO would hold for ever.
    code = ('import sys\nfrom trajectory_calibration.online.store import ResultStore\n'
            'print(ResultStore(sys.argv[1], "/node").latest()[0])')
    found = subprocess.run(
        [sys.executable, '-c', code, str(tmp_path)], capture_output=True, text=True, timeout=120,
        check=True)
    assert found.stdout == f'{path}\n'
    # Nor is it overwritten.
    assert store.save(result).name == 'node_000003.yaml'


def test_a_file_too_large_for_a_result_is_not_read(tmp_path, result):
    store = ResultStore(str(tmp_path), '/node')
    path = store.save(result)
    with (tmp_path / 'node_000009.yaml').open('wb') as stream:
        stream.truncate(10**12)
    assert store.latest()[0] == path
    path.unlink()
    with pytest.raises(ResultError, match='holds 1000000000000 bytes, needed at most 4000000'):
        store.latest()


def test_a_number_that_another_node_took_meanwhile_is_not_taken_again(
        tmp_path, result, monkeypatch):
    mine, twin = (ResultStore(str(tmp_path), '/node') for _ in range(2))
    earlier = [twin.save(result) for _ in range(3)]
    contents = [path.read_bytes() for path in earlier]
    # What the folder held before the twin saved.
    monkeypatch.setattr(ResultStore, '_files', lambda _: [])
    assert mine.save(replace(result, frame_b='other')).name == 'node_000004.yaml'
    assert [path.read_bytes() for path in earlier] == contents


def test_what_a_power_cut_left_behind_is_in_nobodys_way(tmp_path, result):
    (tmp_path / '.node_000001.yaml.new').write_text('half a res')
    store = ResultStore(str(tmp_path), '/node')
    path = store.save(result)
    assert store.latest()[0] == path


@pytest.mark.once
def test_nodes_of_one_name_that_save_at_once_lose_nothing(tmp_path, result):
    code = (
        'import sys\n'
        'from trajectory_calibration import CalibrationResult\n'
        'from trajectory_calibration.online.store import ResultStore\n'
        'result = CalibrationResult.load(sys.argv[1])\n'
        'store = ResultStore(sys.argv[2], "/node")\n'
        'input()\n'
        'for _ in range(25):\n'
        '    print(store.save(result))\n')
    seed = tmp_path / 'seed.yaml'
    result.save(seed)
    folder = tmp_path / 'results'
    processes = [subprocess.Popen(
        [sys.executable, '-c', code, str(seed), str(folder)], text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE) for _ in range(3)]
    for process in processes:
        process.stdin.write('\n')
        process.stdin.flush()
    saved = [line for process in processes for line in process.communicate()[0].split()]
    assert len(saved) == len(set(saved)) == 75
    assert sorted(saved) == sorted(map(str, folder.iterdir()))


def test_saving_leaves_the_umask_of_the_process_alone_and_obeys_it(
        tmp_path, result, monkeypatch):
    previous = os.umask(0o027)
    try:
        with monkeypatch.context() as patch:
            # It belongs to the whole process: other threads create files, too.
            patch.delattr(os, 'umask')
            result.save(tmp_path / 'saved.yaml')
            result.save(tmp_path / 'saved.yaml')
            numbered = ResultStore(str(tmp_path), '/node').save(result)
    finally:
        os.umask(previous)
    for path in (tmp_path / 'saved.yaml', numbered):
        assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert len(list(tmp_path.iterdir())) == 2


def test_damaged_files_are_passed_over(tmp_path, result):
    store = ResultStore(str(tmp_path), '/node')
    good, bad = store.save(result), store.save(result)
    unsendable = good.read_text().replace('frame_a: sensor', r'frame_a: "\ud800"')
    for text in (unsendable, 'translation: ['):
        bad.write_text(text)
        assert store.latest()[0] == good
    good.unlink()
    with pytest.raises(ResultError, match='cannot be read'):
        store.latest()


def test_a_folder_that_went_away_is_named(tmp_path, result):
    folder = tmp_path / 'stick'
    store = ResultStore(str(folder), '/node')
    folder.rmdir()
    for attempt in (store.latest, lambda: store.save(result)):
        with pytest.raises(ResultError, match='stick cannot be read: No such file'):
            attempt()


def test_a_name_cannot_leave_the_folder(tmp_path, result):
    path = ResultStore(str(tmp_path), '/../../etc/passwd').save(result)
    assert path.parent == tmp_path


@pytest.mark.skipif(os.geteuid() == 0, reason='root may write anywhere')
def test_a_folder_that_cannot_be_written_is_refused_at_once(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(ConfigError, match='cannot be written to'):
        ResultStore(str(tmp_path), '/node')


@pytest.mark.once
def test_a_kill_while_saving_leaves_every_earlier_result_whole(tmp_path, result):
    code = (
        'import sys\n'
        'from trajectory_calibration import CalibrationResult\n'
        'from trajectory_calibration.online.store import ResultStore\n'
        'result = CalibrationResult.load(sys.argv[1])\n'
        'store = ResultStore(sys.argv[2], "/node")\n'
        'while True:\n'
        '    store.save(result)\n')
    seed = tmp_path / 'seed.yaml'
    result.save(seed)
    folder = tmp_path / 'results'
    rng = np.random.default_rng(1)
    for _ in range(5):
        before = len(list(folder.glob('node_*.yaml'))) if folder.exists() else 0
        process = subprocess.Popen([sys.executable, '-c', code, str(seed), str(folder)])
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline and (
                not folder.exists() or len(list(folder.glob('node_*.yaml'))) <= before):
            time.sleep(0.005)
        # Somewhere inside one of the next saves.
        time.sleep(rng.uniform(0, 0.05))
        process.send_signal(signal.SIGKILL)
        process.wait()
        files = sorted(folder.glob('node_*.yaml'))
        assert len(files) > before
        assert ResultStore(str(folder), '/node').latest()[0] == files[-1]


def test_without_the_yaml_library_a_folder_is_refused_with_the_command(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, 'ruamel.yaml', None)
    with pytest.raises(ConfigError, match=r'result_directory needs YAML: ruamel.yaml is not '
                       r'installed; pip install ruamel.yaml'):
        ResultStore(str(tmp_path), '/node')
