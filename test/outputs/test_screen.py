# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The screen: the answer first, with a mark beside each number; findings, width and colour."""

from dataclasses import replace
import io

import numpy as np
import pytest

from trajectory_calibration import CalibrationConfig, CalibrationResult
from trajectory_calibration.assessment.metrics import RelativeErrors
from trajectory_calibration.assessment.observability import DEGREES_OF_FREEDOM, Observability
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.pose_pairs import AssociationSummary
from trajectory_calibration.geometry import se3
from trajectory_calibration.outputs.answer import (
    angle_jacobian,
    answer_rows,
    status_sentence,
    verdict_of,
)
from trajectory_calibration.outputs.report.box import verdict_box
from trajectory_calibration.outputs.screen import format_result, format_transform
from trajectory_calibration.outputs.terminal import Terminal


def make(std=(0.01, 0.02, 0.03, 0.1, 0.2, 0.3), R=None, status=None, findings=(), **config):
    """Return a result with standard deviations in metres and degrees."""
    status = dict.fromkeys(DEGREES_OF_FREEDOM, 'observed') | (status or {})
    sigma = np.concatenate([std[:3], np.deg2rad(std[3:])])
    return CalibrationResult(
        frame_a='lidar', frame_b='camera',
        T_a_b=se3.from_rotation_translation(
            np.eye(3) if R is None else R, [0.2, -1.25, 0.0]),
        covariance=np.diag(sigma**2), metrics=RelativeErrors(0.1, 0.01), poses=10, motions=9,
        inliers=None,
        observability=Observability(status, (), (1.0, 2.0, 3.0), (1.0, 1.0, 1.0),
                                    tuple(map(tuple, np.eye(3)))),
        association=AssociationSummary('interpolate', 0.0, 10, 10, 10, 0, 0, 0, 0.0, 0.0),
        config=CalibrationConfig(**config), findings=findings, reference='B5')


def test_points_stand_below_each_other_and_every_number_has_a_mark():
    lines = format_result(make()).splitlines()[1:7]
    assert len({line.index('.') for line in lines}) == 1
    assert [line.split()[-1] for line in lines] == ['ok'] * 6
    assert lines[1].split() == ['y', '-1.250', '+-', '0.020', 'm', 'ok']
    # No minus before a zero.
    assert lines[2].split()[1] == '0.000'


def test_what_is_unobserved_is_no_number():
    way_out = 'add --prior-translation=-,-,Z --prior-translation-std=0.01'
    result = make(status={'z': 'unobserved', 'rotation y': 'weak'},
                  findings=(Finding('direction-unobserved', way_out),))
    lines = format_result(result).splitlines()
    assert lines[3].split() == ['z', 'unknown', 'unknown']
    assert lines[5].split()[-1] == 'weak'
    assert format_transform(result).split()[:3] == ['0.200000000', '-1.250000000', 'unknown']
    verdict = verdict_of(result)
    assert verdict.level == 'incomplete'
    assert '--prior-translation=-,-,Z --prior-translation-std=0.01' in verdict.next_step


def test_an_unobserved_rotation_hides_the_quaternion():
    words = format_transform(make(status={'rotation z': 'unobserved'})).split()
    assert words[3:] == ['unknown'] * 4
    text = format_result(make(status={'rotation z': 'unobserved'}), verbose=True)
    assert next(line for line in text.splitlines() if 'quaternion' in line).endswith(' unknown')


def test_the_error_against_the_truth_leaves_out_what_is_unknown():
    T = np.eye(4)
    T[:3, 3] = [0.23, -1.29, 7.0]
    line = '  error against the ground truth: '
    assert line + '7.0002 m, 0.000 deg\n' in format_result(make(), T)
    assert line + '0.0500 m, 0.000 deg (without z)\n' in format_result(
        make(status={'z': 'unobserved'}), T)
    assert line + 'unknown, 0.000 deg (without x, y, z)\n' in format_result(
        make(status=dict.fromkeys('xyz', 'unobserved')), T)


def test_an_error_beyond_deviations_of_zero_is_a_number_a_person_can_read():
    result = make(std=(1e-13,) * 6)
    T = result.T_a_b.copy()
    T[0, 3] += 0.02
    assert format_result(result, T).splitlines()[1].endswith('error -0.020000 m > 1000 sigma')
    assert '<td class="num unknown">&gt; 1000</td>' in verdict_box(
        result, answer_rows(result, T))
    near = make(std=(0.01,) * 6)
    assert format_result(near, T).splitlines()[1].endswith('error -0.020 m = 2.0 sigma')


