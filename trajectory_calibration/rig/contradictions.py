# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tests for sensors that do not fit the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.assessment.prior_update import contradictions as far_from_prior
from trajectory_calibration.config.prior import Prior
from trajectory_calibration.errors import rounded
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.chi_squared import (
    exceedance,
    exceedance_of_ratio,
    FALSE_ALARM,
)
from trajectory_calibration.geometry.observed import without
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.rig.fusion import Fused
from trajectory_calibration.rig.pairs import PairFailure
from trajectory_calibration.rig.result import Contradiction
from trajectory_calibration.rig.tree import Tree
from trajectory_calibration.rig.windows import Clock, Grid, WindowLevel

# Most sensors that are found one after the other, each without the earlier ones.
_MOST_CONTRADICTING = 3

# Fewest blocks of a drive, to find when a mount moved.
_BLOCKS = 12

# Fewest blocks before and after the move of a mount.
_AROUND = 3

# Most jumps per sensor that are tested as moves of the mount, and their smallest chi-squared.
_JUMPS = 3
_LARGE_JUMP = 20.0

# Prior standard deviations of a move, metres and radians, for unobservable directions.
_PRIOR_STD = np.repeat([10.0, 1.0], 3)

# Offsets within the first limit are of one clock; one is off beyond the second limit and this many
# standard deviations.
_SAME_CLOCK_S = 0.01
_OTHER_CLOCK_S = 0.02
_SIGNIFICANT = 5.0


def unconnected_sensors(
    groups: Sequence[Sequence[str]], failures: Sequence[PairFailure],
) -> list[Contradiction]:
    """Return a contradiction for every sensor without an answer to any other."""
    found = []
    for name in (group[0] for group in groups if len(group) == 1):
        own = [pair for pair in failures if name in (pair.parent, pair.child)]
        if all(pair.no_common_time for pair in own):
            kind, text = 'time', (
                f'{name} has no common time with any other sensor: check its clock and file, or '
                'raise max_time_offset')
        else:
            reason = next(pair.reason for pair in own if not pair.no_common_time)
            kind, text = 'vehicle', (
                f'{name} does not move as the other sensors do: check its topic or file, and '
                f'that it is on this vehicle ({reason})')
        found.append(Contradiction(name, kind, text, left_out=True))
    return found


def contradicting_sensors(tree: Tree) -> tuple[frozenset[int], list[Contradiction]]:
    """Return the indices of sensors that contradict the others, and the contradictions."""
    untrusted: frozenset[int] = frozenset()
    found: list[Contradiction] = []
    for _ in range(_MOST_CONTRADICTING if len(tree.names) > 2 else 0):
        worst = (None if untrusted else find_moved(tree)) or _worst_in_loops(tree, untrusted)
        if worst is None:
            break
        sensor, item = worst
        found.append(item)
        if sensor is None:
            break
        untrusted |= {sensor}
    return untrusted, found


def _worst_in_loops(
    tree: Tree, untrusted: frozenset[int],
) -> tuple[int | None, Contradiction] | None:
    """Return the sensor without which the loops close best; None if they close with all.

    The index is None if the sensor cannot be identified.
    """
    now = tree.fuse(untrusted=untrusted)
    p_now = exceedance(now.chi_squared, now.degrees)
    if p_now >= FALSE_ALARM:
        return None
    candidates = [k for k in range(len(tree.names)) if k not in untrusted]
    tried = []
    for k in candidates:
        others = tree.fuse(untrusted=untrusted | {k})
        # Without the faulty sensor the others agree; of three sensors only one pair remains.
        if others.degrees > 0:
            tried.append((
                exceedance(others.chi_squared, others.degrees),
                now.chi_squared - others.chi_squared, now.degrees - others.degrees, k))
    if not tried:
        names = ', '.join(tree.names[k] for k in candidates)
        return None, Contradiction(
            tree.names[candidates[0]], 'loops', f'the pairs of {names} contradict each other, and '
            'of three sensors the wrong one cannot be named: add a sensor, or check all',
            now.chi_squared, now.degrees, p_now)
    p_others, gain, degrees, k = max(tried, key=lambda item: item[:2])
    return k, Contradiction(
        tree.names[k], 'loops', f'the pairs of {tree.names[k]} contradict those of the others '
        f'(which agree with p = {p_others:.2g} without it): check its frame, units and data',
        gain, degrees, min(1.0, exceedance(gain, degrees) * len(tried)))


def prior_contradictions(
    tree: Tree, fused: Fused, priors: Mapping[int, Prior],
) -> list[Contradiction]:
    """Return a contradiction for every sensor whose prior is far from the motion's answer."""
    found = []
    for k, prior in priors.items():
        if findings := far_from_prior(fused.X[k], fused.of(k), prior):
            worst = max(findings, key=lambda finding: finding.values['sigmas'])
            chi_squared = float(worst.values['sigmas'])**2
            found.append(Contradiction(
                tree.names[k], 'prior', f'{tree.names[k]}: {worst.text}', chi_squared, 1,
                exceedance(chi_squared, 1)))
    return found


