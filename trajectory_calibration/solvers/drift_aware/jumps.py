# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Pose jumps: steps that no tail of the noise explains.

The squares of all steps are a mixture of a Student core, whose tail is found with it, and a wide
normal distribution. Heavy tails of real odometry raise no jump; a gap between the core and a few
large steps does. A jump must show over one step and over three: a single bad pose is no jump.
"""

from __future__ import annotations

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.algebra import ROTATION, TRANSLATION
from trajectory_calibration.solvers.drift_aware.drive import Corrected, Drive, residuals
from trajectory_calibration.solvers.drift_aware.student import log_gamma

# A step is a jump from this probability on.
_PROBABILITY = 0.9

# Degrees of freedom that the core may have.
_TAILS = np.array([2.0, 3.0, 5.0, 10.0, 100.0])[:, None]
_CONSTANT = (log_gamma((_TAILS + 3) / 2) - log_gamma(_TAILS / 2)
             - 1.5 * np.log(_TAILS * np.pi))

# The squares are counted in so many classes of their logarithm, over so many decades.
_CLASSES = 100
_DECADES = 1e-16
_ITERATIONS = 30

# The wide component is at least this many times as wide (variance), the share of jumps limited.
_WIDER = 25.0
_LARGEST_SHARE = 0.6


def find_jumps(drive: Drive, at: Corrected) -> FloatArray:
    """Return (N - 1, 2): the variance per axis of jumps in translation and rotation, or zero."""
    last = len(drive) - 1
    i = np.arange(last)
    one = residuals(drive, at, i, i + 1)
    three = residuals(drive, at, np.maximum(i - 1, 0), np.minimum(i + 2, last))
    result = np.zeros((last, 2))
    for column, part in enumerate((TRANSLATION, ROTATION)):
        short, variance = jump_probability((one[:, part]**2).sum(axis=1))
        if (short <= _PROBABILITY).all():
            continue
        long, _ = jump_probability((three[:, part]**2).sum(axis=1))
        result[:, column] = np.where(
            (short > _PROBABILITY) & (long > _PROBABILITY), variance, 0.0)
    return result


def jump_probability(squares: FloatArray) -> tuple[FloatArray, float]:
    """Return (n,) the probabilities that lengths of 3-vectors, squared, are jumps.

    Also the variance per axis of jumps. Expectation maximisation over all tails of the core at
    once; the likelihood chooses.
    """
    largest = float(squares.max())
    if largest <= 0:
        return np.zeros(len(squares)), 0.0
    logs = np.log(np.maximum(squares, _DECADES * largest))
    lowest = float(logs.min())
    width = max((float(logs.max()) - lowest) / _CLASSES, 1e-9)
    of = np.minimum(((logs - lowest) / width).astype(np.intp), _CLASSES - 1)
    counts = np.bincount(of, minlength=_CLASSES).astype(np.float64)
    used = np.flatnonzero(counts)
    c, r = counts[used], np.exp(lowest + width * (used + 0.5))
    core = np.full((len(_TAILS), 1), max(float(np.median(squares)) / 2.4, float(r[0])))
    wide = np.maximum(np.quantile(squares, 0.98) / 3, _WIDER * core)
    share = np.full_like(core, 0.05)
    for _ in range(_ITERATIONS):
        narrow = (_CONSTANT - 1.5 * np.log(core) - (_TAILS + 3) / 2 * np.log1p(r / core / _TAILS)
                  + np.log1p(-share))
        jump = np.log(share) - 1.5 * np.log(2 * np.pi * wide) - r / 2 / wide
        probability = 1 / (1 + np.exp(np.clip(narrow - jump, -500, 500)))
        stay = (1 - probability) * c
        pulled = stay * (_TAILS + 3) / (_TAILS + r / core)
        core = np.maximum((pulled @ r)[:, None] / 3 / (stay.sum(axis=1, keepdims=True) + 1e-9),
                          1e-300)
        jumps = (probability @ c)[:, None]
        share = np.clip((jumps + 0.01) / (len(squares) + 1), 1e-9, _LARGEST_SHARE)
        wide = np.maximum((probability @ (c * r))[:, None] / 3 / (jumps + 1e-12), _WIDER * core)
    best = int(np.argmax(np.logaddexp(narrow, jump) @ c))
    of_class = np.zeros(_CLASSES)
    # The wide normal is the denser of the two also where both vanish, close to zero.
    of_class[used] = probability[best] * (r > 9 * core[best])
    return of_class[of], float(wide[best, 0])
