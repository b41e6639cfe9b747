# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The fixed joints of a URDF: where one frame of a robot sits in another."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trajectory_calibration.errors import in_words, SourceError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

if TYPE_CHECKING:
    import xml.etree.ElementTree as ET


@dataclass(frozen=True, eq=False)
class Joint:
    """One joint: ``T_parent_child`` (4, 4) is the pose of the child link in the parent link."""

    name: str
    kind: str
    parent: str
    child: str
    T_parent_child: FloatArray


@dataclass(frozen=True, eq=False)
class FrameTree:
    """The joints of one URDF, by child link: a link has one parent."""

    path: Path
    joints: dict[str, Joint]

    @classmethod
    def read(cls, path: Path) -> FrameTree:
        """Read a URDF, or the part of one that ``export --as urdf`` wrote.

        Raises
        ------
        SourceError
            The file cannot be read, is no XML, or is a xacro with expressions.

        """
        try:
            text = path.read_text(encoding='utf-8')
        except (OSError, ValueError) as error:
            raise SourceError(f'{path} cannot be read as URDF: {in_words(error)}') from error
        return cls.parse(text, path)

    @classmethod
    def parse(cls, text: str, path: Path) -> FrameTree:
        """Read the text of a URDF; ``path`` is for messages."""
        # Of those who read an extrinsic few have it in XML.
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
            # <origin xyz rpy> alone is what people paste.
            joints = [Joint('origin', 'fixed', '', '', _origin(item, path))
                      for item in root.iter('origin')]
        if not joints:
            raise SourceError(f'{path} holds no <joint> and no <origin>; needed a URDF; a xacro '
                              'must be expanded first (xacro FILE > robot.urdf)')
        return cls(path, {joint.child or joint.name: joint for joint in joints})

    def parent_of(self, frame: str) -> str | None:
        """Return the parent link of a link, or None."""
        joint = self.joints.get(frame)
        return None if joint is None else joint.parent

    def transform(self, parent: str, child: str) -> FloatArray:
        """Return the (4, 4) pose of one frame in another, along fixed joints.

        Raises
        ------
        SourceError
            A frame is missing, the two are not connected, or a joint between them moves.

        """
        up_parent, up_child = self._chain(parent), self._chain(child)
        common = next((frame for frame in up_child if frame in up_parent), None)
        if common is None:
            raise SourceError(f'{self.path} does not connect {parent} and {child}: '
                              f'{parent} belongs to {list(up_parent)[-1]}, {child} to '
                              f'{list(up_child)[-1]}')
        T_parent_child: FloatArray = se3.inverse(
            self._pose(up_parent, common)) @ self._pose(up_child, common)
        return T_parent_child

    def _chain(self, frame: str) -> dict[str, Joint | None]:
        """Return the frames from one up to the root, each with the joint above it."""
        known = set(self.joints) | {joint.parent for joint in self.joints.values()}
        if frame not in known:
            raise SourceError(f'{self.path} has no link {frame}; it has '
                              f'{", ".join(sorted(known - {""}))}')
        chain: dict[str, Joint | None] = {}
        current: str | None = frame
        while current is not None and current not in chain:
            joint = self.joints.get(current)
            chain[current] = joint
            current = None if joint is None else joint.parent
        return chain

    def _pose(self, chain: dict[str, Joint | None], common: str) -> FloatArray:
        """Return the (4, 4) pose of the first frame of a chain in a frame further up."""
        T = np.eye(4)
        for frame, joint in chain.items():
            if frame == common or joint is None:
                break
            if joint.kind != 'fixed':
                raise SourceError(
                    f'{self.path}: joint {joint.name} between {joint.parent} and {joint.child} '
                    f'is {joint.kind}, needed fixed joints only; give the transform itself')
            T = joint.T_parent_child @ T
        return T


def _joint(item: ET.Element, path: Path) -> Joint:
    origin = item.find('origin')
    parent, child = item.find('parent'), item.find('child')
    if parent is None or child is None:
        raise SourceError(f'{path}: joint {item.get("name")} has no parent or no child')
    return Joint(
        item.get('name', ''), item.get('type', 'fixed'), parent.get('link', ''),
        child.get('link', ''), np.eye(4) if origin is None else _origin(origin, path))


def _origin(item: ET.Element, path: Path) -> FloatArray:
    values = []
    for name in ('xyz', 'rpy'):
        text = item.get(name, '0 0 0')
        try:
            numbers = np.array(text.split(), dtype=np.float64)
        except ValueError:
            numbers = np.empty(0)
        if numbers.shape != (3,) or not np.isfinite(numbers).all():
            raise SourceError(f'{path}: {name}="{text}", needed 3 numbers; a xacro must be '
                              'expanded first (xacro FILE > robot.urdf)')
        values.append(numbers)
    return se3.from_rotation_translation(
        se3.rotation_from_roll_pitch_yaw(values[1]), values[0])
