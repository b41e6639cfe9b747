# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A multiscale tree: the likelihood of two trajectories in O(N), without a loop over poses.

Pose pair k gives the pose of the world of b in the world of a: ``Z_k = A_k X B_k^-1``. For perfect
sensors all Z_k are equal. Here every window of 2, 4, 8 ... poses has a Z of its own: that of the
window twice as long around it, displaced by noise of its octave. A pose displaces the Z of its
window by the white noise of the two sensors. Going up the tree, two neighbouring windows with
estimates (Z_1, P_1) and (Z_2, P_2) give one *contrast*,

    d = log(Z_1^-1 Z_2),    d ~ N(J dx, V),    V = P_1 + P_2 + D_octave,

expressed at the pose of b between them, and are merged as in a Kalman filter:

    G = (P_1 + D/2) V^-1,   Z = Z_1 exp(G d),   P = G (P_2 + D/2).

D has the same variance in all directions, and more along the distance moved (noise of the scale).

Contrasts are independent, so that ``sum log det V + d' V^-1 d`` is -2 log likelihood. With D = 0
it is that of one Z for all poses (robot-world hand-eye calibration, ``A X = Z B``). A random walk
doubles D from octave to octave, flicker noise keeps it: the variances of an Allan deviation plot,
here estimated with X. A jump displaces Z across one boundary only.

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
from trajectory_calibration.solvers.drift_aware.noise import along, NoiseModel

Indices = NDArray[np.intp]
_IDENTITY = np.eye(6)
_DIAGONAL = np.arange(6)


@dataclass(frozen=True, eq=False)
class Level:
    """One round of merging neighbours; nodes are the present windows, in time order.

    Attributes
    ----------
    left, right : (n,) indices of the nodes that merge.
    kept : (nodes,) bool, nodes of the next round: the merged ones, and those without a neighbour.
    merged : (n,) indices of the merged nodes among the kept ones.
    rows : slice of its contrasts among those of all rounds.
    left_moves, right_moves : slices of their moves among those of all rounds; None if they are at
        the boundary already.

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
    """The order of merging, and of all contrasts: by octave, then by time.

    Attributes
    ----------
    levels : the rounds.
    body, pose : (m,) moves of all rounds: the pose of b at which an estimate is expressed, and the
        pose at the boundary to which it is moved.
    rotation : (m, 3, 3) of b between the two.
    back_body, back_pose : (m, 3, 3) inverse rotation of b at the two.
    order : (n,) from the order of the rounds to that of the octaves.
    boundary, octave : (n,) of each contrast, in that order: index of the first pose of the right
        window, and log2 of the number of poses of the shorter window.
    first : (octaves,) index of the first contrast of each octave.

    """

    levels: tuple[Level, ...]
    body: Indices
    pose: Indices
    rotation: FloatArray
    back_body: FloatArray
    back_pose: FloatArray
    order: Indices
    boundary: Indices
    octave: Indices
    first: Indices

    @property
    def octaves(self) -> int:
        """Return the number of octaves."""
        return int(self.octave[-1]) + 1

    @property
    def parts(self) -> list[slice]:
        """Return the slices of the contrasts of each octave that has some."""
        edges = [*self.first.tolist(), len(self.octave)]
        return [slice(*ends) for ends in pairwise(edges)]


def plan(cut: NDArray[np.bool_], R_b: FloatArray) -> Plan:
    """Return the tree: windows between the (N - 1,) cuts merge first, then across the cuts.

    ``R_b`` are the (N, 3, 3) rotations of b.
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
        # In the first round the right nodes are single poses at the boundary.
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
    """Return the nodes as a slice if they are every second one: a view instead of a copy."""
    first, last = int(nodes[0]), int(nodes[-1])
    return slice(first, last + 1, 2) if last - first == 2 * (len(nodes) - 1) else nodes


@dataclass(frozen=True, eq=False)
class Contrasts:
    """Differences of neighbouring windows, in the order of the plan.

    Attributes
    ----------
    d : (n, 6) translation and rotation, in the axes of b at the boundary.
    J : (n, 6, 12) derivatives of d by the parameters.
    V, inverse : (n, 6, 6) covariance of d, and its inverse.
    squares : (n,) ``d' V^-1 d``.

    """

    d: FloatArray
    J: FloatArray
    V: FloatArray
    inverse: FloatArray
    squares: FloatArray


@dataclass(frozen=True, eq=False)
class _Moves:
    """Motions of b that carry estimates from one of its poses to another.

    ``rotation`` (m, 3, 3) and ``translation`` (m, 3) of b, ``Ad`` (m, 6, 6) the adjoint of the
    inverse, ``Ad_transposed`` its contiguous transpose, ``by_terms`` (m, 3, 5) the derivatives of
    ``translation``.
    """

    rotation: FloatArray
    translation: FloatArray
    Ad: FloatArray
    Ad_transposed: FloatArray
    by_terms: FloatArray

    @classmethod
    def of(cls, at: Corrected, tree: Plan) -> _Moves:
        """Return all moves of a tree at once."""
        translation, by_terms = (values[tree.pose] - values[tree.body] for values in (
            at.p_b, at.by_terms))
        translation = apply(tree.back_body, translation)
        Ad = adjoint_of_inverse(tree.rotation, translation)
        return cls(tree.rotation, translation, Ad, np.ascontiguousarray(transposed(Ad)),
                   tree.back_pose @ by_terms)


@dataclass(frozen=True, eq=False)
class _Worlds:
    """Estimates of the Z of windows, each expressed as a pose of b in the world of a.

    ``R`` (n, 3, 3), ``p`` (n, 3); ``J`` (n, 6, 12) are the derivatives by the parameters, ``P``
    (n, 6, 6) is the covariance.
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
    noise: NoiseModel,
    jumps: FloatArray,
    weights: FloatArray,
) -> Contrasts:
    """Return the contrasts of all windows.

    ``jumps`` (N - 1, 2) are variances added across each step. ``weights`` (n,) are those of the
    contrasts in the order of the plan; here they count up to one.
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
    """Return the nodes of the next round, and write the contrasts of this round to ``found``."""
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
    # D grows for an outlier.
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
    """Return the estimates carried to the boundary."""
    if own is None:
        return worlds
    Ad = moves.Ad[own]
    J = Ad @ worlds.J
    J[:, TRANSLATION, SCALE:LATENCY + 1] += moves.by_terms[own]
    return _Worlds(
        worlds.R @ moves.rotation[own], worlds.p + apply(worlds.R, moves.translation[own]), J,
        Ad @ worlds.P @ moves.Ad_transposed[own])
