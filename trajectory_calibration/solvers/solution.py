# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a solver returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.geometry.se3 import FloatArray

# Standard deviations of an unobserved direction, metres and radians: no two sensors of one vehicle
# are farther apart. More would let that direction, which noise tilts, spill into others.
UNOBSERVED_STD = np.array([10.0] * 3 + [np.pi] * 3)


@dataclass(frozen=True, eq=False)
class Equations:
    """The estimating equations ``sum Z^T r = 0`` of a solver, to first order about an extrinsic.

    One entry for each motion. The parameters are (t, theta), ``t + dt`` and ``exp(theta) R``.

    Attributes
    ----------
    residual : (M, 6), r: three of the rotation, three of the translation.
    jacobian : (M, 6, 6), derivative of r in the parameters.
    instrument : (M, 6, 6), Z: the jacobian for least squares, part of it for methods in stages.

    """

    residual: FloatArray
    jacobian: FloatArray
    instrument: FloatArray


class Linearise(Protocol):
    """How a solver tells its equations, for covariances."""

    def __call__(self, T_a_b: FloatArray, A: FloatArray, C: FloatArray) -> Equations:
        """Linearise at ``T_a_b`` the motions A and ``C = X B X^-1``, both (M, 4, 4), in a."""
        ...


@dataclass(frozen=True)
class Jump:
    """A step, up to a stamp, in which the two trajectories part: loop closure or lost track."""

    stamp_ns: int
    translation_m: float
    rotation_rad: float


@dataclass(frozen=True)
class Diagnosis:
    """The noise of a pair of trajectories, both sensors taken as equally noisy.

    Attributes
    ----------
    white_m, white_rad : standard deviation of the white noise of a pose, for each sensor.
    walk_m, walk_rad : of what both drift apart in a metre; it grows with the root of the way.
    apart : by time scale, seconds, the standard deviation of what the motions of the two differ
        by along and about an axis, metres and radians, tails included.
    jumps : steps in which the trajectories part, the largest first.
    scale, scale_deviation : metres of a per metre of b; the deviation is None where the scale
        was fixed. Likewise the following.
    time_offset_s, time_offset_deviation_s : added to the stamps of b, on top of the setting.
    systematic_drift, systematic_drift_deviation : metres per metre along x, y, z of b.
    latency_s, latency_deviation_s : by which the position of b is older than its attitude; below
        zero where that of a is.
    saturation : rho, the correlation of the noise at short times with the motion.

    """

    white_m: float
    white_rad: float
    walk_m: float
    walk_rad: float
    apart: tuple[tuple[float, float, float], ...]
    jumps: tuple[Jump, ...]
    scale: float
    scale_deviation: float | None
    time_offset_s: float
    time_offset_deviation_s: float | None
    systematic_drift: tuple[float, ...]
    systematic_drift_deviation: tuple[float, ...] | None
    latency_s: float
    latency_deviation_s: float
    saturation: float


@dataclass(frozen=True, eq=False)
class Solution:
    """An extrinsic and how it was found.

    Attributes
    ----------
    T_a_b : (4, 4), the pose of sensor b in sensor a.
    cost : the solver's own cost at the answer, in the units of its module's formula.
    iterations : steps of the method, over all of its starts where they go side by side.
    inliers : (M,) bool, the motions that the solver kept, or None where it rejects none.
    covariance : (6, 6) or None; order and side as in ``CalibrationResult``.
    linearise : its estimating equations, from which the covariance follows where a solver has
        none of its own; None where they do not apply.
    optimality_gap : upper bound of how much lower the cost could be elsewhere, as a share of it;
        0 is a proof of the global minimum, None where the solver gives no certificate.
    findings : what a person should know of the data and the answer.
    scale : metres of a per metre of b that the solver found, 1 where it does not look for it.
    time_offset_s : seconds to add to the stamps of b, on top of what the association added.
    diagnosis : the noise of the two trajectories, or None where the solver does not identify it.

    """

    T_a_b: FloatArray
    cost: float
    iterations: int
    inliers: NDArray[np.bool_] | None = None
    covariance: FloatArray | None = None
    linearise: Linearise | None = None
    optimality_gap: float | None = None
    findings: tuple[Finding, ...] = ()
    scale: float = 1.0
    time_offset_s: float = 0.0
    diagnosis: Diagnosis | None = None


class Solver(Protocol):
    """A function from relative motions to an extrinsic.

    It needs no initial guess and leaves its input untouched. It always returns an answer: what
    the motion does not determine is as near as possible to the prior, or to zero, and its
    covariance says so. It raises ``MotionError`` only where nothing moved, and ``SolverError``
    where its method fails.
    """

    def __call__(self, motions: MotionPairs, config: CalibrationConfig) -> Solution:
        """Return the extrinsic that the motions determine."""
        ...
