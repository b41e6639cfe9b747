"""The cost ``sum |A X - X B|^2`` as one quadratic form, and its minimum over SE(3).

Every entry of ``M = A X - X B`` is linear in ``v = (vec R, t, 1)``, a vector of 13 numbers (R row
by row). The sum of squares over all motions is therefore ``v^T G v`` with one 13 x 13 Gram
matrix: whatever is done with the cost afterwards does not depend on the number of motions.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.errors import MotionError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# Relative to the largest eigenvalue of a sum of squares: below it a direction is not determined
# but for rounding. It is the square of the tilt, 1e-6 rad, that files with nine digits keep.
_UNDETERMINED = 1e-12

# Weight, relative to the rotation's part of a form, of what holds an undetermined rotation: too
# small to count in a direction that is determined, enough to pass for determined in another.
_HOLD = 1e-9

# The smallest root mean square rotation (radians) that counts as turning at all.
_NO_ROTATION = 1e-9

_MAX_ITERATIONS = 100

# Motions whose equations are held in memory at once (12 x 13 numbers each).
CHUNK = 8192

# The generators of rotation: skew(e_i), and their symmetrised products.
_E = se3.skew(np.eye(3))
_EE = 0.5 * (np.einsum('aij,bjk->abik', _E, _E) + np.einsum('bij,ajk->abik', _E, _E))

# The 24 rotations of a cube: no rotation is farther than 63 degrees from one of them.
_CUBE = np.array([
    matrix for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)
    if np.linalg.det(matrix := np.eye(3)[list(order)] * np.array(signs)[:, None]) > 0])


@dataclass(frozen=True, eq=False)
class Minimum:
    """The lowest minimum found of ``v^T G v`` over SE(3).

    Attributes
    ----------
    T_a_b : (4, 4).
    cost : value of the quadratic form.
    iterations : Newton iterations of all starts together.

    """

    T_a_b: FloatArray
    cost: float
    iterations: int


def equations(A: FloatArray, B: FloatArray) -> FloatArray:
    """Return the (M, 12, 13) rows E with ``E @ v`` = the entries of ``A X - X B``.

    Rows 0-8 are the rotation ``R_A R - R R_B`` row by row, rows 9-11 the translation
    ``R_A t + t_A - R t_B - t``; ``v = (vec R, t, 1)``. A and B are (M, 4, 4).
    """
    R_A, R_B = A[:, :3, :3], B[:, :3, :3]
    E = np.zeros((len(A), 12, 13))
    rotation = E[:, :9, :9].reshape(len(A), 3, 3, 3, 3)
    translation = np.zeros((len(A), 3, 3, 3))
    for i in range(3):
        # d(R_A R)_mi / dR_ni = (R_A)_mn and d(R R_B)_im / dR_in = (R_B)_nm.
        rotation[:, :, i, :, i] += R_A
        rotation[:, i, :, i, :] -= np.swapaxes(R_B, 1, 2)
        translation[:, i, i] = -B[:, :3, 3]
    E[:, :9, :9] = rotation.reshape(len(A), 9, 9)
    E[:, 9:, :9] = translation.reshape(len(A), 3, 9)
    E[:, 9:, 9:12] = R_A - np.eye(3)
    E[:, 9:, 12] = A[:, :3, 3]
    return E


def gram(motions: MotionPairs, rows: slice = slice(0, 12)) -> FloatArray:
    """Return the (13, 13) Gram matrix of the equations, summed over the motions.

    ``rows`` picks equations: all twelve, or the translation only.
    """
    G = np.zeros((13, 13))
    for start in range(0, len(motions), CHUNK):
        part = slice(start, start + CHUNK)
        E = equations(motions.A[part], motions.B[part])[:, rows].reshape(-1, 13)
        G += E.T @ E
    return G


def monomials(T_a_b: FloatArray) -> FloatArray:
    """Return v (..., 13) of (..., 4, 4) extrinsics."""
    R = T_a_b[..., :3, :3]
    one = np.ones((*T_a_b.shape[:-2], 1))
    return np.concatenate([R.reshape(*R.shape[:-2], 9), T_a_b[..., :3, 3], one], axis=-1)


def require_translation(G: FloatArray, motions: int) -> None:
    """Raise MotionError where the translation block of a Gram matrix has an empty direction."""
    free, angle = free_translations(G[9:12, 9:12], motions)
    if len(free) == 3:
        raise MotionError(
            f'the sensors did not turn (root mean square {angle:.1g} rad over {motions} motions);'
            ' the translation between them shows only in turns: drive curves and a ramp or a bank')
    if len(free):
        x, y, z = free[0] * np.sign(free[0, np.abs(free[0]).argmax()])
        raise MotionError(
            f'the translation along ({x:.2f}, {y:.2f}, {z:.2f}) in a is not determined: all '
            f'{motions} motions turn about that axis only; drive a ramp or a bank too')


def free_translations(turns: FloatArray, motions: int) -> tuple[FloatArray, float]:
    """Return (K, 3) unit vectors along which t is free, and the root mean square turn, radians.

    ``turns`` (3, 3) is the sum of ``(R_A - I)^T (R_A - I)``.
    """
    eigenvalues, axes = np.linalg.eigh(turns)
    angle = float(np.sqrt(max(eigenvalues[-1], 0.0) / motions))
    if angle < _NO_ROTATION:
        return np.eye(3), angle
    return axes[:, eigenvalues < _UNDETERMINED * eigenvalues[-1]].T, angle


def hold(G: FloatArray, motions: int, config: CalibrationConfig) -> FloatArray:
    """Return a (13, 13) form that holds what the motion leaves free at the prior, or at zero.

    It is zero where the motion determines everything and nothing else was allowed.

    Raises
    ------
    MotionError
        A translation is free that no prior covers, and ``allow_unobserved`` is off.

    """
    held = np.zeros((13, 13))
    held[9:, 9:] = hold_translation(G[9:12, 9:12], motions, config)
    if holds_rotation(config):
        R = config.prior.rotation
        rows = np.column_stack([np.eye(9), np.zeros((9, 3)), -R.reshape(9)])
        held += _HOLD * float(np.trace(G[:9, :9])) / 9 * rows.T @ rows
    return held


def hold_translation(
    turns: FloatArray, motions: int, config: CalibrationConfig,
) -> FloatArray:
    """Return the (4, 4) part of ``hold`` in (t, 1); raises as ``hold``."""
    prior = config.prior
    free, _ = free_translations(turns, motions)
    covered = all(
        prior.translation_std_along(axis) <= config.unobserved_translation for axis in free)
    if not (covered or config.allow_unobserved):
        G = np.zeros((13, 13))
        G[9:12, 9:12] = turns
        require_translation(G, motions)
    weight = max(float(np.linalg.eigvalsh(turns)[-1]), _NO_ROTATION**2 * motions)
    rows = np.column_stack([free, -free @ prior.translation])
    held: FloatArray = weight * rows.T @ rows
    return held


def holds_rotation(config: CalibrationConfig) -> bool:
    """Return whether a rotation that the motion leaves free has a place to be held at."""
    return config.allow_unobserved or bool(np.isfinite(config.prior.rotation_std).any())


def minimise(G: FloatArray, starts: FloatArray | None = None) -> Minimum:
    """Minimise ``v^T G v`` over rotations and translations, from many starts at once.

    ``starts`` are (S, 3, 3) rotations; the 24 rotations of a cube where omitted.

    Raises
    ------
    MotionError
        A rotation direction that the quadratic form leaves free.

    """
    R, cost, iterations = minimise_rotations(G, _CUBE if starts is None else starts)
    best = int(np.argmin(cost))
    T_a_b = se3.from_rotation_translation(R[best], best_translation(G, R[best]))
    require_rotation(G, T_a_b)
    return Minimum(T_a_b, float(cost[best]), iterations)


def best_translation(G: FloatArray, R: FloatArray) -> FloatArray:
    """Return the (..., 3) translations that minimise the cost for (..., 3, 3) rotations."""
    u = np.concatenate([R.reshape(*R.shape[:-2], 9), np.ones((*R.shape[:-2], 1))], axis=-1)
    outer = np.r_[0:9, 12]
    right = np.einsum('...ij,...j->...i', G[..., 9:12, :][..., outer], u)
    t: FloatArray = -np.linalg.solve(G[..., 9:12, 9:12], right[..., None])[..., 0]
    return t


def minimise_rotations(
    G: FloatArray, starts: FloatArray,
) -> tuple[FloatArray, FloatArray, int]:
    """Run Newton's method on SO(3) from (S, 3, 3) starts, the translation eliminated.

    ``G`` is one (13, 13) matrix or one for each start, (S, 13, 13). Returns the rotations, their
    costs (S,), and the number of iterations.
    """
    outer = np.r_[0:9, 12]
    G_ut = G[..., outer, :][..., 9:12]
    F = G[..., outer, :][..., outer] - G_ut @ np.linalg.solve(
        G[..., 9:12, 9:12], np.swapaxes(G_ut, -1, -2))
    F = np.broadcast_to(0.5 * (F + np.swapaxes(F, -1, -2)), (len(starts), 10, 10))
    scale = np.maximum(np.trace(F[:, :9, :9], axis1=1, axis2=2), np.finfo(float).tiny)
    R = np.array(starts)
    cost = _cost(F, R)
    damping = np.zeros(len(R))
    iterations = 0
    active = np.ones(len(R), bool)
    while active.any() and iterations < _MAX_ITERATIONS:
        iterations += 1
        k = np.flatnonzero(active)
        gradient, hessian = _derivatives(F[k], R[k])
        # A Newton step on the absolute eigenvalues: downhill also where the cost is not convex.
        eigenvalues, Q = np.linalg.eigh(hessian)
        floor = 1e-12 * scale[k, None]
        curvature = np.maximum(np.abs(eigenvalues), floor) + damping[k, None] * scale[k, None]
        step = -np.einsum(
            'kij,kj->ki', Q, np.einsum('kji,kj->ki', Q, gradient) / curvature)
        moved = se3.exp_so3(step) @ R[k]
        moved_cost = _cost(F[k], moved)
        better = moved_cost <= cost[k]
        R[k[better]], cost[k[better]] = moved[better], moved_cost[better]
        damping[k] = np.where(better, damping[k] * 0.1, np.maximum(damping[k] * 10, 1e-3))
        small = np.linalg.norm(step, axis=1) < 1e-12
        active[k] = ~(small | (~better & (damping[k] > 1e8)))
    return R, cost, iterations


def _cost(F: FloatArray, R: FloatArray) -> FloatArray:
    u = np.concatenate([R.reshape(-1, 9), np.ones((len(R), 1))], axis=1)
    return np.einsum('ki,kij,kj->k', u, F, u)


def _derivatives(F: FloatArray, R: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (S, 3) gradients and (S, 3, 3) Hessians in theta of ``exp(theta) R``."""
    u = np.concatenate([R.reshape(-1, 9), np.ones((len(R), 1))], axis=1)
    Fu = np.einsum('kij,kj->ki', F, u)[:, :9]
    first = np.einsum('aij,kjl->kail', _E, R).reshape(-1, 3, 9)
    second = np.einsum('abij,kjl->kabil', _EE, R).reshape(-1, 3, 3, 9)
    gradient = 2 * np.einsum('kai,ki->ka', first, Fu)
    hessian = 2 * (first @ F[:, :9, :9] @ np.swapaxes(first, 1, 2)
                   + np.einsum('kabi,ki->kab', second, Fu))
    return gradient, hessian


