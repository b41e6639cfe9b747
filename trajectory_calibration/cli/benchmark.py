"""``trajectory_calibration benchmark``: the paper, repeated."""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

from trajectory_calibration.cli.progress import progress_bar

OUTPUT = Path('benchmark_paper')


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'benchmark', help='repeat the published experiments',
        description='Repeat published experiments and compare.')
    experiments = parser.add_subparsers(title='experiments', metavar='EXPERIMENT', required=True)
    _add_paper(experiments)


def _add_paper(experiments: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    paper = experiments.add_parser(
        'paper', help='all solvers at all references under noise, outliers, drift, their mixture',
        description='Välimäki, Garigipati, Ghabcheloo, Sensors 23(7):3740, 2023, section IV: '
        'every solver at references A, B1, B5, B10, C5, C10 over 19 conditions. Writes runs.csv, '
        'summary.csv, figures and summary.md. The same command continues a run that was cut off.')
    paper.add_argument(
        '--data', type=Path, metavar='DIR',
        help='folder of the published data; with it, the published trajectories are used, and '
        'the KITTI tables are made')
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
    paper.add_argument('--jobs', type=int, metavar='N', help='processes (default: one per core)')
    paper.add_argument(
        '--backend', default='joblib', metavar='NAME',
        help='joblib, or dask for a cluster (default: joblib)')
    paper.add_argument(
        '--scheduler', metavar='ADDRESS',
        help='of a Dask cluster (default: a cluster of its own on this machine)')
    paper.set_defaults(run=run_paper)


def run_paper(arguments: argparse.Namespace) -> int:
    """Run the paper's experiments and say where the summary is."""
    from trajectory_calibration.benchmark.executor import Executor
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
        executor=Executor(arguments.backend, arguments.jobs, arguments.scheduler),
        command=' '.join(['trajectory_calibration', *sys.argv[1:]]),
    )
    with progress_bar('calibrating') as progress:
        summary = run_paper(benchmark, progress)
    print(summary)
    return 0
