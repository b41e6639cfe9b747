"""Alternate Gauss-Newton steps with steps of the variances until neither moves.

The variances follow their restricted marginal likelihood (average-information Newton steps in
their logarithms). Expectation maximisation would stall where a variance wants to be zero; here
such a variance falls by a factor in every iteration until it no longer matters.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import lsq_linear

from trajectory_calibration.errors import SolverError
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.likelihood import (
    evaluate,
    Evaluation,
    global_likelihood,
    GlobalLikelihood,
    objective,
    predict_step,
)
from trajectory_calibration.solvers.drift_aware.model import (
    Chain,
    columns_of,
    IndexArray,
    linearise,
    PARAMETERS,
    State,
    TERM_COLUMNS,
)
from trajectory_calibration.solvers.drift_aware.noise import COMPONENTS, Noise, WHITE
from trajectory_calibration.solvers.drift_aware.noise_checks import check_lags, LagCheck

# The largest change of a log variance in one step, up and down.
_LARGEST_RISE, _LARGEST_FALL = 1.5, 2.5
# A variance whose score is below this hardly acts.
_SMALL_SCORE = 0.1
# A variance with less information than this about its logarithm has vanished; it comes back where
# the objective gains this from it, by one of these shares of the change that its slope foretells.
_VANISHED, _WORTH_REVIVING = 1.0, 0.5
_SHARES_REVIVED = (0.5, 0.75, 1.0)
# Steps shrink from one to the next by this at least: what they wander by beside is no pace.
_SLOWEST_PACE = 0.5
# Added to correlations of the variances, two of which may be the same.
_RIDGE = 1e-3
# A trust that was lost grows by this factor in every step that does not turn; by less than the
# root of two, so that what turns every other step loses more of it than it regains.
_REGAINED_BY_VARIANCES, _REGAINED_BY_JUMPS = 1.3, 1.4
# Room that a variance at its limit keeps, because limits must differ.
_NEXT_TO_NOTHING = 1e-9
# Converged: parameters, and what the next step of the variances would do to them, move by less
# than this share of their standard deviation, and that deviation by less than that share of
# itself. None of it tightens with the number of poses.
SMALL_STEP, SMALL_CHANGE = 0.03, 0.02
# The largest step of a global term in one iteration (one, metres a metre, seconds).
_LARGEST_TERM_STEP = {'scale': 0.2, 'systematic_drift': 0.05, 'time_offset': 0.05}
# A drift of this much per metre is no drift: the model's step has no length.
_LARGEST_DRIFT = 0.5


class RunawayScaleError(SolverError):
    """The scale went where no scale is: the motion does not hold it."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A minimum of the objective, or where the iterations ended.

    Attributes
    ----------
    chain, state, noise : the data, the unknowns, the noise.
    terms : names of the global terms that were estimated.
    evaluation : at the state, or where it converged one negligible step before it.
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

    @cached_property
    def likelihood(self) -> GlobalLikelihood:
        """Return what the data say here of all global parameters, estimated or not."""
        return global_likelihood(
            self.chain, self.state, self.noise, 0.5 * self.evaluation.position_traces)

    @cached_property
    def lags(self) -> LagCheck:
        """Return what short and long motions say of the noise that was found."""
        return check_lags(self.chain, self.state, self.noise)


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
    max_iterations: int = 40,
    tolerance: float = 1.0,
    smallest_gain: float = np.inf,
) -> Fit:
    """Minimise over bodies, extrinsic, terms, variances and jumps, from a state and a noise.

    ``tolerance`` multiplies the limits below which a step counts as negligible; beside them the
    objective must move by less than ``smallest_gain`` where objectives will be compared.

    Raises
    ------
    SolverError
        The equations cannot be solved: numbers out of range.

    """
    columns = columns_of(terms)
    progress = _Progress()
    of_variances, of_jumps = (
        Trust(len(COMPONENTS), _REGAINED_BY_VARIANCES),
        Trust(noise.jump_probability.shape, _REGAINED_BY_JUMPS))
    # Three equations of translation a step, half of them for b.
    power = 1.5 * (len(chain) - 1)
    first_scale = state.scale
    asked = False
    for iteration in range(1, max_iterations + 1):
        if not 0.5 < state.scale / first_scale < 2:
            raise RunawayScaleError(
                f'drift_aware: the scale runs away ({state.scale / first_scale:.2f} times what '
                'the trajectories span); needed steps longer than their noise, or scale fixed')
        evaluation = _evaluate(chain, state, noise, columns, power)
        power = 0.5 * evaluation.position_traces
        wished = variance_step(evaluation, noise.log_variances - noise.lowest())
        judged = noise.with_jumps(evaluation.walk_squares, evaluation.walk_spread)
        narrow = noise.walk_parts().sum(axis=0)
        remaining, gain = progress.judge(
            evaluation, wished, judged.walk_precision(narrow) - noise.walk_precision(narrow))
        # A step that is as good as nothing is taken too: its rest is of second order.
        state = _moved(state, evaluation.body_response, evaluation.parameter_step, columns)
        done = remaining < tolerance and gain < smallest_gain
        better = None
        # Asked once within a standard deviation of the end: later it would cost settling twice.
        if done or (remaining * SMALL_STEP < 1 and not asked):
            asked = True
            better = _revived(chain, state, noise, columns, evaluation, power)
        if better is not None:
            noise = better
        elif done:
            return Fit(chain, state, noise, tuple(terms), evaluation, iteration, converged=True)
        else:
            noise = replace(judged, jump_probability=noise.jump_probability + of_jumps.damped(
                judged.jump_probability - noise.jump_probability))
            noise = noise.with_log_variances(noise.log_variances + of_variances.damped(wished))
    evaluation = _evaluate(chain, state, noise, columns, power)
    return Fit(chain, state, noise, tuple(terms), evaluation, max_iterations, converged=False)


