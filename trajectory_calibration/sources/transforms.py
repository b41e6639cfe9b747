# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The pose of one frame in another from a tree of transforms, like a tf2 lookup, without ROS.

A robot publishes ``map -> odom`` and ``odom -> base_link`` separately, each at its own times.
``TransformTree`` stores such edges and composes a chain of them; ``ChainFollower`` does so with
live transforms. docs/inputs.md has the rules for stamps and interpolation. A leading slash is
removed from frame names, as tf2 requires.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable, Sequence
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trajectory_calibration.errors import ConfigError, counted, TopicError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.sources.cdr import Poses
from trajectory_calibration.sources.edges import (
    Edge,
    fault_words,
    interpolated,
    longest_silence_ns,
    matrices,
)

TF_PREFIX = 'tf:'

# Largest number of non-static edges kept before the chain is known.
_MAX_MOVING = 1000


class Link(NamedTuple):
    """One step of a chain: an edge, and whether the step goes from parent to child."""

    edge: Edge
    downwards: bool


class TransformTree:
    """Transforms between frames from /tf and /tf_static."""

    def __init__(self) -> None:
        self._edges: dict[tuple[str, str], Edge] = {}

    def edge(self, parent: str, child: str, *, static: bool = False) -> Edge:
        """Return the edge from a frame to its child; a new edge if there is none."""
        key = parent.lstrip('/'), child.lstrip('/')
        edge = self._edges.get(key)
        if edge is None:
            edge = self._edges[key] = Edge(*key, static)
        return edge

    def drop(self, edge: Edge) -> None:
        """Remove an edge."""
        del self._edges[edge.parent, edge.child]

    def extend(self, parent: str, child: str, stamps_ns: ArrayLike, poses: ArrayLike, *,
               static: bool = False) -> None:
        """Add (N,) stamps and (N, 7) poses of ``child`` in ``parent``."""
        self.edge(parent, child, static=static).extend(stamps_ns, poses)

    @property
    def edges(self) -> tuple[Edge, ...]:
        """All edges, in the order in which they were first seen."""
        return tuple(self._edges.values())

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of all frames."""
        return tuple(dict.fromkeys(name for pair in self._edges for name in pair))

    def pairs(self) -> list[tuple[str, str]]:
        """Return parent and child of frames that move relative to each other.

        Of frames that are fixed to each other only one is listed.
        """
        moving = [edge for edge in self.edges if not edge.static and edge.changes]
        found = []
        for parent in dict.fromkeys(edge.parent for edge in moving):
            paths = self._paths(parent)
            for child in dict.fromkeys(edge.child for edge in moving):
                path = paths.get(child)
                if path and all(link.downwards for link in path):
                    found.append((parent, child))
        return found

    def chain(self, parent: str, child: str) -> list[Link]:
        """Return the links from one frame to another.

        Raise TopicError if a frame is unknown, the two are not connected, or there are two paths
        between them.
        """
        names = self.frames
        for name in (parent, child):
            if name not in names:
                raise TopicError(f'no frame {name} in the transforms; frames: '
                                 f'{", ".join(sorted(names)) or "none"}')
        if parent == child:
            raise TopicError(f'{parent} and {child} are one frame; name two')
        path = self._paths(parent).get(child)
        if path is None:
            trees = ' and '.join(
                f'{name} with {", ".join(sorted(self._paths(name).keys() - {name}))}'
                for name in (parent, child))
            raise TopicError(
                f'no transform connects {parent} and {child}: there are separate trees, of '
                f'{trees}; record the topic that publishes the transform between them')
        for link in path:
            if child in self._paths(parent, without=link.edge):
                raise TopicError(
                    f'there are two paths from {parent} to {child}: {self._two_parents()}; '
                    'name a pair of frames between which there is one')
        return path

    def compose(
        self, parent: str, child: str, notes: list[str] | None = None,
    ) -> tuple[NDArray[np.int64], FloatArray]:
        """Return (N,) stamps and the (N, 4, 4) poses of ``child`` in ``parent``.

        Dropped poses are added to ``notes``. Raise TopicError as ``chain`` does, and if the two
        frames do not move relative to each other.
        """
        links = self.chain(parent, child)
        return _compose(links, stamp_edge(links), [] if notes is None else notes)

    def _paths(self, start: str, without: Edge | None = None) -> dict[str, list[Link]]:
        """Return the shortest paths from a frame to all frames connected with it."""
        links: defaultdict[str, list[tuple[str, Link]]] = defaultdict(list)
        for edge in self.edges:
            if edge is not without:
                links[edge.parent].append((edge.child, Link(edge, downwards=True)))
                links[edge.child].append((edge.parent, Link(edge, downwards=False)))
        reached: dict[str, list[Link]] = {start: []}
        queue = deque([start])
        while queue:
            name = queue.popleft()
            for other, link in links[name]:
                if other not in reached:
                    reached[other] = [*reached[name], link]
                    queue.append(other)
        return reached

    def _two_parents(self) -> str:
        parents = {child: [edge.parent for edge in self.edges if edge.child == child]
                   for child in self.frames}
        return '; '.join(f'{child} has the parents {" and ".join(names)}'
                         for child, names in parents.items() if len(names) > 1)


class ChainFollower:
    """The pose of one frame in another from live transforms.

    ``add`` every transform of /tf and /tf_static, and ``take`` the new poses; ``waiting_for`` is
    the reason if there are none. If the time of an edge of the chain goes back, all earlier
    transforms are dropped, as in tf2.
    """

    def __init__(self, parent: str, child: str) -> None:
        self.parent, self.child = parent.lstrip('/'), child.lstrip('/')
        self._tree = TransformTree()
        self.restart(f'no transform yet: is /tf published? ({self.parent}, {self.child})')

    def restart(self, why: str = 'waiting for the next transforms') -> None:
        """Drop all transforms except the static ones, which are published only once."""
        self.waiting_for = why
        for edge in self._tree.edges:
            if not edge.static:
                self._tree.drop(edge)
        self._last_stamp_ns = -2**63
        # Edges of the chain, empty until it is known; and the edge that gives the stamps.
        self._chain: frozenset[Edge] = frozenset()
        self._children: frozenset[str] = frozenset()
        self._stamps_of: Edge | None = None

    def extend(self, runs: Iterable[Poses], *, static: bool = False) -> None:
        """Add the transforms of several messages in message order."""
        for _, frames, stamp_ns, pose in sorted(
                ((message, run.frames, stamp_ns, pose)
                 for run in runs if not self._is_irrelevant(run.frames[1], static=static)
                 for message, stamp_ns, pose in zip(
                     *(column.tolist() for column in run[1:]), strict=True)),
                key=itemgetter(0)):
            self.add(*frames, stamp_ns, pose, static=static)

    def add(self, parent: str, child: str, stamp_ns: int, pose: Sequence[float], *,
            static: bool = False) -> None:
        """Add one transform: the pose x, y, z (m), qx, qy, qz, qw of ``child`` in ``parent``."""
        if self._is_irrelevant(child, static=static):
            return
        edge = self._tree.edge(parent, child, static=static)
        if self._chain and edge not in self._chain and not static:
            # A second parent: only its existence matters, not its transforms.
            return
        if edge.is_reset(stamp_ns):
            if self._chain:
                self.restart(f'the time of {edge} ran backwards: waiting for its next transforms')
            else:
                self._tree.drop(edge)
            edge = self._tree.edge(parent, child)
        edge.add(stamp_ns, pose)

    def take(self) -> tuple[NDArray[np.int64], FloatArray, NDArray[np.int64]]:
        """Return (N,) stamps and (N, 4, 4) poses since the last call, and (3,) refused transforms.

        The last are numbers of refused transforms of the chain by the kinds of ``pose_faults``.
        """
        stamps_ns, poses = np.zeros(0, np.int64), np.zeros((0, 4, 4))
        for edge in self._tree.edges:
            edge.flush()
        try:
            links = self._tree.chain(self.parent, self.child)
            self._chain = frozenset(link.edge for link in links)
            self._children = frozenset(edge.child for edge in self._chain)
            stamps_ns, poses = self._compose(links)
        except TopicError as error:
            self.waiting_for = str(error)
        moving = [edge for edge in self._tree.edges if not edge.static]
        for edge in moving:
            # Bounds the memory before the chain is known: /tf may have a frame per tracked object.
            if self._is_irrelevant(edge.child) or (
                    not self._chain and len(moving) > _MAX_MOVING):
                self._tree.drop(edge)
        refused = sum((edge.new_refusals() for edge in self._chain), start=np.zeros(3, np.int64))
        return stamps_ns, poses, refused

    def _is_irrelevant(self, child: str, *, static: bool = False) -> bool:
        """Return whether a transform cannot affect the known chain, not even as second parent."""
        # Static ones are kept: after a restart the chain may be another.
        return not static and bool(self._chain) and child.lstrip('/') not in self._children

    def _compose(self, links: Sequence[Link]) -> tuple[NDArray[np.int64], FloatArray]:
        """Return the new stamps and poses of a chain; raise TopicError if nothing moves yet."""
        if self._stamps_of is None:
            edge = stamp_edge(links)
            # Before that, another edge may turn out to change most often.
            if edge.changes < 5:
                raise TopicError(f'{edge} has hardly moved yet')
            self._stamps_of = edge
        stamps_ns, poses = _compose(links, self._stamps_of, [])
        new = stamps_ns > self._last_stamp_ns
        stamps_ns, poses = stamps_ns[new], poses[new]
        if len(stamps_ns):
            self.waiting_for = ''
            self._last_stamp_ns = int(stamps_ns[-1])
            for edge in self._chain:
                edge.forget_before(self._last_stamp_ns)
        elif silent := self._silent_edges():
            raise TopicError(f'{silent} is silent: does its sender run?')
        return stamps_ns, poses

    def _silent_edges(self) -> str:
        """Return the edges of the chain whose last transform is older than a gap, in words."""
        moving = {edge: edge.samples[0] for edge in self._chain if not edge.static}
        newest_ns = max(int(stamps_ns[-1]) for stamps_ns in moving.values())
        return ', '.join(sorted(
            str(edge) for edge, stamps_ns in moving.items()
            if newest_ns - int(stamps_ns[-1]) > longest_silence_ns(stamps_ns)))


def names_frames(name: str) -> bool:
    """Return whether a name is ``tf:PARENT.CHILD``, or ``/tf:PARENT.CHILD`` as in evo."""
    return name.removeprefix('/').startswith(TF_PREFIX)


def parse_tf(name: str, frames: Iterable[str] = ()) -> tuple[str, str]:
    """Return the two frames of ``tf:PARENT.CHILD``.

    If frame names contain dots, the existing ``frames`` determine where to split. Raise
    ConfigError for less than two names, or an ambiguous split.
    """
    words = name.removeprefix('/').removeprefix(TF_PREFIX).split('.')
    splits = [('.'.join(words[:k]).lstrip('/'), '.'.join(words[k:]).lstrip('/'))
              for k in range(1, len(words))]
    splits = [split for split in splits if all(split)]
    if len(splits) > 1:
        splits = [split for split in splits if {*split} <= {*frames}] or splits
    if len(splits) != 1:
        raise ConfigError(f'{name!r} does not name two frames; needed tf:PARENT.CHILD, for '
                          'instance tf:map.base_link')
    return splits[0]


def stamp_edge(links: Sequence[Link]) -> Edge:
    """Return the edge of a chain that gives the stamps: the one that changes most often.

    Raise TopicError if nothing moves between the two frames, or an edge has no usable transform.
    """
    for edge, _ in links:
        if not len(edge.samples[0]):
            raise TopicError(f'{edge} has no usable transform ({fault_words(edge.refused)}); '
                             'correct its sender')
    changes = {link.edge: link.edge.changes for link in links if not link.edge.static}
    most = max(changes.values(), default=0)
    if not most:
        chain = ', '.join(str(link.edge) for link in links)
        raise TopicError(f'nothing moves between these frames: {chain} never changed; name a pair '
                         'of frames that move in relation to each other')
    # Of several that change about equally often, the one nearest to the child.
    return [edge for edge, count in changes.items() if count >= 0.8 * most][-1]


def _compose(
    links: Sequence[Link], stamps_of: Edge, notes: list[str],
) -> tuple[NDArray[np.int64], FloatArray]:
    sampled = {link.edge: link.edge.ordered(notes) for link in links}
    stamps_ns = sampled[stamps_of][0]
    keep, result = np.ones(len(stamps_ns), dtype=bool), np.eye(4)
    for edge, downwards in links:
        own_ns, poses = sampled[edge]
        if edge.static:
            T_step = matrices(poses[-1:])
        else:
            T_step, valid = interpolated(own_ns, poses, stamps_ns)
            lost = np.count_nonzero(keep & ~valid)
            if lost:
                notes.append(f'left out {lost} of {counted(int(np.count_nonzero(keep)), "pose")}: '
                             f'{edge} has no transform at their time')
            keep &= valid
        result = result @ (T_step if downwards else se3.inverse(T_step))
    return stamps_ns[keep], result[keep]
