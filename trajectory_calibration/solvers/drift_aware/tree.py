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

    G = (P_1 + D/2) V^-1,   Z = Z_1 exp(G d),   P = G (P_2 + D/2).

D has the same variance in all directions, and more along the distance moved (the scale of worlds
differs too).

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
from itertools import pairwise

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
from trajectory_calibration.solvers.drift_aware.noise import along, Noise

Indices = NDArray[np.intp]
_IDENTITY = np.eye(6)
_DIAGONAL = np.arange(6)


@dataclass(frozen=True, eq=False)
class Level:
    """One round of merging neighbours; nodes are the windows that are left, in time order.

    Attributes
    ----------
    left, right : (n,) the nodes that merge.
    kept : (nodes,) bool, which go on: those merged into, and one without a neighbour.
    merged : (n,) where the merged are among the kept.
    rows : where its contrasts are among those of all rounds.
    left_moves, right_moves : where the moves of both are among those of all rounds; None where
        they are seen at the boundary.

    """

    left: Indices | slice
    right: Indices | slice
    kept: NDArray[np.bool_]
    merged: Indices
    rows: slice
    left_moves: slice
    right_moves: slice | None


@dataclass(frozen=True, eq=False)
class Plan:
    """Which windows merge with which, and the order of all contrasts: by octave, then by time.

    Attributes
    ----------
    levels : the rounds.
    body, pose : (m,) the moves of all rounds: the pose of b at which a world was seen so far,
        and the boundary at which it is to be seen.
    turn : (m, 3, 3) how b turned from there to there.
    back_body, back_pose : (m, 3, 3) the world of b as it is seen there.
    order : (n,) from the order of the rounds to that of the octaves.
    boundary, octave : (n,) of every contrast, in that order: the first pose of the right window,
        and log2 of the poses of the shorter one.
    first : (octaves,) where the contrasts of each octave begin.

    """

    levels: tuple[Level, ...]
    body: Indices
    pose: Indices
    turn: FloatArray
    back_body: FloatArray
    back_pose: FloatArray
    order: Indices
    boundary: Indices
    octave: Indices
    first: Indices

    @property
    def octaves(self) -> int:
        """Return how many octaves there may be."""
        return int(self.octave[-1]) + 1

    @property
    def parts(self) -> list[slice]:
        """Return where the contrasts of each octave are, those without any left out."""
        edges = [*self.first.tolist(), len(self.octave)]
        return [slice(*ends) for ends in pairwise(edges)]


def plan(cut: NDArray[np.bool_], R_b: FloatArray) -> Plan:
    """Return the tree: windows between the (N - 1,) cuts first, then across them.

    ``R_b`` are the (N, 3, 3) attitudes of b.
    """
    stretch = np.concatenate([[0], np.cumsum(cut)])
    first, end = np.arange(len(stretch)), np.arange(len(stretch)) + 1
    seen_at = first.copy()
    levels: list[Level] = []
    boundaries, octaves, bodies, poses = [], [], [], []
    row = move = 0
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
        # In the first round the right ones are single poses, seen where they are.
        moving = (left, right) if levels else (left,)
        moves = []
        for nodes in moving:
            bodies.append(seen_at[nodes])
            poses.append(boundary)
            moves.append(slice(move, move + len(nodes)))
            move = moves[-1].stop
        pairs = (_every_second(left), _every_second(right))
        levels.append(Level(
            *pairs, kept, (np.cumsum(kept) - 1)[left], slice(row, row + len(left)), moves[0],
            moves[1] if levels else None))
        row += len(left)
        boundaries.append(boundary)
        octaves.append(np.floor(np.log2(shorter) + 0.5).astype(np.intp))
        end[left], seen_at[left] = end[right], boundary
        first, end, seen_at = first[kept], end[kept], seen_at[kept]
    boundary, octave, body, pose = map(np.concatenate, (boundaries, octaves, bodies, poses))
    order = np.lexsort((boundary, octave))
    octave = octave[order]
    begins = np.flatnonzero(np.concatenate([[True], octave[1:] != octave[:-1]]))
    back_body, back_pose = (
        np.ascontiguousarray(transposed(R_b[where])) for where in (body, pose))
    return Plan(tuple(levels), body, pose, back_body @ R_b[pose], back_body, back_pose, order,
                boundary[order], octave, begins)


def _every_second(nodes: Indices) -> Indices | slice:
    """Return the nodes as a slice where they are every second one: a view instead of a copy."""
    first, last = int(nodes[0]), int(nodes[-1])
    return slice(first, last + 1, 2) if last - first == 2 * (len(nodes) - 1) else nodes


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
class _Moves:
    """What becomes of worlds that are seen at another pose of b.

    ``turn`` (m, 3, 3) and ``way`` (m, 3) are the motion of b, ``Ad`` (m, 6, 6) is the adjoint of
    its inverse, ``Ad_transposed`` has the memory to be multiplied by, ``by_terms`` (m, 3, 5) are
    its derivatives.
    """

    turn: FloatArray
    way: FloatArray
    Ad: FloatArray
    Ad_transposed: FloatArray
    by_terms: FloatArray

    @classmethod
    def of(cls, at: Corrected, tree: Plan) -> _Moves:
        """Return all moves of a tree at once."""
        way, by_terms = (values[tree.pose] - values[tree.body] for values in (
            at.p_b, at.by_terms))
        way = apply(tree.back_body, way)
        Ad = adjoint_of_inverse(tree.turn, way)
        return cls(tree.turn, way, Ad, np.ascontiguousarray(transposed(Ad)),
                   tree.back_pose @ by_terms)


