# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The node: receives two trajectories, calibrates on request, publishes the extrinsic."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.time_source import CLOCK_TOPIC
from std_srvs.srv import Trigger

from trajectory_calibration.errors import ConfigError, counted, ResultError
from trajectory_calibration.online.answer import describe
from trajectory_calibration.online.background import Background
from trajectory_calibration.online.motion import count_pairs, measure, Motion
from trajectory_calibration.online.options import find_frames, find_type, to_config, to_limits
from trajectory_calibration.online.session import (
    Calibration,
    CalibrationSession,
    CalibrationState,
    Overlay,
)
from trajectory_calibration.online.store import Restored, ResultStore
from trajectory_calibration.online.verification import Monitor
from trajectory_calibration.online.worker import SolverProcess, StoppedError
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.ros.diagnostics import (
    CalibrationView,
    InputMonitor,
    monitor_report,
    pairing_values,
    time_apart_s,
)
from trajectory_calibration.ros.frames import VehicleTransforms
from trajectory_calibration.ros.messages import ResultPublisher
from trajectory_calibration.ros.parameters import NodeParameters
from trajectory_calibration.ros.topics import (
    resolve_topic,
    TrajectorySubscription,
    TransformSubscription,
)
from trajectory_calibration.time_alignment.pairing import is_sparser

NODE_NAME = 'trajectory_calibration'

# Shortest time between two log messages on refused poses, seconds.
_REFUSAL_LOG_S = 10.0
# Time between two log messages on topics without a message, seconds.
_WAITING_LOG_S = 30.0


