# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulate two trajectories with a known extrinsic from a scenario and a seed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from trajectory_calibration.data.trajectory import LARGEST_DRIFT, Trajectory
from trajectory_calibration.errors import ConfigError, counted
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.simulation.noise import Noise
from trajectory_calibration.simulation.paths import flat, hills, Unicycle, Wander

# A day in 2023: stamps have as many digits as real ones.
START_NS = 1_700_000_000_000_000_000

# Limit for one sensor: two days at 100 hertz, a few gigabytes of memory.
_MAX_POSES = 20_000_000


@dataclass(frozen=True)
class Sensor:
    """The poses that the SLAM of one sensor reports.

    Attributes
    ----------
    rate : poses per second.
    noise : errors of the poses.
    clock_offset : how far its clock is ahead at the start, seconds.
    clock_drift : how much faster its clock runs, seconds per second.
    gaps : number of intervals without poses, at random times.
    gap : length of each, seconds.
    sensor_frame, world_frame : names of the frames.

    """

    rate: float = 10.0
    noise: Noise = field(default_factory=Noise)
    clock_offset: float = 0.0
    clock_drift: float = 0.0
    gaps: int = 0
    gap: float = 1.0
    sensor_frame: str = 'lidar'
    world_frame: str = 'lidar_map'

    def __post_init__(self) -> None:
        if not 0 < self.rate <= 1e6:
            raise ConfigError(f'rate is {self.rate}, needed above 0 and up to 1e6 hertz')
        # The seconds of a ROS stamp are 32 bits, here from 0 up.
        low, high = -1_700_000_000, 400_000_000
        if not low <= self.clock_offset <= high:
            raise ConfigError(
                f'clock offset is {self.clock_offset}, needed {low} to {high} s')
        if not abs(self.clock_drift) <= LARGEST_DRIFT:
            raise ConfigError(
                f'clock drift is {self.clock_drift}, needed plus or minus {LARGEST_DRIFT} s/s')
        if not (self.gaps >= 0 and self.gap >= 0):
            raise ConfigError(
                f'{self.gaps} gaps of {self.gap} s are asked for; needed numbers from 0 up')


@dataclass(frozen=True)
class Scenario:
    """Two sensors on one base.

    Attributes
    ----------
    duration : seconds.
    motion : how the base, which is sensor a, moves.
    a, b : the sensors.

    """

    duration: float = 9.9
    motion: Unicycle | Wander = field(default_factory=Unicycle)
    a: Sensor = field(default_factory=Sensor)
    b: Sensor = field(default_factory=lambda: Sensor(
        sensor_frame='camera', world_frame='camera_map'))

    def __post_init__(self) -> None:
        if not 0 < self.duration <= 1e6:
            raise ConfigError(f'duration is {self.duration}, needed above 0 and up to 1e6 s')
        for sensor in (self.a, self.b):
            poses = _count(self.duration, sensor.rate)
            if not 2 <= poses <= _MAX_POSES:
                raise ConfigError(
                    f'{self.duration} s at {sensor.rate} hertz are {counted(poses, "pose")} of '
                    f'{sensor.sensor_frame}, needed ' + (
                        'at least 2; raise the duration or the rate' if poses < 2 else
                        f'at most {_MAX_POSES:,}; lower the duration or the rate'))


class SimulatedPair(NamedTuple):
    """The trajectories of both sensors, and the true (4, 4) pose of sensor b in sensor a."""

    a: Trajectory
    b: Trajectory
    T_a_b: FloatArray


