# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Settings are checked in one place; a result is plain data that survives a file."""

import dataclasses
import errno
import json
import os
from pathlib import Path
import re

from motion_data import perturb, random_pose, sensor_pair
import numpy as np
import pytest

from trajectory_calibration import (
    calibrate,
    CalibrationConfig,
    CalibrationResult,
    ConfigError,
    MotionError,
    ResultError,
    Trajectory,
    TrajectoryError,
)
from trajectory_calibration.config.file_names import file_names
from trajectory_calibration.config.settings import Option
from trajectory_calibration.config.yaml_file import write_text
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.errors import counted, rounded, unknown_name
from trajectory_calibration.outputs.placement import Placement
from trajectory_calibration.rig.result import RigResult
from trajectory_calibration.solvers import load_solver


@pytest.fixture(scope='module')
def result():
    rng = np.random.default_rng(0)
    X = random_pose(rng)
    a, b = sensor_pair(rng, X)
    return calibrate(perturb(rng, a, 1e-3, 1e-3), perturb(rng, b, 1e-3, 1e-3))


def test_every_option_has_a_sentence_and_a_default_in_range():
    for option in CalibrationConfig.options():
        assert len(option.help) > 10, option.name
        # The node shows each on its own.
        assert not option.help.startswith(('the same', 'its ')), option.name
        assert option.check(option.default) == option.default


def test_a_default_is_what_the_paper_says():
    config = CalibrationConfig()
    assert (config.dnlo_c, config.dnlo_min_inliers) == (0.01, 0.5)
    assert config.time_offset == 0.0


@pytest.mark.parametrize('values, message', [
    ({'solver': 'horaud'}, "solver 'horaud' is unknown; needed one of .*dnl, dnlo, ali, park"),
    ({'reference': 'E5'}, "reference 'E5' is unknown"),
    ({'reference': 5}, "reference '5' is unknown"),
    ({'reference': None}, 'reference is None, needed a value of type str'),
    ({'max_gap': -1.0}, 'max_gap is -1.0, needed 0 to 3600'),
    ({'max_gap': float('nan')}, 'max_gap is nan'),
    ({'max_gap': '0.5'}, "max_gap is '0.5', needed a value of type float"),
    ({'max_gap': True}, 'max_gap is True, needed a value of type float'),
    ({'dnlo_min_inliers': 1.5}, 'dnlo_min_inliers is 1.5, needed 0 to 1'),
    ({'association': 'closest'}, 'needed one of auto, interpolate, nearest'),
    ({'solver': 'dnl', 'scale_mode': 'estimate'}, 'scale_mode is estimate, which dnl cannot'),
    ({'time_offset_mode': 'estimate', 'max_time_offset': 0.0}, 'needed more than 0 seconds'),
    ({'max_gab': 1.0}, "setting 'max_gab' is unknown; did you mean max_gap?"),
])
def test_wrong_settings_are_refused_with_the_right_ones(values, message):
    with pytest.raises(ConfigError, match=message):
        CalibrationConfig.from_dict(values)


def test_an_unknown_name_gets_the_nearest_one_or_else_all():
    assert unknown_name('key', 'topc_a', ['topic_a', 'type_a']).endswith(
        'did you mean topic_a?')
    assert unknown_name('key', 'speed', ['topic_a', 'type_a']).endswith(
        'known are topic_a, type_a')


@pytest.mark.parametrize('given, normal', [
    ('AUTO', 'auto'), (' Auto ', 'auto'), ('b7', 'B7'), ('a', 'A'), ('B7', 'B7')])
def test_a_reference_is_written_one_way(given, normal):
    assert CalibrationConfig(reference=given).reference == normal


def test_a_reference_of_thousands_of_digits_is_refused():
    with pytest.raises(ConfigError, match=r'reference .* is unknown'):
        CalibrationConfig(reference=f'B{"9" * 5000}')


