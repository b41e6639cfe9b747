# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Files in other units than seconds and metres raise a question, and nothing else does."""

from dataclasses import replace

import numpy as np
import pytest

from trajectory_calibration import (
    AssociationError,
    calibrate,
    CalibrationConfig,
    MotionError,
    SolverError,
)
from trajectory_calibration.data.plausibility import doubts_of_both, position_doubts, time_doubts
from trajectory_calibration.outputs.inspection import inspect_trajectory
from trajectory_calibration.simulation import SCENARIOS, simulate

RUN = simulate(replace(SCENARIOS['offroad'], duration=60.0), 1)


def slower(trajectory, factor):
    """Return the first poses as they are read where their times are too large by a factor."""
    stamps_ns = trajectory.stamps_ns[:60] - trajectory.stamps_ns[0]
    return replace(trajectory, stamps_ns=stamps_ns * factor, poses=trajectory.poses[:60])


@pytest.mark.parametrize(('factor', 'words'), [
    (10**3, 'in milliseconds? Then divide them by 1000'),
    (10**6, 'in microseconds? Then divide them by 1e6'),
    (10**9, 'in nanoseconds? Then divide them by 1e9'),
])
def test_times_in_another_unit(factor, words):
    a, b = (slower(trajectory, factor) for trajectory in (RUN.a, RUN.b))
    assert words in time_doubts(a)[0].text
    assert words in inspect_trajectory(a, 'a', 'file')['findings'][0]['text']
    # Their stamps coincide, whatever the unit.
    assert words in calibrate(a, b).warnings[0]
    apart = replace(b, stamps_ns=b.stamps_ns + factor * 10**7)
    for pair in ((a, apart), (a, slower(RUN.b, 1)), (slower(RUN.a, 1), b)):
        with pytest.raises((AssociationError, SolverError)) as failed:
            calibrate(*pair)
        assert words in str(failed.value)


def test_steps_that_differ_as_units_do_where_no_time_is_common():
    a, b = slower(RUN.a, 1), slower(RUN.b, 1)
    late = replace(a, stamps_ns=10**18 + a.stamps_ns // 1000)
    question = r'are the times of .* in milliseconds\? .*by 1000;'
    with pytest.raises(AssociationError, match=question):
        calibrate(late, b)
    assert doubts_of_both(a, replace(b, stamps_ns=b.stamps_ns + 10**18)) == ()
    assert doubts_of_both(a, replace(b, stamps_ns=b.stamps_ns // 1000)) == ()


def test_millimetres():
    a = RUN.a.scaled(1000.0)
    assert 'are its positions in metres? Divide millimetres by 1000' in position_doubts(a)[0].text
    assert inspect_trajectory(a, 'a', 'file')['findings'] == [
        found.to_dict() for found in position_doubts(a)]
    found = calibrate(a, RUN.b)
    assert position_doubts(a)[0] in found.findings
    # The ground is hilly: it is not the turning that is too little.
    said = [warning for warning in found.warnings if 'unobserved' in warning]
    assert said
    assert all('noise too large for the motion' in warning for warning in said)


def test_the_unit_of_a_camera_without_scale_is_no_question():
    found = calibrate(RUN.a, RUN.b.scaled(1000.0))
    assert not any('median speed' in warning for warning in found.warnings)


@pytest.mark.parametrize('name', sorted(SCENARIOS))
def test_no_scenario_raises_a_question(name):
    run = simulate(SCENARIOS[name], 0)
    for trajectory in (run.a, run.b):
        assert time_doubts(trajectory) == position_doubts(trajectory) == ()


def test_what_was_found_before_an_error_is_in_it():
    short = replace(RUN.b, stamps_ns=RUN.b.stamps_ns + 55_000_000_000)
    config = CalibrationConfig(time_offset_mode='fixed')
    with pytest.raises((MotionError, SolverError), match=(
            r'. Also found: \d+% of the poses of \w+ lie outside the time of')):
        calibrate(RUN.a, short, config)
    with pytest.raises(MotionError) as failed:
        calibrate(RUN.a, replace(RUN.b, poses=RUN.b.poses[::-1]), config)
    assert 'Also found' not in str(failed.value)
    assert np.isfinite(calibrate(RUN.a, RUN.b).T_a_b).all()


@pytest.mark.parametrize(('unit', 'per_metre'), [
    ('feet', 1 / 0.3048), ('centimetres', 100.0), ('millimetres', 1000.0)])
def test_the_parent_in_a_unit_smaller_than_the_other(unit, per_metre):
    def asked(a, b):
        return [found.text for found in calibrate(a, b).findings
                if found.code == 'length-unit' and 'those of b' in found.text]
    question, = asked(RUN.a.scaled(per_metre), RUN.b)
    assert f'in {unit}? Then so is the translation' in question
    # The other way round the answer is in metres.
    assert not asked(RUN.a, RUN.b.scaled(per_metre))


def test_times_in_days():
    a = replace(RUN.a, stamps_ns=7 * 10**14 + (RUN.a.stamps_ns - RUN.a.stamps_ns[0]) // 86400)
    assert 'in days? Then multiply them by 86400' in time_doubts(a)[0].text
