# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""DNL: direct nonlinear least squares, the first of the two solvers the paper proposes.

T. Valimaki, B. Garigipati, R. Ghabcheloo, "Motion-Based Extrinsic Sensor-to-Sensor Calibration:
Effect of Reference Frame Selection for New and Existing Methods", Sensors 23(7):3740, 2023,
doi:10.3390/s23073740, section III-B:

    min over (theta, t) of  sum |M_ij|^2,   M_ij = A_ij X(theta, t) - X(theta, t) B_ij,

the Frobenius norm of the upper three rows, theta a rotation vector, with CasADi and Ipopt.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from threading import Lock
from typing import Any

import numpy as np

from trajectory_calibration.config.prior import Prior
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.errors import require, SolverError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers import linear, quadratic
from trajectory_calibration.solvers.certificate import certify, PROVEN
from trajectory_calibration.solvers.solution import Solution

# One thread at a time, in all programs: a CasADi function keeps the statistics of whoever called
# it last, CasADi counts the references to shared symbols without a lock, and Ipopt's linear
# solver (MUMPS) has global state, so that a program of its own for each thread would not do.
_IPOPT = Lock()

QUIET = {'print_time': False, 'ipopt.print_level': 0, 'ipopt.sb': 'yes'}


def solve(motions: MotionPairs, config: CalibrationConfig) -> Solution:
    """Return the extrinsic with the lowest cost (rotation entries squared + m^2).

    Raises MotionError for no motion at all, SolverError where Ipopt stopped before a minimum.
    """
    quadratic.require_motion(motions.pairs)
    minimum, gap = lowest_minimum(quadratic.gram(motions), config.prior)
    T_a_b, cost, iterations = minimise_with_ipopt(minimum.form, minimum.T_a_b)
    doubt = Finding(
        'minimum-not-proven',
        'the minimum is not proven to be the lowest; another could have a cost lower by up '
        f'to {gap:.2g} times its own. Compare with another solver', {'relative_gap': gap})
    return Solution(quadratic.polish(T_a_b, motions), cost, iterations,
                    linearise=linear.frobenius, optimality_gap=gap,
                    findings=() if gap <= PROVEN else (doubt,))


def lowest_minimum(
    G: FloatArray, prior: Prior | None = None,
) -> tuple[quadratic.Minimum, float]:
    """Return the lowest minimum of ``v^T G v`` over SE(3), and its gap; see ``certify``.

    The cost is not convex: more and more starts on SO(3) are used until the minimum is proven.
    """
    for starts in (lambda: quadratic.linear_start(G)[None], lambda: None, _many_rotations):
        minimum = quadratic.minimise(G, starts(), prior)
        gap = certify(minimum.form, minimum.T_a_b)
        if gap <= PROVEN:
            break
    return minimum, gap


def _many_rotations() -> FloatArray:
    """Return (500, 3, 3) rotations that cover SO(3) densely, the same ones every time."""
    quaternions = np.random.default_rng(0).standard_normal((500, 4))
    return se3.quaternion_to_rotation(
        quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))


def minimise_with_ipopt(G: FloatArray, start: FloatArray) -> tuple[FloatArray, float, int]:
    """Minimise ``v^T G v`` over (theta, t) from a (4, 4) start; return X, cost, iterations."""
    # Ipopt's tolerances are absolute: give it a form with entries of order one.
    scale = max(float(np.abs(G).max()), np.finfo(float).tiny)
    x, cost, iterations = run_ipopt(
        _program, 'use another solver, or check the trajectories with inspect',
        x0=np.concatenate([np.zeros(3), start[:3, 3]]),
        p=np.concatenate([(G / scale).ravel(), start[:3, :3].ravel()]))
    T_a_b = se3.from_rotation_translation(se3.exp_so3(x[:3]) @ start[:3, :3], x[3:])
    return T_a_b, cost * scale, iterations


def run_ipopt(
    program: Callable[[], Any], advice: str, **arguments: Any,
) -> tuple[FloatArray, float, int]:
    """Run the nonlinear program that ``program()`` returns; return x, cost and iterations.

    Threads take turns. Raises SolverError, which ends with ``advice``, where Ipopt stopped before
    a minimum.
    """
    with _IPOPT:
        # In a call of its own, so that a program that has left its cache ends inside the lock.
        x, cost, stats = _call(program(), arguments)
    if not stats['success']:
        raise SolverError(
            f'Ipopt stopped with {stats["return_status"]} after {stats["iter_count"]} iterations; '
            f'{advice}')
    return x, cost, int(stats['iter_count'])


def _call(solver: Any, arguments: dict[str, Any]) -> tuple[FloatArray, float, dict[str, Any]]:
    found = solver(**arguments)
    return found['x'].full().ravel(), float(found['f']), solver.stats()


@lru_cache(maxsize=1)
def _program() -> Any:
    """Build the nonlinear program once; the Gram matrix and the start are its parameters."""
    # Loaded here because it takes a third of a second, and as Any because its own annotations
    # refuse its own expressions.
    ca: Any = require('casadi')
    theta, t = ca.SX.sym('theta', 3), ca.SX.sym('t', 3)
    G, R_start = ca.SX.sym('G', 169), ca.SX.sym('R_start', 9)
    v = symbolic_monomials(ca, theta, t, R_start)
    cost = ca.dot(v, ca.mtimes(ca.reshape(G, 13, 13), v))
    # Below this tolerance the line search is lost in the rounding of the cost; the last digits
    # come from a step on the residuals.
    return ca.nlpsol(
        'dnl', 'ipopt', {'x': ca.vertcat(theta, t), 'p': ca.vertcat(G, R_start), 'f': cost},
        {**QUIET, 'ipopt.tol': 1e-9, 'ipopt.max_iter': 200})


def symbolic_monomials(ca: Any, theta: Any, t: Any, R_start: Any) -> Any:
    """Return v = (vec(exp(theta) R_start), t, 1) as CasADi expressions, R row by row.

    The rotation vector is relative to the start, and the coefficients of Rodrigues' formula
    switch to their series at zero, where the square root has no derivative.
    """
    square = ca.dot(theta, theta)
    small = square < 1e-8
    # The argument is moved off zero where its branch is not taken: a NaN there would pass
    # through the derivative of if_else.
    angle = ca.sqrt(ca.if_else(small, 1.0, square))
    sine = ca.if_else(small, 1 - square / 6, ca.sin(angle) / angle)
    cosine = ca.if_else(small, 0.5 - square / 24, (1 - ca.cos(angle)) / angle**2)
    K = ca.skew(theta)
    R = (ca.SX.eye(3) + sine * K + cosine * ca.mtimes(K, K))
    R = ca.mtimes(R, ca.reshape(R_start, 3, 3).T)
    return ca.vertcat(ca.vec(R.T), t, 1)
