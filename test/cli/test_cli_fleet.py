# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``trajectory_calibration fleet`` and ``compare``, as a person calls them."""

import csv
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time

from cli_helpers import Gone, make_pair, rows, run, write_pair_bag, X
import numpy as np
import pytest

from trajectory_calibration import CalibrationConfig, CalibrationResult, ConfigError
from trajectory_calibration.cli.main import main
from trajectory_calibration.errors import CalibrationError, ResultError
from trajectory_calibration.executor import Executor
from trajectory_calibration.fleet.jobs import calibrate_job, Job, read_jobs, run_jobs
from trajectory_calibration.geometry import se3
from trajectory_calibration.simulation import flat, Noise, Scenario, simulate, Unicycle, with_noise
from trajectory_calibration.simulation.files import write_tum
from trajectory_calibration.sources import bags as bag_source
from trajectory_calibration.sources.storage import find_bag

DAY_NS = 86_400 * 10**9
STEP = np.array([0.08, 0, 0, 0, 0, np.deg2rad(1.5)])
FAST = '--a', 'a.tum', '--b', 'b.tum', '--solver', 'park', '--processes', '1'


def write_drives(folder, count, moved_from=None):
    """Write folders drive0, drive1, ... with a.tum and b.tum, one for each day."""
    stamps_ns, poses_a, poses_b = make_pair()
    for k in range(count):
        rng = np.random.default_rng(k)
        mounted = X if moved_from is None or k < moved_from else se3.moved(X, STEP)
        noise = se3.exp_se3(rng.normal(size=(2, len(stamps_ns), 6)) * ([2e-3] * 3 + [1e-3] * 3))
        drive = folder / f'drive{k}'
        drive.mkdir(parents=True)
        for name, poses in (('a', poses_a @ noise[0]),
                            ('b', poses_b @ se3.inverse(X) @ mounted @ noise[1])):
            lines = rows(stamps_ns + k * DAY_NS, poses)[1]
            (drive / f'{name}.tum').write_text('\n'.join(lines) + '\n', encoding='utf-8')


@pytest.fixture(scope='module')
def drives(tmp_path_factory):
    folder = tmp_path_factory.mktemp('drives')
    write_drives(folder, 12, moved_from=8)
    return folder


def test_a_recording_that_is_given_twice_counts_once(drives, tmp_path, capsys):
    shutil.copytree(drives / 'drive0', tmp_path / 'in' / 'monday')
    shutil.copytree(drives / 'drive0', tmp_path / 'in' / 'tuesday')
    fleet = 'fleet', f'{tmp_path}/in/*', *FAST, '--output', tmp_path / 'out'
    status, _, err = run(capsys, *fleet)
    assert status == 1
    assert 'tuesday: same recording as monday, counted once' in err
    shutil.copytree(drives / 'drive1', tmp_path / 'in' / 'wednesday')
    status, out, _ = run(capsys, *fleet)
    assert status == 0
    assert out.splitlines()[0].startswith('AGREE: 2 answers')
    assert out.splitlines()[1] == 'tuesday: same recording as monday, counted once'


def test_overlapping_patterns_name_a_recording_once(drives):
    def names(*patterns):
        return [job.name for job in read_jobs(patterns, 'a.tum', 'b.tum', CalibrationConfig())]

    one = str(drives / 'drive0')
    assert names(one, str(drives / 'drive[01]'), one) == ['drive0', 'drive1']
    # Another way of writing the path is told from its stamps and poses.
    assert len({*names(one, f'{drives}/drive1/../drive0', one)}) == 2


def test_a_pattern_without_a_match_is_no_recording(tmp_path, capsys):
    status, _, err = run(capsys, 'fleet', f'{tmp_path}/*.mcap', '--a', '/x', '--b', '/y',
                         '--output', tmp_path)
    assert (status, err) == (2, f'error: no bags match {tmp_path}/*.mcap\n')


@pytest.fixture(scope='module')
def done(drives, tmp_path_factory):
    from trajectory_calibration.cli.main import main
    folder = tmp_path_factory.mktemp('done')
    assert main(['fleet', f'{drives}/drive*', *FAST, '--output', str(folder)]) == 4
    return folder


