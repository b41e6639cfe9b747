# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The cost ``sum |A X - X B|^2`` as one quadratic form, and its minimum over SE(3).

The residuals of a motion are linear in ``v = (vec R, t, 1)``, 13 numbers with R row by row. The
cost of all motions is therefore ``v^T G v`` with one 13 x 13 Gram matrix: whatever is done with
the cost afterwards does not depend on the number of motions.

With the unit quaternions (a_0, a) of R_A and (b_0, b) of R_B, the rotation's part is

    |R_A R - R R_B|^2 = 8 sin^2(w / 2) = 8 |a_0 R b - b_0 a - a x R b|^2,

w the angle between the two products: three rows instead of nine.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from trajectory_calibration.config.prior import Prior
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.errors import counted, MotionError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.solution import UNOBSERVED_STD

# Smallest root mean square motion above rounding (radians; metres per metre from the origin).
NO_MOTION = 1e-9

# A minimisation ends with a step below this, radians.
SETTLED = 1e-12

# Motions whose features are computed at once.
CHUNK = 8192

# The products v_i v_j, i <= j.
UPPER = np.triu_indices(13)
_TWICE = np.where(UPPER[0] == UPPER[1], 1.0, 2.0)

_PLACE = np.zeros((13, 13), dtype=np.intp)
_PLACE[UPPER] = _PLACE[UPPER[::-1]] = np.arange(91)

# v without the translation.
_OUTER = np.r_[0:9, 12]

# The generators of rotation.
_E = se3.skew(np.eye(3))

# The 24 rotations of a cube: no rotation is farther than 63 degrees from one of them.
_CUBE = np.array([
    matrix for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)
    if np.linalg.det(matrix := np.eye(3)[list(order)] * np.array(signs)[:, None]) > 0])


@dataclass(frozen=True, eq=False)
class Minimum:
    """The lowest minimum found of a quadratic form over SE(3).

    Attributes
    ----------
    T_a_b : (4, 4).
    cost : value of the quadratic form.
    iterations : Newton iterations of all starts together.
    form : (13, 13), the form, regularised in unobservable directions.

    """

    T_a_b: FloatArray
    cost: float
    iterations: int
    form: FloatArray


def require_motion(pairs: PosePairs) -> None:
    """Raise MotionError if one of the sensors did not move beyond rounding."""
    for name, poses in (('a', pairs.poses_a), ('b', pairs.poses_b)):
        if np.abs(poses - poses[0]).max() <= NO_MOTION * (1.0 + float(np.abs(poses[0]).max())):
            raise MotionError(
                f'the sensors did not turn or move: {name} stood still over '
                f'{counted(len(poses), "pose")}. Drive curves, and a ramp or a bank')


def rows(A: FloatArray, B: FloatArray, *, rotation: bool = True) -> FloatArray:
    """Return (13, 6, M) coefficients: their product with v are the residuals of (M, 4, 4) motions.

    Without ``rotation``, (13, 3, M): only the translation ``R_A t + t_A - R t_B - t``.
    """
    # Motions along the last axis, so that each operation runs over contiguous numbers.
    found = np.zeros((13, 6, len(A)))
    t_b = B[:, :3, 3].T
    for i in range(3):
        found[3 * i:3 * i + 3, 3 + i] = -t_b
    found[9:12, 3:] = (A[:, :3, :3] - np.eye(3)).transpose(2, 1, 0)
    found[12, 3:] = A[:, :3, 3].T
    if not rotation:
        return found[:, 3:]
    q_a, q_b = (se3.rotation_to_quaternion(T[:, :3, :3]) for T in (A, B))
    root = np.sqrt(8.0)
    turn = root * (q_a[:, 3, None, None] * np.eye(3) - se3.skew(q_a[:, :3]))
    b = q_b[:, :3].T
    for m in range(3):
        found[3 * m:3 * m + 3, :3] = turn[:, :, m].T * b[:, None]
    found[12, :3] = -root * q_b[:, 3] * q_a[:, :3].T
    return found


