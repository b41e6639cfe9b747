# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Where an extrinsic may hang in the frames of a vehicle, so that TF stays a tree.

In TF a frame has one parent. A second transform for a frame that has one moves the frame under
the new parent in every tf2 buffer, without a warning, and tears the rest of the tree off. So the
node listens first, and ``VehicleFrames.place`` says which edge carries the extrinsic:

* the child b has no parent: a -> b;
* b has one, and the parent sensor a has none: from the top of the fixed frames above b, as a
  rule base_link, to a;
* both have one in separate trees, and everything above b is fixed: a -> the root of the tree
  of b, as a rule the body of its driver;
* otherwise none: a and b are connected already, and a second way between them is no tree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.frame_tree import between, Edge, upwards

# Transforms of this difference, metres and radians, are one that was published twice.
_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class Placement:
    """What becomes of an extrinsic in TF.

    Attributes
    ----------
    edge : the transform to publish, None where none may be.
    reason : why it is not a -> b, or why there is none; '' for a -> b.

    """

    edge: Edge | None
    reason: str = ''


class VehicleFrames:
    """The frames that a vehicle publishes on /tf and /tf_static, each with its parent.

    Attributes
    ----------
    conflicts : sentences about frames that were published with two parents.

    """

    def __init__(self) -> None:
        self._edges: dict[str, Edge] = {}
        self._own: Edge | None = None
        self._published: list[Edge] = []
        self._conflicts: dict[str, str] = {}

    @property
    def conflicts(self) -> tuple[str, ...]:
        """Return a sentence for each frame that was published with two parents."""
        return tuple(self._conflicts.values())

    def add(
        self, parent: str, child: str, T_parent_child: FloatArray, *, static: bool,
    ) -> None:
        """Take a transform as it arrives; what this node published itself is left out."""
        edge = Edge(parent.lstrip('/'), child.lstrip('/'), T_parent_child,
                    'fixed' if static else 'moving')
        if not edge.parent or not edge.child or edge.parent == edge.child:
            return
        if static and any(_is_same(edge, own) for own in self._published):
            return
        before = self._edges.get(edge.child)
        if before is not None and before.parent != edge.parent:
            self._conflicts[edge.child] = (
                f'{edge.child} is published with two parents, {before.parent} and {edge.parent}')
        if self._own is not None and edge.child == self._own.child:
            self._conflicts[edge.child] = (
                f'another node publishes {edge.parent} -> {edge.child}, which this node '
                f'publishes as {self._own.parent} -> {self._own.child}; stop one of the two')
        self._edges[edge.child] = edge

    def published(self, edge: Edge) -> None:
        """Note what this node has put on /tf_static, which it will hear itself."""
        self._own = edge
        self._published.append(edge)

    def transform(self, frame_a: str, frame_b: str) -> FloatArray | None:
        """Return the (4, 4) pose of frame b in frame a, None where that is not fixed."""
        found = between(self._edges, frame_a, frame_b)
        return found[0] if found is not None and found[1] is None else None

    def place(
        self, frame_a: str, frame_b: str, T_a_b: FloatArray,
        invented: frozenset[str] = frozenset(),
    ) -> Placement:
        """Return which transform carries the extrinsic.

        Parameters
        ----------
        frame_a, frame_b : str
            The parent and the child sensor.
        T_a_b : (4, 4)
            The pose of b in a.
        invented : frozenset of str
            Names that no message and no setting gave, which must not reach TF.

        """
        if frame_a == frame_b:
            return Placement(None, f'both frames are {frame_a}; set frame_a and frame_b')
        for name, setting in ((frame_a, 'frame_a'), (frame_b, 'frame_b')):
            if name in invented:
                return Placement(None, f'the messages name no frame for {name}; set {setting}')
        parent_a, parent_b = self._edges.get(frame_a), self._edges.get(frame_b)
        found = between(self._edges, frame_a, frame_b)
        if found is not None:
            cure = (
                'correct that transform, for instance in the URDF, instead of adding a second'
                if found[1] is None else
                'a SLAM or an odometry publishes it: switch off the TF of one of the two')
            return Placement(None, (
                f'the vehicle already connects {frame_a} and {frame_b} ({self._way(frame_b)}); '
                f'{cure}'))
        if parent_b is None:
            return Placement(Edge(frame_a, frame_b, T_a_b))
        top, T_top_b, is_root = self._fixed_top(frame_b)
        if parent_a is None:
            return Placement(
                Edge(top, frame_a, T_top_b @ se3.inverse(T_a_b)),
                f'{frame_b} already has the parent {parent_b.parent}: published as '
                f'{top} -> {frame_a}')
        if is_root:
            return Placement(
                Edge(frame_a, top, T_a_b @ se3.inverse(T_top_b)),
                f'{frame_b} already has the parent {parent_b.parent}: published as '
                f'{frame_a} -> {top}')
        return Placement(None, (
            f'{frame_b} already has the parent {parent_b.parent} and {frame_a} the parent '
            f'{parent_a.parent}, in two trees that both move; publish the transform that '
            'connects them yourself'))

    def _fixed_top(self, frame: str) -> tuple[str, FloatArray, bool]:
        """Return the highest frame that is fixed to this one, the pose in it, and if a root."""
        top, T_top, _ = [item for item in upwards(self._edges, frame) if item[2] is None][-1]
        return top, T_top, top not in self._edges

    def _way(self, frame: str) -> str:
        return ' <- '.join(name for name, _, _ in upwards(self._edges, frame))


def difference(T_a_b: FloatArray, T_a_b_today: FloatArray) -> str:
    """Return in words how far an answer is from the transform that the vehicle has today."""
    # Zero is added so that nothing is -0.0000.
    shift = np.round(T_a_b[:3, 3] - T_a_b_today[:3, 3], 4) + 0.0
    turn = np.round(
        np.rad2deg(se3.log_so3(T_a_b[:3, :3] @ T_a_b_today[:3, :3].T)), 3) + 0.0
    return (f'{np.linalg.norm(shift):.4f} m (x {shift[0]:+.4f}, y {shift[1]:+.4f}, '
            f'z {shift[2]:+.4f}) and {np.linalg.norm(turn):.3f} deg '
            f'(about x {turn[0]:+.3f}, y {turn[1]:+.3f}, z {turn[2]:+.3f})')


def _is_same(edge: Edge, own: Edge) -> bool:
    return ((edge.parent, edge.child) == (own.parent, own.child)
            and bool(np.abs(edge.T_parent_child - own.T_parent_child).max() < _SAME))
