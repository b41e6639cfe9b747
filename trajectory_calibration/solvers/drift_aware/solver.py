# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Drift-aware: maximum likelihood on a tree of worlds.

Every other solver takes relative motions over a fixed lag: short ones drown in white noise, long
ones in drift. Here windows of all lengths are compared at once (``tree``), the noise of every
length is found beside the extrinsic (``noise``), jumps are named and bridged (``jumps``), what is
steadily wrong is always in the model (``drive``), and no length is believed beyond what noise
that follows the motion allows (``octaves``). The relative motions given to the solver are not
used, only the pose pairs they were made from. docs/drift_aware/model.md has the derivation.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.errors import counted, MotionError, SolverError
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.algebra import ROTATION, TRANSLATION
from trajectory_calibration.solvers.drift_aware.covariance import covariance
from trajectory_calibration.solvers.drift_aware.diagnosis import diagnose, findings_of
from trajectory_calibration.solvers.drift_aware.drive import Drive, TERMS
from trajectory_calibration.solvers.drift_aware.fit import Fit, fit
from trajectory_calibration.solvers.drift_aware.starts import start
from trajectory_calibration.solvers.solution import Solution

# Fewer pose pairs than this do not tell noise from extrinsic.
MIN_POSES = 10

# Longer drives are thinned to about this many poses: what is left out would be believed no more.
# But not to longer steps, seconds: a vehicle turns in that time, and windows begin with one step.
_ENOUGH = 2000
_LONGEST_STEP_S = 1.0
# A fit to about this many poses comes first where there are more than twice as many.
_COARSE = 400
_COARSE_ROUNDS = 7

# Change of position (metres, and relative to the distance from the origin) that is rounding.
_NO_MOTION = 1e-9


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

    ``terms`` says 'fixed', 'estimate' (no prior) or 'auto' for 'scale', 'systematic_drift' and
    'time_offset'; raises as ``solve``. A scale that is not fixed is found whatever the unit.
    """
    if len(pairs) < MIN_POSES:
        raise SolverError(
            f'drift_aware: {counted(len(pairs), "pose pair")}, needed at least {MIN_POSES} to '
            'tell noise from motion; record longer or use dnl')
    _require_motion(pairs)
    every = _every(pairs)
    # A start that diverges overflows on its way; it is discarded, or all of them are an error.
    with np.errstate(over='ignore', invalid='ignore', divide='ignore'), _named_errors(pairs):
        found, unit = _fit(pairs, every, dict(terms))
        spread, cost = covariance(found), found.objective
        if not np.isfinite(np.r_[found.state.T_a_b.ravel(), spread.ravel(), cost]).all():
            raise SolverError(
                f'drift_aware: {len(pairs)} poses gave no finite answer: the motion is too '
                'degenerate for its model; use dnlo')
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
    """Return k: every k-th pose pair is enough."""
    step_s = 1e-9 * float(np.median(np.diff(pairs.stamps_ns)))
    every = min(round(len(pairs) / _ENOUGH), int(_LONGEST_STEP_S / max(step_s, 1e-9)))
    return max(1, every)


def in_parent_axes(covariance_b: FloatArray, T_a_b: FloatArray) -> FloatArray:
    """Return the (6, 6) covariance of (dt, dtheta) about the axes of a, of one in those of b."""
    G = np.zeros((6, 6))
    G[TRANSLATION, TRANSLATION] = G[ROTATION, ROTATION] = T_a_b[:3, :3]
    result: FloatArray = G @ covariance_b @ G.T
    return result


def _fit(pairs: PosePairs, every: int, terms: dict[str, str]) -> tuple[Fit, float]:
    """Return the fit, and the metres of a per unit of b: from few poses to all of them."""
    drive = Drive.of(pairs, every)
    coarse = Drive.of(pairs, every * max(1, len(drive) // _COARSE))
    state, unit = start(coarse, unit_is_known=terms['scale'] == 'fixed')
    if unit != 1.0:
        # Only such a scale is free.
        terms['scale'] = 'estimate'
    drive, coarse = drive.scaled(unit), coarse.scaled(unit)
    before = None
    if len(drive) > 2 * _COARSE:
        before = fit(coarse, state, terms, most_rounds=_COARSE_ROUNDS)
        state = before.state
    return fit(drive, state, terms, before), unit


@contextmanager
def _named_errors(pairs: PosePairs) -> Iterator[None]:
    """Name what the algebra could not do: motion so degenerate that a matrix has no inverse."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise SolverError(
            f'drift_aware: the equations of {len(pairs)} poses cannot be solved ({error}); needed '
            'motion of both sensors, with turns about several axes') from error


def _unsettled(found: Fit) -> tuple[Finding, ...]:
    """Return a finding where the fit ended at its limit of rounds."""
    if found.converged:
        return ()
    return (Finding(
        'not-converged', f'drift_aware did not converge in {counted(found.rounds, "iteration")}: '
        f'the last step was {found.last_step:.2g} standard deviations. Compare with --solver '
        'dnlo, or record longer', {'rounds': found.rounds}),)


def _require_motion(pairs: PosePairs) -> None:
    """Raise MotionError where one of the sensors did not move at all, but for rounding."""
    for name, poses in (('a', pairs.poses_a), ('b', pairs.poses_b)):
        change = float(np.abs(poses - poses[0]).max())
        if change <= _NO_MOTION * (1.0 + float(np.abs(poses[0]).max())):
            raise MotionError(
                f'the sensors did not turn: {name} stood still over '
                f'{counted(len(poses), "pose")}; drive curves, and a ramp or a bank')
