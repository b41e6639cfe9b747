# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Write a result in the formats of other tools.

``EXPORTS`` is the registry for the command line, ``--output`` and the report. Every format holds
the pose of the child in the parent; only Kalibr's holds the inverse, which its sentence says.
Numbers are written with all digits.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
import io
import json
from pathlib import Path
import re
import shlex
from textwrap import indent
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

import numpy as np

from trajectory_calibration.config.yaml_file import number, quoted, write_text
from trajectory_calibration.errors import ConfigError, ResultError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.placement import Placement
from trajectory_calibration.outputs.screen import std_texts

if TYPE_CHECKING:
    from trajectory_calibration.result import CalibrationResult


@dataclass(frozen=True)
class Exporter:
    """One format.

    ``sentence`` describes its content and direction; ``contents`` returns the content of
    ``file_name`` for a ``Placement``. A binary format cannot be printed.
    """

    sentence: str
    file_name: str
    contents: Callable[[Placement], str | bytes]
    is_binary: bool = False

    def write(self, item: CalibrationResult | Placement) -> str:
        """Return the text; raises ConfigError for a binary format, else like ``encode``."""
        if self.is_binary:
            raise ConfigError(f'{self.file_name} is binary; give a file with --output')
        return self.encode(item).decode()

    def encode(self, item: CalibrationResult | Placement) -> bytes:
        """Return the contents of a file.

        Raises ConfigError for two frames with the same name, or a name that is invalid in the
        format.
        """
        item = item if isinstance(item, Placement) else Placement.of(item)
        contents = self.contents(item.require_two_frames())
        return contents if isinstance(contents, bytes) else contents.encode()


def _texts(item: Placement) -> tuple[list[str], list[str], list[str]]:
    """Return x, y, z; qx, qy, qz, qw; roll, pitch, yaw, metres and radians."""
    t, R = item.T_parent_child[:3, 3], item.T_parent_child[:3, :3]
    return (list(map(number, t)), list(map(number, se3.rotation_to_quaternion(R))),
            list(map(number, se3.roll_pitch_yaw(R))))


def _pose(item: Placement) -> str:
    return f'pose of {item.child} in {item.parent}: p_{item.parent} = T p_{item.child}'


def _comments(item: Placement, *more: str, xml: bool = False) -> str:
    """Return comments, worst first: the pose, or ``more`` in its place, and the uncertainty."""
    lines = [*(more or [_pose(item)])]
    if item.unobserved:
        lines.insert(0, f'UNOBSERVED: {", ".join(item.unobserved)}. These numbers are arbitrary '
                     'along it: measure it, or drive a ramp, before you use them.')
    if item.covariance is not None:
        words = std_texts(item.covariance)
        lines.append(f'standard deviations along and about x, y, z of {item.parent}: '
                     f'{", ".join(words[:3])} m, {", ".join(words[3:])} deg')
    # A line break or two hyphens in a frame name must not end the comment.
    lines = [' '.join(line.split()) for line in (*lines, item.origin) if line]
    return ''.join(f'<!-- {re.sub("-(?=-|$)", "- ", line)} -->\n' if xml else f'# {line}\n'
                   for line in lines)


def _joint(item: Placement) -> str:
    xyz, _, rpy = _texts(item)
    return (f'<joint name={quoteattr(f"{item.parent}_to_{item.child}")} type="fixed">\n'
            f'  <origin xyz="{" ".join(xyz)}" rpy="{" ".join(rpy)}"/>\n'
            f'  <parent link={quoteattr(item.parent)}/>\n'
            f'  <child link={quoteattr(item.child)}/>\n'
            f'</joint>\n<link name={quoteattr(item.child)}/>\n')


def joint_and_link(item: Placement, *comments: str) -> str:
    """Return the joint and the link of the child in URDF, with the pose after ``comments``."""
    return _comments(item, *comments, _pose(item), xml=True) + _joint(item)


def _urdf(item: Placement) -> str:
    return joint_and_link(
        item, f'Paste into <robot>; leave out the link where {item.child} has one')


