# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The algebra of rigid motions: laws over the whole group, its corners included."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from trajectory_calibration.geometry import se3

components = st.floats(-1.0, 1.0).map(lambda x: 0.0 if abs(x) < 1e-200 else x)


@st.composite
def tangents(draw, max_angle=np.pi - 1e-6):
    """Draw (6,) tangents; angles reach from zero over tiny ones to just below half a turn."""
    translation = np.array(draw(st.tuples(*[st.floats(-100, 100)] * 3)))
    axis = np.array(draw(st.tuples(*[components] * 3)))
    norm = np.linalg.norm(axis)
    scale = draw(st.sampled_from([0.0, 1e-12, 1e-8, 1e-5, 9e-3, 1.1e-2, 0.5, 2.0, max_angle]))
    axis = axis / norm * scale if norm > 1e-150 else np.zeros(3)
    return np.concatenate([translation, axis])


@given(tangents())
def test_log_inverts_exp(xi):
    scale = 1 + np.abs(xi).max()
    np.testing.assert_allclose(se3.log_se3(se3.exp_se3(xi)), xi, atol=1e-8 * scale)


@given(tangents(), tangents())
def test_group_laws(x, y):
    X, Y = se3.exp_se3(x), se3.exp_se3(y)
    np.testing.assert_allclose(X @ se3.inverse(X), np.eye(4), atol=1e-12 * 400)
    np.testing.assert_allclose(
        se3.inverse(X @ Y), se3.inverse(Y) @ se3.inverse(X), atol=1e-12 * 400)


@given(tangents(max_angle=2.5), tangents())
def test_adjoint_moves_a_tangent_to_the_other_side(xi, x):
    xi = xi * 0.01
    X = se3.exp_se3(x)
    np.testing.assert_allclose(
        X @ se3.exp_se3(xi), se3.exp_se3(se3.adjoint(X) @ xi) @ X, atol=1e-9)


@given(tangents())
def test_quaternions_round_trip(xi):
    R = se3.exp_so3(xi[3:])
    q = se3.rotation_to_quaternion(R)
    assert q[3] >= 0
    np.testing.assert_allclose(np.linalg.norm(q), 1, atol=1e-14)
    np.testing.assert_allclose(se3.quaternion_to_rotation(q), R, atol=1e-14)


@pytest.mark.parametrize('axis', [*np.eye(3), [0.6, -0.8, 0.0], [-0.36, 0.48, 0.8]])
def test_half_a_turn_keeps_its_digits(axis):
    """At pi the trace says nothing; the largest pivot still does."""
    phi = np.pi * np.array(axis)
    found = se3.log_so3(se3.exp_so3(phi))
    np.testing.assert_allclose(np.abs(found @ axis), np.pi, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found), np.pi, atol=1e-12)


def test_left_jacobian_is_the_derivative_of_exp():
    rng = np.random.default_rng(0)
    for angle in (0.0, 1e-9, 5e-3, 2e-2, 1.0, 3.0):
        axis = rng.normal(size=3)
        phi = axis / np.linalg.norm(axis) * angle
        J = se3.left_jacobian_so3(phi)
        h = 1e-6
        numeric = np.column_stack([
            se3.log_so3(se3.exp_so3(phi + h * e) @ se3.exp_so3(phi - h * e).T) / (2 * h)
            for e in np.eye(3)])
        np.testing.assert_allclose(J, numeric, atol=1e-9)
        np.testing.assert_allclose(J @ se3.left_jacobian_so3_inverse(phi), np.eye(3), atol=1e-12)


def test_a_step_is_along_and_about_the_axes_of_the_parent():
    rng = np.random.default_rng(4)
    start, step = se3.exp_se3(rng.normal(size=(7, 6))), rng.normal(size=(7, 6))
    end = se3.moved(start, step)
    np.testing.assert_allclose(end[:, :3, 3] - start[:, :3, 3], step[:, :3], atol=1e-14)
    np.testing.assert_allclose(
        end[:, :3, :3], se3.exp_so3(step[:, 3:]) @ start[:, :3, :3], atol=1e-14)
    np.testing.assert_allclose(se3.step_between(start, end), step, atol=1e-13)
    np.testing.assert_allclose(se3.moved(start[0], step[0]), end[0], atol=1e-14)


def test_interpolation_is_the_constant_twist():
    rng = np.random.default_rng(1)
    start = se3.exp_se3(rng.normal(size=6))
    twist = rng.normal(size=6)
    for s in (0.0, 0.25, 1.0, 1.5):
        np.testing.assert_allclose(
            se3.geodesic(start, start @ se3.exp_se3(twist), np.array(s)),
            start @ se3.exp_se3(s * twist), atol=1e-12)


def test_nearest_rotation_is_a_rotation_and_the_nearest():
    rng = np.random.default_rng(2)
    R = se3.exp_so3(rng.normal(size=(50, 3)))
    np.testing.assert_allclose(se3.nearest_rotation(1.001 * R), R, atol=1e-12)
    mirrored = se3.nearest_rotation(R @ np.diag([1, 1, -1]))
    np.testing.assert_allclose(np.linalg.det(mirrored), 1, atol=1e-12)


def test_arrays_and_single_elements_agree():
    xi = np.random.default_rng(3).normal(size=(4, 5, 6))
    T = se3.exp_se3(xi)
    assert T.shape == (4, 5, 4, 4)
    # Sums of arrays and of single elements may differ in the last digit.
    np.testing.assert_allclose(T[2, 3], se3.exp_se3(xi[2, 3]), rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(
        se3.log_se3(T)[1, 4], se3.log_se3(T[1, 4]), rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(se3.skew(xi[..., :3]) @ xi[..., :3, None],
                               np.zeros((4, 5, 3, 1)), atol=1e-12)
