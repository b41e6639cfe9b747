# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``trajectory_calibration report``: write the HTML report and the plots of a saved result."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
import sys

from trajectory_calibration import exit_status
from trajectory_calibration.cli.inputs import add_input_arguments, load_pair
from trajectory_calibration.cli.writing import (
    add_truth_argument,
    plot_paths,
    read_truth,
    require_new,
    write_pages,
)
from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.trajectory import recording_of
from trajectory_calibration.errors import ConfigError
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.rig.result import is_rig


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'report', help='write the HTML report of a saved result',
        usage='%(prog)s [options] RESULT A B\n       %(prog)s [options] RIG_RESULT RIG.yaml',
        description='Write one HTML page with the evidence for a saved result. A and B, or those '
        'of RIG.yaml for a rig, are the trajectories that it was made from. docs/report.md '
        'explains every figure.')
    parser.add_argument('result', type=Path, metavar='RESULT', help='result.yaml or rig.yaml')
    add_input_arguments(parser, pair=False)
    add_truth_argument(parser)
    parser.add_argument(
        '--output', type=Path, metavar='FILE',
        help='page to write (default: RESULT with the ending .html)')
    parser.add_argument(
        '--plots', type=Path, metavar='DIR', help='folder for the figures as PNG, SVG and '
        'PDF; needs matplotlib')
    parser.add_argument('--force', action='store_true', help='overwrite files')


def run(arguments: argparse.Namespace) -> int:
    """Write the page."""
    if is_rig(arguments.result):
        from trajectory_calibration.cli.rig import report_rig
        return report_rig(arguments)
    if arguments.b is None:
        raise ConfigError(f'B is missing: {arguments.result} was made from two trajectories')
    result = CalibrationResult.load(arguments.result)
    page = arguments.output or arguments.result.with_suffix('.html')
    require_new([page, *plot_paths(arguments.plots)], force=arguments.force)
    a, b = load_pair(arguments, (result.frame_a, result.frame_b))
    if result.recording not in (None, recording_of(a, b)):
        result = replace(result, findings=(Finding(
            'recording-other', f'A and B are not the trajectories of {arguments.result}: the page '
            'shows how well its answer fits them. Give those that it was made from, or use '
            'verify'), *result.findings))
        print(f'{result.findings[0].level}: {result.findings[0]}', file=sys.stderr)
    truth = read_truth(arguments.ground_truth, result.frame_a, result.frame_b)
    for path in write_pages(result, a, b, truth, arguments, page):
        print(f'wrote {path}')
    return exit_status.INCOMPLETE if result.observability.unobserved else exit_status.DONE
