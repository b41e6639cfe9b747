# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The initial guess: robust extrinsics over several lags, and the unit of length of b.

Each start aligns the rotation vectors of motions over one lag (G. Wahba, SIAM Review 7(3), 1965,
doi:10.1137/1007077) and is refined on the motions of that lag, rotation and translation jointly.
If all rotations share an axis, four angles about it are tried. The start with the smallest median
residuals over all lags wins, which is robust to jumps and outliers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray, from_rotation_translation, skew
from trajectory_calibration.solvers.drift_aware.algebra import (
    apply,
    exp,
    lengths,
    log,
    median,
    ROTATION,
    TRANSLATION,
    transposed,
)
from trajectory_calibration.solvers.drift_aware.drive import Drive, State

_REWEIGHTINGS = 6


def start(drive: Drive, *, unit_is_known: bool) -> tuple[State, float]:
    """Return the initial state, and the metres of a per unit of b (1 if they have one unit).

    The ratio of the position spreads suggests the unit. It is accepted only if the motions fit far
    better, because a sensor on a long arm also has a larger spread.
    """
    best, cost = _best(drive)
    unit = 1.0 if unit_is_known else _ratio_of_spreads(drive)
    # By less it may be drift.
    if abs(np.log(unit)) > 0.3:
        other, its_cost = _best(drive.scaled(unit))
        if its_cost < cost + np.log(0.25):
            return other, unit
    return best, 1.0


def _ratio_of_spreads(drive: Drive) -> float:
    of_a, of_b = (float(np.sqrt(((p - p.mean(axis=0))**2).sum())) for p in (drive.p_a, drive.p_b))
    return of_a / of_b if min(of_a, of_b) > 1e-9 else 1.0


@dataclass(frozen=True, eq=False)
class _Motions:
    """Relative motions over one lag, (M, 3, 3) and (M, 3), of a and of b in their own axes."""

    R_a: FloatArray
    t_a: FloatArray
    R_b: FloatArray
    t_b: FloatArray

    @cached_property
    def typical(self) -> tuple[float, float]:
        """Return the median translation and rotation of a."""
        return median(lengths(self.t_a)), median(lengths(log(self.R_a)))

    def residuals(self, T_a_b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the (M, 6) residuals, and rotations and translations of a carried to b."""
        R, t = T_a_b[:3, :3], T_a_b[:3, 3]
        R_ab = R.T @ self.R_a @ R
        t_ab = (self.R_a @ t + self.t_a - t) @ R
        e = np.empty((len(t_ab), 6))
        e[:, TRANSLATION], e[:, ROTATION] = self.t_b - t_ab, log(transposed(R_ab) @ self.R_b)
        return e, R_ab, t_ab


def _motions(drive: Drive, lag: int) -> _Motions:
    i = np.arange(len(drive) - lag)
    i = i[::max(1, len(i) // 200)]
    j = i + lag
    back_a, back_b = transposed(drive.R_a[i]), transposed(drive.R_b[i])
    return _Motions(back_a @ drive.R_a[j], apply(back_a, drive.p_a[j] - drive.p_a[i]),
                    back_b @ drive.R_b[j], apply(back_b, drive.p_b[j] - drive.p_b[i]))


def _best(drive: Drive) -> tuple[State, float]:
    """Return the best start, and the logarithm of its median residuals."""
    lags = sorted({_poses(drive, seconds) for seconds in (0.0, 1.0, 2.0, 4.0)})
    motions = [_motions(drive, lag) for lag in lags]
    size = float(np.linalg.norm(drive.p_a, axis=1).max()) + 1e-9
    found = [_candidate(one) for one in motions]
    costs = [np.mean([_misfit(T, one, size) for one in motions]) for T in found]
    best = int(np.argmin(costs))
    return State(found[best], np.zeros(6)), float(costs[best])


def _poses(drive: Drive, seconds: float) -> int:
    return int(np.clip(round(seconds / drive.step_s), 1, max(1, len(drive) // 4)))


def _misfit(T_a_b: FloatArray, motions: _Motions, size: float) -> float:
    """Return the log of the product of both median residuals."""
    e, _, _ = motions.residuals(T_a_b)
    return float(np.log(median(lengths(e[:, TRANSLATION])) + 1e-9 * size)
                 + np.log(median(lengths(e[:, ROTATION])) + 1e-9))


def _candidate(motions: _Motions) -> FloatArray:
    """Return an extrinsic from the motions of one lag."""
    of_a, of_b = log(motions.R_a), log(motions.R_b)
    w = np.ones(len(of_a))
    for _ in range(_REWEIGHTINGS):
        U, values, Vt = np.linalg.svd((w[:, None] * of_a).T @ of_b)
        R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
        w = _cauchy_weights(lengths(of_a - of_b @ R.T))
    begun = [from_rotation_translation(R, np.zeros(3))]
    # The second singular value tells whether the rotations share an axis.
    if values[1] < 0.05 * values[0]:
        # The translations determine the angle about the axis: four starts.
        turns = exp(0.5 * np.pi * np.arange(4)[:, None] * U[:, 0])
        begun = [from_rotation_translation(turn @ R, np.zeros(3)) for turn in turns]
    begun = [_refined(T, motions, 1) for T in begun]
    best = min(begun, key=lambda T: _misfit(T, motions, 1.0))
    return _refined(best, motions, _REWEIGHTINGS)


def _cauchy_weights(sizes: FloatArray) -> FloatArray:
    """Return the Cauchy weights of residuals by their median."""
    return 1 / (1 + (sizes / (median(sizes) + 1e-12))**2)


def _refined(T_a_b: FloatArray, motions: _Motions, rounds: int) -> FloatArray:
    """Refine an extrinsic by robust Gauss-Newton."""
    state = State(T_a_b, np.zeros(6))
    for _ in range(rounds):
        e, R_ab, t_ab = motions.residuals(state.T_a_b)
        J = np.zeros((len(e), 6, 6))
        J[:, TRANSLATION, TRANSLATION] = np.eye(3) - R_ab
        J[:, TRANSLATION, ROTATION] = -skew(t_ab)
        J[:, ROTATION, ROTATION] = transposed(R_ab) - np.eye(3)
        if rounds == 1:
            # The lever arm first, because the rotation is already good.
            J[:, :, ROTATION] = 0.0
        root = []
        for part, typical in zip((TRANSLATION, ROTATION), motions.typical, strict=True):
            size = lengths(e[:, part])
            # Bounded, because without noise in one of both the other would be lost to rounding.
            root.append(np.sqrt(_cauchy_weights(size)) / (median(size) + 1e-4 * typical + 1e-9))
        rows = np.repeat(np.stack(root, axis=1), 3, axis=1).reshape(-1)
        A = J.reshape(-1, 6) * rows[:, None]
        normal = A.T @ A
        step = np.zeros(12)
        step[:6] = -np.linalg.lstsq(
            normal + 1e-9 * np.diag(np.diag(normal)), A.T @ (e.reshape(-1) * rows),
            rcond=1e-12)[0]
        step *= min(1.0, 0.5 / max(float(np.linalg.norm(step[ROTATION])), 1e-300))
        state = state.moved(step)
    return state.T_a_b
