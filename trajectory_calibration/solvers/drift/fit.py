"""Alternate Gauss-Newton steps with steps of the variances until neither moves.

The variances follow their restricted marginal likelihood (average-information Newton steps in
their logarithms). Expectation maximisation would stall where a variance wants to be zero; here
such a variance falls by a factor in every iteration until it no longer matters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trajectory_calibration.errors import SolverError
from trajectory_calibration.se3 import FloatArray
from trajectory_calibration.solvers.drift.likelihood import evaluate, Evaluation
from trajectory_calibration.solvers.drift.model import (
    Chain,
    EXTRINSIC,
    IndexArray,
    linearise,
    PARAMETERS,
    State,
    TERM_COLUMNS,
)
from trajectory_calibration.solvers.drift.noise import COMPONENTS, Noise

# The largest change of a log variance in one step, up and down.
_LARGEST_RISE, _LARGEST_FALL = 1.5, 2.5
# A variance whose score is below this hardly acts.
_SMALL_SCORE = 0.1
# Converged: parameters move by less than this share of their standard deviation, and the
# objective by less than this: far below what the data can tell apart.
SMALL_STEP, SMALL_GAIN = 0.06, 0.5
# The largest step of a global term in one iteration (one, metres a metre, seconds).
_LARGEST_TERM_STEP = {'scale': 0.2, 'systematic_drift': 0.05, 'time_offset': 0.05}
# A drift of this much per metre is no drift: the model's step has no length.
_LARGEST_DRIFT = 0.5


@dataclass(frozen=True, eq=False)
class Fit:
    """A minimum of the objective, or where the iterations ended.

    Attributes
    ----------
    chain, state, noise : the data, the unknowns, the noise.
    terms : names of the global terms that were estimated.
    evaluation : at the state.
    iterations : number of them.
    converged : whether the last steps were negligible.

    """

    chain: Chain
    state: State
    noise: Noise
    terms: tuple[str, ...]
    evaluation: Evaluation
    iterations: int
    converged: bool


def columns_of(terms: Sequence[str]) -> IndexArray:
    """Return the indices of the global parameters: the extrinsic and the named terms."""
    everything = np.arange(PARAMETERS)
    parts = [everything[EXTRINSIC], *(
        everything[columns] for name, columns in TERM_COLUMNS.items() if name in terms)]
    return np.concatenate(parts)


def first_noise(chain: Chain, state: State, white_share: float) -> Noise:
    """Guess the noise from what the steps of both sensors differ by.

    ``white_share`` of it is taken for white noise.
    """
    steps = [linearise(chain, state, columns_of(()), first, first + 4096).walk[:, :, -1]
             for first in range(0, len(chain) - 1, 4096)]
    return Noise.guess(chain, np.concatenate(steps), white_share)


def fit(
    chain: Chain,
    state: State,
    noise: Noise,
    terms: Sequence[str] = (),
    max_iterations: int = 25,
    tolerance: float = 1.0,
) -> Fit:
    """Minimise over bodies, extrinsic, terms, variances and jumps, from a state and a noise.

    ``tolerance`` multiplies the limits below which a step counts as negligible.

    Raises
    ------
    SolverError
        The equations cannot be solved: numbers out of range.

    """
    columns = columns_of(terms)
    previous = np.inf
    trust = VarianceTrust()
    # Three equations of translation a step, half of them for b.
    power = 1.5 * (len(chain) - 1)
    first_scale = state.scale
    for iteration in range(1, max_iterations + 1):
        if not 0.5 < state.scale / first_scale < 2:
            raise SolverError(
                f'drift_aware: the scale runs away ({state.scale / first_scale:.2f} times what '
                'the trajectories span); needed steps longer than their noise, or scale fixed')
        evaluation = _evaluate(chain, state, noise, columns, power)
        power = 0.5 * evaluation.position_traces
        step = evaluation.parameter_step
        gain = abs(previous - evaluation.objective)
        previous = evaluation.objective
        deviation = np.sqrt(np.diag(evaluation.covariance))
        if (gain < tolerance * SMALL_GAIN
                and np.all(np.abs(step) < tolerance * SMALL_STEP * deviation)):
            return Fit(
                chain, state, noise, tuple(terms), evaluation, iteration, converged=True)
        state = _moved(state, evaluation, step, columns)
        noise = noise.with_jumps(evaluation.walk_squares, evaluation.walk_spread)
        noise = noise.with_log_variances(
            noise.log_variances + trust.limit(variance_step(evaluation)))
    evaluation = _evaluate(chain, state, noise, columns, power)
    return Fit(chain, state, noise, tuple(terms), evaluation, max_iterations, converged=False)


def scale_covariance(
    covariance: FloatArray, evaluation: Evaluation, columns: IndexArray, scale: float,
) -> FloatArray:
    """Return a (m, m) covariance without the information that is only noise of the steps.

    Noise in the derivative by the scale adds ``T / s^2`` to its information.
    """
    place = np.flatnonzero(columns == TERM_COLUMNS['scale'].start)
    if not len(place):
        return covariance
    column = covariance[:, place]
    variance = float(covariance[place, place][0])
    # Near nothing but noise, keep the result finite.
    false_share = min(0.5 * evaluation.position_traces / scale**2 * variance, 0.7)
    corrected: FloatArray = covariance + column @ column.T * (
        false_share / variance / (1 - false_share))
    return corrected


def variance_step(evaluation: Evaluation) -> FloatArray:
    """Return the (6,) step of the log variances, downhill on the restricted likelihood."""
    score, information = evaluation.score, evaluation.score_information
    eigenvalues, axes = np.linalg.eigh(information)
    curvature = np.maximum(eigenvalues, 1e-8 * eigenvalues[-1] + 1e-3)
    step: FloatArray = -0.5 * axes @ (axes.T @ score / curvature)
    # Where a variance hardly acts, slope and curvature vanish together: do not leap.
    return np.where(np.abs(score) < _SMALL_SCORE, np.minimum(step, 0.0), step)


class VarianceTrust:
    """How far each log variance may move: less after every change of direction."""

    def __init__(self) -> None:
        self._share = np.ones(len(COMPONENTS))
        self._last = np.zeros(len(COMPONENTS))

    def limit(self, step: FloatArray) -> FloatArray:
        """Return the (6,) step within the limits."""
        turned = step * self._last < 0
        self._share = np.where(turned, 0.5 * self._share, np.minimum(1.3 * self._share, 1.0))
        self._last = step
        limited: FloatArray = np.clip(
            step, -_LARGEST_FALL * self._share, _LARGEST_RISE * self._share)
        return limited


def _moved(
    state: State, evaluation: Evaluation, step: FloatArray, columns: IndexArray,
) -> State:
    parameters = np.zeros(PARAMETERS)
    parameters[columns] = step
    # Terms that the data hardly tell from the motion may overshoot: shorten the whole step.
    longest = max(np.abs(parameters[TERM_COLUMNS[name]] / limit).max()
                  for name, limit in _LARGEST_TERM_STEP.items())
    step = step / max(1.0, longest)
    parameters /= max(1.0, longest)
    response = evaluation.body_response
    bodies = -(response[:, :, -1] + response[:, :, :-1] @ step)
    return state.moved(parameters, bodies)


def _evaluate(
    chain: Chain, state: State, noise: Noise, columns: IndexArray, power: float,
) -> Evaluation:
    reason = None
    if np.linalg.norm(state.systematic_drift) > _LARGEST_DRIFT or state.scale <= 0:
        reason = f'scale {state.scale:.3g}, drift {np.round(state.systematic_drift, 3)} a metre'
    else:
        try:
            evaluation = evaluate(chain, state, noise, columns, power)
        except np.linalg.LinAlgError as error:
            reason = str(error)
        else:
            if np.isfinite(evaluation.objective):
                return evaluation
            reason = 'numbers out of range'
    raise SolverError(
        f'drift_aware: the equations of {len(chain)} poses cannot be solved ({reason}); needed '
        'trajectories of one vehicle in metres; check units and frames, or try dnlo')
