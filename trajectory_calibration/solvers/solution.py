# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The contract of a solver: its equations, its solution, the noise it identifies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.geometry.se3 import FloatArray

# Standard deviations of an unobservable direction, metres and radians: an upper bound for sensors
# of one vehicle. A larger value would leak into other directions, because noise tilts the axes.
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
    """The linearised equations of a solver, for covariances."""

    def __call__(self, T_a_b: FloatArray, A: FloatArray, C: FloatArray) -> Equations:
        """Linearise at ``T_a_b`` the motions A and ``C = X B X^-1``, both (M, 4, 4), in a."""
        ...


@dataclass(frozen=True)
class Jump:
    """A step, ending at a stamp, in which one trajectory jumps: loop closure or lost track."""

    stamp_ns: int
    translation_m: float
    rotation_rad: float


@dataclass(frozen=True)
class Diagnosis:
    """The noise of two trajectories; both sensors are assumed to be equally noisy.

    Attributes
    ----------
    white_m, white_rad : standard deviation of the white noise of a pose, for each sensor.
    walk_m, walk_rad : standard deviation of the relative drift after 1 m; it grows with the square
        root of the distance.
    apart : by lag (seconds), the standard deviations of the difference of the motions of both
        sensors along and about an axis, metres and radians, tails included.
    jumps : the steps with jumps, the largest first.
    scale, scale_deviation : metres of a per metre of b. A standard deviation is None if the value
        was fixed; likewise below.
    time_offset_s, time_offset_deviation_s : added to the stamps of b, on top of the setting.
    systematic_drift, systematic_drift_deviation : metres per metre along x, y, z of b.
    latency_s, latency_deviation_s : delay of the position of b relative to its orientation;
        negative for a delay of the position of a.
    saturation : rho, the correlation of short-term noise with the motion.

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
    """An extrinsic and its properties.

    Attributes
    ----------
    T_a_b : (4, 4), the pose of sensor b in sensor a.
    cost : the solver's own cost at the answer, in the units of its module's formula.
    iterations : iterations of the method, all starts together.
    inliers : (M,) bool, motions that are not outliers; None if the solver rejects none.
    covariance : (6, 6) or None; order and side as in ``CalibrationResult``.
    linearise : the estimating equations, for the covariance if the solver has none of its own.
    optimality_gap : upper bound of the relative decrease of the cost at any other extrinsic; 0
        proves the global minimum, None without a certificate.
    findings : on the data and the answer.
    scale : estimated metres of a per metre of b; 1 if not estimated.
    time_offset_s : seconds to add to the stamps of b, on top of those of the association.
    diagnosis : noise of the two trajectories; None if the solver does not identify it.

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

    It needs no initial guess and does not change its input. It always returns an answer:
    unobservable directions are as near as possible to the prior, or to zero, and have a large
    covariance. It raises ``MotionError`` only for input without motion, and ``SolverError`` if its
    method fails.
    """

    def __call__(self, motions: MotionPairs, config: CalibrationConfig) -> Solution:
        """Return the extrinsic that the motions determine."""
        ...
