# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The paper's conclusions, judged one by one on a set of runs.

Every claim is judged on medians over the runs at the hardest level of a class, solver by solver:
medians because a few failed runs rule a mean. A solver without an answer that a claim compares has
no part in it; a claim that is left without solvers is not judged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.paper.statistics import E_AR, E_AT, E_RT, Groups, median_of
from benchmarks.paper.tasks import Cell, HARDEST, PAPER_SOLVERS, REFERENCES
from trajectory_calibration.geometry.se3 import FloatArray

HOLDS, PARTLY, FAILS, OPEN = 'holds', 'holds in part', 'does not hold', 'not judged'


@dataclass(frozen=True)
class Claim:
    """A conclusion of the paper and what the runs say to it."""

    statement: str
    verdict: str
    evidence: str


@dataclass(frozen=True)
class _Medians:
    """Median errors of one source at the hardest levels; NaN where no run has an answer."""

    groups: Groups
    source: str
    solvers: tuple[str, ...]

    def __call__(self, kind: str, solver: str, reference: str, error: int = E_AT) -> float:
        cell = Cell(self.source, kind, HARDEST[kind], solver, reference)
        return median_of(self.groups, cell, error)

    def table(self, kind: str, error: int = E_AT) -> FloatArray:
        """Return (solvers, references) medians."""
        return np.array([[self(kind, solver, reference, error) for reference in REFERENCES]
                         for solver in self.solvers])

    def best_references(self, kind: str, error: int = E_AT) -> dict[str, str]:
        """Return the reference of the lowest median of each solver, of those with an answer."""
        best = np.nanargmin(self.table(kind, error), axis=1)
        return {solver: REFERENCES[k] for solver, k in zip(self.solvers, best, strict=True)}

    def answering(self, claim: _Statement) -> _Medians:
        """Return those of the solvers that have an answer wherever the claim needs one."""
        return replace(self, solvers=tuple(
            solver for solver in self.solvers
            if all(self._answers(kind, solver, claim.references) for kind in claim.kinds)))

    def _answers(self, kind: str, solver: str, references: Iterable[str]) -> bool:
        found = {name for name in REFERENCES if np.isfinite(self(kind, solver, name))}
        return bool(found) and found.issuperset(references)


@dataclass(frozen=True)
class _Statement:
    """A conclusion of the paper and how to judge it.

    Attributes
    ----------
    text : the conclusion.
    kinds : classes of noise that it is about.
    references : those that a solver must have an answer at: what is the best or the worst of
        one is nothing. Any where none is named.
    check : returns the verdict and the evidence.

    """

    text: str
    kinds: tuple[str, ...]
    references: tuple[str, ...]
    check: Callable[[_Medians], tuple[str, str]]


def judge(groups: Groups, source: str, solvers: Iterable[str]) -> list[Claim]:
    """Judge every claim on the runs of a source with those of the paper's solvers that ran."""
    medians = _Medians(
        groups, source, tuple(name for name in PAPER_SOLVERS if name in set(solvers)))
    every = tuple(HARDEST)
    return [_judge(medians, claim) for claim in (
        _Statement('Under white noise longer references are better',
                   ('noise',), ('B1', 'B5', 'B10', 'C5', 'C10'), _longer_under_noise),
        _Statement('The first pose as the only reference (A) is the worst',
                   every, ('A', 'B1'), _a_is_worst),
        _Statement('Under outliers B1 is best',
                   ('outliers',), ('B1', 'B5'), lambda m: _is_best(m, 'outliers', 'B1')),
        _Statement('Under the mixture B5 is best',
                   ('mixture',), ('B1', 'B5'), lambda m: _is_best(m, 'mixture', 'B5')),
        _Statement('Relative errors prefer B1 where absolute errors do not',
                   ('mixture',), ('B1', 'B5'), _relative_prefer_b1),
        _Statement('The choice of the reference matters more than that of the algorithm',
                   every, REFERENCES, _reference_matters_more),
        _Statement('DNLO is better under outliers, and elsewhere no worse than the others',
                   every, (), _dnlo_wins),
    )]


def _judge(medians: _Medians, claim: _Statement) -> Claim:
    if not medians.solvers or any(np.isnan(medians.table(kind)).all() for kind in HARDEST):
        return Claim(claim.text, OPEN, 'conditions are missing')
    answering = medians.answering(claim)
    if not answering.solvers:
        return Claim(claim.text, OPEN, 'no solver has all of the answers that it compares')
    verdict, evidence = claim.check(answering)
    left_out = [solver for solver in medians.solvers if solver not in answering.solvers]
    if left_out:
        evidence += f'; without all of the answers: {", ".join(left_out)}'
    return Claim(claim.text, verdict, evidence)


