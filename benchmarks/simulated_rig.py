# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Several sensors on one base: their trajectories, and where each of them truly is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import ConfigError
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.simulation.noise import Noise
from trajectory_calibration.simulation.paths import hills, Unicycle, Wander
from trajectory_calibration.simulation.scenario import random_pose, Sensor, simulate_sensor


@dataclass(frozen=True)
class Fault:
    """What is wrong with one sensor.

    Attributes
    ----------
    moved : metres by which its mount moves, in a random direction, half-way.
    late : seconds by which its stamps are late.
    elsewhere : whether it rides on another vehicle.

    """

    moved: float = 0.0
    late: float = 0.0
    elsewhere: bool = False


@dataclass(frozen=True)
class RigScenario:
    """Sensors on one base.

    Attributes
    ----------
    sensors : by name; the first is the base.
    duration : seconds.
    motion : how the base moves.
    faults : by the name of the sensor.
    steady_drift : standard deviation of what a drifting sensor drifts steadily besides, metres a
        metre, along one axis; each run draws it.
    latency : standard deviation of the seconds by which positions are older than attitudes.

    """

    sensors: Mapping[str, Sensor]
    duration: float = 120.0
    motion: Unicycle | Wander = field(default_factory=lambda: Unicycle(
        speed=5.0, yaw_rate=0.6, hold=2.0, ground=hills))
    faults: Mapping[str, Fault] = field(default_factory=dict)
    steady_drift: float = 0.0
    latency: float = 0.0


@dataclass(frozen=True, eq=False)
class SimulatedRig:
    """What the sensors report, and the truth.

    Attributes
    ----------
    trajectories : by name.
    T_base_sensor : (4, 4) by name, the true pose of each sensor in the base sensor.

    """

    trajectories: dict[str, Trajectory]
    T_base_sensor: dict[str, FloatArray]


def simulate_rig(scenario: RigScenario, seed: int) -> SimulatedRig:
    """Draw one run; the same seed gives the same motion and mounts whatever the noise."""
    for_path, for_frames, for_sensors, for_faults = np.random.SeedSequence(seed).spawn(4)
    path = scenario.motion.draw(scenario.duration, np.random.default_rng(for_path))
    other = scenario.motion.draw(scenario.duration, np.random.default_rng(for_faults.spawn(1)[0]))
    frames, faults = np.random.default_rng(for_frames), np.random.default_rng(for_faults)
    steady = np.random.default_rng(for_faults.spawn(1)[0])
    trajectories: dict[str, Trajectory] = {}
    truth: dict[str, FloatArray] = {}
    for (name, sensor), noise_seed in zip(
            scenario.sensors.items(), for_sensors.spawn(len(scenario.sensors)), strict=True):
        T_base_sensor = random_pose(frames) if truth else np.eye(4)
        T_world = random_pose(frames)
        fault = scenario.faults.get(name, Fault())
        times = np.arange(int(scenario.duration * sensor.rate + 1e-6) + 1) / sensor.rate
        mount = np.broadcast_to(T_base_sensor, (len(times), 4, 4)).copy()
        direction = faults.standard_normal(3)
        mount[times > scenario.duration / 2, :3, 3] += (
            fault.moved * direction / np.linalg.norm(direction))
        driven = other if fault.elsewhere else path
        poses = T_world @ driven(times) @ mount
        late_s, drift = steady.standard_normal(2) * [scenario.latency, scenario.steady_drift]
        if late_s:
            poses[:, :3, 3] = (T_world @ driven(times - late_s) @ mount)[:, :3, 3]
        noise = sensor.noise if not sensor.noise.walk else replace(
            sensor.noise, drift=sensor.noise.drift + abs(float(drift)))
        late = replace(sensor, clock_offset=sensor.clock_offset + fault.late, sensor_frame=name,
                       world_frame=f'{name}_map', noise=noise)
        trajectories[name] = simulate_sensor(late, scenario.duration, poses, noise_seed)
        truth[name] = T_base_sensor
    return SimulatedRig(trajectories, truth)


_LIDAR = Noise(white=0.01, white_rotation=0.001, walk=0.008, walk_rotation=0.0006)
_GNSS = Noise(white=0.02, white_rotation=0.002)
_MONO = Noise(white=0.003, white_rotation=0.0012, walk=0.004, walk_rotation=0.0008, jumps=1,
              scale=0.37)
_STEREO = Noise(white=0.006, white_rotation=0.001, walk=0.01, walk_rotation=0.0007, drift=0.002)
_WHEELS = Noise(white=0.002, white_rotation=0.0005, walk=0.03, walk_rotation=0.003, drift=0.004)
_RADAR = Noise(white=0.02, white_rotation=0.003, walk=0.02, walk_rotation=0.0015)

# Mixed rates and clocks, one monocular camera, drift and jumps.
_SENSORS = {
    'lidar': Sensor(rate=10.0, noise=_LIDAR),
    'gnss': Sensor(rate=20.0, noise=_GNSS),
    'mono': Sensor(rate=10.0, noise=_MONO, clock_offset=0.035),
    'stereo': Sensor(rate=15.0, noise=_STEREO, clock_offset=-0.012),
    'wheels': Sensor(rate=25.0, noise=_WHEELS),
    'radar': Sensor(rate=8.0, noise=_RADAR, clock_offset=0.060),
    'lidar_rear': Sensor(rate=10.0, noise=_LIDAR, clock_offset=0.003),
    'camera_rear': Sensor(rate=12.0, noise=replace(_STEREO, jumps=2), clock_offset=0.02),
}


def rig_scenario(sensors: int, duration: float = 120.0) -> RigScenario:
    """Return a vehicle off the road with the first of eight sensors, two or more.

    Raises
    ------
    ConfigError
        Fewer than two, or more than eight.

    """
    if not 2 <= sensors <= len(_SENSORS):
        raise ConfigError(f'{sensors} sensors, needed 2 to {len(_SENSORS)}')
    return RigScenario(dict(list(_SENSORS.items())[:sensors]), duration)
