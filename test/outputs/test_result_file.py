# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A result file means the same to every reader, and is what its schema says."""

import dataclasses
import json

from motion_data import perturb, random_pose, sensor_pair
import numpy as np
import pytest
from schemas import validator

from trajectory_calibration import calibrate, CalibrationConfig, CalibrationResult, ResultError
from trajectory_calibration.config.yaml_file import parse_yaml, quoted, read_yaml, to_yaml

# What one version of YAML or the other takes for a truth value, a number, a time or nothing.
WORDS = ['off', 'y', 'n', 'Yes', 'NO', 'on', 'true', 'null', '~', '1:30', '2020-01-01', '0x1F',
         '1e5', '1_000', '0o7', '010', '.5', '+1', '=', '<<', '-', 'x: y', '# a', 'a # b', '!x',
         '&a', '*b', '%c', '@d', '`e', '"q"', "'s'", ' lead', 'trail ', 'a\tb', 'a\nb', '',
         'NaN', '.nan', '\x7f', '\x85', 'é', '😀', 'lidar', '/tf:map.base', 'word ' * 60, '{a}',
         'a,b', '[x', 'a: b', '-5', '1.5e', '\\n', '"\\']


@pytest.fixture(scope='module', params=['dnl', 'dnlo', 'drift_aware'])
def result(request):
    rng = np.random.default_rng(0)
    a, b = (perturb(rng, item, 1e-3, 1e-3) for item in sensor_pair(rng, random_pose(rng)))
    return calibrate(a, b, CalibrationConfig(solver=request.param))


def test_words_and_numbers_mean_the_same_in_both_versions():
    yaml_1_1 = pytest.importorskip('yaml', reason='PyYAML is not installed')
    data = {**{word: word for word in WORDS}, 'list': WORDS,
            'numbers': [1e-5, 1e20, -2.5e-300, 0.1, 3, -0.0, 123456789.125]}
    for version in (yaml_1_1.safe_load, lambda text: parse_yaml(text, '', ResultError)):
        assert version(to_yaml(data)) == data
        for word in WORDS:
            assert version(quoted(word)) == word


def test_a_saved_result_is_read_alike_by_both(result, tmp_path):
    yaml_1_1 = pytest.importorskip('yaml', reason='PyYAML is not installed')
    named = dataclasses.replace(result, frame_a='off', frame_b='1:30')
    named.save(tmp_path / 'r.yaml')
    text = (tmp_path / 'r.yaml').read_text(encoding='utf-8')
    assert yaml_1_1.safe_load(text) == read_yaml(tmp_path / 'r.yaml', '', ResultError)
    assert yaml_1_1.safe_load(text) == json.loads(json.dumps(named.to_dict()))
    again = CalibrationResult.load(tmp_path / 'r.yaml')
    assert (again.frame_a, again.frame_b) == ('off', '1:30')
    assert (again.start_ns, again.duration_s) == (result.start_ns, result.duration_s)


def test_it_is_what_the_schema_says(result):
    of_result = validator('result.schema.json')
    schema = of_result.schema
    for data in (result.to_dict(), result.to_dict(result.T_a_b),
                 dataclasses.replace(result, covariance=None).to_dict()):
        of_result.validate(json.loads(json.dumps(data, allow_nan=False)))
        # Every key is described, and none that is described is missing.
        assert set(data) == set(schema['properties']) == set(schema['required'])
    assert not of_result.is_valid({**result.to_dict(), 'covariance': [[1.0]]})


def test_it_says_nothing_against_itself(result):
    data = result.to_dict()
    assert data['T_a_b']['translation'] == data['T_a_b']['translation_m']
    assert data['clock_drift_ppm'] == 1e6 * data['clock_drift']
    np.testing.assert_allclose(
        [*data['std_m'], *np.deg2rad(data['std_deg'])], np.sqrt(np.diag(data['covariance'])))
    assert data['start_utc'] == '2023-11-14T22:13:20Z'
    assert data['duration_s'] == pytest.approx(9.9)
    assert data['reference_choice'] is None or data['reference'] in data['reference_choice']


def test_what_the_first_format_saved_is_read(result):
    old = result.to_dict()
    for name in ('std_m', 'std_deg', 'clock_drift_ppm', 'start_ns', 'start_utc', 'duration_s',
                 'findings'):
        del old[name]
    for name in ('translation_m', 'rotation_rpy_deg'):
        del old['T_a_b'][name]
    old.update(format_version=1, warnings=['a sentence'])
    again = CalibrationResult.from_dict(old)
    np.testing.assert_allclose(again.T_a_b, result.T_a_b, atol=1e-15)
    assert [(found.code, found.text) for found in again.findings] == [('other', 'a sentence')]
    assert (again.start_ns, again.start_utc, again.duration_s) == (None, None, None)
