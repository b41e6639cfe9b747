# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Extrinsic, terms and noise together: rounds of Gauss-Newton, Fisher scoring and jumps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware import student
from trajectory_calibration.solvers.drift_aware.algebra import ROTATION, solved
from trajectory_calibration.solvers.drift_aware.drive import (
    correct,
    Drive,
    prior_precision,
    State,
)
from trajectory_calibration.solvers.drift_aware.jumps import find_jumps
from trajectory_calibration.solvers.drift_aware.noise import Noise
from trajectory_calibration.solvers.drift_aware.octaves import Octaves, saturation, scores
from trajectory_calibration.solvers.drift_aware.spread import inflation
from trajectory_calibration.solvers.drift_aware.tree import contrast, Contrasts, Plan, plan
from trajectory_calibration.solvers.drift_aware.variances import first_noise, improved

# Rounds in which jumps and the tails are looked for, in which rho is found, and the most there
# are: later ones only settle.
_JUMP_ROUNDS = 3
_TAIL_ROUNDS = (2, 4, 6)
_FIRST_RHO, _LAST_RHO = 2, 6
_MOST_ROUNDS = 16
# The same where a fit to fewer poses came before.
_LAST_RHO_AGAIN = 3

# A step that small, in standard deviations, is none; one that large at the end is a finding.
_SETTLED = 0.05
_UNSETTLED = 0.3

# No step turns further, radians.
_LARGEST_TURN = 0.3

# rho before it is known.
_FIRST_GUESS = 0.1


@dataclass(frozen=True, eq=False)
class Fit:
    """A state, and all that the last round was made of.

    Attributes
    ----------
    drive, state, noise, tree, contrasts, weights, octaves : what they say.
    jumps : (N - 1, 2) the variance of jumps in translation and rotation, zero where there is none.
    rho : the saturation.
    c : (o,) the weight of each octave.
    phi : by how much the combined score varies more than its information says.
    prior : (12,) precisions.
    free : (12,) bool, parameters that are not fixed.
    rounds : how many it took.
    last_step : of the last one, in standard deviations.

    """

    drive: Drive
    state: State
    noise: Noise
    tree: Plan
    contrasts: Contrasts
    weights: FloatArray
    octaves: Octaves
    jumps: FloatArray
    rho: float
    c: FloatArray
    phi: float
    prior: FloatArray
    free: NDArray[np.bool_]
    rounds: int
    last_step: float

    @property
    def converged(self) -> bool:
        """Tell whether the last step was small."""
        return self.last_step < _UNSETTLED

    @property
    def objective(self) -> float:
        """Return -2 log likelihood of the contrasts, up to a constant."""
        squares = np.log1p(self.contrasts.squares / self.noise.tail)
        return float(np.linalg.slogdet(self.contrasts.V)[1].sum()
                     + (self.noise.tail + 6) * squares.sum())


def fit(
    drive: Drive, state: State, modes: Mapping[str, str], before: Fit | None = None,
    most_rounds: int | None = None,
) -> Fit:
    """Return the most likely state from a start.

    ``modes`` says 'fixed', 'estimate' or 'auto' for 'scale', 'systematic_drift', 'time_offset';
    ``before`` is a fit to some of the poses that led to the start.
    """
    rho = _FIRST_GUESS if before is None else before.rho
    last_rho = _LAST_RHO if before is None else _LAST_RHO_AGAIN
    step_s = drive.step_s
    jumps = _breaks(drive, state)
    cut = _cuts(jumps)
    tree = plan(cut, drive.R_b)
    weights = np.ones(len(tree.octave))
    noise = first_noise(drive, state, tree.octaves, cut)
    if before is not None:
        noise = _carried(noise, before, drive)
    for round_ in range(most_rounds or _MOST_ROUNDS):
        if 0 < round_ < _JUMP_ROUNDS:
            jumps = _breaks(drive, state)
            if (_cuts(jumps) != cut).any():
                cut = _cuts(jumps)
                tree = plan(cut, drive.R_b)
                weights = np.ones(len(tree.octave))
                noise = noise.resized(tree.octaves)
        prior = prior_precision(state.terms, modes)
        free = np.isfinite(prior)
        prior = np.where(free, prior, 1.0)
        found = contrast(drive, state, tree, noise, jumps, weights)
        if not free.all():
            found = replace(found, J=found.J * free)
        if round_ in _TAIL_ROUNDS:
            noise = replace(noise, tail=student.find_tail(found.squares))
        weights = student.weights(found.squares, noise.tail)
        octaves = scores(tree, found, weights, step_s)
        terms = np.concatenate([np.zeros(6), state.terms])
        if _FIRST_RHO <= round_ <= last_rho:
            rho = saturation(octaves, prior, terms)
        c = octaves.weights(rho)
        phi = inflation(drive, tree, octaves, c, rho)
        A = octaves.information(c) / phi + np.diag(prior)
        g = octaves.combined(c) / phi + prior * terms
        step = -solved(A, g)
        result = Fit(drive, state, noise, tree, found, weights, octaves, jumps, rho, c, phi,
                     prior, free, round_ + 1, float(np.sqrt(abs(step @ A @ step))))
        if round_ > last_rho and result.last_step < _SETTLED:
            break
        turn = float(np.linalg.norm(step[ROTATION]))
        state = state.moved(step * min(1.0, _LARGEST_TURN / max(turn, 1e-300)))
        noise = improved(noise, drive, state, tree, found, weights, cut,
                         octaves.normal + np.diag(prior))
    return result


def _carried(noise: Noise, before: Fit, drive: Drive) -> Noise:
    """Return the noise of poses, with what a fit to every k-th found between worlds."""
    shift = round(np.log2((len(drive) - 1) / (len(before.drive) - 1)))
    carried = before.noise.refined(shift).resized(len(noise.walk))
    return replace(carried, white=noise.white, stamps=noise.stamps)


def _cuts(jumps: FloatArray) -> NDArray[np.bool_]:
    """Return (N - 1,) whether there is a jump of either kind."""
    return np.asarray((jumps > 0).any(axis=1), dtype=np.bool_)


def _breaks(drive: Drive, state: State) -> FloatArray:
    """Return (N - 1, 2) the variances of jumps; a gap is one of whatever size may be."""
    jumps = find_jumps(drive, correct(drive, state))
    extent = float(np.linalg.norm(drive.p_b, axis=1).max())
    jumps[drive.gap] = [extent**2 + 1e-12, np.pi**2]
    return jumps
