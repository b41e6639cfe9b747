# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A rig in the formats of other tools: as a whole, and sensor by sensor."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from xml.sax.saxutils import quoteattr

from trajectory_calibration.config.file_names import file_names
from trajectory_calibration.errors import ConfigError, counted
from trajectory_calibration.outputs.exports import (
    encode_exports,
    EXPORT_FILES,
    EXPORTS,
    joint_and_link,
    launch_file,
    sensor_kit,
)
from trajectory_calibration.outputs.placement import Placement
from trajectory_calibration.rig.result import RigResult

# The rig itself, and the formats in which it is written as a whole: one robot, a launch file,
# Autoware's kit, rows of poses.
RIG_FILE = 'rig.yaml'
RIG_FILES = {
    'urdf': 'rig.urdf', 'launch': 'static_transforms.launch.py',
    'autoware': 'sensor_kit_calibration.yaml', 'tum': 'transforms.tum'}


def require_own_frames(frames: Mapping[str, str]) -> None:
    """Raise ConfigError where two sensors, by name, have one frame."""
    owners: dict[str, str] = {}
    for name, frame in frames.items():
        if owners.setdefault(frame, name) != name:
            raise ConfigError(f'{owners[frame]} and {name} both have the frame {frame}; name it '
                              'below the sensor: "frame: NAME"')


def placements(rig: RigResult) -> list[Placement]:
    """Return every sensor but the bases, under the frame of its base.

    Raises ConfigError where two sensors have one frame.
    """
    require_own_frames({name: sensor.frame for name, sensor in rig.sensors.items()})
    return [
        Placement(
            rig.sensors[sensor.base].frame, sensor.frame, sensor.T_base_sensor, sensor.covariance,
            origin=f'trajectory_calibration {rig.version}, rig of '
            f'{counted(len(rig.sensors), "sensor")}',
        ).leaving(sensor.unobserved, rig.config.calibration)
        for name, sensor in rig.sensors.items() if name != sensor.base]


def placements_by_folder(rig: RigResult) -> dict[str, Placement]:
    """Return ``placements`` by the names of their folders, which are no other file's."""
    items = placements(rig)
    names = file_names((item.child for item in items), (RIG_FILE, *RIG_FILES.values()))
    return dict(zip(names, items, strict=True))


def rig_exports(rig: RigResult, placed: Mapping[str, Placement]) -> dict[str, bytes]:
    """Return the files of the whole tree, and a folder of all formats for each sensor, by path.

    ``placed`` is ``placements_by_folder``; what of a sensor is ``kept_back`` leaves it out.
    """
    items = {folder: item for folder, item in placed.items() if not item.kept_back}
    if not items:
        return {}
    contents = {file: encode_rig(rig, name, items.values()) for name, file in RIG_FILES.items()}
    for folder, item in items.items():
        contents.update((f'{folder}/{name}', data) for name, data in encode_exports(item).items())
    return contents


def rig_export_files(folders: Iterable[str]) -> list[str]:
    """Return the paths that ``rig_exports`` has where nothing is kept back."""
    return [*RIG_FILES.values(),
            *(f'{folder}/{name}' for folder in folders for name in EXPORT_FILES)]


def encode_rig(rig: RigResult, name: str, items: Iterable[Placement]) -> bytes:
    """Return those ``placements`` of a rig as one file in a format of ``RIG_FILES``."""
    if name == 'launch':
        return launch_file(items).encode()
    if name == 'autoware':
        return sensor_kit(items).encode()
    if name == 'urdf':
        links = ''.join(f'<link name={quoteattr(rig.sensors[base].frame)}/>\n'
                        for base in rig.trees)
        joints = ''.join(map(joint_and_link, items))
        body = ''.join(f'  {line}\n' for line in f'{links}{joints}'.splitlines())
        return f'<?xml version="1.0"?>\n<robot name="rig">\n{body}</robot>\n'.encode()
    return ''.join(map(EXPORTS[name].write, items)).encode()
