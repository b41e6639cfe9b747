"""What the node knows about itself, as diagnostic_msgs."""

from __future__ import annotations

import math

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.online.buffer import PoseBuffer
from trajectory_calibration.online.excitation import Excitation
from trajectory_calibration.online.pairing import Pairing
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.ros.topics import TopicStatus

# A topic without a message for so long is reported as silent, seconds.
_SILENT_S = 5.0
# Poses that were forgotten are reported for so long, seconds.
_RECENT_S = 60.0


class InputMonitor:
    """Reports one input; remembers what it needs for rates and to speak up only when it matters.

    Attributes
    ----------
    name : of the input.
    rate_hz : messages per second between the last two reports.

    """

    def __init__(self, name: str, buffer: PoseBuffer, now_s: float) -> None:
        self.name = name
        self.rate_hz = 0.0
        self._buffer = buffer
        self._received = 0
        self._reported_s = now_s
        self._last_message_s: float | None = None
        # What is held, as last seen, and since when messages have changed nothing of it.
        self._held: tuple[object, ...] = ()
        self._useless_since_s: float | None = None
        self._refused = 0
        # Clock jumps, changes of frames and the poses that they cost, as last seen.
        self._losses = (0, 0, 0)
        self._lost_s = -math.inf
        self._loss = ''

    def report(self, topic: TopicStatus, now_s: float) -> DiagnosticStatus:
        """Return the state of the input; ``now_s`` is a steady time in seconds."""
        buffer = self._buffer
        arrived = buffer.received - self._received
        if now_s > self._reported_s:
            self.rate_hz = arrived / (now_s - self._reported_s)
        if arrived:
            self._last_message_s = now_s
        held = (buffer.generation, buffer.span_ns)
        if held != self._held:
            self._held, self._useless_since_s = held, None
        elif arrived and self._useless_since_s is None:
            self._useless_since_s = now_s
        self._received, self._reported_s = buffer.received, now_s
        status = DiagnosticStatus(name=self.name, hardware_id=buffer.frames[1])
        status.level, status.message = self._judge(topic, now_s)
        span = buffer.span_ns
        status.values = key_values({
            'poses': len(buffer),
            'span_s': f'{(span[1] - span[0]) * 1e-9:.3f}' if span else '0.000',
            'messages': buffer.messages,
            'rate_hz': f'{self.rate_hz:.2f}',
            'world_frame': buffer.frames[0],
            'sensor_frame': buffer.frames[1],
            **{f'refused: {why.value}': count for why, count in buffer.refused.items()},
            'dropped while still': buffer.still,
            'clock jumps': buffer.clock_jumps,
            'frame changes': buffer.frame_changes,
            'memory_mib': f'{buffer.nbytes / 2**20:.2f}',
        })
        return status

    def new_refusals(self) -> str:
        """Return the refused poses in words if there are new ones since the last call, or ''."""
        total = sum(self._buffer.refused.values())
        changed, self._refused = total > self._refused, total
        return self._buffer.refusals() if changed else ''

    def new_loss(self, now_s: float) -> str:
        """Return what a clock that went back, or other frames, have cost since then, or ''."""
        buffer = self._buffer
        (jumps, changes, forgotten), self._losses = self._losses, (
            buffer.clock_jumps, buffer.frame_changes, buffer.forgotten)
        if buffer.forgotten <= forgotten:
            return ''
        self._lost_s = now_s
        lost = f'{buffer.forgotten - forgotten} poses were forgotten'
        if buffer.frame_changes > changes:
            before, now = (' and '.join(name or 'none' for name in frames)
                           for frames in (buffer.frames_before, buffer.frames))
            self._loss = (f'its frames changed from {before} to {now}, {lost}; unless its sender '
                          'began anew, see that one sensor alone publishes on the topic')
        if buffer.clock_jumps > jumps:
            self._loss = (f'its stamps went back, {lost}; unless a bag began anew, correct the '
                          'clock of its sender')
        return self._loss

    def _judge(self, topic: TopicStatus, now_s: float) -> tuple[bytes, str]:
        if not topic.ready:
            return DiagnosticStatus.WARN, topic.text
        if self._last_message_s is None:
            return DiagnosticStatus.WARN, f'{topic.text}: no message yet'
        silent = now_s - self._last_message_s
        if silent > _SILENT_S:
            return DiagnosticStatus.WARN, f'{topic.text}: no message for {silent:.0f} s'
        if self._buffer.messages and not len(self._buffer):
            return DiagnosticStatus.WARN, (
                f'{topic.text}: none of its poses can be used: {self._buffer.refusals()}')
        if self._useless_since_s is not None and now_s - self._useless_since_s > _SILENT_S:
            why = self._buffer.refusals() or 'their stamps jumped and hardly go on'
            return DiagnosticStatus.WARN, (
                f'{topic.text}: no pose taken for {now_s - self._useless_since_s:.0f} s: {why}')
        if self._buffer.forgotten and now_s - self._lost_s < _RECENT_S:
            return DiagnosticStatus.WARN, f'{topic.text}: {self._loss}'
        if topic.doubt:
            return DiagnosticStatus.WARN, f'{topic.text}: {self.rate_hz:.1f} Hz from {topic.doubt}'
        return DiagnosticStatus.OK, f'{topic.text}: {self.rate_hz:.1f} Hz'


def excitation_values(excitation: Excitation) -> dict[str, object]:
    """Return the motion so far and what it promises, about the axes of sensor a."""
    return {
        'motions': excitation.motions,
        'rotation_deg_per_motion_xyz': _three(excitation.rotation_deg, 2),
        'predicted_translation_std_m_xyz': _three(excitation.translation_std, 4),
        'predicted_rotation_std_deg_xyz': _three(excitation.rotation_std_deg, 3),
    }


def pairing_values(pairing: Pairing, result: CalibrationResult | None) -> dict[str, object]:
    """Return where the poses of b fall now, and how the last calibration paired them."""
    values: dict[str, object] = {
        'association: pairs': pairing.pairs,
        'association: in gaps': pairing.in_gaps,
        'association: outside': pairing.outside,
    }
    if result is not None:
        last = result.association
        values['association of the last calibration'] = (
            f'{last.method}: {last.pairs} pairs of {last.poses_a} and {last.poses_b} poses, '
            f'{last.in_gaps} in gaps, {last.outside} outside, {last.between} between')
    return values


def _three(values: FloatArray, digits: int) -> str:
    return ' '.join(f'{value:.{digits}f}' for value in values)


def key_values(values: dict[str, object]) -> list[KeyValue]:
    """Return a dictionary as diagnostics carry it."""
    return [KeyValue(key=key, value=str(value)) for key, value in values.items()]


def time_apart_s(a: PoseBuffer, b: PoseBuffer, time_offset_s: float) -> float:
    """Return the seconds between the spans of two buffers, negative where they overlap.

    ``time_offset_s`` is added to the stamps of b; where a buffer is empty, the answer is 0.
    """
    span_a, span_b = a.span_ns, b.span_ns
    if span_a is None or span_b is None:
        return 0.0
    offset_ns = round(time_offset_s * 1e9)
    start, end = max(span_a[0], span_b[0] + offset_ns), min(span_a[1], span_b[1] + offset_ns)
    return (start - end) * 1e-9
