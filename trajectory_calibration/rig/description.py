# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""RIG.yaml: the sensors of a vehicle, the sources of their trajectories, and settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from trajectory_calibration.config.yaml_file import load_yaml
from trajectory_calibration.errors import ConfigError
from trajectory_calibration.rig.settings import known_of, require_known, RigConfig, SensorSettings
from trajectory_calibration.sources.inputs import InputOptions
from trajectory_calibration.sources.transforms import TF_PREFIX

# Sources of a trajectory: each sensor has one of these keys.
_SOURCES = ('file', 'topic', 'tf')
_READING = tuple(item.name for item in fields(InputOptions))
_KNOWN_OF_SENSOR = tuple(item.name for item in fields(SensorSettings))

# Keys of the file that are settings of the rig.
_RIG_KEYS = ('base', 'pairs', 'leave_out_contradicting', 'processes')
# ``bags`` is the older spelling of ``bag``.
_KEYS = (*_RIG_KEYS, 'bag', 'bags', 'sensors', 'settings')


@dataclass(frozen=True)
class RigDescription:
    """The contents of RIG.yaml.

    Attributes
    ----------
    inputs : by sensor: a file, a topic or ``tf:PARENT.CHILD``, and options for reading it.
    bags : with the topics and transforms.
    config : settings of the rig.

    """

    inputs: Mapping[str, tuple[str, InputOptions]]
    bags: tuple[Path, ...]
    config: RigConfig

    @classmethod
    def load(cls, path: Path) -> RigDescription:
        """Read a file; paths in it are relative to its folder.

        Raises ConfigError: no such file, no YAML, an unknown key, or a sensor without a source.
        """
        return load_yaml(path, lambda data: cls.from_dict(data, path.parent), ConfigError,
                         'the description of a rig', 'no rig; needed lines such as "sensors:"')

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], folder: Path = Path()) -> RigDescription:
        """Build a description from plain data; raises as ``load``."""
        require_known(data, _KEYS, '')
        sensors = data.get('sensors')
        if not isinstance(sensors, Mapping) or len(sensors) < 2:
            raise ConfigError('sensors is needed, with two sensors or more below it')
        inputs, known = {}, {}
        for name, values in sensors.items():
            if not isinstance(values, Mapping):
                raise ConfigError(f'sensor {name} is {values!r}, needed lines such as '
                                  '"topic: /odometry"')
            inputs[str(name)] = _input(str(name), values, folder)
            known[str(name)] = known_of(SensorSettings, values)
        bags = data.get('bag', data.get('bags', ()))
        return cls(
            inputs,
            tuple(folder / str(bag) for bag in ([bags] if isinstance(bags, str) else bags)),
            RigConfig.from_dict({
                **{key: data[key] for key in _RIG_KEYS if key in data}, 'sensors': known,
                'calibration': data.get('settings') or {}}))


def _input(name: str, values: Mapping[str, Any], folder: Path) -> tuple[str, InputOptions]:
    # The frame is a key of both.
    known = dict.fromkeys((*_SOURCES, *_READING, *_KNOWN_OF_SENSOR))
    require_known(values, list(known), f' of sensor {name}')
    given = [key for key in _SOURCES if key in values]
    if len(given) != 1:
        raise ConfigError(
            f'sensor {name} has {" and ".join(given) or "no source"}, needed one of '
            f'{", ".join(_SOURCES)}')
    source = str(values[given[0]])
    if given[0] == 'file':
        source = str(folder / source)
    elif given[0] == 'tf' and not source.startswith(TF_PREFIX):
        source = f'{TF_PREFIX}{source}'
    try:
        return source, InputOptions.from_dict(values, folder)
    except ConfigError as error:
        raise ConfigError(f'sensor {name}: {error}') from error