class CalibrationNode(Node):
    """Parameters, topics and services as listed in the documentation of the package.

    Raises
    ------
    ConfigError
        A parameter is invalid.

    """

    def __init__(self) -> None:
        try:
            super().__init__(NODE_NAME, automatically_declare_parameters_from_overrides=True)
        except ValueError as error:
            raise ConfigError(
                f'parameters: {error}; if one is an empty list, correct it') from error
        self._settings = NodeParameters(self)
        values = self._settings.values()
        names = [values[f'topic_{side}'] for side in 'ab']
        pairs = [find_frames(name) for name in names]
        topics = [resolve_topic(self, name) if pair is None else name
                  for name, pair in zip(names, pairs, strict=True)]
        if topics[0] == topics[1]:
            raise ConfigError(
                f'topic_a and topic_b are both {topics[0]}; needed the topics of two sensors')
        started_s = time.monotonic()
        self._session = CalibrationSession(topics, to_limits(values))
        self._tf = VehicleTransforms(
            self, publish=values['publish_tf'], moving=any(pairs), depth=values['queue_depth'])
        self._inputs = [
            TrajectorySubscription(
                self, name, find_type(values[f'type_{side}']), buffer, values['queue_depth'])
            if pair is None else TransformSubscription(name, pair, self._tf, buffer)
            for side, name, pair, buffer in zip(
                'ab', names, pairs, self._session.buffers, strict=True)]
        self._monitors = [
            InputMonitor(
                self._status_name(f'trajectory_{side}'), buffer, started_s, name)
            for side, buffer, name in zip(
                'ab', self._session.buffers, self._session.names, strict=True)]
        self._refusals_logged_s = 0.0
        # The first one is after 3 seconds.
        self._waiting_logged_s = started_s - _WAITING_LOG_S + 3

        self._state = CalibrationState()
        self._solved = self.create_guard_condition(self._on_solved)
        self._solver: SolverProcess[Calibration] = SolverProcess(done=self._solved.trigger)
        self._answer: Future | None = None
        # Whether a call of ~/calibrate is pending.
        self._call_pending = False
        self._background_done = self.create_guard_condition(self._on_background_done)
        self._background = Background(
            self._session, self._background_done.trigger, started_s,
            Monitor(values['monitor_period'], values['monitor_window'])
            if values['monitor'] else None)

        self._store = (
            ResultStore(values['result_directory'], self.get_fully_qualified_name())
            if values['result_directory'] else None)
        self._publisher = ResultPublisher(self)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        # A call that waits for the solver must not block the other services.
        group = ReentrantCallbackGroup()
        for name, callback in (('calibrate', self._on_calibrate), ('reset', self._on_reset),
                               ('save', self._on_save)):
            self.create_service(Trigger, f'~/{name}', callback, callback_group=group)
        # Steady, because with use_sim_time the node's clock does not advance until a bag plays.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(0.2, self._update_inputs, clock=steady)
        self.create_timer(values['diagnostic_updater.period'], self._report, clock=steady)
        self._restored = self._find_restored() if values['restore'] else None
        self._publish_restored()

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, *args: Any, **kwargs: Any,
    ) -> Subscription:
        """Subscribe, and catch the errors of rclpy for invalid messages on ``/clock``."""
        def take_time(message: Any) -> None:
            # rclpy raises for negative seconds, which would end the executor.
            try:
                callback(message)
            except ValueError as error:
                self.get_logger().warning(
                    f'{CLOCK_TOPIC} ignored: {error}; correct the clock of its sender',
                    throttle_duration_sec=_REFUSAL_LOG_S)
        return super().create_subscription(
            msg_type, topic, take_time if topic == CLOCK_TOPIC else callback, *args, **kwargs)

    def finish_calls(self, executor: SingleThreadedExecutor) -> None:
        """Stop a running calibration and respond to its caller."""
        self._solver.cancel('stopped: the node is shutting down')
        deadline_s = time.monotonic() + 0.5
        while self._call_pending and time.monotonic() < deadline_s:
            executor.spin_once(timeout_sec=0.05)

    def shutdown(self) -> None:
        """Stop the solver processes and destroy the node."""
        self._solver.shutdown()
        self._background.shutdown()
        self.destroy_node()

    def _status_name(self, part: str) -> str:
        """Return the name of a status in the format of diagnostic_updater.

        In a namespace it has the full node name, as with ``use_fqn``, because two pairs of
        sensors are two nodes with the same name.
        """
        full = self.get_fully_qualified_name()
        return f'{full if self.get_namespace() != "/" else self.get_name()}: {part}'

    def _update_inputs(self) -> None:
        for item in self._inputs:
            item.update()
        self._publish_restored()
        self._tf.publish_pending()

    async def _on_calibrate(
        self, _: Trigger.Request, response: Trigger.Response,
    ) -> Trigger.Response:
        if self._solver.busy:
            response.message = 'busy: a calibration is running; call again when it has answered'
            return response
        self._answer, self._call_pending = Future(), True
        self._start_solver(self._settings.values())
        response.success, response.message = await self._answer
        self._call_pending = False
        return response

    def _start_solver(self, values: Mapping[str, Any]) -> None:
        for item in self._inputs:
            item.update()
        # The background computes the same, and the caller waits.
        self._background.stop('a calibration was called for')
        self._state.started(self._measure(values))
        job = self._session.job(to_config(values), _frames(values))
        self._solver.start(job, values['calibration_timeout'])

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        poses_a, poses_b = map(len, self._session.buffers)
        self._solver.cancel('stopped by a reset')
        if self._solver.busy:
            # Done now, so that the solver is not busy for a call right after this one.
            self._answer_call()
        self._background.reset()
        self._tf.reset()
        self._session.reset()
        self._state.reset()
        response.success = True
        response.message = (
            f'dropped {counted(poses_a, "pose")} of a and {poses_b:,} of b; the published '
            'extrinsic stays')
        self.get_logger().info(response.message)
        return response

    def _on_save(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._state.result is None:
            response.message = 'nothing to save: no calibration has succeeded yet'
        elif self._store is None:
            response.message = 'result_directory is empty; start the node with a folder'
        else:
            response.success, response.message = self._save(self._state.result, exports=True)
        return response

    def _save(self, result: CalibrationResult, *, exports: bool = False) -> tuple[bool, str]:
        """Save a result; return whether it succeeded, and a sentence."""
        saved = 'not saved'
        try:
            path = self._store.save(result)
            saved = f'saved in {path}'
            if exports and result.frame_a != result.frame_b:
                saved += '; URDF and other exports'
                saved += f' in {self._store.export(result, path)}'
        except ResultError as error:
            self.get_logger().error(str(error))
            return False, f'{saved}: {error}'
        return True, saved

    def _find_restored(self) -> Restored | None:
        """Return the newest saved result; without one, log it and return None."""
        try:
            found = self._store.latest()
        except ResultError as error:
            self._state.not_restored = f'nothing restored: {error}'
            self.get_logger().error(self._state.not_restored)
            return None
        if found is None:
            self.get_logger().warning('nothing restored: result_directory holds no result yet')
        return found

    def _publish_restored(self) -> None:
        """Publish the restored result once its frames match those of the vehicle."""
        if self._restored is None or self._state.result is not None:
            return
        refusal = self._restored.compare(
            self._session.frames(_frames(self._settings.values())))
        if refusal is None:
            return
        restored, self._restored = self._restored, None
        if refusal:
            self._state.not_restored = refusal
            self.get_logger().error(refusal)
            return
        self._state.result = restored.result
        self._publish(restored.result)
        self.get_logger().info(f'restored {restored.path}: {describe(restored.result)}')

    def _publish(self, result: CalibrationResult, overlay: Overlay | None = None) -> None:
        """Publish an answer; a restored one has no overlay."""
        self._publisher.publish(result, overlay)
        if self._background.monitor is not None:
            self._background.monitor.watch(result, self._session, restored=overlay is None)
        self._tf.take(result, self._session.invented(_frames(self._settings.values())))

    def _on_solved(self) -> None:
        # A reset may have taken the outcome already.
        if self._solver.ready:
            self._answer_call()

    def _answer_call(self) -> None:
        """Publish the outcome of the solver and respond to the pending call."""
        outcome = self._solver.take_outcome()
        failure = outcome.refusal if isinstance(outcome, Calibration) else str(outcome)
        if isinstance(outcome, StoppedError):
            # Not a failure, because it was stopped on request.
            self.get_logger().info(f'calibration {failure}')
            answer = False, failure
        elif failure:
            self._state.failed(failure)
            self.get_logger().warning(self._state.last_failure)
            answer = False, failure
        else:
            result = outcome.result
            self._state.succeeded(result)
            self._publish(result, outcome.overlay)
            file = '' if self._store is None else self._save(result)[1]
            answer = True, describe(result, file, self._tf.today(result), self._tf.placed)
            self.get_logger().info(answer[1])
        if self._answer is not None:
            self._answer.set_result(answer)
            self._answer = None

    def _on_background_done(self) -> None:
        """Take the outcome of the background; log a warning if the extrinsic has changed."""
        before = self._background.verdict
        self._background.take(time.monotonic())
        verdict = self._background.verdict
        if verdict is not None and verdict is not before and verdict.level:
            self.get_logger().warning(f'the published extrinsic: {verdict.sentence}')

    def _report(self) -> None:
        now_s = time.monotonic()
        for monitor in self._monitors:
            if loss := monitor.new_loss(now_s):
                self.get_logger().warning(f'{monitor.name}: {loss}')
        statuses = [
            monitor.report(item.status, now_s, item.lost)
            for monitor, item in zip(self._monitors, self._inputs, strict=True)]
        self._log_waiting(statuses, now_s)
        values = self._settings.values()
        motion = self._measure(values)
        self._update_advice(values, motion, now_s)
        hardware_id = ', '.join(status.hardware_id for status in statuses)
        statuses.append(self._view(values, motion, now_s).report(
            self._status_name('calibration'), hardware_id))
        if self._background.monitor is not None:
            statuses.append(monitor_report(
                self._status_name('monitor'), hardware_id, self._background.verdict))
        message = DiagnosticArray(status=statuses)
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)
        if now_s - self._refusals_logged_s >= _REFUSAL_LOG_S:
            for monitor in self._monitors:
                if refusals := monitor.new_refusals():
                    self._refusals_logged_s = now_s
                    self.get_logger().warning(f'{monitor.name}: {refusals}')

    def _log_waiting(self, statuses: Sequence[DiagnosticStatus], now_s: float) -> None:
        """Log topics without a message, soon after the start and then periodically."""
        if now_s - self._waiting_logged_s < _WAITING_LOG_S:
            return
        self._waiting_logged_s = now_s
        for buffer, status in zip(self._session.buffers, statuses, strict=True):
            if not buffer.received:
                name = status.name.rpartition(': ')[2]
                self.get_logger().info(f'waiting for {name}: {status.message}')

    def _measure(self, values: Mapping[str, Any]) -> Motion:
        offset_s = self._state.time_offset_s(values['time_offset'])
        return measure(self._session.buffers, (0, round(offset_s * 1e9)))

    def _update_advice(self, values: Mapping[str, Any], motion: Motion, now_s: float) -> None:
        """Update the advice; with ``auto_calibrate``, calibrate when the motion is sufficient."""
        if self._solver.busy:
            return
        self._background.poll(motion, to_config(values), _frames(values),
                              values['calibration_timeout'], now_s)
        advice = self._background.advice
        if (values['auto_calibrate'] and not self._state.calibrated and advice is not None
                and self._state.has_moved_on(motion) and advice.sufficient(*_limits(values))):
            self.get_logger().info(f'enough motion ({len(motion)} s): calibrating')
            self._start_solver(values)

    def _view(self, values: Mapping[str, Any], motion: Motion, now_s: float) -> CalibrationView:
        a, b = self._session.buffers
        offset_s = self._state.time_offset_s(values['time_offset'])
        gap_s = time_apart_s(a, b, offset_s)
        solving = '' if not self._solver.busy else (
            f'calibrating for {now_s - self._solver.started_s:.0f} s, at most '
            f'{values["calibration_timeout"]:g} s')
        result = self._state.result
        return CalibrationView(
            self._state, motion, self._background.advice, _limits(values), gap_s, solving,
            self._state.not_restored if self._restored is None else self._restored.waiting,
            {
                'solver': values['solver'],
                'overlap_s': f'{max(0.0, -gap_s):.3f}',
                'time_offset': f'{values["time_offset"]:.4f}',
                'clock_offset_s': self._state.found_offset(),
                **pairing_values(count_pairs(
                    a, b, round(offset_s * 1e9), round(values['max_gap'] * 1e9),
                    at_a=values['association'] == 'auto' and is_sparser(
                        a.stamps_ns, b.stamps_ns)), result),
                'tf': self._tf.placed,
                'vehicle_today': self._tf.today(result),
            })


def _frames(values: Mapping[str, Any]) -> tuple[str, str]:
    return values['frame_a'], values['frame_b']


def _limits(values: Mapping[str, Any]) -> tuple[float, float]:
    return values['target_translation_std'], values['target_rotation_std']
