"""``trajectory_calibration inspect``: what is in a bag or a file, and whether it suffices."""

from __future__ import annotations

import argparse
from dataclasses import replace
import json
from pathlib import Path
from typing import Any, TYPE_CHECKING

from trajectory_calibration.cli.progress import progress_bar, running_clock
from trajectory_calibration.errors import SourceError
from trajectory_calibration.outputs.inspection import inspect_trajectory
from trajectory_calibration.outputs.screen import format_inspection
from trajectory_calibration.outputs.terminal import Terminal
from trajectory_calibration.sources.files import FileSource, FORMATS, is_bag

if TYPE_CHECKING:
    from trajectory_calibration.sources.topics import TopicTrack


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'inspect', help='show what is in a bag or a file, and whether its motion suffices',
        usage='%(prog)s [options] PATH [PATH ...]',
        description='Show the trajectories in bags and files: counts, rates, gaps, frames, and '
                    'whether their motion can determine an extrinsic.')
    parser.add_argument('paths', metavar='PATH', nargs='+', type=Path, help='bag or file')
    parser.add_argument('--format', choices=('text', 'json'), default='text', help='of the output')
    parser.add_argument(
        '--file-format', choices=FORMATS, help='format of the files (default: from their rows)')
    parser.add_argument(
        '--times', type=Path, metavar='FILE', help='times of KITTI poses, seconds')
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Inspect each path and print what was found, then what could not be read."""
    found = [_inspect(path, arguments) for path in arguments.paths]
    inputs = [item for item in found if not isinstance(item, SourceError)]
    errors = [item for item in found if isinstance(item, SourceError)]
    if arguments.format == 'json' and inputs:
        print(json.dumps({'inputs': inputs}))
    else:
        print('\n'.join(format_inspection(item, Terminal.of()) for item in inputs), end='')
    if errors:
        # What was found comes first, also where both go to one terminal.
        print(end='', flush=True)
        raise SourceError('; '.join(map(str, errors)))
    return 0


def _inspect(path: Path, arguments: argparse.Namespace) -> dict[str, Any] | SourceError:
    """Describe what is at a path, or return why that cannot be done."""
    try:
        if is_bag(path):
            return _inspect_bag(path)
        return _inspect_file(path, arguments.file_format, arguments.times)
    except SourceError as error:
        return error


def _inspect_file(path: Path, file_format: str | None, times: Path | None) -> dict[str, Any]:
    with running_clock('reading'):
        trajectory = FileSource(path, file_format, times, path.name).load()
    # No format of files names its frames.
    found = {**inspect_trajectory(trajectory, str(path), 'file').to_dict(),
             'sensor_frame': None, 'world_frame': None}
    return {'path': str(path), 'notes': [], 'trajectories': [found], 'other': []}


def _inspect_bag(path: Path) -> dict[str, Any]:
    # rosbags loads where a bag is read, and only there.
    from trajectory_calibration.sources.bags import open_bags
    from trajectory_calibration.sources.cdr import TRAJECTORY_TYPES
    with open_bags([path]) as reader, progress_bar('reading') as progress:
        types: dict[str, set[str]] = {}
        for channel in reader.channels:
            types.setdefault(channel.topic, set()).add(channel.msgtype)
        serving = [topic for topic, kinds in types.items()
                   if len(kinds) == 1 and kinds <= set(TRAJECTORY_TYPES)]
        tracks = reader.read(serving, progress)
        others = [channel._asdict() for channel in reader.channels
                  if channel.topic not in serving]
        notes = reader.notes
    # The notes stand above all topics, so not once more with one of them.
    found = [_inspect_topic(replace(track, warnings=tuple(
        warning for warning in track.warnings if warning not in notes)))
        for track in tracks.values()]
    return {'path': str(path), 'notes': notes,
            'trajectories': [item for item in found if 'error' not in item],
            'other': [item for item in found if 'error' in item] + others}


def _inspect_topic(track: TopicTrack) -> dict[str, Any]:
    """Describe a topic, or say why it is of no use."""
    try:
        found = inspect_trajectory(track.to_trajectory(), track.topic, track.msgtype)
    except SourceError as error:
        return {'topic': track.topic, 'msgtype': track.msgtype, 'messages': track.messages,
                'error': str(error)}
    return {**found.to_dict(), 'messages': track.messages}
