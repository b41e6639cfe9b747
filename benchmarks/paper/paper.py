# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks.paper``: everything in the paper's section IV, in one folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
import time

from benchmarks.paper import tables
from benchmarks.paper.claims import judge
from benchmarks.paper.comparison import compare_runs, compare_with_quartiles
from benchmarks.paper.environment import (
    describe_executor,
    describe_machine,
    describe_versions,
    in_order,
)
from benchmarks.paper.kitti import kitti_tasks, KittiRecord, run_kitti_task
from benchmarks.paper.published import (
    SEQUENCES,
    simulation_figures,
    simulation_quartiles,
    simulation_runs,
)
from benchmarks.paper.relative import MotionSizes, sizes_of_kitti, sizes_of_runs
from benchmarks.paper.statistics import E_AR, E_AT, group, Groups, summarise
from benchmarks.paper.store import ResultStore, write_rows
from benchmarks.paper.tasks import (
    Cell,
    HARDEST,
    PAPER_SOLVERS,
    published_tasks,
    Record,
    run_task,
    simulated_tasks,
    Task,
)
from trajectory_calibration.config.yaml_file import write_text
from trajectory_calibration.errors import ConfigError, ResultError
from trajectory_calibration.executor import Executor
from trajectory_calibration.solvers import SOLVER_NAMES

TRAJECTORIES = ('simulated', 'published', 'both')
SUMMARY_FILE = 'summary.md'

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class PaperBenchmark:
    """What to run, and where to put it.

    Attributes
    ----------
    output : folder of the results; a run that was cut off continues there.
    data : folder of the published data, or None.
    trajectories : 'simulated', 'published' (needs the data) or 'both'.
    runs : simulated runs of each condition.
    seed : seed of the first of them; the others follow.
    solvers : names.
    executor : where to compute.
    command : what was typed, for the summary.

    """

    output: Path
    data: Path | None = None
    trajectories: str = 'simulated'
    runs: int = 38
    seed: int = 0
    solvers: tuple[str, ...] = SOLVER_NAMES
    executor: Executor = field(default_factory=Executor)
    command: str = 'python -m benchmarks.paper'

    def __post_init__(self) -> None:
        if self.trajectories not in TRAJECTORIES:
            raise ConfigError(f'trajectories {self.trajectories!r} are unknown; needed one of '
                              f'{", ".join(TRAJECTORIES)}')
        if self.trajectories != 'simulated' and self.data is None:
            raise ConfigError(f'trajectories are {self.trajectories}, but no --data names the '
                              'folder of the published data')
        if self.runs < 1 or self.seed < 0:
            raise ConfigError(f'runs are {self.runs} from the seed {self.seed}; needed at least '
                              'one, from a seed of 0 or more')
        unknown = [name for name in self.solvers if name not in SOLVER_NAMES]
        if unknown or not self.solvers:
            raise ConfigError(f'solvers {", ".join(unknown) or "(none)"} are unknown; needed some '
                              f'of {", ".join(SOLVER_NAMES)}')

    @property
    def sources(self) -> tuple[str, ...]:
        """Return where the trajectories come from."""
        return TRAJECTORIES[:2] if self.trajectories == 'both' else (self.trajectories,)

    def tasks(self) -> list[Task]:
        """Return everything that is to be computed."""
        tasks: list[Task] = []
        if 'simulated' in self.sources:
            tasks += simulated_tasks(self.runs, self.seed, self.solvers)
        if 'published' in self.sources and self.data is not None:
            tasks += published_tasks(simulation_runs(self.data), self.solvers)
        return tasks


@dataclass(frozen=True)
class Work:
    """What a call computed: new tasks, of how many in all, and its time in seconds."""

    computed: int
    tasks: int
    cpu_s: float
    wall_s: float


def run_paper(benchmark: PaperBenchmark, progress: Progress) -> Path:
    """Compute what is missing, then write tables, figures and the summary.

    Parameters
    ----------
    benchmark : PaperBenchmark
        What to run.
    progress : function
        Told the tasks that are done and how many there are.

    Returns
    -------
    Path
        The summary, Markdown.

    Raises
    ------
    ConfigError
        A library for the tasks or the figures is not installed.
    ResultError
        The folder cannot be written or holds something else.
    SourceError
        The published data cannot be read.

    """
    # Before the work, not after it: what it is to end in.
    draw_all = _load_figures()
    tasks = benchmark.tasks()
    records, work = _compute(benchmark, tasks, progress)
    groups = group(records)
    kitti = _run_kitti(benchmark)
    sizes = {source: sizes_of_runs(source, tasks) for source in benchmark.sources}
    drives = [] if benchmark.data is None else sizes_of_kitti(benchmark.data)
    names = [name for source in benchmark.sources for name in draw_all(
        benchmark.output / 'figures', groups, source, benchmark.solvers, sizes[source] + drives)]
    _write_tables(benchmark.output, groups, kitti, [*chain(*sizes.values()), *drives])
    text = _introduction(benchmark, work)
    text += _simulations(benchmark, groups, names)
    if benchmark.data is not None:
        text += _beside_published(benchmark, benchmark.data, records, groups)
    if kitti:
        text += _kitti_chapter(kitti)
    summary = benchmark.output / SUMMARY_FILE
    write_text(summary, text, ResultError)
    return summary


