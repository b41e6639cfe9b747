# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Inputs by name: a file, a topic of a bag, or a pair of TF frames.

``load_inputs`` loads several trajectories and reads the bags only once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from itertools import combinations
import os
from pathlib import Path
from typing import Any

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import ConfigError
from trajectory_calibration.geometry import se3
from trajectory_calibration.sources.files import FileSource
from trajectory_calibration.sources.transforms import names_frames

# Arguments: messages read so far, messages expected.
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class InputOptions:
    """How to read one trajectory; None means: from the file or the messages.

    Attributes
    ----------
    frame : name of the sensor frame.
    invert : whether the input has the pose of the world in the sensor frame.
    file_format, times, columns, quaternion_order, time_unit : see ``FileSource``; files only.

    """

    frame: str | None = None
    invert: bool = False
    file_format: str | None = None
    times: str | os.PathLike[str] | None = None
    columns: str | None = None
    quaternion_order: str | None = None
    time_unit: str | None = None

    @classmethod
    def from_dict(
        cls, values: Mapping[str, Any], folder: Path, suffix: str = '',
    ) -> InputOptions:
        """Build options from plain data; keys have the suffix, paths are relative to the folder.

        Other keys are ignored. Raises ConfigError for a value of the wrong type.
        """
        options: dict[str, Any] = {}
        for item in fields(cls):
            name, is_switch = f'{item.name}{suffix}', item.name == 'invert'
            value = values.get(name)
            if value is None:
                continue
            # A number can be a name: YAML reads the name 5 as a number.
            if (not isinstance(value, (str, int, float)) or '\0' in str(value)
                    or isinstance(value, bool) != is_switch):
                raise ConfigError(f'{name} is {value!r}, needed '
                                  f'{"true or false" if is_switch else "a text"}')
            options[item.name] = (value if is_switch else
                                  folder / str(value) if item.name == 'times' else str(value))
        return cls(**options)

    def inverted(self, trajectory: Trajectory) -> Trajectory:
        """Return the poses of the sensor in the world: inverted if ``invert``."""
        return (replace(trajectory, poses=se3.inverse(trajectory.poses)) if self.invert
                else trajectory)

    def file_options(self) -> dict[str, Any]:
        """Return the given options that apply to files only."""
        return {name: value for name, value in vars(self).items()
                if name not in ('frame', 'invert') and value is not None}


def load_inputs(
    inputs: Mapping[str, tuple[str, InputOptions]],
    bags: Sequence[str | os.PathLike[str]] = (),
    progress: Progress | None = None,
) -> dict[str, Trajectory]:
    """Read several trajectories, those from bags in one pass.

    ``inputs`` maps a sensor name to an input and its options. An input is a file, or a topic or
    ``tf:PARENT.CHILD`` of the ``bags``. The sensor name is the frame name if the input has none.
    ``progress`` is called while bags are read.

    Raise ConfigError if two inputs are the same, or an option does not fit an input; SourceError
    if an input cannot be read.
    """
    _require_distinct([name for name, _ in inputs.values()], topics=bool(bags))
    from_bags = [name for name, _ in inputs.values() if bags and not Path(name).is_file()]
    for name, options in inputs.values():
        given = options.file_options()
        if name in from_bags and given:
            raise ConfigError(f'{", ".join(given)} is for files; {name} is read from a bag, whose '
                              'messages carry their format and time')
    tracks = {}
    if from_bags:
        # Imported here, because only bags need it.
        from trajectory_calibration.sources.bags import open_bags
        with open_bags(bags) as reader:
            tracks = reader.read(from_bags, progress)
    return {sensor: options.inverted(tracks[name].to_trajectory(options.frame))
            if name in tracks else load_file(name, sensor, options)[0]
            for sensor, (name, options) in inputs.items()}


def load_file(name: str, sensor: str, options: InputOptions) -> tuple[Trajectory, str]:
    """Return the trajectory of a file, and the columns or format that were used.

    Raises as ``load_inputs``.
    """
    if names_frames(name):
        raise ConfigError(f'{name} names frames of a bag; give the bag with --bag')
    trajectory, read_as = FileSource(
        name, sensor_frame=options.frame or sensor, **options.file_options()).load_described()
    return options.inverted(trajectory), read_as


def _require_distinct(names: Sequence[str], *, topics: bool) -> None:
    """Raise ConfigError if two inputs are the same."""
    for other, name in combinations(names, 2):
        if name == other or (topics and name.lstrip('/') == other.lstrip('/')):
            raise ConfigError(f'{name} is given twice; two sensors are needed')
        # A missing file is reported when it is read.
        with suppress(OSError):
            if Path(name).samefile(other):
                raise ConfigError(f'{other} and {name} are the same; two sensors are needed')
