# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``trajectory_calibration compare``: compare saved results of the same sensors."""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

from trajectory_calibration.cli.writing import print_table, require_new
from trajectory_calibration.errors import ConfigError
from trajectory_calibration.fleet.comparison import compare, Comparison, Entry, short_names
from trajectory_calibration.outputs.comparison_table import to_csv, to_json, to_text
from trajectory_calibration.outputs.fleet_page import fleet_page
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.rig.result import is_rig

# The files in the folder --output.
FILES = ('table.csv', 'table.json', 'fleet.html')


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'compare', help='find out whether saved results agree, or when the extrinsic changed',
        usage='%(prog)s [options] RESULT RESULT [RESULT ...]',
        description='Put results of the same sensors in the order of their dates, and find where '
        'the extrinsic changed. Exit status: 0 they agree, 4 they do not. Rigs (rig.yaml) are '
        'compared with the first one, sensor by sensor, without a page; 3: a sensor could not be '
        'compared, or both rigs are of one recording.')
    parser.add_argument(
        'results', metavar='RESULT', nargs='+', type=Path,
        help='result.yaml or rig.yaml, two or more')
    add_output_options(parser)
    parser.add_argument('--force', action='store_true', help='overwrite files')


def add_output_options(parser: argparse.ArgumentParser, output: Path | None = None) -> None:
    """Add ``--format`` and ``--output`` for the table."""
    parser.add_argument(
        '--format', choices=('text', 'csv', 'json'), default='text', help='output format')
    written = f'(default: {output})' if output else '(default: none is written)'
    parser.add_argument(
        '--output', type=Path, metavar='DIR', default=output,
        help=f'folder for table.csv, table.json and fleet.html, the page of charts {written}')


def run(arguments: argparse.Namespace) -> int:
    """Compare and print the table."""
    if len(arguments.results) < 2:
        raise ConfigError('compare needs two or more results; one was given')
    rigs = [is_rig(path) for path in arguments.results]
    if all(rigs):
        from trajectory_calibration.cli.rig import compare_saved
        return compare_saved(arguments.results, arguments)
    if any(rigs):
        raise ConfigError(f'{arguments.results[rigs.index(True)]} is a rig, and others are not; '
                          'compare rigs with rigs')
    if arguments.output is not None:
        require_new([arguments.output / name for name in FILES], force=arguments.force)
    names = short_names([str(path) for path in arguments.results])
    return report(
        compare([Entry(name, CalibrationResult.load(path))
                 for name, path in zip(names, arguments.results, strict=True)]), arguments)


def report(comparison: Comparison, arguments: argparse.Namespace) -> int:
    """Print and write a comparison; return the exit status."""
    text = {'text': to_text, 'csv': to_csv, 'json': to_json}[arguments.format](comparison)
    encoders = to_csv, to_json, fleet_page
    print_table(text, ((name, encode(comparison)) for name, encode in zip(
        FILES, encoders, strict=True)), arguments)
    if arguments.format != 'text' and comparison.exit_status:
        print('\n'.join(comparison.describe()), file=sys.stderr)
    return comparison.exit_status
