"""Drift-aware: maximum likelihood with white noise, drift and jumps in one model.

Every other solver takes relative motions over a fixed lag: short ones drown in white noise, long
ones in drift. Here both noises are in the model (``solvers/drift/model.py``), their variances
come from the data (``solvers/drift/likelihood.py``), and jumps are named and set aside, so that
no lag, no threshold and no start is asked for. The relative motions given to the solver are not
used, only the pose pairs they were made from. ``docs/drift_aware.md`` has the derivations.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.errors import MotionError, SolverError
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.covariance import (
    extrinsic_covariance,
    in_parent_axes,
    parameter_covariance,
)
from trajectory_calibration.solvers.drift_aware.diagnosis import diagnose, findings_of
from trajectory_calibration.solvers.drift_aware.fit import Fit
from trajectory_calibration.solvers.drift_aware.initial_scale import unit_of_b
from trajectory_calibration.solvers.drift_aware.model import TERM_COLUMNS
from trajectory_calibration.solvers.drift_aware.noise_checks import check_walk
from trajectory_calibration.solvers.drift_aware.selection import (
    COARSE,
    estimate,
    optional_terms,
    RIVALS,
)
from trajectory_calibration.solvers.drift_aware.standstill import without_rest
from trajectory_calibration.solvers.solution import Solution

# Fewer pose pairs than this do not tell noise from extrinsic.
MIN_POSES = 10

# Change of position (metres, and relative to the distance from the origin) that is rounding.
_NO_MOTION = 1e-9


def solve(motions: MotionPairs, config: CalibrationConfig) -> Solution:
    """Return the most likely extrinsic with its covariance.

    Its cost is -2 log of the restricted marginal likelihood, up to a constant.

    Raises
    ------
    MotionError
        The sensors did not turn.
    SolverError
        Too few poses, or equations that cannot be solved.

    """
    return solve_pairs(motions.pairs, {term: config.mode(term) for term in TERM_COLUMNS})


def solve_pairs(pairs: PosePairs, terms: Mapping[str, str]) -> Solution:
    """Return the most likely extrinsic of pose pairs.

    ``terms`` says 'fixed', 'estimate' or 'auto' for 'scale', 'systematic_drift' and
    'time_offset'; raises as ``solve``. A scale that is not fixed is found whatever the unit.
    """
    if len(pairs) < MIN_POSES:
        raise SolverError(
            f'drift_aware: {len(pairs)} pairs of poses, needed at least {MIN_POSES} to tell noise '
            'from motion; record longer or use dnl')
    _require_motion(pairs)
    if not all(_moved(poses[:, :3, 3]) for poses in (pairs.poses_a, pairs.poses_b)):
        # One sensor turned on the spot: its lever arm and a scale explain the same.
        terms = {name: 'fixed' if mode == 'auto' and name in RIVALS else mode
                 for name, mode in terms.items()}
    # A start that diverges overflows on its way; it is discarded, or all of them are an error.
    with np.errstate(over='ignore', invalid='ignore', divide='ignore'), _named_errors(pairs):
        unit = 1.0 if terms['scale'] == 'fixed' else _unit(pairs)
        fit, pairs = _fit(pairs.scaled(unit), terms)
        covariance = parameter_covariance(fit)
        of_extrinsic = extrinsic_covariance(fit, optional_terms(terms))
    diagnosis = diagnose(fit, covariance, pairs.stamps_ns, unit)
    return Solution(
        T_a_b=fit.state.T_a_b,
        cost=fit.evaluation.objective,
        iterations=fit.iterations,
        covariance=in_parent_axes(of_extrinsic, fit.state.T_a_b),
        findings=(
            *findings_of(diagnosis), *fit.lags.findings(fit.state.T_a_b), *_bounded(fit),
            *_unsettled(fit)),
        scale=unit * fit.state.scale,
        time_offset_s=fit.state.time_offset,
        diagnosis=diagnosis,
    )


@contextmanager
def _named_errors(pairs: PosePairs) -> Iterator[None]:
    """Name what the algebra could not do: motion so degenerate that a matrix has no inverse."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise SolverError(
            f'drift_aware: the equations of {len(pairs)} poses cannot be solved ({error}); needed '
            'motion of both sensors, with turns about several axes') from error


def _fit(pairs: PosePairs, terms: Mapping[str, str]) -> tuple[Fit, PosePairs]:
    """Return the fit, and the pairs that it is of: with those at rest only where they tell."""
    drive = without_rest(pairs)
    fit = estimate(drive.pairs, terms)
    if drive.stops and not drive.rest_is_worthless(fit):
        return estimate(pairs, terms), pairs
    return fit, drive.pairs


def _unit(pairs: PosePairs) -> float:
    """Return metres of a per unit of b where that is not one, as well as a short fit tells it.

    An error of scale on top of it is then as likely, and as large, as between other sensors.
    """
    unit = unit_of_b(pairs)
    if unit == 1.0:
        return unit
    pairs = pairs.thinned(max(1, len(pairs) // COARSE))
    rest = dict.fromkeys(TERM_COLUMNS, 'fixed')
    return unit * estimate(pairs.scaled(unit), {**rest, 'scale': 'estimate'}).state.scale


def _bounded(fit: Fit) -> tuple[Finding, ...]:
    """Return a warning where the walk that was identified does not accumulate."""
    check = check_walk(fit.chain, fit.state, fit.noise)
    return () if check is None else check.findings()


def _unsettled(fit: Fit) -> tuple[Finding, ...]:
    """Return a warning where the final fit ended at its limit of iterations."""
    if fit.converged:
        return ()
    step = np.abs(fit.evaluation.parameter_step) / np.sqrt(np.diag(fit.evaluation.covariance))
    warning = Finding(
        'not-converged',
        f'drift_aware: stopped after {fit.iterations} iterations before it settled; its last '
        f'step was {step.max():.2g} of the standard deviation: compare with dnlo or record longer',
        {'iterations': fit.iterations})
    return (warning,)


def _require_motion(pairs: PosePairs) -> None:
    """Raise MotionError where one of the sensors did not move at all, but for rounding."""
    for name, poses in (('a', pairs.poses_a), ('b', pairs.poses_b)):
        if not _moved(poses):
            raise MotionError(
                f'the sensors did not turn: {name} stood still over {len(pairs)} poses; drive '
                'curves, and a ramp or a bank')


def _moved(values: FloatArray) -> bool:
    """Tell whether the first axis of an array has more in it than rounding."""
    change = float(np.abs(values - values[0]).max())
    return change > _NO_MOTION * (1.0 + float(np.abs(values[0]).max()))
