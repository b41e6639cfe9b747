"""How sure the answer is: what the model says, and what the data say about the model.

The model's covariance holds where its noise is the true one. Errors of real SLAM go on for
seconds, which the model takes for independent. The contributions of all poses to the gradient
at the minimum show it: summed over blocks, their scatter has the model's information as its
expectation, or more where neighbours agree (a sandwich estimate over blocks; H. R. Kuensch,
Annals of Statistics 17(3), 1989, doi:10.1214/aos/1176347265). Direction by direction the larger
of the two is reported.
"""

from __future__ import annotations

import numpy as np

from trajectory_calibration.se3 import FloatArray
from trajectory_calibration.solvers.drift.fit import columns_of, Fit, scale_covariance
from trajectory_calibration.solvers.drift.likelihood import predict_step
from trajectory_calibration.solvers.drift.model import EXTRINSIC, TERM_COLUMNS

# Blocks of consecutive poses, and how far the scatter of so few may exceed its expectation
# before it counts: the largest eigenvalue of six parameters over twenty blocks stays below this
# in nineteen of twenty data sets whose noise is the model's.
BLOCKS = 20
_SIGNIFICANT = 3.0


def parameter_covariance(fit: Fit) -> FloatArray:
    """Return the (m, m) covariance of the estimated global parameters, right perturbations."""
    columns = columns_of(fit.terms)
    evaluation = fit.evaluation
    model = scale_covariance(evaluation.covariance, evaluation, columns, fit.state.scale)
    if len(fit.chain) < 2 * BLOCKS:
        return model
    eigenvalues, axes = np.linalg.eigh(model)
    root = axes * np.sqrt(np.maximum(eigenvalues, 0.0))
    whitened = evaluation.contributions @ root
    sums = np.stack([block.sum(axis=0) for block in np.array_split(whitened, BLOCKS)])
    sums -= sums.mean(axis=0)
    inflation, directions = np.linalg.eigh(sums.T @ sums * BLOCKS / (BLOCKS - 1))
    inflation = np.where(inflation > _SIGNIFICANT, inflation, 1.0)
    spread = root @ directions
    covariance: FloatArray = (spread * inflation) @ spread.T
    return covariance


def extrinsic_covariance(fit: Fit, covariance: FloatArray) -> FloatArray:
    """Return the (6, 6) covariance of the extrinsic, from that of all parameters.

    Where the data prove an error of scale, a drift along the motion, one across it is as likely
    and cannot be told from a turned sensor: b is then given a drift of that size in unknown
    direction, and both the freedom it gives the extrinsic and the change that the data suggest
    for it are counted as possible error.
    """
    found = covariance[EXTRINSIC, EXTRINSIC]
    if 'scale' not in fit.terms or 'systematic_drift' in fit.terms:
        return found
    columns = columns_of([*(term for term in fit.terms if term != 'scale'), 'systematic_drift'])
    drift = TERM_COLUMNS['systematic_drift']
    place = np.flatnonzero((columns >= drift.start) & (columns < drift.stop))
    step, joint, _ = predict_step(
        fit.chain, fit.state, fit.noise, columns, 0.5 * fit.evaluation.position_traces)
    across = joint[EXTRINSIC, place]
    known = joint[np.ix_(place, place)]
    assumed = known + (fit.state.scale - 1) ** 2 * np.eye(3)
    # A drift of zero is measured, with the size of the scale's error as its deviation.
    change = step[EXTRINSIC] - across @ np.linalg.solve(assumed, step[place])
    freedom = across @ (np.linalg.pinv(known) - np.linalg.inv(assumed)) @ across.T
    return found + 0.5 * (freedom + freedom.T) + np.outer(change, change)


def in_parent_axes(covariance: FloatArray, T_a_b: FloatArray) -> FloatArray:
    """Turn a (6, 6) covariance of ``t + R rho``, ``R exp(phi)`` into that of the result.

    The result's is ``t + dt``, ``exp(dtheta) R`` along the fixed axes of a: ``dt = R rho`` and
    ``dtheta = R phi``.
    """
    turn = np.kron(np.eye(2), T_a_b[:3, :3])
    result: FloatArray = turn @ covariance @ turn.T
    return 0.5 * (result + result.T)