def simulate(scenario: Scenario, seed: int, T_a_b: FloatArray | None = None) -> SimulatedPair:
    """Draw one run of a scenario.

    The generator of Välimäki, Garigipati, Ghabcheloo, Sensors 23(7):3740, 2023,
    doi:10.3390/s23073740, section IV-A, with more errors of real sensors. The same seed gives
    the same motion, extrinsic and world frames with any noise. ``T_a_b``, (4, 4), is the
    extrinsic; by default it is drawn from the seed.
    """
    for_path, for_frames, for_a, for_b = np.random.SeedSequence(seed).spawn(4)
    path = scenario.motion.draw(scenario.duration, np.random.default_rng(for_path))
    rng = np.random.default_rng(for_frames)
    drawn, T_worldb_worlda = random_pose(rng), random_pose(rng)
    T_a_b = drawn if T_a_b is None else T_a_b
    poses_a, poses_b = (path(np.arange(_count(scenario.duration, sensor.rate)) / sensor.rate)
                        for sensor in (scenario.a, scenario.b))
    return SimulatedPair(
        simulate_sensor(scenario.a, scenario.duration, poses_a, for_a),
        simulate_sensor(scenario.b, scenario.duration, T_worldb_worlda @ poses_b @ T_a_b, for_b),
        T_a_b)


def random_pose(rng: np.random.Generator) -> FloatArray:
    """Draw a (4, 4) pose: rotation uniform over SO(3), translation in plus or minus 0.5 m."""
    quaternion = rng.standard_normal(4)
    return se3.from_rotation_translation(
        se3.quaternion_to_rotation(quaternion / np.linalg.norm(quaternion)),
        rng.uniform(-0.5, 0.5, 3))


def _count(duration: float, rate: float) -> int:
    # 1e-6 against rounding: the last sample stays if duration * rate is a whole number.
    return int(duration * rate + 1e-6) + 1


def simulate_sensor(
    sensor: Sensor, duration: float, poses: FloatArray, seed: np.random.SeedSequence,
) -> Trajectory:
    """Return the trajectory that the SLAM of a sensor reports for (N, 4, 4) true poses."""
    for_noise, for_gaps = seed.spawn(2)
    times = np.arange(len(poses)) / sensor.rate
    starts = np.random.default_rng(for_gaps).uniform(0, max(duration - sensor.gap, 0), sensor.gaps)
    hidden = ((times >= starts[:, None]) & (times < starts[:, None] + sensor.gap)).any(axis=0)
    clock = times * (1 + sensor.clock_drift) + sensor.clock_offset
    stamps_ns = START_NS + np.rint(clock * 1e9).astype(np.int64)
    disturbed = sensor.noise.disturb(poses, 1 / sensor.rate, for_noise)
    return Trajectory(stamps_ns[~hidden], disturbed[~hidden],
                      sensor.world_frame, sensor.sensor_frame)


def with_noise(scenario: Scenario, a: Noise, b: Noise) -> Scenario:
    """Return the scenario with the noise of both sensors replaced."""
    return replace(scenario, a=replace(scenario.a, noise=a), b=replace(scenario.b, noise=b))


def paper_scenario(*, white: float = 0.0, jumps: int = 0, drift: float = 0.0) -> Scenario:
    """Return the paper's scenario: noise and jumps on both trajectories, drift on b."""
    both = Noise(white=white, jumps=jumps)
    scenario = Scenario(motion=Unicycle(as_published=True))
    return with_noise(scenario, both, replace(both, drift=drift))


def _field_scenario(duration: float, motion: Unicycle | Wander) -> Scenario:
    """Return a scenario with SLAM of a lidar at 10 Hz and of a camera at 20 Hz."""
    slam = Noise(white=0.005, white_rotation=0.001, walk=0.005, walk_rotation=0.0005)
    scenario = with_noise(Scenario(duration, motion), slam, replace(slam, drift=0.005))
    return replace(scenario, b=replace(scenario.b, rate=20.0))


# The paper's classes at their hardest level, then other motions and sensors.
SCENARIOS: dict[str, Scenario] = {
    'noise': paper_scenario(white=0.01),
    'outliers': paper_scenario(jumps=10),
    'drift': paper_scenario(drift=0.05),
    'mixture': paper_scenario(white=0.005, jumps=5, drift=0.025),
    'offroad': _field_scenario(
        120.0, Unicycle(speed=5.0, yaw_rate=0.6, hold=2.0, ground=hills)),
    'road': _field_scenario(
        120.0, Unicycle(speed=15.0, yaw_rate=0.3, hold=2.0, ground=flat)),
    'drone': _field_scenario(60.0, Wander()),
    'handheld': _field_scenario(
        60.0, Wander(reach=0.8, tilt=0.5, turn=0.8, frequency=0.5)),
}
