# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The launch files and what they make of their arguments."""

from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
import sys
from types import ModuleType

import pytest

from trajectory_calibration import ConfigError
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.online.launch_arguments import (
    ARGUMENTS,
    launch_settings,
    PARAMETERS,
    RIG_ARGUMENTS,
    rig_settings,
)
from trajectory_calibration.online.options import OPTIONS

ROOT = Path(__file__).resolve().parents[2]
FILES = ROOT / 'launch'
CONFIG = str(ROOT / 'config' / 'calibration.yaml')
RIG = """base: lidar
sensors:
  camera-1: {topic: /orb/pose, frame: cam1, scale: free}
  lidar: {topic: /lidar/odom, frame: velodyne}
  wheels: {tf: odom.base_link, prior_translation: '-,-,0.4', prior_translation_std: 0.01}
settings: {max_time_offset: 1.0}
"""


def test_what_is_not_given_is_left_to_the_file():
    settings = launch_settings({})
    assert (settings.params_file, settings.parameters) == (None, {})
    assert (settings.name, settings.log_level, settings.respawn) == (
        'trajectory_calibration', 'info', False)


def test_what_is_given_beats_the_file_in_its_type():
    settings = launch_settings({
        'params_file': CONFIG, 'topic_a': '/lidar', 'frame_b': 'off', 'publish_tf': 'True',
        'result_directory': '~/results', 'namespace': 'front', 'respawn': 'true',
        'log_level': 'debug', 'name': 'extrinsics'})
    assert settings.params_file == CONFIG
    assert settings.parameters == {
        'topic_a': '/lidar', 'frame_b': 'off', 'publish_tf': True,
        'result_directory': '~/results'}
    assert (settings.namespace, settings.name, settings.log_level, settings.respawn) == (
        'front', 'extrinsics', 'debug', True)


@pytest.mark.parametrize('text, value', [('true', True), ('False', False)])
def test_simulated_time_is_the_argument_where_it_is_given(text, value):
    assert launch_settings({'use_sim_time': text}).parameters == {'use_sim_time': value}


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


@pytest.fixture
def rig(tmp_path):
    """Return a function that writes RIG.yaml and returns its path as a text."""
    def write(text):
        path = tmp_path / 'RIG.yaml'
        path.write_text(text)
        return str(path)
    return write


def test_every_sensor_of_a_rig_has_a_node_against_the_base(rig):
    camera, wheels = rig_settings({
        'rig': rig(RIG), 'params_file': CONFIG, 'result_directory': 'results',
        'use_sim_time': 'true', 'respawn': 'true'})
    assert (camera.name, camera.namespace, camera.params_file, camera.respawn) == (
        'calibrate_camera_1', 'rig', CONFIG, True)
    assert camera.parameters == {
        'topic_a': '/lidar/odom', 'topic_b': '/orb/pose', 'frame_a': 'velodyne',
        'frame_b': 'cam1', 'scale_mode': 'estimate', 'scale': 1.0,
        'result_directory': 'results', 'max_time_offset': 1.0, 'use_sim_time': True}
    assert wheels.parameters['topic_b'] == 'tf:odom.base_link'
    assert wheels.parameters['prior_translation_std'] == '0.01'


def test_what_a_rig_is_not_given_is_left_to_the_file(rig):
    known = {*OPTIONS, *(option.name for option in CalibrationConfig.options())}
    for node in rig_settings({'rig': rig(RIG)}):
        assert set(node.parameters) <= known - {'result_directory'}


TWO = 'sensors:\n  a: {topic: /a}\n'


@pytest.mark.parametrize('text, arguments, words', [
    (RIG, {'rig': ''}, 'rig is empty, needed the description of the sensors: rig:=RIG.yaml'),
    (RIG, {'rig': '/nowhere.yaml'}, '/nowhere.yaml cannot be read as the description of a rig'),
    (RIG, {'params_file': '/nowhere.yaml'}, 'params_file /nowhere.yaml does not exist'),
    (RIG, {'use_sim_time': '1'}, "use_sim_time is '1', needed true or false"),
    (RIG, {'log_level': 'loud'}, 'needed one of debug, info'),
    (TWO + '  b: {file: RIG.yaml}\n', {}, 'sensor b has a file'),
    (f'base: c\n{TWO}  b: {{topic: /b}}\n', {}, "the base 'c' is none of the sensors: a, b"),
    (TWO + '  b-1: {topic: /b}\n  b_1: {topic: /c}\n', {},
     'the sensors b-1 and b_1 would both be calibrated by the node calibrate_b_1; rename'),
])
def test_what_does_not_fit_a_rig_is_an_error(rig, text, arguments, words):
    with pytest.raises(ConfigError, match=words):
        rig_settings({'rig': rig(text), **arguments})


def test_the_name_of_a_node_has_no_letter_that_ros_refuses(rig):
    node, = rig_settings({'rig': rig(TWO + '  kamera v\u00f6rn: {topic: /b}\n')})
    assert node.name == 'calibrate_kamera_v_rn'


class Recorded:
    """Stands for an action of launch: remembers how it was made."""

    def __init__(self, *args, **kwargs):
        self.args, self.kwargs = args, kwargs

    def perform(self, context):
        return context[self.args[0]]


def load(monkeypatch, file='calibration'):
    """Return a launch file as a module, with stand-ins for launch where it is missing."""
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
    spec = spec_from_file_location(f'{file}_launch', FILES / f'{file}.launch.py')
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
    assert {name: value.args[0] for name, value in overrides.items()} == {'topic_a': '/lidar'}
    assert (node.kwargs['name'], node.kwargs['executable']) == ('extrinsics', 'calibration_node')
    assert node.kwargs['arguments'] == ['--ros-args', '--log-level', 'info']
    bare, = declared[-1].kwargs['function'](context)
    assert bare.kwargs['parameters'] == []


@pytest.mark.skipif(find_spec('launch_ros') is not None, reason='launch_ros is installed')
def test_the_launch_file_of_a_rig_starts_all_nodes(monkeypatch, rig):
    declared = load(monkeypatch, 'rig').generate_launch_description().args[0]
    assert [item.args[0] for item in declared[:-1]] == [name for name, _, _ in RIG_ARGUMENTS]
    context = {name: default for name, default, _ in RIG_ARGUMENTS}
    nodes = declared[-1].kwargs['function']({**context, 'rig': rig(RIG), 'params_file': CONFIG})
    assert [node.kwargs['name'] for node in nodes] == ['calibrate_camera_1', 'calibrate_wheels']
    for node in nodes:
        file, overrides = node.kwargs['parameters']
        assert file == CONFIG
        assert overrides['frame_a'].args == ('velodyne',)
        assert overrides['frame_a'].kwargs == {'value_type': str}


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
