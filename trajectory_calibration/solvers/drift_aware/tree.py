# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The tree of worlds: a likelihood of two trajectories in O(N), without a loop over poses.

Pose k says where the world of b lies in the world of a: ``Z_k = A_k X B_k^-1``. Between perfect
sensors all are one. Here every window of 2, 4, 8 ... poses has a world of its own: that of the
window twice as long around it, displaced by noise of its octave, and a pose displaces the world
of its window by the white noise of the two sensors. Going up, two neighbouring windows with
estimates (Z_1, P_1) and (Z_2, P_2) of their worlds tell one *contrast*,

    d = log(Z_1^-1 Z_2),    d ~ N(J dx, V),    V = P_1 + P_2 + D_octave,

seen at the body between them, and merge to one estimate as a Kalman filter would:

    G = (P_1 + D/2) V^-1,   Z = Z_1 exp(G d),   P = (1 - G)(P_1 + D/2)(1 - G)' + G (P_2 + D/2) G'.

Contrasts are independent, so that ``sum log det V + d' V^-1 d`` is -2 log likelihood. With D = 0
it is that of one world for all poses (robot-world hand-eye calibration, ``A X = Z B``); noise
that walks doubles D from octave to octave, flicker keeps it: the variances that an Allan
deviation plots, here estimated beside X. A jump displaces the world across one boundary only.

K. C. Chou, A. S. Willsky, A. Benveniste, "Multiscale recursive estimation, data fusion, and
regularization", IEEE TAC 39(3), 1994, doi:10.1109/9.280746. G. W. Wornell, "Wavelet-based
representations for the 1/f family of fractal processes", Proc. IEEE 81(10), 1993,
doi:10.1109/5.241506 (why contrasts of dyadic windows decorrelate such noise).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.algebra import (
    adjoint_of_inverse,
    apply,
    exp,
    log,
    ROTATION,
    TRANSLATION,
    transposed,
)
from trajectory_calibration.solvers.drift_aware.drive import (
    correct,
    Corrected,
    Drive,
    LATENCY,
    OFFSET,
    PARAMETERS,
    SCALE,
    State,
)

Indices = NDArray[np.intp]
_IDENTITY = np.eye(6)


@dataclass(frozen=True, eq=False)
class Level:
    """One round of merging neighbours; nodes are the windows that are left, in time order.

    Attributes
    ----------
    left, right : (n,) the nodes that merge.
    kept : (nodes,) bool, which go on: those merged into, and one without a neighbour.
    merged : (n,) where the merged are among the kept.
    boundary : (n,) the first pose of the right window.
    octave : (n,) log2 of the poses of the shorter one.

    """

    left: Indices
    right: Indices
    kept: NDArray[np.bool_]
    merged: Indices
    boundary: Indices
    octave: Indices


@dataclass(frozen=True, eq=False)
class Plan:
    """Which windows merge with which, and the order of all contrasts: by octave, then by time.

    Attributes
    ----------
    levels : the rounds.
    order : (n,) from the order of the rounds to that of the octaves.
    boundary, octave : (n,) of every contrast, in that order.
    first : (octaves,) where the contrasts of each octave begin.

    """

    levels: tuple[Level, ...]
    order: Indices
    boundary: Indices
    octave: Indices
    first: Indices

    @property
    def octaves(self) -> int:
        """Return how many octaves there may be."""
        return int(self.octave[-1]) + 1


def plan(cut: NDArray[np.bool_]) -> Plan:
    """Return the tree: windows between the (N - 1,) cuts first, then across them."""
    stretch = np.concatenate([[0], np.cumsum(cut)])
    first, end = np.arange(len(stretch)), np.arange(len(stretch)) + 1
    levels = []
    while len(first) > 1:
        group = stretch[first]
        begins = np.flatnonzero(np.concatenate([[True], group[1:] != group[:-1]]))
        if len(begins) == len(first):
            begins = begins[:1]
        sizes = np.diff(np.append(begins, len(first)))
        odd = (np.arange(len(first)) - np.repeat(begins, sizes)) % 2 == 1
        right = np.flatnonzero(odd)
        left, kept = right - 1, ~odd
        boundary = first[right]
        shorter = np.minimum(boundary - first[left], end[right] - boundary)
        levels.append(Level(left, right, kept, (np.cumsum(kept) - 1)[left], boundary,
                            np.floor(np.log2(shorter) + 0.5).astype(np.intp)))
        end[left] = end[right]
        first, end = first[kept], end[kept]
    octave = np.concatenate([level.octave for level in levels])
    boundary = np.concatenate([level.boundary for level in levels])
    order = np.lexsort((boundary, octave))
    octave = octave[order]
    begins = np.flatnonzero(np.concatenate([[True], octave[1:] != octave[:-1]]))
    return Plan(tuple(levels), order, boundary[order], octave, begins)


@dataclass(frozen=True, eq=False)
class Contrasts:
    """By how much neighbouring windows disagree, in the order of the plan.

    Attributes
    ----------
    d : (n, 6) translation and rotation, in the axes of b at the boundary.
    J : (n, 6, 12) derivatives of d in the parameters.
    V, inverse : (n, 6, 6) its covariance, and the inverse.
    squares : (n,) ``d' V^-1 d``.

    """

    d: FloatArray
    J: FloatArray
    V: FloatArray
    inverse: FloatArray
    squares: FloatArray


