# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trees of frames, as in URDF and TF, and the transform between two of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
import re
from typing import TYPE_CHECKING

import numpy as np

from trajectory_calibration.errors import in_words, SourceError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

if TYPE_CHECKING:
    import xml.etree.ElementTree as ET


@dataclass(frozen=True, eq=False)
class TreeEdge:
    """One transform of a tree: ``T_parent_child`` (4, 4), metres.

    ``parent`` and ``child`` are frames, in a URDF the links of the joint ``name``. ``kind`` is
    'fixed', another type of a URDF joint, or 'moving' in TF.
    """

    parent: str
    child: str
    T_parent_child: FloatArray
    kind: str = 'fixed'
    name: str = ''


def ancestors(
    edges: Mapping[str, TreeEdge], frame: str,
) -> Iterator[tuple[str, FloatArray, TreeEdge | None]]:
    """Yield a frame and its ancestors: name, (4, 4) pose of the first frame in it, moving edge.

    ``edges`` are by child. The moving edge is one in between that is not fixed, or None. In a
    cycle each frame is yielded once.
    """
    T, moving, seen = np.eye(4), None, set()
    while frame not in seen:
        yield frame, T, moving
        seen.add(frame)
        edge = edges.get(frame)
        if edge is None:
            return
        T, moving = edge.T_parent_child @ T, moving if edge.kind == 'fixed' else edge
        frame = edge.parent


def relative_pose(
    edges: Mapping[str, TreeEdge], parent: str, child: str,
) -> tuple[FloatArray, TreeEdge | None] | None:
    """Return the (4, 4) pose of child in parent, and a moving edge in between, or None.

    None in place of both if the frames are in separate trees.
    """
    of_parent = {frame: (T, moving) for frame, T, moving in ancestors(edges, parent)}
    for frame, T_frame_child, moving in ancestors(edges, child):
        if frame in of_parent:
            T_frame_parent, moving_parent = of_parent[frame]
            T: FloatArray = se3.inverse(T_frame_parent) @ T_frame_child
            return T, moving or moving_parent
    return None


@dataclass(frozen=True, eq=False)
class FrameTree:
    """The joints of one URDF, by child link."""

    path: Path
    joints: dict[str, TreeEdge]

    @classmethod
    def read(cls, path: Path) -> FrameTree:
        """Read a URDF or a part of one; raises SourceError, also for a xacro."""
        try:
            text = path.read_text(encoding='utf-8')
        except (OSError, ValueError) as error:
            raise SourceError(f'{path} cannot be read as URDF: {in_words(error)}') from error
        return cls.parse(text, path)

    @classmethod
    def parse(cls, text: str, path: Path) -> FrameTree:
        """Read the text of a URDF; ``path`` is for messages."""
        # Imported here because few extrinsics are in XML.
        import xml.etree.ElementTree as ET
        if text.lstrip().startswith('<?xml'):
            text = text.partition('?>')[2]
        try:
            # A snippet has several roots. The parser expands no external entities.
            root = ET.fromstring(f'<all>{text}</all>')  # noqa: S314
        except ET.ParseError as error:
            raise SourceError(f'{path} cannot be read as URDF: {error}') from error
        joints = [_joint(item, path) for item in root.iter('joint')
                  if item.find('parent') is not None]
        if not joints:
            # A snippet may be <origin xyz rpy> alone.
            joints = [TreeEdge('', '', _origin(item, path), name='origin')
                      for item in root.iter('origin')]
        if not joints:
            raise SourceError(f'{path} holds no <joint> and no <origin>; needed a URDF; a xacro '
                              'must be expanded first (xacro FILE > robot.urdf)')
        return cls(path, {joint.child or joint.name: joint for joint in joints})

    @property
    def links(self) -> set[str]:
        """Return the names of all frames."""
        return set(self.joints) | {joint.parent for joint in self.joints.values()}

    def transform(self, parent: str, child: str) -> FloatArray:
        """Return the (4, 4) pose of child in parent along fixed joints.

        Raises SourceError if a frame is missing, or no fixed joints connect the two.
        """
        for frame in (parent, child):
            if frame not in self.links:
                raise SourceError(f'{self.path} has no link {frame}; it has '
                                  f'{", ".join(sorted(self.links - {""}))}')
        found = relative_pose(self.joints, parent, child)
        if found is None:
            roots = [list(ancestors(self.joints, frame))[-1][0] for frame in (parent, child)]
            raise SourceError(f'{self.path} does not connect {parent} and {child}: '
                              f'{parent} belongs to {roots[0]}, {child} to {roots[1]}')
        T_parent_child, moving = found
        if moving is not None:
            raise SourceError(
                f'{self.path}: joint {moving.name} between {moving.parent} and {moving.child} '
                f'is {moving.kind}, needed fixed joints only; give the transform itself')
        return T_parent_child


def _joint(item: ET.Element, path: Path) -> TreeEdge:
    ends = [found.get('link', '') for found in map(item.find, ('parent', 'child'))
            if found is not None]
    if len(ends) != 2:
        raise SourceError(f'{path}: joint {item.get("name")} has no parent or no child')
    origin = item.find('origin')
    return TreeEdge(ends[0], ends[1], np.eye(4) if origin is None else _origin(origin, path),
                    item.get('type', 'fixed'), item.get('name', ''))


def _origin(item: ET.Element, path: Path) -> FloatArray:
    values = []
    for name in ('xyz', 'rpy'):
        text = item.get(name, '0 0 0')
        found = numbers_of(text)
        if found.shape != (3,) or not np.isfinite(found).all() or set(',[]') & set(text):
            raise SourceError(f'{path}: {name}="{text}", needed 3 numbers; a xacro must be '
                              'expanded first (xacro FILE > robot.urdf)')
        values.append(found)
    return se3.from_rotation_translation(se3.rotation_from_roll_pitch_yaw(values[1]), values[0])


def numbers_of(text: str) -> FloatArray:
    """Return the (N,) numbers of a text, separated by spaces or commas; empty for other text."""
    try:
        return np.array(re.split(r'[\s,]+', text.strip(' ,[]\t\n')), dtype=np.float64)
    except ValueError:
        return np.empty(0)
