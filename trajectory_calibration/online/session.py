# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A calibration session: a buffer for each sensor, the jobs, and their outcome.

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
    """The (K, 4, 4) poses of sensor a in its world, from the trajectories of a and of b.

    Those from b are ``Z B_k T_a_b^-1``: transformed to a by the extrinsic, and to the world of a
    by the best-fitting registration Z.
    """

    world_frame: str
    stamps_ns: NDArray[np.int64]
    poses_a: FloatArray
    poses_b: FloatArray


def make_overlay(a: Trajectory, b: Trajectory, result: CalibrationResult) -> Overlay:
    """Return the two tracks of a calibration in one world frame."""
    pairs = associate(a, corrected_b(result, b), result.config)
    # More than 2000 poses only slow the display down.
    pairs = pairs.thinned(-(-len(pairs) // 2000))
    poses_a, poses_b = pairs.poses_a, pairs.poses_b @ se3.inverse(result.T_a_b)
    return Overlay(a.world_frame, pairs.stamps_ns, poses_a,
                   se3.registration(poses_a, poses_b) @ poses_b)


class Calibration(NamedTuple):
    """A result, and the tracks it was estimated from, for display."""

    result: CalibrationResult
    overlay: Overlay

    @property
    def refusal(self) -> str:
        """Return why the node does not publish the result and what to do, '' if it does.

        A result with an unobservable direction is not published, unless ``allow_unobserved``. The
        text ends with the refused poses of the tracks.
        """
        kept_back = Placement.of(self.result).kept_back
        notes = [found.text for found in self.result.findings if found.code == 'input-repaired']
        return kept_back and '; '.join([
            f'not published: {kept_back} unobservable. {_reason_and_advice(self.result)}', *notes])


@dataclass(frozen=True, eq=False)
class CalibrationJob:
    """The data of one calibration, copied when it was requested."""

    track_a: Snapshot
    track_b: Snapshot
    config: CalibrationConfig

    def run(self) -> Calibration:
        """Calibrate; the text of a CalibrationError ends with the refused poses."""
        try:
            a, b = self.track_a.trajectory(), self.track_b.trajectory()
            result = calibrate(a, b, self.config)
            return Calibration(result, make_overlay(a, b, result))
        except CalibrationError as error:
            # The refused poses may be the cause.
            notes = [note for note in (*self.track_a.warnings, *self.track_b.warnings)
                     if note not in str(error)]
            raise type(error)('; '.join([in_node_words(str(error)), *notes])) from error


class CalibrationSession:
    """The poses of the sensors since the last reset; the first sensor is the parent.

    ``names`` are sensor names from the topics, used if the messages have none.
    """

    def __init__(self, topics: Sequence[str], limits: BufferLimits) -> None:
        self.names = [topic.strip('/').replace('/', '_') for topic in topics]
        self.buffers = tuple(PoseBuffer(limits) for _ in topics)

    def tracks(self, frames: Sequence[str] = ('', '')) -> tuple[Snapshot, ...]:
        """Return copies of the buffers; non-empty ``frames`` override the sensor frames."""
        return tuple(
            buffer.snapshot(name, frame.lstrip('/'))
            for buffer, name, frame in zip(self.buffers, self.names, frames, strict=True))

    def job(self, config: CalibrationConfig, frames: Sequence[str] = ('', '')) -> CalibrationJob:
        """Return a job that calibrates the second sensor in the first with the buffered poses."""
        track_a, track_b = self.tracks(frames)
        return CalibrationJob(track_a, track_b, config)

    def frames(self, overrides: Sequence[str] = ('', '')) -> tuple[str, ...]:
        """Return the frame of each sensor in a calibration, '' before its first pose."""
        return tuple(
            override.lstrip('/') or buffer.frames[1] or (name if len(buffer) else '')
            for override, buffer, name in zip(overrides, self.buffers, self.names, strict=True))

    def invented(self, overrides: Sequence[str] = ('', '')) -> frozenset[str]:
        """Return the frames that are named after the topic, not by a message or an override."""
        return frozenset(
            name for override, buffer, name in zip(
                overrides, self.buffers, self.names, strict=True)
            if not override and not buffer.frames[1])

    def reset(self) -> None:
        """Drop all poses and counts."""
        for buffer in self.buffers:
            buffer.clear()


class CalibrationState:
    """The outcome of the calibrations so far."""

    def __init__(self) -> None:
        # The last result, of this run or restored.
        self.result: CalibrationResult | None = None
        self.reset()

    def started(self, motion: Motion) -> None:
        """Store the motion that a calibration uses."""
        self._tried = motion

    def succeeded(self, result: CalibrationResult) -> None:
        """Store a new result."""
        self.result, self.calibrated = result, True
        self.last_failure = self.not_restored = ''

    def failed(self, why: str) -> None:
        """Store a failure; the previous result is kept."""
        self.last_failure = f'calibration failed: {why}'

    def reset(self) -> None:
        """Reset everything except the result."""
        # Whether the result is from after the reset, and why the last calibration failed.
        self.calibrated, self.last_failure = False, ''
        # Why a saved result was refused. Unlike a failure, more motion does not help.
        self.not_restored = ''
        self._tried = NO_MOTION

    def has_moved_on(self, motion: Motion) -> bool:
        """Return whether there is enough new motion that another calibration may differ."""
        return motion.is_news_after(self._tried)

    def time_offset_s(self, setting_s: float) -> float:
        """Return the clock offset estimated since the last reset, or else the setting."""
        return self.result.time_offset_s if self.calibrated and self.result else setting_s

    def found_offset(self) -> str:
        """Return the clock offset estimated since the last reset, '' if there is none."""
        if not (self.calibrated and self.result) or (
                self.result.config.mode('time_offset') == 'fixed'):
            return ''
        return f'{self.result.time_offset_s:.4f}'


def _reason_and_advice(result: CalibrationResult) -> str:
    """Return why directions are unobservable, and the advice, in terms of node parameters."""
    why = in_node_words('; '.join(
        found.text.partition(': ')[2] for found in result.observability.findings
        if found.code == 'direction-unobserved'))
    return why[:1].upper() + why[1:]
