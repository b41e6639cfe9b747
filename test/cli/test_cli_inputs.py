# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Options of the inputs: they reach the readers, for both files or for one."""

import argparse
from pathlib import Path
import re
import shlex

from cli_helpers import run, write_pair, write_pair_bag
import pytest

from trajectory_calibration.cli.inputs import (
    add_input_arguments,
    options_of,
    split_bags,
)
from trajectory_calibration.cli.options import add_config_options
from trajectory_calibration.sources.inputs import InputOptions, load_inputs


def _options(*arguments):
    parser = argparse.ArgumentParser()
    add_input_arguments(parser)
    parsed = parser.parse_args(['a', 'b', *arguments])
    return options_of(parsed, 'a'), options_of(parsed, 'b')


def test_an_option_for_both_and_for_one():
    a, b = _options('--columns', 't,x', '--columns-b', 'x,t', '--time-unit', 'ms', '--invert-b',
                    '--frame-a', 'lidar', '--quaternion-order-a', 'wxyz', '--format-b', 'g2o')
    assert a == InputOptions(
        frame='lidar', columns='t,x', time_unit='ms', quaternion_order='wxyz')
    assert b == InputOptions(columns='x,t', time_unit='ms', invert=True, file_format='g2o')


def test_several_bags_after_one_option(tmp_path):
    one, two = tmp_path / 'one', tmp_path / 'two.mcap'
    one.mkdir()
    two.touch()
    expected = ['--bag', str(one), '--bag', str(two)]
    assert split_bags(['--bag', str(one), str(two), '/a', '/b']) == [*expected, '/a', '/b']
    assert split_bags(['/a', '/b', '--bag', str(one), str(two), '-v']) == [
        '/a', '/b', *expected, '-v']
    assert split_bags(['--bag', str(one), '--bag', str(two)]) == expected
    # What is named first is a bag, also where it does not exist.
    assert split_bags(['--bag', 'none', '/a']) == ['--bag', 'none', '/a']
    assert split_bags(['--', '--bag', str(one), str(two)]) == ['--', '--bag', str(one), str(two)]


def test_a_file_and_a_topic(tmp_path, capsys):
    a, _, _ = write_pair(tmp_path)
    bag = write_pair_bag(tmp_path / 'bag')
    status, out, err = run(
        capsys, 'calibrate', a, '/camera/pose', '--bag', bag, '--solver', 'park', '--reference',
        'B5', '--format', 'json')
    assert (status, err) == (0, '')
    assert '"frame_a": "sensor_a"' in out


@pytest.mark.parametrize(('arguments', 'message'), [
    (['/x', '/x', '--bag', '{bag}'], '/x is given twice; two sensors are needed'),
    (['/x', 'x', '--bag', '{bag}'], 'x is given twice; two sensors are needed'),
    (['{a}', '{b}', '--bag', '{bag}'], '--bag {bag} is not used: {a} and {b} are files'),
    (['tf:map.base', '{a}'], 'tf:map.base names frames of a bag; give the bag with --bag'),
    (['tf:map.base', '/camera/pose', '--bag', '{bag}'], 'no topic of transforms'),
    (['{a}', '{b}', '--columns', 't,x'], 'names no complete pose'),
])
def test_inputs_that_are_none(tmp_path, capsys, arguments, message):
    a, b, _ = write_pair(tmp_path)
    names = {'a': a, 'b': b, 'bag': write_pair_bag(tmp_path / 'bag')}
    status, out, err = run(capsys, 'calibrate', *(item.format(**names) for item in arguments))
    assert status in (1, 2)
    assert out == ''
    assert message.format(**names) in err


def test_one_input_alone(tmp_path):
    a, _, _ = write_pair(tmp_path)
    assert load_inputs({'lidar': (a, InputOptions())})['lidar'].sensor_frame == 'lidar'
    bag = write_pair_bag(tmp_path / 'bag')
    found = load_inputs({'sensor': ('lidar/odom', InputOptions())}, [bag])
    assert found['sensor'].sensor_frame == 'lidar'


@pytest.mark.parametrize('page', ['inputs.md', 'from_slam.md'])
def test_the_docs_name_options_that_exist(page):
    text = (Path(__file__).parents[2] / 'docs' / page).read_text(encoding='utf-8')
    parser = argparse.ArgumentParser()
    add_input_arguments(parser)
    add_config_options(parser)
    commands = re.findall(r'`calibrate ([^`]*)`', text)
    assert len(commands) > 10
    for command in commands:
        parser.parse_args(split_bags(shlex.split(command.partition(';')[0])))