class _Progress:
    """How far a fit may still go, from one iteration to the next."""

    def __init__(self) -> None:
        self._objective, self._size = np.inf, np.inf
        self._deviation: FloatArray | None = None

    def judge(
        self, evaluation: Evaluation, wished: FloatArray, reweighted: FloatArray,
    ) -> tuple[float, float]:
        """Return what remains, one where it is just negligible, and the change of the objective.

        ``wished`` (6,) is the next step of the log variances, ``reweighted`` (N - 1, 2) that of
        the precision of each step of the walk, as another one becomes a jump.
        """
        deviation = np.sqrt(np.diag(evaluation.covariance))
        size = float((np.abs(evaluation.parameter_step) / deviation).max())
        # Steps that shrink by a factor add up to a geometric series.
        pace = min(size / self._size, _SLOWEST_PACE) if self._size > 0 else 0.0
        by_variances = np.abs(evaluation.sensitivity @ np.maximum(wished, -1.0)) / deviation
        by_jumps = np.abs(evaluation.covariance @ np.tensordot(
            reweighted, evaluation.leverage, 2)) / deviation
        change = (np.inf if self._deviation is None
                  else float(np.abs(np.log(deviation / self._deviation)).max()))
        gain = abs(self._objective - evaluation.objective)
        self._objective, self._size, self._deviation = evaluation.objective, size, deviation
        moved = max(size / (1 - pace), float(by_variances.max()), float(by_jumps.max()))
        return max(moved / SMALL_STEP, change / SMALL_CHANGE), gain


def settled(chain: Chain, state: State, noise: Noise, terms: Sequence[str]) -> State:
    """Return the state after one step of everything but the noise.

    From a state whose bodies were not fitted, what is of second order in their step would pass
    for a walk or for jumps.
    """
    columns = columns_of(terms)
    step, response = predict_step(chain, state, noise, columns, 1.5 * (len(chain) - 1))
    return _moved(state, response, step, columns)


def scale_covariance(
    covariance: FloatArray, position_traces: float, columns: IndexArray, scale: float,
) -> FloatArray:
    """Return a (m, m) covariance without the information that is only noise of the steps.

    Noise in the derivative by the scale adds ``T / s^2`` to its information, T half of the
    ``position_traces``.
    """
    place = np.flatnonzero(columns == TERM_COLUMNS['scale'].start)
    if not len(place):
        return covariance
    column = covariance[:, place]
    variance = float(covariance[place, place][0])
    # Near nothing but noise, keep the result finite.
    false_share = min(0.5 * position_traces / scale**2 * variance, 0.7)
    corrected: FloatArray = covariance + column @ column.T * (
        false_share / variance / (1 - false_share))
    return corrected


