# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The diagnostics of the node."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from trajectory_calibration.errors import counted
from trajectory_calibration.online.advice import Advice, FEWEST_S
from trajectory_calibration.online.answer import deviations, headline
from trajectory_calibration.online.buffer import PoseBuffer
from trajectory_calibration.online.motion import Motion, Pairing
from trajectory_calibration.online.session import CalibrationState
from trajectory_calibration.online.verification import MonitorVerdict
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.ros.topics import TopicStatus

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN

# A topic without a message for longer, seconds, is reported as silent.
_SILENT_S = 5.0


class InputMonitor:
    """Reports the state of one input, and changes since the last report."""

    def __init__(self, name: str, buffer: PoseBuffer, now_s: float, sensor: str = '') -> None:
        self.name, self._sensor = name, sensor
        # Messages per second between the last two reports.
        self.rate_hz = 0.0
        self._buffer = buffer
        self._received = 0
        self._reported_s = now_s
        self._last_message_s: float | None = None
        # Generation and span of the buffer at the last report, and since when messages have not
        # changed them.
        self._last_held: tuple[object, ...] = ()
        self._unchanged_since_s: float | None = None
        self._refused = 0
        # Clock jumps, changes of frames and the poses dropped by them, at the last report.
        self._losses = (0, 0, 0)
        self._lost_s = -math.inf
        self._loss = ''

    def report(self, topic: TopicStatus, now_s: float, lost: int = 0) -> DiagnosticStatus:
        """Return the state of the input; ``now_s`` is a steady time in seconds."""
        buffer = self._buffer
        arrived = buffer.received - self._received
        if now_s > self._reported_s:
            self.rate_hz = arrived / (now_s - self._reported_s)
        if arrived:
            self._last_message_s = now_s
        held = (buffer.generation, buffer.span_ns)
        if held != self._last_held:
            self._last_held, self._unchanged_since_s = held, None
        elif arrived and self._unchanged_since_s is None:
            self._unchanged_since_s = now_s
        self._received, self._reported_s = buffer.received, now_s
        problem = self._problem(topic, now_s) if topic.ready else ''
        message = topic.text
        if topic.ready:
            message += f': {problem}' if problem else f': {self.rate_hz:.1f} Hz'
        if lost:
            message += f'; {counted(lost, "message")} lost by DDS'
        first_ns, last_ns = buffer.span_ns or (0, 0)
        return _status(self.name, buffer.frames[1] or self._sensor, message, {
            'poses': len(buffer),
            'span_s': f'{(last_ns - first_ns) * 1e-9:.3f}',
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
        }, level=OK if topic.ready and not problem else WARN)

    def new_refusals(self) -> str:
        """Return the refused poses in words, '' if none is new since the last call."""
        before, self._refused = self._refused, sum(self._buffer.refused.values())
        return self._buffer.refusals() if self._refused > before else ''

    def new_loss(self, now_s: float) -> str:
        """Return the poses dropped by a clock jump or other frames since the last call, or ''."""
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

    def _problem(self, topic: TopicStatus, now_s: float) -> str:
        """Return the problem of the input in words, '' if there is none."""
        if self._last_message_s is None:
            return 'no message yet. Does it publish?'
        silent = now_s - self._last_message_s
        if silent > _SILENT_S:
            return f'no message for {silent:.0f} s'
        if self._buffer.messages and not len(self._buffer):
            return f'no pose can be used: {self._buffer.refusals()}'
        if self._unchanged_since_s is not None and now_s - self._unchanged_since_s > _SILENT_S:
            why = self._buffer.refusals() or 'the stamps jumped'
            return f'no pose accepted for {now_s - self._unchanged_since_s:.0f} s: {why}'
        # Poses that were forgotten are reported for a minute.
        if self._buffer.forgotten and now_s - self._lost_s < 60:
            return self._loss
        return topic.doubt and f'{self.rate_hz:.1f} Hz from {topic.doubt}'


