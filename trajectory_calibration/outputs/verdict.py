# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether a person may use an answer, in one word, one sentence and one next step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajectory_calibration.assessment.observability import OBSERVED, PRIOR, UNOBSERVED, WEAK
from trajectory_calibration.outputs.answer import answer_rows, Row, status_sentence, worst_status
from trajectory_calibration.result import CalibrationResult

GOOD, CARE, OPEN, FAILED = 'good', 'care', 'open', 'failed'
TITLES = {GOOD: 'Usable', CARE: 'Usable with care', OPEN: 'Incomplete', FAILED: 'No answer'}

# Level of findings that may make an answer wrong.
SERIOUS = 'serious'

# Weak by more than this many times the limit: no curve of the same drive will mend it.
_FAR = 3.0


@dataclass(frozen=True)
class Verdict:
    """The judgement of a result.

    Attributes
    ----------
    level : 'good', 'care', 'open' (a direction is unknown) or 'failed'.
    sentence : what is good and what is not.
    next_step : what to do now.

    """

    level: str
    sentence: str
    next_step: str

    @property
    def opening(self) -> str:
        """Return the sentence with a capital, unless it begins with the name of an axis."""
        word = self.sentence.partition(' ')[0].strip(',')
        return self.sentence if len(word) == 1 else word.capitalize() + self.sentence[len(word):]

    @property
    def title(self) -> str:
        """Return the level in words."""
        return TITLES[self.level]


def judge(result: CalibrationResult, rows: tuple[Row, ...] | None = None) -> Verdict:
    """Return the verdict on a result."""
    rows = rows or answer_rows(result)
    worst = worst_status(rows)
    sentence = status_sentence(rows)
    serious = serious_texts(result)
    if worst == UNOBSERVED:
        return Verdict(OPEN, sentence, _ways_out(rows))
    if serious:
        return Verdict(CARE, f'{sentence}, but check the data first', serious[0])
    if worst == WEAK:
        return Verdict(CARE, sentence, _stronger(rows))
    return Verdict(
        GOOD if worst in (OBSERVED, PRIOR) else CARE, sentence,
        'Copy the transform below. Check it on another drive: trajectory_calibration verify '
        'result.yaml A B')


def serious_texts(result: CalibrationResult) -> list[str]:
    """Return the texts of the findings that may make the answer wrong.

    Without those of its directions, which have a mark of their own.
    """
    return [found.text for found in result.findings
            if found.level == SERIOUS and not found.code.startswith('direction-')]


def _ways_out(rows: tuple[Row, ...]) -> str:
    """Name what determines the directions that the motion left open."""
    names = [row.name for row in rows if row.status == UNOBSERVED]
    listed = ', '.join(names)
    ways = []
    if set(names) & {'x', 'y', 'z'}:
        pattern = ','.join(
            name.upper() if name in names else '-' for name in ('x', 'y', 'z'))
        ways.append(f'measure {listed_of(names, "xyz")} and add --prior-translation={pattern} '
                    '--prior-translation-std=0.01')
    if set(names) & {'roll', 'pitch', 'yaw'}:
        ways.append('add --prior-rotation=ROLL,PITCH,YAW --prior-rotation-std=1')
    return (f'{listed}: drive {_motion(names)}, or {", or ".join(ways)}.')


def listed_of(names: list[str], wanted: str) -> str:
    """Return those of the names that are wanted: 'y, z'."""
    return ', '.join(name for name in names if name in wanted)


def _motion(names: list[str]) -> str:
    if names == ['z'] or not set(names) & {'x', 'y', 'z'}:
        return 'over a ramp or a bank' if names == ['z'] else 'curves and ramps'
    return 'curves, and over a ramp or a bank'


def _stronger(rows: tuple[Row, ...]) -> str:
    weak = [row for row in rows if row.status == WEAK]
    factor = max((row.std or np.inf) / max(row.weak_limit, 1e-9) for row in weak)
    how = 'tighter curves and steeper ramps' if factor > _FAR else 'more curves and ramps'
    names = ', '.join(row.name for row in weak)
    return (f'To improve {names}: record {how}. Longer of the same helps only with the square '
            'root of the time.')
