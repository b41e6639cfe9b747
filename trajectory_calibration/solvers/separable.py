"""Rotation first, then translation: what the separable solvers share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.errors import MotionError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers import linear, quadratic
from trajectory_calibration.solvers.solution import Solution

# The second largest singular value of the aligned rotation vectors, relative to the largest,
# below which all rotations share one axis but for rounding.
_SINGLE_AXIS = 1e-9

# Rotation of a motion from which its axis is not trusted (radians). At half a turn the axis and
# its opposite are the same rotation, and noise chooses between them for each sensor by itself.
_HALF_TURN = np.deg2rad(170.0)


def solve_separable(
    motions: MotionPairs, config: CalibrationConfig | None = None,
) -> Solution:
    """Align the rotation vectors, then solve for the translation.

    The cost of the solution is the sum of squared residuals of the translation, m^2.

    Raises
    ------
    MotionError
        As ``align_rotation_vectors``, or too few motions of less than half a turn.

    """
    config = config or CalibrationConfig()
    motions, inliers, findings = leave_out_half_turns(motions)
    R_a_b = align_rotation_vectors(motions, config)
    t, cost = solve_translation(R_a_b, motions, config)
    return Solution(se3.from_rotation_translation(R_a_b, t), cost=cost, iterations=1,
                    inliers=inliers, linearise=linear.separable, findings=findings)


def leave_out_half_turns(
    motions: MotionPairs,
) -> tuple[MotionPairs, NDArray[np.bool_] | None, tuple[Finding, ...]]:
    """Leave out the motions whose axis noise may flip, for methods that compare the axes.

    Returns the motions to use, which of the given ones they are, (M,), or None for all, and
    findings. With reference A all are kept, as in the published figures: its motions wind up to
    half a turn wherever a vehicle turns round.

    Raises
    ------
    MotionError
        Fewer than two motions remain.

    """
    angle = np.maximum(*(se3.rotation_angle(T[:, :3, :3]) for T in (motions.A, motions.B)))
    kept: NDArray[np.bool_] = angle < _HALF_TURN
    if kept.all():
        return motions, None, ()
    count, limit = int(np.count_nonzero(~kept)), f'{np.rad2deg(_HALF_TURN):.0f} degrees'
    if len(motions) - count < 2:
        raise MotionError(
            f'{count} of {len(motions)} motions turn by more than {limit}, where noise flips the '
            'axis that this solver compares; needed 2 that turn less: use another reference, as '
            'auto, or solver dnl')
    found = (f'{count} of {len(motions)} motions turn by more than {limit}, where noise flips the '
             'axis')
    if motions.reference == 'A':
        return motions, None, (Finding(
            'half-turns', f'{found}; they are kept, as published: use a reference B<n>, or solver '
            'dnl', {'motions': count}),)
    return motions.picked(kept), kept, (
        Finding('half-turns', f'{found}; they are excluded', {'motions': count}),)


def align_rotation_vectors(motions: MotionPairs, config: CalibrationConfig) -> FloatArray:
    """Return the (3, 3) rotation R that minimises ``sum |phi_A - R phi_B|^2``.

    Kabsch's algorithm on the rotation vectors of the motions: ``A X = X B`` implies
    ``R_A = R R_B R^T``, hence ``phi_A = R phi_B``.

    Raises
    ------
    MotionError
        The sensors did not turn, or turned about one axis only, and no prior of the rotation
        nor ``allow_unobserved`` says what the rest should be.

    """
    phi_a, phi_b = se3.log_so3(motions.A[:, :3, :3]), se3.log_so3(motions.B[:, :3, :3])
    covariance = phi_a.T @ phi_b
    U, singular, _ = np.linalg.svd(covariance)
    if quadratic.holds_rotation(config):
        # A nudge: it decides what the rotations leave open and nothing else.
        nudge = max(float(singular[0]), np.finfo(float).tiny) * _SINGLE_AXIS
        covariance = covariance + nudge * config.prior.rotation
    else:
        _require_two_axes(singular, U, len(motions))
    return se3.nearest_rotation(covariance)


def solve_translation(
    R_a_b: FloatArray, motions: MotionPairs, config: CalibrationConfig,
) -> tuple[FloatArray, float]:
    """Return the (3,) least-squares t of ``(R_A - I) t = R t_B - t_A`` and its cost, m^2."""
    D = (motions.A[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (motions.B[:, :3, 3] @ R_a_b.T - motions.A[:, :3, 3]).reshape(-1)
    # The normal equations: D is well conditioned wherever the rotation was accepted, and a
    # 3 x 3 product costs a tenth of an orthogonal factorisation of all rows.
    turns = D.T @ D
    held = quadratic.hold_translation(turns, len(motions), config)
    t = np.linalg.solve(turns + held[:3, :3], D.T @ right - held[:3, 3])
    return t, float(np.sum((D @ t - right) ** 2))


def _require_two_axes(singular: FloatArray, axes: FloatArray, motions: int) -> None:
    largest_angle = np.sqrt(singular[0] / motions)
    if largest_angle < 1e-9:
        raise MotionError(
            f'the sensors did not turn (root mean square {largest_angle:.1g} rad over {motions} '
            'motions); needed rotation about two axes: drive curves and a ramp or a bank')
    if singular[1] < _SINGLE_AXIS * singular[0]:
        x, y, z = axes[:, 0]
        raise MotionError(
            f'all rotations share one axis ({x:.2f}, {y:.2f}, {z:.2f} in a); needed rotation '
            'about two axes: drive a ramp or a bank too, or use a joint solver (dnl) with a '
            'known translation along that axis')
