# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Joint estimation: Gauss-Newton for extrinsic and terms, Fisher scoring for the noise, jumps."""

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
from trajectory_calibration.solvers.drift_aware.noise import NoiseModel
from trajectory_calibration.solvers.drift_aware.octaves import Octaves, saturation, scores
from trajectory_calibration.solvers.drift_aware.spread import inflation
from trajectory_calibration.solvers.drift_aware.tree import contrast, Contrasts, Plan, plan
from trajectory_calibration.solvers.drift_aware.variances import first_noise, improved


@dataclass(frozen=True, eq=False)
class Fit:
    """A state, with all quantities of the last round.

    Attributes
    ----------
    drive, state, noise, tree, contrasts, weights, octaves : see their classes.
    jumps : (N - 1, 2) variances of jumps in translation and rotation, zero without a jump.
    rho : correlation of the noise with the motion, which saturates the information.
    c : (o,) weight of each octave.
    phi : ratio of the scatter of the combined score to its information.
    prior : (12,) precisions of the priors.
    free : (12,) bool, parameters that are not fixed.
    rounds : number of rounds.
    last_step : length of the last step, in standard deviations.

    """

    drive: Drive
    state: State
    noise: NoiseModel
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
        """Return whether the last step was small, in standard deviations."""
        return self.last_step < 0.3

    @property
    def objective(self) -> float:
        """Return -2 log likelihood of the contrasts, up to a constant."""
        squares = np.log1p(self.contrasts.squares / self.noise.tail)
        return float(np.linalg.slogdet(self.contrasts.V)[1].sum()
                     + (self.noise.tail + 6) * squares.sum())


def fit(
    drive: Drive, state: State, modes: Mapping[str, str], before: Fit | None = None,
    most_rounds: int = 16,
) -> Fit:
    """Return the maximum-likelihood fit from a start.

    ``modes`` maps 'scale', 'systematic_drift' and 'time_offset' to 'fixed', 'estimate' or 'auto'.
    ``before`` is the coarse fit that gave the start. Jumps, tail and rho are estimated in the
    first rounds.
    """
    rho, last_rho = (0.1, 6) if before is None else (before.rho, 3)
    step_s = drive.step_s
    jumps = _breaks(drive, state)
    cut = _cuts(jumps)
    tree = plan(cut, drive.R_b)
    weights = np.ones(len(tree.octave))
    noise = first_noise(drive, state, tree.octaves, cut)
    if before is not None:
        noise = _from_coarse(noise, before, drive)
    for round_ in range(most_rounds):
        if 0 < round_ < 3:
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
        if round_ in (2, 4, 6):
            noise = replace(noise, tail=student.find_tail(found.squares))
        weights = student.weights(found.squares, noise.tail)
        octaves = scores(tree, found, weights, step_s)
        terms = np.concatenate([np.zeros(6), state.terms])
        if 2 <= round_ <= last_rho:
            rho = saturation(octaves, prior, terms)
        c = octaves.weights(rho)
        phi = inflation(drive, tree, octaves, c, rho)
        A = octaves.information(c) / phi + np.diag(prior)
        g = octaves.combined(c) / phi + prior * terms
        step = -solved(A, g)
        result = Fit(drive, state, noise, tree, found, weights, octaves, jumps, rho, c, phi,
                     prior, free, round_ + 1, float(np.sqrt(abs(step @ A @ step))))
        if round_ > last_rho and result.last_step < 0.05:
            break
        angle = float(np.linalg.norm(step[ROTATION]))
        state = state.moved(step * min(1.0, 0.3 / max(angle, 1e-300)))
        noise = improved(noise, drive, state, tree, found, weights, cut,
                         octaves.normal + np.diag(prior))
    return result


def _from_coarse(noise: NoiseModel, before: Fit, drive: Drive) -> NoiseModel:
    """Return the initial noise, with the noise between worlds from the coarse fit."""
    shift = round(np.log2((len(drive) - 1) / (len(before.drive) - 1)))
    coarse = before.noise.refined(shift).resized(len(noise.walk))
    return replace(coarse, white=noise.white, stamps=noise.stamps)


def _cuts(jumps: FloatArray) -> NDArray[np.bool_]:
    """Return (N - 1,) whether a step has a jump."""
    return np.asarray((jumps > 0).any(axis=1), dtype=np.bool_)


def _breaks(drive: Drive, state: State) -> FloatArray:
    """Return the (N - 1, 2) variances of jumps; a gap is a jump of any size."""
    jumps = find_jumps(drive, correct(drive, state))
    extent = float(np.linalg.norm(drive.p_b, axis=1).max())
    jumps[drive.gap] = [extent**2 + 1e-12, np.pi**2]
    return jumps