def test_a_change_is_named_and_ends_with_4(drives, done, capsys):
    before = {path: path.stat().st_mtime_ns for path in (done / 'results').iterdir()}
    status, out, err = run(capsys, 'fleet', f'{drives}/drive*', *FAST, '--output', done)
    assert status == 4
    assert out.startswith('CHANGED: drive0-7 | drive8-11: +0.0')
    assert ' deg about z' in out
    assert 'wrote ' in err
    table = list(csv.DictReader((done / 'table.csv').open(encoding='utf-8')))
    assert [row['name'] for row in table] == [f'drive{k}' for k in range(12)]
    assert json.loads((done / 'table.json').read_text())['exit_status'] == 4
    assert (done / 'fleet.html').read_text().count('class="change"') == 6
    # Nothing was calibrated again.
    assert len(before) == 12
    assert before == {path: path.stat().st_mtime_ns for path in (done / 'results').iterdir()}


def test_compare_says_the_same_of_the_results(done, capsys, tmp_path):
    results = sorted((done / 'results').iterdir(), reverse=True)
    status, out, _ = run(capsys, 'compare', *results)
    assert status == 4
    assert 'CHANGED: drive0-' in out
    status, out, err = run(capsys, 'compare', *results, '--format', 'json', '--output', tmp_path)
    assert status == 4
    assert json.loads(out)['changes'][0]['axes'] == ['about z', 'along x'] or (
        'along x' in json.loads(out)['changes'][0]['axes'])
    assert 'CHANGED' in err
    assert (tmp_path / 'fleet.html').exists()
    again = ('compare', *results, '--output', tmp_path)
    status, out, err = run(capsys, *again)
    assert (status, out) == (2, '')
    assert 'table.csv and 2 more exist; give --force' in err
    assert run(capsys, *again, '--force')[0] == 4
    before = [path for path in results if int(path.name[5:].partition('-')[0]) < 8]
    status, out, _ = run(capsys, 'compare', *before, '--format', 'csv')
    assert status == 0
    assert len(list(csv.DictReader(io.StringIO(out)))) == 8
    assert run(capsys, 'compare', results[0])[0] == 2


def test_a_reader_that_has_gone_takes_no_tables_away(done, tmp_path, monkeypatch):
    monkeypatch.setattr('trajectory_calibration.cli.main._discard_output', lambda: None)
    monkeypatch.setattr(sys, 'stdout', Gone())
    results = map(str, (done / 'results').iterdir())
    assert main(['compare', *results, '--output', str(tmp_path)]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {
        'table.csv', 'table.json', 'fleet.html'}


def test_what_another_run_left_is_overwritten_with_force_only(drives, tmp_path, capsys):
    shutil.copytree(drives / 'drive0', tmp_path / 'in' / 'drive0')
    shutil.copytree(drives / 'drive1', tmp_path / 'in' / 'drive1')
    fleet = 'fleet', f'{tmp_path}/in/*', *FAST, '--output', tmp_path / 'out'
    assert run(capsys, *fleet)[0] == 0
    # The same command goes on, also with one recording more.
    shutil.copytree(drives / 'drive2', tmp_path / 'in' / 'drive2')
    assert run(capsys, *fleet)[0] == 0
    before = {path: path.read_bytes() for path in (tmp_path / 'out').rglob('*.*')}
    status, out, err = run(capsys, *fleet, '--reference', 'B7')
    assert (status, out) == (2, '')
    assert 'table.csv and 5 more exist; give --force' in err
    assert {path: path.read_bytes() for path in (tmp_path / 'out').rglob('*.*')} == before
    assert run(capsys, *fleet, '--reference', 'B7', '--force')[0] == 0
    # What was overwritten is gone: the same command goes on again, also with fewer recordings.
    assert run(capsys, *fleet, '--reference', 'B7')[0] == 0
    shutil.rmtree(tmp_path / 'in' / 'drive2')
    (tmp_path / 'out' / 'results' / 'notes.yaml').write_text('a: person\n')
    assert run(capsys, *fleet, '--reference', 'B7')[0] == 2
    assert run(capsys, *fleet, '--reference', 'B7', '--force')[0] == 0
    assert run(capsys, *fleet, '--reference', 'B7')[0] == 0
    assert (tmp_path / 'out' / 'results' / 'notes.yaml').exists()
    # And tables that no fleet wrote.
    shutil.rmtree(tmp_path / 'out' / 'results')
    assert run(capsys, *fleet)[0] == 2


def test_from_another_folder_it_is_the_same_run(drives, tmp_path, capsys, monkeypatch):
    fleet = *FAST, '--output', tmp_path / 'out'
    monkeypatch.chdir(drives)
    assert run(capsys, 'fleet', 'drive[01]', *fleet)[0] == 0
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / 'out' / 'results').iterdir()}
    monkeypatch.chdir(tmp_path)
    status, _, err = run(capsys, 'fleet', f'{drives}/drive[01]', *fleet)
    assert status == 0, err
    assert before == {
        path: path.stat().st_mtime_ns for path in (tmp_path / 'out' / 'results').iterdir()}


