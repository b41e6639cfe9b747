"""``trajectory_calibration benchmark``: the paper, repeated; and many bags, compared."""

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
    from trajectory_calibration.benchmark.executor import Executor

OUTPUT = Path('benchmark_paper')


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'benchmark', help='repeat the published experiments, or calibrate many bags',
        description='Repeat the published experiments, or calibrate many bags and compare.')
    experiments = parser.add_subparsers(title='experiments', metavar='EXPERIMENT', required=True)
    _add_paper(experiments)
    _add_repeat(experiments)


def _add_paper(experiments: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    paper = experiments.add_parser(
        'paper', help='all solvers at all references under noise, outliers, drift, their mixture',
        usage='%(prog)s [options]',
        description='Välimäki, Garigipati, Ghabcheloo, Sensors 23(7):3740, 2023, section IV: '
        'every solver at references A, B1, B5, B10, C5, C10 over 19 conditions. Writes runs.csv, '
        'summary.csv, figures and summary.md. The same command continues a run that was cut off.')
    paper.add_argument(
        '--data', type=Path, metavar='DIR',
        help='folder of the published data; with it, the published trajectories are used, and '
        'the KITTI tables are made, of those of the solvers that the paper has')
    paper.add_argument(
        '--trajectories', metavar='WHICH',
        help='simulated, published or both (default: published with --data, else simulated)')
    paper.add_argument(
        '--output', type=Path, default=OUTPUT, metavar='DIR',
        help=f'folder of the results (default: {OUTPUT})')
    paper.add_argument(
        '--solvers', metavar='NAMES', help='names with commas between (default: all)')
    paper.add_argument(
        '--runs', type=int, default=38, help='simulated runs of each condition (default: 38)')
    paper.add_argument(
        '--seed', type=int, default=0,
        help='of the first simulated run; run k is that of simulate --seed (default: 0)')
    _add_executor_options(paper)
    paper.set_defaults(run=run_paper)


def _add_repeat(experiments: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    repeat = experiments.add_parser(
        'repeat', help='calibrate each of many bags of the same sensors, and compare',
        usage='%(prog)s [options] A B BAG [BAG ...]',
        description='Calibrate each bag by itself. Prints CSV with one row for a bag, and on '
        'standard error how far the answers scatter.')
    repeat.add_argument('a', metavar='A', help='topic of sensor a, the parent')
    repeat.add_argument('b', metavar='B', help='topic of sensor b, the child')
    repeat.add_argument('bags', metavar='BAG', nargs='+', type=Path, help='bag')
    _add_executor_options(repeat)
    add_config_options(repeat)
    repeat.set_defaults(run=run_repeat)


def _add_executor_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--jobs', type=int, metavar='N', help='processes (default: one per core)')
    parser.add_argument(
        '--backend', default='joblib', metavar='NAME',
        help='joblib, or dask for a cluster (default: joblib)')
    parser.add_argument(
        '--scheduler', metavar='ADDRESS',
        help='of a Dask cluster (default: a cluster of its own on this machine)')


def run_paper(arguments: argparse.Namespace) -> int:
    """Run the paper's experiments and say where the summary is."""
    from trajectory_calibration.benchmark.paper import PaperBenchmark, run_paper
    from trajectory_calibration.solvers import SOLVER_NAMES
    solvers = tuple(SOLVER_NAMES)
    if arguments.solvers is not None:
        solvers = tuple(name.strip() for name in arguments.solvers.split(','))
    benchmark = PaperBenchmark(
        output=arguments.output,
        data=arguments.data,
        trajectories=arguments.trajectories or ('published' if arguments.data else 'simulated'),
        runs=arguments.runs,
        seed=arguments.seed,
        solvers=solvers,
        executor=_executor(arguments),
        command=' '.join(['trajectory_calibration', *sys.argv[1:]]),
    )
    with progress_bar('calibrating') as progress:
        summary = run_paper(benchmark, progress)
    print(summary)
    return 0


def run_repeat(arguments: argparse.Namespace) -> int:
    """Calibrate the bags, print their answers, and say how these scatter."""
    from trajectory_calibration.benchmark.repeat import (
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
        for record in _executor(arguments).map(calibrate_bag, tasks):
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


def _executor(arguments: argparse.Namespace) -> Executor:
    from trajectory_calibration.benchmark.executor import Executor
    return Executor(arguments.backend, arguments.jobs, arguments.scheduler)
