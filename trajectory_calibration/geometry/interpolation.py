# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Interpolation of a trajectory."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# A change of the twist beyond this many medians over so many poses around is a jump of a SLAM. The
# cubic would carry a sixteenth of a jump into the next interval, too little to be excluded later.
# White noise reaches four medians by chance.
_JUMP, _AROUND = 8.0, 11

# Poses that are processed at once, to stay in the cache of the processor.
_CHUNK = 4096


def left_of(stamps_ns: NDArray[np.int64], at_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the index of the stamp at or before each time, for at least two sorted stamps.

    For times outside it is that of the first or the last step.
    """
    return np.minimum(np.maximum(np.searchsorted(stamps_ns, at_ns), 1), len(stamps_ns) - 1) - 1


def interpolate(
    stamps_ns: NDArray[np.int64],
    poses: FloatArray,
    at_ns: NDArray[np.int64],
    *,
    max_gap_ns: int | None,
) -> FloatArray:
    """Return the (K, 4, 4) poses of a trajectory at (K,) times.

    Between two poses: the cubic through these two and one more on either side, in the tangent
    space at the point of the geodesic. It is exact for a constant twist. For smooth motion its
    error is of fourth order in the step, that of the geodesic of second order. It does not depend
    on the choice of frames, because the tangents of ``G T X`` are those of ``T`` times a matrix.
    Without a neighbour on one side (end, gap or jump) it is the quadratic through three poses.
    Without any, or if the stamps are so uneven that the squared weights add up to more than 1, it
    is the geodesic: no interpolated pose is noisier than a measured one.

    Parameters
    ----------
    stamps_ns : (N,) int64
        Strictly increasing, N >= 2.
    poses : (N, 4, 4)
        Of the trajectory.
    at_ns : (K,) int64
        Times outside the span continue the first and the last geodesic.
    max_gap_ns : int or None
        A pose beyond a longer gap is no neighbour; None: it always is.

    """
    left = left_of(stamps_ns, at_ns)
    since, gap = at_ns - stamps_ns[left], stamps_ns[left + 1] - stamps_ns[left]
    inside = (since > 0) & (since < gap)
    jumps = _twist_jumps(stamps_ns, poses) if inside.any() else np.zeros(len(poses), bool)
    result = np.empty((len(at_ns), 4, 4))
    for start in range(0, len(at_ns), _CHUNK):
        part = slice(start, start + _CHUNK)
        found, near = result[part], left[part]
        found[:] = se3.geodesic(poses[near], poses[near + 1], since[part] / gap[part])
        between = np.flatnonzero(inside[part])
        if len(between):
            found[between] = _on_cubic(
                found[between], stamps_ns, poses, at_ns[part][between], near[between],
                max_gap_ns, jumps)
    return result


def _on_cubic(
    result: FloatArray, stamps_ns: NDArray[np.int64], poses: FloatArray,
    at_ns: NDArray[np.int64], left: NDArray[np.intp], max_gap_ns: int | None,
    jumps: NDArray[np.bool_],
) -> FloatArray:
    """Return the (K, 4, 4) poses on the cubic from those on the geodesic."""
    around = left[:, None] + np.arange(-1, 3)
    known = (around >= 0) & (around < len(stamps_ns))
    around = np.clip(around, 0, len(stamps_ns) - 1)
    if max_gap_ns is not None:
        known[:, [0, 3]] &= np.diff(stamps_ns[around], axis=1)[:, [0, 2]] <= max_gap_ns
    origin = se3.inverse(result)
    tangents = np.stack([se3.log_se3(origin @ poses[k]) for k in around.T], axis=1)
    known &= np.linalg.norm(tangents[..., 3:], axis=-1) <= np.pi / 2
    known[:, 0] &= ~jumps[around[:, 1]]
    known[:, 3] &= ~jumps[around[:, 2]]
    weights = _lagrange((stamps_ns[around] - at_ns[:, None]) * 1e-9, known)
    sound = np.einsum('ij,ij->i', weights, weights) <= 1
    steps = np.einsum('ij,ijk->ik', weights[sound], tangents[sound])
    result[sound] = result[sound] @ se3.exp_se3(steps)
    return result


def _twist_jumps(stamps_ns: NDArray[np.int64], poses: FloatArray) -> NDArray[np.bool_]:
    """Return at which of the (N,) poses the twist jumps."""
    jumps = np.zeros(len(poses), bool)
    if len(poses) < _AROUND:
        return jumps
    seconds = np.diff(stamps_ns)[:, None] * 1e-9
    twists = np.empty((len(seconds), 6))
    for start in range(0, len(twists), _CHUNK):
        part = poses[start:start + _CHUNK + 1]
        twists[start:start + _CHUNK] = se3.log_se3(se3.inverse(part[:-1]) @ part[1:])
    twists /= seconds
    # The second divided difference, which is what the cubic adds to the geodesic.
    change = np.diff(twists, axis=0) / (seconds[:-1] + seconds[1:])
    for part in (change[:, :3], change[:, 3:]):
        size = np.linalg.norm(part, axis=1)
        padded = np.pad(size, _AROUND // 2, mode='reflect')
        usual = np.median(sliding_window_view(padded, _AROUND), axis=1)
        jumps[1:-1] |= size > _JUMP * usual
    return jumps


def _lagrange(nodes: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Return (K, M) Lagrange weights at zero of those of (K, M) nodes that are ``known``."""
    differences = nodes[:, None, :] - nodes[:, :, None]
    both = known[:, None, :] & known[:, :, None] & ~np.eye(nodes.shape[1], dtype=bool)
    factors = np.divide(nodes[:, None, :], differences, out=np.ones_like(differences), where=both)
    weights: FloatArray = known * factors.prod(axis=2)
    return weights
