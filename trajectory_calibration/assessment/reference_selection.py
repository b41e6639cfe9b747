"""Which reference to take: short motions drown in white noise, long ones in drift and jumps.

The errors of the relative motions do not tell which reference gives the better extrinsic. The
noise does. ``drift_aware`` identifies it and gives, with it, all that the data say of the
extrinsic: a mean ``x`` and a covariance ``P``. Reporting another answer ``x_n`` then costs, by
what is known,

    E |x_n - truth|^2 = |x_n - x|^2 + tr P,

which is what a solver's answer at each reference is judged by, with rotations counted by what
they move a point one metre away: the smallest expected error wins. ``P + (x_n - x)(x_n - x)^T``
is also how far the answer may be from the truth. Against a covariance predicted from the noise
alone it counts what the noise happened to be in these data, and errors that no solver's equations
know of, as jumps, a scale, a steady drift.

J. O. Berger, "Statistical Decision Theory and Bayesian Analysis", 1985, section 4.4 (posterior
expected loss).
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from trajectory_calibration.assessment.covariance import estimate_uncertainty, Uncertainty
from trajectory_calibration.assessment.excitation import thinned
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.motion_pairs import (
    AUTOMATIC,
    lag_grid,
    reference_indices,
    select_motions,
)
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.errors import MotionError, SolverError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers import load_solver, noise_identifier, solver_info

# A rotation counts by what it moves at this distance, metres.
_DISTANCE = 1.0

# References that are compared: A, and n poses that span so many seconds, as far as that is no more
# than a quarter of the recording.
_CANDIDATES_B = (0.1, 0.2, 0.3, 0.5, 0.8, 1.2, 2.0, 3.0, 5.0, 8.0)
_CANDIDATES_C = (0.5, 1.0, 2.0)
_LARGEST_SHARE = 0.25

# The reference where none can be preferred, seconds.
_USUAL = (0.5,)

# Poses and motions that are enough to tell references apart.
_ENOUGH = 10_000

# Errors below this, metres, are named as such: digits would say nothing.
_SMALLEST = 1e-4

# How many of the other candidates the explanation names.
_NAMED = 3


@dataclass(frozen=True, eq=False)
class Known:
    """What the data say of the extrinsic, by ``drift_aware``.

    Attributes
    ----------
    T_a_b : (4, 4), the mean.
    covariance : (6, 6), of the mean.
    directions : (K, 6), what turns a step (dt, dtheta) into metres along the directions that the
        motion showed; ``_DISTANCE`` counts.
    variance : of the mean along all of them together, m^2.

    """

    T_a_b: FloatArray
    covariance: FloatArray
    directions: FloatArray
    variance: float

    def expected_error(self, T_a_b: FloatArray) -> float:
        """Return the root of the expected squared error of a (4, 4) answer, metres."""
        step = se3.step_between(self.T_a_b, T_a_b)
        return float(np.sqrt(np.sum((self.directions @ step)**2) + self.variance))

    def uncertainty_of(self, T_a_b: FloatArray, own: Uncertainty) -> Uncertainty:
        """Return how far a (4, 4) answer may be from the truth.

        ``own`` is what the equations of its solver say, for directions that those leave open.
        """
        step = se3.step_between(self.T_a_b, T_a_b)
        return replace(own, covariance=(
            self.covariance + np.outer(step, step) + own.unobserved.T @ own.unobserved))


@dataclass(frozen=True)
class ReferenceChoice:
    """A reference, and why.

    Attributes
    ----------
    reference : 'B6', ...
    explanation : a sentence, or empty where the reference was given and taken.
    known : what the data say of the extrinsic, where it was chosen by that.

    """

    reference: str
    explanation: str = ''
    known: Known | None = None


def choose_reference(pairs: PosePairs, config: CalibrationConfig) -> ReferenceChoice:
    """Return the reference of the configuration, or for ``auto`` the best by expectation."""
    (lag,) = lag_grid(pairs.stamps_ns, _USUAL, largest_share=1.0)
    usual = f'B{max(1, min(lag, (len(pairs) - 1) // 2))}'
    needed = solver_info(config.solver).needs_reference
    if config.reference != AUTOMATIC:
        if not needed and not _fits(config.reference, len(pairs)):
            return ReferenceChoice(usual, (
                f'{config.solver} needs no reference; {usual} for the relative error, because '
                f'{config.reference} is too long for {len(pairs)} poses'))
        return ReferenceChoice(config.reference)
    if not needed:
        return ReferenceChoice(usual)
    try:
        known = _known(pairs, config)
    except (MotionError, SolverError) as error:
        # Whether the motion is enough is for the solver that was asked for to say: what it leaves
        # open may be allowed, or known beforehand.
        return ReferenceChoice(usual, f'{usual}: nothing to judge by; {error}')
    expected: dict[str, float] = {}
    for reference in _candidates(pairs):
        motions = thinned(select_motions(pairs, reference), _ENOUGH)
        try:
            found = load_solver(config.solver)(motions, config).T_a_b
        except (MotionError, SolverError):
            # Another reference may do; where none does, the usual one says why.
            continue
        expected[reference] = known.expected_error(found)
    if not expected:
        return ReferenceChoice(usual)
    best = min(expected, key=lambda name: expected[name])
    return ReferenceChoice(best, _explanation(best, expected), known)


def _candidates(pairs: PosePairs) -> list[str]:
    """Return 'A', 'B1', ..., 'C5', ..."""
    lags = {letter: lag_grid(pairs.stamps_ns, seconds, _LARGEST_SHARE)
            for letter, seconds in (('B', _CANDIDATES_B), ('C', _CANDIDATES_C))}
    return ['A', *(f'B{lag}' for lag in lags['B']), *(f'C{lag}' for lag in lags['C'] if lag > 1)]


def _fits(reference: str, poses: int) -> bool:
    """Tell whether so many poses make motions with a reference."""
    with suppress(MotionError):
        reference_indices(reference, poses)
        return True
    return False


def _known(pairs: PosePairs, config: CalibrationConfig) -> Known:
    motions = select_motions(pairs.thinned(-(-len(pairs) // _ENOUGH)), 'B1')
    solution = noise_identifier().load()(motions, config)
    covariance = estimate_uncertainty(solution, motions).covariance
    unit = np.repeat([1.0, _DISTANCE], 3)
    variances, axes = np.linalg.eigh(covariance * np.outer(unit, unit))
    # Where the motion showed nothing, no answer is better than another.
    seen = variances < config.unobserved_translation**2
    # Rounding may leave a variance below zero.
    return Known(solution.T_a_b, covariance, axes[:, seen].T * unit,
                 float(np.maximum(variances[seen], 0.0).sum()))


def _explanation(best: str, expected: dict[str, float]) -> str:
    others = [name for name in expected if name != best]
    named = others[::max(1, -(-len(others) // _NAMED))]
    text = f'{best}: predicted {_length(expected[best])}'
    if named:
        text += '; ' + ', '.join(f'{name} {_length(expected[name])}' for name in named)
    return text


def _length(metres: float) -> str:
    if metres < _SMALLEST:
        return f'below {100 * _SMALLEST:g} cm'
    return f'{100 * metres:.2g} cm' if metres < 1 else f'{metres:.3g} m'
