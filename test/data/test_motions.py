# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The reference selections A, B<n>, C<n>, and the four error measures."""

from hypothesis import given
from hypothesis import strategies as st
from motion_data import random_pose, sensor_pair
import numpy as np
import pytest

from trajectory_calibration import CalibrationConfig, CalibrationError, ConfigError, MotionError
from trajectory_calibration.assessment.metrics import absolute_errors, relative_errors
from trajectory_calibration.data.motion_pairs import (
    parse_reference,
    reference_indices,
    select_motions,
)
from trajectory_calibration.geometry import se3
from trajectory_calibration.time_alignment.pairing import associate


def test_a_compares_with_the_first_pose():
    i, j = reference_indices('A', 5)
    assert i.tolist() == [0, 0, 0, 0]
    assert j.tolist() == [1, 2, 3, 4]


def test_b_compares_with_the_pose_n_earlier():
    i, j = reference_indices('B3', 6)
    assert i.tolist() == [0, 1, 2]
    assert j.tolist() == [3, 4, 5]


def test_c_compares_with_the_first_pose_of_the_segment():
    i, j = reference_indices('C3', 8)
    assert i.tolist() == [0, 0, 3, 3]
    assert j.tolist() == [1, 2, 4, 5]


@pytest.mark.parametrize('poses, n, motions', [(100, 5, 19 * 4), (101, 5, 20 * 4), (11, 10, 9)])
def test_c_drops_the_last_segment_even_where_it_is_complete(poses, n, motions):
    assert len(reference_indices(f'C{n}', poses)[0]) == motions


@given(st.sampled_from('ABC'), st.integers(1, 60), st.integers(2, 60))
def test_every_reference_gives_motions_forward_in_time_or_a_sentence(letter, n, poses):
    n = max(n, 2) if letter == 'C' else n
    reference = letter if letter == 'A' else f'{letter}{n}'
    try:
        i, j = reference_indices(reference, poses)
    except MotionError as error:
        assert 'needed at least 2' in str(error)
        return
    assert len(i) >= 2
    assert (i >= 0).all()
    assert (i < j).all()
    assert (j < poses).all()
    assert ((j - i) <= (poses if letter == 'A' else n)).all()


@pytest.mark.parametrize('reference', ['', 'B', 'B0', 'C-1', 'D5', 'A1', 'B5.0', 'B 5', '5'])
def test_an_unknown_reference_lists_the_known(reference):
    with pytest.raises(ConfigError, match=r'needed A \(the first pose\), B<n>'):
        parse_reference(reference)


def test_segments_of_one_pose_are_no_setting():
    with pytest.raises(ConfigError, match='C1 compares every pose with itself; use C2'):
        CalibrationConfig(reference='c1')


def test_case_does_not_matter():
    assert parse_reference('b5') == ('B', 5)


@pytest.mark.parametrize('reference, advice', [
    ('B100', 'use a smaller n or record longer'), ('C100', 'use a smaller n'),
    ('B99999999999999999999', 'reference B9+ leaves 0 motions of 100 poses'),
    ('C99999999999999999999', 'reference C9+ leaves 0 motions of 100 poses')])
def test_n_too_large_says_what_to_do(reference, advice):
    with pytest.raises(MotionError, match=advice):
        reference_indices(reference, 100)


def test_motions_do_not_depend_on_the_worlds_and_measure_zero_at_the_truth():
    rng = np.random.default_rng(0)
    X = random_pose(rng)
    a, b = sensor_pair(rng, X)
    motions = select_motions(associate(a, b), 'B7')
    assert motions.reference == 'B7'
    np.testing.assert_allclose(motions.A @ X, X @ motions.B, atol=1e-12)
    errors = relative_errors(X, motions)
    assert errors.e_rt < 1e-12
    assert errors.e_rR < 1e-12


def test_errors_are_those_of_a_known_displacement():
    """Off by 3 cm and 2 degrees: the absolute errors say just that."""
    rng = np.random.default_rng(1)
    X = random_pose(rng)
    off = X.copy()
    off[:3, 3] += [0.03, 0, 0]
    off[:3, :3] = off[:3, :3] @ se3.exp_so3([0, np.deg2rad(2), 0])
    errors = absolute_errors(off, X)
    assert errors.e_at == pytest.approx(0.03)
    assert np.rad2deg(errors.e_aR) == pytest.approx(2)


def test_relative_translation_error_is_the_mean_distance():
    """With b turned by R_B = I and A a pure step, e_rt is the length of the difference."""
    rng = np.random.default_rng(2)
    a, b = sensor_pair(rng, np.eye(4), rotation=(0, 0, 0))
    motions = select_motions(associate(a, b), 'B1')
    turned = se3.from_rotation_translation(se3.exp_so3([0, 0, np.pi / 2]), np.zeros(3))
    steps = motions.A[:, :3, 3]
    expected = np.linalg.norm(steps - motions.B[:, :3, 3] @ turned[:3, :3].T, axis=1).mean()
    assert relative_errors(turned, motions).e_rt == pytest.approx(expected)


def test_named_errors_share_one_base():
    with pytest.raises(CalibrationError):
        reference_indices('B100', 100)
