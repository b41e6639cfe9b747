# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Zhuang: Gauss-Newton in z = tan(w/2) k and the translation, through the identification Jacobian.

H. Zhuang, Z. Qu, "A New Identification Jacobian for Robotic Hand/Eye Calibration", IEEE
Transactions on Systems, Man, and Cybernetics 24(8), 1994, doi:10.1109/21.299711, equations 14
and 16; as replicated in doi:10.3390/s23073740, section III-C. With the axes k of the rotations
of a motion, ``u = (R_A - I) t + t_A`` and [x] the skew matrix of x, each motion gives

    f = [k_A + k_B] z - k_B + k_A        (rotation, eq. 14a)
    g = [u + t_B] z - t_B + u            (translation, eq. 14b)

and the sum of squares of f and g is minimised. Both are linear in the 16 products of (z, 1) and
(t, 1), so that the cost is a quadratic form in these and an iteration costs the same for any
number of motions.

The cost grows with tan(w/2) of the rotation between the sensors and has no finite value at half
a turn. Published results start at the identity; this solver starts at Kabsch's rotation, which
converges wherever a minimum exists. Near half a turn it first turns sensor b by that rotation, so
that z is small; the minimum then belongs to those coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers import linear, quadratic
from trajectory_calibration.solvers.registry import DEFAULT_SOLVER
from trajectory_calibration.solvers.separable import align_rotation_vectors, exclude_half_turns
from trajectory_calibration.solvers.solution import Equations, Solution


def solve(motions: MotionPairs, config: CalibrationConfig) -> Solution:
    """Return the extrinsic at the minimum next to Kabsch's rotation; raises as ``park``."""
    quadratic.require_motion(motions.pairs)
    motions, inliers, findings = exclude_half_turns(motions)
    R_start = align_rotation_vectors(motions, config.prior)
    angle = float(se3.rotation_angle(R_start))
    turned = angle > np.deg2rad(179.9)
    R_turn = R_start if turned else np.eye(3)
    start = np.concatenate([_to_z(R_start @ R_turn.T), config.prior.translation])
    found = _minimise(_gram(motions, R_turn), start, len(motions))
    T_a_b = se3.from_rotation_translation(_from_z(found.x[:3]) @ R_turn, found.x[3:])
    # From there on z is longer than one.
    if angle > np.pi / 2:
        findings = (*findings, Finding(
            'zhuang-large-rotation',
            f'the sensors are rotated by {np.rad2deg(angle):.0f} degrees against each '
            'other, where the parameter of this solver grows and magnifies noise' + (
                ' without bound; solved in rotated coordinates' if turned else '')
            + f'; prefer {DEFAULT_SOLVER}', {'angle_deg': float(np.rad2deg(angle))}))
    if not found.settled:
        findings = (*findings, Finding(
            'not-converged', f'the solver stopped after {found.iterations} iterations before it '
            f'settled. Prefer {DEFAULT_SOLVER}'))
    return Solution(T_a_b, found.cost, found.iterations, inliers=inliers,
                    linearise=partial(linearise, R_turn), findings=findings)


def linearise(R_turn: FloatArray, T_a_b: FloatArray, A: FloatArray, C: FloatArray) -> Equations:
    """Return the equations, as ``solution.Linearise``, with b turned by R_turn.

    With ``R = (I - [z])^-1 (I + [z])`` both residuals are ``(I - [z])`` times a plain difference:
    f of the axes, g of the translation.
    """
    equations = linear.translation_only(T_a_b, A, C)
    (k_a, turns_a), (k_c, turns_c) = (_axes(moved) for moved in (A, C))
    turns = (turns_a & turns_c)[:, None]
    equations.residual[:, linear.ROTATION] = turns * (k_a - k_c)
    equations.jacobian[:, linear.ROTATION, 3:] = se3.skew(turns * k_c)
    z = _to_z(T_a_b[:3, :3] @ R_turn.T)
    W = np.eye(3) - se3.skew(z)
    # Rotation and translation, both (3,), alike.
    plain = equations.residual.reshape(-1, 2, 3)
    jacobian = W @ equations.jacobian.reshape(-1, 2, 3, 6)
    jacobian[..., 3:] += 0.5 * se3.skew(plain) @ (W + np.outer(z, z))
    jacobian = jacobian.reshape(-1, 6, 6)
    return Equations((plain @ W.T).reshape(-1, 6), jacobian, jacobian)