def variance_step(evaluation: Evaluation, room: FloatArray) -> FloatArray:
    """Return the (6,) step of the log variances, downhill on the restricted likelihood.

    It minimises the quadratic model in a box: what a variance at its limit leaves over is for
    the others to explain. They may fall by (6,) ``room`` at most.
    """
    score, information = evaluation.score, evaluation.score_information
    eigenvalues, axes = np.linalg.eigh(information)
    root = np.sqrt(np.maximum(eigenvalues, 1e-8 * eigenvalues[-1] + 1e-3))
    lowest = -np.clip(room, 0.0, _LARGEST_FALL)
    # Where a variance hardly acts, slope and curvature vanish together: do not leap.
    highest = np.where(np.abs(score) < _SMALL_SCORE, 0.0, _LARGEST_RISE)
    step: FloatArray = lsq_linear(
        root[:, None] * axes.T, -0.5 * axes.T @ score / root,
        (lowest - _NEXT_TO_NOTHING, highest + _NEXT_TO_NOTHING), method='bvls').x
    return step


def missed_variances(evaluation: Evaluation) -> FloatArray:
    """Return (6,) changes of the log variances for those that should not have vanished.

    The likelihood is smooth in a variance near zero, though not in its logarithm: slope and
    curvature by the walk's variances, everything else free to follow, say where it would be. For
    vanished white noise they are differences of large numbers, and nothing but rounding.
    """
    score, information = evaluation.score, evaluation.score_information
    own = np.maximum(np.diag(information), np.finfo(float).tiny)
    root = np.sqrt(own)
    correlation = information / np.outer(root, root) + _RIDGE * np.eye(len(score))
    alone = own / np.diag(np.linalg.inv(correlation))
    factor = -0.5 * score / alone
    missed = (own < _VANISHED) & (score**2 > 4 * alone * _WORTH_REVIVING) & (factor > 1)
    missed[:WHITE] = False
    return np.where(missed, np.log(np.maximum(factor, 1.0)), 0.0)


class Trust:
    """How much of a step is taken, element by element: less after every change of direction."""

    def __init__(self, shape: int | tuple[int, ...], regained: float) -> None:
        self._regained = regained
        self._share = np.ones(shape)
        self._last = np.zeros(shape)

    def damped(self, step: FloatArray) -> FloatArray:
        """Return the trusted share of a step."""
        turned = step * self._last < 0
        regained = np.minimum(self._regained * self._share, 1.0)
        self._share = np.where(turned, 0.5 * self._share, regained)
        self._last = step
        return self._share * step


def _revived(
    chain: Chain, state: State, noise: Noise, columns: IndexArray, evaluation: Evaluation,
    power: float,
) -> Noise | None:
    """Return the noise with variances that should not have vanished, or None where all is well.

    The slope says that a variance is missed, but not well how much of it, with the others as
    they are: of some shares of the change, in logarithms, the one with the smallest objective is
    taken, if it is smaller than without.
    """
    missed = missed_variances(evaluation)
    if not missed.any():
        return None
    best, smallest = None, evaluation.objective - _WORTH_REVIVING
    for share in _SHARES_REVIVED:
        better = noise.with_log_variances(noise.log_variances + share * missed)
        with suppress(np.linalg.LinAlgError):
            found = objective(chain, state, better, columns, power)
            if found < smallest:
                best, smallest = better, found
    return best


def _moved(
    state: State, response: FloatArray, step: FloatArray, columns: IndexArray,
) -> State:
    parameters = np.zeros(PARAMETERS)
    parameters[columns] = step
    # Terms that the data hardly tell from the motion may overshoot: shorten the whole step.
    longest = max(np.abs(parameters[TERM_COLUMNS[name]] / limit).max()
                  for name, limit in _LARGEST_TERM_STEP.items())
    step = step / max(1.0, longest)
    parameters /= max(1.0, longest)
    bodies = -(response[:, :, -1] + response[:, :, :-1] @ step)
    return state.moved(parameters, bodies)


def _evaluate(
    chain: Chain, state: State, noise: Noise, columns: IndexArray, power: float,
) -> Evaluation:
    reason = None
    needed = 'trajectories of one vehicle in metres; check units and frames, or try dnlo'
    if np.linalg.norm(state.systematic_drift) > _LARGEST_DRIFT or state.scale <= 0:
        reason = f'scale {state.scale:.3g}, drift {np.round(state.systematic_drift, 3)} a metre'
        if {*columns_of(('scale', 'systematic_drift'))} <= {*columns}:
            needed = ('scale_mode or systematic_drift_mode auto, because they are the same where '
                      'a vehicle drives forward')
    else:
        try:
            evaluation = evaluate(chain, state, noise, columns, power)
        except np.linalg.LinAlgError as error:
            reason = str(error)
        else:
            if np.isfinite(evaluation.objective):
                return evaluation
            reason = 'numbers out of range'
    raise SolverError(f'drift_aware: the equations of {len(chain)} poses cannot be solved '
                      f'({reason}); needed {needed}')