def _longer_under_noise(m: _Medians) -> tuple[str, str]:
    right = [s for s in m.solvers
             if m('noise', s, 'B10') < m('noise', s, 'B5') < m('noise', s, 'B1')
             and m('noise', s, 'C10') < m('noise', s, 'C5')]
    shown = m.solvers[-1]
    series = ', '.join(f'{name} {_mm(m("noise", shown, name))}'
                       for name in ('B1', 'B5', 'B10', 'C5', 'C10'))
    return _verdict(right, m), f'{_count(right, m)}; {shown}: {series}'


def _a_is_worst(m: _Medians) -> tuple[str, str]:
    counts = {kind: int(np.sum(np.nanargmax(m.table(kind), axis=1) == REFERENCES.index('A')))
              for kind in HARDEST}
    total = len(m.solvers)
    worst = sum(counts.values())
    verdict = HOLDS if worst == len(HARDEST) * total else FAILS if worst <= total else PARTLY
    return verdict, 'worst of six for ' + ', '.join(
        f'{count} of {total} solvers under {kind}' for kind, count in counts.items())


def _is_best(m: _Medians, kind: str, reference: str) -> tuple[str, str]:
    best = {E_AT: m.best_references(kind), E_AR: m.best_references(kind, E_AR)}
    right = [s for s in m.solvers if best[E_AT][s] == reference]
    evidence = f'{_count(right, m)} in translation'
    others = [f'{s} {name}' for s, name in best[E_AT].items() if name != reference]
    if others:
        evidence += f' (best of the others: {", ".join(others)})'
    turned = [s for s in m.solvers if best[E_AR][s] == reference]
    return _verdict(right, m), f'{evidence}, {_count(turned, m)} in rotation'


def _relative_prefer_b1(m: _Medians) -> tuple[str, str]:
    relative, absolute = m.best_references('mixture', E_RT), m.best_references('mixture', E_AT)
    right = [s for s in m.solvers if relative[s] == 'B1' != absolute[s]]
    x, y = (table[np.isfinite(table)] for table in (
        m.table('mixture', error) for error in (E_RT, E_AT)))
    rank = float(np.corrcoef(np.argsort(np.argsort(x)), np.argsort(np.argsort(y)))[0, 1])
    return _verdict(right, m), (
        f'{_count(right, m)} under the mixture; the ranks of both errors over all '
        f'{len(x)} combinations correlate with {rank:+.2f}')


def _reference_matters_more(m: _Medians) -> tuple[str, str]:
    parts, more = [], 0
    for kind in HARDEST:
        logs = np.log(m.table(kind))
        # Half of the solvers differ by less, and half of the references.
        by_reference = float(np.exp(np.median(np.ptp(logs, axis=1))))
        by_solver = float(np.exp(np.median(np.ptp(logs, axis=0))))
        more += by_reference > by_solver
        parts.append(f'{kind} {by_reference:.1f} against {by_solver:.1f}')
    verdict = {0: FAILS, len(HARDEST): HOLDS}.get(more, PARTLY)
    return verdict, 'worst over best reference against worst over best solver: ' + ', '.join(parts)


def _dnlo_wins(m: _Medians) -> tuple[str, str]:
    if 'dnlo' not in m.solvers or len(m.solvers) < 2:
        return OPEN, 'needs dnlo and another solver'
    k = m.solvers.index('dnlo')
    parts, wins = [], 0
    for kind in HARDEST:
        best = np.nanmin(m.table(kind), axis=1).tolist()
        other = min(best[:k] + best[k + 1:])
        # Two solvers that find the same minimum differ by rounding.
        wins += best[k] <= 1.001 * other
        parts.append(f'{kind} {_mm(best[k])} against {_mm(other)}')
    verdict = {0: FAILS, len(HARDEST): HOLDS}.get(wins, PARTLY)
    return verdict, 'best reference of each: ' + ', '.join(parts)


def _verdict(right: list[str], m: _Medians) -> str:
    return {0: FAILS, len(m.solvers): HOLDS}.get(len(right), PARTLY)


def _count(right: list[str], m: _Medians) -> str:
    return f'{len(right)} of {len(m.solvers)} solvers'


def _mm(metres: float) -> str:
    return f'{1e3 * metres:.3g} mm'
