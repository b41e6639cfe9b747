"""``trajectory_calibration calibrate``: files or topics in, the extrinsic out."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from trajectory_calibration.cli.options import add_config_options, config_from_arguments
from trajectory_calibration.sources.files import FORMATS, FileSource, read_transform

if TYPE_CHECKING:
    from trajectory_calibration.result import CalibrationResult
    from trajectory_calibration.se3 import FloatArray
    from trajectory_calibration.trajectory import Trajectory


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'calibrate', help='find the extrinsic of two trajectories',
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
        help='known pose of b in a, one row [t] x y z qx qy qz qw or a saved result')
    parser.add_argument(
        '--format', choices=('text', 'json', 'yaml'), default='text', help='of the output')
    parser.add_argument(
        '--output', type=Path, metavar='DIR', help='folder to write the result to')
    add_config_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Calibrate and print the result."""
    from trajectory_calibration.pipeline import calibrate
    config = config_from_arguments(arguments)
    truth = None if arguments.ground_truth is None else read_transform(arguments.ground_truth)
    trajectory_a, trajectory_b = _load(arguments)
    result = calibrate(trajectory_a, trajectory_b, config)
    if arguments.output is not None:
        _write(result, arguments.output)
    _print(result, truth, arguments.format)
    return 0


def _load(arguments: argparse.Namespace) -> tuple[Trajectory, Trajectory]:
    return (
        FileSource(Path(arguments.a), arguments.format_a, arguments.times_a,
                   arguments.frame_a or 'sensor_a').load(),
        FileSource(Path(arguments.b), arguments.format_b, arguments.times_b,
                   arguments.frame_b or 'sensor_b').load())


def _write(result: CalibrationResult, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    result.save(folder / 'result.yaml')


def _print(result: CalibrationResult, truth: FloatArray | None, output_format: str) -> None:
    if output_format == 'json':
        print(json.dumps(result.to_dict(truth)))
    elif output_format == 'yaml':
        from trajectory_calibration.report.text import to_yaml
        sys.stdout.write(to_yaml(result.to_dict(truth)))
    else:
        from trajectory_calibration.report.text import format_result
        sys.stdout.write(format_result(result, truth))
