"""``trajectory_calibration calibrate``: files or topics in, the extrinsic out."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from trajectory_calibration.cli.inputs import add_input_arguments, load_pair
from trajectory_calibration.cli.options import add_config_options, config_from_arguments
from trajectory_calibration.cli.progress import running_clock
from trajectory_calibration.config.yaml_file import to_yaml, write_text, write_yaml
from trajectory_calibration.errors import ResultError
from trajectory_calibration.geometry.se3 import FloatArray, rotation_to_quaternion
from trajectory_calibration.outputs.screen import format_result
from trajectory_calibration.pipeline import calibrate
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.sources.files import read_transform

RESULT_FILE = 'result.yaml'
TRANSFORM_FILE = 'T_a_b.txt'


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'calibrate', help='find the extrinsic of two trajectories',
        usage='%(prog)s [options] A B',
        description='Find the pose of sensor b in sensor a from two trajectories.')
    add_input_arguments(parser)
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
    trajectory_a, trajectory_b = load_pair(arguments)
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
