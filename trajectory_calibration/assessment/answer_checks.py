# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checks of an answer: faults of the input that a good fit does not show.

**One orientation.** The rotations of two sensors never agree to the last digit. If they do and the
positions differ, one trajectory is a smoothed copy of the other, or both use the orientation of
one sensor. The position difference then depends on the motion, and the standard deviations do not
hold.

**Two worlds.** An INS may write its attitude in north-east-down and its position in
east-north-up, or its yaw may refer to magnetic north. The rotations then agree with those of the
other sensor, and on flat ground the translations do too, with an extrinsic that is wrong by the
angle between the two worlds. But rotation equations and translation equations have different
solutions for the rotation of b in a. On ground that is not flat both are observed.
"""

from __future__ import annotations

import numpy as np

from trajectory_calibration.assessment.motion_equations import (
    ENOUGH,
    motions_over,
    MotionVectors,
    student_weights,
)
from trajectory_calibration.assessment.orientation_checks import LEAST_STEPS
from trajectory_calibration.assessment.steadiness import unsteady
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.data.trajectory import ROUNDING_TOLERANCE
from trajectory_calibration.errors import rounded
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# Parts of the drive with independent errors.
_PARTS = 12
# The angle between both solutions must exceed this angle and this many standard deviations. Both
# sensors must share this part of the rotations that determine it: on flat ground, pitch and roll
# are noise. On 20 real pairs the angle is up to 3 deg and, beyond 1 deg, 4 standard deviations.
_APART, _SIGMA, _SHARED = np.deg2rad(5.0), 8.0, 0.5


def check_answer(
    T_a_b: FloatArray, covariance: FloatArray, pairs: PosePairs, frames: tuple[str, str],
    config: CalibrationConfig,
) -> tuple[Finding, ...]:
    """Return findings about faults of the input that a good fit does not show.

    ``pairs`` have the scale of b corrected.
    """
    if not config.input_checks:
        return ()
    return (*one_orientation(T_a_b, pairs, frames), *two_worlds(T_a_b, pairs, frames),
            *unsteady(T_a_b, covariance, pairs, frames))


def one_orientation(
    T_a_b: FloatArray, pairs: PosePairs, frames: tuple[str, str],
) -> tuple[Finding, ...]:
    """Return a finding if both sensors have one orientation but different positions.

    ``pairs`` have the scale of b corrected. Jumps and a steady drift alone give no finding:
    simulated trajectories may have no other errors.
    """
    motions = select_motions(pairs, 'B1', ENOUGH)
    if len(motions) < LEAST_STEPS:
        return ()
    vectors = MotionVectors.by(motions.A, motions.B)
    rotation_residuals, residuals = vectors.residuals(T_a_b)
    residual_angle, angle = (float(np.median(np.linalg.norm(phi, axis=1)))
                             for phi in (rotation_residuals, vectors.phi_a))
    # The first is rounding of a file (radians); the rotations must exceed it by far.
    if residual_angle > 1e-7 or angle < ROUNDING_TOLERANCE:
        return ()
    length = np.linalg.norm(vectors.t_b, axis=1)[:, None]
    drift = np.median(residuals / np.maximum(length, np.finfo(float).tiny), axis=0)
    without_drift, distance = (float(np.median(np.linalg.norm(values, axis=1)))
                               for values in (residuals - drift * length, residuals))
    # A steady drift explains the differences if less than this share of them remains.
    if without_drift < max(ROUNDING_TOLERANCE, 0.3 * distance):
        return ()
    return (Finding(
        'orientations-identical',
        f'{frames[0]} and {frames[1]} rotate identically, to the last digit, but move '
        'differently: one was computed from the other, or both from one IMU? The standard '
        'deviations do not hold. Give trajectories that were measured apart',
        {'parted_rad': residual_angle}),)


def two_worlds(
    T_a_b: FloatArray, pairs: PosePairs, frames: tuple[str, str],
) -> tuple[Finding, ...]:
    """Return a finding if rotations and translations give different orientations of b in a.

    ``pairs`` have the scale of b corrected.
    """
    # Over shorter lags, filters of a SLAM look like a rotation.
    motions = motions_over(pairs, 8.0, fewest=40)
    if motions is None:
        return ()
    vectors = MotionVectors.by(motions.A, motions.B)
    R_rotation, P_rotation = _rotation(T_a_b, vectors, by_translation=False)
    R_translation, P_translation = _rotation(T_a_b, vectors, by_translation=True)
    phi = se3.log_so3((R_rotation @ R_translation.T)[None])[0]
    angle = float(np.linalg.norm(phi))
    if angle < _APART:
        return ()
    axis = phi / angle
    std = float(np.sqrt(axis @ (P_rotation + P_translation) @ axis))
    if angle < _SIGMA * std or _shared_rotation(axis, R_rotation, vectors) < _SHARED:
        return ()
    return (Finding(
        'worlds-differ',
        f'the rotations and the translations give orientations of {frames[1]} in {frames[0]} '
        f'that differ by {rounded(np.rad2deg(angle))} deg. Are positions and orientations of one '
        'sensor in two worlds (NED and ENU, exchanged axes, another north)? Write both in one',
        {'apart_deg': float(np.rad2deg(angle)), 'std_deg': float(np.rad2deg(std))}),)


def _rotation(
    T_a_b: FloatArray, vectors: MotionVectors, *, by_translation: bool,
) -> tuple[FloatArray, FloatArray]:
    """Return the (3, 3) rotation from one kind of equations, and its (3, 3) covariance.

    From the translation equations or, if not ``by_translation``, from the rotation equations. The
    covariance is the sandwich over parts of the drive.
    """
    T_a_b, scale = T_a_b.copy(), 1.0
    count = len(vectors.phi_a)
    parts = np.arange(count) * _PARTS // count
    covariance = np.zeros((3, 3))
    for _ in range(10):
        residuals = vectors.residuals(T_a_b, scale)[by_translation]
        J = vectors.jacobians(T_a_b, scale)[by_translation][:, :, :7 if by_translation else 3]
        weighted = student_weights(residuals)[:, None, None] * J
        H = np.einsum('kij,kil->jl', weighted, J)
        unit = np.sqrt(np.maximum(np.diag(H), np.finfo(float).tiny))
        P = np.linalg.pinv(H / np.outer(unit, unit), rcond=1e-8, hermitian=True) / np.outer(
            unit, unit)
        g = np.zeros((_PARTS, len(P)))
        np.add.at(g, parts, np.einsum('kij,ki->kj', weighted, residuals))
        inflation = max(1.0, float(np.trace(P @ (g.T @ g))) / len(P))
        covariance = P[:3, :3] * inflation
        step = P @ g.sum(axis=0)
        step[:3] *= min(1.0, 0.5 / max(float(np.linalg.norm(step[:3])), 1e-9))
        T_a_b[:3, :3] = se3.exp_so3(step[:3]) @ T_a_b[:3, :3]
        if by_translation:
            T_a_b[:3, 3] += step[3:6]
            scale *= float(np.exp(np.clip(step[6], -1.0, 1.0)))
    return T_a_b[:3, :3], covariance


def _shared_rotation(axis: FloatArray, R: FloatArray, vectors: MotionVectors) -> float:
    """Return the share of the rotations across ``axis`` that both sensors measured."""
    across_a, across_b = (
        phi - np.outer(phi @ axis, axis) for phi in (vectors.phi_a, vectors.phi_b @ R.T))
    both = float(np.sum(across_a * across_b))
    return 2 * both / max(float(np.sum(across_a**2) + np.sum(across_b**2)), np.finfo(float).tiny)
