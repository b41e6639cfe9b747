"""Which reference to take: short motions drown in white noise, long ones in drift and jumps.

The errors of the relative motions do not tell which reference gives the better extrinsic. The
noise does. ``drift_aware`` identifies it and gives, with it, all that the data say of the
extrinsic: a mean ``x`` and a covariance ``P``. Reporting another answer ``x_n`` then costs, by
what is known,

    E |x_n - truth|^2 = |x_n - x|^2 + tr P,

which is what a solver's answer at each reference is judged by: the one with the smallest
expected error of the translation wins. Against a covariance predicted from the identified noise
alone this also counts what the noise happened to be in these data, and errors that no solver's
equations know of, as jumps, a scale, a steady drift.

J. O. Berger, "Statistical Decision Theory and Bayesian Analysis", 1985, section 4.4 (posterior
expected loss).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajectory_calibration.association import PosePairs
from trajectory_calibration.config import CalibrationConfig
from trajectory_calibration.errors import MotionError, SolverError
from trajectory_calibration.excitation import thinned, thinning
from trajectory_calibration.motions import AUTOMATIC, parse_reference, select_motions
from trajectory_calibration.se3 import FloatArray
from trajectory_calibration.solvers import drift_aware, load_solver, WITHOUT_REFERENCE
from trajectory_calibration.uncertainty import estimate_uncertainty

# References that are compared, as far as n is no more than a quarter of the poses.
_CANDIDATES = ('A', 'B1', 'B2', 'B3', 'B5', 'B8', 'B12', 'B20', 'B30', 'B50', 'B80',
               'C5', 'C10', 'C20')
_LARGEST_SHARE = 0.25

# The reference where none can be preferred.
_USUAL = 5

# Poses and motions that are enough to tell references apart.
_ENOUGH = 10_000

# How many of the other candidates the explanation names.
_NAMED = 3


@dataclass(frozen=True)
class ReferenceChoice:
    """A reference, and why.

    Attributes
    ----------
    reference : 'B6', ...
    explanation : a sentence, or empty where the reference was given.

    """

    reference: str
    explanation: str = ''


def choose_reference(pairs: PosePairs, config: CalibrationConfig) -> ReferenceChoice:
    """Return the reference of the configuration, or for ``auto`` the best by expectation.

    Raises
    ------
    MotionError
        The motion does not determine the extrinsic.

    """
    if config.reference != AUTOMATIC:
        return ReferenceChoice(config.reference)
    usual = f'B{max(1, min(_USUAL, (len(pairs) - 1) // 2))}'
    if config.solver in WITHOUT_REFERENCE:
        return ReferenceChoice(usual, f'{config.solver} needs no reference')
    try:
        mean, spread, seen = _known_translation(pairs, config)
    except SolverError as error:
        return ReferenceChoice(usual, f'{usual}: nothing to judge by; {error}')
    expected: dict[str, float] = {}
    for reference in _CANDIDATES:
        if parse_reference(reference)[1] > max(1, _LARGEST_SHARE * len(pairs)):
            continue
        motions = thinned(select_motions(pairs, reference), _ENOUGH)
        try:
            found = load_solver(config.solver)(motions, config).T_a_b[:3, 3]
        except (MotionError, SolverError):
            # Another reference may do; where none does, the usual one says why.
            continue
        expected[reference] = float(np.sqrt(np.sum((seen @ (found - mean))**2) + spread))
    return _choice(expected) if expected else ReferenceChoice(usual)


def _known_translation(
    pairs: PosePairs, config: CalibrationConfig,
) -> tuple[FloatArray, float, FloatArray]:
    """Return what is known of the translation: mean, variance, and in which directions.

    The (3, 3) projection leaves out directions that the motion did not show: there no answer is
    better than another.
    """
    keep = thinning(len(pairs), _ENOUGH)
    pairs = PosePairs(
        pairs.stamps_ns[keep], pairs.poses_a[keep], pairs.poses_b[keep], pairs.summary)
    motions = select_motions(pairs, 'B1')
    solution = drift_aware.solve(motions, config)
    covariance = estimate_uncertainty(solution, motions).covariance[:3, :3]
    variances, axes = np.linalg.eigh(covariance)
    known = variances < config.unobserved_translation**2
    seen: FloatArray = axes[:, known] @ axes[:, known].T
    return solution.T_a_b[:3, 3], float(variances[known].sum()), seen


def _choice(expected: dict[str, float]) -> ReferenceChoice:
    best = min(expected, key=lambda name: expected[name])
    others = [name for name in expected if name != best]
    named = others[::max(1, -(-len(others) // _NAMED))]
    text = f'{best}: predicted {_length(expected[best])}'
    if named:
        text += '; ' + ', '.join(f'{name} {_length(expected[name])}' for name in named)
    return ReferenceChoice(best, text)


def _length(metres: float) -> str:
    return f'{100 * metres:.2g} cm' if metres < 1 else f'{metres:.2g} m'
