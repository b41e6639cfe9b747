# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of rigs: which sensors have moved."""

import csv
import json
from pathlib import Path
import re

from cli_helpers import Gone
import numpy as np
import pytest

from benchmarks.simulated_rig import RigScenario, simulate_rig
from trajectory_calibration.cli.main import main
from trajectory_calibration.errors import ConfigError, ResultError
from trajectory_calibration.geometry import se3
from trajectory_calibration.rig import RigConfig, RigResult
from trajectory_calibration.rig.comparison import compare_rigs
from trajectory_calibration.rig.contradictions import describe_size
from trajectory_calibration.rig.result import SensorAnswer
from trajectory_calibration.rig.shared_noise import twist_to_step
from trajectory_calibration.simulation.files import write_tum
from trajectory_calibration.simulation.noise import Noise
from trajectory_calibration.simulation.scenario import random_pose, Sensor

NAMES = ('a', 'b', 'c', 'd')
SIGMA = 0.002


def rig(X, rng):
    """Return the rig of a drive, with an independent random twist per sensor."""
    twist = SIGMA * rng.standard_normal((len(X), 6))
    sensors = {'a': SensorAnswer('a', 'a', 'a', np.eye(4), np.zeros((6, 6)), {})}
    L = [twist_to_step(np.eye(4), x) for x in X]
    C = np.zeros((len(X) - 1, 6, len(X) - 1, 6))
    for k in range(1, len(X)):
        T = se3.moved(X[k], L[k] @ (twist[k] - twist[0]))
        for j in range(1, len(X)):
            C[k - 1, :, j - 1] = SIGMA**2 * (1 + (j == k)) * L[k] @ L[j].T
        sensors[NAMES[k]] = SensorAnswer(
            NAMES[k], NAMES[k], 'a', T, C[k - 1, :, k - 1], {})
    size = 6 * (len(X) - 1)
    return RigResult('a', sensors, C.reshape(size, size), NAMES[1:len(X)], (), (), 0.0, 0,
                     (), RigConfig())


@pytest.fixture
def mounts():
    rng = np.random.default_rng(0)
    return np.stack([np.eye(4), *(random_pose(rng) for _ in range(3))]), rng


def test_a_rig_that_holds(mounts):
    X, rng = mounts
    alarms, ratio = 0, []
    for _ in range(60):
        found = compare_rigs(rig(X, rng), rig(X, rng))
        alarms += not found.holds
        ratio.append(found.chi_squared / found.degrees)
    assert alarms <= 1
    assert 0.85 < np.mean(ratio) < 1.15


@pytest.mark.parametrize('moved', [1, 2, 3])
def test_a_sensor_that_moved_is_named(mounts, moved):
    X, rng = mounts
    later = X.copy()
    later[moved] = se3.moved(X[moved], [0.03, 0.0, 0.02, 0.0, 0.0, 0.01])
    found = compare_rigs(rig(X, rng), rig(later, rng))
    assert [change.sensor for change in found.changes] == [NAMES[moved]]
    np.testing.assert_allclose(
        found.changes[0].step, [0.03, 0.0, 0.02, 0.0, 0.0, 0.01], atol=5 * SIGMA)
    assert f'{NAMES[moved]} moved by' in str(found)
    assert str(found).count('chi-squared') == len(found.changes)


def test_the_base_that_moved_is_named(mounts):
    X, rng = mounts
    later = X.copy()
    later[1:] = se3.inverse(se3.exp_se3(np.array([0.03, 0.0, 0.02, 0.0, 0.0, 0.01]))) @ X[1:]
    found = compare_rigs(rig(X, rng), rig(later, rng))
    assert [change.sensor for change in found.changes] == ['a']
    np.testing.assert_allclose(
        found.changes[0].step, [0.03, 0.0, 0.02, 0.0, 0.0, 0.01], atol=5 * SIGMA)


def test_rigs_without_common_sensors_are_an_error(mounts):
    X, rng = mounts
    one = rig(X, rng)
    other = RigResult.from_dict({**one.to_dict(), 'sensors': {
        'a': one.to_dict()['sensors']['a']}, 'covariance_of': [], 'covariance': []})
    with pytest.raises(ResultError, match='one more sensor in both'):
        compare_rigs(one, other)


