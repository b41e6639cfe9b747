# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Averages over runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.paper.published import ERRORS
from benchmarks.paper.tasks import Cell, Record
from trajectory_calibration.geometry.se3 import FloatArray

# Index of each error in the arrays below.
E_RT, E_RR, E_AT, E_AR = range(len(ERRORS))

# (runs, 4) errors of each cell, rows in the order of the runs; NaN where there is no answer.
Groups = Mapping[Cell, FloatArray]

_RESAMPLES = 2000


@dataclass(frozen=True)
class Summary:
    """A row of the summary file: one error of one cell over its runs.

    ``low`` and ``high`` bound the mean with 95 % confidence. ``failed`` runs have no answer and
    are left out of the numbers.
    """

    source: str
    kind: str
    level: float
    solver: str
    reference: str
    error: str
    runs: int
    failed: int
    mean: float
    low: float
    high: float
    q25: float
    median: float
    q75: float


def group(records: Iterable[Record]) -> dict[Cell, FloatArray]:
    """Return the errors of each cell, sorted by run."""
    rows: dict[Cell, list[tuple[int, tuple[float, ...]]]] = {}
    for record in records:
        rows.setdefault(record.cell, []).append((record.run, record.errors))
    return {cell: np.array([errors for _, errors in sorted(values)])
            for cell, values in rows.items()}


def summarise(groups: Groups) -> list[Summary]:
    """Return every error of every cell."""
    rows = []
    for cell, errors in groups.items():
        for k, name in enumerate(ERRORS):
            values = errors[:, k]
            values = values[np.isfinite(values)]
            low, high = mean_interval(values)
            q25, median, q75 = quartiles(values)
            rows.append(Summary(
                *cell, name, len(errors), len(errors) - len(values), mean(values), low, high,
                q25, median, q75))
    return rows


def mean(values: FloatArray) -> float:
    """Return the mean, NaN of nothing."""
    return float(values.mean()) if len(values) else float('nan')


def quartiles(values: FloatArray) -> tuple[float, float, float]:
    """Return the lower quartile, the median and the upper quartile, NaN of nothing."""
    if not len(values):
        return (float('nan'),) * 3
    q25, median, q75 = np.quantile(values, [0.25, 0.5, 0.75]).tolist()
    return q25, median, q75


def mean_interval(values: FloatArray) -> tuple[float, float]:
    """Return the interval that holds the mean with 95 % confidence.

    By the bootstrap (percentiles of the means of resampled runs, with a fixed seed), because the
    errors are far from normal and never negative.
    """
    if not len(values):
        return float('nan'), float('nan')
    picks = np.random.default_rng(0).integers(len(values), size=(_RESAMPLES, len(values)))
    low, high = np.quantile(values[picks].mean(axis=1), [0.025, 0.975]).tolist()
    return low, high


def median_of(groups: Groups, cell: Cell, error: int) -> float:
    """Return the median of one error of a cell; NaN where the cell is missing or has no answer."""
    values = groups.get(cell, np.full((0, len(ERRORS)), np.nan))[:, error]
    return quartiles(values[np.isfinite(values)])[1]


def mean_of(groups: Groups, cell: Cell, error: int) -> float:
    """Return the mean of one error of a cell; NaN where the cell is missing or has no answer."""
    values = groups.get(cell, np.full((0, len(ERRORS)), np.nan))[:, error]
    return mean(values[np.isfinite(values)])
