# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``trajectory_calibration calibrate``: estimate the extrinsic from files or topics."""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

from trajectory_calibration import exit_status
from trajectory_calibration.cli.inputs import add_input_arguments, load_pair
from trajectory_calibration.cli.options import add_config_options, config_from_arguments
from trajectory_calibration.cli.progress import progress
from trajectory_calibration.cli.writing import (
    add_truth_argument,
    plot_paths,
    print_as,
    read_truth,
    require_new,
    write_answer,
    write_failure,
    write_pages,
)
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import CalibrationError, ConfigError
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.placement import Placement
from trajectory_calibration.outputs.screen import format_result, format_transform
from trajectory_calibration.outputs.terminal import Terminal
from trajectory_calibration.pipeline import calibrate
from trajectory_calibration.result import CalibrationResult

RESULT_FILE = 'result.yaml'
TRANSFORM_FILE = 'T_a_b.txt'


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'calibrate', help='find the extrinsic of two trajectories',
        usage='%(prog)s [options] A B',
        description='Find the pose of sensor b in sensor a from two trajectories.',
        epilog='Exit status: 0 done; 3 done, but a direction is unobservable; 1 no answer; 2 '
        'wrong usage.')
    add_input_arguments(parser)
    add_truth_argument(parser)
    group = parser.add_argument_group('output')
    group.add_argument(
        '--format', choices=('text', 'json', 'yaml'), default='text', help='output format')
    group.add_argument(
        '-v', '--verbose', action='store_true',
        help='show all findings, and how the answer was computed')
    group.add_argument(
        '-q', '--quiet', action='store_true', help='show the transform alone: x y z qx qy qz qw '
        '(serious findings on standard error)')
    group.add_argument(
        '--output', type=Path, metavar='DIR',
        help='folder for the result (result.yaml) and its exports (URDF, static transform, ...)')
    group.add_argument(
        '--report', type=Path, metavar='FILE.html', help='HTML page with the evidence for the '
        'answer; also written without an answer')
    group.add_argument(
        '--plots', type=Path, metavar='DIR', help='folder for figures as PNG, SVG and PDF; '
        'needs matplotlib')
    group.add_argument('--force', action='store_true', help='overwrite files')
    add_config_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Calibrate and print the result."""
    config = config_from_arguments(arguments)
    require_new(_files(arguments), force=arguments.force)
    loaded: tuple[Trajectory, ...] = ()
    try:
        loaded = a, b = load_pair(arguments)
        truth = read_truth(arguments.ground_truth, a.sensor_frame, b.sensor_frame)
        with progress('calibrating'):
            result = calibrate(a, b, config)
    except ConfigError:
        # Wrong usage: a report about the data would be pointless.
        raise
    except CalibrationError as error:
        if arguments.report is not None:
            write_failure(error, loaded, config, arguments)
        raise
    written = [] if arguments.output is None else [arguments.output]
    # The answer is printed even if a file cannot be written, and the files are written even if
    # the pipe is closed.
    try:
        _print(result, truth, arguments)
    finally:
        if arguments.output is not None:
            _write(result, truth, arguments.output)
        written += write_pages(result, a, b, truth, arguments, arguments.report)
    if arguments.format == 'text' and not arguments.quiet and written:
        print('', *(f'wrote {path}' for path in written), sep='\n')
    return exit_status.INCOMPLETE if result.observability.unobserved else exit_status.DONE


def _files(arguments: argparse.Namespace) -> list[Path]:
    """Return the output files."""
    files = plot_paths(arguments.plots)
    if arguments.output is not None:
        from trajectory_calibration.outputs.exports import EXPORT_FILES
        files += [arguments.output / name for name in (
            RESULT_FILE, TRANSFORM_FILE, *EXPORT_FILES)]
    if arguments.report is not None:
        files.append(arguments.report)
    return files


def _write(result: CalibrationResult, truth: FloatArray | None, folder: Path) -> None:
    """Write the result, the transform as a TUM row, and the exports."""
    from trajectory_calibration.outputs.exports import encode_exports, EXPORT_FILES, EXPORTS
    item = Placement.of(result)
    contents: dict[str, str | bytes] = {}
    if not item.kept_back:
        # Unlike the other exports, a row needs no two different frame names.
        contents[TRANSFORM_FILE] = EXPORTS['tum'].contents(item)
        if result.frame_a != result.frame_b:
            contents.update(encode_exports(item))
    write_answer(
        folder / RESULT_FILE, result.to_dict(truth), contents, (TRANSFORM_FILE, *EXPORT_FILES),
        item.kept_back)


def _print(
    result: CalibrationResult, truth: FloatArray | None, arguments: argparse.Namespace,
) -> None:
    text = format_transform(result) if arguments.quiet else format_result(
        result, truth, verbose=arguments.verbose, terminal=Terminal.of())
    print_as(arguments.format, result.to_dict(truth), text)
    if arguments.format == 'text' and arguments.quiet:
        for finding in result.findings:
            if finding.level == 'serious':
                print(f'serious: {" ".join(finding.text.split())}', file=sys.stderr)