def test_verbose_says_which_poses_were_not_used():
    result = make()
    summary = replace(result.association, in_gaps=2, between=35)
    text = format_result(replace(result, association=summary), verbose=True)
    assert 'unused poses of b: 2 in gaps, 35 between poses' in ' '.join(text.split())


@pytest.mark.parametrize('axis, name', [(0, 'pitch'), (1, 'yaw'), (2, 'yaw')])
def test_an_open_axis_is_seen_in_the_angle_that_it_turns(axis, name):
    # The optical frame of a camera that looks ahead.
    R = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    unknown = f'rotation {"xyz"[axis]}'
    rows = answer_rows(make(R=R, status={unknown: 'unobserved'}))
    assert [row.name for row in rows if not row.is_known] != []
    J = angle_jacobian(R)
    step = np.zeros(3)
    step[axis] = 1e-6
    moved = se3.roll_pitch_yaw(se3.exp_so3(step) @ R) - se3.roll_pitch_yaw(R)
    np.testing.assert_allclose(moved, J @ step, atol=1e-10)
    worst = int(np.argmax(np.abs(J[:, axis])))
    assert not rows[3 + worst].is_known
    del name


@pytest.mark.parametrize('angles', [(0.3, -0.4, 1.2), (2.9, 1.2, -3.0), (-1.57, 0.01, -1.57)])
def test_deviations_of_roll_pitch_yaw(angles):
    R = se3.rotation_from_roll_pitch_yaw(angles)
    std = np.deg2rad([0.1, 0.2, 0.3])
    rows = answer_rows(make(R=R, std=(0.01, 0.01, 0.01, 0.1, 0.2, 0.3)))
    draws = np.random.default_rng(0).normal(size=(20000, 3)) * std
    spread = np.rad2deg(
        np.angle(np.exp(1j * (se3.roll_pitch_yaw(se3.exp_so3(draws) @ R) - np.array(angles)))))
    np.testing.assert_allclose([row.std for row in rows[3:]], spread.std(axis=0), rtol=0.03)


def test_three_findings_worst_first_and_the_rest_with_v():
    findings = (Finding('scale', 'one'), Finding('clock-offset', 'two'),
                Finding('direction-weak', 'three'), Finding('poses-identical', 'four'),
                Finding('clock-drift', 'five'))
    text = format_result(make(findings=findings))
    assert text.endswith('\nserious: four\nwarning: three\nnote: one\nand 2 more: -v\n')
    verbose = format_result(make(findings=findings), verbose=True)
    assert 'note: five' in verbose
    assert 'more: -v' not in verbose


def test_statuses_in_one_sentence():
    assert status_sentence(answer_rows(make())) == 'all six numbers ok'
    weak = make(status={'x': 'weak', 'y': 'weak', 'z': 'unobserved'})
    assert status_sentence(answer_rows(weak)) == 'rotation ok; x, y weak; z unknown'
    assert verdict_of(make(findings=(Finding('clock-ambiguous', 'two clocks'),))).level == 'care'


def test_a_path_is_never_broken_and_text_fits_a_narrow_terminal():
    path = '/tmp/' + 'x' * 150
    findings = (Finding('input-repaired', f'{path}: ' + 'many words ' * 20),)
    lines = format_result(make(findings=findings), terminal=Terminal(60)).splitlines()
    assert [line for line in lines[8:] if len(line) > 60] == [f'note: {path}:'] or any(
        path in line for line in lines)
    assert max(len(line) for line in lines[8:] if path not in line) <= 60


class _Stream(io.StringIO):
    def __init__(self, tty):
        super().__init__()
        self._tty = tty

    def isatty(self):
        return self._tty


def test_colour_on_a_terminal_only_and_not_with_no_color(monkeypatch):
    for name in ('NO_COLOR', 'COLUMNS'):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv('TERM', 'xterm')
    assert Terminal.of(_Stream(tty=True)).colour
    plain = Terminal.of(_Stream(tty=False))
    assert (plain.colour, plain.width > 10000) == (False, True)
    monkeypatch.setenv('COLUMNS', '70')
    assert Terminal.of(_Stream(tty=True)).width == 70
    assert Terminal.of(_Stream(tty=False)).width == 70
    monkeypatch.setenv('NO_COLOR', '1')
    assert not Terminal.of(_Stream(tty=True)).colour
    assert '\033' not in format_result(make(), terminal=Terminal.of(_Stream(tty=True)))
    assert '\033[32mok' in format_result(make(), terminal=Terminal(80, colour=True))


def test_a_prior_has_its_own_mark():
    text = format_result(make(status={'z': 'prior'}))
    assert 'prior: given beforehand' in text
    assert replace(make(), findings=()).findings == ()
