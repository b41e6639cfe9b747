# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What is computed: one run of one condition, by all solvers at all references.

The association is made once for a run and the motions once for a reference, so that what is left
is the solvers' own time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from time import process_time, thread_time
from typing import Any, NamedTuple

import numpy as np

from benchmarks.paper.published import PublishedRun
from trajectory_calibration.assessment.metrics import absolute_errors, relative_errors
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.motion_pairs import MotionPairs, select_motions
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import CalibrationError
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.simulation import paper_scenario, simulate
from trajectory_calibration.solvers import load_solver
from trajectory_calibration.time_alignment.pairing import associate_by_interpolation

PAPER_SOLVERS = ('ali', 'park', 'taylor', 'zhuang', 'dnl', 'dnlo')
REFERENCES = ('A', 'B1', 'B5', 'B10', 'C5', 'C10')

# A solver without a reference has one row for a run. Its relative errors, which need motions to
# be errors of, are those over the motions of one reference.
REFERENCE_FREE = ('drift_aware',)
NO_REFERENCE = '-'
_MOTIONS_WITHOUT_REFERENCE = 'B5'

# Classes of noise with their levels: standard deviation (m; rotation 2 rad/m), jumps in each
# trajectory, metres of drift per metre. The mixture has one level: 0.005, 5 and 0.025.
LEVELS: dict[str, tuple[float, ...]] = {
    'noise': (0.0, 0.002, 0.004, 0.006, 0.008, 0.01),
    'outliers': (0.0, 2.0, 4.0, 6.0, 8.0, 10.0),
    'drift': (0.0, 0.01, 0.02, 0.03, 0.04, 0.05),
    'mixture': (0.0,),
}
HARDEST = {kind: levels[-1] for kind, levels in LEVELS.items()}

# The paper's program and its stated c.
SETTINGS: dict[str, Any] = {'dnlo_c': 0.01, 'dnlo_method': 'ipopt'}


class Cell(NamedTuple):
    """A group of runs that are averaged: a condition, a solver, a reference."""

    source: str
    kind: str
    level: float
    solver: str
    reference: str


@dataclass(frozen=True)
class Record:
    """One calibration. The fields are the columns of the results file.

    Errors are NaN where the solver gave no answer; ``note`` then says why. ``cpu_ms`` is the time
    of the solver alone, of one thread.
    """

    source: str
    kind: str
    level: float
    run: int
    solver: str
    reference: str
    e_rt_m: float
    e_rR_deg: float
    e_at_m: float
    e_aR_deg: float
    cpu_ms: float
    note: str = ''

    @property
    def cell(self) -> Cell:
        """Return the group it is counted in."""
        return Cell(self.source, self.kind, self.level, self.solver, self.reference)

    @property
    def errors(self) -> tuple[float, float, float, float]:
        """Return the four errors in the order of ``published.ERRORS``."""
        return self.e_rt_m, self.e_rR_deg, self.e_at_m, self.e_aR_deg


@dataclass(frozen=True)
class Task:
    """One run of one condition, and the solvers to try on it.

    Attributes
    ----------
    source : 'simulated' or 'published'.
    kind, level : the condition.
    run : seed of the simulator, or number of the published run.
    solvers : names.
    files : the published run, or None to simulate.

    """

    source: str
    kind: str
    level: float
    run: int
    solvers: tuple[str, ...]
    files: PublishedRun | None = None

    def load(self) -> tuple[Trajectory, Trajectory, FloatArray]:
        """Return the trajectories of a and b and the true (4, 4) pose of b in a."""
        if self.files is not None:
            return self.files.load()
        pair = simulate(paper_scenario(**_noise(self.kind, self.level)), self.run)
        return pair.a, pair.b, pair.T_a_b


class TaskResult(NamedTuple):
    """Records of a task and the processor time, in seconds, that it took in all."""

    records: list[Record]
    cpu_s: float


def simulated_tasks(runs: int, seed: int, solvers: Sequence[str]) -> list[Task]:
    """Return the paper's conditions with simulator seeds ``seed`` to ``seed + runs - 1``."""
    return [Task('simulated', kind, level, run, tuple(solvers))
            for kind, levels in LEVELS.items() for level in levels
            for run in range(seed, seed + runs)]


def published_tasks(runs: Iterable[PublishedRun], solvers: Sequence[str]) -> list[Task]:
    """Return one task for each published run."""
    return [Task('published', item.kind, item.level, item.run, tuple(solvers), item)
            for item in runs]


def references_of(solver: str) -> tuple[str, ...]:
    """Return the references that a solver is tried at."""
    return (NO_REFERENCE,) if solver in REFERENCE_FREE else REFERENCES


def run_task(task: Task) -> TaskResult:
    """Calibrate one run by every solver of the task at every reference."""
    start = process_time()
    a, b, T_a_b_true = task.load()
    pairs = associate_by_interpolation(a, b, max_gap_ns=None)
    records = []
    motions = {reference: select_motions(pairs, reference) for reference in REFERENCES}
    motions[NO_REFERENCE] = motions[_MOTIONS_WITHOUT_REFERENCE]
    for solver in task.solvers:
        for reference in references_of(solver):
            errors, cpu_ms, note = solve(solver, motions[reference], T_a_b_true)
            records.append(Record(
                task.source, task.kind, task.level, task.run, solver, reference, *errors,
                cpu_ms, note))
    return TaskResult(records, process_time() - start)


def solve(
    solver: str, motions: MotionPairs, T_a_b_true: FloatArray,
) -> tuple[tuple[float, float, float, float], float, str]:
    """Return the four errors (m, deg, m, deg), the milliseconds of the solver, and a note."""
    config = CalibrationConfig(solver=solver, **SETTINGS)
    function = load_solver(solver)
    start = thread_time()
    try:
        T_a_b = function(motions, config).T_a_b
    except CalibrationError as error:
        nan = float('nan')
        return (nan, nan, nan, nan), 1e3 * (thread_time() - start), str(error)
    cpu_ms = 1e3 * (thread_time() - start)
    relative, absolute = relative_errors(T_a_b, motions), absolute_errors(T_a_b, T_a_b_true)
    errors = (relative.e_rt, float(np.rad2deg(relative.e_rR)),
              absolute.e_at, float(np.rad2deg(absolute.e_aR)))
    return errors, cpu_ms, ''


def _noise(kind: str, level: float) -> dict[str, Any]:
    """Return the arguments of ``paper_scenario`` for a condition."""
    if kind == 'mixture':
        return {'white': 0.005, 'jumps': 5, 'drift': 0.025}
    name = {'noise': 'white', 'outliers': 'jumps', 'drift': 'drift'}[kind]
    return {name: int(level) if name == 'jumps' else level}