def _xacro(item: Placement) -> str:
    macro = re.sub(r'\W', '_', f'{item.parent}_to_{item.child}')
    for name in (item.parent, item.child):
        # Spaces, quotes and $ are special in the defaults of a macro.
        if re.fullmatch(r'[\w./-]+', name) is None:
            raise ConfigError(
                f'xacro cannot hold the frame name {name!r}, needed letters, digits and _ . / -; '
                'use urdf')
    defaults = quoteattr(f'parent:={item.parent} child:={item.child}')
    comments = _comments(item, f'Include this file, then call <xacro:{macro}/> in the robot',
                         _pose(item), xml=True)
    joint = _joint(replace(item, parent='${parent}', child='${child}'))
    body = indent(f'{comments}<xacro:macro name="{macro}" params={defaults}>\n'
                  f'{indent(joint, "  ")}</xacro:macro>\n', '  ')
    return ('<?xml version="1.0"?>\n<robot xmlns:xacro="http://www.ros.org/wiki/xacro">\n'
            f'{body}</robot>\n')


def _publisher_arguments(item: Placement) -> list[tuple[str, str]]:
    """Return the arguments of ``static_transform_publisher``, by name."""
    xyz, quaternion, _ = _texts(item)
    names = ('--x', '--y', '--z', '--qx', '--qy', '--qz', '--qw')
    return [*zip(names, xyz + quaternion, strict=True),
            ('--frame-id', item.parent), ('--child-frame-id', item.child)]


def _static_tf(item: Placement) -> str:
    return _comments(item) + shlex.join([
        'ros2', 'run', 'tf2_ros', 'static_transform_publisher',
        *(word for pair in _publisher_arguments(item) for word in pair)]) + '\n'


def launch_file(items: Iterable[Placement]) -> str:
    """Return a launch file that publishes the transforms."""
    nodes = ''
    for item in items:
        rows = ''.join(f'                {name!r}, {value!r},\n'
                       for name, value in _publisher_arguments(item))
        nodes += indent(_comments(item), '        ') + (
            "        Node(\n            package='tf2_ros', "
            f"executable='static_transform_publisher',\n            arguments=[\n{rows}"
            '            ]),\n')
    return ('from launch import LaunchDescription\nfrom launch_ros.actions import Node\n\n\n'
            f'def generate_launch_description():\n    return LaunchDescription([\n{nodes}    ])\n')


def _rows(matrix: FloatArray, separator: str, start: str = '', end: str = '') -> str:
    return ''.join(f'{start}{separator.join(map(number, row))}{end}\n' for row in matrix)


def _npy(item: Placement) -> bytes:
    stream = io.BytesIO()
    np.save(stream, item.T_parent_child)
    return stream.getvalue()


def _json(item: Placement) -> str:
    xyz, quaternion, rpy = (list(map(float, texts)) for texts in _texts(item))
    return json.dumps({
        'parent': item.parent,
        'child': item.child,
        'translation_m': xyz,
        'rotation_xyzw': quaternion,
        'rotation_rpy_rad': rpy,
        'T_parent_child': item.T_parent_child.tolist(),
        'covariance_m_rad': None if item.covariance is None else item.covariance.tolist(),
        'unobserved': list(item.unobserved),
        'origin': item.origin,
    }, indent=1) + '\n'


def _yaml(item: Placement) -> str:
    xyz, quaternion, rpy = (', '.join(texts) for texts in _texts(item))
    return (
        _comments(item)
        + f'parent: {quoted(item.parent)}\nchild: {quoted(item.child)}\n'
        f'translation_m: [{xyz}]\nrotation_xyzw: [{quaternion}]\nrotation_rpy_rad: [{rpy}]\n'
        f'T_parent_child:\n{_rows(item.T_parent_child, ", ", "- [", "]")}'
        f'unobserved: [{", ".join(map(quoted, item.unobserved))}]\n')


def _tum(item: Placement) -> str:
    xyz, quaternion, _ = _texts(item)
    return (_comments(item, _pose(item), 'stamp tx ty tz qx qy qz qw')
            + f'{" ".join(["0", *xyz, *quaternion])}\n')


def sensor_kit(items: Iterable[Placement]) -> str:
    """Return Autoware's sensor_kit_calibration.yaml: every child under its parent."""
    lines, parent = '# sensor_kit_calibration.yaml, metres, radians\n', None
    for item in sorted(items, key=lambda item: item.parent):
        if item.parent != parent:
            parent = item.parent
            lines += f'{quoted(parent)}:\n'
        xyz, _, rpy = _texts(item)
        lines += indent(_comments(item), '  ') + f'  {quoted(item.child)}:\n'
        lines += ''.join(f'    {name}: {text}\n' for name, text in zip(
            ('x', 'y', 'z', 'roll', 'pitch', 'yaw'), xyz + rpy, strict=True))
    return lines


