"""How sure the answer is: what the model says, and what the data say about the model.

The model's covariance holds where its noise is the true one. Errors of real SLAM go on for
seconds, which the model takes for independent. The contributions of all poses to the gradient
at the minimum show it: summed over blocks, their scatter has the model's information as its
expectation, or more where neighbours agree (a sandwich estimate over blocks; H. R. Kuensch,
Annals of Statistics 17(3), 1989, doi:10.1214/aos/1176347265). Direction by direction the larger
of the two is reported, and no less than what the lags disagree by (``consistency.py``).

Rotation noise phi of a moves b by the lever arm, ``phi x t``: it is in the residual, and in the
residual's derivative by t. Half the gradient has therefore, at the truth, not the expectation
zero but

    E[G^T P e] = tr(P dV/dt) / 2,

V the covariance of a pose, P the projected inverse covariance, and the answer is off by
``b = -C E[G^T P e]`` on average: a shorter lever arm (errors in variables; W. A. Fuller,
Measurement Error Models, 1987, section 1.1, doi:10.1002/9780470316665). It is not taken out of
the answer, because the data do not tell whose rotation noise it is. The share f of a makes it
``2 f b``: b is that of equal sensors. With every share as likely ``E[(2 f)^2] = 4/3``, and
``4/3 b b^T`` is added to the covariance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.averaging import (
    drift_for_scale,
    Gaussian,
    joined,
    weigh,
)
from trajectory_calibration.solvers.drift_aware.fit import Fit, scale_covariance
from trajectory_calibration.solvers.drift_aware.likelihood import BLOCKS, FREE_VARIANCE
from trajectory_calibration.solvers.drift_aware.model import columns_of, EXTRINSIC
from trajectory_calibration.solvers.drift_aware.noise import UNKNOWN_SHARE
from trajectory_calibration.solvers.drift_aware.selection import RIVALS

# How far the scatter of so few blocks may exceed its expectation before it counts in full. The
# largest eigenvalue of m parameters over n blocks is near (1 + sqrt(m / (n - 1)))^2; it stays
# below this many times that in 99 of 100 data sets whose noise is the model's (m from 6 to 11).
# From that expectation on it counts by degrees: no answer hangs on a limit.
_SIGNIFICANT = 1.25


def parameter_covariance(fit: Fit) -> FloatArray:
    """Return the (m, m) covariance of the estimated global parameters, right perturbations."""
    return _likelihood(fit, fit.terms).covariance


def extrinsic_covariance(fit: Fit, optional: Sequence[str]) -> FloatArray:
    """Return the (6, 6) covariance of the extrinsic, whichever terms the data should have.

    It is about the answer of the fit and counts the ``optional`` terms that were left out, or
    taken in, by their probability; see ``averaging.py``.
    """
    time_offset = 'time_offset' if 'time_offset' in optional else None
    sure = [name for name in fit.terms if name not in optional]
    if 'systematic_drift' in fit.terms:
        # An error of scale was judged the worse explanation.
        optional = [name for name in optional if name != 'scale']
    found = {
        name: weigh(
            _likelihood(fit, [*sure, *filter(None, (name, time_offset))]), fit.state,
            name, time_offset,
            drift_for_scale(fit.chain.step_translation, fit.state.scale)
            if name == 'systematic_drift' and 'scale' in optional else 0.0)
        for name in RIVALS if name in optional}
    if len(found) == 2:
        return joined(*found.values()).mean()
    if found:
        return found.popitem()[1].mean()
    if time_offset:
        return weigh(
            _likelihood(fit, [*sure, time_offset]), fit.state, None, time_offset).mean()
    return parameter_covariance(fit)[EXTRINSIC, EXTRINSIC]


def _likelihood(fit: Fit, terms: Sequence[str]) -> Gaussian:
    columns = columns_of(terms)
    step, covariance = fit.likelihood.estimate(columns)
    model = scale_covariance(
        covariance, fit.evaluation.position_traces, columns, fit.state.scale)
    if len(fit.chain) < 2 * BLOCKS:
        widened = fit.lags.excess * model
    else:
        widened = _widened(model, fit.likelihood.gradients(columns, step), fit.lags.excess)
    bias = lever_arm_bias(fit, covariance)
    return Gaussian(columns, step, widened + UNKNOWN_SHARE * np.outer(bias, bias))


def lever_arm_bias(fit: Fit, covariance: FloatArray) -> FloatArray:
    """Return the (m,) bias by rotation noise that is equal in both sensors.

    ``covariance`` is the (m, m) of the parameters, right perturbations; directions without
    information do not move.
    """
    slopes = fit.noise.white_slopes(fit.state.T_a_b)
    gradient = 0.5 * np.tensordot(slopes, fit.evaluation.white_projected, 2)
    _, root = _split(covariance)
    return -root @ (root[:3].T @ gradient)


def _split(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (m, k) roots of a covariance over directions without information, and the rest."""
    eigenvalues, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(np.maximum(eigenvalues, 0.0))
    free = eigenvalues > 0.5 * FREE_VARIANCE
    return root[:, free], root[:, ~free]


def _widened(model: FloatArray, gradients: FloatArray, excess: float) -> FloatArray:
    """Return the (m, m) covariance, larger where the (BLOCKS, m) gradients ask for it.

    It is at least ``excess`` times as large.
    """
    # The gradient along a direction without information is rounding: no scatter to learn from.
    open_root, root = _split(model)
    sums = gradients @ root
    sums -= sums.mean(axis=0)
    inflation, directions = np.linalg.eigh(sums.T @ sums * BLOCKS / (BLOCKS - 1))
    expected = (1 + np.sqrt(len(inflation) / (BLOCKS - 1)))**2
    counted = np.clip((inflation / expected - 1) / (_SIGNIFICANT - 1), 0.0, 1.0)
    inflation = np.maximum(1 + counted * (inflation - 1), excess)
    spread = root @ directions
    covariance: FloatArray = (spread * inflation) @ spread.T + open_root @ open_root.T
    return covariance


def in_parent_axes(covariance: FloatArray, T_a_b: FloatArray) -> FloatArray:
    """Turn a (6, 6) covariance of ``t + R rho``, ``R exp(phi)`` into that of the result.

    The result's is ``t + dt``, ``exp(dtheta) R`` along the fixed axes of a: ``dt = R rho`` and
    ``dtheta = R phi``.
    """
    turn = np.kron(np.eye(2), T_a_b[:3, :3])
    result: FloatArray = turn @ covariance @ turn.T
    return 0.5 * (result + result.T)
