# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The arguments of the launch files. Not in these files, because ``launch`` is not on PyPI.

A given argument overrides the parameter file; for an empty one the file applies.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
import re
from typing import Any

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.errors import ConfigError
from trajectory_calibration.online.options import OPTIONS
from trajectory_calibration.rig.description import RigDescription

# Name, default and description of an argument.
Argument = tuple[str, str, str]

# Parameters of the node that are also arguments.
PARAMETERS = ('topic_a', 'topic_b', 'frame_a', 'frame_b', 'publish_tf', 'result_directory')
_USE_SIM_TIME = 'use_sim_time'

# Parameters have an empty default: the value in the file.
_FILE: Argument = ('params_file', '', 'file with the parameters of a node; empty: all defaults')
_PROCESS_ARGUMENTS: tuple[Argument, ...] = (
    (_USE_SIM_TIME, '', 'whether a bag or a simulator publishes /clock; empty: as in the file'),
    ('log_level', 'info', 'debug, info, warn, error or fatal'),
    ('respawn', 'false', 'start a node again whenever it ends'),
)


def _parameter_argument(name: str) -> Argument:
    return name, '', f'{OPTIONS[name].help}; empty: as in the file'


ARGUMENTS: tuple[Argument, ...] = (
    _FILE,
    ('config', '', 'older name of params_file'),
    *map(_parameter_argument, PARAMETERS),
    ('namespace', '', 'namespace of the node: one for each pair of sensors'),
    ('name', 'trajectory_calibration', 'name of the node'),
    *_PROCESS_ARGUMENTS,
)
RIG_ARGUMENTS: tuple[Argument, ...] = (
    ('rig', '', 'RIG.yaml: the base and the sensors, each with a topic or tf; needed'),
    _FILE,
    _parameter_argument('result_directory'),
    ('namespace', 'rig', 'namespace of the nodes'),
    *_PROCESS_ARGUMENTS,
)

_LOG_LEVELS = ('debug', 'info', 'warn', 'error', 'fatal')


@dataclass(frozen=True)
class LaunchSettings:
    """How to start a node; ``parameters`` override the file."""

    params_file: str | None
    namespace: str
    log_level: str
    respawn: bool
    name: str
    parameters: dict[str, Any] = field(default_factory=dict)

    def of_node(self, typed: Callable[..., Any]) -> dict[str, Any]:
        """Return the arguments of ``launch_ros.actions.Node``; ``typed`` is ParameterValue."""
        # With a type, because YAML reads a frame named "off" as False.
        overrides = {name: typed(value, value_type=type(value))
                     for name, value in self.parameters.items()}
        return {
            'package': 'trajectory_calibration', 'executable': 'calibration_node',
            'name': self.name, 'namespace': self.namespace, 'output': 'screen',
            # The last one has priority.
            'parameters': [*filter(None, [self.params_file, overrides])],
            'arguments': ['--ros-args', '--log-level', self.log_level],
            'respawn': self.respawn, 'respawn_delay': 2.0}


def launch_settings(arguments: Mapping[str, str]) -> LaunchSettings:
    """Return the settings of the node for arguments of ``calibration.launch.py``, all strings."""
    given = _with_defaults(ARGUMENTS, arguments)
    return LaunchSettings(
        **_process_settings(given), name=given['name'], parameters=_parameters(given, PARAMETERS))


def rig_settings(arguments: Mapping[str, str]) -> list[LaunchSettings]:
    """Return the settings of the nodes for arguments of ``rig.launch.py``.

    There is one node for each sensor of RIG.yaml except the base, which is its parent;
    ``trajectory_calibration rig --from-results DIR`` makes one rig of their saved results. Raises
    ConfigError if the file does not exist, a sensor has no topic, or two nodes have equal names.
    """
    given = _with_defaults(RIG_ARGUMENTS, arguments)
    if not given['rig']:
        raise ConfigError('rig is empty, needed the description of the sensors: rig:=RIG.yaml')
    process, parameters = _process_settings(given), _parameters(given, ['result_directory'])
    found: dict[str, tuple[str, LaunchSettings]] = {}
    description = RigDescription.load(Path(given['rig']).expanduser())
    for sensor, own in _sensor_parameters(description).items():
        # Characters allowed in a ROS name: ASCII letters, digits and underscores.
        name = 'calibrate_' + re.sub('[^A-Za-z0-9_]', '_', sensor)
        if name in found:
            raise ConfigError(f'the sensors {found[name][0]} and {sensor} would both be '
                              f'calibrated by the node {name}; rename one of them')
        found[name] = sensor, LaunchSettings(
            **process, name=name, parameters={**parameters, **own})
    return [settings for _, settings in found.values()]


def _sensor_parameters(description: RigDescription) -> dict[str, dict[str, Any]]:
    """Return the node parameters of each sensor except the base."""
    base = description.config.base or next(iter(description.inputs))
    if base not in description.inputs:
        raise ConfigError(f'the base {base!r} is none of the sensors: '
                          f'{", ".join(description.inputs)}')
    defaults = CalibrationConfig()
    shared = {name: value for name, value in description.config.calibration.to_dict().items()
              if value != getattr(defaults, name)}
    found = {}
    for name, (source, options) in description.inputs.items():
        if options.file_options() or options.invert or Path(source).is_file():
            raise ConfigError(f'sensor {name} has a file, needed a topic or tf for a node')
        settings = description.config.of(name)
        found[name] = {
            **shared, **settings.given, **description.config.scale_of(name),
            'topic_a': description.inputs[base][0], 'topic_b': source,
            'frame_a': description.config.of(base).frame or base,
            'frame_b': settings.frame or name}
    del found[base]
    return found


def _with_defaults(known: Sequence[Argument], arguments: Mapping[str, str]) -> dict[str, str]:
    return {name: arguments.get(name, default) or default for name, default, _ in known}


def _process_settings(given: Mapping[str, str]) -> dict[str, Any]:
    """Return the settings that are not parameters of the node."""
    if given['log_level'] not in _LOG_LEVELS:
        raise ConfigError(
            f'log_level is {given["log_level"]!r}, needed one of {", ".join(_LOG_LEVELS)}')
    return {'params_file': _params_file(given['params_file'], given.get('config', '')),
            'namespace': given['namespace'], 'log_level': given['log_level'],
            'respawn': _switch('respawn', given['respawn'])}


def _parameters(given: Mapping[str, str], names: Sequence[str]) -> dict[str, Any]:
    """Return the given parameters, each in its type."""
    return {name: _switch(name, given[name])
            if name == _USE_SIM_TIME or OPTIONS[name].kind is bool
            else OPTIONS[name].check(given[name])
            for name in (*names, _USE_SIM_TIME) if given[name]}


def _params_file(params_file: str, config: str) -> str | None:
    if params_file and config and params_file != config:
        raise ConfigError(
            f'params_file is {params_file} and config {config}, two names of one argument; '
            'give one of them')
    if not (params_file or config):
        return None
    path = Path(params_file or config).expanduser()
    if not path.is_file():
        raise ConfigError(f'params_file {path} does not exist; correct its path')
    return str(path)


def _switch(name: str, text: str) -> bool:
    if text.lower() not in ('true', 'false'):
        raise ConfigError(f'{name} is {text!r}, needed true or false')
    return text.lower() == 'true'
