# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Our figures beside the published ones: run by run, and class by class."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.paper.statistics import E_AR, E_AT, Groups, quartiles
from benchmarks.paper.tasks import Cell, HARDEST, PAPER_SOLVERS, Record, REFERENCES
from trajectory_calibration.geometry.se3 import FloatArray

# Two errors agree when they differ by less than this share, or by less than rounding of the
# published files explains where the error is zero: metres, degrees.
AGREEMENT = 1e-3
_NOTHING = np.array([1e-6, 1e-4])

# A median inside the quartiles is one that is not zero in both.
_ZERO_M, _ZERO_DEG = 1e-6, 1e-4

_ABSOLUTE = [E_AT, E_AR]


@dataclass(frozen=True)
class Agreement:
    """How the absolute errors of a solver at a reference compare, over all conditions and runs.

    ``agree`` counts runs whose both errors agree; of the others, ``lower`` have the lower
    translation error with us and ``higher`` with the paper. The medians of e_at are over all
    runs of all levels above zero.
    """

    solver: str
    reference: str
    runs: int
    agree: int
    lower: int
    higher: int
    median_e_at_m: float
    published_median_e_at_m: float


@dataclass(frozen=True)
class Inside:
    """Our median beside the published quartiles of the same cell."""

    kind: str
    level: float
    solver: str
    reference: str
    error: str
    q25: float
    median: float
    q75: float
    ours: float
    inside: bool


def compare_runs(
    records: Iterable[Record],
    published: Mapping[tuple[str, float, int, str, str], FloatArray],
) -> list[Agreement]:
    """Compare the records of published trajectories with the published errors."""
    pairs: dict[tuple[str, str], list[tuple[bool, FloatArray, FloatArray]]] = {}
    for item in records:
        key = item.kind, item.level, item.run, item.solver, item.reference
        if item.source == 'published' and key in published:
            noisy = item.level > 0 or item.kind == 'mixture'
            pairs.setdefault((item.solver, item.reference), []).append(
                (noisy, np.array(item.errors)[_ABSOLUTE], published[key][_ABSOLUTE]))
    rows = []
    for (solver, reference), values in pairs.items():
        disturbed = np.array([value[0] for value in values])
        ours, theirs = (np.array([value[k] for value in values]) for k in (1, 2))
        same = (np.abs(ours - theirs) <= np.maximum(AGREEMENT * theirs, _NOTHING)).all(axis=1)
        lower = ours[:, 0] < theirs[:, 0]
        rows.append(Agreement(
            solver, reference, len(values), int(same.sum()), int((~same & lower).sum()),
            int((~same & ~lower).sum()), quartiles(ours[disturbed, 0])[1],
            quartiles(theirs[disturbed, 0])[1]))
    return sorted(rows, key=lambda row: (
        PAPER_SOLVERS.index(row.solver), REFERENCES.index(row.reference)))


def compare_with_quartiles(
    groups: Groups, published: Mapping[tuple[str, float, str, str], FloatArray],
    solvers: Iterable[str],
) -> list[Inside]:
    """Place our simulated medians in the published quartiles, at every level with noise."""
    rows = []
    for (kind, level, solver, reference), theirs in published.items():
        cell = Cell('simulated', kind, level, solver, reference)
        if solver not in solvers or cell not in groups:
            continue
        for name, error, zero in (('e_at_m', E_AT, _ZERO_M), ('e_aR_deg', E_AR, _ZERO_DEG)):
            q25, median, q75 = theirs[:, error].tolist()
            if q75 < zero:
                continue
            values = groups[cell][:, error]
            ours = quartiles(values[np.isfinite(values)])[1]
            rows.append(Inside(kind, level, solver, reference, name, q25, median, q75, ours,
                               q25 <= ours <= q75))
    return rows


def at_hardest_level(rows: Iterable[Inside]) -> list[Inside]:
    """Return the rows of the hardest level of each class."""
    return [row for row in rows if row.level == HARDEST[row.kind]]
