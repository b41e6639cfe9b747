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


def in_parent_axes(covariance: FloatArray, T_a_b: FloatArray) -> FloatArray:
    """Turn a (6, 6) covariance of ``t + R rho``, ``R exp(phi)`` into that of the result.

    The result's is ``t + dt``, ``exp(dtheta) R`` along the fixed axes of a: ``dt = R rho`` and
    ``dtheta = R phi``.
    """
    turn = np.kron(np.eye(2), T_a_b[:3, :3])
    result: FloatArray = turn @ covariance @ turn.T
    return 0.5 * (result + result.T)
