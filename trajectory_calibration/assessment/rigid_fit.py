# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""How well one rigid motion explains two trajectories, in milliseconds and by any reading of them.

No solver and no error bars: relative motions over a few lags, the rotation between the sensors
by Wahba's problem, its lever arm and scale by least squares, all of it reweighted so that jumps
count little. It answers whether two trajectories are of one body at all, and which reading of
their numbers (inverted, another order of the quaternion, mirrored) makes them so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from trajectory_calibration.assessment.motion_equations import LARGEST_TURN, Moved
from trajectory_calibration.data.motion_pairs import lag_grid
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# Lags, seconds at 10 Hz or more, those first that most recordings agree over.
LAGS_S = (2.0, 0.5, 0.2, 0.1, 8.0, 32.0)
# Beyond this lag also two sensors agree whose clocks are seconds apart: then what they do apart at
# shorter ones must be errors, which grow no more than so many times faster than independent ones.
_SHORT_S = 2.0
NOT_BY_NOISE = 1.5
# Share of the poses that the longest lag may span; motions that suffice; fewer say nothing.
_LONGEST_SHARE = 0.25
_MOTIONS, _LEAST_MOTIONS = 300, 5
# Rounds of reweighting, and those of them that find the rotation by itself.
_ROUNDS, _ALONE = 8, 2

# Squared metres and radians that are rounding.
_TINY = 1e-24

# One body: the sensors turn apart by less than this share of their turns and move apart by less
# than this share of their way, over one lag at least.
_ONE_BODY = {'turn': 0.1, 'way': 0.2}


# How the (K, 4, 4) poses of a sensor are to be read; None: as they are.
Read = Callable[[FloatArray], FloatArray] | None


@dataclass(frozen=True)
class RigidFit:
    """What the best rigid motion leaves unexplained over one lag.

    Attributes
    ----------
    lag, lag_s : in poses, and the time of ``LAGS_S`` that it stands for.
    turn, turn_apart : radians, medians over the motions.
    turn_share : the same as a share, of the quarter of the motions that turns most.
    way_apart : metres that stay unexplained, median over the motions.
    way_share : the same as a share of the way, of the longer half of the motions.

    """

    lag: int
    lag_s: float
    turn: float
    turn_apart: float
    turn_share: float
    way_apart: float
    way_share: float

    @property
    def one_body(self) -> bool:
        """Tell whether the two move as one body."""
        return self.misfit < 1

    @property
    def misfit(self) -> float:
        """Return the larger of both shares, relative to what one body leaves."""
        return max(self.turn_share / _ONE_BODY['turn'], self.way_share / _ONE_BODY['way'])


def fits(
    pairs: PosePairs, read_a: Read = None, read_b: Read = None,
    seconds: Sequence[float] = LAGS_S,
) -> Iterator[RigidFit]:
    """Yield the fit over each lag that the pairs, read so, have enough motions for."""
    lags: dict[int, float] = {}
    for lag_s in seconds:
        lags.setdefault(lag_grid(pairs.stamps_ns, (lag_s,), 1.0)[0], lag_s)
    for lag, lag_s in lags.items():
        if lag <= _LONGEST_SHARE * len(pairs):
            found = _fit(*_motions(pairs, lag, read_a, read_b), lag, lag_s)
            if found is not None:
                yield found


def best_fit(
    pairs: PosePairs, read_a: Read = None, read_b: Read = None,
    seconds: Sequence[float] = LAGS_S,
) -> RigidFit | None:
    """Return the first fit of one body, or else the best one; None where there is none."""
    found: list[RigidFit] = []
    for fit in fits(pairs, read_a, read_b, seconds):
        found.append(fit)
        if fit.one_body and (fit.lag_s <= _SHORT_S or max(
                growth(found, 'turn'), growth(found, 'way')) <= NOT_BY_NOISE):
            return fit
    # None of these is one body, however long the lag.
    return min((fit for fit in found if not fit.one_body),
               key=lambda fit: fit.misfit, default=None)


def turn_share(pairs: PosePairs, lag: int, R_a_b: FloatArray) -> float:
    """Return by what share of the turns over a lag a (3, 3) rotation misses them."""
    return _turn_share(Moved.by(*_motions(pairs, lag)), R_a_b)


def growth(found: Sequence[RigidFit], what: str) -> float:
    """Return how much faster what is unexplained grows with the lag than independent errors do.

    Errors of each pose do not grow, those of each step grow with the root of the lag. What two
    bodies do apart grows with the lag. ``what`` is 'turn' or 'way'; lags with no more disagreement
    than one body has do not count.
    """
    ascending = sorted(found, key=lambda item: item.lag)
    apart = [float(getattr(item, f'{what}_apart')) for item in ascending]
    factor = 1.0
    for k, item in enumerate(ascending):
        likely = min((np.sqrt(item.lag / other.lag) * size
                      for other, size in zip(ascending[:k], apart[:k], strict=True)), default=0.0)
        if likely > 0 and getattr(item, f'{what}_share') > _ONE_BODY[what]:
            factor = max(factor, apart[k] / likely)
    return factor


