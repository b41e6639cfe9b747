# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Inputs of the subcommands that read trajectories: their options, and loading them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from trajectory_calibration.cli.progress import progress
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import ConfigError
from trajectory_calibration.sources.files import FORMATS
from trajectory_calibration.sources.inputs import InputOptions, load_inputs
from trajectory_calibration.sources.layouts import QUATERNION_ORDERS, TIME_UNITS
from trajectory_calibration.sources.text import is_bag

# Options of files, for both sensors (--NAME) or for one (--NAME-a, --NAME-b).
_SHARED: tuple[tuple[str, dict[str, Any]], ...] = (
    ('columns', {'metavar': 'NAMES', 'help': 'names of the columns, for instance '
                 't,x,y,z,qw,qx,qy,qz; - skips a column'}),
    ('quaternion-order', {'choices': QUATERNION_ORDERS,
                          'help': 'order of the four numbers of a quaternion'}),
    ('time-unit', {'choices': TIME_UNITS, 'help': 'unit of the times'}),
    ('file-format', {'choices': FORMATS, 'metavar': 'FORMAT', 'help': 'format of the files '
                     f'(default: detected): {", ".join(FORMATS)}'}),
    ('invert', {'action': 'store_true',
                'help': 'the files hold poses of the world in the sensor; invert them'}),
)


def add_input_arguments(parser: argparse.ArgumentParser, *, pair: bool = True) -> None:
    """Add A, B (optional unless ``pair``), ``--bag``, and the options of how to read them."""
    parser.add_argument(
        'a', metavar='A',
        help='sensor a, the parent: a file; with --bag a topic or tf:PARENT.CHILD')
    parser.add_argument('b', metavar='B', nargs=None if pair else '?',
                        help='sensor b, the child: the same')
    add_bag_argument(parser)
    group = parser.add_argument_group('how to read the inputs (default: detected)')
    for name in 'ab':
        group.add_argument(
            f'--frame-{name}', metavar='FRAME', help=f'name of the frame of sensor {name}')
        group.add_argument(
            f'--times-{name}', type=Path, metavar='FILE',
            help=f'file with the times of the poses of file {name}, one a line')
    for option, settings in _SHARED:
        group.add_argument(f'--{option}', **settings)
        for name in 'ab':
            # --format-a is of version 0.1.
            names = [option, 'format'] if option == 'file-format' else [option]
            group.add_argument(*(f'--{item}-{name}' for item in names),
                               **{**settings, 'help': f'the same, for {name} alone'})


def add_bag_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--bag``; with ``split_bags`` it takes several values."""
    parser.add_argument(
        '--bag', action='append', default=[], metavar='BAG [BAG ...]',
        help='bags that hold the topics or transforms')


def add_file_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of how to read files, for a command with the same options for all files."""
    parser.add_argument(
        '--times', type=Path, metavar='FILE', help='file with the times of the poses, one a line')
    for option, settings in _SHARED:
        parser.add_argument(f'--{option}', **settings)


def options_of(arguments: argparse.Namespace, sensor: str = '') -> InputOptions:
    """Return the input options of sensor 'a' or 'b', or those of all files ('')."""
    given = vars(arguments)
    values: dict[str, Any] = {
        item.name: given.get(f'{item.name}_{sensor}') or given.get(item.name)
        for item in fields(InputOptions)}
    return InputOptions(**values)


def load_pair(
    arguments: argparse.Namespace, frames: tuple[str | None, str | None] = (None, None),
) -> tuple[Trajectory, Trajectory]:
    """Read A and B according to the options of ``add_input_arguments``.

    ``frames`` are the sensor frames of files, which hold no frame names.
    """
    inputs = {}
    for name, frame in zip('ab', frames, strict=True):
        options = options_of(arguments, name)
        if not arguments.bag:
            options = replace(options, frame=options.frame or frame)
        inputs[f'sensor_{name}'] = getattr(arguments, name), options
    if arguments.bag and all(Path(name).is_file() for name, _ in inputs.values()):
        raise ConfigError(
            f'--bag {arguments.bag[0]} is not used: {arguments.a} and {arguments.b} are files. '
            'Leave out --bag, or name topics of the bag')
    with progress('reading') as draw:
        a, b = load_inputs(inputs, arguments.bag, draw).values()
    return a, b


def split_bags(arguments: Sequence[str]) -> list[str]:
    """Return the arguments with ``--bag x y`` as ``--bag x --bag y``.

    Arguments after ``--bag`` belong to it as long as they are bags on disk.
    """
    result: list[str] = []
    after_bag = False
    for k, argument in enumerate(arguments):
        if argument == '--':
            return result + list(arguments[k:])
        if result and result[-1] == '--bag':
            after_bag = True
        elif after_bag and not argument.startswith('-') and is_bag(Path(argument)):
            result.append('--bag')
        else:
            after_bag = False
        result.append(argument)
    return result
