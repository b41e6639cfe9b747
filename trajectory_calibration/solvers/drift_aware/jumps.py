# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Pose jumps: steps that the tail of the noise does not explain.

The residuals of all steps are a mixture of a Student core, with an estimated tail, and a wide
normal distribution. Heavy tails of real odometry are no jumps; steps far beyond the core are. A
jump must show over one step and over three: a single bad pose is no jump.
"""

from __future__ import annotations

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.algebra import ROTATION, TRANSLATION
from trajectory_calibration.solvers.drift_aware.drive import Corrected, Drive, residuals
from trajectory_calibration.solvers.drift_aware.student import log_gamma

# A step is a jump from this probability on.
_PROBABILITY = 0.9

# Possible degrees of freedom of the core, once for each of the two starts.
_TAILS = np.tile([2.0, 3.0, 5.0, 10.0, 100.0], 2)[:, None]
_CONSTANT = (log_gamma((_TAILS + 3) / 2) - log_gamma(_TAILS / 2)
             - 1.5 * np.log(_TAILS * np.pi))

# Number of bins of the histogram of the logarithms of the squares.
_BINS = 100

# Smallest ratio of the variances of the wide component and the core.
_WIDER = 25.0


def find_jumps(drive: Drive, at: Corrected) -> FloatArray:
    """Return the (N - 1, 2) variances per axis of jumps in translation and rotation, or zero."""
    last = len(drive) - 1
    i = np.arange(last)
    short, variance = jump_probability(_squares(residuals(drive, at, i, i + 1)))
    sudden = short > _PROBABILITY
    if not sudden.any():
        return np.zeros((last, 2))
    long, _ = jump_probability(_squares(residuals(
        drive, at, np.maximum(i - 1, 0), np.minimum(i + 2, last))))
    result: FloatArray = np.where(sudden & (long > _PROBABILITY), variance[:, None], 0.0).T
    return result


def _squares(e: FloatArray) -> FloatArray:
    """Return the (2, n) squared lengths of translation and rotation of (n, 6) residuals."""
    return np.stack([np.einsum('ni,ni->n', e[:, part], e[:, part])
                     for part in (TRANSLATION, ROTATION)])


def jump_probability(squares: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the (k, n) probabilities of jumps, for (k, n) squared lengths of 3-vectors.

    Also the (k,) variances per axis of the jumps. Expectation maximisation for all tails of the
    core and all k rows at once; the likelihood chooses.
    """
    largest = squares.max(axis=1, keepdims=True)
    logs = np.log(np.maximum(squares, np.maximum(1e-16 * largest, 1e-300)))
    lowest = logs.min(axis=1, keepdims=True)
    width = np.maximum((logs.max(axis=1, keepdims=True) - lowest) / _BINS, 1e-9)
    of = np.minimum(((logs - lowest) / width).astype(np.intp), _BINS - 1)
    counts = np.stack([np.bincount(row, minlength=_BINS) for row in of]).astype(np.float64)
    # (k, 1, bins); the estimates below are (k, tails, 1).
    r = np.exp(lowest + width * (np.arange(_BINS) + 0.5))[:, None]
    # Columns for sums over the bins: counts, and sums of squares.
    sums = np.stack([counts, counts * r[:, 0]], axis=2)
    total = counts.sum(axis=1)[:, None, None]
    first = np.take_along_axis(r[:, 0], (counts > 0).argmax(axis=1)[:, None], axis=1)
    core = np.maximum(np.median(squares, axis=1)[:, None] / 2.4, first)
    core = np.repeat(core[:, None], len(_TAILS), axis=1)
    # A wide component that starts narrow never reaches a single step far beyond all others; one
    # that starts wide may miss smaller jumps. The likelihood chooses between both starts.
    starts = np.stack([np.quantile(squares, 0.98, axis=1), largest[:, 0]], axis=1) / 3
    wide = np.maximum(np.repeat(starts, len(_TAILS) // 2, axis=1)[:, :, None], _WIDER * core)
    share = np.full_like(core, 0.05)
    for _ in range(30):
        ratio = r / core
        narrow = (_CONSTANT - 1.5 * np.log(core) + np.log1p(-share)) - (
            0.5 * (_TAILS + 3)) * np.log(1 + ratio / _TAILS)
        jump = (np.log(share) - 1.5 * np.log(2 * np.pi * wide)) - r * (0.5 / wide)
        probability = 1 / (1 + np.exp(np.minimum(np.maximum(narrow - jump, -500), 500)))
        pulled = ((1 - probability) * (_TAILS + 3) / (_TAILS + ratio)) @ sums[:, :, 1:]
        of_jumps = probability @ sums
        jumps, of_jumps = of_jumps[:, :, :1], of_jumps[:, :, 1:]
        core = np.maximum(pulled / 3 / (total - jumps + 1e-9), 1e-300)
        share = np.clip((jumps + 0.01) / (squares.shape[1] + 1), 1e-9, 0.6)
        wide = np.maximum(of_jumps / 3 / (jumps + 1e-12), _WIDER * core)
    best = (np.logaddexp(narrow, jump) @ sums[:, :, :1])[:, :, 0].argmax(axis=1)
    row = np.arange(len(squares))
    # Near zero, where both vanish, the wide component is the denser one.
    of_bin = probability[row, best] * (r[:, 0] > 9 * core[row, best])
    return np.take_along_axis(of_bin, of, axis=1), wide[row, best, 0]