def test_a_bag_a_day_goes_on_from_the_first_day(tmp_path, capsys):
    """Alone, the bag of the first day needs no name of its folder; with others it does."""
    fleet = ('fleet', f'{tmp_path}/day*/bag.mcap', '--a', '/lidar/odom', '--b', '/camera/pose',
             '--solver', 'park', '--jobs', '1', '--output', tmp_path / 'out')
    for day, status in ((1, 1), (2, 0), (3, 0)):
        (tmp_path / f'day{day}').mkdir()
        write_pair_bag(tmp_path / f'day{day}' / 'bag.mcap', count=80 + day)
        before = {path.name: path.stat().st_mtime_ns for path in tmp_path.glob('out/results/*')}
        found, _, err = run(capsys, *fleet)
        assert found == status, err
        after = {path.name: path.stat().st_mtime_ns for path in tmp_path.glob('out/results/*')}
        # Only the new bag was calibrated.
        assert len(after) == day
        assert before.items() <= after.items()


def test_recordings_of_one_size_and_time_are_told_by_their_beginnings(drives, tmp_path):
    for k in range(2):
        (tmp_path / f'{k}').mkdir()
        for name in 'ab':
            text = (drives / f'drive{k}' / f'{name}.tum').read_text()[:3000].ljust(3000)
            (tmp_path / f'{k}' / f'{name}.tum').write_text(text)
            os.utime(tmp_path / f'{k}' / f'{name}.tum', ns=(DAY_NS, DAY_NS))
    one, two = (read_jobs([str(tmp_path / f'{k}')], 'a.tum', 'b.tum', CalibrationConfig())[0]
                for k in range(2))
    assert one.fingerprint != two.fingerprint


def test_other_settings_and_other_inputs_are_calibrated_again(drives, tmp_path):
    shutil.copytree(drives / 'drive0', tmp_path / 'in' / 'drive0')
    folder = tmp_path / 'results'

    def finish(config):
        jobs = read_jobs([str(tmp_path / 'in' / 'drive0')], 'a.tum', 'b.tum', config)
        (entry,) = run_jobs(jobs, folder, Executor(processes=1))
        (path,) = folder.iterdir()
        return entry.result, path, path.stat().st_mtime_ns

    first = finish(CalibrationConfig(solver='park'))
    assert finish(CalibrationConfig(solver='park'))[1:] == first[1:]
    other = finish(CalibrationConfig(solver='taylor'))
    assert other[1] != first[1]
    assert other[0].config.solver == 'taylor'
    text = (tmp_path / 'in' / 'drive0' / 'a.tum').read_text()
    (tmp_path / 'in' / 'drive0' / 'a.tum').write_text('# edited\n' + text)
    assert finish(CalibrationConfig(solver='taylor'))[1] != other[1]


def test_a_process_that_was_killed_is_one_line():
    with pytest.raises(CalibrationError, match='a process was killed'):
        list(Executor(processes=2).unordered(os._exit, [1, 1]))
    # The next one has processes of its own.
    assert sorted(Executor(processes=2).unordered(abs, [-1, -2])) == [(0, 1), (1, 2)]


