# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The answer of a call, and a saved result that must fit the vehicle."""

from dataclasses import replace
import json
from pathlib import Path

import numpy as np
import pytest

from trajectory_calibration import calibrate, CalibrationConfig, Trajectory
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.geometry import se3
from trajectory_calibration.online.answer import describe, headline, summary
from trajectory_calibration.online.options import in_node_words
from trajectory_calibration.online.store import Restored

T_A_B = se3.exp_se3([0.3, -0.2, 0.1, 0.4, -0.3, 1.2])


@pytest.fixture(scope='module')
def result():
    rng = np.random.default_rng(2)
    a = se3.exp_se3(np.cumsum(rng.normal(size=(60, 6)) * 0.1, axis=0))
    stamps_ns = np.arange(1, 61) * 10**8
    return calibrate(
        Trajectory(stamps_ns, a, 'map', 'lidar'), Trajectory(stamps_ns, a @ T_A_B, 'w', 'camera'),
        CalibrationConfig(solver='taylor', max_time_offset=0))


def test_the_last_line_is_json_and_each_other_one_thing(result):
    text, _, machine = describe(result, 'saved in x', '').rpartition('\n')
    assert machine == summary(result) and '\n' not in machine
    lines = text.split('\n - ')
    assert lines[0] == headline(result)
    assert [line.partition(':')[0] for line in lines[1:4]] == [
        'standard deviations', 'data', 'saved in x']
    found = json.loads(machine)
    assert np.allclose(found['translation_m'], T_A_B[:3, 3], atol=1e-9)
    assert set(found['status'].values()) == {'observed'}


def test_what_is_unknown_is_no_number(result):
    def opened(name):
        status = {**result.observability.status, name: 'unobserved'}
        return replace(result, observability=replace(result.observability, status=status))
    x, y, z = T_A_B[:3, 3]
    assert f'translation [{x:.4f}, {y:.4f}, unknown] m, rotation xyzw [0' in headline(opened('z'))
    assert headline(opened('rotation x')).endswith(f'{", ".join(["unknown"] * 4)}]')
    assert f'{z:.4f}] m' in headline(opened('rotation x'))


@pytest.mark.parametrize('frames, expected', [
    (('', ''), None), (('lidar', ''), None), (('lidar', 'camera'), ''),
    (('lidar', 'camera_2'), 'the topics carry lidar and camera_2'),
    (('', 'camera_2'), 'the topics carry unknown and camera_2'),
])
def test_a_saved_result_waits_for_its_frames_and_is_refused_for_others(result, frames, expected):
    found = Restored(Path('x_000001.yaml'), result).compare(frames)
    assert found == expected if not expected else expected in found


@pytest.mark.parametrize('text, wanted', [
    ('add --prior-translation=-,-,Z --prior-translation-std=0.01, or',
     'add prior_translation:=-,-,Z prior_translation_std:=0.01, or'),
    ('Add --prior-translation, --prior-rotation.', 'Add prior_translation, prior_rotation.'),
    ('--association=nearest --max-time-difference=0.74. If they moved: --max-gap=2',
     'association:=nearest max_time_difference:=0.74. If they moved: max_gap:=2'),
    ('or --no-input-checks if', 'or input_checks:=false if'),
    # The node receives what is published: it has no such parameter.
    ('Use --invert-a', 'Use --invert-a'),
])
def test_options_of_the_command_line_become_parameters(text, wanted):
    assert in_node_words(text) == wanted


def test_findings_in_an_answer_name_parameters(result):
    said = replace(result, findings=(Finding('direction-weak', 'weak: add --prior-rotation=R'),))
    assert '\n - warning: weak: add prior_rotation:=R\n' in describe(said)