def _load_figures() -> Callable[..., list[str]]:
    try:
        from benchmarks.paper.figures import draw_all
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"{error.name} is not installed; pip install -e '.[fleet,plot]'"
        ) from error
    return draw_all


def _compute(
    benchmark: PaperBenchmark, tasks: Sequence[Task], progress: Progress,
) -> tuple[list[Record], Work]:
    """Run the tasks that have no results yet; return all records of the tasks."""
    start = time.perf_counter()
    store = ResultStore(benchmark.output)
    missing = store.missing(tasks)
    cpu_s = 0.0
    for done, result in enumerate(in_order(benchmark.executor, run_task, missing), 1):
        store.append(result.records)
        cpu_s += result.cpu_s
        progress(len(tasks) - len(missing) + done, len(tasks))
    work = Work(len(missing), len(tasks), cpu_s, time.perf_counter() - start)
    return store.select(tasks), work


def _run_kitti(benchmark: PaperBenchmark) -> list[KittiRecord]:
    if benchmark.data is None:
        return []
    tasks = kitti_tasks(benchmark.data, benchmark.solvers)
    found = in_order(benchmark.executor, run_kitti_task, tasks)
    return list(chain.from_iterable(found))


def _write_tables(
    folder: Path, groups: Groups, kitti: list[KittiRecord], sizes: list[MotionSizes],
) -> None:
    write_rows(folder / 'summary.csv', summarise(groups))
    write_rows(folder / 'motions.csv', sizes)
    if kitti:
        write_rows(folder / 'kitti.csv', kitti)


def _introduction(benchmark: PaperBenchmark, work: Work) -> str:
    first, last = benchmark.seed, benchmark.seed + benchmark.runs - 1
    seeds = (f'simulator seeds {first} to {last}' if 'simulated' in benchmark.sources
             else 'published trajectories only')
    return (
        '# The paper, repeated\n\n'
        f'    {benchmark.command}\n\n'
        f'- {describe_machine()}; {describe_executor(benchmark.executor)}\n'
        f'- {describe_versions()}\n'
        f'- {seeds}; solvers {", ".join(benchmark.solvers)}\n'
        f'- {work.computed} of {work.tasks} runs computed in this call: {work.wall_s:.0f} s by '
        f'the clock, {work.cpu_s:.0f} s of processor time\n')


def _simulations(benchmark: PaperBenchmark, groups: Groups, figures: Sequence[str]) -> str:
    text = '\n## Conclusions of the paper\n\n'
    text += 'Medians over the runs at the hardest level of each class.\n\n'
    text += tables.claims_table({
        source: judge(groups, source, benchmark.solvers) for source in benchmark.sources})
    for source in benchmark.sources:
        text += f'\n## Medians, {source} trajectories\n'
        for kind, level in HARDEST.items():
            at = '' if kind == 'mixture' else f' {level:g}'
            text += f'\n{kind}{at}:\n\n'
            text += tables.medians_table(groups, source, benchmark.solvers, kind)
    text += '\n## Figures\n\n'
    return text + ''.join(f'![{name}](figures/{name}.png)\n\n' for name in figures)


def _beside_published(
    benchmark: PaperBenchmark, data: Path, records: Sequence[Record], groups: Groups,
) -> str:
    text = ''
    solvers = [name for name in PAPER_SOLVERS if name in benchmark.solvers]
    quartiles = simulation_quartiles(data)
    if 'published' in benchmark.sources:
        text += '\n## Published trajectories, run by run\n\n'
        text += tables.agreement_table(compare_runs(records, simulation_figures(data)))
    if 'published' in benchmark.sources and 'ali' in solvers:
        medians = {
            Cell('published', kind, level, solver, reference): (values[1, E_AT], values[1, E_AR])
            for (kind, level, solver, reference), values in quartiles.items()}
        text += '\n## Ali: ours, and the published rows with a wrong quaternion scaling\n\n'
        text += tables.ali_table(groups, medians)
    if 'simulated' in benchmark.sources:
        rows = compare_with_quartiles(groups, quartiles, solvers)
        text += '\n## Simulated medians in the published quartiles of all 38 runs\n\n'
        text += tables.quartiles_table(rows)
        text += '\nOutside, of dnl and dnlo:\n\n'
        text += tables.outside_table(rows, ('dnl', 'dnlo'))
    return text


def _kitti_chapter(records: Sequence[KittiRecord]) -> str:
    text = '\n## KITTI\n\n' + tables.kitti_agreement(records)
    for sequence in SEQUENCES:
        text += f'\n### {sequence}: ours (published)\n\n'
        text += tables.kitti_table(records, sequence)
        text += f'\n### {sequence}: along and across the axis that it determines least\n\n'
        text += tables.kitti_axes_table(records, sequence)
    return text