def test_the_old_result_goes_when_the_new_one_is_there(drives, tmp_path, monkeypatch):
    def full(*_):
        raise ResultError('disk full')

    def results():
        return sorted(path.name for path in (tmp_path / 'results').iterdir())

    one, two = (read_jobs([str(drives / 'drive0')], 'a.tum', 'b.tum', CalibrationConfig(
        solver='taylor', reference=reference)) for reference in ('B5', 'B6'))
    list(run_jobs(one, tmp_path / 'results', Executor(processes=1)))
    before = results()
    with monkeypatch.context() as patch:
        patch.setattr('trajectory_calibration.fleet.jobs.write_yaml', full)
        with pytest.raises(ResultError, match='disk full'):
            list(run_jobs(two, tmp_path / 'results', Executor(processes=1)))
    assert results() == before == [one[0].file_name]
    list(run_jobs(two, tmp_path / 'results', Executor(processes=1)))
    assert results() == [two[0].file_name]


@pytest.mark.once
def test_killed_half_way_it_goes_on(drives, tmp_path):
    command = [sys.executable, '-m', 'trajectory_calibration', 'fleet', f'{drives}/drive*', *FAST,
               '--output', str(tmp_path)]
    results = tmp_path / 'results'
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while not (results.exists() and any(results.glob('*.yaml'))):
        assert time.monotonic() < deadline
        assert process.poll() in (None, 4)
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    kept = {path: path.stat().st_mtime_ns for path in results.glob('*.yaml')}
    again = subprocess.run(command, check=False, capture_output=True, text=True)
    assert again.returncode == 4, again.stderr
    assert 'CHANGED: drive0-7 | drive8-11' in again.stdout
    assert len(list(results.glob('*.yaml'))) == 12
    for path, stamp in kept.items():
        CalibrationResult.load(path)
        assert path.stat().st_mtime_ns == stamp


@pytest.mark.once
def test_dask_gives_the_same_table(drives, done, tmp_path, capsys):
    pytest.importorskip('distributed', reason='distributed is not installed')
    options = [*FAST[:-2], '--processes', '2', '--backend', 'dask']
    status, _, err = run(capsys, 'fleet', f'{drives}/drive*', *options, '--output', tmp_path)
    assert status == 4, err
    assert (tmp_path / 'table.csv').read_text() == (done / 'table.csv').read_text()


def test_bags_and_jobs_and_what_fails_is_named(drives, tmp_path, capsys):
    write_pair_bag(tmp_path / 'monday.mcap')
    (tmp_path / 'broken.mcap').write_bytes(b'\x89MCAP0\r\nhello')
    (tmp_path / 'jobs.yaml').write_text(f"""
a: /lidar/odom
b: /camera/pose
config: {{solver: park}}
jobs:
- monday.mcap
- {{bag: broken.mcap, name: damaged}}
- {{name: again, bag: [monday.mcap], frame_a: velodyne, config: {{solver: taylor}}}}
- {{name: files, a: {drives}/drive0/a.tum, b: {drives}/drive0/b.tum}}
""")
    jobs = read_jobs([str(tmp_path / 'jobs.yaml')], None, None, CalibrationConfig())
    assert [job.name for job in jobs] == ['monday', 'damaged', 'again', 'files']
    entries = {entry.name: entry for entry in run_jobs(
        jobs, tmp_path / 'results', Executor(processes=1))}
    assert entries['damaged'].result is None
    assert 'broken.mcap' in entries['damaged'].failure
    assert entries['monday'].result.config.solver == 'park'
    assert entries['again'].result.config.solver == 'taylor'
    assert entries['again'].result.frame_a == 'velodyne'
    assert entries['files'].result is not None
    write_pair_bag(tmp_path / 'tuesday.mcap', count=90)
    status, out, err = run(
        capsys, 'fleet', f'{tmp_path}/*.mcap', '--a', '/lidar/odom', '--b', '/camera/pose',
        '--solver', 'park', '--processes', '1', '--output', tmp_path / 'out')
    assert status == 0, err
    assert 'broken: no answer: ' in err
    assert '1 of 3 gave no answer' in out


