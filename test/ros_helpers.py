# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A running node and a client of it, over real DDS, isolated from everything else.

Test modules import it through ``ros_if_any``, which does without ROS, too.
"""

from contextlib import contextmanager
import itertools
import os
import pathlib
import resource
import signal
import subprocess
import sys
import time
from unittest import mock

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    PoseWithCovarianceStamped,
    Quaternion,
    Transform,
    TransformStamped,
    Vector3,
)
from nav_msgs.msg import Odometry, Path
import numpy as np
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header, String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from trajectory_calibration.geometry import se3
from trajectory_calibration.online.buffer import BufferLimits, PoseBuffer
from trajectory_calibration.ros.diagnostics import InputMonitor

__all__ = [
    'BufferLimits',
    'Client',
    'Clock',
    'DescribeParameters',
    'DiagnosticArray',
    'DurabilityPolicy',
    'Future',
    'GetParameters',
    'InputMonitor',
    'ListParameters',
    'MarkerArray',
    'NodeProcess',
    'Parameter',
    'PoseBuffer',
    'QoSProfile',
    'ReliabilityPolicy',
    'SetParameters',
    'String',
    'connected',
    'drive',
    'matrix',
    'parameter_value_to_python',
    'running',
    'serialize_message',
    'to_message',
    'to_path',
    'to_transform',
]

# Long enough for a machine with ten times more work than cores.
LIMIT_S = 90.0
TYPES = {
    'Odometry': Odometry,
    'PoseStamped': PoseStamped,
    'PoseWithCovarianceStamped': PoseWithCovarianceStamped,
    'TransformStamped': TransformStamped,
    'Path': Path,
}
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=5000)

# What a client calls, by the name below the node.
SERVICES = {
    'calibrate': Trigger,
    'reset': Trigger,
    'save': Trigger,
    'set_parameters': SetParameters,
    'get_parameters': GetParameters,
    'list_parameters': ListParameters,
    'describe_parameters': DescribeParameters,
}

# Alone on this machine, and found soon.
ENVIRONMENT = {
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
    'FASTRTPS_DEFAULT_PROFILES_FILE': str(pathlib.Path(__file__).with_name('discovery.xml')),
}

# How long an answer that changes nothing is waited for before it is asked for again.
ASK_AGAIN_S = 0.5

# Where the extrinsic of every simulated pair lies.
T_A_B = se3.exp_se3([0.3, -0.2, 0.1, 0.4, -0.3, 1.2])

_numbers = itertools.count(os.getpid())


def drive(poses=100, rate_hz=10.0, start_s=1000.0, seed=3, *, planar=False):
    """Return (N,) stamps and the (N, 4, 4) poses of both sensors on a noise-free drive.

    In three dimensions, or on flat ground.
    """
    rng = np.random.default_rng(seed)
    time_s = np.arange(poses) / rate_hz
    phases, rates = rng.uniform(0, 6, (2, 6)), rng.uniform(0.3, 1.2, (2, 6))
    amplitudes = np.array([[0.05] * 3 + [0.06] * 3, [0.03] * 3 + [0.04] * 3])
    amplitudes[0, 0] = 0.1
    if planar:
        amplitudes[:, 2:5] = 0.0
    twists = (amplitudes[:, None] * np.sin(time_s[:, None] * rates[:, None] + phases[:, None]))
    steps = se3.exp_se3(twists.sum(0))
    T_w_a = np.empty_like(steps)
    T_w_a[0] = np.eye(4)
    for k in range(1, poses):
        T_w_a[k] = T_w_a[k - 1] @ steps[k]
    T_v_b = se3.exp_se3([5.0, -2.0, 1.0, 0.2, 0.1, -0.9]) @ T_w_a @ T_A_B
    stamps_ns = (np.round((start_s + time_s) * 1e9)).astype(np.int64)
    return stamps_ns, T_w_a, T_v_b


def to_message(type_name, stamp_ns, T_w_s, frame='map', child='sensor'):
    """Return one pose as a message of the type (not Path)."""
    header = Header(frame_id=frame)
    header.stamp.sec, header.stamp.nanosec = divmod(int(stamp_ns), 1_000_000_000)
    x, y, z = map(float, T_w_s[:3, 3])
    qx, qy, qz, qw = map(float, se3.rotation_to_quaternion(T_w_s[:3, :3]))
    pose = Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))
    if type_name == 'Odometry':
        return Odometry(
            header=header, child_frame_id=child, pose=PoseWithCovariance(pose=pose))
    if type_name == 'PoseStamped':
        return PoseStamped(header=header, pose=pose)
    if type_name == 'TransformStamped':
        return TransformStamped(header=header, child_frame_id=child, transform=Transform(
            translation=Vector3(x=x, y=y, z=z), rotation=pose.orientation))
    return PoseWithCovarianceStamped(header=header, pose=PoseWithCovariance(pose=pose))


def to_transform(stamp_ns, T, parent, child):
    """Return a (4, 4) transform as a message."""
    message = TransformStamped(header=Header(frame_id=parent), child_frame_id=child)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(int(stamp_ns), 10**9)
    t, q = message.transform.translation, message.transform.rotation
    t.x, t.y, t.z = map(float, T[:3, 3])
    q.x, q.y, q.z, q.w = map(float, se3.rotation_to_quaternion(T[:3, :3]))
    return message


def to_path(stamps_ns, poses, frame='map'):
    """Return a whole trajectory as one message."""
    return Path(header=Header(frame_id=frame), poses=[
        to_message('PoseStamped', stamp, pose, frame)
        for stamp, pose in zip(stamps_ns, poses, strict=True)])


def heed_hangup():
    """Undo what nohup does, under which tests may run: a child would ignore SIGHUP, too."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


