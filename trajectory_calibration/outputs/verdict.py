# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether a person may use an answer, in one word, one sentence and one next step."""

from __future__ import annotations

from typing import NamedTuple

from trajectory_calibration.assessment.observability import UNOBSERVED, WEAK
from trajectory_calibration.outputs.answer import answer_rows, Row, status_sentence, worst_status
from trajectory_calibration.result import CalibrationResult

GOOD, CARE, OPEN, FAILED = 'good', 'care', 'open', 'failed'
TITLES = {GOOD: 'Usable', CARE: 'Usable with care', OPEN: 'Incomplete', FAILED: 'No answer'}

# Level of findings that may make an answer wrong.
SERIOUS = 'serious'


class Verdict(NamedTuple):
    """The judgement of a result.

    ``level`` is 'good', 'care', 'open' (a direction is unknown) or 'failed'; ``sentence`` says
    what is good and what is not, ``next_step`` what to do now.
    """

    level: str
    sentence: str
    next_step: str


def judge(result: CalibrationResult, rows: tuple[Row, ...] | None = None) -> Verdict:
    """Return the verdict on a result."""
    rows = rows or answer_rows(result)
    worst = worst_status(rows)
    sentence = status_sentence(rows)
    # The name of an axis has no capital.
    if sentence[1] not in ', ':
        sentence = sentence[0].upper() + sentence[1:]
    # Those of directions have a mark of their own.
    serious = [found.text for found in result.findings
               if found.level == SERIOUS and not found.code.startswith('direction-')]
    if worst == UNOBSERVED:
        return Verdict(OPEN, sentence, _advice(result, 'direction-unobserved'))
    if serious:
        return Verdict(CARE, f'{sentence}, but check the data first', serious[0])
    if worst == WEAK:
        return Verdict(CARE, sentence, _advice(result, 'direction-weak'))
    return Verdict(
        GOOD, sentence, 'Copy the transform below. Check it on another drive: '
        'trajectory_calibration verify result.yaml A B')


def _advice(result: CalibrationResult, code: str) -> str:
    """Return what the findings say of the directions of this kind, and what to do."""
    texts = [found.text for found in result.findings if found.code == code]
    return '; '.join(texts) or 'drive curves, and a ramp or a bank'