@pytest.mark.parametrize(('text', 'message'), [
    ('jobs: []', 'no bags match'), ('a: 1', 'holds no jobs'), ('[1]', 'holds no jobs'),
    ('jobs: [x.mcap]', 'a and b are not named'),
    ('{config: 5, jobs: [x.mcap]}', 'config is 5, needed settings by name'),
    ('{a: /x, b: /y, jobs: [{bag: [5]}]}', r'bag is \[5\], needed a text'),
    ('{a: /x, b: /y, invert_a: yes it is, jobs: [x]}', 'needed true or false'),
    ('{a: /x, b: /y, jobs: [{bag: x.mcap, speed: 3}]}', "'speed' is unknown"),
])
def test_a_list_of_jobs_that_is_none_is_named(tmp_path, text, message):
    (tmp_path / 'jobs.yaml').write_text(text)
    with pytest.raises(ConfigError, match=message):
        read_jobs([str(tmp_path / 'jobs.yaml')], None, None, CalibrationConfig())


def test_a_folder_of_folders_is_named_with_the_pattern_that_serves(drives):
    with pytest.raises(ConfigError, match=r"holds one folder for each recording; give '.*/\*'$"):
        read_jobs([str(drives)], 'a.tum', 'b.tum', CalibrationConfig())


def test_a_folder_that_holds_a_bag_is_named_with_the_bag(tmp_path):
    write_pair_bag(tmp_path / 'day' / 'bag')
    with pytest.raises(ConfigError, match=f"and bag in it is; give '{tmp_path}/day/bag'"):
        read_jobs([str(tmp_path / 'day')], '/lidar/odom', '/camera/pose', CalibrationConfig())


def test_equal_names_of_jobs_get_a_number(tmp_path):
    (tmp_path / 'jobs.yaml').write_text(
        '{a: /x, b: /y, jobs: [{bag: x, name: n}, {bag: y, name: n}, z.mcap, z.mcap]}')
    jobs = read_jobs([str(tmp_path / 'jobs.yaml')], None, None, CalibrationConfig())
    assert [job.name for job in jobs] == ['n', 'n_2', 'z', 'z_2']


def test_bags_without_sensors_are_wrong_usage(capsys, tmp_path):
    status, _, err = run(capsys, 'fleet', 'x.mcap', '--output', tmp_path)
    assert status == 2
    assert 'give --a and --b' in err


def test_one_topic_is_not_two_sensors(capsys):
    status, out, err = run(capsys, 'fleet', 'x.mcap', '--a', '/a', '--b', '/a')
    assert (status, out) == (2, '')
    assert 'A and B are both /a; needed two sensors' in err


def test_a_direction_that_a_drive_leaves_open_is_named(capsys, tmp_path):
    for k in range(3):
        noise = Noise(white=0.005 + 0.001 * k)
        (tmp_path / f'flat{k}').mkdir()
        pair = simulate(with_noise(
            Scenario(20.0, Unicycle(ground=flat) if k else Unicycle()), noise, noise), 0)
        for name in 'ab':
            write_tum(tmp_path / f'flat{k}' / f'{name}.tum', getattr(pair, name))
    status, out, err = run(
        capsys, 'fleet', f'{tmp_path}/flat*', *FAST[:4], '--solver', 'dnl', '--reference', 'B10',
        '--processes', '1', '--format', 'csv', '--output', tmp_path / 'out')
    assert status == 0, out + err
    assert [row['unobserved'] for row in csv.DictReader(io.StringIO(out))] == ['', 'z', 'z']


def test_a_bag_is_opened_once_for_both_topics(tmp_path, monkeypatch):
    bag = write_pair_bag(tmp_path / 'x.mcap')
    opened = []
    monkeypatch.setattr(
        bag_source, 'find_bag', lambda path: opened.append(path) or find_bag(path))
    data, reason = calibrate_job(Job('x', '/lidar/odom', '/camera/pose', (bag,)))
    assert not reason
    assert data['frame_a']
    assert list(map(str, opened)) == [bag]


def test_people_count_run2_before_run10(tmp_path):
    for k in (10, 2, 1):
        (tmp_path / f'run{k}.mcap').write_text('')
    jobs = read_jobs([f'{tmp_path}/*.mcap'], '/a', '/b', CalibrationConfig())
    assert [job.name for job in jobs] == ['run1', 'run2', 'run10']
