"""The extrinsic's covariance over all hypotheses about the global terms, each by its probability.

Whether b has an error of scale, a steady drift or a clock offset is a matter of degree: a term
just short of being proven moves the extrinsic as far as one that just is. A drift across the
motion, moreover, cannot be told from a turned sensor; all that is known of it is that it is
probably no larger than what shows along the motion. Both follow from one prior. A term is absent,
or its components are normal with a common deviation sigma that is itself unknown, which makes
them Cauchy variables, the same in all axes. Where there is a scale, the drift that takes its place
has a component as large along the motion, which tells its sigma. For each sigma everything is
Gaussian and in closed form about the linearisation at the answer; the sum over all hypotheses is

    P = sum_m w_m (P_m + (x_m - x)(x_m - x)^T),

about the answer x itself (J. A. Hoeting, D. Madigan, A. E. Raftery, C. T. Volinsky, Statistical
Science 14(4), 1999, doi:10.1214/ss/1009212519).
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.model import (
    EXTRINSIC,
    IndexArray,
    State,
    TERM_COLUMNS,
)
from trajectory_calibration.solvers.drift_aware.selection import (
    PRIOR_SCALE,
    SUPPORT,
    term_columns,
    value_of,
)

# A Cauchy variable is a normal one divided by the size of another: equally probable sizes.
_SIZES = 12
# Zero is a term that is absent.
_SIGMAS = np.array([0.0, *(
    1 / NormalDist().inv_cdf(0.5 + 0.5 * (k + 0.5) / _SIZES) for k in range(_SIZES))])
# That a term is absent before the data speak: what makes the Bayes factor from which a term is
# taken in the one from which it is the more probable.
_ABSENT = SUPPORT / (1 + SUPPORT)
_LOG_PRIOR = np.log([_ABSENT, *[(1 - _ABSENT) / _SIZES] * _SIZES])


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


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """All combinations of the sigmas of up to two terms.

    Attributes
    ----------
    log_evidence : (k, l), up to a constant; the first row and column are terms that are absent.
    log_prior : (k, l).
    held : (l,), the evidence with the term as it is in the state.
    moments : (k, l, 6, 6), of the extrinsic about that of the state.

    """

    log_evidence: FloatArray
    log_prior: FloatArray
    held: FloatArray
    moments: FloatArray

    def mean(self) -> FloatArray:
        """Return the (6, 6) moments weighed by the probability of each hypothesis."""
        log_weight = self.log_evidence + self.log_prior
        weight = np.exp(log_weight - log_weight.max())
        mean: FloatArray = np.tensordot(weight / weight.sum(), self.moments, 2)
        return 0.5 * (mean + mean.T)


def weigh(
    found: Gaussian,
    state: State,
    term: str | None,
    time_offset: str | None,
    taken_over: FloatArray | float = 0.0,
) -> Hypotheses:
    """Weigh what one term, and a clock offset, may be; None is a term that is not in doubt.

    ``taken_over`` is the value of the term that does what its rival does in the state.
    """
    names = [name for name in (term, time_offset) if name is not None]
    place = np.concatenate([term_columns(found.columns, name) for name in names])
    value = np.concatenate([value_of(state, name) for name in names]) + found.mean[place]
    sigmas = [_SIGMAS if name is not None else np.zeros(1) for name in (term, time_offset)]
    variances = np.zeros((len(sigmas[0]), len(sigmas[1]), len(place)))
    first = 0
    for name, grid in zip((term, time_offset), np.meshgrid(*sigmas, indexing='ij'), strict=True):
        if name is not None:
            size = TERM_COLUMNS[name].stop - TERM_COLUMNS[name].start
            variances[:, :, first:first + size] = (PRIOR_SCALE[name] * grid[:, :, None])**2
            first += size
    as_it_is = value.copy()
    if term is not None:
        own = slice(0, TERM_COLUMNS[term].stop - TERM_COLUMNS[term].start)
        as_it_is[own] = found.mean[place[own]]
        value[own] += taken_over
    # Measured: a term of zero, with the variance of its prior.
    prior = variances[..., None] * np.eye(len(place))
    total = found.covariance[np.ix_(place, place)] + prior
    across = found.covariance[EXTRINSIC, place]
    gain = across @ np.linalg.inv(total)
    step = found.mean[EXTRINSIC] - gain @ value
    # In Joseph's form: the difference of two large matrices may leave less than nothing.
    taken = np.zeros((*gain.shape[:-1], len(found.columns)))
    taken[..., EXTRINSIC] = np.eye(6)
    taken[..., place] = -gain
    covariance = (taken @ found.covariance @ np.swapaxes(taken, -1, -2)
                  + gain @ prior @ np.swapaxes(gain, -1, -2))
    priors = [_LOG_PRIOR if name is not None else np.zeros(1) for name in (term, time_offset)]
    return Hypotheses(
        log_evidence=_log_normal(value, total),
        log_prior=priors[0][:, None] + priors[1],
        held=_log_normal(as_it_is, total[0]),
        moments=covariance + step[..., :, None] * step[..., None, :],
    )


def joined(scale: Hypotheses, drift: Hypotheses) -> Hypotheses:
    """Return the hypotheses of two rivals, half of the prior that a term is there for each."""
    half = scale.log_prior.copy()
    half[1:] -= np.log(2.0)
    # Both are about the same state, which ties their constants.
    instead = drift.log_evidence[1:] - drift.held + scale.held
    return Hypotheses(
        np.concatenate([scale.log_evidence, instead]),
        np.concatenate([half, half[1:]]),
        scale.held,
        np.concatenate([scale.moments, drift.moments[1:]]))


def drift_for_scale(steps: FloatArray, scale: float) -> FloatArray:
    """Return the (3,) drift that does to (n, 3) steps, all along one axis, what a scale does."""
    forward = steps.sum(axis=0) / max(np.linalg.norm(steps, axis=1).sum(), np.finfo(float).tiny)
    drift: FloatArray = (1 - scale) / scale * forward
    return drift


def _log_normal(value: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the log density of (n,) values at (..., n, n) covariances, but for constants."""
    quadratic = np.linalg.inv(covariance) @ value @ value
    density: FloatArray = -0.5 * (quadratic + np.linalg.slogdet(covariance)[1])
    return density