def _motions(
    pairs: PosePairs, lag: int, read_a: Read = None, read_b: Read = None,
) -> tuple[FloatArray, FloatArray]:
    """Return (K, 4, 4) motions of a and b over a lag, as many as suffice."""
    count = len(pairs) - lag
    i = np.arange(0, count, max(1, -(-count // _MOTIONS)))
    found = []
    for read, poses in ((read_a, pairs.poses_a), (read_b, pairs.poses_b)):
        start, end = ((read(part) if read else part) for part in (poses[i], poses[i + lag]))
        found.append(se3.inverse(start) @ end)
    return found[0], found[1]


def _fit(A: FloatArray, B: FloatArray, lag: int, lag_s: float) -> RigidFit | None:
    moved = Moved.by(A, B)
    square = np.maximum(np.sum(moved.turn_a**2, axis=1), np.sum(moved.turn_b**2, axis=1))
    usable = square < LARGEST_TURN**2
    if usable.sum() < _LEAST_MOTIONS:
        return None
    moved, square = Moved(*(item[usable] for item in moved)), square[usable]
    way = np.sum(moved.way_a**2, axis=1)
    weight_t, weight_v = (
        np.full(len(way), 1 / max(float(np.mean(size)), _TINY)) for size in (square, way))
    T, scale = np.eye(4), 1.0
    for k in range(_ROUNDS):
        if k < _ALONE:
            # Turns about one axis say nothing of the rotation about it; where both went does.
            T[:3, :3] = se3.nearest_rotation(
                _correlation(moved.turn_a, moved.turn_b, weight_t)
                + _correlation(moved.way_a + moved.lever @ T[:3, 3], moved.way_b, weight_v))
        # Then all of it together: in turns, a heading and a lever arm settle each other slowly.
        free = slice(3, 7) if k < _ALONE else slice(0, 7)
        H, g = np.zeros((7, 7)), np.zeros(7)
        for J, left, weight, size in zip(moved.slopes(T, scale), moved.left(T, scale),
                                         (weight_t, weight_v), (square, way), strict=True):
            rows = (weight[:, None, None] / max(float(weight @ size), _TINY) * J).reshape(-1, 7)
            H += rows.T @ J.reshape(-1, 7)
            g += rows.T @ left.ravel()
        step = np.zeros(7)
        step[free] = np.linalg.pinv(H[free, free], rcond=1e-10, hermitian=True) @ g[free]
        T[:3, :3] = se3.exp_so3(step[:3]) @ T[:3, :3]
        T[:3, 3] += step[3:6]
        scale *= 1 + float(step[6])
        turn_apart, way_apart = (np.sum(left**2, axis=1) for left in moved.left(T, scale))
        weight_t, weight_v = (
            1 / (apart + np.median(apart) + _TINY) for apart in (turn_apart, way_apart))
    if scale <= 0:
        way_apart = way
    turn = 0.5 * np.sum(moved.turn_a**2 + moved.turn_b**2, axis=1)
    longer = way >= np.median(way)
    return RigidFit(
        lag, lag_s, float(np.sqrt(np.median(turn))), float(np.sqrt(np.median(turn_apart))),
        _turn_share(moved, T[:3, :3]), float(np.sqrt(np.median(way_apart))),
        float(np.sqrt(np.median(way_apart[longer] / (way[longer] + _TINY)))))


def _turn_share(moved: Moved, R: FloatArray) -> float:
    """Return the median, over the quarter of the turns that is largest, of what R misses."""
    turn = 0.5 * np.sum(moved.turn_a**2 + moved.turn_b**2, axis=1)
    most = turn >= np.quantile(turn, 0.75)
    apart = np.sum((moved.turn_a - moved.turn_b @ R.T)**2, axis=1)
    return float(np.sqrt(np.median(apart[most] / (2 * turn[most] + _TINY))))


def _correlation(a: FloatArray, b: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the (3, 3) sum of products of (K, 3) vectors as a share of what it can be.

    So that neither turns nor ways rule the other, however well they fit by themselves.
    """
    weighted = a * weights[:, None]
    most = np.sqrt(np.sum(weighted * a) * float(weights @ np.sum(b**2, axis=1)))
    share: FloatArray = weighted.T @ b / max(float(most), _TINY)
    return share