def test_the_command_ends_with_four_where_a_sensor_moved(tmp_path, capsys):
    noise = Noise(white=0.002, white_rotation=0.0003)
    run = simulate_rig(RigScenario({name: Sensor(noise=noise) for name in 'abc'}, 30.0), 3)
    for name, trajectory in run.trajectories.items():
        write_tum(tmp_path / f'{name}.tum', trajectory)
    (tmp_path / 'RIG.yaml').write_text(
        'sensors:\n' + ''.join(f'  {name}: {{file: {name}.tum}}\n' for name in 'abc'))
    assert main(['rig', str(tmp_path / 'RIG.yaml'), '--output', str(tmp_path)]) == 0
    saved = tmp_path / 'rig.yaml'
    verify = ['verify', str(saved), str(tmp_path / 'RIG.yaml')]
    assert main(verify) == 3
    assert 'cannot tell: both rigs are of one recording' in capsys.readouterr().out
    same = tmp_path / 'same'
    assert main(['compare', *3 * [str(saved)], '--output', str(same)]) == 3
    printed = capsys.readouterr().out
    assert printed.count('cannot tell: both rigs are of one recording') == 2
    assert 'holds' not in printed
    data = RigResult.load(saved).to_dict()
    assert len(data['recordings']) == 3
    # As from another drive.
    data['recordings'] = []
    data['sensors']['b']['T_base_sensor']['translation'][0] += 0.1
    earlier = tmp_path / 'earlier.yaml'
    RigResult.from_dict(data).save(earlier)
    assert main(['verify', str(earlier), str(tmp_path / 'RIG.yaml')]) == 4
    printed = capsys.readouterr().out
    assert 'b moved by 10 cm' in printed
    # No exponent, also for large moves.
    assert describe_size(np.array([3.0, 4.0, 0.0, 0.0, 0.0, 2.5])) == '500 cm and 143 deg'
    verdicts = {line.split()[0]: line.split()[-1] for line in printed.splitlines()[3:]}
    assert verdicts == {'b': 'moved', 'c': 'holds'}
    assert main([*verify, '--format', 'json']) == 3
    told = json.loads(capsys.readouterr().out)
    assert (told['holds'], told['same_recording']) == (None, True)
    table = tmp_path / 'table'
    compare = ['compare', str(earlier), str(saved), '--format', 'csv', '--output', str(table)]
    assert main(compare) == 4
    row = next(csv.DictReader((table / 'table.csv').open()))
    assert row['sensor'] == 'b'
    assert float(row['dx_m']) == pytest.approx(-0.1, abs=1e-9)
    found, = json.loads((table / 'table.json').read_text())
    assert (found['moved'], found['holds'], found['same_recording']) == (['b'], False, False)


def test_a_rig_of_settings_that_are_not_here_is_read(mounts):
    data = rig(*mounts).to_dict()
    data['config'] |= {'old': 1, 'sensors': {'b': {'scale': 'free', 'old': 2}}}
    data['config']['calibration'] |= {'solver': 'acme', 'old': 3}
    config = RigResult.from_dict(data).config
    assert (config.calibration.solver, config.of('b').scale) == ('acme', 'free')
    with pytest.raises(ConfigError, match="solver 'acme' is unknown"):
        config.scale_of('b')


def test_several_rigs_are_one_table_with_unique_names(
        mounts, tmp_path, monkeypatch, capsys):
    X, rng = mounts
    monkeypatch.chdir(tmp_path)
    paths = [f'{name}/rig.yaml' for name in ('one', 'two', 'three')]
    for path in paths:
        Path(path).parent.mkdir()
        rig(X, rng).save(path)
    assert main(['compare', *paths, '--output', 'cmp', '--format', 'json']) == 0
    out, err = capsys.readouterr()
    assert [(item['rig'], item['against'], item['holds']) for item in json.loads(out)] == [
        ('two', 'one', True), ('three', 'one', True)]
    assert err == 'wrote cmp/table.csv, table.json\n'
    assert sorted(path.name for path in Path('cmp').iterdir()) == ['table.csv', 'table.json']
    assert json.loads(Path('cmp/table.json').read_text()) == json.loads(out)
    with Path('cmp/table.csv').open(encoding='utf-8') as stream:
        rows = [(row['rig'], row['sensor']) for row in csv.DictReader(stream)]
    assert rows == [(name, sensor) for name in ('two', 'three') for sensor in 'bcd']
    assert main(['compare', *paths, '--output', 'cmp']) == 2
    assert 'table.csv and 1 more exist; give --force' in capsys.readouterr().err
    assert main(['compare', *paths, '--output', 'cmp', '--force']) == 0
    assert capsys.readouterr().out.count(' against one: the rig holds') == 2
    # A closed pipe does not delete tables.
    monkeypatch.setattr('trajectory_calibration.cli.main._discard_output', lambda: None)
    monkeypatch.setattr('sys.stdout', Gone())
    assert main(['compare', *paths, '--output', 'head']) == 0
    assert sorted(path.name for path in Path('head').iterdir()) == ['table.csv', 'table.json']


@pytest.mark.parametrize('option', [
    ['--columns', 't,x,y,z,qw,qx,qy,qz'], ['--quaternion-order-b', 'wxyz'], ['--invert-a'],
    ['--file-format-b', 'tum'], ['--times-a', 'x'], ['--frame-a', 'x']])
def test_input_options_are_in_the_description(mounts, tmp_path, capsys, option):
    rig(*mounts).save(tmp_path / 'rig.yaml')
    assert main(['verify', str(tmp_path / 'rig.yaml'), 'RIG.yaml', *option]) == 2
    assert capsys.readouterr().err == (
        f'error: {option[0]} is for A and B; write how a sensor is read below it in RIG.yaml\n')


@pytest.mark.parametrize('arguments', [
    ['verify', 'rig.yaml', 'RIG.yaml', 'b.tum'],
    ['verify', 'result.yaml', 'a.tum'],
    ['compare', 'rig.yaml', 'result.yaml']])
def test_rigs_and_pairs_are_not_mixed(mounts, tmp_path, monkeypatch, capsys, arguments):
    monkeypatch.chdir(tmp_path)
    rig(*mounts).save('rig.yaml')
    (tmp_path / 'result.yaml').write_text('format_version: 2\n')
    assert main(arguments) == 2
    assert re.search('is a rig|B is missing', capsys.readouterr().err)
