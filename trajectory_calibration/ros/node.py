"""The node: receives two trajectories, calibrates on request, publishes the extrinsic."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.time_source import CLOCK_TOPIC
from rclpy.utilities import get_default_context
from std_srvs.srv import Trigger

from trajectory_calibration.errors import CalibrationError, ConfigError, ResultError
from trajectory_calibration.online.answer import describe, deviations, headline
from trajectory_calibration.online.excitation import Excitation, ExcitationMonitor
from trajectory_calibration.online.options import find_type, to_config, to_limits
from trajectory_calibration.online.pairing import count_pairs
from trajectory_calibration.online.session import CalibrationSession
from trajectory_calibration.online.store import ResultStore
from trajectory_calibration.online.worker import SolverProcess, StoppedError
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.ros.diagnostics import (
    excitation_values,
    InputMonitor,
    key_values,
    pairing_values,
    time_apart_s,
)
from trajectory_calibration.ros.outputs import ResultPublisher
from trajectory_calibration.ros.parameters import NodeParameters
from trajectory_calibration.ros.signals import StopSignals
from trajectory_calibration.ros.topics import resolve_topic, TrajectorySubscription

NODE_NAME = 'trajectory_calibration'

# Beyond it DDS runs out of ports, and Fast DDS ends the process itself.
_HIGHEST_DOMAIN = 232

# How often the graph is searched for publishers, and how often the log speaks of bad poses.
_WATCH_S = 0.2
_DIAGNOSTICS_S = 1.0
_REFUSAL_LOG_S = 10.0
# How long the end waits for the answer to a caller.
_FAREWELL_S = 0.5

# How much more motion, of that which it had, there must be before a calibration that failed says
# nothing about the next one: its message leaves the diagnostics, and auto_calibrate tries again.
_MORE_MOTION = 0.2


class CalibrationNode(Node):
    """Parameters, topics and services as listed in the documentation of the package.

    Raises
    ------
    ConfigError
        A parameter is invalid.

    """

    def __init__(self, **kwargs: Any) -> None:
        try:
            super().__init__(
                NODE_NAME, automatically_declare_parameters_from_overrides=True, **kwargs)
        except ValueError as error:
            raise ConfigError(
                f'parameters: {error}; if one is an empty list, correct it') from error
        self._settings = NodeParameters(self)
        values = self._settings.values()
        topics = [resolve_topic(self, values[name]) for name in ('topic_a', 'topic_b')]
        if topics[0] == topics[1]:
            raise ConfigError(
                f'topic_a and topic_b are both {topics[0]}; needed the topics of two sensors')
        self._session = CalibrationSession(topics, to_limits(values))
        buffers = self._session.buffers[0], self._session.buffers[1]
        self._inputs = [
            TrajectorySubscription(
                self, values[f'topic_{side}'], find_type(values[f'type_{side}']), buffer,
                values['queue_depth'])
            for side, buffer in zip('ab', buffers, strict=True)]
        self._monitors = [
            InputMonitor(f'{self.get_fully_qualified_name()}: {name}', buffer, time.monotonic())
            for name, buffer in zip(('trajectory_a', 'trajectory_b'), buffers, strict=True)]
        self._refusals_logged_s = 0.0
        self._result: CalibrationResult | None = None
        self._last_failure = ''

        self._solved = self.create_guard_condition(self._on_solved)
        self._solver = SolverProcess(done=self._solved.trigger)
        self._answer: Future | None = None
        # Whether a caller of ~/calibrate waits.
        self._called = False
        self._excitation = ExcitationMonitor()
        self._calibrated = False
        # Motions driven when a calibration was tried last, and that it had.
        self._tried = (0, 0)

        self._store = None
        if values['result_directory']:
            self._store = ResultStore(
                values['result_directory'], self.get_fully_qualified_name())

        self._publisher = ResultPublisher(self, publish_tf=values['publish_tf'])
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        # A call that waits for the solver must not hold up its neighbours.
        group = ReentrantCallbackGroup()
        self.create_service(
            Trigger, '~/calibrate', self._on_calibrate, callback_group=group)
        self.create_service(Trigger, '~/reset', self._on_reset, callback_group=group)
        self.create_service(Trigger, '~/save', self._on_save, callback_group=group)
        # Steady: with use_sim_time the node's own clock stands still until a bag plays.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_WATCH_S, self._watch_topics, clock=steady)
        self.create_timer(_DIAGNOSTICS_S, self._report, clock=steady)
        if values['restore']:
            self._restore()

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, *args: Any, **kwargs: Any,
    ) -> Subscription:
        """Subscribe as any node does, but outlive what rclpy cannot take on ``/clock``."""
        def take_time(message: Any) -> None:
            # rclpy raises for negative seconds, out of the executor.
            try:
                callback(message)
            except ValueError as error:
                self.get_logger().warning(
                    f'{CLOCK_TOPIC} ignored: {error}; correct the clock of its sender',
                    throttle_duration_sec=_REFUSAL_LOG_S)
        return super().create_subscription(
            msg_type, topic, take_time if topic == CLOCK_TOPIC else callback, *args, **kwargs)

    def take_leave(self, executor: SingleThreadedExecutor) -> None:
        """Stop a running calibration and answer its caller."""
        self._solver.cancel('stopped: the node is shutting down')
        deadline_s = time.monotonic() + _FAREWELL_S
        while self._called and time.monotonic() < deadline_s:
            executor.spin_once(timeout_sec=0.05)

    def shutdown(self) -> None:
        """Stop a running calibration and destroy the node."""
        self._solver.shutdown()
        self.destroy_node()

    def _watch_topics(self) -> None:
        for item in self._inputs:
            item.update()

    async def _on_calibrate(
        self, request: Trigger.Request, response: Trigger.Response,
    ) -> Trigger.Response:
        del request
        if self._solver.busy:
            response.message = 'busy: a calibration is running; call again when it has answered'
            return response
        self._answer, self._called = Future(), True
        self._start_solver(self._settings.values())
        response.success, response.message = await self._answer
        self._called = False
        return response

    def _start_solver(self, values: Mapping[str, Any]) -> None:
        excitation = self._observe(values)[0]
        self._tried = excitation.driven, excitation.motions
        job = self._session.job(to_config(values), (values['frame_a'], values['frame_b']))
        self._solver.start(job, values['calibration_timeout'])

    def _on_reset(
        self, request: Trigger.Request, response: Trigger.Response,
    ) -> Trigger.Response:
        del request
        poses_a, poses_b = len(self._session.buffers[0]), len(self._session.buffers[1])
        self._solver.cancel('stopped by a reset')
        self._session.reset()
        self._calibrated, self._tried, self._last_failure = False, (0, 0), ''
        response.success = True
        response.message = (
            f'forgot {poses_a} poses of a and {poses_b} of b; the published extrinsic stays')
        self.get_logger().info(response.message)
        return response

    def _on_save(
        self, request: Trigger.Request, response: Trigger.Response,
    ) -> Trigger.Response:
        del request
        if self._result is None:
            response.message = 'nothing to save: no calibration has succeeded yet'
        elif self._store is None:
            response.message = 'result_directory is empty; start the node with a folder'
        else:
            response.success, response.message = self._save(self._store, self._result)
        return response

    def _save(self, store: ResultStore, result: CalibrationResult) -> tuple[bool, str]:
        """Save a result; return whether that succeeded, and a sentence."""
        try:
            return True, f'saved in {store.save(result)}'
        except ResultError as error:
            self.get_logger().error(str(error))
            return False, f'not saved: {error}'

    def _restore(self) -> None:
        """Publish the newest saved result; a vehicle without one starts all the same."""
        try:
            found = self._store.latest() if self._store is not None else None
        except ResultError as error:
            self.get_logger().error(f'nothing restored: {error}')
            return
        if found is None:
            self.get_logger().warning('nothing restored: result_directory holds no result yet')
            return
        path, self._result = found
        self._publisher.publish(self._result, None)
        self.get_logger().info(f'restored {path}: {describe(self._result)}')

    def _on_solved(self) -> None:
        """Publish what the solver found and answer the call that waits for it."""
        if not self._solver.busy:
            return
        outcome = self._solver.take_outcome()
        if isinstance(outcome, StoppedError):
            # Not a failure: whoever stopped it knows.
            self.get_logger().info(f'calibration {outcome}')
            answer = False, str(outcome)
        elif isinstance(outcome, CalibrationError):
            self._last_failure = f'calibration failed: {outcome}'
            self.get_logger().warning(self._last_failure)
            answer = False, str(outcome)
        else:
            result = self._result = outcome.result
            self._last_failure, self._calibrated = '', True
            self._publisher.publish(result, outcome.overlay)
            file = '' if self._store is None else self._save(self._store, result)[1]
            text = describe(result, file)
            answer = True, text
            self.get_logger().info(text)
        if self._answer is not None:
            self._answer.set_result(answer)
            self._answer = None

    def _report(self) -> None:
        now_s = time.monotonic()
        for monitor in self._monitors:
            loss = monitor.new_loss(now_s)
            if loss:
                self.get_logger().warning(f'{monitor.name}: {loss}')
        statuses = [
            monitor.report(item.status, now_s)
            for monitor, item in zip(self._monitors, self._inputs, strict=True)]
        values = self._settings.values()
        excitation, offset_s = self._observe(values)
        statuses.append(self._calibration_status(values, excitation, offset_s))
        message = DiagnosticArray(status=statuses)
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)
        if values['auto_calibrate']:
            self._calibrate_when_ready(values, excitation)
        if now_s - self._refusals_logged_s >= _REFUSAL_LOG_S:
            for monitor in self._monitors:
                refusals = monitor.new_refusals()
                if refusals:
                    self._refusals_logged_s = now_s
                    self.get_logger().warning(f'{monitor.name}: {refusals}')

    def _observe(self, values: Mapping[str, Any]) -> tuple[Excitation, float]:
        """Return the motion so far, and the seconds added to the stamps of b for it."""
        # A calibration of this run may have found the clock offset.
        offset_s = (self._result.time_offset_s if self._calibrated and self._result is not None
                    else values['time_offset'])
        return self._excitation.update(
            self._session.buffers[0], self._session.buffers[1], round(offset_s * 1e9),
            round(values['max_gap'] * 1e9), to_config(values)), offset_s

    def _clock_offset(self) -> str:
        """Return the clock offset that a calibration since the last reset found, or ''."""
        result = self._result
        if (result is None or not self._calibrated
                or result.config.mode('time_offset') == 'fixed'):
            return ''
        return f'{result.time_offset_s:.4f}'

    def _has_moved_on(self, excitation: Excitation) -> bool:
        """Return whether the data differ much from those of the last calibration."""
        # Fewer motions are those of a buffer that started anew.
        driven, motions = self._tried
        return not driven <= excitation.driven <= driven + _MORE_MOTION * motions

    def _calibrate_when_ready(
        self, values: Mapping[str, Any], excitation: Excitation,
    ) -> None:
        """Calibrate once since the start or the last reset; after a failure, with more motion."""
        limits = values['target_translation_std'], values['target_rotation_std']
        if (not self._solver.busy and not self._calibrated and self._has_moved_on(excitation)
                and excitation.sufficient(*limits)):
            self.get_logger().info(f'enough motion ({excitation.motions} s): calibrating')
            self._start_solver(values)

    def _calibration_status(
        self, values: Mapping[str, Any], excitation: Excitation, offset_s: float,
    ) -> DiagnosticStatus:
        session, result = self._session, self._result
        apart_s = time_apart_s(session.buffers[0], session.buffers[1], offset_s)
        if apart_s > 0:
            advice = (f'the stamps of a and b are {apart_s:.3f} s apart: correct the clocks, or '
                      'set time_offset')
        else:
            advice = excitation.advice(
                values['frame_a'] or session.buffers[0].frames[1] or 'sensor a',
                values['target_translation_std'], values['target_rotation_std'])
        status = DiagnosticStatus(
            name=f'{self.get_fully_qualified_name()}: calibration', level=DiagnosticStatus.OK)
        if self._solver.busy:
            status.message = 'calibrating'
        elif self._last_failure and not self._has_moved_on(excitation):
            status.level, status.message = DiagnosticStatus.WARN, self._last_failure
        # A restored answer, or one before a reset, says nothing about what is held.
        elif self._calibrated and not self._last_failure:
            status.message = 'calibrated'
        else:
            status.message = advice
        status.values = key_values({
            'solver': values['solver'],
            'overlap_s': f'{max(0.0, -apart_s):.3f}',
            'time_offset': f'{values["time_offset"]:.4f}',
            'clock_offset_s': self._clock_offset(),
            **pairing_values(count_pairs(
                session.buffers[0], session.buffers[1], round(offset_s * 1e9),
                round(values['max_gap'] * 1e9),
                at_a=self._excitation.at_a and values['association'] == 'auto'), result),
            'advice': advice,
            'last_failure': self._last_failure,
            **excitation_values(excitation),
            **({} if result is None else {
                'extrinsic': headline(result), 'standard_deviations': deviations(result)}),
        })
        return status


def _init(args: Sequence[str] | None) -> None:
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except (RuntimeError, UnicodeEncodeError) as error:
        raise ConfigError(f'ROS arguments: {" ".join(str(error).split())}') from error
    domain = get_default_context().get_domain_id()
    if domain > _HIGHEST_DOMAIN:
        raise ConfigError(f'ROS_DOMAIN_ID is {domain}, needed 0 to {_HIGHEST_DOMAIN}')


def main(args: Sequence[str] | None = None, stop: StopSignals | None = None) -> int:
    """Run the node until a signal, which ``stop`` notes; return the exit status."""
    stop = stop or StopSignals()
    node = None
    try:
        _init(args)
        executor = SingleThreadedExecutor()
        node = CalibrationNode()
        executor.add_node(node)
        while rclpy.ok() and not stop.received:
            executor.spin_once(timeout_sec=0.2)
        node.take_leave(executor)
        executor.shutdown()
    except ConfigError as error:
        get_logger(NODE_NAME).fatal(str(error))
        return 2
    finally:
        if node is not None:
            node.shutdown()
        rclpy.try_shutdown()
    return 0
