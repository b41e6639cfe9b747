# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which sensors do not fit the others, how sure that is, and what to do."""

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

# Contradictions that are looked for one after the other, each without the ones before.
_MOST_DOUBTED = 3

# Blocks that a drive is cut into, at least, to find when a mount moved.
_BLOCKS = 12

# A mount that moved is known from at least this many blocks before and after.
_AROUND = 3

# Jumps of a sensor that are asked whether its mount moved, and how large they are, chi-squared.
_JUMPS = 3
_LARGE_JUMP = 20.0

# What no motion tells, metres and radians: a weak wish that nothing moved.
_UNTOLD = np.repeat([10.0, 1.0], 3)

# Clocks that agree within this are one clock; beyond as much again, and surely so, one is off.
_SAME_CLOCK_S = 0.01
_OTHER_CLOCK_S = 0.02
_SURE = 5.0


def unconnected(
    groups: Sequence[Sequence[str]], failures: Sequence[PairFailure],
) -> list[Contradiction]:
    """Name the sensors that share no answer with any other."""
    found = []
    for name in (group[0] for group in groups if len(group) == 1):
        own = [pair for pair in failures if name in (pair.parent, pair.child)]
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
    p_now = exceedance(now.chi_squared, now.degrees)
    if p_now >= FALSE_ALARM:
        return None
    left = [k for k in range(len(tree.names)) if k not in doubted]
    tried = []
    for k in left:
        rest = tree.fuse(doubted=doubted | {k})
        # Without the culprit the others agree; of three, nobody is left to agree.
        if rest.degrees > 0:
            tried.append((
                exceedance(rest.chi_squared, rest.degrees),
                now.chi_squared - rest.chi_squared, now.degrees - rest.degrees, k))
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
        gain, degrees, min(1.0, exceedance(gain, degrees) * len(tried)))


def against_priors(
    tree: Tree, fused: Fused, priors: Mapping[int, Prior],
) -> list[Contradiction]:
    """Name the sensors whose prior is far from what the motion says."""
    found = []
    for k, prior in priors.items():
        if told := far_from_prior(fused.X[k], fused.of(k), prior):
            worst = max(told, key=lambda finding: finding.values['sigmas'])
            chi_squared = float(worst.values['sigmas'])**2
            found.append(Contradiction(
                tree.names[k], 'prior', f'{tree.names[k]}: {worst.text}', chi_squared, 1,
                exceedance(chi_squared, 1)))
    return found


def other_clocks(names: Sequence[str], clocks: Sequence[Clock]) -> list[Contradiction]:
    """Name the sensors whose clock, of one epoch for all, is off that of most others."""
    seconds = np.array([clock.offset_s for clock in clocks])
    agree = np.abs(seconds[:, None] - seconds) <= _SAME_CLOCK_S
    same = agree[np.argmax(agree.sum(axis=1))]
    if np.count_nonzero(same) < max(2, len(clocks) / 2 + 0.5):
        return []
    found = []
    for name, clock, late_s in zip(names, clocks, np.median(seconds[same]) - seconds, strict=True):
        if abs(late_s) > max(_OTHER_CLOCK_S, _SURE * clock.offset_std_s):
            chi_squared = float(late_s / max(clock.offset_std_s, 1e-6))**2
            word = 'late' if late_s > 0 else 'early'
            found.append(Contradiction(
                name, 'clock', f'the stamps of {name} are {1e3 * abs(late_s):.0f} ms {word} '
                f'against those of the others (corrected): check its driver',
                chi_squared, 1, exceedance(chi_squared, 1)))
    return found


