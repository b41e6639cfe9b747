# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A saved result that waits until the frames of the vehicle are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from trajectory_calibration.result import CalibrationResult


@dataclass(frozen=True, eq=False)
class Restored:
    """A result of an earlier run.

    Attributes
    ----------
    path : its file.
    result : what it holds.

    """

    path: Path
    result: CalibrationResult

    @property
    def waiting(self) -> str:
        """Return what it waits for."""
        return (f'{self.path.name} is restored when poses of {self.result.frame_a} and '
                f'{self.result.frame_b} arrive, or frame_a and frame_b name them')

    def compare(self, frames: Sequence[str]) -> str | None:
        """Compare with the frames of the vehicle, '' for one that is not known yet.

        Returns
        -------
        str or None
            None where one is not known yet, '' where they are those of the result, and why it
            is refused where they are not.

        """
        wanted = self.result.frame_a, self.result.frame_b
        if any(frame and frame != expected
               for frame, expected in zip(frames, wanted, strict=True)):
            found = ' and '.join(frame or 'unknown' for frame in frames)
            return (f'not restored: {self.path} holds {wanted[0]} -> {wanted[1]}, the topics '
                    f'carry {found}; correct the topics, or calibrate again')
        return '' if all(frames) else None
