# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A rig in the formats of other tools: one file for the whole tree."""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import quoteattr

from trajectory_calibration.config.yaml_file import number, quoted
from trajectory_calibration.errors import ConfigError, ResultError
from trajectory_calibration.geometry import se3
from trajectory_calibration.outputs.exports import EXPORTS, publisher_arguments, write_exports
from trajectory_calibration.outputs.placement import Placement
from trajectory_calibration.rig.result import RigResult

# Files of a rig, all below the folder that is asked for.
URDF_FILE, LAUNCH_FILE = 'rig.urdf', 'static_transforms.launch.py'
KIT_FILE, MATRICES_FILE = 'sensor_kit_calibration.yaml', 'transforms.tum'


def placements(rig: RigResult) -> list[Placement]:
    """Return every sensor but the bases, under the frame of its base.

    Raises
    ------
    ConfigError
        Two sensors have one frame.

    """
    frames: dict[str, str] = {}
    for name, sensor in rig.sensors.items():
        if sensor.frame in frames:
            raise ConfigError(
                f'{frames[sensor.frame]} and {name} both have the frame {sensor.frame}; name it '
                'below the sensor: "frame: NAME"')
        frames[sensor.frame] = name
    return [
        Placement(
            rig.sensors[sensor.base].frame, sensor.frame, sensor.T_base_sensor, sensor.covariance,
            tuple(f'{component} of {sensor.frame} in {rig.sensors[sensor.base].frame}'
                  for component in sensor.unobserved),
            f'trajectory_calibration {rig.version}, rig of {len(rig.sensors)} sensors')
        for name, sensor in rig.sensors.items() if name != sensor.base]


def urdf(rig: RigResult) -> str:
    """Return one robot with a link for each sensor and a fixed joint for all but the bases."""
    parts = [f'<link name={quoteattr(rig.sensors[base].frame)}/>\n' for base in rig.trees]
    parts += [EXPORTS['urdf'].write(item) for item in placements(rig)]
    body = ''.join(f'  {line}\n' for part in parts for line in part.splitlines())
    return f'<?xml version="1.0"?>\n<robot name="rig">\n{body}</robot>\n'


def launch(rig: RigResult) -> str:
    """Return one launch file that publishes every static transform."""
    nodes = ''
    for item in placements(rig):
        arguments = publisher_arguments(item)
        rows = ''.join(f'                {name!r}, {value!r},\n' for name, value in zip(
            arguments[::2], arguments[1::2], strict=True))
        warning = ''.join(f'        # UNOBSERVED: {words}, an arbitrary number\n'
                          for words in item.unobserved)
        nodes += (f"{warning}        Node(\n            package='tf2_ros', "
                  f"executable='static_transform_publisher',\n            arguments=[\n{rows}"
                  '            ]),\n')
    return (f'# {len(rig.free)} static transforms of a calibrated rig\n'
            'from launch import LaunchDescription\nfrom launch_ros.actions import Node\n\n\n'
            'def generate_launch_description():\n    return LaunchDescription([\n'
            f'{nodes}    ])\n')


def sensor_kit(rig: RigResult) -> str:
    """Return Autoware's sensor_kit_calibration.yaml: every sensor under its base."""
    lines = ['# sensor_kit_calibration.yaml, metres and radians']
    parent = None
    for item in sorted(placements(rig), key=lambda item: item.parent):
        lines += [f'# UNOBSERVED: {words}, an arbitrary number' for words in item.unobserved]
        if item.parent != parent:
            parent = item.parent
            lines.append(f'{quoted(parent)}:')
        T = item.T_parent_child
        values = zip(('x', 'y', 'z', 'roll', 'pitch', 'yaw'),
                     (*T[:3, 3], *se3.roll_pitch_yaw(T[:3, :3])), strict=True)
        lines.append(f'  {quoted(item.child)}:')
        lines += [f'    {name}: {number(value)}' for name, value in values]
    return '\n'.join(lines) + '\n'


def write_rig_exports(rig: RigResult, folder: Path) -> list[Path]:
    """Write the files of the whole tree, and a folder of all formats for each sensor.

    Raises
    ------
    ConfigError
        Two sensors have one frame.
    ResultError
        The folder or a file cannot be written.

    """
    texts = {URDF_FILE: urdf(rig), LAUNCH_FILE: launch(rig), KIT_FILE: sensor_kit(rig),
             MATRICES_FILE: ''.join(EXPORTS['tum'].write(item) for item in placements(rig))}
    written = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (folder / name).write_text(text, encoding='utf-8')
            written.append(folder / name)
    except OSError as error:
        raise ResultError(f'{folder} cannot be written: {error.strerror or error}') from error
    for item in placements(rig):
        written += write_exports(item, folder / item.child.strip('/').replace('/', '_'))
    return written