def features(A: FloatArray, B: FloatArray) -> FloatArray:
    """Return (91, M): ``|A X - X B|^2`` of each motion is their sum times v_i v_j, see ``UPPER``.

    A and B are (M, 4, 4).
    """
    found = rows(A, B)
    return _TWICE[:, None] * np.concatenate([
        (found[i] * found[i:]).sum(axis=1) for i in range(13)])


def form(sums: FloatArray) -> FloatArray:
    """Return the (..., 13, 13) Gram matrices of (..., 91) sums of features."""
    halves: FloatArray = (sums / _TWICE)[..., _PLACE]
    return halves


def gram(motions: MotionPairs, *, rotation: bool = True) -> FloatArray:
    """Return the (13, 13) Gram matrix of all motions, or of their translation rows only."""
    G = np.zeros((13, 13))
    for part in parts(motions):
        found = rows(motions.A[part], motions.B[part], rotation=rotation).reshape(13, -1)
        G += found @ found.T
    return G


def parts(motions: MotionPairs) -> list[slice]:
    """Return slices of motions few enough to be worked on at once."""
    return [slice(start, start + CHUNK) for start in range(0, len(motions), CHUNK)]


def monomials(T_a_b: FloatArray) -> FloatArray:
    """Return v (..., 13) of (..., 4, 4) extrinsics."""
    R = T_a_b[..., :3, :3]
    one = np.ones((*T_a_b.shape[:-2], 1))
    return np.concatenate([R.reshape(*R.shape[:-2], 9), T_a_b[..., :3, 3], one], axis=-1)


def minimise(
    G: FloatArray, starts: FloatArray | None = None, prior: Prior | None = None,
) -> Minimum:
    """Minimise ``v^T G v`` over rotations and translations, from many starts at once.

    Unobservable directions are as near as possible to the prior, or to zero and the identity
    without one. ``starts`` are (S, 3, 3) rotations; the 24 of a cube
    where omitted.
    """
    G = held_translation(G, prior)
    starts = _CUBE if starts is None else starts
    minimum = _lowest(G, starts)
    if not _determines_rotation(G, minimum.T_a_b):
        R_prior = np.eye(3) if prior is None else prior.rotation
        off = np.column_stack([np.eye(9), np.zeros((9, 3)), -R_prior.reshape(9)])
        # A weight that is negligible beside the rotation's part of the form.
        held = G + 1e-9 * float(np.trace(G[:9, :9])) / 9 * off.T @ off
        minimum = _lowest(held, np.concatenate([starts, R_prior[None]]))
    return minimum


def held_translation(G: FloatArray, prior: Prior | None = None) -> FloatArray:
    """Return (..., 13, 13) forms that fix unobservable directions of t at the prior, or zero."""
    hold = hold_of(G[..., 9:12, 9:12], np.einsum('...ii->...', G[..., :9, :9]))
    if not hold.any():
        return G
    held = G.copy()
    held[..., 9:12, 9:12] += hold
    if prior is not None:
        pull = hold @ prior.translation
        held[..., 9:12, 12] -= pull
        held[..., 12, 9:12] -= pull
        held[..., 12, 12] += pull @ prior.translation
    return held


def hold_of(turns: FloatArray, size: FloatArray | float) -> FloatArray:
    """Return the (..., 3, 3) forms that fix unobservable directions of t.

    ``turns`` (..., 3, 3) are sums of ``D^T D``, D = R_A - I.
    ``size`` (...) is the motion in the same sums: without any turn, all that they say against it
    is rounding.
    """
    eigenvalues, axes = np.linalg.eigh(turns)
    largest = np.maximum(eigenvalues[..., -1], se3.PRECISION * np.asarray(size))[..., None]
    unobserved = eigenvalues <= se3.ROUNDING * largest
    weight = np.where(unobserved, np.maximum(largest, np.finfo(float).tiny), 0.0)
    hold: FloatArray = (axes * weight[..., None, :]) @ np.swapaxes(axes, -1, -2)
    return hold


