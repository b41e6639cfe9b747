"""The noise of a pair of trajectories: white, walk, and rare jumps.

White noise sits on every pose. With equal sensors it is, in the axes of b and about the body of
b, ``sigma_t^2 V_t + sigma_r^2 V_r``: noise of rotation of sensor a moves b by the lever arm.

The walk of a step has two causes, each with a variance for translation and one for rotation:
one per metre moved, and one per squared radian turned, because real SLAM bends and stretches
turns. On top of it comes, rarely, a jump: a mixture whose responsibilities name the outliers. A
wide component of the mixture redescends, which a Student's t does not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.model import Chain

# Log variances, in this order.
COMPONENTS = (
    'white_translation', 'white_rotation',
    'walk_translation_per_metre', 'walk_rotation_per_metre',
    'walk_translation_per_radian', 'walk_rotation_per_radian',
)
WHITE = 2

# No standard deviation of one pose or step is taken below this (m, rad): rounding of files.
_SMALLEST = 1e-8
# White and walk are kept within this ratio of variances, which keeps the equations solvable.
_LARGEST_RATIO = 1e8
# ... and within this one where all of them shall act.
_REVIVED = 0.03
# White noise that the steps of a coarser chain hid is brought up to this share of the walk.
_HIDDEN = 1e-3
# A jump has at least this many times the variance of the median step.
_JUMP_RATIO = 30.0
# ... and this many times that of the white noise of a pose: less does not stand out.
_JUMP_TO_WHITE = 8.0
# Before the data speak: one step in fifty is a jump, an opinion worth this many steps.
_PRIOR_JUMPS, _PRIOR_STEPS = 0.2, 20.0
# Rounds of expectation and maximisation of the jumps in each iteration.
_ROUNDS = 3
# The model takes half of the rotation noise for each sensor's. An effect of one of them alone is
# 2 f times as large, f its share of the noise: the mean of the square, every share as likely.
UNKNOWN_SHARE = 4 / 3
# The median of chi-squared with three degrees of freedom.
_CHI2_MEDIAN = 2.366


@dataclass(frozen=True, eq=False)
class Noise:
    """Variances of the noise, and how likely each step is a jump.

    Attributes
    ----------
    log_variances : (6,), in the order of COMPONENTS: m^2, rad^2 for one pose (each sensor),
        then of the walk per metre and per squared radian.
    profiles : (2, N - 1), metres and squared radians of each step.
    log_typical : (3, 1), logarithms of one, and of both in a typical step.
    jump_probability : (N - 1, 2), that the step is a jump of translation, of rotation.
    jump_variance : (2,), m^2 and rad^2.
    jump_share : (2,), of the steps.

    """

    log_variances: FloatArray
    profiles: FloatArray
    log_typical: FloatArray
    jump_probability: FloatArray
    jump_variance: FloatArray
    jump_share: FloatArray

    @classmethod
    def guess(cls, chain: Chain, steps: FloatArray, white_share: float) -> Noise:
        """Guess from (N - 1, 6) differences of the steps of both sensors."""
        squares = _squares(steps)
        scale = np.maximum(np.median(squares, axis=0) / _CHI2_MEDIAN, _SMALLEST**2)
        profiles, typical = _profiles(chain)
        log_variances = np.log(np.concatenate([
            white_share * scale / 4,
            *((1 - white_share) * scale / 2 / np.exp(typical[1:]))]))
        tail = max(3, len(squares) // 20)
        largest = np.sort(squares, axis=0)[-tail:].mean(axis=0) / 3
        return cls(log_variances, profiles, typical, np.full(squares.shape, 0.02),
                   np.maximum(largest, _JUMP_RATIO * scale), np.full(2, 0.02))

    def carried_to(self, chain: Chain, finer: float) -> Noise:
        """Return the same variances and jumps for a chain with ``finer`` times as many steps.

        Every part of a step that jumped may have, until it is judged. White noise may have
        drowned in the longer steps and has to act again before it can be judged; a walk that the
        longer steps did not show is not there in the shorter ones.
        """
        profiles, typical = _profiles(chain)
        parts = np.arange(profiles.shape[1])
        coarse = self.jump_probability
        touched = [np.minimum((ends / finer).astype(int), len(coarse) - 1)
                   for ends in (parts, parts + 1)]
        carried = replace(
            self, profiles=profiles, log_typical=typical, jump_share=self.jump_share / finer,
            jump_probability=np.maximum(coarse[touched[0]], coarse[touched[1]]))
        return carried.raised(_HIDDEN, slice(WHITE)).raised(1 / _LARGEST_RATIO)

    @property
    def variances(self) -> FloatArray:
        """Return the (6,) variances."""
        return np.exp(self.log_variances)

    def white_parts(self, T_a_b: FloatArray) -> FloatArray:
        """Return the (2, 6, 6) covariances that translation and rotation add to a pose."""
        R, t = T_a_b[:3, :3], T_a_b[:3, 3]
        # Rotation noise phi of a moves b by R^T (phi x t) and turns it by R^T phi.
        lever = np.concatenate([-R.T @ se3.skew(t), R.T])
        parts = np.zeros((2, 6, 6))
        parts[0, :3, :3] = 2 * np.eye(3)
        parts[1] = lever @ lever.T
        parts[1, 3:, 3:] += np.eye(3)
        return self.variances[:WHITE, None, None] * parts

    def white_slopes(self, T_a_b: FloatArray) -> FloatArray:
        """Return the (3, 6, 6) derivatives of the white covariance by t, along the axes of b.

        Only the lever arm is in it, u in the axes of b: ``s_r^2 [u]x [u]x^T`` of the positions
        and ``-s_r^2 [u]x`` between them and the rotations. A turn of b turns the axes alone.
        """
        lever = se3.skew(T_a_b[:3, :3].T @ T_a_b[:3, 3])
        axes = se3.skew(np.eye(3))
        slopes = np.zeros((3, 6, 6))
        slopes[:, :3, :3] = axes @ lever.T + lever @ axes.transpose(0, 2, 1)
        slopes[:, :3, 3:] = -axes
        slopes[:, 3:, :3] = axes
        return float(self.variances[1]) * slopes

    def walk_parts(self) -> FloatArray:
        """Return (2, N - 1, 2): variance of a step by length, by angle; translation, rotation."""
        return self.variances[WHITE:].reshape(2, 1, 2) * self.profiles[:, :, None]

    def walk_precision(self, narrow: FloatArray) -> FloatArray:
        """Return the (N - 1, 2) expected precision given the (N - 1, 2) variance of no jump."""
        gamma = self.jump_probability
        return (1 - gamma) / narrow + gamma / (narrow + self.jump_variance)

    def mixture_terms(self, narrow: FloatArray) -> float:
        """Return the log determinants of the walk and the entropy of the jumps, times -2."""
        gamma = self.jump_probability
        tiny = np.finfo(float).tiny
        log_determinant = 3 * ((1 - gamma) * np.log(narrow)
                               + gamma * np.log(narrow + self.jump_variance)).sum()
        prior = (gamma * np.log(self.jump_share)
                 + (1 - gamma) * np.log1p(-self.jump_share)).sum()
        entropy = -(gamma * np.log(np.maximum(gamma, tiny))
                    + (1 - gamma) * np.log(np.maximum(1 - gamma, tiny))).sum()
        return float(log_determinant - 2 * (prior + entropy))

    def with_jumps(self, squares: FloatArray, spread: FloatArray) -> Noise:
        """Judge every step anew.

        Parameters
        ----------
        squares : (N - 1, 2)
            Squared length of the expected walk of each step, translation and rotation.
        spread : (N - 1, 2)
            Trace of its posterior covariance.

        The step's own assumption is taken out of its posterior first, which leaves what the
        other poses say (the cavity of expectation propagation, covariance taken as isotropic);
        jump or not is then the better explanation of that.

        """
        narrow = self.walk_parts().sum(axis=0)
        assumed = 1 / self.walk_precision(narrow)
        share = 1 - np.minimum(spread / 3 / assumed, 1 - 1e-9)
        variance = assumed * (1 - share) / share
        mean_square = squares / share**2
        floor = np.maximum(_JUMP_RATIO * np.median(narrow, axis=0),
                           _JUMP_TO_WHITE * self.variances[:WHITE])
        jump_variance, jump_share = np.maximum(self.jump_variance, floor), self.jump_share
        # What the others say stays; how common and how large jumps are follows in a few rounds.
        for _ in range(_ROUNDS):
            small, large = variance + narrow, variance + narrow + jump_variance
            log_odds = (1.5 * np.log(small / large) - 0.5 * mean_square * (1 / large - 1 / small)
                        + np.log(jump_share / (1 - jump_share)))
            gamma = 1 / (1 + np.exp(-np.clip(log_odds, -50, 50)))
            count = gamma.sum(axis=0)
            found = (gamma * (squares + spread)).sum(axis=0) / np.maximum(3 * count, 1e-12)
            jump_variance = np.maximum(found, floor)
            jump_share = (count + _PRIOR_JUMPS) / (len(gamma) + _PRIOR_STEPS)
        return replace(self, jump_probability=gamma, jump_variance=jump_variance,
                       jump_share=jump_share)

    def revived(self) -> Noise:
        """Return the noise with every variance large enough to act.

        A variance that has vanished beside another one cannot tell any more whether it would be
        needed: after a change of the model all of them get a new chance.
        """
        return self.raised(_REVIVED)

    def lowest(self) -> FloatArray:
        """Return the (6,) log variances below which the equations could not be solved."""
        return self._lowest(1 / _LARGEST_RATIO)

    def with_log_variances(self, log_variances: FloatArray) -> Noise:
        """Return the noise with new log variances, kept where the equations can be solved."""
        return replace(self, log_variances=log_variances).raised(1 / _LARGEST_RATIO)

    def raised(self, share: float, components: slice = slice(None)) -> Noise:
        """Return the noise with none of the components below a share of the largest."""
        log_variances = self.log_variances.copy()
        lowest = self._lowest(share)[components]
        log_variances[components] = np.maximum(log_variances[components], lowest)
        return replace(self, log_variances=log_variances)

    def _lowest(self, share: float) -> FloatArray:
        """Return the (6,) log variances that are a share of the largest, in a typical step."""
        # Of one typical step; rows: white, by length, by angle.
        step = self.log_variances.reshape(3, 2) + self.log_typical
        lowest = np.maximum(2 * np.log(_SMALLEST), step.max(axis=0) + np.log(share))
        result: FloatArray = (lowest - self.log_typical).ravel()
        return result


def _profiles(chain: Chain) -> tuple[FloatArray, FloatArray]:
    """Return the ``profiles`` and the ``log_typical`` of a chain."""
    profiles = np.stack([chain.step_length, chain.step_turn + 1e-12])
    typical = np.log([1.0, np.median(profiles[0]), np.mean(profiles[1])])
    return profiles, typical[:, None]


def _squares(vectors: FloatArray) -> FloatArray:
    """Return (n, 2) squared lengths of the translation and the rotation of (n, 6)."""
    return np.stack([np.einsum('ij,ij->i', vectors[:, :3], vectors[:, :3]),
                     np.einsum('ij,ij->i', vectors[:, 3:], vectors[:, 3:])], axis=1)
