# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A buffer for each sensor, what is calibrated from them, and what came of it.

The node and a replay share it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import CalibrationError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.online.buffer import BufferLimits, PoseBuffer
from trajectory_calibration.online.motion import Motion, NO_MOTION
from trajectory_calibration.online.options import in_node_words
from trajectory_calibration.online.snapshot import Snapshot
from trajectory_calibration.outputs.placement import Placement
from trajectory_calibration.outputs.report.tracks import corrected_b
from trajectory_calibration.pipeline import calibrate
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.time_alignment.pairing import associate


@dataclass(frozen=True, eq=False)
class Overlay:
    """The (K, 4, 4) poses of sensor a in its world, as a and as b reported them.

    Those of b are ``Z B_k T_a_b^-1``: carried to a by the extrinsic, and into the world of a by
    the Z that fits all of them best.
    """

    world_frame: str
    stamps_ns: NDArray[np.int64]
    poses_a: FloatArray
    poses_b: FloatArray


def make_overlay(a: Trajectory, b: Trajectory, result: CalibrationResult) -> Overlay:
    """Lay the tracks of a calibration over each other."""
    pairs = associate(a, corrected_b(result, b), result.config)
    # More poses than a person can tell apart only slow the display down.
    pairs = pairs.thinned(-(-len(pairs) // 2000))
    poses_a, poses_b = pairs.poses_a, pairs.poses_b @ se3.inverse(result.T_a_b)
    return Overlay(a.world_frame, pairs.stamps_ns, poses_a,
                   se3.registration(poses_a, poses_b) @ poses_b)


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
        kept_back = Placement.of(self.result).kept_back
        notes = [found.text for found in self.result.findings if found.code == 'input-repaired']
        return kept_back and '; '.join([
            f'not published: {kept_back} unobserved. {_way_out(self.result)}', *notes])


@dataclass(frozen=True, eq=False)
class CalibrationJob:
    """Everything that one calibration needs, copied at the moment it was asked for."""

    track_a: Snapshot
    track_b: Snapshot
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
            raise type(error)('; '.join([in_node_words(str(error)), *notes])) from error


class CalibrationSession:
    """The poses of the sensors since the last reset; the first sensor is the parent.

    The full names of their topics name the sensors whose messages do not (``names``).
    """

    def __init__(self, topics: Sequence[str], limits: BufferLimits) -> None:
        self.names = [topic.strip('/').replace('/', '_') for topic in topics]
        self.buffers = tuple(PoseBuffer(limits) for _ in topics)

    def tracks(self, frames: Sequence[str] = ('', '')) -> tuple[Snapshot, ...]:
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


class CalibrationState:
    """The outcome of the calibrations so far."""

    def __init__(self) -> None:
        # The last answer, of this run or restored.
        self.result: CalibrationResult | None = None
        self.reset()

    def started(self, motion: Motion) -> None:
        """Note the motion that a calibration begins with."""
        self._tried = motion

    def succeeded(self, result: CalibrationResult) -> None:
        """Take a new answer."""
        self.result, self.calibrated = result, True
        self.last_failure = self.not_restored = ''

    def failed(self, why: str) -> None:
        """Take a failure; the answer before it stays."""
        self.last_failure = f'calibration failed: {why}'

    def reset(self) -> None:
        """Forget all but the answer."""
        # Whether the answer was found since, and why the last calibration failed.
        self.calibrated, self.last_failure = False, ''
        # Why a saved answer was refused: unlike a failure, no motion mends that.
        self.not_restored = ''
        self._tried = NO_MOTION

    def has_moved_on(self, motion: Motion) -> bool:
        """Return whether what the last calibration said is old: another may succeed."""
        return motion.is_news_after(self._tried)

    def time_offset_s(self, setting_s: float) -> float:
        """Return the clock offset that was found since the last reset, or else the setting."""
        return self.result.time_offset_s if self.calibrated and self.result else setting_s

    def found_offset(self) -> str:
        """Return the clock offset that a calibration since the last reset found, or ''."""
        if not (self.calibrated and self.result) or (
                self.result.config.mode('time_offset') == 'fixed'):
            return ''
        return f'{self.result.time_offset_s:.4f}'


def _way_out(result: CalibrationResult) -> str:
    """Return why directions are unobserved and what the findings advise, in words of the node."""
    why = in_node_words('; '.join(
        found.text.partition(': ')[2] for found in result.observability.findings
        if found.code == 'direction-unobserved'))
    return why[:1].upper() + why[1:]