def _kalibr(item: Placement) -> str:
    comments = _comments(
        item, f'cam0 is {item.parent}, cam1 is {item.child}; add their intrinsics',
        f'T_cn_cnm1 maps points of {item.parent} to {item.child}: the inverse of the pose of '
        f'{item.child} in {item.parent}')
    return (comments + 'cam1:\n  T_cn_cnm1:\n'
            + _rows(se3.inverse(item.T_parent_child), ', ', '  - [', ']'))


EXPORTS: dict[str, Exporter] = {
    'urdf': Exporter(
        'fixed joint from the parent link to the child link; its origin is the pose of the child '
        'in the parent', 'extrinsic.urdf', _urdf),
    'xacro': Exporter(
        'the joint of urdf as a macro; its origin is the pose of the child in the parent',
        'extrinsic.xacro', _xacro),
    'static-tf': Exporter(
        'command that publishes the pose of the child (--child-frame-id) in the parent '
        '(--frame-id)', 'static_transform.sh', _static_tf),
    'launch': Exporter(
        'launch file that publishes the pose of the child in the parent',
        'static_transform.launch.py', lambda item: launch_file([item])),
    'matrix': Exporter(
        '4 x 4 numbers, the pose of the child in the parent: p_parent = T p_child', 'matrix.txt',
        lambda item: _comments(item) + _rows(item.T_parent_child, ' ')),
    'npy': Exporter(
        '4 x 4 NumPy array, the pose of the child in the parent', 'matrix.npy', _npy,
        is_binary=True),
    'json': Exporter(
        'the pose of the child in the parent with its covariance', 'extrinsic.json', _json),
    'yaml': Exporter(
        'the pose of the child in the parent, for YAML 1.1 and 1.2', 'extrinsic.yaml', _yaml),
    'tum': Exporter(
        'one row 0 x y z qx qy qz qw, the pose of the child in the parent', 'extrinsic.tum', _tum),
    'autoware': Exporter(
        'the pose of the child under its parent, as in sensor_kit_calibration.yaml',
        'sensor_kit_calibration.yaml', lambda item: sensor_kit([item])),
    'kalibr': Exporter(
        'camchain of two: T_cn_cnm1 maps points of the parent (cam0) to the child (cam1), the '
        'inverse of the pose of the child in the parent', 'camchain.yaml', _kalibr),
}


# The file names of all formats.
EXPORT_FILES = tuple(exporter.file_name for exporter in EXPORTS.values())


def encode_exports(item: Placement) -> dict[str, bytes]:
    """Return the contents of ``EXPORT_FILES``, without formats where a frame name is invalid.

    Raises ConfigError if both frames have the same name.
    """
    item.require_two_frames()
    contents = {}
    for exporter in EXPORTS.values():
        with suppress(ConfigError):
            contents[exporter.file_name] = exporter.encode(item)
    return contents


def write_exports(item: Placement, folder: Path) -> list[Path]:
    """Write every format into a folder, which is made if needed; return the paths.

    Existing files are overwritten. Raises ConfigError if both frames have the same name,
    ResultError if a file cannot be written.
    """
    contents = encode_exports(item)
    remove_others(folder, EXPORT_FILES, contents)
    for name, data in contents.items():
        write_text(folder / name, data)
    return [folder / name for name in contents]


def remove_others(folder: Path, names: Iterable[str], contents: Container[str]) -> list[Path]:
    """Remove the files in ``names`` that are not in ``contents``; return the removed paths.

    Otherwise exports of an earlier result would seem to belong to the new one. Raises ResultError.
    """
    removed = [path for name in names if name not in contents
               and (path := folder / name).is_file()]
    try:
        for path in removed:
            path.unlink()
    except OSError as error:
        raise ResultError(f'{path} is of an earlier answer and cannot be removed: '
                          f'{error.strerror or error}') from error
    for subfolder in {path.parent for path in removed} - {folder}:
        # Not if it holds files of the user.
        with suppress(OSError):
            subfolder.rmdir()
    return removed
