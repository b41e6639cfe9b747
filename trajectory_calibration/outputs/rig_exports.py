# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Export of a rig to the formats of other tools: as a whole, and per sensor."""

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

# The saved rig, and the files of the whole rig by format.
RIG_FILE = 'rig.yaml'
RIG_FILES = {
    'urdf': 'rig.urdf', 'launch': 'static_transforms.launch.py',
    'autoware': 'sensor_kit_calibration.yaml', 'tum': 'transforms.tum'}


def require_own_frames(frames: Mapping[str, str]) -> None:
    """Raise ConfigError if two sensors have the same frame; ``frames`` are by sensor."""
    owners: dict[str, str] = {}
    for name, frame in frames.items():
        if owners.setdefault(frame, name) != name:
            raise ConfigError(f'{owners[frame]} and {name} both have the frame {frame}; name it '
                              'below the sensor: "frame: NAME"')


def placements(rig: RigResult) -> list[Placement]:
    """Return the placement of every sensor, except the bases, in the frame of its base.

    Raises ConfigError if two sensors have the same frame.
    """
    require_own_frames({name: sensor.frame for name, sensor in rig.sensors.items()})
    return [
        Placement(
            rig.sensors[sensor.base].frame, sensor.frame, sensor.T_base_sensor, sensor.covariance,
            origin=f'trajectory_calibration {rig.version}, rig of '
            f'{counted(len(rig.sensors), "sensor")}',
        ).with_unobserved(sensor.unobserved, rig.config.calibration)
        for name, sensor in rig.sensors.items() if name != sensor.base]


def placements_by_folder(rig: RigResult) -> dict[str, Placement]:
    """Return ``placements`` by folder name; no folder has the name of a file of the rig."""
    items = placements(rig)
    names = file_names((item.child for item in items), (RIG_FILE, *RIG_FILES.values()))
    return dict(zip(names, items, strict=True))


def rig_exports(rig: RigResult, placed: Mapping[str, Placement]) -> dict[str, bytes]:
    """Return the files of the whole rig, and of one folder per sensor, by path.

    ``placed`` is ``placements_by_folder``. Sensors with a ``kept_back`` component are left out.
    """
    items = {folder: item for folder, item in placed.items() if not item.kept_back}
    if not items:
        return {}
    contents = {file: encode_rig(rig, name, items.values()) for name, file in RIG_FILES.items()}
    for folder, item in items.items():
        contents.update((f'{folder}/{name}', data) for name, data in encode_exports(item).items())
    return contents


def rig_export_files(folders: Iterable[str]) -> list[str]:
    """Return the paths of ``rig_exports`` if no sensor is left out."""
    return [*RIG_FILES.values(),
            *(f'{folder}/{name}' for folder in folders for name in EXPORT_FILES)]


def encode_rig(rig: RigResult, name: str, items: Iterable[Placement]) -> bytes:
    """Return ``placements`` of a rig as one file in a format of ``RIG_FILES``."""
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
