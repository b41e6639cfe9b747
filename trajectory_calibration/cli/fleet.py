# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``trajectory_calibration fleet``: calibrate and compare recordings of the same sensors."""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

from trajectory_calibration.cli.compare import add_output_options, FILES, report
from trajectory_calibration.cli.options import add_config_options, config_from_arguments
from trajectory_calibration.cli.progress import progress
from trajectory_calibration.cli.writing import require_new
from trajectory_calibration.executor import Executor

OUTPUT = Path('fleet')


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'fleet', help='calibrate many recordings, and find out when a sensor moved',
        usage='%(prog)s [options] JOBS.yaml | BAG ... --a A --b B',
        description='Calibrate each recording separately on all cores, and compare. Results stay '
        'in the folder results of --output: after an interruption, the same command continues. A '
        'recording without an answer is named with its reason. Exit status: 0 the answers agree, '
        '4 they do not, 1 fewer than two answers.')
    parser.add_argument(
        'jobs_or_bags', metavar='JOBS', nargs='+',
        help='YAML file of jobs; or bags, folders or patterns such as "drives/*.mcap"')
    parser.add_argument(
        '--a', metavar='A', help='topic of sensor a, the parent; or its file in each folder')
    parser.add_argument('--b', metavar='B', help='topic of sensor b, the child; or its file')
    add_output_options(parser, OUTPUT)
    parser.add_argument(
        '--force', action='store_true', help='overwrite what other jobs or settings left there')
    add_executor_options(parser)
    add_config_options(parser)


def add_executor_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of an Executor."""
    # --jobs is of version 0.1.
    parser.add_argument('--processes', '--jobs', type=int, default=0, metavar='N',
                        help='processes of this machine (default: one per core)')
    parser.add_argument(
        '--backend', default=Executor.backend, metavar='NAME',
        help=f'joblib, or dask for a cluster (default: {Executor.backend})')
    parser.add_argument(
        '--scheduler', metavar='ADDRESS',
        help='address of a Dask cluster (default: one on this machine)')


def run(arguments: argparse.Namespace) -> int:
    """Calibrate the recordings, compare and print the table."""
    from trajectory_calibration.fleet.comparison import compare
    from trajectory_calibration.fleet.jobs import read_jobs, results_of_others, run_jobs
    jobs = read_jobs(arguments.jobs_or_bags, arguments.a, arguments.b,
                     config_from_arguments(arguments))
    results = arguments.output / 'results'
    others = results_of_others(results, jobs)
    # An interrupted run continues without --force.
    if others or not any(results.glob('*.yaml')):
        require_new([*(arguments.output / name for name in FILES), *others],
                    force=arguments.force)
    with progress('calibrating') as draw:
        done = {entry.name: entry
                for entry in run_jobs(jobs, results, executor_of(arguments), draw)}
    # The order of completion does not matter: the table is always the same.
    entries = [done[job.name] for job in jobs]
    for entry in entries:
        if entry.result is None:
            print(f'{entry.name}: no answer: {entry.failure}', file=sys.stderr)
    return report(compare(entries), arguments)


def executor_of(arguments: argparse.Namespace) -> Executor:
    """Return the executor from the options of ``add_executor_options``."""
    return Executor(arguments.backend, arguments.processes, arguments.scheduler)
