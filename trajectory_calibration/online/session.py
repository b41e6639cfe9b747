"""Two buffers and what is calibrated from them: what the node and a replay share.

Nothing here imports ROS.
"""

from __future__ import annotations

from dataclasses import dataclass

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.errors import CalibrationError, MotionError
from trajectory_calibration.online.buffer import BufferLimits, PoseBuffer, Track
from trajectory_calibration.online.overlay import make_overlay, Overlay
from trajectory_calibration.pipeline import calibrate
from trajectory_calibration.result import CalibrationResult


@dataclass(frozen=True, eq=False)
class Calibration:
    """An answer, and the tracks it was found from for a person to look at."""

    result: CalibrationResult
    overlay: Overlay


@dataclass(frozen=True, eq=False)
class CalibrationJob:
    """Everything that one calibration needs, copied at the moment it was asked for."""

    track_a: Track
    track_b: Track
    config: CalibrationConfig

    def run(self) -> Calibration:
        """Calibrate.

        Raises
        ------
        CalibrationError
            As ``calibrate``, for tracks of fewer than two poses, and for an answer that must
            not go out: one with a direction that neither the motion nor a prior determined,
            unless ``allow_unobserved``. The message ends with what was refused of the tracks.

        """
        try:
            a, b = self.track_a.trajectory(), self.track_b.trajectory()
            result = calibrate(a, b, self.config)
            _require_observed(result)
            return Calibration(result, make_overlay(a, b, result))
        except CalibrationError as error:
            # What was refused may be why.
            notes = [note for note in (*self.track_a.warnings, *self.track_b.warnings)
                     if note not in str(error)]
            raise type(error)('; '.join([str(error), *notes])) from error


class CalibrationSession:
    """The poses of both sensors since the last reset.

    Parameters
    ----------
    topic_a, topic_b : str
        Full names; they name a sensor whose messages do not.
    limits : BufferLimits
        For each buffer.

    Attributes
    ----------
    buffer_a, buffer_b : the poses of the parent and of the child sensor.

    """

    def __init__(self, topic_a: str, topic_b: str, limits: BufferLimits) -> None:
        self._topic_a, self._topic_b = topic_a, topic_b
        self.buffer_a = PoseBuffer(limits)
        self.buffer_b = PoseBuffer(limits)

    def job(
        self, config: CalibrationConfig, frame_a: str = '', frame_b: str = '',
    ) -> CalibrationJob:
        """Return a calibration of what is held now; ``frame_a``, ``frame_b`` override names."""
        return CalibrationJob(
            self.buffer_a.snapshot(_name_of(self._topic_a), frame_a),
            self.buffer_b.snapshot(_name_of(self._topic_b), frame_b),
            config)

    def reset(self) -> None:
        """Forget all poses and counts."""
        self.buffer_a.clear()
        self.buffer_b.clear()


def _require_observed(result: CalibrationResult) -> None:
    unobserved = result.observability.unobserved
    if unobserved and not result.config.allow_unobserved:
        raise MotionError(
            f'not published: {", ".join(unobserved)} of {result.frame_b} in {result.frame_a} not '
            f'observed ({"; ".join(map(str, result.observability.findings))})')


def _name_of(topic: str) -> str:
    return topic.strip('/').replace('/', '_')
