# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""One truth about the parameters: options, parameter file and node agree."""

import math
from pathlib import Path

import pytest
from ros_if_any import needs_ros, ros
from ruamel.yaml import YAML

from trajectory_calibration import CalibrationConfig, ConfigError
from trajectory_calibration.online import options

pytestmark = needs_ros

ROOT = Path(__file__).resolve().parents[2]


def from_file():
    document = YAML(typ='safe').load((ROOT / 'config' / 'calibration.yaml').read_text())
    return document['/**']['ros__parameters']


def test_the_parameter_file_is_what_the_options_say():
    assert (ROOT / 'config' / 'calibration.yaml').read_text() == options.parameter_file(), (
        'write it anew: python3 -m trajectory_calibration.online.options '
        '> config/calibration.yaml')


def test_there_is_an_option_for_every_setting_of_a_calibration():
    for option in CalibrationConfig.options():
        assert options.OPTIONS[option.name] == option


def test_the_parameter_file_holds_every_parameter_with_its_default():
    values = from_file()
    assert values == {option.name: option.default for option in options.OPTIONS.values()}
    assert {name: type(value) for name, value in values.items()} == {
        option.name: option.kind for option in options.OPTIONS.values()}


def test_every_option_has_a_range_or_is_free_text():
    for option in options.OPTIONS.values():
        if option.kind in (int, float):
            assert math.isfinite(option.minimum) and math.isfinite(option.maximum), option.name
        assert option.check(option.default) == option.default


def test_the_node_declares_exactly_these_parameters(tmp_path):
    config = str(ROOT / 'config' / 'calibration.yaml')
    with ros.running(tmp_path, '--params-file', config, '-p', 'max_gap:=2') as (_, client):
        listed = client.call('list_parameters').result.names
        names = [option.name for option in options.OPTIONS.values()]
        request = ros.GetParameters.Request(names=names)
        values = [ros.parameter_value_to_python(value)
                  for value in client.call('get_parameters', request).values]
        described = client.call(
            'describe_parameters', ros.DescribeParameters.Request(names=names)).descriptors
    foreign = {'use_sim_time', 'start_type_description_service'}
    assert set(listed) - foreign == set(names)
    expected = {option.name: option.default for option in options.OPTIONS.values()}
    expected['max_gap'] = 2.0
    assert dict(zip(names, values, strict=True)) == expected
    for option, descriptor in zip(options.OPTIONS.values(), described, strict=True):
        assert descriptor.description == option.help
        if option.kind is float:
            assert descriptor.floating_point_range[0].to_value == option.maximum
        if option.choices:
            assert option.choices[-1] in descriptor.additional_constraints


@pytest.mark.parametrize('values, sentence', [
    ({'max_gap': float('nan')}, 'max_gap is nan'),
    ({'max_gap': None}, 'max_gap is None'),
    ({'max_poses': True}, 'max_poses is True'),
    ({'max_poses': 5}, 'needed 10 to'),
    ({'type_b': 'Imu'}, "type 'Imu' cannot be used"),
    ({'nonsense': 1}, "'nonsense' is unknown"),
])
def test_values_are_judged_in_one_place(values, sentence):
    with pytest.raises(ConfigError, match=sentence):
        options.check_values(values)


def test_an_integer_serves_where_a_double_is_meant():
    value = options.check_values({'max_gap': 1})['max_gap']
    assert value == 1.0 and isinstance(value, float)