class CalibrationView(NamedTuple):
    """The data of the status of the calibration."""

    state: CalibrationState
    motion: Motion
    advice: Advice | None
    # Wanted standard deviations, metres and degrees.
    limits: tuple[float, float]
    # Time between the trajectories, negative if they overlap.
    gap_s: float
    # The running calibration, and what must happen first; '' if none.
    solving: str
    waiting: str
    values: dict[str, object]

    @property
    def sentence(self) -> str:
        """Return the advice in one sentence."""
        if self.gap_s > 0:
            return (f'the stamps of a and b are {self.gap_s:.3f} s apart: correct the clocks, '
                    'or set time_offset')
        if len(self.motion) < FEWEST_S:
            return f'waiting for motion seen by both sensors: {len(self.motion)} s so far'
        if self.advice is None:
            return 'evaluating the motion so far'
        return self.advice.sentence(*self.limits)

    def report(self, name: str, hardware_id: str) -> DiagnosticStatus:
        """Return it as a status."""
        state, result = self.state, self.state.result
        failed = state.last_failure and not state.has_moved_on(self.motion)
        problem = '' if self.solving else state.last_failure if failed else self.waiting
        # A restored answer, or one from before a reset, is not about the buffered poses.
        current = 'calibrated' if state.calibrated and not state.last_failure else self.sentence
        return _status(name, hardware_id, self.solving or problem or current, {
            **self.values,
            'advice': self.sentence,
            'last_failure': state.last_failure,
            'motion_s': len(self.motion),
            **_advice_values(self.advice),
            **({} if result is None else {
                'extrinsic': headline(result), 'standard_deviations': deviations(result),
                'findings': ' '.join(finding.code for finding in result.findings)}),
        }, level=WARN if problem else OK)


def _advice_values(advice: Advice | None) -> dict[str, object]:
    """Return the predicted accuracy of a calibration now, along the axes of sensor a."""
    if advice is None or advice.std is None:
        return {}
    result, std = advice.result, advice.std
    return {
        'rotation_deg_per_motion_xyz': _three(result.observability.excitation_deg, 2),
        'predicted_translation_std_m_xyz': _three(std[:3], 4),
        'predicted_rotation_std_deg_xyz': _three(std[3:], 3),
        'predicted_unobserved': ', '.join(result.observability.unobserved),
        'predicted_extrinsic': headline(result),
    }


def monitor_report(
    name: str, hardware_id: str, verdict: MonitorVerdict | None,
) -> DiagnosticStatus:
    """Return the status of the checks of the published extrinsic."""
    if verdict is None:
        return _status(name, hardware_id,
                       'not checked yet: waiting for an extrinsic, and for motion after it', {})
    return _status(name, hardware_id, verdict.sentence, {
        'verdict': verdict.verdict, 'status': verdict.exit_status,
        'checks in a row that found a change': verdict.checks}, level=bytes([verdict.level]))


def pairing_values(pairing: Pairing, result: CalibrationResult | None) -> dict[str, object]:
    """Return the present association counts, and the association of the last calibration."""
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


def _status(
    name: str, hardware_id: str, message: str, values: dict[str, object], *, level: bytes = OK,
) -> DiagnosticStatus:
    return DiagnosticStatus(
        name=name, hardware_id=hardware_id, level=level, message=message,
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])


def time_apart_s(a: PoseBuffer, b: PoseBuffer, time_offset_s: float) -> float:
    """Return the seconds between the spans of two buffers, negative if they overlap.

    ``time_offset_s`` is added to the stamps of b. If a buffer is empty, 0 is returned.
    """
    span_a, span_b = a.span_ns, b.span_ns
    if span_a is None or span_b is None:
        return 0.0
    offset_ns = round(time_offset_s * 1e9)
    start, end = max(span_a[0], span_b[0] + offset_ns), min(span_a[1], span_b[1] + offset_ns)
    return (start - end) * 1e-9
