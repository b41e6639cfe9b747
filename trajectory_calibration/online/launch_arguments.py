# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the launch file does with its arguments; apart from it, because ``launch`` is not on PyPI.

An argument that is given beats the parameter file; one that is empty leaves it to the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trajectory_calibration.errors import ConfigError
from trajectory_calibration.online.options import OPTIONS

# Parameters of the node that are arguments, too.
PARAMETERS = ('topic_a', 'topic_b', 'frame_a', 'frame_b', 'publish_tf', 'result_directory')

# Name, default and meaning; the defaults of the parameters are empty: the file's.
ARGUMENTS = (
    ('params_file', '', 'file with the parameters of the node; empty: all defaults'),
    ('config', '', 'older name of params_file'),
    *((name, '', f'{OPTIONS[name].help}; empty: as in the file') for name in PARAMETERS),
    ('namespace', '', 'namespace of the node: one for each pair of sensors'),
    ('name', 'trajectory_calibration', 'name of the node'),
    ('use_sim_time', 'false', 'whether a bag or a simulator publishes /clock'),
    ('log_level', 'info', 'debug, info, warn, error or fatal'),
    ('respawn', 'false', 'start the node again whenever it ends'),
)

_LOG_LEVELS = ('debug', 'info', 'warn', 'error', 'fatal')


@dataclass(frozen=True)
class LaunchSettings:
    """How the node is started; ``parameters`` beat the file."""

    params_file: str | None
    parameters: dict[str, Any]
    namespace: str
    name: str
    log_level: str
    respawn: bool


def launch_settings(arguments: Mapping[str, str]) -> LaunchSettings:
    """Return how to start the node for launch arguments, all of them texts."""
    given = {name: arguments.get(name, default) or default for name, default, _ in ARGUMENTS}
    parameters: dict[str, Any] = {'use_sim_time': _switch('use_sim_time', given['use_sim_time'])}
    for name in PARAMETERS:
        if given[name]:
            parameters[name] = (_switch(name, given[name]) if OPTIONS[name].kind is bool
                                else OPTIONS[name].check(given[name]))
    if given['log_level'] not in _LOG_LEVELS:
        raise ConfigError(
            f'log_level is {given["log_level"]!r}, needed one of {", ".join(_LOG_LEVELS)}')
    return LaunchSettings(
        _params_file(given['params_file'], given['config']), parameters, given['namespace'],
        given['name'], given['log_level'], _switch('respawn', given['respawn']))


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