def _axes(motions: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the (M, 3) axes of (M, 4, 4) motions, and which of them turn enough to have one.

    Of the others only the translation is used.
    """
    phi = se3.log_so3(motions[:, :3, :3])
    angle = np.linalg.norm(phi, axis=1)
    return phi / np.maximum(angle, quadratic.NO_MOTION)[:, None], angle > quadratic.NO_MOTION


def _gram(motions: MotionPairs, R_turn: FloatArray) -> FloatArray:
    """Return the (16, 16) Gram matrix in (z_i t_j row by row, z, t, 1), b turned by R_turn."""
    (k_a, turns_a), (k_b, turns_b) = _axes(motions.A), _axes(motions.B)
    turns = turns_a & turns_b
    k_a, k_b = k_a[turns], k_b[turns] @ R_turn.T
    t_a, t_b = motions.A[:, :3, 3], motions.B[:, :3, 3] @ R_turn.T
    f = np.zeros((len(k_a), 3, 16))
    f[:, :, 9:12] = se3.skew(k_a + k_b)
    f[:, :, 15] = k_a - k_b
    D = motions.A[:, :3, :3] - np.eye(3)
    g = np.zeros((len(t_a), 3, 16))
    for j in range(3):
        # [D e_j t_j] z: column i of the skew matrix multiplies z_i t_j.
        g[:, :, [j, 3 + j, 6 + j]] = se3.skew(D[:, :, j])
    g[:, :, 9:12] = se3.skew(t_a + t_b)
    g[:, :, 12:15] = D
    g[:, :, 15] = t_a - t_b
    rows = np.concatenate([f, g]).reshape(-1, 16)
    S: FloatArray = rows.T @ rows
    return S


@dataclass(frozen=True, eq=False)
class _Minimum:
    x: FloatArray
    cost: float
    iterations: int
    settled: bool


def _minimise(S: FloatArray, start: FloatArray, motions: int) -> _Minimum:
    """Minimise over (z, t), and once more with an implausible translation held at the start."""
    hold = np.zeros((6, 6))
    found = _gauss_newton(S, start, hold, motions)
    _, _, H = _equations(S, found.x)
    hold[3:, 3:] = quadratic.hold_implausible(H[3:, 3:], found.cost / (6 * motions))
    return _gauss_newton(S, start, hold, motions) if hold.any() else found


def _gauss_newton(S: FloatArray, start: FloatArray, hold: FloatArray, motions: int) -> _Minimum:
    """Minimise with ``(x - start)^T hold (x - start)`` added to the cost."""
    # Changes of the cost that are rounding, by the cost of no extrinsic at all.
    x, iteration, rounding = start, 0, 1e-13 * float(S[15, 15])
    plain, gradient, H = _equations(S, x)
    # An unobservable direction stays where it is, whatever rounding makes of it.
    Q = quadratic.observed_directions(H, motions)
    for iteration in range(1, 501):
        off = x - start
        cost = plain + off @ hold @ off
        step = -Q @ np.linalg.solve(Q.T @ (H + hold) @ Q, Q.T @ (gradient + hold @ off))
        length = np.linalg.norm(step) / (1 + np.linalg.norm(x[:3]) + np.linalg.norm(x[3:]))
        for _ in range(40):
            plain, gradient, H = _equations(S, x + step)
            off = x + step - start
            if plain + off @ hold @ off <= cost + rounding:
                break
            step = 0.5 * step
        else:
            # No step goes down: the rest is rounding.
            return _Minimum(x, max(float(cost), 0.0), iteration, settled=True)
        x = x + step
        if length <= 1e-12:
            return _Minimum(x, max(plain, 0.0), iteration, settled=True)
    return _Minimum(x, max(plain, 0.0), iteration, settled=False)


def _equations(S: FloatArray, x: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Return the cost, half its gradient in x = (z, t), and its Gauss-Newton matrix."""
    z, t = x[:3], x[3:]
    m = np.concatenate([np.outer(z, t).ravel(), x, [1.0]])
    J = np.zeros((16, 6))
    J[:9, :3] = np.kron(np.eye(3), t[:, None])
    J[:9, 3:] = np.kron(z[:, None], np.eye(3))
    J[9:15] = np.eye(6)
    Sm = S @ m
    return float(m @ Sm), J.T @ Sm, J.T @ S @ J


def _to_z(R: FloatArray) -> FloatArray:
    """Return z = tan(w/2) k of a rotation: the vector part of its quaternion over the scalar."""
    q = se3.rotation_to_quaternion(R)
    z: FloatArray = q[:3] / q[3]
    return z


def _from_z(z: FloatArray) -> FloatArray:
    q = np.append(z, 1.0)
    return se3.quaternion_to_rotation(q / np.linalg.norm(q))
