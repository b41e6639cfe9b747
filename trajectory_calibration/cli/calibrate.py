"""``trajectory_calibration calibrate``: files or topics in, the extrinsic out."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from trajectory_calibration.cli.options import (
    add_config_options,
    config_from_arguments,
    require_two,
)
from trajectory_calibration.cli.progress import progress_bar, running_clock
from trajectory_calibration.config.yaml_file import to_yaml, write_text, write_yaml
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import ConfigError, ResultError
from trajectory_calibration.geometry.se3 import FloatArray, rotation_to_quaternion
from trajectory_calibration.outputs.screen import format_result
from trajectory_calibration.pipeline import calibrate
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.sources.files import FileSource, FORMATS, read_transform

RESULT_FILE = 'result.yaml'
TRANSFORM_FILE = 'T_a_b.txt'


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'calibrate', help='find the extrinsic of two trajectories',
        usage='%(prog)s [options] A B',
        description='Find the pose of sensor b in sensor a from two trajectories.')
    parser.add_argument('a', metavar='A', help='file of sensor a, the parent; a topic with --bag')
    parser.add_argument('b', metavar='B', help='file of sensor b, the child; a topic with --bag')
    parser.add_argument(
        '--bag', action='append', type=Path, metavar='BAG',
        help='bag that holds A and B as topics; may be given several times')
    for name in 'ab':
        parser.add_argument(
            f'--frame-{name}', metavar='FRAME', help=f'name of the frame of sensor {name}')
        parser.add_argument(
            f'--format-{name}', choices=FORMATS,
            help='format of the file (default: told from its first row)')
        parser.add_argument(
            f'--times-{name}', type=Path, metavar='FILE', help='times of KITTI poses, seconds')
    parser.add_argument(
        '--ground-truth', type=Path, metavar='FILE',
        help='known pose of b in a, one row [t] x y z qx qy qz qw or a saved result (.yaml)')
    parser.add_argument(
        '--format', choices=('text', 'json', 'yaml'), default='text', help='of the output')
    parser.add_argument(
        '--output', type=Path, metavar='DIR', help='folder to write the result to')
    add_config_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Calibrate and print the result."""
    config = config_from_arguments(arguments)
    truth = None if arguments.ground_truth is None else _read_truth(arguments.ground_truth)
    trajectory_a, trajectory_b = _load(arguments)
    with running_clock('calibrating'):
        result = calibrate(trajectory_a, trajectory_b, config)
    if arguments.output is not None:
        _write(result, truth, arguments.output)
    _print(result, truth, arguments.format)
    return 0


def _read_truth(path: Path) -> FloatArray:
    if path.suffix in ('.yaml', '.yml'):
        return CalibrationResult.load(path).T_a_b
    return read_transform(path)


def _load(arguments: argparse.Namespace) -> tuple[Trajectory, Trajectory]:
    """Read A and B."""
    require_two(arguments.a, arguments.b)
    if arguments.bag:
        return _load_topics(arguments)
    if _same_file(arguments.a, arguments.b):
        raise ConfigError(
            f'A and B, {arguments.a} and {arguments.b}, are the same file; needed two sensors')
    with running_clock('reading'):
        return (
            FileSource(Path(arguments.a), arguments.format_a, arguments.times_a,
                       arguments.frame_a or 'sensor_a').load(),
            FileSource(Path(arguments.b), arguments.format_b, arguments.times_b,
                       arguments.frame_b or 'sensor_b').load())


def _same_file(a: str, b: str) -> bool:
    try:
        return Path(a).samefile(b)
    except OSError:
        # Reading it says what is wrong.
        return False


def _load_topics(arguments: argparse.Namespace) -> tuple[Trajectory, Trajectory]:
    """Read the topics A and B in one pass over the bags."""
    for name in ('format_a', 'format_b', 'times_a', 'times_b'):
        if getattr(arguments, name) is not None:
            raise ConfigError(f'--{name.replace("_", "-")} is for files; with --bag, A and B are '
                              'topics, whose messages carry their format and time')
    # rosbags loads where a bag is read, and only there.
    from trajectory_calibration.sources.bags import open_bags
    with open_bags(arguments.bag) as reader, progress_bar('reading') as progress:
        tracks = reader.read([arguments.a, arguments.b], progress)
    return (tracks[arguments.a].to_trajectory(arguments.frame_a),
            tracks[arguments.b].to_trajectory(arguments.frame_b))


def _write(result: CalibrationResult, truth: FloatArray | None, folder: Path) -> None:
    """Write the result, then the bare transform as one row that other tools read."""
    t, q = result.T_a_b[:3, 3], rotation_to_quaternion(result.T_a_b[:3, :3])
    lines = [f'# pose of {result.frame_b} in {result.frame_a}: stamp tx ty tz qx qy qz qw']
    if result.observability.unobserved:
        lines.append(f'# not observed: {", ".join(result.observability.unobserved)}')
    lines.append(f'0 {" ".join(f"{value:.9f}" for value in (*t, *q))}')
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_yaml(folder / RESULT_FILE, result.to_dict(truth))
        write_text(folder / TRANSFORM_FILE, ''.join(f'{line}\n' for line in lines), ResultError)
    except OSError as error:
        raise ResultError(
            f'{folder} cannot be written: {error.strerror or error}; give another --output'
        ) from error
    except ResultError as error:
        raise ResultError(f'{error}; give another --output') from error


def _print(result: CalibrationResult, truth: FloatArray | None, output_format: str) -> None:
    if output_format == 'json':
        print(json.dumps(result.to_dict(truth)))
    elif output_format == 'yaml':
        print(to_yaml(result.to_dict(truth)), end='')
    else:
        print(format_result(result, truth), end='')