def test_what_is_no_trajectory_is_refused():
    rng = np.random.default_rng(1)
    a, _ = sensor_pair(rng, random_pose(rng))
    with pytest.raises(TrajectoryError, match='trajectory_b is of type NoneType, needed a Traj'):
        calibrate(a, None)


def test_an_integer_serves_where_a_number_is_meant():
    assert CalibrationConfig(max_gap=2).max_gap == 2.0


@pytest.mark.parametrize('value', [np.float64(0.25), np.float32(0.25), np.int64(1), 1])
def test_numbers_of_numpy_serve_and_become_plain(value):
    config = CalibrationConfig(max_gap=value)
    assert type(config.max_gap) is float
    assert config.max_gap == value
    assert json.loads(json.dumps(config.to_dict()))['max_gap'] == value
    assert type(Option('n', 1, 'a count').check(np.int32(3))) is int


def test_a_word_of_numpy_becomes_plain():
    assert type(CalibrationConfig(solver=np.str_('dnl')).solver) is str


@pytest.mark.parametrize('value', [np.bool_(1), np.array([0.5]), 1j, 10**400])
def test_what_is_no_number_is_refused(value):
    with pytest.raises(ConfigError, match='max_gap is'):
        CalibrationConfig(max_gap=value)
    with pytest.raises(ConfigError, match='solver is an integer of too many digits'):
        CalibrationConfig(solver=10**5000)
    with pytest.raises(ConfigError, match=r'n is 1\.5, needed a value of type int'):
        Option('n', 1, 'a count').check(1.5)


def test_a_value_that_is_given_is_known():
    assert CalibrationConfig().mode('time_offset') == 'auto'
    # A clock offset is read off somewhere: the search begins there.
    assert CalibrationConfig(time_offset=0.1).mode('time_offset') == 'auto'
    assert CalibrationConfig(time_offset=0.1, time_offset_mode='fixed').mode(
        'time_offset') == 'fixed'
    assert CalibrationConfig(scale=0.98).mode('scale') == 'fixed'
    assert CalibrationConfig(max_time_offset=0.0).mode('time_offset') == 'fixed'
    assert CalibrationConfig().mode('systematic_drift') == 'auto'


def test_a_given_scale_multiplies_b():
    rng = np.random.default_rng(2)
    X = random_pose(rng)
    a, b = sensor_pair(rng, X)
    small = b.scaled(0.5)
    assert b.scaled(1.0) is b
    result = calibrate(a, small, CalibrationConfig(solver='dnl', scale=2.0))
    assert result.absolute_errors(X).e_at < 1e-9
    assert result.scale == 2.0


def test_a_clock_offset_is_found_and_said():
    rng = np.random.default_rng(3)
    X = random_pose(rng)
    a, b = sensor_pair(rng, X)
    late = Trajectory(b.stamps_ns - 1_200_000_000, b.poses, 'map_b', 'camera')
    result = calibrate(a, late, CalibrationConfig(solver='dnl'))
    assert result.time_offset_s == pytest.approx(1.2, abs=0.005)
    assert any('clock offset +1' in warning for warning in result.warnings)
    with pytest.raises(MotionError, match='did not turn together'):
        calibrate(a, late, CalibrationConfig(solver='dnl', time_offset_mode='fixed'))
    given = calibrate(a, late, CalibrationConfig(solver='dnl', time_offset=1.2))
    assert given.time_offset_s == pytest.approx(1.2, abs=1e-9)


