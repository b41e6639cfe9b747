# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from benchmarks.paper.claims import Claim
from benchmarks.paper.comparison import Agreement, at_hardest_level, Inside
from benchmarks.paper.kitti import KittiRecord, PUBLISHED_C, STATED_C
from benchmarks.paper.published import SEQUENCES
from benchmarks.paper.statistics import E_AR, E_AT, Groups, median_of
from benchmarks.paper.tasks import Cell, HARDEST, PAPER_SOLVERS, REFERENCES, references_of

_NONE = '-'


def markdown(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table; cells that are no text are shown by ``str``."""
    lines = [header, ['---'] * len(header), *rows]
    return ''.join(f'| {" | ".join(map(str, line))} |\n' for line in lines)


def claims_table(columns: dict[str, list[Claim]]) -> str:
    """Return the verdicts of each source side by side, with the evidence below."""
    first = next(iter(columns.values()))
    verdicts = markdown(
        ['claim of the paper', *columns],
        [[claim.statement, *(found[k].verdict for found in columns.values())]
         for k, claim in enumerate(first)])
    evidence = [f'\n**{claim.statement}.**\n' + ''.join(
        f'- {name}: {found[k].evidence}.\n' for name, found in columns.items())
        for k, claim in enumerate(first)]
    return verdicts + ''.join(evidence)


def medians_table(groups: Groups, source: str, solvers: Sequence[str], kind: str) -> str:
    """Return median e_at and e_aR of solvers and references at the hardest level of a class."""
    rows = []
    for solver in solvers:
        row = [solver]
        # A solver without references has one number, which stands for all.
        names = references_of(solver)
        for reference in REFERENCES:
            name = reference if reference in names else names[0]
            cell = Cell(source, kind, HARDEST[kind], solver, name)
            e_at, e_aR = (median_of(groups, cell, error) for error in (E_AT, E_AR))
            row.append(_pair(1e3 * e_at, e_aR))
        rows.append(row)
    return markdown(['mm / °', *REFERENCES], rows)


def agreement_table(rows: Sequence[Agreement]) -> str:
    """Return the comparison run by run."""
    return markdown(
        ['solver', 'reference', 'runs', 'agree', 'ours lower', 'ours higher',
         'median e_at, ours', 'published'],
        [[row.solver, row.reference, row.runs, f'{row.agree / row.runs:.1%}', row.lower,
          row.higher, f'{1e3 * row.median_e_at_m:.2f} mm',
          f'{1e3 * row.published_median_e_at_m:.2f} mm'] for row in rows])


def ali_table(groups: Groups, published: dict[Cell, tuple[float, float]]) -> str:
    """Return our medians of ``ali`` over the published ones, at the hardest levels."""
    rows = []
    for kind, level in HARDEST.items():
        ours, theirs = [f'{kind}, ours'], [f'{kind}, published']
        for reference in REFERENCES:
            cell = Cell('published', kind, level, 'ali', reference)
            ours.append(_pair(1e3 * median_of(groups, cell, E_AT), median_of(groups, cell, E_AR)))
            e_at, e_aR = published[cell]
            theirs.append(_pair(1e3 * e_at, e_aR))
        rows += [ours, theirs]
    return markdown(['mm / °', *REFERENCES], rows)


def quartiles_table(rows: Sequence[Inside]) -> str:
    """Return how many of our medians lie inside the published quartiles, and those that do not."""
    counts = []
    for solver in PAPER_SOLVERS:
        for error in ('e_at_m', 'e_aR_deg'):
            of_all = [row for row in rows if (row.solver, row.error) == (solver, error)]
            if of_all:
                hardest = at_hardest_level(of_all)
                counts.append([solver, error,
                               f'{sum(row.inside for row in hardest)} of {len(hardest)}',
                               f'{sum(row.inside for row in of_all)} of {len(of_all)}'])
    return markdown(['solver', 'error', 'inside at the hardest levels', 'inside at all levels'],
                    counts)


def outside_table(rows: Sequence[Inside], solvers: Sequence[str]) -> str:
    """Return the medians of solvers that are outside the published quartiles."""
    return markdown(
        ['class', 'level', 'solver', 'reference', 'error',
         'published quartiles', 'published median', 'ours'],
        [[row.kind, f'{row.level:g}', row.solver, row.reference, row.error,
          f'{row.q25:.4g} to {row.q75:.4g}', f'{row.median:.4g}', f'{row.ours:.4g}']
         for row in rows if row.solver in solvers and not row.inside])


def kitti_table(records: Sequence[KittiRecord], sequence: str) -> str:
    """Return the paper's table of a drive: ours, then the published value in brackets."""
    rows = []
    for record in _ordered(records, sequence):
        base = next(item for item in records if (
            item.sequence, item.solver, item.dnlo_c, item.reference) == (
            sequence, record.solver, record.dnlo_c, 'B1'))
        better = [f'{100 * (1 - mine / first):+.0f} %' for mine, first in (
            (record.e_at_m, base.e_at_m), (record.e_aR_deg, base.e_aR_deg))]
        if record.reference == 'B1':
            better = [_NONE, _NONE]
        errors = [f'{mine:.3f} ({theirs:.3f})'
                  for mine, theirs in zip(record.errors, record.published, strict=True)]
        rows.append([_label(record), record.reference, *errors, *better])
    return markdown(['solver', 'ref.', 'e_rt m', 'e_rR °', 'e_at m', 'e_aR °',
                     'e_at against B1', 'e_aR against B1'], rows)


def kitti_axes_table(records: Sequence[KittiRecord], sequence: str) -> str:
    """Return the translation error along and across the weak axis, by both truths."""
    corrected = sequence == SEQUENCES[1]
    header = ['solver', 'ref.', 'e_at m', 'along', 'across']
    if corrected:
        header += ['corrected e_at m', 'along', 'across', 'corrected e_aR °']
    rows = []
    for record in _ordered(records, sequence):
        numbers = [record.e_at_m, record.along_m, record.across_m]
        if corrected:
            numbers += [record.corrected_e_at_m, record.corrected_along_m,
                        record.corrected_across_m, record.corrected_e_aR_deg]
        rows.append([_label(record), record.reference, *(f'{number:.3f}' for number in numbers)])
    return markdown(header, rows)


def kitti_agreement(records: Sequence[KittiRecord]) -> str:
    """Return in one sentence how far the tables are from the published ones."""
    same = [item for item in records if item.solver != 'dnlo' or item.dnlo_c == PUBLISHED_C]
    off = np.abs([np.subtract(item.errors, item.published) for item in same])
    close = int(np.sum((off[:, E_AT] <= 1e-3) & (off[:, E_AR] <= 5e-3)))
    return (f'{close} of {len(same)} pairs of e_at and e_aR are within 0.001 m and 0.005° of the '
            f'published ones; the largest differences are {off[:, E_AT].max():.1g} m and '
            f'{off[:, E_AR].max():.1g}°.\n')


def _ordered(records: Sequence[KittiRecord], sequence: str) -> list[KittiRecord]:
    return sorted(
        (item for item in records if item.sequence == sequence),
        key=lambda item: (PAPER_SOLVERS.index(item.solver), item.dnlo_c == STATED_C,
                          REFERENCES.index(item.reference)))


def _label(record: KittiRecord) -> str:
    return f'dnlo, c = {record.dnlo_c:g}' if record.solver == 'dnlo' else record.solver


def _pair(e_at_mm: float, e_aR_deg: float) -> str:
    # Without noise an error is rounding, and its digits mean nothing.
    return ' / '.join(
        _NONE if np.isnan(value) else '0' if value < 1e-4 else f'{value:.3g}'
        for value in (e_at_mm, e_aR_deg))
