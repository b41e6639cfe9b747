# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Choose the TF edge that publishes an extrinsic, so that TF stays a tree.

In TF a frame has one parent. A transform from a second parent moves the frame to it in every tf2
buffer, without a warning, and disconnects the rest of the tree. So the node listens first, and
``VehicleFrames.place`` chooses the edge:

* the child b has no parent: a -> b;
* b has a parent, and the parent sensor a has none: from the highest frame fixed to b, usually
  base_link, to a;
* both have parents in separate trees, and all frames above b are fixed: from a to the root of the
  tree of b, usually the body frame of its driver;
* otherwise none: a and b are connected already, and a second path would not be a tree.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.frame_tree import ancestors, relative_pose, TreeEdge

# With more frames, such as one per tracked object, the least recently moved are dropped.
_MOST_FRAMES = 1000


class Carrier(NamedTuple):
    """The edge that publishes an extrinsic (None if not possible), and why it is not a -> b."""

    edge: TreeEdge | None
    reason: str = ''


class VehicleFrames:
    """The frames that a vehicle publishes on /tf and /tf_static, each with its parent."""

    def __init__(self) -> None:
        self._edges: dict[str, TreeEdge] = {}
        # Published on /tf_static by this node, which also receives them.
        self._published: list[TreeEdge] = []
        self._conflicts: dict[str, str] = {}

    @property
    def conflicts(self) -> tuple[str, ...]:
        """Return a sentence for each frame that was published with two parents."""
        return tuple(self._conflicts.values())

    def add(
        self, parent: str, child: str, T_parent_child: FloatArray, *, static: bool,
    ) -> None:
        """Add a received (4, 4) transform; those published by this node are ignored."""
        edge = TreeEdge(parent.lstrip('/'), child.lstrip('/'), T_parent_child,
                        'fixed' if static else 'moving')
        if not edge.parent or not edge.child or edge.parent == edge.child:
            return
        if static and any(
                (edge.parent, edge.child) == (own.parent, own.child)
                and np.abs(T_parent_child - own.T_parent_child).max() < 1e-9
                for own in self._published):
            return
        before = self._edges.get(edge.child)
        if before is not None and before.parent != edge.parent:
            self._conflicts[edge.child] = (
                f'{edge.child} is published with two parents, {before.parent} and {edge.parent}')
        if self._published and edge.child == self._published[-1].child:
            self._conflicts[edge.child] = (
                f'another node publishes {edge.parent} -> {edge.child}, which this node publishes '
                f'as {self._published[-1].parent} -> {edge.child}; stop one of the two')
        # Removed first, so that the order is by last reception.
        self._edges.pop(edge.child, None)
        self._edges[edge.child] = edge
        if len(self._edges) > _MOST_FRAMES:
            moving = [name for name, edge in self._edges.items() if edge.kind == 'moving']
            for name in moving[:-(-len(moving) // 2)]:
                del self._edges[name]

    def published(self, edge: TreeEdge) -> None:
        """Record a transform that this node published on /tf_static."""
        self._published.append(edge)

    def transform(self, frame_a: str, frame_b: str) -> FloatArray | None:
        """Return the (4, 4) pose of frame b in frame a, None if it is not fixed.

        Also None if both sensors have the same name: TF has then only one pose for both.
        """
        if frame_a == frame_b:
            return None
        found = relative_pose(self._edges, frame_a, frame_b)
        return found[0] if found is not None and found[1] is None else None

    def place(
        self, frame_a: str, frame_b: str, T_a_b: FloatArray,
        invented: frozenset[str] = frozenset(),
    ) -> Carrier:
        """Return the edge for the pose of b in a; ``invented`` frame names are not published."""
        if frame_a == frame_b:
            return Carrier(None, f'both frames are {frame_a}; set frame_a and frame_b')
        for name, setting in ((frame_a, 'frame_a'), (frame_b, 'frame_b')):
            if name in invented:
                return Carrier(None, f'the messages name no frame for {name}; set {setting}')
        found = relative_pose(self._edges, frame_a, frame_b)
        if found is not None:
            remedy = (
                'correct that transform, for instance in the URDF, instead of adding a second'
                if found[1] is None else
                'a SLAM or an odometry publishes it: switch off the TF of one of the two')
            path = ' <- '.join(name for name, _, _ in ancestors(self._edges, frame_b))
            return Carrier(None, (
                f'the vehicle already connects {frame_a} and {frame_b} ({path}); {remedy}'))
        if frame_b not in self._edges:
            return Carrier(TreeEdge(frame_a, frame_b, T_a_b))
        has_parent = f'{frame_b} already has the parent {self._edges[frame_b].parent}'
        # The highest frame that is fixed to b.
        top, T_top_b, _ = [item for item in ancestors(self._edges, frame_b) if item[2] is None][-1]
        if frame_a not in self._edges:
            edge = TreeEdge(top, frame_a, T_top_b @ se3.inverse(T_a_b))
        elif top not in self._edges:
            edge = TreeEdge(frame_a, top, T_a_b @ se3.inverse(T_top_b))
        else:
            return Carrier(None, (
                f'{has_parent} and {frame_a} the parent {self._edges[frame_a].parent}, in two '
                'trees that both move; publish the transform that connects them yourself'))
        return Carrier(edge, f'{has_parent}: published as {edge.parent} -> {edge.child}')


def difference_in_words(T_a_b: FloatArray, T_a_b_today: FloatArray) -> str:
    """Return the difference of an answer from the present transform of the vehicle in words."""
    step = se3.step_between(T_a_b_today, T_a_b)
    # Zero is added so that nothing is -0.0000.
    t, r_deg = np.round(step[:3], 4) + 0.0, np.round(np.rad2deg(step[3:]), 3) + 0.0
    return (f'{np.linalg.norm(t):.4f} m (x {t[0]:+.4f}, y {t[1]:+.4f}, '
            f'z {t[2]:+.4f}) and {np.linalg.norm(r_deg):.3f} deg '
            f'(about x {r_deg[0]:+.3f}, y {r_deg[1]:+.3f}, z {r_deg[2]:+.3f})')