def hold_implausible(turns: FloatArray, variance: float) -> FloatArray:
    """Return a (3, 3) form that holds the directions of t farther than sensors can be apart.

    An unobservable rotation leaves residuals as large as the motion, which a direction of hardly
    any turn explains by kilometres: with ``variance`` of a residual, m^2, such a t means nothing.
    """
    eigenvalues, axes = np.linalg.eigh(turns)
    # Far beyond ``UNOBSERVED_STD``, because published rows are 20 and 100 m off.
    least = variance / (10 * UNOBSERVED_STD[0])**2
    unobserved = axes[:, eigenvalues < least]
    hold: FloatArray = 1e9 * least * unobserved @ unobserved.T
    return hold


def linear_start(G: FloatArray) -> FloatArray:
    """Return the (3, 3) rotation next to the minimum over all matrices, rotations or not."""
    v = -np.linalg.pinv(G[:12, :12], rcond=se3.ROUNDING, hermitian=True) @ G[:12, 12]
    return se3.nearest_rotation(v[:9].reshape(3, 3))


def without_translation(G: FloatArray) -> FloatArray:
    """Return the (..., 10, 10) forms in ``u = (vec R, 1)``, each at the best translation."""
    G_ut = G[..., _OUTER, :][..., 9:12]
    F = G[..., _OUTER, :][..., _OUTER] - G_ut @ np.linalg.solve(
        G[..., 9:12, 9:12], np.swapaxes(G_ut, -1, -2))
    return np.asarray(0.5 * (F + np.swapaxes(F, -1, -2)), dtype=np.float64)


def best_translation(G: FloatArray, R: FloatArray) -> FloatArray:
    """Return the (..., 3) translations that minimise the cost for (..., 3, 3) rotations."""
    u = _with_one(R)
    right = G[..., 9:12, :][..., _OUTER] @ u[..., None]
    return np.asarray(-np.linalg.solve(G[..., 9:12, 9:12], right)[..., 0], dtype=np.float64)


def minimise_rotations(
    G: FloatArray, starts: FloatArray, tolerance: float = SETTLED,
) -> tuple[FloatArray, FloatArray, int]:
    """Run Newton's method on SO(3) from (S, 3, 3) starts, the translation eliminated.

    ``G`` is one (13, 13) matrix or one for each start, (S, 13, 13). Returns the rotations, their
    costs (S,), and the number of iterations. It ends with steps below the tolerance, radians.
    """
    F = without_translation(G)
    scale = np.maximum(np.einsum('...ii->...', F[..., :9, :9]), np.finfo(float).tiny)
    F = np.broadcast_to(F / scale[..., None, None], (len(starts), 10, 10))
    R = np.array(starts)
    cost, damping, done, iterations = _cost(F, R), np.zeros(len(R)), np.zeros(len(R), bool), 0
    while not done.all() and iterations < 100:
        iterations += 1
        gradient, hessian = _derivatives(F, R)
        # A Newton step on the absolute eigenvalues: downhill also where the cost is not convex.
        eigenvalues, Q = np.linalg.eigh(hessian)
        curvature = np.maximum(np.abs(eigenvalues), 1e-12) + damping[:, None]
        along = (np.swapaxes(Q, 1, 2) @ gradient[:, :, None])[:, :, 0] / curvature
        step = -(Q @ along[:, :, None])[:, :, 0]
        moved = se3.exp_so3(step) @ R
        moved_cost = _cost(F, moved)
        better = moved_cost <= cost
        R[better], cost[better] = moved[better], moved_cost[better]
        damping = np.where(better, damping * 0.1, np.maximum(damping * 10, 1e-3))
        done |= (np.sum(step**2, axis=1) < tolerance**2) | (~better & (damping > 1e8))
    return R, cost * scale, iterations


def polish(
    T_a_b: FloatArray, motions: MotionPairs, weights: FloatArray | None = None, *,
    rotation: bool = True,
) -> FloatArray:
    """Take one Gauss-Newton step on the residuals themselves, where they determine it.

    A Gram matrix squares the condition of the problem; one step on the true residuals gives back
    the digits, which is what lets noise-free data be recovered to machine precision.
    """
    slopes, H, g = _slopes(T_a_b), np.zeros((6, 6)), np.zeros(6)
    for part in parts(motions):
        found = rows(motions.A[part], motions.B[part], rotation=rotation)
        if weights is not None:
            found *= np.sqrt(weights[part])
        found = found.reshape(13, -1)
        J = slopes @ found
        H += J @ J.T
        g += J @ (monomials(T_a_b) @ found)
    Q = observed_directions(H, len(motions))
    return se3.moved(T_a_b, -Q @ (Q.T @ g))