@pytest.mark.parametrize('given_s', [0.0, 1.1])
def test_the_clock_offset_of_the_solver_and_that_of_before_are_one_finding(monkeypatch, given_s):
    def solve(motions, config):
        more = Finding('clock-offset', 'remaining clock offset', {'offset_s': 0.02})
        return dataclasses.replace(
            load_solver('dnl')(motions, config), time_offset_s=0.02, findings=(more,))

    monkeypatch.setattr('trajectory_calibration.pipeline.load_solver', lambda _: solve)
    rng = np.random.default_rng(3)
    a, b = sensor_pair(rng, random_pose(rng))
    late = dataclasses.replace(b, stamps_ns=b.stamps_ns - 1_200_000_000)
    result = calibrate(a, late, CalibrationConfig(
        solver='dnl', time_offset=given_s, time_offset_mode='estimate'))
    found, = (found for found in result.findings if found.code == 'clock-offset')
    assert found.values == {'offset_s': pytest.approx(result.time_offset_s - given_s)}
    total, before, after = (float(word) for word in re.findall(r'([+-]\d+\.\d) ms', found.text))
    assert total == pytest.approx(1220 - 1e3 * given_s, abs=5)
    assert (total, after) == (pytest.approx(before + after, abs=0.11), 20.0)


def test_config_round_trips():
    config = CalibrationConfig(solver='ali', max_gap=1.25)
    assert CalibrationConfig.from_dict(config.to_dict()) == config


def test_json_has_the_promised_keys(result):
    data = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    promised = {
        'frame_a', 'frame_b', 'solver', 'reference', 'T_a_b', 'covariance', 'poses', 'motions',
        'e_rt_m', 'e_rR_deg', 'e_at_m', 'e_aR_deg', 'scale', 'time_offset_s', 'observability',
        'findings', 'warnings'}
    assert promised <= set(data)
    assert data['frame_a'] == 'lidar'
    assert data['frame_b'] == 'camera'
    assert len(data['T_a_b']['translation']) == 3
    assert np.linalg.norm(data['T_a_b']['rotation_xyzw']) == pytest.approx(1)
    assert data['e_at_m'] is None
    assert data['e_aR_deg'] is None


def test_truth_fills_the_absolute_errors(result):
    truth = result.T_a_b.copy()
    truth[0, 3] += 0.25
    data = result.to_dict(truth)
    assert data['e_at_m'] == pytest.approx(0.25)
    assert data['e_aR_deg'] == pytest.approx(0, abs=1e-6)


def test_errors_unpack(result):
    truth = result.T_a_b.copy()
    truth[0, 3] += 0.25
    e_at, e_aR = result.absolute_errors(truth)
    assert (e_at, e_aR) == pytest.approx((0.25, 0), abs=1e-7)
    e_rt, e_rR = result.metrics
    assert (e_rt, e_rR) == (result.metrics.e_rt, result.metrics.e_rR)


def leaves(data, name=''):
    """Yield the place and the value of everything in nested dicts and lists."""
    if not isinstance(data, (dict, list, tuple)):
        yield name, data
        return
    for key, value in data.items() if isinstance(data, dict) else enumerate(data):
        yield from leaves(value, f'{name}/{key}')


@pytest.mark.parametrize(('solver', 'own'), [
    ('dnl', 'optimality_gap'), ('dnlo', 'inliers'), ('drift_aware', 'diagnosis')])
def test_a_saved_result_reads_back(tmp_path, solver, own):
    rng = np.random.default_rng(0)
    a, b = (perturb(rng, item, 1e-3, 1e-3) for item in sensor_pair(rng, random_pose(rng)))
    # A jump, another unit and another clock: nothing is what it is without being set.
    poses = b.poses.copy()
    poses[40:, 0, 3] += 0.5
    b = Trajectory(b.stamps_ns - 20_000_000, poses, 'map_b', 'camera').scaled(1.05)
    result = calibrate(a, b, CalibrationConfig(
        solver=solver, scale=0.96, time_offset=0.02,
        scale_mode='estimate' if solver == 'drift_aware' else 'fixed'))
    assert getattr(result, own) is not None
    path = tmp_path / 'result.yaml'
    result.save(path)
    again = CalibrationResult.load(path)
    assert dict(leaves(again.to_dict())) == pytest.approx(
        dict(leaves(result.to_dict())), rel=1e-12, abs=1e-14)
    np.testing.assert_array_equal(again.inliers, result.inliers)
    for name in ('frame_a', 'frame_b', 'poses', 'motions', 'association', 'config', 'warnings',
                 'scale', 'version'):
        assert getattr(again, name) == getattr(result, name), name
    assert [p.name for p in tmp_path.iterdir()] == ['result.yaml']


