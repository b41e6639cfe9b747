# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A buffer for each sensor and what is calibrated from them: what the node and a replay share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import re
from typing import NamedTuple

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.errors import CalibrationError
from trajectory_calibration.online.buffer import BufferLimits, PoseBuffer
from trajectory_calibration.online.overlay import make_overlay, Overlay
from trajectory_calibration.online.track import Track
from trajectory_calibration.outputs.placement import Placement
from trajectory_calibration.pipeline import calibrate
from trajectory_calibration.result import CalibrationResult


class Calibration(NamedTuple):
    """An answer, and the tracks it was found from for a person to look at."""

    result: CalibrationResult
    overlay: Overlay

    @property
    def refusal(self) -> str:
        """Return why the node does not publish it and what to do, '' where it does.

        It keeps back an answer with a direction that neither the motion nor a prior determined,
        unless ``allow_unobserved``. The text ends with what was refused of the tracks.
        """
        unknown = Placement.of(self.result).kept_back
        notes = [found.text for found in self.result.findings if found.code == 'input-repaired']
        return unknown and '; '.join([
            f'not published: {unknown} unobservable. {_way_out(self.result)}', *notes])


@dataclass(frozen=True, eq=False)
class CalibrationJob:
    """Everything that one calibration needs, copied at the moment it was asked for."""

    track_a: Track
    track_b: Track
    config: CalibrationConfig

    def run(self) -> Calibration:
        """Calibrate; a CalibrationError ends with what was refused of the tracks."""
        try:
            a, b = self.track_a.trajectory(), self.track_b.trajectory()
            result = calibrate(a, b, self.config)
            return Calibration(result, make_overlay(a, b, result))
        except CalibrationError as error:
            # What was refused may be why.
            notes = [note for note in (*self.track_a.warnings, *self.track_b.warnings)
                     if note not in str(error)]
            raise type(error)('; '.join([str(error), *notes])) from error


class CalibrationSession:
    """The poses of the sensors since the last reset; the first sensor is the parent.

    The full names of their topics name the sensors whose messages do not (``names``).
    """

    def __init__(self, topics: Sequence[str], limits: BufferLimits) -> None:
        self.names = [topic.strip('/').replace('/', '_') for topic in topics]
        self.buffers = tuple(PoseBuffer(limits) for _ in topics)

    def tracks(self, frames: Sequence[str] = ('', '')) -> tuple[Track, ...]:
        """Return copies of what is held now; ``frames`` that are not empty override names."""
        return tuple(
            buffer.snapshot(name, frame.lstrip('/'))
            for buffer, name, frame in zip(self.buffers, self.names, frames, strict=True))

    def job(self, config: CalibrationConfig, frames: Sequence[str] = ('', '')) -> CalibrationJob:
        """Return a calibration of the second sensor in the first from what is held now."""
        track_a, track_b = self.tracks(frames)
        return CalibrationJob(track_a, track_b, config)

    def frames(self, overrides: Sequence[str] = ('', '')) -> tuple[str, ...]:
        """Return the frame of each sensor as a calibration names it, '' before its first pose."""
        return tuple(
            override.lstrip('/') or buffer.frames[1] or (name if len(buffer) else '')
            for override, buffer, name in zip(overrides, self.buffers, self.names, strict=True))

    def invented(self, overrides: Sequence[str] = ('', '')) -> frozenset[str]:
        """Return the frames that no message and no override names, but the topic."""
        return frozenset(
            name for override, buffer, name in zip(
                overrides, self.buffers, self.names, strict=True)
            if not override and not buffer.frames[1])

    def reset(self) -> None:
        """Forget all poses and counts."""
        for buffer in self.buffers:
            buffer.clear()


def _way_out(result: CalibrationResult) -> str:
    """Return why directions are open and what the findings advise, in words of the node."""
    why = re.sub(r'--([a-z-]+)(=?)',
                 lambda option: option[1].replace('-', '_') + (option[2] and ':='),
                 '; '.join(found.text.partition(': ')[2] for found in result.observability.findings
                           if found.code == 'direction-unobserved'))
    return why[:1].upper() + why[1:]
