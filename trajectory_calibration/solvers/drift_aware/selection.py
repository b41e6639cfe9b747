"""Where to start, which global terms the data support, and the final fit.

All of it happens first on a thinned chain, which has the same noise model (white noise of a
pose, walk of a metre), then on all poses, where only a few iterations are left to do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.errors import MotionError, SolverError
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers import quadratic
from trajectory_calibration.solvers.drift_aware.fit import (
    first_noise,
    Fit,
    fit,
    RunawayScaleError,
    settled,
)
from trajectory_calibration.solvers.drift_aware.model import (
    Chain,
    columns_of,
    IndexArray,
    State,
    TERM_COLUMNS,
)
from trajectory_calibration.solvers.drift_aware.noise import Noise

# Poses of the thinned chain.
COARSE = 250
# How much finer each next chain is.
_REFINEMENT = 3
# Starts: the least-squares answers of these lags (poses of the thinned chain), each with the
# share of white noise for which it would be a good one, and the iterations after which the most
# likely start goes on alone. Each of the two noises can pass for the other for a while.
_START_LAGS = {1: 0.1, 5: 0.5, 20: 0.95}
_RACE = 4
# Where terms are compared, the objective must have settled to this.
_COMPARED = 0.5
# Where a fit is only a means to a start or a choice, negligible means this many times more.
_ROUGH = 5.0
# Cauchy scale of each term before the data speak (one, metres a metre, seconds): about one
# percent and one hundredth of a second. The tails leave room for more.
PRIOR_SCALE = {'scale': 0.01, 'systematic_drift': 0.01, 'time_offset': 0.01}
# In forward motion a scale is a drift along the motion: only one of them is taken in by itself.
RIVALS = ('scale', 'systematic_drift')
# The Bayes factor from which a term is taken in, and twice its logarithm.
SUPPORT = 3.0
_SUPPORT = 2 * np.log(SUPPORT)
# Without the term its effect passes for noise, so that the prediction is too low; below this a
# fit is not worth trying.
_HOPELESS = -10.0


def estimate(pairs: PosePairs, terms: Mapping[str, str]) -> Fit:
    """Fit the model to pose pairs.

    Parameters
    ----------
    pairs : PosePairs
        At least three.
    terms : mapping
        For each of ``TERM_COLUMNS`` 'fixed' (not estimated), 'estimate', or 'auto': estimated
        where a Bayes factor of 3 supports it.

    Raises
    ------
    MotionError
        The sensors did not turn.
    SolverError
        The equations cannot be solved.

    """
    try:
        return _estimate(pairs, terms)
    except RunawayScaleError:
        if terms['scale'] != 'auto':
            raise
        # Where one sensor hardly moves, shrinking the moves of the other shrinks their noise.
        return _estimate(pairs, {**terms, 'scale': 'fixed'})


def _estimate(pairs: PosePairs, terms: Mapping[str, str]) -> Fit:
    wanted = tuple(name for name in TERM_COLUMNS if terms[name] == 'estimate')
    optional = tuple(name for name in TERM_COLUMNS if terms[name] == 'auto')
    every = max(1, len(pairs) // COARSE)
    coarse = Chain.from_pairs(pairs, every)
    best = _best_start(pairs, every, coarse)
    if wanted:
        best = _with_terms(best, wanted)
    best = _grow(best, optional)
    if every == 1:
        return fit(coarse, best.state, best.noise, best.terms)
    while every > 1:
        thinned, every = every, max(every // _REFINEMENT, 1)
        tolerance = 1.0 if every == 1 else _ROUGH
        best = _refine(best, Chain.from_pairs(pairs, every), thinned / every, tolerance)
        best = _revise(best, optional, tolerance)
    return best


def optional_terms(terms: Mapping[str, str]) -> tuple[str, ...]:
    """Return the terms that the data decide about; ``terms`` as for ``estimate``."""
    wanted = [name for name in TERM_COLUMNS if terms[name] == 'estimate']
    return tuple(name for name in TERM_COLUMNS
                 if terms[name] == 'auto' and not _excluded(name, wanted))


def _refine(best: Fit, chain: Chain, finer: float, tolerance: float) -> Fit:
    """Fit a chain with ``finer`` times as many steps, from what a coarser one found."""
    state = replace(best.state, bodies=chain.poses_a @ best.state.T_a_b)
    noise = best.noise.carried_to(chain, finer)
    state = settled(chain, state, noise, best.terms)
    return fit(chain, state, noise, best.terms, tolerance=tolerance)


def _best_start(pairs: PosePairs, every: int, chain: Chain) -> Fit:
    """Return the most likely fit over several starts, all terms fixed."""
    fits = [_tried(chain, State.start(chain, T_a_b), white_share)
            for T_a_b, white_share in _starts(pairs.thinned(every))]
    ahead = [candidate for candidate in fits if candidate is not None]
    if not ahead:
        raise SolverError(
            f'drift_aware: none of {len(fits)} starts leads anywhere with {len(chain)} poses; '
            'check that both trajectories are of one vehicle, or try dnlo')
    best = min(ahead, key=lambda candidate: candidate.evaluation.objective)
    return _compared(best, (), best.noise)


def _compared(best: Fit, terms: tuple[str, ...], noise: Noise) -> Fit:
    """Return a fit from the state of another, with an objective that can be compared."""
    return fit(best.chain, best.state, noise, terms, tolerance=_ROUGH, smallest_gain=_COMPARED)


def _tried(chain: Chain, state: State, white_share: float) -> Fit | None:
    """Return a start after a few iterations, or None where they break down."""
    try:
        return fit(chain, state, first_noise(chain, state, white_share), max_iterations=_RACE)
    except SolverError:
        return None


def _with_terms(best: Fit, terms: tuple[str, ...]) -> Fit:
    """Return the fit with the terms that the user asks for."""
    plain = _compared(best, terms, best.noise)
    try:
        revived = _compared(best, terms, best.noise.revived())
    except SolverError:
        return plain
    return min(plain, revived, key=lambda candidate: candidate.evaluation.objective)


def _starts(pairs: PosePairs) -> list[tuple[FloatArray, float]]:
    """Return extrinsics and shares of white noise: the least-squares answers of a few lags."""
    found = []
    failure: MotionError | None = None
    for lag, white_share in _START_LAGS.items():
        if len(pairs) - lag < 2:
            continue
        G = quadratic.gram(select_motions(pairs, f'B{lag}'))
        # A direction of the translation that the motion leaves free starts at zero.
        G[range(9, 12), range(9, 12)] += 1e-9 * max(float(np.trace(G[9:12, 9:12])), 1e-12)
        try:
            found.append((quadratic.minimise(G).T_a_b, white_share))
        except MotionError as error:
            failure = error
    if failure is not None and not found:
        raise failure
    return found


def _grow(best: Fit, optional: tuple[str, ...]) -> Fit:
    """Take in the optional terms one by one, the most promising first."""
    while True:
        # Lags that disagree because of what is missing are no reason not to try it.
        promised = {name: _gain_of_adding(best, name, 1.0) for name in optional
                    if not _excluded(name, best.terms)}
        # Whatever promises less than the best of its rivals is left for the next round, where
        # it would have to be tried again beside what was taken in.
        by_promise = sorted(
            _rivals([name for name in promised if promised[name] >= _HOPELESS]),
            key=lambda names: max(promised[name] for name in names), reverse=True)
        taken = next(filter(None, (_supported(best, names) for names in by_promise)), None)
        if taken is None:
            return best
        best = taken


def _supported(best: Fit, names: Sequence[str]) -> Fit | None:
    """Return the fit with one of some rivals, or None where none is supported."""
    fits = {}
    for name in names:
        # A term that the motion cannot tell from another one is not supported by it.
        with suppress(SolverError):
            fits[name] = _compared(best, (*best.terms, name), best.noise.revived())

    def choice(excess: float) -> str | None:
        return _choice({name: _gain_of_fitting(best, fits[name], name, excess) for name in fits})

    # More noise makes no term more likely: what fails without is spared the check of the lags.
    # Of their disagreement the least counts: a term that is missing makes them disagree, too.
    chosen = choice(1.0) and choice(min(found.lags.excess for found in fits.values()))
    return None if chosen is None else fits[chosen]


def _revise(best: Fit, optional: tuple[str, ...], tolerance: float) -> Fit:
    """Judge the optional terms again on a finer chain; refit where the verdict changes."""
    excess = best.lags.excess
    kept = [name for name in best.terms
            if name not in optional or _gain_of_keeping(best, name, excess) > 0]
    gains = {name: _gain_of_adding(best, name, excess) for name in optional
             if not _excluded(name, best.terms)}
    added = [_choice({name: gains[name] for name in names}) for names in _rivals([*gains])]
    terms = tuple(name for name in TERM_COLUMNS if name in kept or name in added)
    if {*terms} == {*best.terms}:
        return best
    state = best.state
    if 'scale' not in terms:
        state = replace(state, scale=1.0)
    if 'systematic_drift' not in terms:
        state = replace(state, systematic_drift=np.zeros(3))
    if 'time_offset' not in terms:
        state = replace(state, time_offset=0.0)
    return fit(best.chain, state, best.noise, terms, tolerance=tolerance)


def _rivals(names: Sequence[str]) -> list[list[str]]:
    """Return some terms in groups of those that explain the same data."""
    groups = [[name for name in names if name in RIVALS],
              *([name] for name in names if name not in RIVALS)]
    return [group for group in groups if group]


def _choice(gains: Mapping[str, float]) -> str | None:
    """Return the rival to take in, or None; ``gains`` are twice the log Bayes factors."""
    if not gains:
        return None
    # Of those that do as well, the one with fewer parameters.
    enough = max(gains.values()) - _SUPPORT
    name = min((name for name in gains if gains[name] >= enough),
               key=lambda name: TERM_COLUMNS[name].stop - TERM_COLUMNS[name].start)
    return name if gains[name] >= _SUPPORT else None


def _excluded(name: str, terms: Sequence[str]) -> bool:
    """Tell whether a term is in already, or a rival that explains the same data."""
    return name in terms or (name in RIVALS and bool(set(RIVALS) & set(terms)))


def _gain_of_adding(best: Fit, name: str, excess: float) -> float:
    """Predict twice the log Bayes factor of one more term from the slope of the likelihood.

    ``excess`` is how many times larger than identified the variances of the noise are.
    """
    columns = columns_of((*best.terms, name))
    step, covariance = best.likelihood.estimate(columns)
    place = term_columns(columns, name)
    return _wald_gain(name, step[place], covariance[np.ix_(place, place)], excess)


def _gain_of_keeping(best: Fit, name: str, excess: float) -> float:
    return _wald_gain(name, *_estimated(best, name), excess)


def _gain_of_fitting(best: Fit, found: Fit, name: str, excess: float) -> float:
    """Return twice the log Bayes factor of a fit with one more term, from both likelihoods."""
    value, covariance = _estimated(found, name)
    # The likelihoods are integrated over the parameters: the volume of the term is in theirs.
    ratio = (best.evaluation.objective - found.evaluation.objective
             - float(np.linalg.slogdet(covariance)[1]))
    return _gain(name, ratio, value, covariance, excess)


def _estimated(found: Fit, name: str) -> tuple[FloatArray, FloatArray]:
    """Return the value and the covariance of an estimated term."""
    place = term_columns(columns_of(found.terms), name)
    return value_of(found.state, name), found.evaluation.covariance[np.ix_(place, place)]


def _wald_gain(name: str, value: FloatArray, covariance: FloatArray, excess: float) -> float:
    ratio = float(value @ np.linalg.solve(covariance, value))
    return _gain(name, ratio, value, covariance, excess)


def _gain(
    name: str, ratio: float, value: FloatArray, covariance: FloatArray, excess: float,
) -> float:
    """Return twice the log Bayes factor of a term; ``ratio`` is twice the log likelihood ratio.

    Noise with variances that many times larger makes the likelihood that much flatter (the
    variance inflation factor of quasi-likelihoods; K. P. Burnham, D. R. Anderson, "Model
    Selection and Multimodel Inference", 2nd edition, 2002, section 2.5).
    """
    covariance = excess * covariance
    log_volume = float(np.linalg.slogdet(covariance)[1])
    return ratio / excess + log_volume - _prior_cost(name, value, covariance)


def _prior_cost(name: str, value: FloatArray, covariance: FloatArray) -> float:
    """Return -2 log of the Cauchy prior, less the Gaussian constant of Laplace's method.

    Where the data leave the term more open than the prior does, the volume of what is possible
    is that of both together, or nothing at all would support a term that was not measured. The
    precision of the prior is its expectation as a mixture of normals.
    """
    scale = PRIOR_SCALE[name]
    density = np.pi * scale * (1 + (value / scale)**2)
    precision = 2 / (scale**2 + value**2)
    shrunk = float(np.linalg.slogdet(np.eye(len(value)) + covariance * precision)[1])
    return float(2 * np.log(density).sum() - len(value) * np.log(2 * np.pi)) + shrunk


def value_of(state: State, name: str) -> FloatArray:
    """Return how far a term is from doing nothing."""
    values = {'scale': np.array([state.scale - 1]), 'systematic_drift': state.systematic_drift,
              'time_offset': np.array([state.time_offset])}
    return values[name]


def term_columns(columns: IndexArray, name: str) -> IndexArray:
    """Return where a term stands among the columns of some parameters."""
    wanted = TERM_COLUMNS[name]
    return np.flatnonzero((columns >= wanted.start) & (columns < wanted.stop))
