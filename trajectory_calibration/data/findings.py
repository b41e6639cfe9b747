# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Findings about the data and the answer, with stable codes.

The code is stable and documented (docs/findings.md, a test compares), the text is for people, the
values are for programs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

# How much a finding matters, worst first.
LEVELS = ('serious', 'warning', 'note')

# Code -> (level, meaning). Codes never change their meaning; a new meaning is a new code.
CATALOGUE: dict[str, tuple[str, str]] = {
    'association-gaps': ('warning', 'many poses of one sensor fall in gaps of the other'),
    'association-outside': ('note', 'many poses of one sensor are before or after the other'),
    'bag-damaged': ('warning', 'a bag is damaged or incomplete; the intact messages were read'),
    'clock-ambiguous': ('serious', 'another clock offset fits as well; the extrinsic differs'),
    'clock-drift': ('note', 'one clock runs fast or slow; corrected'),
    'clock-offset': ('note', 'a clock offset was found and added to the stamps of b'),
    'clock-offset-unsteady': ('serious', 'a large clock offset that changes: two vehicles?'),
    'clock-uneven': ('warning', 'one clock deviates from a constant drift'),
    'direction-unobserved': ('serious', 'the motion does not determine this direction'),
    'direction-weak': ('warning', 'this direction is determined, but badly'),
    'extrinsic-unsteady': ('serious', 'the extrinsic, or the scale, changes during the drive'),
    'frame-renamed': ('note', 'a frame lost its leading slash, which tf2 refuses'),
    'frames-equal': ('warning', 'both sensors have the same frame name'),
    'half-turns': ('note', 'motions near half a turn were excluded, or kept as published'),
    'input-read-as': ('note', 'how an input was read if the file does not define it'),
    'input-repaired': ('note', 'the input was repaired, or part of it was dropped'),
    'length-unit': ('warning', 'implausibly fast motion: another unit of length?'),
    'minimum-not-proven': ('warning', 'the minimum is not proven to be the lowest'),
    'not-converged': ('warning', 'the solver stopped before it converged'),
    'orientation-jumps': ('warning', 'the orientation of one sensor jumps'),
    'orientations-identical': ('serious', 'both sensors report the same orientation'),
    'other': ('warning', 'a finding of another version, or of a solver from another package'),
    'pose-jumps': ('note', 'pose jumps were found and excluded'),
    'position-latency': ('note', 'the position of one sensor is late; corrected'),
    'poses-held': ('note', 'poses that repeat an old measurement were dropped'),
    'poses-identical': ('serious', 'both sensors report the same poses'),
    'poses-lost': ('note', 'poses were dropped: the SLAM had lost tracking'),
    'prior-contradicts': ('serious', 'the prior is far from the answer of the motion'),
    'quaternion-order': ('warning', 'the quaternions may have w first'),
    'recording-other': ('serious', 'the trajectories of a report are not those of the result'),
    'rig-clock': ('warning', 'the stamps of one sensor are late or early; corrected'),
    'rig-contradiction': ('serious', 'one sensor contradicts the others'),
    'rig-groups': ('warning', 'groups of sensors share no motion; each is calibrated separately'),
    'rig-loops': ('warning', 'loops of sensors do not close within the standard deviations'),
    'rig-mount-moved': ('serious', 'a sensor moved on its mount during the drive'),
    'rig-no-common-time': ('serious', 'a sensor has no common time with the others'),
    'rig-other-motion': ('serious', 'a sensor does not move as the others do'),
    'rig-result-repeated': ('note', 'several saved results of one pair: the latest was used'),
    'rig-result-unread': ('warning', 'a file beside saved results could not be read as one'),
    'rig-shared-noise': ('note', 'from saved results: the correlation of pairs is assumed'),
    'scale': ('note', 'the two trajectories differ in scale; corrected'),
    'scale-unit': ('note', 'b is in another unit of length; its scale was found'),
    'short-drive': ('warning', 'too short for the errors of a SLAM to show'),
    'stamps-are-numbers': ('warning', 'the times may be frame numbers'),
    'stamps-unpadded': ('note', 'times were written as sec.nsec without leading zeros; repaired'),
    'systematic-drift': ('note', 'one trajectory has a systematic drift; corrected'),
    'time-unit': ('warning', 'implausible time steps: another unit of time?'),
    'uncorrected': ('warning', 'a scale, drift or clock offset that this solver cannot correct'),
    'worlds-differ': ('serious', 'positions and orientations of one sensor are in two worlds'),
    'zhuang-large-rotation': ('note', 'the chosen solver is inaccurate at large rotations'),
}


@dataclass(frozen=True)
class Finding:
    """One thing that was found.

    Attributes
    ----------
    code : a key of ``CATALOGUE``: kebab case, stable.
    text : one or two lines for a person: what, why it matters, what to do.
    values : the numbers of the text for programs, units in the names: ``{'largest_m': 0.31}``.

    """

    code: str
    text: str
    values: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.code not in CATALOGUE:
            raise KeyError(f'finding {self.code!r} is not in the catalogue of data/findings.py')

    def __str__(self) -> str:
        return self.text

    @property
    def level(self) -> str:
        """Return 'serious' (may make the answer wrong), 'warning' or 'note'."""
        return CATALOGUE[self.code][0]

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON or YAML."""
        return {'code': self.code, 'level': self.level, 'text': self.text,
                'values': dict(self.values)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Finding:
        """Rebuild from ``to_dict``; a code of another version becomes 'other'."""
        code = str(data['code'])
        return cls(code if code in CATALOGUE else 'other', str(data['text']),
                   dict(data.get('values') or {}))


def worst_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings by level, in their own order within a level."""
    return tuple(sorted(findings, key=lambda found: LEVELS.index(found.level)))


def texts(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Return the sentences alone."""
    return tuple(found.text for found in findings)
