# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""DNLO: direct nonlinear least squares with outlier rejection, the paper's second solver.

T. Valimaki, B. Garigipati, R. Ghabcheloo, "Motion-Based Extrinsic Sensor-to-Sensor Calibration:
Effect of Reference Frame Selection for New and Existing Methods", Sensors 23(7):3740, 2023,
doi:10.3390/s23073740, section III-B:

    min over (theta, t, alpha) of  sum alpha |M|^2 + (1 - alpha) c,
    0 <= alpha <= 1,   sum alpha >= d M.

The cost has many minima. There are three minimisers:

* ``ipopt``: extrinsic and weights in one nonlinear program, as in the paper, from the paper's
  start and to the paper's tolerance; it repeats the published figures.
* ``path``: the same central path with the weights eliminated in closed form, many times faster
  for many motions, then weights and extrinsic alternate.
* ``alternating``: weights and extrinsic alternate, starting from parts of the drive.

``auto`` uses ``ipopt`` for few motions and ``path`` for many, then alternates until every weight
is at its bound. It prefers ``alternating`` only if its cost is clearly lower: minima that differ
by a few percent are the roughness of the trimmed cost, and the smooth path is then usually closer
to the truth (docs/solvers.md has the figures).
"""

from __future__ import annotations

from functools import lru_cache, partial
from typing import Any

import numpy as np

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.errors import counted, MotionError, require
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers import linear, quadratic
from trajectory_calibration.solvers.dnl import QUIET, run_ipopt, symbolic_monomials
from trajectory_calibration.solvers.least_trimmed_squares import Candidates, TrimmedCost
from trajectory_calibration.solvers.solution import Solution

# The paper's start: rotation vector, translation and all weights. The authors' rotation matrix
# is the transpose of the usual one, hence the signs.
_PAPER_START = np.array([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0])


def solve(motions: MotionPairs, config: CalibrationConfig) -> Solution:
    """Return the extrinsic and the motions it keeps (cost: rotation entries squared + m^2).

    Raises MotionError for no motion at all, or fewer than two that are kept; SolverError where
    Ipopt stopped before a minimum.
    """
    quadratic.require_motion(motions.pairs)
    cost = TrimmedCost.of(motions, config.dnlo_c, config.dnlo_min_inliers, config.prior)
    best, steps = _minimise(cost, config.dnlo_method)
    weights = best.weights[0]
    inliers = weights > 0.5
    kept = int(np.count_nonzero(inliers))
    # With one motion the axis of its rotation is unobserved.
    if kept < 2:
        raise MotionError(
            f'the solver keeps {kept} of {counted(len(motions), "motion")}, needed at least '
            f'2: the other squared residuals are above dnlo_c, {cost.c:g}. '
            'Raise dnlo_c or dnlo_min_inliers')
    return Solution(
        quadratic.polish(best.T_a_b[0], motions, weights), float(best.cost[0]), steps,
        inliers=inliers, linearise=linear.frobenius)


def _minimise(cost: TrimmedCost, method: str) -> tuple[Candidates, int]:
    """Minimise by one method, or for ``auto`` by that for the number of motions."""
    motions = cost.features.shape[1]
    if method == 'alternating':
        return cost.alternate(_starts(cost))
    if method == 'ipopt':
        return _minimise_with_ipopt(cost)
    # So few take the nonlinear program less than about a tenth of a second.
    if method == 'auto' and motions <= 500:
        joint, steps = _minimise_with_ipopt(cost)
        start = joint.T_a_b
    else:
        start, steps = cost.follow_central_path(cost.minimum(np.ones((1, motions))))
    best, more = cost.alternate(start)
    if method == 'auto':
        # Few motions and 1e-5 rad are enough to see where to search.
        few = cost.thinned(400)
        best = _clearly_lower(best, cost, few.alternate(_starts(few), 1e-5)[0])
    return best, steps + more


def _clearly_lower(best: Candidates, cost: TrimmedCost, other: Candidates) -> Candidates:
    """Return the minimum next to ``other`` if its cost is clearly lower, else ``best``."""
    # Without noise both are rounding errors, and their ratio says nothing.
    limit = 0.95 * float(best.cost[0]) - 1e-12
    if cost.weigh(other.T_a_b).cost[0] >= best.cost[0]:
        return best
    other = cost.alternate(other.T_a_b)[0]
    return other if other.cost[0] < limit else best


def _starts(cost: TrimmedCost) -> FloatArray:
    """Return (S, 4, 4) extrinsics: of all motions, and of consecutive quarters of the drive."""
    motions = cost.features.shape[1]
    parts = max(1, min(4, motions // 2))
    weights = np.zeros((parts + 1, motions))
    weights[0] = 1.0
    for row, part in zip(weights[1:], np.array_split(np.arange(motions), parts), strict=True):
        row[part] = 1.0
    return cost.minimum(weights)


def _minimise_with_ipopt(cost: TrimmedCost) -> tuple[Candidates, int]:
    """Minimise over extrinsic and weights together; return them and the iterations."""
    motions = cost.features.shape[1]
    x, value, iterations = run_ipopt(
        partial(_program, motions), 'set dnlo_method to path',
        x0=np.concatenate([_PAPER_START, np.ones(motions)]),
        p=np.append(cost.features.ravel(), cost.c),
        lbx=np.concatenate([np.full(6, -np.inf), np.zeros(motions)]),
        ubx=np.concatenate([np.full(6, np.inf), np.ones(motions)]),
        lbg=cost.least, ubg=np.inf)
    T_a_b = se3.from_rotation_translation(se3.exp_so3(x[:3]), x[3:6])
    # Ipopt may leave a bound by its relaxation, 1e-8.
    weights = np.clip(x[None, 6:], 0.0, 1.0)
    return Candidates(T_a_b[None], weights, np.array([value + motions * cost.c])), iterations


@lru_cache(maxsize=8)
def _program(motions: int) -> Any:
    """Build the program for that many motions; their features and c are its parameters."""
    # Loaded here because it takes a third of a second, and as Any because its own annotations
    # refuse its own expressions.
    ca: Any = require('casadi')
    theta, t = ca.SX.sym('theta', 3), ca.SX.sym('t', 3)
    v = symbolic_monomials(ca, theta, t, ca.SX(np.eye(3).ravel()))
    products = ca.vertcat(*(v[int(i)] * v[int(j)] for i, j in zip(*quadratic.UPPER, strict=True)))
    phi = ca.Function('phi', [theta, t], [products])
    x = ca.MX.sym('x', 6 + motions)
    p = ca.MX.sym('p', 91 * motions + 1)
    alpha = x[6:]
    squares = ca.mtimes(ca.reshape(p[:-1], motions, 91), phi(x[:3], x[3:6]))
    # The constant M c is left out, as in the authors' program: Ipopt's scaling sees the rest. Its
    # tolerances are its own, as there.
    cost = ca.dot(alpha, squares) - p[-1] * ca.sum1(alpha)
    return ca.nlpsol(
        'dnlo', 'ipopt', {'x': x, 'p': p, 'f': cost, 'g': ca.sum1(alpha)}, QUIET)
