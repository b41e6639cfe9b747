"""``trajectory_calibration fleet``: many bags of the same sensors, compared."""

from __future__ import annotations

import argparse
import csv
from dataclasses import astuple, fields
from pathlib import Path
import sys
from typing import TYPE_CHECKING

from trajectory_calibration.cli.options import (
    add_config_options,
    config_from_arguments,
    require_two,
)
from trajectory_calibration.cli.progress import progress_bar

if TYPE_CHECKING:
    from trajectory_calibration.fleet.executor import Executor


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'fleet', help='calibrate each of many bags of the same sensors, and compare',
        usage='%(prog)s [options] A B BAG [BAG ...]',
        description='Calibrate each bag by itself. Prints CSV with one row for a bag, and on '
        'standard error how far the answers scatter.')
    parser.add_argument('a', metavar='A', help='topic of sensor a, the parent')
    parser.add_argument('b', metavar='B', help='topic of sensor b, the child')
    parser.add_argument('bags', metavar='BAG', nargs='+', type=Path, help='bag')
    add_executor_options(parser)
    add_config_options(parser)
    parser.set_defaults(run=run)


def add_executor_options(parser: argparse.ArgumentParser) -> None:
    """Add where the tasks run."""
    parser.add_argument('--jobs', type=int, metavar='N', help='processes (default: one per core)')
    parser.add_argument(
        '--backend', default='joblib', metavar='NAME',
        help='joblib, or dask for a cluster (default: joblib)')
    parser.add_argument(
        '--scheduler', metavar='ADDRESS',
        help='of a Dask cluster (default: a cluster of its own on this machine)')


def run(arguments: argparse.Namespace) -> int:
    """Calibrate the bags, print their answers, and say how these scatter."""
    from trajectory_calibration.fleet.repeat import (
        BagRecord,
        BagTask,
        calibrate_bag,
        describe_open,
        scatter,
    )
    config = config_from_arguments(arguments)
    require_two(arguments.a, arguments.b)
    tasks = [BagTask(bag, arguments.a, arguments.b, config) for bag in arguments.bags]
    writer = csv.writer(sys.stdout, lineterminator='\n')
    writer.writerow(item.name for item in fields(BagRecord))
    records = []
    with progress_bar('calibrating') as progress:
        for record in executor_of(arguments).map(calibrate_bag, tasks):
            records.append(record)
            writer.writerow(astuple(record))
            progress(len(records), len(tasks))
    found = scatter(records)
    x, y, z = found.T_a_b[:3, 3]
    print(f'{sum(not record.note for record in records)} of {len(records)} bags; mean translation '
          f'({x:.4f}, {y:.4f}, {z:.4f}) m; standard deviations along x, y, z of a '
          f'({", ".join(f"{value:.4f}" for value in found.std_m)}) m and about them '
          f'({", ".join(f"{value:.3f}" for value in found.std_deg)}) deg', file=sys.stderr)
    if unobserved := describe_open(records):
        print(unobserved, file=sys.stderr)
    return 0


def executor_of(arguments: argparse.Namespace) -> Executor:
    """Return where the tasks run that ``add_executor_options`` let a person choose."""
    from trajectory_calibration.fleet.executor import Executor
    return Executor(arguments.backend, arguments.jobs, arguments.scheduler)