def newton_step(G: FloatArray, T_a_b: FloatArray, motions: int) -> FloatArray:
    """Return a (4, 4) extrinsic one Newton step nearer to the minimum of ``v^T G v``."""
    slopes, Gv = _slopes(T_a_b), G @ monomials(T_a_b)
    H = slopes @ G @ slopes.T
    H[3:, 3:] += _bend(T_a_b[:3, :3], Gv[:9].reshape(3, 3))
    Q = observed_directions(H, motions)
    return se3.moved(T_a_b, -Q @ (Q.T @ (slopes @ Gv)))


def observed_directions(H: FloatArray, motions: int) -> FloatArray:
    """Return (6, K) Q with ``Q^T H Q = I``: what a sum of squares in (t, theta) determines.

    ``Q Q^T`` is its inverse, zero where that is rounding.
    """
    largest = np.diagonal(H).reshape(2, 3).max(axis=1)
    scale = np.repeat(np.sqrt(np.maximum(largest, motions * NO_MOTION**2)), 3)
    eigenvalues, Q = np.linalg.eigh(H / np.outer(scale, scale))
    kept = eigenvalues > se3.ROUNDING * max(float(eigenvalues[-1]), 1.0)
    found: FloatArray = Q[:, kept] / np.sqrt(eigenvalues[kept]) / scale[:, None]
    return found


def _slopes(T_a_b: FloatArray) -> FloatArray:
    """Return (6, 13), the derivatives of v in (t, theta)."""
    slopes = np.zeros((6, 13))
    slopes[:3, 9:12] = np.eye(3)
    slopes[3:, :9] = (_E @ T_a_b[:3, :3]).reshape(3, 9)
    return slopes


def _bend(R: FloatArray, N: FloatArray) -> FloatArray:
    """Return (..., 3, 3), half the second derivative in theta of ``2 sum N * exp(theta) R``."""
    K = R @ np.swapaxes(N, -1, -2)
    trace = np.trace(K, axis1=-2, axis2=-1)[..., None, None]
    bend: FloatArray = 0.5 * (K + np.swapaxes(K, -1, -2)) - trace * np.eye(3)
    return bend


def _lowest(G: FloatArray, starts: FloatArray) -> Minimum:
    R, cost, iterations = minimise_rotations(G, starts)
    best = int(np.argmin(cost))
    T_a_b = se3.from_rotation_translation(R[best], best_translation(G, R[best]))
    return Minimum(T_a_b, max(float(cost[best]), 0.0), iterations, G)


def _determines_rotation(G: FloatArray, T_a_b: FloatArray) -> bool:
    """Tell whether a form determines the rotation at its minimum, but for rounding."""
    J = _slopes(T_a_b)[3:, :9]
    eigenvalues = np.linalg.eigvalsh(J @ without_translation(G)[:9, :9] @ J.T)
    return bool(eigenvalues[0] > se3.ROUNDING * eigenvalues[-1])


def _with_one(R: FloatArray) -> FloatArray:
    """Return (..., 10) u = (vec R, 1) of (..., 3, 3) rotations."""
    return np.concatenate([R.reshape(*R.shape[:-2], 9), np.ones((*R.shape[:-2], 1))], axis=-1)


def _cost(F: FloatArray, R: FloatArray) -> FloatArray:
    u = _with_one(R)
    cost: FloatArray = np.sum((F @ u[:, :, None])[:, :, 0] * u, axis=1)
    return cost


def _derivatives(F: FloatArray, R: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (S, 3) gradients and (S, 3, 3) Hessians in theta of ``exp(theta) R``."""
    N = F[:, :9] @ _with_one(R)[:, :, None]
    first = (_E @ R[:, None]).reshape(-1, 3, 9)
    hessian = first @ F[:, :9, :9] @ np.swapaxes(first, 1, 2) + _bend(R, N.reshape(-1, 3, 3))
    return 2 * (first @ N)[:, :, 0], 2 * hessian