def clock_contradictions(names: Sequence[str], clocks: Sequence[Clock]) -> list[Contradiction]:
    """Return a contradiction for every sensor whose clock differs from that of most others.

    All ``clocks`` have the same epoch.
    """
    seconds = np.array([clock.offset_s for clock in clocks])
    agree = np.abs(seconds[:, None] - seconds) <= _SAME_CLOCK_S
    same = agree[np.argmax(agree.sum(axis=1))]
    if np.count_nonzero(same) < max(2, len(clocks) / 2 + 0.5):
        return []
    found = []
    for name, clock, late_s in zip(names, clocks, np.median(seconds[same]) - seconds, strict=True):
        if abs(late_s) > max(_OTHER_CLOCK_S, _SIGNIFICANT * clock.offset_std_s):
            chi_squared = float(late_s / max(clock.offset_std_s, 1e-6))**2
            word = 'late' if late_s > 0 else 'early'
            found.append(Contradiction(
                name, 'clock', f'the stamps of {name} are {1e3 * abs(late_s):.0f} ms {word} '
                f'against those of the others (corrected): check its driver',
                chi_squared, 1, exceedance(chi_squared, 1)))
    return found


def find_moved(tree: Tree) -> tuple[int, Contradiction] | None:
    """Return the sensor with the most significant change of its extrinsic at some time, or None.

    Every sensor is compared with the weighted mean of the others. If a mount moves suddenly, the
    track jumps by the change of the extrinsic; if a SLAM jumps, the extrinsic does not change. At
    every large jump the test is therefore whether the change equals the jump rather than zero,
    with one degree of freedom instead of six; elsewhere it is whether the change is zero.
    """
    levels, noise, grid = tree.levels, tree.noise, tree.grid
    if noise is None or grid is None:
        return None
    count = 2 * levels[0].known.shape[1]
    size = 2 ** max(1, int(np.log2(count / _BLOCKS)))
    blocks = count // size
    if blocks < 2 * _AROUND:
        return None
    # The length with the smallest noise: white noise is averaged, and drift is still small.
    best = int(np.argmin(np.trace(noise[:, :, :3, :3], axis1=2, axis2=3).mean(axis=1)))
    half = min(2 ** best, size)
    steps, samples = _steps(grid, half)
    found = []
    for s, unobserved in enumerate(tree.unobserved_twists()):
        of_sensor = *_blocks(levels, noise, s, size, blocks), unobserved
        cuts = [(cut * size, cut, cut, None) for cut in range(_AROUND, blocks - _AROUND + 1)]
        jumps = [(sample, sample // size, sample // size + 1, jump)
                 for sample, jump in _jumps(noise[best], steps, samples, s, half)]
        for sample, until, since, jump in (*cuts, *jumps):
            estimate = _change(*of_sensor, until, since)
            if estimate is None:
                continue
            change, weight, noise_degrees = estimate
            chi_squared, degrees = float(change @ weight @ change), 6 - unobserved.shape[1]
            tried: float = len(cuts)
            if jump is not None:
                chi_squared -= float((change - jump) @ weight @ (change - jump))
                # Bound of the false alarm rate for a jump of the track alone, of any size.
                change, degrees, tried = jump, 1, 0.5 * len(jumps)
            p_value = exceedance_of_ratio(chi_squared, degrees, noise_degrees) * tried
            found.append((min(1.0, p_value * len(tree.names)), -chi_squared, degrees, s, sample,
                          change))
    if not found:
        return None
    p_value, chi_squared, degrees, s, sample, twist = min(found, key=lambda item: item[:2])
    if p_value >= FALSE_ALARM:
        return None
    step = twist.copy()
    step[:3] += np.cross(twist[3:], tree.start[s, :3, 3])
    seconds = 1e-9 * float(grid.stamps_ns[sample] - grid.stamps_ns[0])
    name = tree.names[s]
    return s, Contradiction(
        name, 'moved', f'the mount of {name} moved by {describe_size(step)} near {seconds:.0f} s: '
        'fasten it, and calibrate the parts before and after alone',
        -chi_squared, degrees, p_value)


def _steps(grid: Grid, half: int) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return (S, K', 6) steps of each sensor relative to the first, and the (K',) samples."""
    count, width = len(grid.stamps_ns), 4 * half
    starts = np.arange(0, count - width + 1, 2 * half)
    index = starts[:, None] + np.arange(width)
    part = grid.poses[:, index]
    motion = se3.inverse(part[:, :, :1]) @ part
    relative = se3.log_se3(se3.inverse(motion[0]) @ motion)
    running = np.cumsum(np.pad(relative, ((0, 0), (0, 0), (1, 0), (0, 0))), axis=2)
    # A step is the mean of the ``half`` samples from a cut on minus that of those before.
    cuts = np.arange(half, 3 * half)
    step = running[:, :, cuts + half] - 2 * running[:, :, cuts] + running[:, :, cuts - half]
    known = grid.known[:, index].all(axis=(0, 2))
    samples = (starts[known, None] + cuts).ravel()
    return step[:, known].reshape(len(step), -1, 6) / half, samples


def _jumps(
    noise: FloatArray, steps: FloatArray, samples: NDArray[np.intp], sensor: int, half: int,
) -> list[tuple[int, FloatArray]]:
    """Return samples of the largest jumps of a sensor, and their (6,) twists of the base."""
    _, step, weight = _residuals(noise, steps, np.ones(steps.shape[:2], dtype=np.bool_), sensor)
    size = _chi_squared(step, weight)
    found = []
    for _ in range(_JUMPS if len(size) else 0):
        most = int(np.argmax(size))
        if size[most] < _LARGE_JUMP:
            break
        found.append((int(samples[most]), step[most]))
        size[np.abs(samples - samples[most]) <= 2 * half] = 0.0
    return found


def _blocks(
    levels: Sequence[WindowLevel], noise: FloatArray, sensor: int, size: int, blocks: int,
) -> tuple[FloatArray, FloatArray]:
    """Return (B, 6) scores and (B, 6, 6) information of one sensor relative to all others."""
    score, information = np.zeros((blocks, 6)), np.zeros((blocks, 6, 6))
    for level, N in zip(levels, noise, strict=True):
        if 2 * level.samples > size:
            break
        windows, residuals, K = _residuals(N, level.differences, level.known, sensor)
        # Robust weights: jumps of a track are not moves of a mount.
        robust = np.minimum(1.0, 24.0 / np.maximum(_chi_squared(residuals, K), 1e-12))
        J = level.jacobian[windows]
        weighted = robust[:, None, None] * np.swapaxes(J, 1, 2) @ K
        block = np.minimum(2 * level.samples * windows // size, blocks - 1)
        np.add.at(score, block, -(weighted @ residuals[:, :, None])[:, :, 0])
        np.add.at(information, block, weighted @ J)
    return score, information


def _residuals(
    noise: FloatArray, values: FloatArray, known: NDArray[np.bool_], sensor: int,
) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Return residuals of a sensor from the weighted mean of the others.

    ``values`` are (S, W, 6), ``known`` (S, W). Returns (W',) indices with a value of the sensor
    and of two others, (W', 6) residuals and their (W', 6, 6) weights.
    """
    others = known.copy()
    others[sensor] = False
    at = np.flatnonzero(known[sensor] & (others.sum(axis=0) >= 2))
    W = others[:, at, None, None] * np.linalg.inv(noise)[:, None]
    P = np.linalg.inv(W.sum(axis=0))
    mean = P @ np.sum(W @ values[:, at, :, None], axis=0)
    return at, values[sensor, at] - mean[:, :, 0], np.linalg.inv(noise[sensor] + P)


def _chi_squared(residuals: FloatArray, weight: FloatArray) -> FloatArray:
    """Return (W,) chi-squared of (W, 6) residuals with (W, 6, 6) weights."""
    found: FloatArray = np.einsum('wi,wij,wj->w', residuals, weight, residuals)
    return found


def _change(
    score: FloatArray, information: FloatArray, unobserved: FloatArray, until: int, since: int,
) -> tuple[FloatArray, FloatArray, int] | None:
    """Return the (6,) change of the extrinsic, its (6, 6) weight, and degrees of freedom.

    The change is from the blocks before ``until`` to those from ``since`` on. The degrees of
    freedom are those of the noise in the weight. None for too few blocks.
    """
    known = np.trace(information, axis1=1, axis2=2) > 0
    parts = [np.flatnonzero(known[:until]), since + np.flatnonzero(known[since:])]
    if min(map(len, parts)) < _AROUND:
        return None
    prior = np.diag(1.0 / _PRIOR_STD**2)
    H = [information[part].sum(axis=0) for part in parts]
    x = [np.linalg.solve(h + prior, score[part].sum(axis=0))
         for h, part in zip(H, parts, strict=True)]
    # Scatter of the blocks relative to their noise.
    residuals = np.concatenate([score[part] - information[part] @ answer
                                for part, answer in zip(parts, x, strict=True)])
    used = information[np.concatenate(parts)] + prior
    scatter = float(np.sum(residuals * np.linalg.solve(used, residuals[:, :, None])[:, :, 0]))
    degrees = 6 * (len(residuals) - 2)
    weight = H[0] @ np.linalg.solve(H[0] + H[1] + prior, H[1])
    return x[1] - x[0], without(weight / max(1.0, scatter / degrees), unobserved), degrees


def describe_size(step: FloatArray) -> str:
    """Return the distance and angle of a (6,) step as text."""
    metres = float(np.linalg.norm(step[:3]))
    degrees = float(np.rad2deg(np.linalg.norm(step[3:])))
    return f'{rounded(100 * metres)} cm and {rounded(degrees)} deg'
