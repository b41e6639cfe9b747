# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Command-line options for every setting of a calibration."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
import re
from typing import Any

from trajectory_calibration.config.settings import CalibrationConfig, Option
from trajectory_calibration.config.yaml_file import read_yaml
from trajectory_calibration.errors import ConfigError

# Values that start like an option: -90,0,-90; -,-,0.42; -1e-3; -inf. No option matches.
_NEGATIVE = re.compile(r'-([\d.,\s].*|inf|nan)?', re.DOTALL | re.IGNORECASE)


def join_negative_values(arguments: Sequence[str]) -> list[str]:
    """Return the arguments with '--name -90,0,-90' as '--name=-90,0,-90'.

    argparse reads a value that starts with a minus as an option unless it is a plain number.
    """
    joined: list[str] = []
    for k, argument in enumerate(arguments):
        if argument == '--':
            return joined + list(arguments[k:])
        names = joined and re.fullmatch(r'--[a-z][a-z-]*', joined[-1])
        if names and _NEGATIVE.fullmatch(argument):
            joined[-1] += f'={argument}'
        else:
            joined.append(argument)
    return joined


def add_config_options(parser: argparse.ArgumentParser, without: tuple[str, ...] = ()) -> None:
    """Add ``--config FILE`` and one option for each field of CalibrationConfig.

    ``without`` are prefixes of the settings that a command does not use.
    """
    group = parser.add_argument_group('settings of the calibration')
    group.add_argument(
        '--config', type=Path, metavar='FILE',
        help='YAML with settings by name, or a saved result to repeat; options given here win')
    for option in CalibrationConfig.options():
        if not option.name.startswith(without):
            _add_option(group, option)


def config_from_arguments(arguments: argparse.Namespace) -> CalibrationConfig:
    """Return the defaults, overridden by ``--config``, overridden by the options.

    Raises
    ------
    ConfigError
        A setting is unknown or out of range, or the file holds no settings.

    """
    values = {} if arguments.config is None else _read_settings(arguments.config)
    return CalibrationConfig.from_dict({**values, **given_options(arguments)})


def given_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the settings that are given as options."""
    names = {option.name for option in CalibrationConfig.options()}
    return {name: value for name, value in vars(arguments).items() if name in names}


def refuse_options(arguments: argparse.Namespace, names: Iterable[str], why: str) -> None:
    """Raise ConfigError if one of these options, by attribute name, is given."""
    for name in names:
        if vars(arguments).get(name):
            raise ConfigError(f'--{name.replace("_", "-")} {why}')


def _add_option(group: argparse._ArgumentGroup, option: Option) -> None:
    default = 'none' if option.default == '' else option.default
    # argparse expands % in a help text.
    text = f'{option.help} (default: {default})'.replace('%', '%%')
    flag = f'--{option.name.replace("_", "-")}'
    settings: dict[str, Any]
    if option.kind is bool:
        settings = {'action': argparse.BooleanOptionalAction}
    elif option.extensible:
        # Names from other packages are looked up only when the option is checked.
        settings = {'metavar': 'NAME'}
        text += f': {", ".join(option.choices)}'
    elif option.choices:
        settings = {'choices': option.choices}
    else:
        settings = {'type': option.kind,
                    'metavar': {int: 'N', float: 'X'}.get(option.kind, 'TEXT')}
    # Without a default: a missing option must not override --config.
    group.add_argument(flag, default=argparse.SUPPRESS, help=text, **settings)


def _read_settings(path: Path) -> dict[str, Any]:
    data = read_yaml(path, 'settings', ConfigError)
    if isinstance(data, dict) and 'format_version' in data:
        data = data.get('config')
    if not isinstance(data, dict):
        raise ConfigError(f'{path} holds no settings; needed lines such as "max_gap: 0.5"')
    return {str(name): value for name, value in data.items()}
