# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The nodes that ``rig.launch.py`` starts for RIG.yaml."""

import pytest

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.errors import ConfigError
from trajectory_calibration.online.options import OPTIONS
from trajectory_calibration.rig.nodes import nodes_of

RIG = """base: lidar
sensors:
  camera-1: {topic: /orb/pose, frame: cam1, scale: free}
  lidar: {topic: /lidar/odom, frame: velodyne}
  wheels: {tf: odom.base_link, prior_translation: '-,-,0.4', prior_translation_std: 0.01}
settings: {max_time_offset: 1.0}
"""


def test_every_sensor_has_a_node_against_the_base(tmp_path):
    (tmp_path / 'RIG.yaml').write_text(RIG)
    camera, wheels = nodes_of(tmp_path / 'RIG.yaml', 'results', sim_time=True)
    assert camera.name == 'calibrate_camera_1'
    assert camera.parameters == {
        'topic_a': '/lidar/odom', 'topic_b': '/orb/pose', 'frame_a': 'velodyne',
        'frame_b': 'cam1', 'scale_mode': 'estimate', 'result_directory': 'results',
        'max_time_offset': 1.0, 'use_sim_time': True}
    assert wheels.parameters['topic_b'] == 'tf:odom.base_link'
    assert wheels.parameters['prior_translation_std'] == '0.01'


def test_every_parameter_is_one_of_the_node(tmp_path):
    (tmp_path / 'RIG.yaml').write_text(RIG)
    known = {*OPTIONS, *(option.name for option in CalibrationConfig.options()), 'use_sim_time'}
    for node in nodes_of(tmp_path / 'RIG.yaml', 'results'):
        assert set(node.parameters) <= known


def test_files_are_no_topics(tmp_path):
    (tmp_path / 'a.tum').write_text('0 0 0 0 0 0 0 1\n')
    (tmp_path / 'RIG.yaml').write_text(
        'sensors:\n  a: {file: a.tum}\n  b: {topic: /b}\n')
    with pytest.raises(ConfigError, match='sensor a has a file'):
        nodes_of(tmp_path / 'RIG.yaml')


def test_the_base_is_a_sensor(tmp_path):
    (tmp_path / 'RIG.yaml').write_text(
        'base: c\nsensors:\n  a: {topic: /a}\n  b: {topic: /b}\n')
    with pytest.raises(ConfigError, match="the base 'c'"):
        nodes_of(tmp_path / 'RIG.yaml')