@dataclass(frozen=True, eq=False)
class _Worlds:
    """Estimates of the worlds of windows, each as the pose of b at ``body`` in the world of a.

    ``rest`` is (n, 6, 18): derivatives in the parameters, and the covariance P.
    """

    body: Indices
    R: FloatArray
    p: FloatArray
    rest: FloatArray


def contrast(
    drive: Drive,
    state: State,
    tree: Plan,
    white: FloatArray,
    walk: FloatArray,
    jumps: FloatArray,
    weights: FloatArray,
) -> Contrasts:
    """Go up the tree.

    ``white`` is (6, 6), the covariance of the noise of a pose of both sensors in the axes of b;
    ``walk`` (octaves, 2), the variance of translation and rotation between worlds of an octave;
    ``jumps`` (N - 1, 2), what is added to that across each step; ``weights`` (n,), of the
    contrasts in the order of the plan, of which at most one counts here.

    """
    at = correct(drive, state)
    N = len(drive)
    rest = np.zeros((N, 6, PARAMETERS + 6))
    rest[:, :, :6] = _IDENTITY
    rest[:, :, OFFSET] = at.by_offset
    rest[:, :, PARAMETERS:] = white
    worlds = _Worlds(np.arange(N), at.R_ax, at.p_ax, rest)
    trusted = np.empty(len(weights))
    trusted[tree.order] = np.minimum(weights, 1.0)
    parts = []
    begin = 0
    for level in tree.levels:
        noise = np.repeat(walk[level.octave] + jumps[level.boundary - 1], 3, axis=1)
        w = trusted[begin:begin + len(level.left)]
        begin += len(level.left)
        part, worlds = _merge(drive, at, worlds, level, noise, w)
        parts.append(part)
    d, J, V, inverse = (np.concatenate(values)[tree.order] for values in zip(*parts, strict=True))
    return Contrasts(d, J, V, inverse, (d * apply(inverse, d)).sum(axis=1))


def _merge(
    drive: Drive, at: Corrected, worlds: _Worlds, level: Level, noise: FloatArray, w: FloatArray,
) -> tuple[tuple[FloatArray, ...], _Worlds]:
    one = _seen_at(drive, at, worlds, level.left, level.boundary)
    two = _seen_at(drive, at, worlds, level.right, level.boundary)
    back = transposed(one.R)
    d: FloatArray = np.concatenate(
        [apply(back, two.p - one.p), log(back @ two.R)], axis=1)
    J = two.rest[:, :, :PARAMETERS] - one.rest[:, :, :PARAMETERS]
    P_1, P_2 = one.rest[:, :, PARAMETERS:], two.rest[:, :, PARAMETERS:]
    V = P_1 + P_2
    diagonal = np.arange(6)
    V[:, diagonal, diagonal] += noise
    inverse = np.asarray(np.linalg.inv(V), dtype=np.float64)
    # A contrast that is an outlier says that its worlds are further apart: D grows.
    own = 0.5 * ((1 / w - 1)[:, None, None] * V)
    own[:, diagonal, diagonal] += 0.5 * noise
    P_1 = P_1 + own
    G = P_1 @ (w[:, None, None] * inverse)
    stay = _IDENTITY - G
    step = apply(G, d)
    P = stay @ P_1 @ transposed(stay) + G @ (P_2 + own) @ transposed(G)
    merged = _Worlds(
        level.boundary, one.R @ exp(step[:, ROTATION]), one.p + apply(one.R, step[:, TRANSLATION]),
        np.concatenate([one.rest[:, :, :PARAMETERS] + G @ J, 0.5 * (P + transposed(P))], axis=2))
    return (d, J, V, inverse), _put(worlds, merged, level)


def _put(worlds: _Worlds, merged: _Worlds, level: Level) -> _Worlds:
    """Return the nodes of the next round."""
    if level.kept.sum() == len(level.merged):
        return merged
    kept = level.kept
    body, R, p, rest = worlds.body[kept], worlds.R[kept], worlds.p[kept], worlds.rest[kept]
    body[level.merged], R[level.merged] = merged.body, merged.R
    p[level.merged], rest[level.merged] = merged.p, merged.rest
    return _Worlds(body, R, p, rest)


def _seen_at(
    drive: Drive, at: Corrected, worlds: _Worlds, nodes: Indices, pose: Indices,
) -> _Worlds:
    """Return the worlds of some nodes as they are seen at other poses of b."""
    body, R, p, rest = worlds.body[nodes], worlds.R[nodes], worlds.p[nodes], worlds.rest[nodes]
    if (body == pose).all():
        return _Worlds(pose, R, p, rest)
    back = transposed(drive.R_b[body])
    turn, way = back @ drive.R_b[pose], apply(back, at.p_b[pose] - at.p_b[body])
    Ad = adjoint_of_inverse(turn, way)
    rest = Ad @ rest
    rest[:, :, PARAMETERS:] = rest[:, :, PARAMETERS:] @ transposed(Ad)
    rest[:, TRANSLATION, SCALE:LATENCY + 1] += transposed(drive.R_b[pose]) @ (
        at.by_terms[pose] - at.by_terms[body])
    return _Worlds(pose, R @ turn, p + apply(R, way), rest)