def find_moved(tree: Tree) -> tuple[int, Contradiction] | None:
    """Return the sensor whose extrinsic before some moment is surest another one than after it.

    Every sensor is compared with the weighted mean of the others. A mount that moves at once
    shows twice: the track jumps by as much as the extrinsic changes. A SLAM that jumps shows
    once. So at every large jump the change of the extrinsic is asked whether it is the jump
    rather than zero, which is one question instead of six; elsewhere whether it is zero.
    """
    levels, noise, grid = tree.levels, tree.noise, tree.grid
    if noise is None or grid is None:
        return None
    count = 2 * levels[0].known.shape[1]
    size = 2 ** max(1, int(np.log2(count / _BLOCKS)))
    blocks = count // size
    if blocks < 2 * _AROUND:
        return None
    # The length at which a jump shows best: white noise is averaged, and drift is small yet.
    best = int(np.argmin(np.trace(noise[:, :, :3, :3], axis1=2, axis2=3).mean(axis=1)))
    half = min(2 ** best, size)
    steps, samples = _steps(grid, half)
    found = []
    for s, unobserved in enumerate(tree.unobserved_twists()):
        evidence = *_blocks(levels, noise, s, size, blocks), unobserved
        cuts = [(cut * size, cut, cut, None) for cut in range(_AROUND, blocks - _AROUND + 1)]
        jumps = [(sample, sample // size, sample // size + 1, jump)
                 for sample, jump in _jumps(noise[best], steps, samples, s, half)]
        for sample, until, since, jump in (*cuts, *jumps):
            told = _change(*evidence, until, since)
            if told is None:
                continue
            change, weight, of_noise = told
            chi_squared, degrees = float(change @ weight @ change), 6 - unobserved.shape[1]
            tried: float = len(cuts)
            if jump is not None:
                chi_squared -= float((change - jump) @ weight @ (change - jump))
                # Whatever its size, a jump of the track alone exceeds this no more often.
                change, degrees, tried = jump, 1, 0.5 * len(jumps)
            p_value = exceedance_of_ratio(chi_squared, degrees, of_noise) * tried
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
    """Return (S, K', 6) steps of each sensor against the first, and the (K',) samples."""
    count, width = len(grid.stamps_ns), 4 * half
    starts = np.arange(0, count - width + 1, 2 * half)
    index = starts[:, None] + np.arange(width)
    part = grid.poses[:, index]
    motion = se3.inverse(part[:, :, :1]) @ part
    away = se3.log_se3(se3.inverse(motion[0]) @ motion)
    running = np.cumsum(np.pad(away, ((0, 0), (0, 0), (1, 0), (0, 0))), axis=2)
    # A step is the mean of as many samples from a cut on less that of those before.
    cuts = np.arange(half, 3 * half)
    step = running[:, :, cuts + half] - 2 * running[:, :, cuts] + running[:, :, cuts - half]
    known = grid.known[:, index].all(axis=(0, 2))
    samples = (starts[known, None] + cuts).ravel()
    return step[:, known].reshape(len(step), -1, 6) / half, samples


def _jumps(
    noise: FloatArray, steps: FloatArray, samples: NDArray[np.intp], sensor: int, half: int,
) -> list[tuple[int, FloatArray]]:
    """Return where one sensor jumps most against all others, and the (6,) twists of the base."""
    _, step, weight = _against(noise, steps, np.ones(steps.shape[:2], dtype=np.bool_), sensor)
    size = _squared(step, weight)
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
    """Return (B, 6) scores and (B, 6, 6) information of one sensor against all others."""
    score, information = np.zeros((blocks, 6)), np.zeros((blocks, 6, 6))
    for level, N in zip(levels, noise, strict=True):
        if 2 * level.samples > size:
            break
        windows, apart, K = _against(N, level.differences, level.known, sensor)
        # A jump of a track is no move of a mount.
        trust = np.minimum(1.0, 24.0 / np.maximum(_squared(apart, K), 1e-12))
        J = level.jacobian[windows]
        weighted = trust[:, None, None] * np.swapaxes(J, 1, 2) @ K
        block = np.minimum(2 * level.samples * windows // size, blocks - 1)
        np.add.at(score, block, -(weighted @ apart[:, :, None])[:, :, 0])
        np.add.at(information, block, weighted @ J)
    return score, information


def _against(
    noise: FloatArray, values: FloatArray, known: NDArray[np.bool_], sensor: int,
) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Return where a sensor and two others have values, and there how far it is from their mean.

    ``values`` are (S, W, 6), ``known`` (S, W); the weight of what is returned is (W', 6, 6).
    """
    others = known.copy()
    others[sensor] = False
    at = np.flatnonzero(known[sensor] & (others.sum(axis=0) >= 2))
    W = others[:, at, None, None] * np.linalg.inv(noise)[:, None]
    P = np.linalg.inv(W.sum(axis=0))
    mean = P @ np.sum(W @ values[:, at, :, None], axis=0)
    return at, values[sensor, at] - mean[:, :, 0], np.linalg.inv(noise[sensor] + P)


def _squared(apart: FloatArray, weight: FloatArray) -> FloatArray:
    """Return (W,) chi-squared of (W, 6) values."""
    found: FloatArray = np.einsum('wi,wij,wj->w', apart, weight, apart)
    return found


def _change(
    score: FloatArray, information: FloatArray, unobserved: FloatArray, until: int, since: int,
) -> tuple[FloatArray, FloatArray, int] | None:
    """Return the (6,) change of the extrinsic between two blocks, and its (6, 6) weight.

    Also the degrees of freedom with which the noise in the weight was estimated.
    """
    known = np.trace(information, axis1=1, axis2=2) > 0
    parts = [np.flatnonzero(known[:until]), since + np.flatnonzero(known[since:])]
    if min(map(len, parts)) < _AROUND:
        return None
    untold = np.diag(1.0 / _UNTOLD**2)
    H = [information[part].sum(axis=0) for part in parts]
    x = [np.linalg.solve(h + untold, score[part].sum(axis=0))
         for h, part in zip(H, parts, strict=True)]
    # By how much the blocks scatter more than their noise says.
    left = np.concatenate([score[part] - information[part] @ answer
                           for part, answer in zip(parts, x, strict=True)])
    used = information[np.concatenate(parts)] + untold
    scatter = float(np.sum(left * np.linalg.solve(used, left[:, :, None])[:, :, 0]))
    of_noise = 6 * (len(left) - 2)
    weight = H[0] @ np.linalg.solve(H[0] + H[1] + untold, H[1])
    return x[1] - x[0], without(weight / max(1.0, scatter / of_noise), unobserved), of_noise


def describe_size(step: FloatArray) -> str:
    """Return a (6,) step in words: how far, and by what angle."""
    metres = float(np.linalg.norm(step[:3]))
    degrees = float(np.rad2deg(np.linalg.norm(step[3:])))
    return f'{rounded(100 * metres)} cm and {rounded(degrees)} deg'
