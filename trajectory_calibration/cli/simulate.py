# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``trajectory_calibration simulate``: write two trajectories with a known extrinsic."""

from __future__ import annotations

import argparse
from dataclasses import fields, replace
from pathlib import Path
import shlex
from typing import Any

from trajectory_calibration.cli.progress import progress
from trajectory_calibration.cli.writing import require_new
from trajectory_calibration.config.yaml_file import make_folder
from trajectory_calibration.errors import ConfigError, counted, SourceError
from trajectory_calibration.simulation import Noise, Scenario, SCENARIOS, simulate, SimulatedPair
from trajectory_calibration.simulation.files import (
    MESSAGES,
    STORAGES,
    write_bag,
    write_transform,
    write_tum,
)

FORMATS = ('tum', *STORAGES)
TOPICS = ('/trajectory_a', '/trajectory_b')

# Fields of ``Sensor`` that are options.
_SENSOR_OPTIONS = (
    ('rate', float, 'HZ', 'poses per second (default: of the scenario)'),
    ('clock-offset', float, 'S', 'its clock is ahead by this many seconds'),
    ('clock-drift', float, 'S/S', 'its clock gains this many seconds a second'),
    ('gaps', int, 'N', 'gaps in its poses'),
    ('gap', float, 'S', 'length of each gap, seconds'),
)


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'simulate', help='make two trajectories with a known extrinsic',
        usage='%(prog)s [options] --output DIR',
        description='Simulate the trajectories of two sensors on one vehicle, with the errors of '
        'a SLAM. Writes truth.tum, and a.tum and b.tum or a rosbag2 in the folder bag.')
    parser.add_argument('--output', type=Path, required=True, metavar='DIR', help='folder to fill')
    parser.add_argument('--force', action='store_true', help='overwrite files')
    parser.add_argument(
        '--scenario', default='mixture', metavar='NAME',
        help='noise, outliers, drift, mixture (10 s each, as in the paper), offroad, road (nearly '
        'flat), drone or handheld (default: mixture)')
    parser.add_argument('--seed', type=int, default=0, help='random seed (default: 0)')
    parser.add_argument(
        '--noise', action='append', default=[], metavar='[a.|b.]NAME=VALUE',
        help='change an error of both sensors, or of one: white, white_rotation, jumps, drift, '
        'walk, walk_rotation, coloured, coloured_rotation, coloured_time, loop_closures, scale '
        '(metres, radians, seconds); may be given several times')
    parser.add_argument('--duration', type=float, metavar='S',
                        help='length of the drive, seconds (default: of the scenario)')
    parser.add_argument(
        '--mounting', metavar='TRANSFORM',
        help='pose of b in a: x,y,z,roll,pitch,yaw (metres, radians), x,y,z,qx,qy,qz,qw, or a '
        'file (default: drawn from the seed)')
    for name in 'ab':
        group = parser.add_argument_group(f'sensor {name}')
        for option, kind, metavar, text in _SENSOR_OPTIONS:
            group.add_argument(f'--{option}-{name}', type=kind, metavar=metavar, help=text)
        group.add_argument(f'--frame-{name}', dest=f'sensor_frame_{name}', metavar='FRAME',
                           help='name of its frame')
    parser.add_argument(
        '--format', choices=FORMATS, default='tum',
        help='files (tum) or a bag (mcap, sqlite3) (default: tum)')
    parser.add_argument(
        '--message', choices=MESSAGES, default='odometry',
        help='type of the messages in a bag (default: odometry)')


def run(arguments: argparse.Namespace) -> int:
    """Simulate, write the files and print a summary."""
    require_new(_files(arguments), force=arguments.force)
    if arguments.scenario not in SCENARIOS:
        raise ConfigError(
            f'scenario {arguments.scenario!r} is unknown; needed one of {", ".join(SCENARIOS)}')
    if arguments.seed < 0:
        raise ConfigError(f'seed is {arguments.seed}, needed a whole number from 0 up')
    scenario = _with_options(SCENARIOS[arguments.scenario], arguments)
    mounting = None
    if arguments.mounting is not None:
        from trajectory_calibration.outputs.extrinsic_file import transform_of
        mounting = transform_of(arguments.mounting)
    with progress('simulating'):
        pair = simulate(scenario, arguments.seed, mounting)
        hint = _write(pair, arguments)
    for name, trajectory in (('a', pair.a), ('b', pair.b)):
        print(f'{name}: {counted(len(trajectory), "pose")} of {trajectory.sensor_frame} over '
              f'{trajectory.duration_s:g} s')
    print(f'try: {hint}')
    return 0


def _files(arguments: argparse.Namespace) -> list[Path]:
    """Return the output files that ``--force`` overwrites."""
    names = ['truth.tum', 'a.tum', 'b.tum']
    if arguments.format != 'tum':
        # A bag is never overwritten: ``write_bag`` raises before the truth is written.
        names = [] if (arguments.output / 'bag').exists() else names[:1]
    return [arguments.output / name for name in names]


def _with_options(scenario: Scenario, arguments: argparse.Namespace) -> Scenario:
    """Return the scenario with the options applied."""
    # In one step: the limits of the number of poses depend on the duration and the rate.
    changes: dict[str, Any] = {}
    if arguments.duration is not None:
        changes['duration'] = arguments.duration
    for name in 'ab':
        sensor = getattr(scenario, name)
        given = {item.name: value for item in fields(sensor)
                 if (value := getattr(arguments, f'{item.name}_{name}', None)) is not None}
        noise = _with_settings(sensor.noise, name, arguments.noise)
        changes[name] = replace(sensor, noise=noise, **given)
    return replace(scenario, **changes)


def _with_settings(noise: Noise, sensor: str, settings: list[str]) -> Noise:
    """Return the noise with the settings ``[a.|b.]NAME=VALUE`` of the sensor applied."""
    names = [item.name for item in fields(noise)]
    values: dict[str, Any] = {}
    for setting in settings:
        key, _, text = setting.partition('=')
        which, _, name = key.rpartition('.')
        if which not in ('', 'a', 'b') or name not in names:
            raise ConfigError(
                f'noise {setting!r} is unknown; needed NAME=VALUE, a.NAME=VALUE or b.NAME=VALUE '
                f'with a name of {", ".join(names)}')
        if which in ('', sensor):
            kind = int if name in ('jumps', 'loop_closures') else float
            try:
                values[name] = kind(text)
            except ValueError:
                raise ConfigError(
                    f'noise {setting!r}: {text!r} is no {kind.__name__}') from None
    return replace(noise, **values)


def _write(pair: SimulatedPair, arguments: argparse.Namespace) -> str:
    """Write the files; return the command that calibrates them."""
    folder: Path = arguments.output
    make_folder(folder, SourceError)
    inputs: list[Path | str]
    if arguments.format == 'tum':
        inputs = [folder / 'a.tum', folder / 'b.tum']
        for path, trajectory in zip(inputs, pair[:2], strict=True):
            write_tum(Path(path), trajectory)
    else:
        inputs = ['--bag', folder / 'bag', *TOPICS]
        write_bag(folder / 'bag', dict(zip(TOPICS, pair[:2], strict=True)),
                  message=arguments.message, storage=arguments.format)
    write_transform(folder / 'truth.tum', pair.T_a_b)
    offset = (arguments.clock_offset_a or 0.0) - (arguments.clock_offset_b or 0.0)
    clocks = ['--time-offset', f'{offset:.12g}'] if offset else []
    return shlex.join(map(str, [
        'trajectory_calibration', 'calibrate', *inputs, '--ground-truth', folder / 'truth.tum',
        *clocks]))
