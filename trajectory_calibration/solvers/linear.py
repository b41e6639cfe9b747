# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""First derivatives of the solvers' residuals, motion by motion, in the axes of sensor a.

With ``C = X B X^-1``, the motion of b expressed in sensor a, every solver compares A with C, and
its equations can be written in the axes of sensor a. Near the answer the six residuals here have
the same sum of squares, to second order, as the twelve entries of ``A X - X B``. The estimating
equations are therefore the same, at a fraction of the cost.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.solution import Equations

ROTATION, TRANSLATION = slice(0, 3), slice(3, 6)
_IDENTITY = np.eye(3)


def gram(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return (n, m) ``sum left^T right`` of (M, 6, n) and (M, 6, m), over all equations."""
    product: FloatArray = left.reshape(-1, left.shape[2]).T @ right.reshape(-1, right.shape[2])
    return product


def frobenius(T_a_b: FloatArray, A: FloatArray, C: FloatArray) -> Equations:
    """Return the equations of ``sum |A X - X B|^2``.

    The nine rotation entries of a residual rotation of angle w have the norm
    ``sqrt(8) sin(w / 2)``, which is sqrt(2) times the length of its rotation vector.
    """
    equations = translation_only(T_a_b, A, C)
    R_At = np.swapaxes(A[:, :3, :3], 1, 2)
    root = np.sqrt(2.0)
    equations.residual[:, ROTATION] = root * se3.log_so3(R_At @ C[:, :3, :3])
    equations.jacobian[:, ROTATION, 3:] = root * (R_At - _IDENTITY)
    return equations


def translation_only(T_a_b: FloatArray, A: FloatArray, C: FloatArray) -> Equations:
    """Return the equations of ``sum |R_A t + t_A - R t_B - t|^2``; the rotation rows are zero."""
    t = T_a_b[:3, 3]
    D = A[:, :3, :3] - _IDENTITY
    # R t_B, the translation of b in the axes of a.
    Rt_b = C[:, :3, 3] - t + C[:, :3, :3] @ t
    residual, jacobian = np.zeros((len(A), 6)), np.zeros((len(A), 6, 6))
    residual[:, TRANSLATION] = D @ t + A[:, :3, 3] - Rt_b
    jacobian[:, TRANSLATION, :3] = D
    jacobian[:, TRANSLATION, 3:] = se3.skew(Rt_b)
    return Equations(residual, jacobian, jacobian)


def separable(T_a_b: FloatArray, A: FloatArray, C: FloatArray) -> Equations:
    """Return the equations of ``sum |phi_A - R phi_B|^2``, then of the translation for that R."""
    equations = translation_only(T_a_b, A, C)
    phi = se3.log_so3(C[:, :3, :3])
    equations.residual[:, ROTATION] = se3.log_so3(A[:, :3, :3]) - phi
    equations.jacobian[:, ROTATION, 3:] = se3.skew(phi)
    # The rotation is estimated first: the translation rows do not affect it.
    instrument = equations.jacobian.copy()
    instrument[:, TRANSLATION, 3:] = 0.0
    return replace(equations, instrument=instrument)
