# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Rotation first, then translation: ``park`` and ``taylor``.

Both align the rotation vectors of the motions, ``min over R of sum |phi_A - R phi_B|^2``, and then
solve the translation rows by linear least squares:

* C. Park, P. Moghadam, S. Kim, S. Sridharan, C. Fookes, "Spatiotemporal Camera-LiDAR Calibration:
  A Targetless and Structureless Approach", IEEE Robotics and Automation Letters 5(2), 2020,
  doi:10.1109/LRA.2020.2969164, coarse alignment;
* Z. Taylor, J. Nieto, "Motion-based calibration of multimodal sensor arrays", IEEE International
  Conference on Robotics and Automation (ICRA), 2015, pp. 4843-4850,
  doi:10.1109/ICRA.2015.7139872, section III-B.

As replicated in doi:10.3390/s23073740, section III-C. Park's ``R = (M^T M)^(1/2) M^-1`` with
``M = sum phi_B phi_A^T`` is Kabsch's solution, the one of Taylor. The papers differ in what
follows, which needs the sensors' own measurements or their covariances.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.config.prior import Prior
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.errors import counted, MotionError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers import linear, quadratic
from trajectory_calibration.solvers.solution import Solution

# Rotation of a motion (radians) from which its axis is not used. At 180 deg an axis and its
# opposite are the same rotation, and noise decides between them for each sensor separately.
_HALF_TURN = np.deg2rad(170.0)


def solve(motions: MotionPairs, config: CalibrationConfig) -> Solution:
    """Return the extrinsic; its cost is the sum of squared residuals of the translation, m^2.

    Raises MotionError for no motion at all, or too few motions of less than half a turn.
    """
    quadratic.require_motion(motions.pairs)
    motions, inliers, findings = exclude_half_turns(motions)
    R_a_b = align_rotation_vectors(motions, config.prior)
    t, cost = solve_translation(R_a_b, motions, config.prior)
    return Solution(se3.from_rotation_translation(R_a_b, t), cost=cost, iterations=1,
                    inliers=inliers, linearise=linear.separable, findings=findings)


def exclude_half_turns(
    motions: MotionPairs,
) -> tuple[MotionPairs, NDArray[np.bool_] | None, tuple[Finding, ...]]:
    """Exclude motions near 180 deg, whose axis noise may flip, for methods that compare axes.

    Returns the motions, an (M,) mask of them or None for all, and findings. With reference A all
    are kept, as in the published figures: its motions reach 180 deg whenever a vehicle turns
    round. Raises MotionError if fewer than two remain.
    """
    angle = np.maximum(*(se3.rotation_angle(T[:, :3, :3]) for T in (motions.A, motions.B)))
    kept: NDArray[np.bool_] = angle < _HALF_TURN
    if kept.all():
        return motions, None, ()
    count = int(np.count_nonzero(~kept))
    found = (f'{count} of {counted(len(motions), "motion")} turn by more than '
             f'{np.rad2deg(_HALF_TURN):.0f} degrees, where noise flips the axis')
    if len(motions) - count < 2:
        raise MotionError(
            f'{found} that this solver compares; needed 2 that turn less: use another reference, '
            'as auto, or another solver')
    if motions.reference == 'A':
        return motions, None, (Finding(
            'half-turns', f'{found}; they are kept, as published: use a reference B<n>, or '
            'another solver', {'motions': count}),)
    return motions.picked(kept), kept, (
        Finding('half-turns', f'{found}; they are excluded', {'motions': count}),)


def align_rotation_vectors(motions: MotionPairs, prior: Prior) -> FloatArray:
    """Return the (3, 3) rotation R that minimises ``sum |phi_A - R phi_B|^2``.

    Kabsch's algorithm on the rotation vectors of the motions: ``A X = X B`` implies
    ``R_A = R R_B R^T``, hence ``phi_A = R phi_B``. With rotations about fewer than two axes, the
    unobservable part is as near as possible to the prior, or to the identity.
    """
    phi_a, phi_b = se3.log_so3(motions.A[:, :3, :3]), se3.log_so3(motions.B[:, :3, :3])
    covariance = phi_a.T @ phi_b
    singular = np.linalg.svd(covariance, compute_uv=False)
    # Below it all rotations have one axis within rounding.
    regulariser = max(1e-9 * float(singular[0]), quadratic.NO_MOTION**2 * len(motions))
    if singular[1] < regulariser:
        covariance = covariance + regulariser * prior.rotation
    return se3.nearest_rotation(covariance)


def solve_translation(
    R_a_b: FloatArray, motions: MotionPairs, prior: Prior,
) -> tuple[FloatArray, float]:
    """Return the (3,) least-squares t of ``(R_A - I) t = R t_B - t_A`` and its cost, m^2.

    Unobservable directions are as near as possible to the prior, or to zero.
    """
    D = (motions.A[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (motions.B[:, :3, 3] @ R_a_b.T - motions.A[:, :3, 3]).reshape(-1)
    # The normal equations: a 3 x 3 product costs a tenth of an orthogonal factorisation.
    normal, side = D.T @ D, D.T @ right
    hold = quadratic.hold_of(normal, float(np.sum(motions.B[:, :3, 3]**2)))
    t = np.linalg.solve(normal + hold, side + hold @ prior.translation)
    hold = hold + quadratic.hold_implausible(
        normal + hold, float(np.mean((D @ t - right)**2)))
    t = np.linalg.solve(normal + hold, side + hold @ prior.translation)
    return t, float(np.sum((D @ t - right)**2))
