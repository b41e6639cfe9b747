# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether a person may use an answer, in one word, one sentence and one next step."""

from __future__ import annotations

from dataclasses import dataclass

from trajectory_calibration.assessment.observability import OBSERVED, PRIOR, UNOBSERVED, WEAK
from trajectory_calibration.outputs.answer import answer_rows, Row, status_sentence, worst_status
from trajectory_calibration.result import CalibrationResult

GOOD, CARE, OPEN, FAILED = 'good', 'care', 'open', 'failed'
TITLES = {GOOD: 'Usable', CARE: 'Usable with care', OPEN: 'Incomplete', FAILED: 'No answer'}

# Level of findings that may make an answer wrong.
SERIOUS = 'serious'


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
        return Verdict(OPEN, sentence, _advice(result, 'direction-unobserved'))
    if serious:
        return Verdict(CARE, f'{sentence}, but check the data first', serious[0])
    if worst == WEAK:
        return Verdict(CARE, sentence, _advice(result, 'direction-weak'))
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


def _advice(result: CalibrationResult, code: str) -> str:
    """Return what the findings say of the directions of this kind, and what to do."""
    texts = [found.text for found in result.findings if found.code == code]
    return '; '.join(texts) or 'drive curves, and a ramp or a bank'
