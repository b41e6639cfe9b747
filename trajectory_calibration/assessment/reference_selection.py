# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Automatic reference selection: short motions suffer from white noise, long ones from drift.

The residuals of the relative motions do not show which reference gives the better extrinsic. The
posterior of the extrinsic does (``covariance.MostLikely``): the answer of each reference has an
expected squared error ``|x_n - x|^2 + tr P``, where a rotation counts as the displacement of a
point at a distance of one metre. The smallest wins.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajectory_calibration.assessment.covariance import ENOUGH, most_likely, MostLikely
from trajectory_calibration.assessment.input_checks import require_fit
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.motion_pairs import (
    AUTOMATIC,
    lag_grid,
    reference_indices,
    select_motions,
)
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.errors import MotionError, SolverError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers import load_solver, noise_identifier, solver_info


@dataclass(frozen=True)
class ReferenceChoice:
    """A reference such as 'B6', and the reason; empty if the user gave it.

    ``known`` is the posterior of the extrinsic if the choice was made by it.
    """

    reference: str
    explanation: str = ''
    known: MostLikely | None = None


def choose_reference(pairs: PosePairs, config: CalibrationConfig) -> ReferenceChoice:
    """Return the configured reference, or for ``auto`` that of the least expected error."""
    (lag,) = lag_grid(pairs.stamps_ns, (0.5,), largest_share=1.0)
    usual = f'B{max(1, min(lag, (len(pairs) - 1) // 2))}'
    needed = solver_info(config.solver).needs_reference
    if config.reference != AUTOMATIC:
        try:
            reference_indices(config.reference, len(pairs))
        except MotionError:
            if not needed:
                return ReferenceChoice(usual, (
                    f'{usual} for the fit residual: {config.reference} is too long for '
                    f'{len(pairs)} poses'))
        return ReferenceChoice(config.reference)
    if not needed:
        return ReferenceChoice(usual)
    try:
        known = most_likely(pairs, config)
        if config.input_checks:
            # An answer that would be refused cannot judge others.
            require_fit(known.T_a_b, pairs, ('a', 'b'), noise_identifier().name)
    except (MotionError, SolverError) as error:
        # The chosen solver decides whether the motion is enough.
        return ReferenceChoice(usual, f'{usual}: nothing to judge by; {error}')
    directions, variance = _observed(known, config)
    expected: dict[str, float] = {}
    for reference in _candidates(pairs):
        motions = select_motions(pairs, reference, ENOUGH)
        try:
            found = load_solver(config.solver)(motions, config).T_a_b
        except (MotionError, SolverError):
            # Another reference may work; if none does, the usual one raises the error.
            continue
        step = directions @ se3.step_between(known.T_a_b, found)
        expected[reference] = float(np.sqrt(step @ step + variance))
    if not expected:
        return ReferenceChoice(usual)
    best = min(expected, key=lambda name: expected[name])
    return ReferenceChoice(best, _explanation(best, expected), known)


def _candidates(pairs: PosePairs) -> list[str]:
    """Return 'A', 'B1', ..., 'C5', ...: lags of at most a quarter of the recording."""
    lags_b, lags_c = (lag_grid(pairs.stamps_ns, seconds, 0.25) for seconds in (
        (0.1, 0.2, 0.3, 0.5, 0.8, 1.2, 2.0, 3.0, 5.0, 8.0), (0.5, 1.0, 2.0)))
    return ['A', *(f'B{lag}' for lag in lags_b), *(f'C{lag}' for lag in lags_c if lag > 1)]


def _observed(known: MostLikely, config: CalibrationConfig) -> tuple[FloatArray, float]:
    """Return the (K, 6) observed directions and the sum of their variances, m^2.

    A direction times a step (dt, dtheta) is a displacement in metres.
    """
    # Radians count as metres: rotations displace a point at the distance of a metre.
    variances, axes = np.linalg.eigh(known.covariance)
    # Along unobservable directions no answer is better than another.
    seen = variances < config.unobserved_translation**2
    # Rounding may make a variance negative.
    return axes[:, seen].T, float(np.maximum(variances[seen], 0.0).sum())


def _explanation(best: str, expected: dict[str, float]) -> str:
    others = [name for name in expected if name != best]
    named = others[::max(1, -(-len(others) // 3))]
    text = f'{best}: predicted error {_length(expected[best])}'
    if named:
        text += '; of others: ' + ', '.join(f'{name} {_length(expected[name])}' for name in named)
    return text


def _length(metres: float) -> str:
    if metres < 1e-4:
        return 'below 0.01 cm'
    return f'{100 * metres:.2g} cm' if metres < 1 else f'{metres:.3g} m'
