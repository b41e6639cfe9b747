# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks.paper``: the published experiments, repeated."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import sys

from benchmarks.paper.paper import PaperBenchmark, run_paper
from trajectory_calibration.cli.fleet import add_executor_options, executor_of
from trajectory_calibration.cli.main import guarded
from trajectory_calibration.cli.progress import progress
from trajectory_calibration.solvers import SOLVER_NAMES

OUTPUT = Path('benchmark_paper')


def main(argv: Sequence[str] | None = None) -> int:
    """Run the paper's experiments and say where the summary is; the exit status."""
    return guarded(_run, sys.argv[1:] if argv is None else argv)


def _run(argv: Sequence[str]) -> int:
    arguments = _parser().parse_args(argv)
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
        executor=executor_of(arguments),
        command=' '.join(['python -m benchmarks.paper', *argv]),
    )
    with progress('calibrating') as draw:
        summary = run_paper(benchmark, draw)
    print(summary)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='python -m benchmarks.paper', usage='%(prog)s [options]',
        description='Välimäki, Garigipati, Ghabcheloo, Sensors 23(7):3740, 2023, section IV: '
        'every solver at references A, B1, B5, B10, C5, C10 over 19 conditions. Writes runs.csv, '
        'summary.csv, figures and summary.md. The same command continues a run that was cut off.')
    parser.add_argument(
        '--data', type=Path, metavar='DIR',
        help='folder of the published data; with it, the published trajectories are used, and '
        'the KITTI tables are made, of those of the solvers that the paper has')
    parser.add_argument(
        '--trajectories', metavar='WHICH',
        help='simulated, published or both (default: published with --data, else simulated)')
    parser.add_argument(
        '--output', type=Path, default=OUTPUT, metavar='DIR',
        help=f'folder of the results (default: {OUTPUT})')
    parser.add_argument(
        '--solvers', metavar='NAMES', help='names with commas between (default: all)')
    parser.add_argument(
        '--runs', type=int, default=38, help='simulated runs of each condition (default: 38)')
    parser.add_argument(
        '--seed', type=int, default=0,
        help='of the first simulated run; run k is that of simulate --seed (default: 0)')
    add_executor_options(parser)
    return parser


if __name__ == '__main__':
    sys.exit(main())
