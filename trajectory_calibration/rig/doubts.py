# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Every sensor that does not fit, with what was found and what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from trajectory_calibration.config.prior import Prior
from trajectory_calibration.geometry.chi_squared import FALSE_ALARM
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.rig.contradictions import find_moved, find_other_clocks
from trajectory_calibration.rig.fusion import Fused
from trajectory_calibration.rig.observed import probability
from trajectory_calibration.rig.pairs import PairFailure
from trajectory_calibration.rig.result import Contradiction
from trajectory_calibration.rig.tree import Tree

# Contradictions that are looked for one after the other, each without the ones before.
_MOST_DOUBTED = 3


def unconnected(
    groups: Sequence[Sequence[str]], failures: Sequence[PairFailure],
) -> list[Contradiction]:
    """Name the sensors that share no answer with any other."""
    found = []
    for name in (group[0] for group in groups if len(group) == 1):
        own = [pair for pair in failures if name in (pair.parent, pair.child)]
        if not own:
            continue
        if all(pair.no_common_time for pair in own):
            kind, text = 'time', (
                f'{name} shares no time with any other sensor: check its clock and its file, or '
                'raise max_time_offset')
        else:
            reason = next(pair.reason for pair in own if not pair.no_common_time)
            kind, text = 'vehicle', (
                f'{name} does not move as the other sensors do: check its topic or file, and '
                f'that it rides on this vehicle ({reason})')
        found.append(Contradiction(name, kind, text, left_out=True))
    return found


def doubt(tree: Tree) -> tuple[frozenset[int], list[Contradiction]]:
    """Return the sensors that contradict the rest, one after the other, and what was found."""
    doubted: frozenset[int] = frozenset()
    found: list[Contradiction] = []
    for _ in range(_MOST_DOUBTED if len(tree.names) > 2 else 0):
        worst = (None if doubted else find_moved(tree)) or _worst_in_loops(tree, doubted)
        if worst is None:
            break
        sensor, item = worst
        found.append(item)
        if sensor is None:
            break
        doubted |= {sensor}
    return doubted, found


def _worst_in_loops(
    tree: Tree, doubted: frozenset[int],
) -> tuple[int | None, Contradiction] | None:
    """Return the sensor without which the loops close best, where they do not close."""
    now = tree.fuse(doubted=doubted)
    p_now = probability(now.chi_squared, now.degrees)
    if p_now >= FALSE_ALARM:
        return None
    left = [k for k in range(len(tree.names)) if k not in doubted]
    tried = []
    for k in left:
        without = tree.fuse(doubted=doubted | {k})
        # Without the culprit the others agree; of three, nobody is left to agree.
        if without.degrees > 0:
            tried.append((
                probability(without.chi_squared, without.degrees),
                now.chi_squared - without.chi_squared, now.degrees - without.degrees, k))
    if not tried:
        names = ', '.join(tree.names[k] for k in left)
        return None, Contradiction(
            tree.names[left[0]], 'loops', f'the pairs of {names} contradict each other, and of '
            'three sensors the wrong one cannot be named: add a sensor, or check all',
            now.chi_squared, now.degrees, p_now)
    p_rest, gain, degrees, k = max(tried, key=lambda item: item[:2])
    return k, Contradiction(
        tree.names[k], 'loops', f'the pairs of {tree.names[k]} contradict those of the others '
        f'(which agree with p = {p_rest:.2g} without it): check its frame, its units and its data',
        gain, degrees, min(1.0, probability(gain, degrees) * len(tried)))


def against_priors(
    tree: Tree, fused: Fused, priors: Mapping[int, Prior],
) -> list[Contradiction]:
    """Name the sensors whose prior is far from what the motion says."""
    found = []
    for k, prior in priors.items():
        known = np.isfinite(prior.std)
        P = block_of(fused, k)[np.ix_(known, known)] + np.diag(prior.std[known]**2)
        deviation = prior.deviation(fused.X[k])[known]
        scale = np.sqrt(np.diagonal(P))
        worst = float(np.abs(deviation / scale).max())
        # Of the largest of a few normal deviations, so that the number of components is free.
        p_value = min(1.0, len(scale) * float(np.exp(-0.5 * worst**2)))
        if p_value < FALSE_ALARM:
            name = tree.names[k]
            found.append(Contradiction(
                name, 'prior', f'the prior of {name} is {worst:.0f} standard deviations from what '
                'the motion says: one of them is wrong, and the answer is between',
                worst**2, 1, p_value))
    return found


def other_clocks(tree: Tree) -> list[Contradiction]:
    """Name the sensors whose clock is off that of most others."""
    found = []
    for k, late_s in find_other_clocks(tree.clocks, tree.clocks[0].epoch_ns):
        name = tree.names[k]
        word = 'late' if late_s > 0 else 'early'
        std = max(tree.clocks[k].offset_std_s, 1e-6)
        chi_squared = (late_s / std)**2
        found.append(Contradiction(
            name, 'clock', f'the stamps of {name} are {1e3 * abs(late_s):.0f} ms {word} against '
            f'those of the others (corrected): check its driver',
            chi_squared, 1, float(np.exp(-0.5 * min(chi_squared, 1400.0)))))
    return found


def block_of(fused: Fused, k: int) -> FloatArray:
    """Return the (6, 6) covariance of sensor k of a tree; zero of its base."""
    if k == 0:
        return np.zeros((6, 6))
    return fused.covariance[6 * k - 6:6 * k, 6 * k - 6:6 * k]
