# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The variances of the tree, by restricted maximum likelihood.

For contrasts ``d ~ N(J dx, V)`` whose covariance is linear in variances s, ``dV/ds_i = E_i``,
the restricted log likelihood has score and information

    score_i = 1/2 sum [ e' V^-1 E_i V^-1 e - tr V^-1 E_i + tr V^-1 E_i V^-1 J A^-1 J' ]
    information_ij = 1/2 sum tr(V^-1 E_i V^-1 E_j)

(the last part of the score: fitted parameters reduce the squares). One step of Fisher scoring per
round; variances stay non-negative. The white noise is estimated from neighbouring poses (octave
0), the noise between worlds from its own octave. An octave of few contrasts is regularised towards
that of the octave below times ``GROWTH``.

Noise of the stamps acts along the twist of a pose. Noise of the scale acts along the derivative j
of d by the log scale, ``E = j j'``, with one variance from all octaves. Both standard deviations
have half-Cauchy priors as wide as those of the clock offset and of the scale, so that a few
contrasts give no spurious noise.

D. A. Harville, "Maximum likelihood approaches to variance component estimation and to related
problems", JASA 72(358), 1977, doi:10.1080/01621459.1977.10480998.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.algebra import (
    adjoint_of_inverse,
    apply,
    solved,
    transposed,
)
from trajectory_calibration.solvers.drift_aware.drive import (
    correct,
    Drive,
    HALF_WIDTH,
    OFFSET,
    residuals,
    SCALE,
    State,
    twists_b,
)
from trajectory_calibration.solvers.drift_aware.noise import (
    along,
    GROWTH,
    NoiseModel,
    PARTS,
    scale_growth,
    units,
)
from trajectory_calibration.solvers.drift_aware.tree import Contrasts, Plan

# Smallest variance, for noise-free data: (1e-11)^2 metres or radians.
_LEAST = 1e-22


def first_noise(drive: Drive, state: State, octaves: int, cut: NDArray[np.bool_]) -> NoiseModel:
    """Return the white noise from the median step, without other noise."""
    i = np.flatnonzero(~cut)
    e = residuals(drive, correct(drive, state), i, i + 1)
    white = [0.65 * np.median((e[:, part]**2).mean(axis=1)) for part in PARTS]
    return NoiseModel(_balanced(np.array(white), drive), 0.0, np.zeros((octaves, 2)), 0.0, 5.0)


def _balanced(white: FloatArray, drive: Drive) -> FloatArray:
    """Return the (2,) variances, bounded so that neither makes the other vanish in rounding."""
    # At least a millimetre: the sensors may rotate on the spot.
    extent = 1e-3**2 + max(
        float((p**2).sum(axis=1).max()) for p in (drive.p_a, drive.p_b))
    translation = max(white[0], _LEAST, 1e-9 * white[1] * extent)
    return np.array([translation, max(white[1], _LEAST, 1e-9 * translation / extent)])


def improved(
    noise: NoiseModel,
    drive: Drive,
    state: State,
    tree: Plan,
    found: Contrasts,
    weights: FloatArray,
    cut: NDArray[np.bool_],
    normal: FloatArray,
) -> NoiseModel:
    """Return the noise after a step of Fisher scoring; ``normal`` (12, 12) is A."""
    e = apply(found.inverse, found.d)
    whitened = found.inverse @ found.J
    # Half the derivative of the restricted log likelihood by V.
    slope = (weights[:, None, None] * (
        along(e) + whitened @ solved(normal, np.eye(len(normal))) @ transposed(whitened))
        - found.inverse)
    slope[cut[tree.boundary - 1]] = 0.0
    used = ~cut[tree.boundary - 1]
    lowest = slice(0, tree.first[1] if len(tree.first) > 1 else None)
    white, stamps = _improved_white(noise, drive, state, tree, found, slope, used, lowest)
    walk = _improved_walk(noise, tree, found, slope, used)
    scale = _improved_scale(noise, tree, found, slope, used)
    return NoiseModel(white, stamps, walk, scale, noise.tail)


