"""The extrinsic's covariance over all hypotheses about the global terms, each by its probability.

Whether b has an error of scale, a steady drift or a clock offset is a matter of degree: a term
just short of being proven moves the extrinsic as far as one that just is. A drift across the
motion, moreover, cannot be told from a turned sensor; all that is known of it is that it is
probably no larger than what shows along the motion. Both follow from one prior. A term is absent,
or its components are normal with a common deviation sigma that is itself unknown, which makes
them Cauchy variables, the same in all axes. Scale and drift, where both are there, share their
sigma: the one tells how large the other is likely to be. For each sigma everything is Gaussian
and in closed form about the linearisation at the answer; the sum over the hypotheses is

    P = sum_m w_m (P_m + (x_m - x)(x_m - x)^T),

about the answer x itself (J. A. Hoeting, D. Madigan, A. E. Raftery, C. T. Volinsky, Statistical
Science 14(4), 1999, doi:10.1214/ss/1009212519).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from trajectory_calibration.se3 import FloatArray
from trajectory_calibration.solvers.drift.fit import without_information
from trajectory_calibration.solvers.drift.model import EXTRINSIC, IndexArray, State, TERM_COLUMNS
from trajectory_calibration.solvers.drift.selection import (
    PRIOR_SCALE,
    RIVALS,
    SUPPORT,
    term_columns,
    value_of,
)

# A Cauchy variable is a normal one divided by the size of another: equally probable sizes.
_SIZES = 12
_SIGMAS = np.array([
    1 / NormalDist().inv_cdf(0.5 + 0.5 * (k + 0.5) / _SIZES) for k in range(_SIZES)])
# Terms that share their deviation.
_Group = tuple[str, ...]
# That a term, or both of two rivals, are absent before the data speak: what makes the Bayes
# factor from which a term is taken in the one from which it is the more probable.
_ABSENT = SUPPORT / (1 + SUPPORT)


@dataclass(frozen=True, eq=False)
class Gaussian:
    """The likelihood of the global parameters about a state.

    Attributes
    ----------
    columns : (m,), which they are.
    mean : (m,), the step to the most likely values.
    covariance : (m, m).

    """

    columns: IndexArray
    mean: FloatArray
    covariance: FloatArray


def average(
    found: Gaussian, state: State, optional: Sequence[str], false_information: float,
) -> FloatArray:
    """Return the (6, 6) covariance of the extrinsic about that of the state.

    ``false_information`` is what noise adds to the information about the scale; terms that are in
    ``found`` but not ``optional`` are in every hypothesis.
    """
    log_weights, moments = [], []
    for groups, prior in _hypotheses(optional):
        terms = [name for group in groups for name in group]
        absent = np.concatenate([
            term_columns(found.columns, name) for name in optional if name not in terms]
            or [np.zeros(0, np.intp)])
        null = -np.concatenate(
            [value_of(state, name) for name in optional if name not in terms] or [np.zeros(0)])
        rest, log_evidence = _conditioned(found, absent, null)
        if 'scale' in terms:
            rest = replace(rest, covariance=without_information(
                rest.covariance, term_columns(rest.columns, 'scale'), false_information))
        place = np.concatenate([term_columns(rest.columns, name) for name in terms]
                               or [np.zeros(0, np.intp)])
        value = np.concatenate([value_of(state, name) for name in terms] or [np.zeros(0)])
        variances = _prior_variances(groups)
        # Measured: a term of zero, with the variance of its prior.
        total = (rest.covariance[np.ix_(place, place)]
                 + variances[:, :, None] * np.eye(len(place)))
        value = value + rest.mean[place]
        across = rest.covariance[EXTRINSIC, place]
        gain = np.linalg.solve(total, np.broadcast_to(across.T, (len(total), len(place), 6)))
        step = rest.mean[EXTRINSIC] - value @ gain
        covariance = rest.covariance[EXTRINSIC, EXTRINSIC] - across @ gain
        log_weights.append(np.log(prior / len(total)) + log_evidence + _log_normal(value, total))
        moments.append(covariance + step[:, :, None] * step[:, None, :])
    log_weight = np.concatenate(log_weights)
    weight = np.exp(log_weight - log_weight.max())
    result: FloatArray = np.tensordot(weight / weight.sum(), np.concatenate(moments), 1)
    return 0.5 * (result + result.T)


def _hypotheses(optional: Sequence[str]) -> list[tuple[tuple[_Group, ...], float]]:
    """Return which groups of optional terms are there, with probabilities."""
    hypotheses: list[tuple[tuple[_Group, ...], float]] = [((), 1.0)]
    rivals = tuple(name for name in RIVALS if name in optional)
    slots = [rivals, *((name,) for name in optional if name not in RIVALS)]
    for slot in filter(None, slots):
        # One of them, or all.
        groups = {slot, *((name,) for name in slot)}
        choices = [((), _ABSENT), *(((group,), (1 - _ABSENT) / len(groups)) for group in groups)]
        hypotheses = [(present + chosen, prior * probability)
                      for present, prior in hypotheses for chosen, probability in choices]
    return hypotheses


def _prior_variances(groups: Sequence[_Group]) -> FloatArray:
    """Return (k, g): equally probable prior variances of the components of all terms."""
    grids = np.meshgrid(*(_SIGMAS**2 for _ in groups), indexing='ij')
    scales = [np.concatenate([np.full(_size(name), PRIOR_SCALE[name]**2) for name in group])
              for group in groups]
    components = [grid.reshape(-1, 1) * scale for grid, scale in zip(grids, scales, strict=True)]
    return np.concatenate(components, axis=1) if components else np.zeros((1, 0))


def _size(name: str) -> int:
    return TERM_COLUMNS[name].stop - TERM_COLUMNS[name].start


def _conditioned(
    found: Gaussian, fixed: IndexArray, value: FloatArray,
) -> tuple[Gaussian, float]:
    """Return the rest where some parameters have a value, and its log density."""
    others = np.setdiff1d(np.arange(len(found.columns)), fixed)
    spread = found.covariance[np.ix_(fixed, fixed)]
    gain = np.linalg.solve(spread, found.covariance[np.ix_(fixed, others)]).T
    off = value - found.mean[fixed]
    rest = Gaussian(
        found.columns[others],
        found.mean[others] + gain @ off,
        found.covariance[np.ix_(others, others)] - gain @ found.covariance[np.ix_(fixed, others)])
    return rest, float(_log_normal(off, spread))


def _log_normal(value: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the log density of (n,) values at (..., n, n) covariances, but for constants."""
    column = np.broadcast_to(value[:, None], (*covariance.shape[:-1], 1))
    solved = np.linalg.solve(covariance, column)
    density: FloatArray = -0.5 * (solved[..., 0] @ value + np.linalg.slogdet(covariance)[1])
    return density
