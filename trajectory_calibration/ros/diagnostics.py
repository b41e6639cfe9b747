# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the node knows about itself, as diagnostic_msgs."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from trajectory_calibration.errors import counted
from trajectory_calibration.online.advice import Advice, FEWEST_S
from trajectory_calibration.online.answer import deviations, headline
from trajectory_calibration.online.buffer import PoseBuffer
from trajectory_calibration.online.motion import Motion
from trajectory_calibration.online.pairing import Pairing
from trajectory_calibration.online.state import CalibrationState
from trajectory_calibration.online.verification import Verdict
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

    def __init__(self, name: str, buffer: PoseBuffer, now_s: float, sensor: str = '') -> None:
        self.name, self._sensor = name, sensor
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

    @property
    def part(self) -> str:
        """Return the name of the input without that of the node."""
        return self.name.rpartition(': ')[2]

    @property
    def received(self) -> bool:
        """Whether a message has come."""
        return self._buffer.received > 0

    def report(self, topic: TopicStatus, now_s: float, lost: int = 0) -> DiagnosticStatus:
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
        status = DiagnosticStatus(
            name=self.name, hardware_id=buffer.frames[1] or self._sensor)
        status.level, status.message = self._judge(topic, now_s)
        if lost:
            status.message += f'; {counted(lost, "message")} lost by DDS'
        span = buffer.span_ns
        status.values = key_values({
            'poses': len(buffer),
            'span_s': f'{(span[1] - span[0]) * 1e-9:.3f}' if span else '0.000',
            'messages': buffer.messages,
            'messages lost': lost,
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
        forgotten = buffer.forgotten - forgotten
        lost = f'{counted(forgotten, "pose")} {"was" if forgotten == 1 else "were"} dropped'
        if buffer.frame_changes > changes:
            before, now = (' and '.join(name or 'none' for name in frames)
                           for frames in (buffer.frames_before, buffer.frames))
            self._loss = (f'the frames changed from {before} to {now}, {lost}; unless the sender '
                          'was restarted, check that only one sensor publishes on the topic')
        if buffer.clock_jumps > jumps:
            self._loss = (f'the stamps went back, {lost}; unless a bag was restarted, correct the '
                          'clock of the sender')
        return self._loss

    def _judge(self, topic: TopicStatus, now_s: float) -> tuple[bytes, str]:
        if not topic.ready:
            return DiagnosticStatus.WARN, topic.text
        if self._last_message_s is None:
            return DiagnosticStatus.WARN, f'{topic.text}: no message yet. Does it publish?'
        silent = now_s - self._last_message_s
        if silent > _SILENT_S:
            return DiagnosticStatus.WARN, f'{topic.text}: no message for {silent:.0f} s'
        if self._buffer.messages and not len(self._buffer):
            return DiagnosticStatus.WARN, (
                f'{topic.text}: no pose can be used: {self._buffer.refusals()}')
        if self._useless_since_s is not None and now_s - self._useless_since_s > _SILENT_S:
            why = self._buffer.refusals() or 'the stamps jumped'
            return DiagnosticStatus.WARN, (
                f'{topic.text}: no pose accepted for {now_s - self._useless_since_s:.0f} s: {why}')
        if self._buffer.forgotten and now_s - self._lost_s < _RECENT_S:
            return DiagnosticStatus.WARN, f'{topic.text}: {self._loss}'
        if topic.doubt:
            return DiagnosticStatus.WARN, f'{topic.text}: {self.rate_hz:.1f} Hz from {topic.doubt}'
        return DiagnosticStatus.OK, f'{topic.text}: {self.rate_hz:.1f} Hz'


@dataclass(frozen=True, eq=False)
class CalibrationView:
    """What the status of the calibration is made of.

    Attributes
    ----------
    state : outcome of the calibrations so far.
    motion, advice : so far; the advice is None before the first.
    limits : wanted standard deviations, metres and degrees.
    apart_s : time between the trajectories, negative where they overlap.
    solving : what is being solved in words, '' where nothing is.
    waiting : a sentence where something must come first, '' otherwise.
    values : what is reported besides.

    """

    state: CalibrationState
    motion: Motion
    advice: Advice | None
    limits: tuple[float, float]
    apart_s: float
    solving: str
    waiting: str
    values: dict[str, object]

    @property
    def sentence(self) -> str:
        """Return the advice in one sentence."""
        if self.apart_s > 0:
            return (f'the stamps of a and b are {self.apart_s:.3f} s apart: correct the clocks, '
                    'or set time_offset')
        if len(self.motion) < FEWEST_S:
            return f'waiting for motion seen by both sensors: {len(self.motion)} s so far'
        if self.advice is None:
            return 'judging the motion so far'
        return self.advice.sentence(*self.limits)

    def report(self, name: str, hardware_id: str) -> DiagnosticStatus:
        """Return it as a status."""
        status = DiagnosticStatus(name=name, hardware_id=hardware_id, level=DiagnosticStatus.OK)
        state, result = self.state, self.state.result
        if self.solving:
            status.message = self.solving
        elif state.last_failure and not state.has_moved_on(self.motion):
            status.level, status.message = DiagnosticStatus.WARN, state.last_failure
        elif self.waiting:
            status.level, status.message = DiagnosticStatus.WARN, self.waiting
        # A restored answer, or one before a reset, says nothing about what is held.
        elif state.calibrated and not state.last_failure:
            status.message = 'calibrated'
        else:
            status.message = self.sentence
        status.values = key_values({
            **self.values,
            'advice': self.sentence,
            'last_failure': state.last_failure,
            'motion_s': len(self.motion),
            **advice_values(self.advice),
            **({} if result is None else {
                'extrinsic': headline(result), 'standard_deviations': deviations(result),
                'findings': ' '.join(finding.code for finding in result.findings)}),
        })
        return status


def advice_values(advice: Advice | None) -> dict[str, object]:
    """Return what a calibration would say now, about the axes of sensor a."""
    std = None if advice is None else advice.std
    if advice is None or advice.result is None or std is None:
        return {}
    result = advice.result
    return {
        'rotation_deg_per_motion_xyz': _three(result.observability.excitation_deg, 2),
        'predicted_translation_std_m_xyz': _three(std[:3], 4),
        'predicted_rotation_std_deg_xyz': _three(std[3:], 3),
        'predicted_unobservable': ', '.join(result.observability.unobserved),
        'predicted_extrinsic': headline(result),
    }


def monitor_report(name: str, hardware_id: str, verdict: Verdict | None) -> DiagnosticStatus:
    """Return whether the published extrinsic still holds."""
    status = DiagnosticStatus(name=name, hardware_id=hardware_id, level=DiagnosticStatus.OK)
    if verdict is None:
        status.message = 'not checked yet: waiting for an extrinsic, and for motion after it'
        return status
    status.level = bytes([verdict.level])
    status.message = verdict.sentence
    status.values = key_values({
        'verdict': verdict.verdict, 'status': verdict.exit_status,
        'checks in a row that found a change': verdict.checks})
    return status


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


def _three(values: Any, digits: int) -> str:
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
