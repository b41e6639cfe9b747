# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The launch file and what it makes of its arguments."""

from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
import sys
from types import ModuleType

import pytest

from trajectory_calibration import ConfigError
from trajectory_calibration.online.launch_arguments import ARGUMENTS, launch_settings, PARAMETERS
from trajectory_calibration.online.options import OPTIONS

ROOT = Path(__file__).resolve().parents[2]
FILE = ROOT / 'launch' / 'calibration.launch.py'
CONFIG = str(ROOT / 'config' / 'calibration.yaml')


def test_what_is_not_given_is_left_to_the_file():
    settings = launch_settings({})
    assert (settings.params_file, settings.parameters) == (None, {'use_sim_time': False})
    assert (settings.name, settings.log_level, settings.respawn) == (
        'trajectory_calibration', 'info', False)


def test_what_is_given_beats_the_file_in_its_type():
    settings = launch_settings({
        'params_file': CONFIG, 'topic_a': '/lidar', 'frame_b': 'off', 'publish_tf': 'True',
        'result_directory': '~/results', 'namespace': 'front', 'respawn': 'true',
        'log_level': 'debug', 'name': 'extrinsics'})
    assert settings.params_file == CONFIG
    assert settings.parameters == {
        'use_sim_time': False, 'topic_a': '/lidar', 'frame_b': 'off', 'publish_tf': True,
        'result_directory': '~/results'}
    assert (settings.namespace, settings.name, settings.log_level, settings.respawn) == (
        'front', 'extrinsics', 'debug', True)


def test_config_is_the_older_name_of_the_file():
    assert launch_settings({'config': CONFIG}).params_file == CONFIG


@pytest.mark.parametrize('arguments, words', [
    ({'params_file': '/nowhere.yaml'}, 'params_file /nowhere.yaml does not exist'),
    ({'config': '/nowhere.yaml'}, 'params_file /nowhere.yaml does not exist'),
    ({'params_file': CONFIG, 'config': '/other.yaml'}, 'two names of one argument'),
    ({'publish_tf': 'maybe'}, "publish_tf is 'maybe', needed true or false"),
    ({'respawn': '5'}, "respawn is '5'"), ({'use_sim_time': 'x'}, 'use_sim_time'),
    ({'log_level': 'loud'}, 'needed one of debug, info'),
])
def test_what_does_not_fit_is_an_error(arguments, words):
    with pytest.raises(ConfigError, match=words):
        launch_settings(arguments)


def test_every_parameter_among_the_arguments_is_one_of_the_node():
    assert set(PARAMETERS) <= set(OPTIONS)
    assert {name for name, _, _ in ARGUMENTS} >= {
        'params_file', 'config', 'topic_a', 'topic_b', 'frame_a', 'frame_b', 'publish_tf',
        'result_directory', 'log_level', 'respawn', 'name', 'namespace', 'use_sim_time'}


class Recorded:
    """Stands for an action of launch: remembers how it was made."""

    def __init__(self, *args, **kwargs):
        self.args, self.kwargs = args, kwargs

    def perform(self, context):
        return context[self.args[0]]


def load(monkeypatch):
    """Return the launch file as a module, with stand-ins for launch where it is missing."""
    if find_spec('launch_ros') is None:
        for name, members in {
                'launch': ['LaunchDescription'],
                'launch.actions': ['DeclareLaunchArgument', 'OpaqueFunction'],
                'launch.substitutions': ['LaunchConfiguration'],
                'launch_ros': [], 'launch_ros.actions': ['Node'],
                'launch_ros.parameter_descriptions': ['ParameterValue']}.items():
            module = ModuleType(name)
            for member in members:
                setattr(module, member, type(member, (Recorded,), {}))
            monkeypatch.setitem(sys.modules, name, module)
    spec = spec_from_file_location('calibration_launch', FILE)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.skipif(find_spec('launch_ros') is not None, reason='launch_ros is installed')
def test_the_launch_file_puts_arguments_after_the_file(monkeypatch):
    module = load(monkeypatch)
    declared = module.generate_launch_description().args[0]
    assert [item.args[0] for item in declared[:-1]] == [name for name, _, _ in ARGUMENTS]
    context = {name: default for name, default, _ in ARGUMENTS}
    (node,) = declared[-1].kwargs['function'](
        {**context, 'params_file': CONFIG, 'topic_a': '/lidar', 'name': 'extrinsics'})
    file, overrides = node.kwargs['parameters']
    assert file == CONFIG
    assert {name: value.args[0] for name, value in overrides.items()} == {
        'use_sim_time': False, 'topic_a': '/lidar'}
    assert (node.kwargs['name'], node.kwargs['executable']) == ('extrinsics', 'calibration_node')
    assert node.kwargs['arguments'] == ['--ros-args', '--log-level', 'info']


@pytest.mark.skipif(find_spec('launch_ros') is None, reason='launch_ros is missing')
@pytest.mark.parametrize('arguments, status', [
    ([('params_file', '/nowhere.yaml')], 1), ([('log_level', 'loud')], 1)])
def test_launch_itself_refuses_what_does_not_fit(monkeypatch, arguments, status):
    from launch import LaunchService
    from launch.actions import SetLaunchConfiguration
    description = load(monkeypatch).generate_launch_description()
    for name, value in arguments:
        description.entities.insert(0, SetLaunchConfiguration(name, value))
    service = LaunchService(noninteractive=True)
    service.include_launch_description(description)
    assert service.run() == status
