# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether an answer can be meant although the two trajectories move as one body.

**One orientation.** Two sensors never turn alike to the last digit. Where they do and their
positions differ, one is a smoothed or filtered copy of the other, or both took their orientation
from one sensor. What their positions differ by then follows the motion, as no noise does, and no
standard deviation holds.

**Two worlds.** An INS that writes its attitude against north-east-down and its position as
east-north-up, a yaw that counts from another direction than the map does, a magnetic declination:
the turns of such poses agree with those of the other sensor, and on flat ground the ways do too,
with a pose of b that is off by the angle between the two worlds. But turns and ways then tell
different rotations of b in a, and where the ground is not flat both are known.
"""

from __future__ import annotations

import numpy as np

from trajectory_calibration.assessment.motion_equations import motions_over, Moved, weights_of
from trajectory_calibration.assessment.steadiness import unsteady
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.errors import rounded
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# One orientation: motions, radians of a step that are digits of a file, metres that are none.
_STEPS, _FEWEST_STEPS, _DIGITS, _APART_M = 2000, 20, 1e-7, 1e-5
# A steady drift leaves less than this share of what they differ by.
_NO_DRIFT = 0.3
# Steps turn by so many times more, or they say nothing.
_TURNED = 100.0

# Two worlds: seconds of a motion. Over shorter ones, filters of a SLAM look like a rotation.
_LAG_S, _MOTIONS, _FEWEST = 8.0, 800, 40
_PARTS, _ROUNDS = 12, 10
# Radians of a step, and the share of the information below which a direction is not solved for.
_STEP, _UNSEEN = 0.5, 1e-8
# Angles between the two rotations that are none, standard deviations, and the share of what the
# sensors turned that both saw: on flat ground, pitch and roll are noise. Over 20 real pairs the
# two differ by up to 3 deg and, where that is more than 1 deg, 4 standard deviations.
_APART, _SIGMA, _SHARED = np.deg2rad(5.0), 8.0, 0.5


def check_answer(
    T_a_b: FloatArray, covariance: FloatArray, pairs: PosePairs, frames: tuple[str, str],
    config: CalibrationConfig,
) -> tuple[Finding, ...]:
    """Return what is wrong with an answer although the two move as one body.

    ``pairs`` have the scale of b corrected.
    """
    if not config.input_checks:
        return ()
    return (*one_orientation(T_a_b, pairs, frames), *two_worlds(T_a_b, pairs, frames),
            *unsteady(T_a_b, covariance, pairs, frames))


def one_orientation(
    T_a_b: FloatArray, pairs: PosePairs, frames: tuple[str, str],
) -> tuple[Finding, ...]:
    """Return a finding where both sensors have the orientation of one, and other positions.

    ``pairs`` have the scale of b corrected. Jumps and a steady drift are no reason: simulated
    trajectories have nothing else.
    """
    motions = select_motions(pairs, 'B1', _STEPS)
    if len(motions) < _FEWEST_STEPS:
        return ()
    moved = Moved.by(motions.A, motions.B)
    turn_left, rest = moved.left(T_a_b)
    parted, turned = (
        float(np.median(np.linalg.norm(turn, axis=1))) for turn in (turn_left, moved.turn_a))
    if parted > _DIGITS or turned < _TURNED * _DIGITS:
        return ()
    length = np.linalg.norm(moved.way_b, axis=1)[:, None]
    drift = np.median(rest / np.maximum(length, np.finfo(float).tiny), axis=0)
    apart = float(np.median(np.linalg.norm(rest - drift * length, axis=1)))
    if apart < max(_APART_M, _NO_DRIFT * float(np.median(np.linalg.norm(rest, axis=1)))):
        return ()
    return (Finding(
        'orientations-identical',
        f'{frames[0]} and {frames[1]} rotate identically, to the last digit, but move '
        'differently: one was computed from the other, or both from one IMU? The standard '
        'deviations do not hold. Give trajectories that were measured apart',
        {'parted_rad': parted}),)


def two_worlds(
    T_a_b: FloatArray, pairs: PosePairs, frames: tuple[str, str],
) -> tuple[Finding, ...]:
    """Return a finding where turns and ways tell different rotations of b in a.

    ``pairs`` have the scale of b corrected.
    """
    motions = motions_over(pairs, _LAG_S, fewest=_FEWEST, at_most=_MOTIONS)
    if motions is None:
        return ()
    moved = Moved.by(motions.A, motions.B)
    of_turns, turn_variance = _rotation(T_a_b, moved, by_way=False)
    of_ways, way_variance = _rotation(T_a_b, moved, by_way=True)
    apart = se3.log_so3((of_turns @ of_ways.T)[None])[0]
    angle = float(np.linalg.norm(apart))
    if angle < _APART:
        return ()
    axis = apart / angle
    std = float(np.sqrt(axis @ (turn_variance + way_variance) @ axis))
    if angle < _SIGMA * std or _shared_turning(axis, of_turns, moved) < _SHARED:
        return ()
    return (Finding(
        'worlds-differ',
        f'the rotations and the translations give orientations of {frames[1]} in {frames[0]} '
        f'that differ by {rounded(np.rad2deg(angle))} deg. Are positions and orientations of one '
        'sensor in two worlds (NED and ENU, exchanged axes, another north)? Write both in one',
        {'apart_deg': float(np.rad2deg(angle)), 'std_deg': float(np.rad2deg(std))}),)


def _rotation(
    T_a_b: FloatArray, moved: Moved, *, by_way: bool,
) -> tuple[FloatArray, FloatArray]:
    """Return (3, 3) the rotation that turns alone, or ways alone, tell, and its covariance.

    The covariance is the sandwich over parts of the drive.
    """
    T_a_b, scale = T_a_b.copy(), 1.0
    count = len(moved.turn_a)
    parts = np.arange(count) * _PARTS // count
    covariance = np.zeros((3, 3))
    for _ in range(_ROUNDS):
        left = moved.left(T_a_b, scale)[by_way]
        J = moved.slopes(T_a_b, scale)[by_way][:, :, :7 if by_way else 3]
        weighted = weights_of(left)[:, None, None] * J
        H = np.einsum('kij,kil->jl', weighted, J)
        unit = np.sqrt(np.maximum(np.diag(H), np.finfo(float).tiny))
        P = np.linalg.pinv(H / np.outer(unit, unit), rcond=_UNSEEN, hermitian=True) / np.outer(
            unit, unit)
        g = np.zeros((_PARTS, len(P)))
        np.add.at(g, parts, np.einsum('kij,ki->kj', weighted, left))
        inflation = max(1.0, float(np.trace(P @ (g.T @ g))) / len(P))
        covariance = P[:3, :3] * inflation
        step = P @ g.sum(axis=0)
        step[:3] *= min(1.0, _STEP / max(float(np.linalg.norm(step[:3])), 1e-9))
        T_a_b[:3, :3] = se3.exp_so3(step[:3]) @ T_a_b[:3, :3]
        if by_way:
            T_a_b[:3, 3] += step[3:6]
            scale *= float(np.exp(np.clip(step[6], -1.0, 1.0)))
    return T_a_b[:3, :3], covariance


def _shared_turning(axis: FloatArray, R: FloatArray, moved: Moved) -> float:
    """Return which share both sensors saw of the turns that tell the rotation about an axis."""
    across_a, across_b = (
        turns - np.outer(turns @ axis, axis) for turns in (moved.turn_a, moved.turn_b @ R.T))
    both = float(np.sum(across_a * across_b))
    return 2 * both / max(float(np.sum(across_a**2) + np.sum(across_b**2)), np.finfo(float).tiny)