def tangent_basis(T_a_b: FloatArray) -> FloatArray:
    """Return the (13, 6) derivative of v in (t, theta), ``R = exp(theta) R_hat``."""
    J = np.zeros((13, 6))
    J[:9, 3:] = (_E @ T_a_b[:3, :3]).reshape(3, 9).T
    J[9:12, :3] = np.eye(3)
    return J


def require_rotation(G: FloatArray, T_a_b: FloatArray) -> None:
    """Raise MotionError where the cost does not determine a rotation at its minimum."""
    J = tangent_basis(T_a_b)
    H = J.T @ G @ J
    S = H[3:, 3:] - H[3:, :3] @ np.linalg.solve(H[:3, :3], H[:3, 3:])
    eigenvalues, axes = np.linalg.eigh(0.5 * (S + S.T))
    if eigenvalues[0] < _UNDETERMINED * max(eigenvalues[-1], np.finfo(float).tiny):
        x, y, z = axes[:, 0] * np.sign(axes[np.abs(axes[:, 0]).argmax(), 0])
        raise MotionError(
            f'the rotation about ({x:.2f}, {y:.2f}, {z:.2f}) in a is not determined by this '
            'motion; drive curves with forward motion, and a ramp or a bank')


def polish(T_a_b: FloatArray, motions: MotionPairs, rows: slice = slice(0, 12),
           weights: FloatArray | None = None, held: FloatArray | None = None) -> FloatArray:
    """Take one Gauss-Newton step on the residuals themselves, and on the form ``held``.

    A Gram matrix squares the condition of the problem; one step on the true residuals gives back
    the digits, which is what lets noise-free data be recovered to machine precision.
    """
    J, v = tangent_basis(T_a_b), monomials(T_a_b)
    H, g = np.zeros((6, 6)), np.zeros(6)
    if held is not None:
        H, g = J.T @ held @ J, J.T @ (held @ v)
    for start in range(0, len(motions), CHUNK):
        part = slice(start, start + CHUNK)
        E = equations(motions.A[part], motions.B[part])[:, rows]
        if weights is not None:
            E = E * np.sqrt(weights[part, None, None])
        E = E.reshape(-1, 13)
        EJ = E @ J
        H += EJ.T @ EJ
        g += EJ.T @ (E @ v)
    return se3.moved(T_a_b, -np.linalg.solve(H, g))
