"""Do short and long motions say the same? A check of the noise model that was identified.

Every lag n has an answer of its own: least squares over the motions from pose k to k + n, as dnl
weighs them. White noise and a walk throw it off the most likely answer by amounts that follow
from the model, pose by pose and step by step, so that the difference is chi-squared with six
degrees of freedom. Noise that is neither (bounded drift, errors that go on for seconds or come
back in every turn) shows as lags that disagree by more.

The most likely answer is efficient under the model, so that the covariance of the difference is
that of the lag's answer less its own (J. A. Hausman, Econometrica 46(6), 1978,
doi:10.2307/1913827). The lag's own is used, which is never too small: in directions that only
noise excites, on flat ground, both are too small and nothing would be left of their difference.

A motion is known as noisily as its poses are, and that noise is in the disagreement as well
(errors in variables). With e the disagreement of a motion, M what carries errors from its start
to its end, ``J = I - M`` the derivative, W weights and ``H = sum J^T W J``, a lag answers
``-H^-1 sum J^T W e``. Noise y of the poses, in their axes, is ``ad(y_end) M - M ad(y_start)`` of
J and, where it is b's, ``-(y_end - M y_start)`` of e. Of the mean of ``dJ^T W de`` nothing is left
but that the rotation noise of the start, s_r, turns where the motion led:

    b = H^-1 (2 s_r^2 sum p, 0),    p the way from start to end in the axes of the start.

That holds however much of the noise the fit has smoothed: the error of the most likely poses is
not correlated with the data, so that what correlates is what the model takes for part of the
pose, the noise of b. Which sensor's it is, is not known, and ``UNKNOWN_SHARE b b^T`` is added to
the covariance; the answer of the lag stays.

Lags do not show errors that stay the same in the sensor for seconds, and are bounded: to all of
them that is another extrinsic. A walk is identified from how fast such errors change, and then
they do not accumulate. ``check_walk`` compares what the rotations disagree by over a quarter of
the drive with what white noise and walk make of it. The mean square is a quadratic form of normal
variables and taken for chi-squared with as many degrees of freedom as its variance says (F. E.
Satterthwaite, Biometrics Bulletin 2(6), 1946, doi:10.2307/3002019).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtr

from trajectory_calibration.data.findings import Finding
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.model import (
    Chain,
    columns_of,
    IndexArray,
    linearise,
    State,
)
from trajectory_calibration.solvers.drift_aware.noise import Noise, UNKNOWN_SHARE, WHITE

# Poses that a motion spans; at least four motions of a lag must fit one after the other.
LAGS = (1, 2, 5, 10, 20, 50)
_MOTIONS = 4
# Of long drives, this many stretches of consecutive poses, evenly spread.
_STRETCHES, _STRETCH = 8, 2500
# Chi-squared of six degrees of freedom that chance exceeds once in forty, and once in three
# hundred: with six lags, one data set in fifty would be suspected wrongly. Between the two the
# evidence counts by degrees, so that no answer hangs on which side of a limit it falls.
_DOUBTFUL, SIGNIFICANT = 14.45, 19.55
# The walk is judged over this share of the drive, by as many motions, where at least so much of
# what they should disagree by is the walk's, and a quarter has so many poses.
_SPAN, _SPANNING, _WALK_SHARE, _SHORTEST = 0.25, 200, 0.5, 10
# It does not accumulate where chance makes it so small once in a hundred, and no more than half
# of the mean square is there: what else a model has wrong is no news.
_TOO_SMALL, _LARGEST_RATIO = 0.01, 0.5
# Weights of square metres and square radians: nine entries of a rotation move by sqrt(2) a radian.
_WEIGHTS = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])


@dataclass(frozen=True, eq=False)
class LagCheck:
    """The lag whose answer is the farthest from the most likely one, measured by the model.

    Attributes
    ----------
    lag : poses.
    difference : (6,), the lag's answer less the most likely one, right perturbation.
    covariance : (6, 6), what the identified noise predicts for it, or more.
    statistic : chi-squared of six degrees of freedom.

    """

    lag: int
    difference: FloatArray
    covariance: FloatArray
    statistic: float

    @property
    def excess(self) -> float:
        """Return how many times larger variances are than the model says; 1 without evidence."""
        return 1.0 + (self.statistic / 6 - 1.0) * float(
            np.clip((self.statistic - _DOUBTFUL) / (SIGNIFICANT - _DOUBTFUL), 0.0, 1.0))

    def findings(self, T_a_b: FloatArray) -> tuple[Finding, ...]:
        """Return a sentence where the lags disagree: what stands out most, along the axes of a."""
        if self.statistic < SIGNIFICANT:
            return ()
        turn = np.kron(np.eye(2), T_a_b[:3, :3])
        difference = turn @ self.difference
        deviation = np.sqrt(np.maximum(np.diag(turn @ self.covariance @ turn.T), 0.0))
        ratio = np.abs(difference) / np.maximum(deviation, np.finfo(float).tiny)
        k = int(ratio.argmax())
        found = (f'move b by {difference[k]:+.2g} m along' if k < 3 else
                 f'turn b by {np.rad2deg(difference[k]):+.2g} deg about')
        sentence = Finding(
            'scales-disagree',
            f'short and long motions disagree: those over {self.lag} poses alone would {found} '
            f'{"xyz"[k % 3]} of a, {ratio[k]:.1f} times what the identified noise makes likely; '
            'it is neither white nor a walk, so the stated deviations were enlarged, to at least '
            f'{np.sqrt(self.excess):.1f} times what it explains',
            {'lag_poses': self.lag, 'sigmas': float(ratio[k])})
        return (sentence,)


def check_lags(chain: Chain, state: State, noise: Noise) -> LagCheck:
    """Compare the answers of all lags with the most likely one; return the worst."""
    poses, bodies, disagreement, white, walk = _disagreement(chain, state, noise)
    checks = []
    for lag in LAGS:
        if lag > 1 and lag * _MOTIONS > len(chain):
            break
        start = np.flatnonzero(poses[lag:] - poses[:-lag] == lag)
        end = start + lag
        to_end = se3.adjoint(se3.inverse(bodies[end]))
        jacobian = np.eye(6) - to_end @ se3.adjoint(bodies[start])
        way = bodies[start, :3, :3].transpose(0, 2, 1) @ (
            bodies[end, :3, 3] - bodies[start, :3, 3])[..., None]
        weighted = _WEIGHTS[:, None] * jacobian
        inverse = np.linalg.pinv(np.tensordot(weighted, jacobian, ((0, 1), (0, 1))), rcond=1e-12)
        # What an error in the world at either end does to the answer.
        effect = -inverse @ weighted.transpose(0, 2, 1) @ to_end
        by_pose = np.zeros((len(poses), 6, 6))
        by_pose[end] = effect
        by_pose[start] -= effect
        difference = np.einsum('kij,kj->i', by_pose, disagreement)
        # A step moves all poses after it.
        by_step = -np.cumsum(by_pose, axis=0)[:-1]
        covariance = _gram(by_pose @ white) + _gram(by_step @ walk)
        bias = inverse[:, :3] @ (2 * noise.variances[1] * way.sum(axis=(0, 2)))
        covariance += UNKNOWN_SHARE * np.outer(bias, bias)
        checks.append(
            LagCheck(lag, difference, covariance, _chi_squared(difference, covariance)))
    return max(checks, key=lambda check: check.statistic)


@dataclass(frozen=True)
class WalkCheck:
    """Whether the rotations drift apart over a quarter of the drive as the walk would have it.

    Attributes
    ----------
    ratio : mean square of what they disagree by, divided by what the noise predicts.
    probability : that noise of the model has a ratio as small.
    walk_share : of what is predicted; the rest is white noise.
    disagreement : root of the mean square, radians.

    """

    ratio: float
    probability: float
    walk_share: float
    disagreement: float

    @property
    def is_bounded(self) -> bool:
        """Tell whether a walk was identified that does not accumulate."""
        return (self.walk_share > _WALK_SHARE and self.probability < _TOO_SMALL
                and self.ratio < _LARGEST_RATIO)

    def findings(self) -> tuple[Finding, ...]:
        """Return a sentence where the errors are bounded."""
        if not self.is_bounded:
            return ()
        degrees = np.rad2deg(self.disagreement)
        sentence = Finding(
            'errors-bounded',
            'the errors of the two do not add up as a walk would: over a quarter of the drive '
            f'their rotations part by {degrees:.2g} deg instead of '
            f'{degrees / np.sqrt(self.ratio):.2g}; they are bounded and go on for seconds, as of '
            'GNSS/INS or of a SLAM with loop closures, and the stated deviations may be several '
            'times too small: compare the answers of several drives', {'ratio': self.ratio})
        return (sentence,)


def check_walk(chain: Chain, state: State, noise: Noise) -> WalkCheck | None:
    """Compare long motions with the walk that was identified; None where the drive is short."""
    _, _, disagreement, _, _ = _disagreement(chain, state, noise)
    # Steps that jump have no part in it: a pose that is wrong jumps away and back.
    # What is held at its limit so that the equations can be solved was not found in the data.
    found = (noise.log_variances > noise.lowest())[WHITE + 1::2]
    variance = found @ noise.walk_parts()[:, :, 1]
    white = 2 * float(noise.variances[1])
    squares = expected = by_walk = spread = 0.0
    count = 0
    first = 0
    for part in _stretches(len(chain)):
        n = len(part)
        span = int(_SPAN * n)
        if span < _SHORTEST:
            return None
        rotation = disagreement[first:first + n, 3:]
        first += n
        walked = np.concatenate([[0.0], np.cumsum(variance[part[:-1]])])
        start = np.unique(np.linspace(0, n - span - 1, _SPANNING).astype(np.intp))
        end = start + span
        squares += float(np.square(rotation[end] - rotation[start]).sum())
        # Of two motions: the walk of the steps in both, and the noise of ends in both.
        common = np.maximum(
            walked[np.minimum.outer(end, end)] - walked[np.maximum.outer(start, start)], 0.0)
        by_walk += 3 * float(np.trace(common))
        common += white * (2.0 * np.eye(len(start)) - np.equal.outer(start, end)
                           - np.equal.outer(end, start))
        expected += 3 * float(np.trace(common))
        spread += 3 * float(np.square(common).sum())
        count += len(start)
    ratio, freedom = squares / expected, expected**2 / spread
    return WalkCheck(ratio, float(chdtr(freedom, freedom * ratio)), by_walk / expected,
                     float(np.sqrt(squares / count)))


def _disagreement(
    chain: Chain, state: State, noise: Noise,
) -> tuple[IndexArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return what a and b disagree by at n poses, all of a short drive.

    The indices (n,); b's poses (n, 4, 4) near the origin, with their white noise where the fit
    found no walk, smoothed where it did; the (n, 6) disagreement, in the axes of the world, up to
    a constant for each stretch; and roots (n, 6, 6) and (n - 1, 6, 6) of the covariances of white
    noise and walk in those axes.
    """
    stretches = _stretches(len(chain))
    poses = np.concatenate(stretches)
    pieces = [linearise(chain, state, columns_of(()), part[0], part[-1] + 1)
              for part in stretches]
    observed = np.concatenate([piece.observation[:, :, -1] for piece in pieces])
    # The steps of a stretch; the last of all but the last leads out of it, and acts on nothing.
    walked = np.concatenate([piece.walk[:, :, -1] for piece in pieces])[:len(poses) - 1]
    bodies = state.bodies[poses]
    bodies = se3.inverse(bodies[len(bodies) // 2]) @ bodies
    turn = se3.adjoint(bodies)
    after = turn[1:]
    disagreement = -np.einsum('kij,kj->ki', turn, observed)
    disagreement[1:] += np.cumsum(np.einsum('kij,kj->ki', after, walked), axis=0)
    white = turn @ np.linalg.cholesky(noise.white_parts(state.T_a_b).sum(axis=0))
    precision = noise.walk_precision(noise.walk_parts().sum(axis=0))[poses[:-1]]
    walk = after * np.repeat(1 / np.sqrt(precision), 3, axis=1)[:, None, :]
    return poses, bodies, disagreement, white, walk


def _stretches(count: int) -> list[IndexArray]:
    """Return runs of consecutive indices below ``count``: all of them, or evenly spread."""
    if count <= _STRETCHES * _STRETCH:
        return [np.arange(count)]
    first = np.linspace(0, count - _STRETCH, _STRETCHES).astype(np.intp)
    return [np.arange(i, i + _STRETCH) for i in first]


def _chi_squared(difference: FloatArray, covariance: FloatArray) -> float:
    """Return ``d^T C^-1 d`` over the directions in which a lag says anything."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    unit = difference / deviation
    correlation = covariance / np.outer(deviation, deviation)
    return float(unit @ np.linalg.pinv(correlation, rcond=1e-12, hermitian=True) @ unit)


def _gram(roots: FloatArray) -> FloatArray:
    """Return ``sum E E^T`` of (n, 6, 6)."""
    gram: FloatArray = np.tensordot(roots, roots, ((0, 2), (0, 2)))
    return gram
