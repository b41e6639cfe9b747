# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""One name for everything that can be read: a file, a topic of a bag, a pair of frames of TF.

``load_inputs`` returns the trajectories of several, bags read once for all.
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

# Called with the part done and the whole.
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class InputOptions:
    """How one trajectory is to be read; None where the file or the messages tell.

    Attributes
    ----------
    frame : name of the frame of the sensor.
    invert : whether the input holds the pose of the world in the sensor.
    file_format, times, columns, quaternion_order, time_unit : see ``FileSource``; of files only.

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
        """Build options from plain data; names have the suffix, and paths begin in the folder.

        Other keys are left alone. Raises ConfigError for a value of the wrong kind.
        """
        options: dict[str, Any] = {}
        for item in fields(cls):
            name, is_switch = f'{item.name}{suffix}', item.name == 'invert'
            value = values.get(name)
            if value is None:
                continue
            # A number may be a name: YAML makes one of 5.
            if (not isinstance(value, (str, int, float)) or '\0' in str(value)
                    or isinstance(value, bool) != is_switch):
                raise ConfigError(f'{name} is {value!r}, needed '
                                  f'{"true or false" if is_switch else "a text"}')
            options[item.name] = (value if is_switch else
                                  folder / str(value) if item.name == 'times' else str(value))
        return cls(**options)

    def inverted(self, trajectory: Trajectory) -> Trajectory:
        """Return the poses of the sensor in the world, whichever of both was read."""
        return (replace(trajectory, poses=se3.inverse(trajectory.poses)) if self.invert
                else trajectory)

    def of_files(self) -> dict[str, Any]:
        """Return the settings that are given and mean nothing but for a file."""
        return {name: value for name, value in vars(self).items()
                if name not in ('frame', 'invert') and value is not None}


def load_inputs(
    inputs: Mapping[str, tuple[str, InputOptions]],
    bags: Sequence[str | os.PathLike[str]] = (),
    progress: Progress | None = None,
) -> dict[str, Trajectory]:
    """Read several trajectories, those of bags in one pass.

    ``inputs`` has for each sensor its input, a file, or a topic or ``tf:PARENT.CHILD`` of the
    ``bags``, and its options. The name of the sensor is that of its frame where the input names
    none. ``progress`` is called while bags are read.

    Raise ConfigError where two inputs are one, or an option does not fit an input; SourceError
    where an input cannot be read.
    """
    _require_different([name for name, _ in inputs.values()], topics=bool(bags))
    from_bags = [name for name, _ in inputs.values() if bags and not Path(name).is_file()]
    for name, options in inputs.values():
        given = options.of_files()
        if name in from_bags and given:
            raise ConfigError(f'{", ".join(given)} is for files; {name} is read from a bag, whose '
                              'messages carry their format and time')
    tracks = {}
    if from_bags:
        # What bags need loads where a bag is read, and only there.
        from trajectory_calibration.sources.bags import open_bags
        with open_bags(bags) as reader:
            tracks = reader.read(from_bags, progress)
    return {sensor: options.inverted(tracks[name].to_trajectory(options.frame))
            if name in tracks else load_file(name, sensor, options)[0]
            for sensor, (name, options) in inputs.items()}


def load_file(name: str, sensor: str, options: InputOptions) -> tuple[Trajectory, str]:
    """Return the trajectory of a file, and how it was read: its columns, or its format.

    Raises as ``load_inputs``.
    """
    if names_frames(name):
        raise ConfigError(f'{name} names frames of a bag; give the bag with --bag')
    trajectory, read_as = FileSource(
        name, sensor_frame=options.frame or sensor, **options.of_files()).load_described()
    return options.inverted(trajectory), read_as


def _require_different(names: Sequence[str], *, topics: bool) -> None:
    """Raise ConfigError where two inputs are one."""
    for other, name in combinations(names, 2):
        if name == other or (topics and name.lstrip('/') == other.lstrip('/')):
            raise ConfigError(f'{name} is given twice; two sensors are needed')
        # What is no file is no reason here: reading it says what is wrong.
        with suppress(OSError):
            if Path(name).samefile(other):
                raise ConfigError(f'{other} and {name} are the same; two sensors are needed')
