# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The variances of the tree, by restricted likelihood beside the extrinsic.

For contrasts ``d ~ N(J dx, V)`` whose covariance is linear in variances s, ``dV/ds_i = E_i``,
the restricted log likelihood has score and information

    score_i = 1/2 sum [ e' V^-1 E_i V^-1 e - tr V^-1 E_i + tr V^-1 E_i V^-1 J A^-1 J' ]
    information_ij = 1/2 sum tr(V^-1 E_i V^-1 E_j)

(the last part of the score: parameters that were fitted take their share of the squares). One
step of Fisher scoring a round; variances stay at least zero. The white noise is told by
neighbouring poses (octave 0), the noise between worlds by its own octave. An octave of few
contrasts is drawn towards what the one below it tells: noise grows there by ``GROWTH``.

Noise of the stamps is along the twist of a pose, that of the scale along the derivative j of d
in the log scale, ``E = j j'``, and all octaves tell its one variance. Both deviations have
half-Cauchy priors as wide as those of the clock offset and of the scale: few contrasts invent
none.

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
    Noise,
    PARTS,
    scale_growth,
    units,
)
from trajectory_calibration.solvers.drift_aware.tree import Contrasts, Plan

# Variances of noise-free data end here: (1e-11)^2 metres and radians.
_LEAST = 1e-22
# One kind of noise is at least this part of the other (variance, over the extent of the drive).
_RATIO = 1e-9
# A drive has at least that extent, metres: one sensor may turn on the spot.
_SMALLEST_EXTENT = 1e-3

# How many contrasts the extrapolation from the octave below counts for.
_PRIOR_CONTRASTS = 24

# A round changes the white noise by no more than this factor.
_LARGEST_CHANGE = 20.0


def first_noise(drive: Drive, state: State, octaves: int, cut: NDArray[np.bool_]) -> Noise:
    """Return white noise as the median step has it, and none that walks."""
    i = np.flatnonzero(~cut)
    e = residuals(drive, correct(drive, state), i, i + 1)
    white = [0.65 * np.median((e[:, part]**2).mean(axis=1)) for part in PARTS]
    return Noise(_balanced(np.array(white), drive), 0.0, np.zeros((octaves, 2)), 0.0, 5.0)


def _balanced(white: FloatArray, drive: Drive) -> FloatArray:
    """Return the (2,) variances, neither so small that what the other tells drowns in rounding."""
    extent = _SMALLEST_EXTENT**2 + max(
        float((p**2).sum(axis=1).max()) for p in (drive.p_a, drive.p_b))
    translation = max(white[0], _LEAST, _RATIO * white[1] * extent)
    return np.array([translation, max(white[1], _LEAST, _RATIO * translation / extent)])


def improved(
    noise: Noise,
    drive: Drive,
    state: State,
    tree: Plan,
    found: Contrasts,
    weights: FloatArray,
    cut: NDArray[np.bool_],
    normal: FloatArray,
) -> Noise:
    """Return the noise after a step of Fisher scoring; ``normal`` is A, (12, 12)."""
    e = apply(found.inverse, found.d)
    whitened = found.inverse @ found.J
    # Half the derivative of the restricted log likelihood in V.
    slope = (weights[:, None, None] * (
        along(e) + whitened @ solved(normal, np.eye(len(normal))) @ transposed(whitened))
        - found.inverse)
    slope[cut[tree.boundary - 1]] = 0.0
    used = ~cut[tree.boundary - 1]
    lowest = slice(0, tree.first[1] if len(tree.first) > 1 else None)
    white, stamps = _improved_white(noise, drive, state, tree, found, slope, used, lowest)
    walk = _improved_walk(noise, tree, found, slope, used)
    scale = _improved_scale(noise, tree, found, slope, used)
    return Noise(white, stamps, walk, scale, noise.tail)


def _improved_white(
    noise: Noise, drive: Drive, state: State, tree: Plan, found: Contrasts, slope: FloatArray,
    used: NDArray[np.bool_], lowest: slice,
) -> tuple[FloatArray, float]:
    """Fit the white noise, and that of the stamps, to the contrasts of the lowest octave."""
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
    white: FloatArray = np.clip(
        noise.white + step[:2], noise.white / _LARGEST_CHANGE, noise.white * _LARGEST_CHANGE)
    return _balanced(white, drive), noise.stamps + float(step[2])


def _improved_walk(
    noise: Noise, tree: Plan, found: Contrasts, slope: FloatArray, used: NDArray[np.bool_],
) -> FloatArray:
    """Fit the noise between worlds to the contrasts of each octave above the lowest."""
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
        prior = np.diag(np.diag(own)) * _PRIOR_CONTRASTS / counts[octave]
        step = solved(own + prior, score[octave] + prior @ (expected - walk[octave]))
        walk[octave] = np.maximum(walk[octave] + step, 0.0)
    return walk


def _improved_scale(
    noise: Noise, tree: Plan, found: Contrasts, slope: FloatArray, used: NDArray[np.bool_],
) -> float:
    """Fit the variance of the scale to the contrasts of all octaves."""
    growth = np.where(used, scale_growth(tree.octaves)[tree.octave], 0.0)
    j = found.J[:, :, SCALE]
    score = float(growth @ (j * apply(slope, j)).sum(axis=1))
    information = float(growth**2 @ (j * apply(found.inverse, j)).sum(axis=1)**2)
    score -= 1.0 / (HALF_WIDTH[SCALE - 6]**2 + noise.scale)
    return max(0.0, noise.scale + score / information) if information > 0 else 0.0
