# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Drift-aware: maximum likelihood on a tree of worlds.

Every other solver uses relative motions over a fixed lag: white noise dominates short ones, drift
dominates long ones. Here windows of all lengths are compared at once (``tree``). The noise at each
length is estimated with the extrinsic (``noise``), jumps are detected and bridged (``jumps``),
systematic errors are always in the model (``drive``), and the information of a length saturates
because its noise may be correlated with the motion (``octaves``). The solver uses the pose pairs,
not the relative motions. docs/drift_aware/model.md has the derivation.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.errors import counted, SolverError
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.algebra import ROTATION, TRANSLATION
from trajectory_calibration.solvers.drift_aware.covariance import covariance
from trajectory_calibration.solvers.drift_aware.diagnosis import diagnose, findings_of
from trajectory_calibration.solvers.drift_aware.drive import Drive, TERMS
from trajectory_calibration.solvers.drift_aware.fit import Fit, fit
from trajectory_calibration.solvers.drift_aware.starts import start
from trajectory_calibration.solvers.quadratic import require_motion
from trajectory_calibration.solvers.solution import Solution

# Fewer pose pairs cannot separate noise from the extrinsic.
MIN_POSES = 10

# With more than twice this many poses, a fit to about this many comes first.
_COARSE = 400


def solve(motions: MotionPairs, config: CalibrationConfig) -> Solution:
    """Return the most likely extrinsic with its covariance.

    Its cost is -2 log of the likelihood, up to a constant.

    Raises
    ------
    MotionError
        A sensor did not move.
    SolverError
        Too few poses, or equations that cannot be solved.

    """
    return solve_pairs(motions.pairs, {term: config.mode(term) for term in TERMS})


def solve_pairs(pairs: PosePairs, terms: Mapping[str, str]) -> Solution:
    """Return the most likely extrinsic of pose pairs.

    ``terms`` maps 'scale', 'systematic_drift' and 'time_offset' to 'fixed', 'estimate' (no prior)
    or 'auto'; raises as ``solve``. A scale that is not fixed may be far from one (other units).
    """
    if len(pairs) < MIN_POSES:
        raise SolverError(
            f'{counted(len(pairs), "pose pair")}, needed at least {MIN_POSES} to '
            'tell noise from motion; record longer, or use another solver')
    require_motion(pairs)
    every = _every(pairs)
    # A diverging start overflows; it is discarded, and if all diverge, that is an error.
    with np.errstate(over='ignore', invalid='ignore', divide='ignore'), _named_errors(pairs):
        found, unit = _fit(pairs, every, dict(terms))
        spread, cost = covariance(found), found.objective
        if not np.isfinite(np.r_[found.state.T_a_b.ravel(), spread.ravel(), cost]).all():
            raise SolverError(
                f'{len(pairs)} poses gave no finite answer: the motion is too '
                'degenerate for this solver; use another one')
    diagnosis = diagnose(found, spread, pairs.stamps_ns[::every], unit)
    return Solution(
        T_a_b=found.state.T_a_b,
        cost=cost,
        iterations=found.rounds,
        covariance=in_parent_axes(spread[:6, :6], found.state.T_a_b),
        findings=(*findings_of(diagnosis, int(pairs.stamps_ns[0])), *_unsettled(found)),
        scale=diagnosis.scale,
        time_offset_s=diagnosis.time_offset_s,
        diagnosis=diagnosis,
    )


def _every(pairs: PosePairs) -> int:
    """Return k such that every k-th pose pair is enough."""
    step_s = 1e-9 * float(np.median(np.diff(pairs.stamps_ns)))
    # The information of more than 2000 poses saturates. But a vehicle turns in a second.
    every = min(round(len(pairs) / 2000), int(1.0 / max(step_s, 1e-9)))
    return max(1, every)


def in_parent_axes(covariance_b: FloatArray, T_a_b: FloatArray) -> FloatArray:
    """Convert the (6, 6) covariance of (dt, dtheta) from the axes of b to those of a."""
    G = np.zeros((6, 6))
    G[TRANSLATION, TRANSLATION] = G[ROTATION, ROTATION] = T_a_b[:3, :3]
    result: FloatArray = G @ covariance_b @ G.T
    return result


def _fit(pairs: PosePairs, every: int, terms: dict[str, str]) -> tuple[Fit, float]:
    """Return the fit, and the metres of a per unit of b; coarse to fine."""
    drive = Drive.of(pairs, every)
    coarse = Drive.of(pairs, every * max(1, len(drive) // _COARSE))
    state, unit = start(coarse, unit_is_known=terms['scale'] == 'fixed')
    if unit != 1.0:
        # Another unit is only possible if the scale is free.
        terms['scale'] = 'estimate'
    drive, coarse = drive.scaled(unit), coarse.scaled(unit)
    before = None
    if len(drive) > 2 * _COARSE:
        before = fit(coarse, state, terms, most_rounds=7)
        state = before.state
    return fit(drive, state, terms, before), unit


@contextmanager
def _named_errors(pairs: PosePairs) -> Iterator[None]:
    """Convert a singular matrix, from degenerate motion, to a named error."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise SolverError(
            f'the equations of {len(pairs)} poses cannot be solved ({error}); needed '
            'motion of both sensors, with turns about several axes') from error


def _unsettled(found: Fit) -> tuple[Finding, ...]:
    """Return a finding if the fit did not converge."""
    if found.converged:
        return ()
    return (Finding(
        'not-converged', f'the solver did not converge in {counted(found.rounds, "iteration")}: '
        f'the last step was {found.last_step:.2g} standard deviations. Compare with another '
        'solver, or record longer', {'rounds': found.rounds}),)
