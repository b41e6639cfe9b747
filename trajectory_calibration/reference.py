"""Which reference to take: short motions drown in white noise, long ones in drift and jumps.

The errors of the relative motions do not tell which reference gives the better extrinsic. The
noise does: identified once from the disagreement of the two trajectories (``pair_noise``), it
goes through the equations of the solver with each reference in turn (``predict_covariance``),
correlated pairs and the bias of noisy rotations included, and the smallest predicted error of
the translation wins. The solver runs up to three times more than without ``auto``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration import se3
from trajectory_calibration.association import PosePairs
from trajectory_calibration.config import CalibrationConfig
from trajectory_calibration.errors import MotionError
from trajectory_calibration.motions import AUTOMATIC, MotionPairs, select_motions
from trajectory_calibration.pair_noise import identify_noise
from trajectory_calibration.se3 import FloatArray
from trajectory_calibration.solvers import load_solver, WITHOUT_REFERENCE
from trajectory_calibration.uncertainty import predict_covariance, spanned_steps

# Spacings that are compared: about 1.4 times each other, up to a quarter of the poses.
_SPACINGS = (1, 2, 3, 4, 6, 8, 11, 15, 20, 30, 40, 60, 80)
_LARGEST_SHARE = 0.25

# The spacing of the first look, which identifies the noise.
_FIRST = 5
_ROUNDS = 3

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
    """Return the reference of the configuration, or for ``auto`` the best by prediction.

    Raises
    ------
    MotionError
        The motion does not determine the extrinsic.

    """
    if config.reference != AUTOMATIC:
        return ReferenceChoice(config.reference)
    reference = f'B{max(1, min(_FIRST, (len(pairs) - 1) // 2))}'
    if config.solver in WITHOUT_REFERENCE:
        return ReferenceChoice(reference, f'{config.solver} needs no reference')
    choice = ReferenceChoice(reference)
    for _ in range(_ROUNDS):
        # An error of the extrinsic looks like drift; a look from a better one sees less of it.
        looked, choice = choice, _improve(pairs, config, choice.reference)
        if looked.reference == choice.reference:
            break
    return choice


def _improve(pairs: PosePairs, config: CalibrationConfig, reference: str) -> ReferenceChoice:
    """Choose by the noise that shows with the extrinsic found at one reference."""
    motions = select_motions(pairs, reference)
    solution = load_solver(config.solver)(motions, config)
    if solution.linearise is None:
        return ReferenceChoice(reference, f'{config.solver} tells no equations to predict from')
    X = solution.T_a_b
    kept = np.ones(len(motions), dtype=bool) if solution.inliers is None else solution.inliers
    usable = spanned_steps(motions, kept)
    noise = identify_noise(pairs.poses_a, X @ pairs.poses_b @ se3.inverse(X), usable)
    predicted: dict[str, float] = {}
    for spacing in _SPACINGS:
        if spacing > max(1, _LARGEST_SHARE * len(pairs)):
            break
        motions = select_motions(pairs, f'B{spacing}')
        weights = _within(motions, usable)
        # A solver that rejects must keep its share; one that cannot has jumps in its answer.
        if weights.mean() < config.dnlo_min_inliers and solution.inliers is not None:
            continue
        covariance = predict_covariance(X, motions, noise, solution.linearise, weights)
        predicted[motions.reference] = float(np.sqrt(np.trace(covariance[:3, :3])))
    if not predicted:
        raise MotionError(
            f'reference auto: {len(pairs)} pairs of poses leave no motion to compare; record '
            'longer or give a reference')
    return _choice(predicted)


def _within(motions: MotionPairs, usable: NDArray[np.bool_]) -> FloatArray:
    """Return (M,) one for motions across usable steps only, else zero."""
    bad = np.concatenate([[0], np.cumsum(~usable)])
    return (bad[motions.j] == bad[motions.i]).astype(np.float64)


def _choice(predicted: dict[str, float]) -> ReferenceChoice:
    best = min(predicted, key=lambda name: predicted[name])
    others = [name for name in predicted if name != best]
    named = others[::max(1, -(-len(others) // _NAMED))]
    text = f'{best}: predicted {_length(predicted[best])}'
    if named:
        text += '; ' + ', '.join(f'{name} {_length(predicted[name])}' for name in named)
    return ReferenceChoice(best, text)


def _length(metres: float) -> str:
    return f'{100 * metres:.2g} cm' if metres < 1 else f'{metres:.2g} m'
