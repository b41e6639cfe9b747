# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which sensor does not fit the others, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.chi_squared import FALSE_ALARM
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.rig.clocks import Clock
from trajectory_calibration.rig.observed import probability, without
from trajectory_calibration.rig.result import Contradiction
from trajectory_calibration.rig.tree import Tree
from trajectory_calibration.rig.windows import Grid, Level, TWIST

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

_Numbers = NDArray[np.floating[Any]]


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
    count = int(levels[0].last[-1]) + 1
    size = 2 ** max(1, int(np.log2(count / _BLOCKS)))
    blocks = count // size
    if blocks < 2 * _AROUND:
        return None
    # The length at which a jump shows best: white noise is averaged, and drift is small yet.
    best = int(np.argmin(np.trace(noise[:, :, :3, :3], axis1=2, axis2=3).mean(axis=1)))
    half = min(2 ** best, size)
    steps, samples = _steps(grid, half)
    found = []
    for s, free in enumerate(tree.free_twists()):
        evidence = *_blocks(levels, noise, s, size, blocks), free
        degrees = 6 - free.shape[1]
        tried = [(cut * size, None, *told) for cut in range(blocks)
                 if (told := _change(*evidence, cut, cut)) is not None]
        jumps = [(sample, jump, *told)
                 for sample, jump in _jumps(noise[best], steps, samples, s, half)
                 if (told := _change(*evidence, sample // size, sample // size + 1)) is not None]
        for sample, jump, change, weight in (*tried, *jumps):
            chi_squared = float(change @ weight @ change)
            p_value = probability(chi_squared, degrees) * len(tried)
            if jump is not None:
                chi_squared -= float((change - jump) @ weight @ (change - jump))
                # Whatever its size, a jump of the track alone exceeds this no more often.
                p_value = math.erfc(math.sqrt(max(chi_squared, 0.0) / 2)) / 2 * len(jumps)
            found.append((
                min(1.0, p_value * len(tree.names)), -chi_squared, 1 if jump is not None else
                degrees, s, sample, change if jump is None else jump))
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
        name, 'moved', f'the mount of {name} moved by {describe_step(step)} near {seconds:.0f} s: '
        'fasten it, and calibrate the parts before and after alone',
        -chi_squared, degrees, p_value)


def _steps(grid: Grid, half: int) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return (S, K', 6) steps of each sensor against the first, and the (K',) samples.

    A step is the mean of the ``half`` samples from a sample on less that of those before, as a
    twist about the base.
    """
    count, width = len(grid.stamps_ns), 4 * half
    starts = np.arange(0, count - width + 1, 2 * half)
    index = starts[:, None] + np.arange(width)
    part = grid.poses[:, index]
    motion = se3.inverse(part[:, :, :1]) @ part
    away = se3.log_se3(se3.inverse(motion[0]) @ motion)
    nothing = np.zeros((*away.shape[:2], 1, 6))
    running = np.cumsum(np.concatenate([nothing, away], axis=2), axis=2)
    cuts = np.arange(half, 3 * half)
    step = running[:, :, cuts + half] - 2 * running[:, :, cuts] + running[:, :, cuts - half]
    known = grid.known[:, index].all(axis=(0, 2))
    samples = (starts[known, None] + cuts).ravel()
    return step[:, known].reshape(len(step), -1, 6) / half, samples


def _jumps(
    noise: FloatArray, steps: FloatArray, samples: NDArray[np.intp], sensor: int, half: int,
) -> list[tuple[int, FloatArray]]:
    """Return where one sensor jumps most against all others, and the (6,) twists of the base.

    ``noise`` (S, 6, 6) are the covariances of the steps.
    """
    others = [s for s in range(len(noise)) if s != sensor]
    W = np.linalg.inv(noise[others])
    of_others = np.linalg.inv(W.sum(axis=0))
    step = steps[sensor] - _mean(of_others, W, steps[others])
    size = np.sum(step @ np.linalg.inv(noise[sensor] + of_others) * step, axis=1)
    found: list[tuple[int, FloatArray]] = []
    while len(found) < _JUMPS and len(size):
        most = int(np.argmax(size))
        if size[most] < _LARGE_JUMP:
            break
        found.append((int(samples[most]), step[most]))
        size[np.abs(samples - samples[most]) <= 2 * half] = 0.0
    return found


def _blocks(
    levels: Sequence[Level], noise: FloatArray, sensor: int, size: int, blocks: int,
) -> tuple[FloatArray, FloatArray]:
    """Return (B, 6) scores and (B, 6, 6) information of one sensor against all others."""
    score, information = np.zeros((blocks, 6)), np.zeros((blocks, 6, 6))
    for level, N in zip(levels, noise, strict=True):
        if level.last[0] - level.first[0] >= size:
            break
        W = np.linalg.inv(N)
        patterns, which = np.unique(level.known.T, axis=0, return_inverse=True)
        for p, pattern in enumerate(patterns):
            others = np.flatnonzero(pattern)
            others = others[others != sensor]
            if not pattern[sensor] or len(others) < 2:
                continue
            windows = np.flatnonzero(which.ravel() == p)
            of_others = np.linalg.inv(W[others].sum(axis=0))
            apart = level.differences[sensor, windows] - _mean(
                of_others, W[others], level.differences[others][:, windows])
            K = np.linalg.inv(N[sensor] + of_others)
            # A jump of a track is no move of a mount.
            squared = np.sum(apart @ K * apart, axis=1) / 6
            trust = np.minimum(1.0, 4.0 / np.maximum(squared, 1e-12))
            J = level.jacobian[windows][:, :, TWIST]
            weighted = trust[:, None, None] * np.swapaxes(J, 1, 2) @ K
            block = np.minimum(level.first[windows] // size, blocks - 1)
            np.add.at(score, block, -(weighted @ apart[:, :, None])[:, :, 0])
            np.add.at(information, block, weighted @ J)
    return score, information


def _mean(P: _Numbers, W: _Numbers, values: FloatArray) -> FloatArray:
    """Return (W, 6) means of (S, W, 6) values with (S, 6, 6) weights, whose sum has inverse P."""
    mean: FloatArray = (values @ (P @ W).swapaxes(1, 2)).sum(axis=0)
    return mean


def _change(
    score: FloatArray, information: FloatArray, free: FloatArray, until: int, since: int,
) -> tuple[FloatArray, FloatArray] | None:
    """Return the (6,) change of the extrinsic between two blocks, and its (6, 6) weight."""
    known = np.trace(information, axis1=1, axis2=2) > 0
    parts = (slice(None, until), slice(since, None))
    if min(np.count_nonzero(known[part]) for part in parts) < _AROUND:
        return None
    untold = np.diag(1.0 / _UNTOLD**2)
    H = [information[part].sum(axis=0) for part in parts]
    x = [np.linalg.solve(h + untold, score[part].sum(axis=0))
         for h, part in zip(H, parts, strict=True)]
    # By how much the blocks scatter more than their noise says.
    left = np.concatenate([(score[part] - information[part] @ answer)[known[part]]
                           for part, answer in zip(parts, x, strict=True)])
    used = np.concatenate([information[part][known[part]] for part in parts])
    scatter = np.einsum(
        'bi,bi->', left, np.linalg.solve(used + untold, left[:, :, None])[:, :, 0])
    inflation = max(1.0, float(scatter) / (6 * (len(left) - 2)))
    weight = H[0] @ np.linalg.solve(H[0] + H[1] + untold, H[1]) / inflation
    return x[1] - x[0], without(weight, free)


def find_other_clocks(clocks: Sequence[Clock], stamp_ns: int) -> list[tuple[int, float]]:
    """Return the sensors whose clock is off that of most others, and by how many seconds.

    Positive: the stamps are late. Only where most sensors share one clock.
    """
    seconds = np.array([clock.at(stamp_ns) for clock in clocks])
    sure = np.array([clock.offset_std_s for clock in clocks])
    agree = np.abs(seconds[:, None] - seconds) <= _SAME_CLOCK_S
    centre = int(np.argmax(agree.sum(axis=1)))
    same = agree[centre]
    if np.count_nonzero(same) < max(2, len(clocks) / 2 + 0.5):
        return []
    usual = float(np.median(seconds[same]))
    off = seconds - usual
    return [(int(k), -float(off[k])) for k in np.flatnonzero(
        (np.abs(off) > _OTHER_CLOCK_S) & (np.abs(off) > _SURE * sure))]


def describe_step(step: FloatArray) -> str:
    """Return a (6,) step in words: how far, and by what angle."""
    metres = float(np.linalg.norm(step[:3]))
    degrees = float(np.rad2deg(np.linalg.norm(step[3:])))
    return f'{100 * metres:.2g} cm and {degrees:.2g} deg'
