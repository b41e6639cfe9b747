# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bayesian update of an answer with the prior."""

from __future__ import annotations

import numpy as np

from trajectory_calibration.config.prior import FIXED, Prior
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.errors import ConfigError, in_sigmas
from trajectory_calibration.geometry import chi_squared, se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers import DEFAULT_SOLVER

# The update is linear in the rotation up to about this angle, degrees. A rotation axis with a
# larger standard deviation is unobservable: the rotation about it is arbitrary.
_LARGEST_ROTATION_DEG = 15.0


def apply_prior(
    T_a_b: FloatArray, covariance: FloatArray, prior: Prior,
) -> tuple[FloatArray, FloatArray]:
    """Return the answer and its (6, 6) covariance updated with the prior.

    A least-squares problem in six unknowns, iterated because of the rotation (iterated Kalman
    update). About unobservable axes it starts at the prior. Raises ConfigError if the prior
    rotates the answer too far for a linear update.
    """
    if not prior.given:
        return T_a_b, covariance
    known = np.isfinite(prior.std)
    std = np.maximum(prior.std[known], FIXED)
    start = _step_to_prior(T_a_b, covariance, prior)
    T_a_b = se3.moved(T_a_b, start)
    eigenvalues, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(np.maximum(eigenvalues, 0.0))
    step = np.zeros(6)
    for _ in range(20):
        deviation = prior.step_from(se3.moved(T_a_b, step))
        observe = np.eye(6)
        observe[3:, 3:] = _observation(deviation[3:], step[3:])
        observe = observe[known]
        # Scaled by the covariance, with the rows of the prior first: a fixed component has 1e13
        # times the weight of an unobservable direction.
        Q, triangle = np.linalg.qr(np.concatenate([observe @ root / std[:, None], np.eye(6)]))
        # The answer of the motion alone is at -start.
        expected = (deviation[known] + observe @ (step + start)) / std
        following = root @ np.linalg.solve(triangle, Q[:len(std)].T @ expected) - start
        settled = np.abs(following - step).max() < 1e-13
        step = following
        if settled:
            break
    _require_small_rotation(step[3:], covariance, prior)
    half = np.linalg.solve(triangle.T, root.T)
    return se3.moved(T_a_b, step), half.T @ half


def _require_small_rotation(rotation: FloatArray, covariance: FloatArray, prior: Prior) -> None:
    """Raise ConfigError if a (3,) rotation is too large for a linear update."""
    angle = float(np.rad2deg(np.linalg.norm(rotation)))
    if angle <= _LARGEST_ROTATION_DEG:
        return
    axes, _ = _unobserved_axes(covariance)
    what, check = 'prior', (
        'check prior_rotation (roll, pitch, yaw of b in a, degrees), or drive so that the motion '
        'shows the rotation, about two axes')
    # If it is mostly about unobservable axes, the prior contradicts nothing that is known.
    if np.linalg.norm(axes.T @ rotation) > 0.7 * np.linalg.norm(rotation):
        # The translation belongs to a rotation that is arbitrary.
        check = ('mostly about an axis that is unobservable for this solver; use '
                 f'{DEFAULT_SOLVER}, or drive so that the motion shows the rotation, about two '
                 'axes')
        if not np.isfinite(prior.std[3:]).any():
            what = 'prior of the translation'
            check = f'{check}, or give prior_rotation, too'
    raise ConfigError(
        f'the {what} turns the answer of the motion by {angle:.0f} degrees, needed less than '
        f'{_LARGEST_ROTATION_DEG:.0f}; {check}')


def _unobserved_axes(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the (3, K) unobservable rotation axes and their (K,) variances."""
    variances, axes = np.linalg.eigh(covariance[3:, 3:])
    unobserved = variances > np.deg2rad(_LARGEST_ROTATION_DEG)**2
    return axes[:, unobserved], variances[unobserved]


def _step_to_prior(T_a_b: FloatArray, covariance: FloatArray, prior: Prior) -> FloatArray:
    """Return the (6,) step about the unobservable axes that brings an answer closest to the prior.

    The rotation about such an axis may be wrong by any angle, too far for a linear step. The step
    is zero if the rotation would move an observed translation.
    """
    axes, variances = _unobserved_axes(covariance)
    if not (len(variances) and np.isfinite(prior.std[3:]).any()):
        return np.zeros(6)
    along = covariance[:, 3:] @ axes / variances
    step: FloatArray = along @ _angles_to_prior(T_a_b[:3, :3], axes, prior)
    shift = along[:3] * np.sqrt(variances)
    without = covariance[:3, :3] - shift @ shift.T + se3.ROUNDING * np.eye(3)
    if step[:3] @ np.linalg.solve(without, step[:3]) > 1:
        return np.zeros(6)
    return step


def _angles_to_prior(R_a_b: FloatArray, axes: FloatArray, prior: Prior) -> FloatArray:
    """Return (K,) radians about the columns of (3, K) axes that bring a rotation to the prior."""
    known = np.isfinite(prior.std[3:])
    # Normalised: a fixed component has 1e12 times the weight of a degree.
    weight = 1.0 / np.maximum(prior.std[3:][known], FIXED)
    weight = weight / weight.max()

    def deviation(angles: FloatArray) -> FloatArray:
        R = se3.exp_so3(angles @ axes.T) @ R_a_b
        return se3.log_so3(prior.rotation @ np.swapaxes(R, -1, -2))

    def cost(angles: FloatArray) -> FloatArray:
        squares: FloatArray = np.sum((weight * deviation(angles)[..., known])**2, axis=-1)
        return squares

    # About one axis the cost may have several minima; about more, the full rotation is the start.
    starts = (np.linspace(-np.pi, np.pi, 72, endpoint=False)[:, None] if axes.shape[1] == 1
              else (se3.log_so3(prior.rotation @ R_a_b.T) @ axes)[None])
    angles: FloatArray = starts[int(np.argmin(cost(starts)))]
    for _ in range(50):
        off = deviation(angles)
        slope = (_observation(off, axes @ angles) @ axes)[known]
        # A zero slope: the prior does not depend on the angle.
        step = np.linalg.lstsq(weight[:, None] * slope, weight * off[known], rcond=1e-9)[0]
        if cost(angles + step) >= cost(angles):
            break
        angles = angles + step
    return angles


def contradictions(
    T_a_b: FloatArray, covariance: FloatArray, prior: Prior,
) -> tuple[Finding, ...]:
    """Return a finding for each component of the prior that contradicts the motion.

    The combination of two contradicting values is supported by neither.
    """
    found = []
    deviation = prior.step_from(T_a_b)
    for k in np.flatnonzero(np.isfinite(prior.std)):
        both = float(np.sqrt(covariance[k, k] + prior.std[k] ** 2))
        distance = abs(float(deviation[k]))
        if distance**2 > chi_squared.quantile(1) * both**2:
            what = (f'translation {"xyz"[k]} is {distance:.3g} m' if k < 3 else
                    f'rotation about {"xyz"[k - 3]} is {np.rad2deg(distance):.3g} deg')
            found.append(Finding(
                'prior-contradicts',
                f'the prior of the {what} from the answer of the motion, '
                f'{in_sigmas(distance / both)} standard deviations of both. One of '
                'them is wrong, and the result lies between',
                {'component': int(k), 'sigmas': distance / both}))
    return tuple(found)


def _observation(deviation: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return the (3, 3) negative derivative of the deviation from the prior by the rotation."""
    # exp(d) = R_prior R^T exp(-rotation); the right Jacobian is the left one transposed.
    return se3.left_jacobian_so3_inverse(deviation).T @ se3.left_jacobian_so3(rotation)
