# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``trajectory_calibration inspect``: show the content of bags and files, and rate the motion."""

from __future__ import annotations

import argparse
from dataclasses import replace
import json
from pathlib import Path
import sys
from typing import Any, TYPE_CHECKING

from trajectory_calibration.cli.inputs import add_file_arguments, options_of
from trajectory_calibration.cli.progress import progress
from trajectory_calibration.errors import ConfigError, MissingPackageError, SourceError
from trajectory_calibration.outputs.inspection import inspect_trajectory
from trajectory_calibration.outputs.screen import format_inspection
from trajectory_calibration.outputs.terminal import Terminal
from trajectory_calibration.sources.inputs import InputOptions, load_file
from trajectory_calibration.sources.text import is_bag
from trajectory_calibration.sources.transforms import TF_PREFIX

if TYPE_CHECKING:
    from trajectory_calibration.sources.topics import TopicTrack


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'inspect', help='show what is in a bag or a file, and whether its motion suffices',
        usage='%(prog)s [options] PATH [PATH ...]',
        description='Show the trajectories in bags and files: counts, rates, gaps, frames, and '
                    'whether their motion can determine an extrinsic.')
    parser.add_argument('paths', metavar='PATH', nargs='*', type=Path, help='bag or file')
    # For consistency with the other commands.
    parser.add_argument(
        '--bag', metavar='BAG', action='append', default=[], type=Path, help='the same as PATH')
    parser.add_argument('--format', choices=('text', 'json'), default='text', help='output format')
    add_file_arguments(parser)
    parser.set_defaults(parser=parser)


def run(arguments: argparse.Namespace) -> int:
    """Inspect each path and print the results, then the errors of those that cannot be read."""
    paths = [*arguments.paths, *arguments.bag]
    if not paths:
        arguments.parser.print_usage(sys.stderr)
        raise ConfigError('the following arguments are required: PATH')
    inputs, errors = [], []
    for path in paths:
        try:
            inputs.append(_inspect_bag(path) if is_bag(path) else
                          _inspect_file(path, options_of(arguments)))
        except (MissingPackageError, SourceError) as error:  # noqa: PERF203
            errors.append(str(error))
    if arguments.format == 'json' and inputs:
        print(json.dumps({'inputs': inputs}))
    else:
        print('\n'.join(format_inspection(item, Terminal.of()) for item in inputs), end='')
    if errors:
        # Flushed, so that a terminal shows the results before the error.
        print(end='', flush=True)
        raise SourceError('; '.join(errors))
    return 0


def _inspect_file(path: Path, options: InputOptions) -> dict[str, Any]:
    with progress('reading'):
        trajectory, read_as = load_file(str(path), path.name, options)
    data = inspect_trajectory(trajectory, str(path), 'file')
    # The path is printed above the findings; file formats have no frame names.
    for finding in data['findings']:
        finding['text'] = finding['text'].removeprefix(f'{path.name}: ').removeprefix(f'{path}: ')
    data.update(sensor_frame=None, world_frame=None, read_as=read_as,
                warnings=[finding['text'] for finding in data['findings']])
    return {'path': str(path), 'notes': [], 'trajectories': [data], 'other': []}


def _inspect_bag(path: Path) -> dict[str, Any]:
    # Imported here because files need no bag reader.
    from trajectory_calibration.sources.bags import open_bags
    from trajectory_calibration.sources.cdr import TF
    with open_bags([path]) as reader, progress('reading') as draw:
        tree = reader.transforms()
        pairs = [f'{TF_PREFIX}{parent}.{child}' for parent, child in tree.pairs()]
        # Six pairs of frames are described in full; the others are named.
        tracks = reader.read([*reader.serving, *pairs[:6]], draw)
        others = [
            {'topic': channel.topic, 'msgtype': channel.msgtype, 'messages': channel.messages,
             **({} if channel.encoding == 'cdr' else {'encoding': channel.encoding})}
            for channel in reader.channels
            if channel.topic not in reader.serving and channel.msgtype != TF]
        notes = reader.notes
    # Notes are printed once for the bag, not again with each topic.
    topics = [_inspect_topic(replace(track, warnings=tuple(
        warning for warning in track.warnings if warning not in notes)))
        for track in tracks.values()]
    transforms = {'transforms': {
        'frames': sorted(tree.frames),
        'edges': [f'{edge}{" (static)" if edge.static else ""}' for edge in tree.edges],
        'pairs': pairs}}
    return {'path': str(path), 'notes': notes,
            'trajectories': [item for item in topics if 'error' not in item],
            'other': [item for item in topics if 'error' in item] + others,
            **(transforms if tree.frames else {})}


def _inspect_topic(track: TopicTrack) -> dict[str, Any]:
    """Describe a topic, or return the reason why it is no trajectory."""
    try:
        data = inspect_trajectory(track.to_trajectory(), track.topic, track.msgtype)
    except SourceError as error:
        return {'topic': track.topic, 'msgtype': track.msgtype, 'messages': track.messages,
                'error': str(error)}
    # For a pair of TF frames the messages are not counted: each holds other transforms, too.
    counted = {} if track.topic.startswith(TF_PREFIX) else {'messages': track.messages}
    return {**data, **counted}