def _improved_white(
    noise: NoiseModel, drive: Drive, state: State, tree: Plan, found: Contrasts, slope: FloatArray,
    used: NDArray[np.bool_], lowest: slice,
) -> tuple[FloatArray, float]:
    """Estimate the white noise and that of the stamps from the lowest octave."""
    j = tree.boundary[lowest][used[lowest]]
    if not len(j):
        return noise.white, noise.stamps
    inverse, slope = found.inverse[lowest][used[lowest]], slope[lowest][used[lowest]]
    back = transposed(drive.R_b[j - 1])
    way = np.exp(state.terms[0]) * drive.step_b[j - 1]
    Ad = adjoint_of_inverse(back @ drive.R_b[j], way)
    unit = units(state.T_a_b)
    twists = twists_b(drive, state.T_a_b)
    E = [*(one + Ad @ one @ transposed(Ad) for one in unit),
         along(twists[j]) + along(apply(Ad, twists[j - 1]))]
    by = [inverse @ one for one in E]
    score = np.array([(slope * one).sum() for one in E])
    score[2] -= 1.0 / (HALF_WIDTH[OFFSET - 6]**2 + noise.stamps)
    information = np.array([[(x * transposed(y)).sum() for y in by] for x in by])
    step = solved(information, score)
    if noise.stamps + step[2] < 0:
        step[2] = -noise.stamps
        step[:2] = solved(information[:2, :2], score[:2] - information[:2, 2] * step[2])
    # A round changes the white noise by no more than a factor.
    white: FloatArray = np.clip(noise.white + step[:2], noise.white / 20, noise.white * 20)
    return _balanced(white, drive), noise.stamps + float(step[2])


def _improved_walk(
    noise: NoiseModel, tree: Plan, found: Contrasts, slope: FloatArray, used: NDArray[np.bool_],
) -> FloatArray:
    """Estimate the noise between worlds from each octave above the lowest."""
    octaves = tree.octaves

    def total(values: FloatArray) -> FloatArray:
        sums = np.bincount(tree.octave, np.where(used, values, 0.0), octaves)
        return np.asarray(sums, dtype=np.float64)

    score = np.stack([total(np.trace(slope[:, part, part], axis1=1, axis2=2))
                      for part in PARTS], axis=-1)
    information = np.stack([np.stack([
        total((found.inverse[:, one, two]**2).sum(axis=(1, 2))) for two in PARTS], axis=-1)
        for one in PARTS], axis=-1)
    counts = total(np.ones(len(used)))
    walk = noise.resized(octaves).walk.copy()
    walk[0] = 0.0
    for octave in range(1, octaves):
        expected = GROWTH * walk[octave - 1]
        if not counts[octave]:
            walk[octave] = expected
            continue
        own = information[octave]
        # The extrapolation from the octave below counts for 24 contrasts.
        prior = np.diag(np.diag(own)) * 24 / counts[octave]
        step = solved(own + prior, score[octave] + prior @ (expected - walk[octave]))
        walk[octave] = np.maximum(walk[octave] + step, 0.0)
    return walk


def _improved_scale(
    noise: NoiseModel, tree: Plan, found: Contrasts, slope: FloatArray, used: NDArray[np.bool_],
) -> float:
    """Estimate the variance of the scale from all octaves."""
    growth = np.where(used, scale_growth(tree.octaves)[tree.octave], 0.0)
    j = found.J[:, :, SCALE]
    score = float(growth @ (j * apply(slope, j)).sum(axis=1))
    information = float(growth**2 @ (j * apply(found.inverse, j)).sum(axis=1)**2)
    score -= 1.0 / (HALF_WIDTH[SCALE - 6]**2 + noise.scale)
    return max(0.0, noise.scale + score / information) if information > 0 else 0.0
