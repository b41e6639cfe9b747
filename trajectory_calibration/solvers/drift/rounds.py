"""From one round of the variances and of the jumps to the next.

Each round says which variances it wishes, with the jumps as they are, and which steps it takes
for jumps, with the variances as they are. Far from the end, what changes its mind is trusted the
less. Near it, where jumps are a matter of degree, each round takes a share off the error that
hardly changes, and a combination of the last few foretells where they lead (Anderson
acceleration: D. G. Anderson, Journal of the ACM 12(4), 1965, doi:10.1145/321296.321305; H. F.
Walker, P. Ni, SIAM Journal on Numerical Analysis 49(4), 2011, doi:10.1137/10078356X).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from trajectory_calibration.se3 import FloatArray
from trajectory_calibration.solvers.drift.noise import COMPONENTS, Noise

# The largest change of a log variance in one step, up and down.
LARGEST_RISE, LARGEST_FALL = 1.5, 2.5
# A trust that was lost grows by this factor in every step that does not turn; slowly, because
# what turned once tends to turn again, but it must grow or the fit would stop short.
_REGAINED_BY_VARIANCES, _REGAINED_BY_JUMPS = 1.3, 1.15
# Rounds that are remembered beside the present one.
_MEMORY = 4
# Relative to the mean square of the differences of rounds, which may be nearly dependent.
_RIDGE = 1e-4
# A step that is a jump with less probability than this is none.
_CERTAIN = 1e-12


class Rounds:
    """The rounds of one fit."""

    def __init__(self, steps: int) -> None:
        self._variances = Trust(len(COMPONENTS), _REGAINED_BY_VARIANCES)
        self._jumps = Trust((steps, 2), _REGAINED_BY_JUMPS)
        self._last = Anderson()

    def next(
        self, noise: Noise, judged: Noise, wished: FloatArray, information: FloatArray,
        *, alike: bool,
    ) -> Noise:
        """Return the noise for the next round.

        Parameters
        ----------
        noise, judged : Noise
            Of this round, and with its verdict on the jumps.
        wished : (6,)
            The step of the log variances.
        information : (6, 6)
            Of the log variances.
        alike : bool
            Whether rounds are so near the end that the last few foretell the next ones.

        """
        if alike:
            return self._foretold(noise, judged, wished, information)
        self._last = Anderson()
        jumps = noise.jump_probability
        jumps = jumps + self._jumps.damped(judged.jump_probability - jumps)
        return replace(judged, jump_probability=jumps).with_log_variances(
            noise.log_variances + self._variances.damped(wished))

    def _foretold(
        self, noise: Noise, judged: Noise, wished: FloatArray, information: FloatArray,
    ) -> Noise:
        size = len(wished)
        before, after = (_log_odds(each.jump_probability) for each in (noise, judged))
        # A step is as long as what it changes the objective by.
        gamma = judged.jump_probability.ravel()
        deviation = np.sqrt(gamma * (1 - gamma))
        eigenvalues, axes = np.linalg.eigh(information)
        root = np.sqrt(np.maximum(eigenvalues, 0.0))[:, None] * axes.T
        step = self._last.step(
            np.concatenate([noise.log_variances, before]),
            np.concatenate([wished, after - before]),
            lambda step: np.concatenate([root @ step[:size], deviation * step[size:]]))
        jumps = 1 / (1 + np.exp(-(before + step[size:])))
        return replace(judged, jump_probability=jumps.reshape(-1, 2)).with_log_variances(
            noise.log_variances + np.clip(step[:size], -LARGEST_FALL, LARGEST_RISE))


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


class Anderson:
    """The last rounds of an iteration towards a fixed point."""

    def __init__(self) -> None:
        self._points: list[FloatArray] = []
        self._steps: list[FloatArray] = []

    def step(
        self, point: FloatArray, wished: FloatArray, weighted: Callable[[FloatArray], FloatArray],
    ) -> FloatArray:
        """Return the step to take from a point in place of the one that its round wishes.

        ``weighted`` maps a step, linearly, to where its length says how much it matters.
        """
        self._points = [*self._points[-_MEMORY:], point]
        self._steps = [*self._steps[-_MEMORY:], wished]
        if len(self._points) == 1:
            return wished
        moved = [later - earlier for earlier, later in pairwise(self._points)]
        changed = [later - earlier for earlier, later in pairwise(self._steps)]
        design = np.stack([weighted(change) for change in changed], axis=1)
        gram = design.T @ design
        ridge = _RIDGE * np.trace(gram) / len(gram) + np.finfo(float).tiny
        shares = np.linalg.solve(gram + ridge * np.eye(len(gram)), design.T @ weighted(wished))
        result = wished.copy()
        for share, move, change in zip(shares, moved, changed, strict=True):
            result -= share * (move + change)
        return result


def _log_odds(probability: FloatArray) -> FloatArray:
    """Return log odds, kept finite, of probabilities in one row."""
    kept = np.clip(probability.ravel(), _CERTAIN, 1 - _CERTAIN)
    odds: FloatArray = np.log(kept) - np.log1p(-kept)
    return odds