@dataclass(frozen=True, eq=False)
class _Worlds:
    """Estimates of the worlds of windows, each as the pose of b in the world of a.

    ``J`` (n, 6, 12) are the derivatives in the parameters, ``P`` (n, 6, 6) is the covariance.
    """

    R: FloatArray
    p: FloatArray
    J: FloatArray
    P: FloatArray

    def picked(self, nodes: Indices | NDArray[np.bool_] | slice) -> _Worlds:
        """Return some of them."""
        return _Worlds(self.R[nodes], self.p[nodes], self.J[nodes], self.P[nodes])


def contrast(
    drive: Drive,
    state: State,
    tree: Plan,
    noise: Noise,
    jumps: FloatArray,
    weights: FloatArray,
) -> Contrasts:
    """Go up the tree.

    ``jumps`` (N - 1, 2), the variances that are added across each step; ``weights`` (n,), of the
    contrasts in the order of the plan, of which at most one counts here.
    """
    at = correct(drive, state)
    N, n = len(drive), len(tree.octave)
    J = np.zeros((N, 6, PARAMETERS))
    J[:, :, :6] = _IDENTITY
    J[:, :, OFFSET] = at.by_offset
    worlds = _Worlds(at.R_ax, at.p_ax, J, noise.of_poses(state.T_a_b, at.by_offset))
    moves = _Moves.of(at, tree)
    # All in the order of the rounds.
    D, trusted, of_scale = np.zeros((n, 6, 6)), np.empty((n, 1, 1)), np.empty((n, 1, 1))
    variance = noise.walk[tree.octave] + jumps[tree.boundary - 1]
    D[tree.order[:, None], _DIAGONAL, _DIAGONAL] = np.repeat(variance, 3, axis=1)
    trusted[tree.order, 0, 0] = np.minimum(weights, 1.0)
    of_scale[tree.order, 0, 0] = noise.of_scale(tree.octaves)[tree.octave]
    d, J, V, inverse = (np.empty((n, 6, *columns)) for columns in (
        (), (PARAMETERS,), (6,), (6,)))
    for level in tree.levels:
        rows = level.rows
        worlds = _merge(moves, worlds, level, D[rows], of_scale[rows], trusted[rows],
                        (d[rows], J[rows], V[rows], inverse[rows]))
    d, J, V, inverse = (values[tree.order] for values in (d, J, V, inverse))
    return Contrasts(d, J, V, inverse, (d * apply(inverse, d)).sum(axis=1))


def _merge(
    moves: _Moves, worlds: _Worlds, level: Level, D: FloatArray, of_scale: FloatArray,
    w: FloatArray,
    found: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
) -> _Worlds:
    """Return the nodes of the next round; put the contrasts of this one into ``found``."""
    d, J, V, inverse = found
    one = _seen_at_boundary(moves, level.left_moves, worlds.picked(level.left))
    two = _seen_at_boundary(moves, level.right_moves, worlds.picked(level.right))
    back = np.ascontiguousarray(transposed(one.R))
    d[:, TRANSLATION], d[:, ROTATION] = apply(back, two.p - one.p), log(back @ two.R)
    np.subtract(two.J, one.J, out=J)
    D = D + of_scale * along(J[:, :, SCALE])
    np.add(one.P, two.P, out=V)
    V += D
    inverse[:] = np.linalg.inv(V)
    # A contrast that is an outlier says that its worlds are further apart: D grows.
    own = 0.5 * ((1 / w - 1) * V + D)
    G = (one.P + own) @ (w * inverse)
    P = G @ (two.P + own)
    step = apply(G, d)
    merged = _Worlds(
        one.R @ exp(step[:, ROTATION]), one.p + apply(one.R, step[:, TRANSLATION]),
        one.J + G @ J, 0.5 * (P + transposed(P)))
    return _put(worlds, merged, level)


def _put(worlds: _Worlds, merged: _Worlds, level: Level) -> _Worlds:
    """Return the nodes of the next round."""
    if 2 * len(level.merged) == len(level.kept):
        return merged
    result = worlds.picked(level.kept)
    for values, own in ((result.R, merged.R), (result.p, merged.p), (result.J, merged.J),
                        (result.P, merged.P)):
        values[level.merged] = own
    return result


def _seen_at_boundary(moves: _Moves, own: slice | None, worlds: _Worlds) -> _Worlds:
    """Return worlds after their moves."""
    if own is None:
        return worlds
    Ad = moves.Ad[own]
    J = Ad @ worlds.J
    J[:, TRANSLATION, SCALE:LATENCY + 1] += moves.by_terms[own]
    return _Worlds(
        worlds.R @ moves.turn[own], worlds.p + apply(worlds.R, moves.way[own]), J,
        Ad @ worlds.P @ moves.Ad_transposed[own])
