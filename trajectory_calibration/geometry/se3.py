# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Rigid motions in three dimensions, over whole arrays.

Conventions, the same everywhere in the package:

* A pose is a (4, 4) homogeneous matrix ``T_a_b``: the pose of b in a, ``p_a = T_a_b @ p_b``.
* A tangent vector ``xi`` is (6,): translation x, y, z (metres), then rotation x, y, z (radians),
  the order of the covariance in ``geometry_msgs/PoseWithCovariance``.
* Quaternions are x, y, z, w.
* Every function takes any number of leading axes and maps over them.

Formulas: J. Sola, J. Deray, D. Atchuthan, "A micro Lie theory for state estimation in robotics",
arXiv:1812.01537; T. Barfoot, "State Estimation for Robotics", 2017, section 7.1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

# Beyond this angle (radians) rotation vectors are not used: near 180 deg noise may flip the axis.
LARGEST_ROTATION = 2.6

# Rounding of poses in files with nine digits, metres and radians; and its square, relative to the
# largest eigenvalue of a sum of squares.
PRECISION, ROUNDING = 1e-6, 1e-12


def skew(vectors: ArrayLike) -> FloatArray:
    """Return the (..., 3, 3) matrices whose product with w is the cross product of v and w."""
    v = np.asarray(vectors, dtype=np.float64)
    result = np.zeros((*v.shape, 3))
    result[..., 0, 1], result[..., 0, 2], result[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    result[..., 1, 0], result[..., 2, 0], result[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return result


def from_rotation_translation(rotation: ArrayLike, translation: ArrayLike) -> FloatArray:
    """Assemble (..., 4, 4) poses from (..., 3, 3) rotations and (..., 3) translations."""
    R = np.asarray(rotation, dtype=np.float64)
    t = np.asarray(translation, dtype=np.float64)
    result = np.zeros((*np.broadcast_shapes(R.shape[:-2], t.shape[:-1]), 4, 4))
    result[..., :3, :3] = R
    result[..., :3, 3] = t
    result[..., 3, 3] = 1.0
    return result


def inverse(poses: ArrayLike) -> FloatArray:
    """Return the inverses of (..., 4, 4) poses."""
    T = np.asarray(poses, dtype=np.float64)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    return from_rotation_translation(Rt, -np.einsum('...ij,...j->...i', Rt, T[..., :3, 3]))


def scaled(poses: FloatArray, factor: float) -> FloatArray:
    """Return (..., 4, 4) poses with their translations multiplied."""
    result = poses.copy()
    result[..., :3, 3] *= factor
    return result


def quaternion_to_rotation(quaternions_xyzw: ArrayLike) -> FloatArray:
    """Return the (..., 3, 3) rotations of (..., 4) unit quaternions x, y, z, w."""
    q = np.asarray(quaternions_xyzw, dtype=np.float64)
    x, y, z, w = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    R = np.empty((*q.shape[:-1], 3, 3))
    R[..., 0, 0] = 1 - 2 * (y * y + z * z)
    R[..., 0, 1] = 2 * (x * y - z * w)
    R[..., 0, 2] = 2 * (x * z + y * w)
    R[..., 1, 0] = 2 * (x * y + z * w)
    R[..., 1, 1] = 1 - 2 * (x * x + z * z)
    R[..., 1, 2] = 2 * (y * z - x * w)
    R[..., 2, 0] = 2 * (x * z - y * w)
    R[..., 2, 1] = 2 * (y * z + x * w)
    R[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return R


def rotation_to_quaternion(rotations: ArrayLike) -> FloatArray:
    """Return the (..., 4) unit quaternions x, y, z, w (w >= 0) of (..., 3, 3) rotations.

    Of the four formulas, the one with the largest pivot is used, so no angle loses digits.
    """
    R = np.asarray(rotations, dtype=np.float64)
    diagonal = np.diagonal(R, axis1=-2, axis2=-1)
    trace = diagonal.sum(-1)
    # The row of 4 q q^T with the pivot w.
    q = np.empty((*R.shape[:-2], 4))
    for i, (j, k) in enumerate(((2, 1), (0, 2), (1, 0))):
        q[..., i] = R[..., j, k] - R[..., k, j]
    q[..., 3] = 1 + trace
    # w is the largest pivot for angles below 90 degrees, the usual case.
    large = trace <= 1
    if np.any(large):
        q[large] = _row_with_largest_pivot(R[large], diagonal[large], trace[large], q[large])
    q /= np.sqrt(np.sum(q * q, axis=-1, keepdims=True))
    return np.where(q[..., 3:] < 0, -q, q)


def _row_with_largest_pivot(
    R: FloatArray, diagonal: FloatArray, trace: FloatArray, last: FloatArray,
) -> FloatArray:
    """Return (K, 4) rows of 4 q q^T, of which the ``last`` are known."""
    K = np.empty((len(R), 4, 4))
    K[..., 3, :] = K[..., :, 3] = last
    for i in range(3):
        K[..., i, i] = 1 - trace + 2 * diagonal[..., i]
    for i, j in ((0, 1), (0, 2), (1, 2)):
        K[..., i, j] = K[..., j, i] = R[..., i, j] + R[..., j, i]
    pivot = np.argmax(np.diagonal(K, axis1=-2, axis2=-1), axis=-1)
    return np.take_along_axis(K, pivot[..., None, None], axis=-2)[..., 0, :]


def roll_pitch_yaw(rotations: ArrayLike) -> FloatArray:
    """Return the (..., 3) angles about the fixed x, then y, then z axis, as URDF writes them.

    Radians; ``R = R_z(yaw) R_y(pitch) R_x(roll)``. Roll is computed from R after removal of yaw,
    so that the three reproduce R to the last digit even with pitch near 90 degrees.
    """
    R = np.asarray(rotations, dtype=np.float64)
    # At pitch 90 degrees roll and yaw have the same axis: roll gets the whole angle.
    level = np.hypot(R[..., 0, 0], R[..., 1, 0]) > 1e-13
    yaw = np.where(level, np.arctan2(R[..., 1, 0], R[..., 0, 0]), 0.0)
    c, s = np.cos(yaw), np.sin(yaw)
    pitch = np.arctan2(-R[..., 2, 0], c * R[..., 0, 0] + s * R[..., 1, 0])
    roll = np.arctan2(s * R[..., 0, 2] - c * R[..., 1, 2], c * R[..., 1, 1] - s * R[..., 0, 1])
    return np.stack([roll, pitch, yaw], axis=-1)


def rotation_from_roll_pitch_yaw(angles: ArrayLike) -> FloatArray:
    """Return the (..., 3, 3) rotations of (..., 3) roll, pitch, yaw (radians) as in URDF."""
    roll, pitch, yaw = np.moveaxis(np.asarray(angles, dtype=np.float64)[..., None] * np.eye(3),
                                   -2, 0)
    return exp_so3(yaw) @ exp_so3(pitch) @ exp_so3(roll)


def exp_so3(rotation_vectors: ArrayLike) -> FloatArray:
    """Return the (..., 3, 3) rotations of (..., 3) rotation vectors (radians)."""
    phi = np.asarray(rotation_vectors, dtype=np.float64)
    # Not exactly zero, so that sin(half) / half is one.
    half = np.maximum(0.5 * np.sqrt(np.sum(phi * phi, axis=-1, keepdims=True)), 1e-150)
    q = np.concatenate([0.5 * np.sin(half) / half * phi, np.cos(half)], axis=-1)
    return quaternion_to_rotation(q)


def log_so3(rotations: ArrayLike) -> FloatArray:
    """Return the (..., 3) rotation vectors, of length at most pi, of (..., 3, 3) rotations."""
    q = rotation_to_quaternion(rotations)
    sine = np.sqrt(np.sum(q[..., :3]**2, axis=-1, keepdims=True))
    # A copy: for strided operands NumPy chooses between its vectorised and its scalar arctan2,
    # which differ in the last bit, by the memory address, and answers would not be reproducible.
    cosine = np.ascontiguousarray(q[..., 3:])
    angle = 2.0 * np.arctan2(sine, cosine)
    # angle / sine tends to 2 as the rotation vanishes.
    factor = np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine > 0)
    return factor * q[..., :3]


def rotation_angle(rotations: ArrayLike) -> FloatArray:
    """Return the (...) angles in [0, pi] of (..., 3, 3) rotations."""
    return np.linalg.norm(log_so3(rotations), axis=-1)


def nearest_rotation(matrices: ArrayLike) -> FloatArray:
    """Return the (..., 3, 3) rotations closest to (..., 3, 3) matrices in the Frobenius norm.

    The orthogonal Procrustes solution with the determinant kept at +1: S. Umeyama, IEEE PAMI
    13(4), 1991, doi:10.1109/34.88573, lemma.
    """
    U, _, Vt = np.linalg.svd(np.asarray(matrices, dtype=np.float64))
    sign = np.sign(np.linalg.det(U @ Vt))
    U = U.copy()
    U[..., :, 2] *= sign[..., None]
    return U @ Vt


def left_jacobian_so3(rotation_vectors: ArrayLike) -> FloatArray:
    """Return (..., 3, 3) J with ``exp(phi + d) = exp(J d) exp(phi)`` to first order."""
    phi = np.asarray(rotation_vectors, dtype=np.float64)
    a2, small, s2 = _squared_angle(phi)
    a = np.sqrt(s2)
    first = np.where(small, 0.5 - a2 / 24 + a2**2 / 720, (1 - np.cos(a)) / s2)
    second = np.where(small, 1 / 6 - a2 / 120 + a2**2 / 5040, (a - np.sin(a)) / (a * s2))
    K = skew(phi)
    return np.eye(3) + first[..., None, None] * K + second[..., None, None] * (K @ K)


def left_jacobian_so3_inverse(rotation_vectors: ArrayLike) -> FloatArray:
    """Return the (..., 3, 3) inverses of ``left_jacobian_so3``, for angles below 2 pi."""
    phi = np.asarray(rotation_vectors, dtype=np.float64)
    a2, small, s2 = _squared_angle(phi)
    half = 0.5 * np.sqrt(s2)
    factor = np.where(
        small, 1 / 12 + a2 / 720 + a2**2 / 30240, (1 - half * np.cos(half) / np.sin(half)) / s2)
    K = skew(phi)
    return np.eye(3) - 0.5 * K + factor[..., None, None] * (K @ K)


def _squared_angle(phi: FloatArray) -> tuple[FloatArray, NDArray[np.bool_], FloatArray]:
    """Return (...) squared lengths, where they are small, and one in place of those."""
    a2 = np.einsum('...i,...i->...', phi, phi)
    # There the closed forms lose digits to cancellation; the Taylor series, cut after the terms
    # that are kept, is exact to machine precision.
    small = a2 < 1e-2**2
    return a2, small, np.where(small, 1.0, a2)


def exp_se3(tangents: ArrayLike) -> FloatArray:
    """Return the (..., 4, 4) poses of (..., 6) tangent vectors."""
    xi = np.asarray(tangents, dtype=np.float64)
    rho, phi = xi[..., :3], xi[..., 3:]
    t = np.einsum('...ij,...j->...i', left_jacobian_so3(phi), rho)
    return from_rotation_translation(exp_so3(phi), t)


def log_se3(poses: ArrayLike) -> FloatArray:
    """Return the (..., 6) tangent vectors of (..., 4, 4) poses."""
    T = np.asarray(poses, dtype=np.float64)
    phi = log_so3(T[..., :3, :3])
    rho = np.einsum('...ij,...j->...i', left_jacobian_so3_inverse(phi), T[..., :3, 3])
    return np.concatenate([rho, phi], axis=-1)


def adjoint(poses: ArrayLike) -> FloatArray:
    """Return (..., 6, 6) Ad with ``T exp(xi) = exp(Ad xi) T`` for (..., 4, 4) poses T."""
    T = np.asarray(poses, dtype=np.float64)
    R = T[..., :3, :3]
    result = np.zeros((*T.shape[:-2], 6, 6))
    result[..., :3, :3] = R
    result[..., 3:, 3:] = R
    result[..., :3, 3:] = skew(T[..., :3, 3]) @ R
    return result


def moved(poses: ArrayLike, steps: ArrayLike) -> FloatArray:
    """Return (..., 4, 4) poses after (..., 6) steps: ``t + dt``, ``exp(dtheta) R``.

    Along and about the axes of the parent, as in the covariance of an extrinsic.
    """
    T = np.asarray(poses, dtype=np.float64)
    step = np.asarray(steps, dtype=np.float64)
    return from_rotation_translation(
        exp_so3(step[..., 3:]) @ T[..., :3, :3], T[..., :3, 3] + step[..., :3])


def step_between(start: ArrayLike, end: ArrayLike) -> FloatArray:
    """Return the (..., 6) steps with which ``moved`` takes (..., 4, 4) poses to others."""
    T_0, T_1 = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    rotation = log_so3(T_1[..., :3, :3] @ np.swapaxes(T_0[..., :3, :3], -1, -2))
    return np.concatenate([T_1[..., :3, 3] - T_0[..., :3, 3], rotation], axis=-1)


def inverse_step(pose: ArrayLike) -> FloatArray:
    """Return (6, 6) J: steps of a (4, 4) pose, times J, are the steps of its inverse."""
    T = np.asarray(pose, dtype=np.float64)
    R, t = T[:3, :3], T[:3, 3]
    J = np.zeros((6, 6))
    J[:3, :3] = J[3:, 3:] = -R.T
    J[:3, 3:] = -R.T @ skew(t)
    return J


def geodesic(start: ArrayLike, end: ArrayLike, fraction: ArrayLike) -> FloatArray:
    """Return the (..., 4, 4) poses at ``fraction`` (...) of the geodesic from start to end.

    The constant-twist path ``T_0 exp(s log(T_0^-1 T_1))``; a fraction outside [0, 1] continues it.
    """
    T_0 = np.asarray(start, dtype=np.float64)
    s = np.asarray(fraction, dtype=np.float64)
    return T_0 @ exp_se3(s[..., None] * log_se3(inverse(T_0) @ np.asarray(end)))


def registration(poses_a: FloatArray, poses_b: FloatArray) -> FloatArray:
    """Return (4, 4), what moves (K, 4, 4) poses b as a whole onto a, by rotations and positions.

    Positions alone do not tell a rotation about a straight line.
    """
    R_a, R_b = poses_a[:, :3, :3], poses_b[:, :3, :3]
    by_rotation = np.einsum('kij,klj->il', R_a, R_b) / len(poses_a)
    p_a, p_b = poses_a[:, :3, 3], poses_b[:, :3, 3]
    mean_a, mean_b = p_a.mean(axis=0), p_b.mean(axis=0)
    by_position = (p_a - mean_a).T @ (p_b - mean_b) / len(p_a)
    R = nearest_rotation(by_rotation)
    # Each counts by how well it agrees.
    turn = np.mean(rotation_angle(np.swapaxes(R_a, 1, 2) @ R @ R_b) ** 2)
    shift = np.mean(np.sum((p_a - mean_a - (p_b - mean_b) @ R.T) ** 2, axis=1))
    R = nearest_rotation(by_rotation / max(turn, 1e-12) + by_position / max(shift, 1e-12))
    return from_rotation_translation(R, mean_a - R @ mean_b)
