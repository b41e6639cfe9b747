# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The covariance of an extrinsic: one noise model for the answers of all solvers.

Motions share poses, and their errors drift and jump: a covariance from the residuals of a solver
is wrong by factors. One solver identifies the noise (``solvers.noise_identifier``) and gives the
posterior of the extrinsic, a mean ``x`` and a covariance ``P``. The answer ``x_n`` of another
solver then has the mean squared error

    E (x_n - truth)(x_n - truth)^T = P + (x_n - x)(x_n - x)^T.

It includes the effect of the actual noise, and of errors that the equations of that solver do not
model: jumps, a scale, a systematic drift. Directions that its equations do not determine are
unobservable in its answer, whatever the other solver knows (``excitation``).

J. O. Berger, "Statistical Decision Theory and Bayesian Analysis", 1985, section 4.4 (posterior
expected loss).
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from trajectory_calibration.assessment.excitation import split_equations, split_pairs
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.motion_pairs import MotionPairs, select_motions
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.errors import MotionError, SolverError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers import noise_identifier
from trajectory_calibration.solvers.solution import Diagnosis, Linearise, Solution, UNOBSERVED_STD

# Number of poses that is enough to identify the noise, and of motions to compare references.
ENOUGH = 10_000

# Errors that the noise identifier corrects and the paper's solvers cannot, by finding code.
_TERMS = {'scale': 'a difference in scale', 'scale-unit': 'another unit of length',
          'systematic-drift': 'a steady drift', 'clock-offset': 'a clock offset'}


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """The uncertainty of an answer.

    Attributes
    ----------
    covariance : (6, 6), order and side as in ``CalibrationResult``.
    unobserved : (K, 6) unobservable directions (dt, dtheta).
    findings : on the uncertainty.

    """

    covariance: FloatArray
    unobserved: FloatArray
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True, eq=False)
class MostLikely:
    """Posterior of the extrinsic: mean (4, 4), covariance (6, 6), and the noise identified."""

    T_a_b: FloatArray
    covariance: FloatArray
    findings: tuple[Finding, ...] = ()
    diagnosis: Diagnosis | None = None


def most_likely(pairs: PosePairs, config: CalibrationConfig) -> MostLikely:
    """Return the posterior of the extrinsic from the solver that identifies the noise.

    Raises MotionError and SolverError as that solver: too few poses, no motion.
    """
    motions = select_motions(pairs.thinned(-(-len(pairs) // ENOUGH)), 'B1')
    solution = noise_identifier().load()(motions, config)
    return MostLikely(solution.T_a_b, estimate_uncertainty(solution, motions, config).covariance,
                      solution.findings, solution.diagnosis)


def estimate_uncertainty(
    solution: Solution,
    motions: MotionPairs,
    config: CalibrationConfig | None = None,
    known: MostLikely | None = None,
) -> Uncertainty:
    """Return the uncertainty of a solution from motions.

    ``config`` has the settings of the noise identifier, ``known`` is its answer if it has already
    run. Raises SolverError for a solution with neither a covariance nor equations.
    """
    if solution.covariance is not None:
        # The solver's own covariance counts rotation noise as excitation.
        unobserved = split_pairs(solution.T_a_b, motions.pairs.scaled(solution.scale)).unobserved
        return Uncertainty(_bounded(solution.covariance, unobserved), unobserved)
    if solution.linearise is None:
        raise SolverError('the solver gave neither a covariance nor the equations it solved')
    config = config or CalibrationConfig()
    if known is None:
        # Too few poses, for instance: the residuals are used instead.
        with suppress(MotionError, SolverError):
            known = most_likely(motions.pairs, config)
    excited = split_equations(solution.T_a_b, motions, solution.linearise, solution.inliers)
    unobserved = excited.unobserved
    if known is None:
        covariance = _from_residuals(solution.T_a_b, motions, solution.linearise, excited.basis)
        return Uncertainty(_bounded(covariance, unobserved), unobserved)
    step = np.clip(se3.step_between(known.T_a_b, solution.T_a_b), -UNOBSERVED_STD, UNOBSERVED_STD)
    return Uncertainty(_bounded(known.covariance + np.outer(step, step), unobserved), unobserved,
                       _uncorrected(known, config.solver))


def _uncorrected(known: MostLikely, solver: str) -> tuple[Finding, ...]:
    """Return a finding if the data have errors that the solver cannot correct."""
    found = [finding for finding in known.findings if finding.code in _TERMS]
    if not found:
        return ()
    values = {name: value for finding in found for name, value in finding.values.items()}
    return (Finding(
        'uncorrected', f'the data hold {" and ".join(_TERMS[item.code] for item in found)}, which '
        f'{solver} cannot correct. The standard deviations include the effect. Use solver '
        f'{noise_identifier().name}', values),)


def _from_residuals(
    T_a_b: FloatArray, motions: MotionPairs, linearise: Linearise, basis: FloatArray,
) -> FloatArray:
    """Return a (6, 6) covariance on the span of a (6, K) basis, for independent motions.

    The sandwich estimate, corrected for the degrees of freedom.
    """
    motions = motions.thinned(ENOUGH)
    found = linearise(T_a_b, motions.A, T_a_b @ motions.B @ se3.inverse(T_a_b))
    Z = found.instrument @ basis
    bread = np.einsum('kri,krj->ij', Z, found.jacobian @ basis)
    scores = np.einsum('kri,kr->ki', Z, found.residual)
    inverse = basis @ np.linalg.pinv(bread, rcond=se3.ROUNDING)
    equations = 6 * len(motions)
    share = equations / max(equations - basis.shape[1], 1)
    covariance: FloatArray = share * inverse @ (scores.T @ scores) @ inverse.T
    return 0.5 * (covariance + covariance.T)


def _bounded(covariance: FloatArray, unobserved: FloatArray) -> FloatArray:
    """Return a (6, 6) covariance with (K, 6) unobservable directions, bounded.

    Rounding may make a variance negative, several such directions may exceed ``UNOBSERVED_STD``.
    """
    unit = np.outer(UNOBSERVED_STD, UNOBSERVED_STD)
    total = covariance + unobserved.T @ unobserved
    variances, axes = np.linalg.eigh(0.5 * (total + total.T) / unit)
    bounded: FloatArray = (axes * np.clip(variances, 0.0, 1.0)) @ axes.T * unit
    return 0.5 * (bounded + bounded.T)
