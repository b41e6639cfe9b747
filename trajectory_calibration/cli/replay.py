# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``trajectory_calibration replay``: calibrate a bag with the code of the node."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from trajectory_calibration import exit_status
from trajectory_calibration.cli.progress import progress
from trajectory_calibration.cli.writing import print_as
from trajectory_calibration.config.yaml_file import parse_yaml, read_yaml
from trajectory_calibration.errors import ConfigError, TopicError

_NODE_NAME = 'trajectory_calibration'


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'replay', help='calibrate a bag as the node would, through the same buffers',
        usage='%(prog)s [options] BAG [BAG ...]',
        description="Feed a bag to the node's buffers at full speed and print the answer that "
        'the node gives after it received the same messages.')
    parser.add_argument(
        'bag', nargs='+', type=Path, metavar='BAG', help='bag with the two topics')
    parser.add_argument(
        '--params-file', action='append', type=Path, default=[], metavar='FILE',
        help="the node's parameter file")
    parser.add_argument(
        '-p', '--param', action='append', default=[], metavar='NAME:=VALUE',
        help="one of the node's parameters, as ROS takes it: -p topic_a:=/lidar/odometry")
    parser.add_argument(
        '--format', choices=('text', 'json', 'yaml'), default='text',
        help="output format; text is the node's answer")


def run(arguments: argparse.Namespace) -> int:
    """Replay, calibrate and print the answer."""
    # Imported here, not at the start of every command.
    from trajectory_calibration.online.answer import describe
    from trajectory_calibration.online.feed import feed_track
    from trajectory_calibration.online.options import (
        check_values,
        find_frames,
        find_type,
        to_config,
        to_limits,
    )
    from trajectory_calibration.online.session import CalibrationSession
    from trajectory_calibration.sources.bags import open_bags
    values = check_values(_read_parameters(arguments.params_file, arguments.param))
    topic_a, topic_b = (
        values[name] if find_frames(values[name]) else f'/{values[name].lstrip("/")}'
        for name in ('topic_a', 'topic_b'))
    if topic_a == topic_b:
        raise ConfigError(f'topic_a and topic_b are both {topic_a}; needed two sensors')
    with open_bags(arguments.bag) as reader, progress('reading') as draw:
        tracks = reader.read([topic_a, topic_b], draw)
    session = CalibrationSession((topic_a, topic_b), to_limits(values))
    for topic, name, buffer in zip(
            (topic_a, topic_b), ('type_a', 'type_b'), session.buffers, strict=True):
        expected = find_type(values[name])
        if expected not in (None, tracks[topic].msgtype) and find_frames(topic) is None:
            raise TopicError(f'{topic} carries {tracks[topic].msgtype}, {name} is {expected}; '
                             'correct it or set auto')
        feed_track(tracks[topic], buffer)
    result = session.job(
        to_config(values), (values['frame_a'], values['frame_b'])).run().result
    print_as(arguments.format, result.to_dict(), describe(result) + '\n')
    return exit_status.INCOMPLETE if result.observability.unobserved else exit_status.DONE


def _read_parameters(files: Sequence[Path], assignments: Sequence[str]) -> dict[str, Any]:
    """Return the parameters of files, overridden by assignments; they are not checked here."""
    values: dict[str, Any] = {}
    for path in files:
        values.update(_node_parameters(read_yaml(path, 'parameters', ConfigError), path))
    for assignment in assignments:
        name, separator, text = assignment.partition(':=')
        if not separator:
            raise ConfigError(f'-p {assignment!r} is no parameter; needed NAME:=VALUE')
        values[name] = parse_yaml(text, f'-p {assignment!r} cannot be read', ConfigError)
    return values


def _node_parameters(document: Any, path: Path) -> dict[str, Any]:
    """Return the parameters of all nodes (``/**``), overridden by those of this node."""
    nodes = {str(key): node for key, node in document.items()} if (
        isinstance(document, dict)) else {}
    given = [node.get('ros__parameters') if isinstance(node, dict) else None
             for key, node in sorted(nodes.items(), key=lambda item: item[0] != '/**')
             if key == '/**' or key.rpartition('/')[2] == _NODE_NAME]
    if not given or not all(isinstance(values, dict) for values in given):
        raise ConfigError(
            f'{path} holds no parameters of {_NODE_NAME}; needed them under "/**:" and '
            '"ros__parameters:" as in config/calibration.yaml')
    return {name: value for values in given for name, value in _flattened(values)}


def _flattened(values: Any, prefix: str = '') -> Iterator[tuple[str, Any]]:
    """Yield parameters with dotted names, which ``ros2 param dump`` writes as nested mappings."""
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _flattened(value, f'{prefix}{name}.')
        else:
            yield f'{prefix}{name}', value