class NodeProcess:
    """``calibration_node`` in a process of its own; its log goes to a file."""

    def __init__(self, folder, domain, namespace, arguments=(), environment=None):
        self.log_path = folder / f'node_{next(_numbers)}.log'
        environment = {**os.environ, **ENVIRONMENT, **(environment or {}),
                       'ROS_DOMAIN_ID': str(domain), 'ROS_LOG_DIR': str(folder),
                       'OMP_NUM_THREADS': '1'}
        with self.log_path.open('wb') as log:
            self.process = subprocess.Popen(
                [sys.executable, '-m', 'trajectory_calibration.ros.executable', '--ros-args',
                 '-r', f'__ns:={namespace}', '-p', 'diagnostic_updater.period:=0.1', *arguments],
                stdout=log, stderr=subprocess.STDOUT, env=environment,
                preexec_fn=heed_hangup)  # noqa: PLW1509

    @property
    def log(self):
        """What the node has written so far."""
        return self.log_path.read_text(errors='replace')

    def stop(self, number=signal.SIGINT):
        """Send a signal; return the exit status and the CPU seconds that the end took.

        Of the processor, not of the clock: other work on the machine is not the node's.
        """
        stat = pathlib.Path(f'/proc/{self.process.pid}/stat').read_text()
        fields = stat.rpartition(')')[2].split()
        before = (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
        ended = resource.getrusage(resource.RUSAGE_CHILDREN)
        self.process.send_signal(number)
        status = self.process.wait(LIMIT_S)
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return status, (
            used.ru_utime + used.ru_stime - ended.ru_utime - ended.ru_stime - before)


class Client:
    """The rest of the vehicle: publishes trajectories, calls services, listens."""

    def __init__(self, domain, namespace):
        self.domain, self.namespace = domain, namespace
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node('client', namespace=namespace, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.diagnostics = {}
        self._services = {name: self._service(name) for name in SERVICES}
        self._met = False
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)

    def close(self):
        """Leave the graph."""
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def wait(self, condition, what='the condition'):
        """Spin until the condition holds; fail after the limit."""
        deadline = time.monotonic() + LIMIT_S
        while not condition():
            if time.monotonic() > deadline:
                raise TimeoutError(f'waited {LIMIT_S:g} s for {what}')
            self.executor.spin_once(timeout_sec=0.05)

    def spin(self, seconds):
        """Receive for that long."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self.executor.spin_once(timeout_sec=0.05)

    def publisher(self, topic, type_name='Odometry', qos=RELIABLE):
        """Return a publisher that the node has found."""
        publisher = self.node.create_publisher(TYPES[type_name], topic, qos)
        self.wait(lambda: publisher.get_subscription_count() > 0, f'a subscription on {topic}')
        return publisher

    def publish_drive(self, stamps_ns, poses_a, poses_b, types=('Odometry', 'Odometry')):
        """Publish both trajectories whole and wait until the node holds them."""
        publishers = [
            self.publisher(topic, type_name)
            for topic, type_name in zip(('trajectory_a', 'trajectory_b'), types, strict=True)]
        frames = (('map', 'lidar'), ('odom', 'camera'))
        for publisher, type_name, poses, (frame, child) in zip(
                publishers, types, (poses_a, poses_b), frames, strict=True):
            if type_name == 'Path':
                publisher.publish(to_path(stamps_ns, poses, frame))
                continue
            for stamp, pose in zip(stamps_ns, poses, strict=True):
                publisher.publish(to_message(type_name, stamp, pose, frame, child))
        self.wait_for_poses(len(stamps_ns), len(stamps_ns))
        return publishers

    def wait_for_poses(self, count_a, count_b):
        """Wait until the diagnostics say that so many poses are held."""
        self.wait(lambda: (self.value('trajectory_a', 'poses') == str(count_a)
                           and self.value('trajectory_b', 'poses') == str(count_b)),
                  f'{count_a} and {count_b} poses')

    def value(self, part, key):
        """Return a value of the latest diagnostics, or None."""
        status = self.status(part)
        return None if status is None else {v.key: v.value for v in status.values}.get(key)

    def status(self, part):
        """Return the latest diagnostic status of a part of the node, or None."""
        return self.diagnostics.get(f'{self.namespace}/trajectory_calibration: {part}')

    def _service(self, name):
        return self.node.create_client(SERVICES[name], f'trajectory_calibration/{name}')

    def meet(self):
        """Wait until the node knows every endpoint that this client has made so far.

        A client may have found a service whose node has not found the client. Fast DDS drops the
        answer then, 0.1 s after it was given, and the call waits for ever. Discovery goes in the
        order in which endpoints were made: once a newer client of a service has an answer, so
        will the older ones. Listing parameters changes nothing, and may be asked for again.
        """
        newest = self._service('list_parameters')
        self.wait(newest.service_is_ready, 'the node')
        asked_s, answers = -ASK_AGAIN_S, []

        def answered():
            nonlocal asked_s
            if time.monotonic() - asked_s >= ASK_AGAIN_S:
                asked_s = time.monotonic()
                answers.append(newest.call_async(ListParameters.Request()))
            return any(map(Future.done, answers))
        self.wait(answered, 'a first answer')
        self.node.destroy_client(newest)
        self._met = True

    def start_call(self, name, request=None):
        """Call a service of the node, once; return the future of its answer."""
        if not self._met:
            self.meet()
        service = self._services[name]
        self.wait(service.service_is_ready, f'the service {name}')
        return service.call_async(SERVICES[name].Request() if request is None else request)

    def call(self, name, request=None):
        """Call a service of the node, once, and return its answer."""
        future = self.start_call(name, request)
        self.wait(future.done, f'the answer of {name}')
        return future.result()

    def set_parameter(self, name, value):
        """Set a parameter of the node; return the result."""
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()])
        return self.call('set_parameters', request).results[0]

    def latched(
        self, topic='trajectory_calibration/extrinsic', kind=TransformStamped, qos=LATCHED,
    ):
        """Return a list that receives the messages of a latched topic."""
        messages = []

        def receive(message):
            messages.append(message)
        self.node.create_subscription(kind, topic, receive, qos)
        return messages

    def _on_diagnostics(self, message):
        for status in message.status:
            self.diagnostics[status.name] = status


@contextmanager
def connected(namespace=None, domain=None):
    """Yield a client, by default alone in a domain of its own."""
    number = next(_numbers)
    # Each process of a parallel run counts in a range of its own.
    worker = int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0')[2:])
    domain = domain or 1 + 50 * (worker % 2) + number % 50
    namespace = namespace or f'/test_{os.getpid()}_{number}'
    with mock.patch.dict(os.environ, ENVIRONMENT):
        client = Client(domain, namespace)
        try:
            yield client
        finally:
            client.close()


@contextmanager
def running(folder, *arguments, namespace=None, domain=None, environment=None):
    """Yield a node in its own process and a client of it, as ``connected``."""
    with connected(namespace, domain) as client:
        node = NodeProcess(
            folder, client.domain, client.namespace, arguments, environment)
        try:
            yield node, client
        finally:
            if node.process.poll() is None:
                node.process.kill()
            node.process.wait(LIMIT_S)


def matrix(message):
    """Return the (4, 4) transform of a TransformStamped."""
    t, q = message.transform.translation, message.transform.rotation
    R = se3.quaternion_to_rotation([q.x, q.y, q.z, q.w])
    return se3.from_rotation_translation(R, [t.x, t.y, t.z])