def test_inliers_survive_as_ranges(result, tmp_path):
    for mask in (np.zeros(result.motions, bool), np.ones(result.motions, bool),
                 np.arange(result.motions) % 3 == 1):
        changed = dataclasses.replace(result, inliers=mask)
        changed.save(tmp_path / 'r.yaml')
        np.testing.assert_array_equal(
            CalibrationResult.load(tmp_path / 'r.yaml').inliers, mask)


def test_saving_is_whole_or_not_at_all(result, tmp_path):
    path = tmp_path / 'result.yaml'
    path.write_text('precious')
    bad = dataclasses.replace(result, frame_a=object())
    with pytest.raises(Exception, match='object'):
        bad.save(path)
    assert path.read_text() == 'precious'
    assert [p.name for p in tmp_path.iterdir()] == ['result.yaml']


def test_every_file_is_whole_or_not_at_all(tmp_path, monkeypatch):
    def cut(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    path = tmp_path / 'page.html'
    write_text(path, 'precious')
    (tmp_path / 'link').symlink_to(path)
    with monkeypatch.context() as patch:
        patch.setattr(Path, 'replace', cut)
        with pytest.raises(ResultError, match=r'page\.html cannot be written: No space left'):
            write_text(path, 'new')
    assert path.read_text() == 'precious'
    write_text(tmp_path / 'link', 'new')
    assert (path.read_text(), (tmp_path / 'link').is_symlink()) == ('new', True)
    reader, writer = os.pipe()
    write_text(Path(f'/dev/fd/{writer}'), 'x')
    assert os.read(reader, 9) == b'x'
    os.close(reader)
    os.close(writer)
    assert sorted(item.name for item in tmp_path.iterdir()) == ['link', 'page.html']


def test_names_stay_in_their_folder_and_apart():
    names = ['..', '/a/b', 'a_b', 'A_b', '', '.', 'rig.urdf', 'lidar']
    found = file_names(names, ['rig.urdf'])
    assert found == ['_.', 'a_b', 'a_b_2', 'A_b_3', '_', '__2', 'rig.urdf_2', 'lidar']


def test_a_place_that_cannot_be_written_is_named(result, tmp_path):
    with pytest.raises(ResultError, match='cannot be written: No such file or directory'):
        result.save(tmp_path / 'nowhere' / 'result.yaml')


@pytest.mark.parametrize('text, message', [
    ('', 'holds no calibration result'),
    ('a: [1, 2', 'cannot be read as a result'),
    ('hello: world', 'format_version is missing'),
    ('!!python/object/apply:os.system ["true"]', 'cannot be read'),
    ('\0\1', 'cannot be read'),
    ('a: 2023-13-45', 'cannot be read as a result: '),
    ('a: !!int "abc"', 'cannot be read as a result: '),
    ('a: !!int ""', 'cannot be read as a result: malformed value'),
    ('a: !!bool x', 'cannot be read as a result: malformed value'),
    ('"\\U99999999"', 'cannot be read as a result: '),
    (f'a: {"9" * 5000}', 'cannot be read as a result: Exceeds the limit|is missing'),
    ('[' * 1000, 'cannot be read as a result: it is nested too deeply'),
])
def test_other_files_are_not_results(tmp_path, text, message):
    path = tmp_path / 'x.yaml'
    path.write_text(text)
    with pytest.raises(ResultError, match=message):
        CalibrationResult.load(path)


@pytest.mark.parametrize('key, value', [
    ('format_version', 99), ('T_a_b', None), ('T_a_b', {'translation': [0, 0], 'rotation_xyzw': [
        0, 0, 0, 1]}), ('config', {'max_gap': 'x'}), ('config', ''), ('inlier_motions', 'a-b'),
    ('poses', 'many'), ('poses', float('inf')), ('poses', True), ('motions', 10**15),
    ('motions', float('inf')),
    ('motions', -1), ('findings', 'abc'), ('findings', [5]), ('diagnosis', 5),
    ('optimality_gap', 'x'), ('scale', float('nan')), ('scale', 10**400), ('scale', '1'),
    ('time_offset_s', float('inf')), ('e_rt_m', 'nan'), ('reference_choice', 5),
    ('association', {}), ('association', 'abc'), ('observability', [])])
def test_a_spoilt_result_is_refused(result, key, value):
    data = {**result.to_dict(), key: value}
    with pytest.raises(ResultError):
        CalibrationResult.from_dict(data)


@pytest.mark.parametrize('quaternion, message', [
    ([1, 1, 0, 0], 'norm is 1.41421'), ([0, 0, 0, 0], 'norm is 0'), ([0, 0, 0, 1.02], 'norm is'),
    ([1e200] * 4, 'norm is inf'), ([0, 0, 1], 'needed'), ([0, 0, 0, float('nan')], 'finite')])
def test_a_quaternion_that_is_no_rotation_is_refused(result, quaternion, message):
    data = result.to_dict()
    data['T_a_b']['rotation_xyzw'] = quaternion
    with pytest.raises(ResultError, match=message):
        CalibrationResult.from_dict(data)


def test_a_quaternion_that_was_rounded_is_normalised(result):
    data = result.to_dict()
    data['T_a_b']['rotation_xyzw'] = [round(q, 4) for q in data['T_a_b']['rotation_xyzw']]
    R = CalibrationResult.from_dict(data).T_a_b[:3, :3]
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(R, result.T_a_b[:3, :3], atol=1e-3)


@pytest.mark.parametrize('ranges', ['0-{n}', '5-4', '-1-3', '3', '0-2,{n}-{n}'])
def test_inliers_beyond_the_motions_are_refused(result, ranges):
    data = {**result.to_dict(), 'inlier_motions': ranges.format(n=result.motions)}
    with pytest.raises(ResultError, match='inlier'):
        CalibrationResult.from_dict(data)


@pytest.mark.parametrize('spoil, message', [
    (lambda P: P[:5], 'needed'), (lambda P: P * np.nan, 'finite'),
    (lambda P: P + np.eye(6, k=1), 'symmetric'), (lambda P: -P, 'variance')])
def test_a_covariance_that_is_none_is_refused(result, spoil, message):
    data = {**result.to_dict(), 'covariance': spoil(result.covariance).tolist()}
    with pytest.raises(ResultError, match=message):
        CalibrationResult.from_dict(data)


def test_the_arrays_of_a_result_are_its_own_and_read_only(result):
    T_a_b, covariance = result.T_a_b.copy(), np.eye(6)
    mask = np.ones(result.motions, bool)
    frozen = dataclasses.replace(result, T_a_b=T_a_b, covariance=covariance, inliers=mask)
    T_a_b[0, 3] += 1
    covariance[0, 0] = 9
    mask[0] = False
    np.testing.assert_array_equal(frozen.T_a_b, result.T_a_b)
    np.testing.assert_array_equal(frozen.covariance, np.eye(6))
    assert frozen.inliers.all()
    for array in (frozen.T_a_b, frozen.covariance, frozen.inliers, result.T_a_b):
        with pytest.raises(ValueError, match='read-only'):
            array[0] = 0


def test_a_count_of_an_association_that_is_none_is_refused(result):
    data = result.to_dict()
    data['association']['pairs'] = 'many'
    with pytest.raises(ResultError, match="found 'many', needed a value of type int"):
        CalibrationResult.from_dict(data)


@pytest.mark.parametrize('path', ['', 'x\0', '/'])
def test_a_path_that_is_no_file_name_is_refused(result, path):
    with pytest.raises(ResultError, match='cannot be written'):
        result.save(path)
    with pytest.raises(ResultError, match='cannot be read'):
        CalibrationResult.load(path)


def test_findings_of_the_motion_survive_and_older_files_are_read_without(result, tmp_path):
    found = Finding('direction-weak', 'z weak', {'std_m': 0.1})
    dataclasses.replace(result, findings=(found,)).save(tmp_path / 'r.yaml')
    again = CalibrationResult.load(tmp_path / 'r.yaml')
    assert again.findings == again.observability.findings == (found,)
    assert again.warnings == ('z weak',)
    older = {**again.to_dict(), 'format_version': 1}
    del older['findings']
    read = CalibrationResult.from_dict(older)
    assert (read.warnings, read.observability.findings) == (('z weak',), ())
    older['warnings'] = 'abc'
    with pytest.raises(ResultError, match="found 'abc', needed a value of type list"):
        CalibrationResult.from_dict(older)


def test_a_result_of_settings_that_are_not_here_is_read_and_not_repeated(result):
    data = result.to_dict()
    data['config'] |= {'solver': 'acme', 'dnlo_method': 'annealing', 'old_setting': 3}
    read = CalibrationResult.from_dict(data)
    assert (read.config.solver, read.config.dnlo_method) == ('acme', 'annealing')
    assert read.to_dict()['config'] == data['config']
    assert 'acme' in Placement.of(read).origin
    with pytest.raises(ConfigError, match="setting 'old_setting' is unknown"):
        CalibrationConfig.from_dict(read.config.to_dict())
    del data['config']['old_setting'], data['config']['dnlo_method']
    with pytest.raises(ConfigError, match="solver 'acme' is unknown"):
        CalibrationConfig.from_dict(CalibrationResult.from_dict(data).config.to_dict())
    for wrong in ({'max_gap': 'x'}, {'max_gap': -1.0}, {'solver': []}, {
            'prior_translation': 'x'}):
        with pytest.raises(ResultError, match='not a calibration result'):
            CalibrationResult.from_dict({**data, 'config': {**data['config'], **wrong}})


def test_missing_file(tmp_path):
    with pytest.raises(ResultError, match='No such file'):
        CalibrationResult.load(tmp_path / 'none.yaml')


@pytest.mark.parametrize('kind', [CalibrationResult, RigResult])
@pytest.mark.parametrize('text', ['', 'a: [', 'no: result\n'])
def test_a_file_that_holds_something_else_is_named(tmp_path, kind, text):
    path = tmp_path / 'notes.yaml'
    path.write_text(text)
    with pytest.raises(ResultError, match=re.escape(str(path))):
        kind.load(path)


def test_two_sensors_of_one_name_are_a_warning():
    rng = np.random.default_rng(1)
    a, b = sensor_pair(rng, random_pose(rng))
    same = Trajectory(b.stamps_ns, b.poses, 'w', 'lidar')
    warnings = calibrate(a, same, CalibrationConfig(solver='taylor')).warnings
    assert any('both sensors are named lidar' in warning for warning in warnings)


def test_versions_agree(result):
    root = Path(__file__).parents[1]
    version = CalibrationResult.__dataclass_fields__['version'].default
    assert f'<version>{version}</version>' in (root / 'package.xml').read_text()
    assert result.to_dict()['package_version'] == version


def test_numbers_and_nouns_in_messages():
    assert [counted(1, 'pose'), counted(0, 'pose'), counted(1200, 'pose')] == [
        '1 pose', '0 poses', '1,200 poses']
    assert [rounded(1220.4), rounded(99.7), rounded(99.4), rounded(0.123), rounded(250, 3)] == [
        '1,220', '100', '99', '0.12', '250']
