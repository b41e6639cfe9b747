# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A rig in the formats of other tools: one file for the whole tree."""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import quoteattr

from trajectory_calibration.errors import ConfigError, counted
from trajectory_calibration.outputs.exports import (
    EXPORTS,
    launch_file,
    sensor_kit,
    write_exports,
    write_files,
)
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
            origin=f'trajectory_calibration {rig.version}, rig of '
            f'{counted(len(rig.sensors), "sensor")}',
        ).leaving(sensor.unobserved, rig.config.calibration)
        for name, sensor in rig.sensors.items() if name != sensor.base]


def _urdf(rig: RigResult, items: list[Placement]) -> str:
    """Return one robot with a link for each sensor and a fixed joint for all but the bases."""
    parts = [f'<link name={quoteattr(rig.sensors[base].frame)}/>\n' for base in rig.trees]
    parts += map(EXPORTS['urdf'].write, items)
    body = ''.join(f'  {line}\n' for part in parts for line in part.splitlines())
    return f'<?xml version="1.0"?>\n<robot name="rig">\n{body}</robot>\n'


def write_rig_exports(rig: RigResult, folder: Path) -> list[str]:
    """Write the files of the whole tree, and a folder of all formats for each sensor.

    Return what of the rig is ``kept_back``, whose sensors are left out of every file.

    Raises
    ------
    ConfigError
        Two sensors have one frame.
    ResultError
        The folder or a file cannot be written.

    """
    every = placements(rig)
    items = [item for item in every if not item.kept_back]
    if items:
        texts = {
            URDF_FILE: _urdf(rig, items), LAUNCH_FILE: launch_file(items),
            KIT_FILE: sensor_kit(items), MATRICES_FILE: ''.join(map(EXPORTS['tum'].write, items))}
        write_files(folder, {name: text.encode() for name, text in texts.items()})
    for item in items:
        write_exports(item, folder / item.child.strip('/').replace('/', '_'))
    return [item.kept_back for item in every if item.kept_back]
