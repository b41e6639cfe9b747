# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulated drives of kinds of vehicles and sensors, with nothing of the package in them.

A simulator of its own, so that a mistake of the package's cannot hide: the vehicle's pose is a
smooth function of time, sampled at the stamps of each sensor; what real sensors do to it is added.
Every family draws its vehicle, mounting, noise and terms anew from a seed.
"""

from dataclasses import dataclass

import numpy as np

FINE_HZ = 200.0


def skew(v):
    x, y, z = np.moveaxis(np.asarray(v, dtype=float), -1, 0)
    o = np.zeros_like(x)
    return np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1),
                     np.stack([-y, x, o], -1)], -2)


def rotation(vectors):
    """Return (..., 3, 3) of (..., 3) rotation vectors: Rodrigues."""
    v = np.asarray(vectors, dtype=float)
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    K = skew(v)
    s = np.sinc(angle / np.pi)
    c = 0.5 * np.sinc(angle / (2 * np.pi))**2
    return np.eye(3) + s * K + c * (K @ K)


def euler(yaw, pitch, roll):
    z = np.zeros_like(yaw)
    return (rotation(np.stack([z, z, yaw], -1)) @ rotation(np.stack([z, pitch, z], -1))
            @ rotation(np.stack([roll, z, z], -1)))


def smooth(rng, time_s, std, correlation_s):
    """Return a smooth stationary process: white noise through a Gaussian of that width."""
    step = time_s[1] - time_s[0]
    half = max(1, round(3 * correlation_s / step))
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) * step / correlation_s)**2)
    kernel /= np.linalg.norm(kernel)
    return std * np.convolve(rng.normal(size=len(time_s) + 2 * half), kernel, 'valid')


def coloured(rng, stamps_s, std, correlation_s, columns=3):
    """Return (N, columns) of an Ornstein-Uhlenbeck process at the stamps."""
    values = np.empty((len(stamps_s), columns))
    values[0] = rng.normal(size=columns)
    keep = np.exp(-np.diff(stamps_s) / correlation_s)
    drawn = rng.normal(size=(len(keep), columns)) * np.sqrt(1 - keep**2)[:, None]
    for k, factor in enumerate(keep):
        values[k + 1] = factor * values[k] + drawn[k]
    return std * values


@dataclass
class Path:
    """A vehicle's pose in the world over a fine grid of times."""

    time_s: np.ndarray
    R: np.ndarray
    p: np.ndarray

    def at(self, stamps_s):
        """Return (N, 3, 3) and (N, 3) by linear steps of the fine grid."""
        k = np.clip(np.searchsorted(self.time_s, stamps_s, side='right') - 1,
                    0, len(self.time_s) - 2)
        f = (stamps_s - self.time_s[k]) / (self.time_s[k + 1] - self.time_s[k])
        d = np.swapaxes(self.R[k], 1, 2) @ self.R[k + 1]
        # Half the antisymmetric part is the rotation vector of so short a step.
        turn = 0.5 * np.stack([d[:, 2, 1] - d[:, 1, 2], d[:, 0, 2] - d[:, 2, 0],
                               d[:, 1, 0] - d[:, 0, 1]], -1)
        return (self.R[k] @ rotation(f[:, None] * turn),
                self.p[k] + f[:, None] * (self.p[k + 1] - self.p[k]))


def fine(duration_s):
    # Filters and late positions reach before the first stamp and beyond the last one.
    return np.arange(-2.0, duration_s + 2.0, 1 / FINE_HZ)


def car(rng, duration_s, speed, yaw_rate, hills=0.05, turn_s=3.0):
    """Return a vehicle that goes where its nose points, over hills (radians of slope)."""
    t = fine(duration_s)
    v = np.maximum(speed * (1 + smooth(rng, t, 0.3, 8.0)), 0.1 * speed)
    # Turns with straights between: a smooth process whose small values are zero.
    rate = smooth(rng, t, 1.0, turn_s)
    rate = yaw_rate * np.sign(rate) * np.maximum(np.abs(rate) - 0.4, 0.0)
    yaw = rng.uniform(-np.pi, np.pi) + np.cumsum(rate) / FINE_HZ
    way = np.cumsum(v) / FINE_HZ
    pitch, roll = np.zeros_like(t), np.zeros_like(t)
    if hills:
        for length in (15.0, 60.0, 250.0):
            waves = [hills / np.sqrt(3) * np.sin(way * 2 * np.pi / length + phase)
                     for phase in rng.uniform(0, 2 * np.pi, size=2)]
            pitch, roll = pitch + waves[0], roll + waves[1]
        roll = roll - 0.003 * v * rate
    R = euler(yaw, pitch, roll)
    return Path(t, R, np.cumsum(R[:, :, 0] * v[:, None], axis=0) / FINE_HZ)


def free(rng, duration_s, reach, tilt, correlation_s, yaw_rate):
    """Return a body that moves and turns in all directions: drone, hand, arm."""
    t = fine(duration_s)
    p = np.stack([smooth(rng, t, reach, correlation_s) for _ in range(3)], -1)
    pitch, roll = (smooth(rng, t, tilt, 0.5 * correlation_s) for _ in range(2))
    yaw = np.cumsum(smooth(rng, t, yaw_rate, correlation_s)) / FINE_HZ
    return Path(t, euler(yaw, pitch, roll), p)


def legged(rng, duration_s):
    """Return a walking robot: a slow car with the bob, roll and pitch of its gait."""
    base = car(rng, duration_s, rng.uniform(0.5, 1.2), 0.4, hills=0.04, turn_s=2.0)
    t, hertz = base.time_s, rng.uniform(1.6, 2.4)
    phase = 2 * np.pi * hertz * t + 0.5 * smooth(rng, t, 1.0, 5.0)
    roll, pitch = 0.04 * np.sin(phase), 0.03 * np.sin(2 * phase + 1.0)
    R = base.R @ euler(0.02 * np.sin(phase + 0.5), pitch, roll)
    p = base.p + np.stack([0 * t, 0.015 * np.sin(phase), 0.02 * np.sin(2 * phase)], -1)
    return Path(t, R, p)


@dataclass
class Sensor:
    """What a sensor does to the true pose; metres, radians, seconds.

    Attributes
    ----------
    rate_hz, jitter_s : of its stamps; the jitter is not known to the reader.
    white, white_rad : noise of each pose.
    walk, walk_rad : drift after one metre; grows with the root of the way.
    walk_s, walk_s_rad : the same after one second.
    coloured : pairs of (metres, radians, correlation seconds).
    scale, drift : of the lengths of its steps; (3,) metres per metre along its axes.
    gain : of its turning about its z.
    late_s : position older than attitude.
    filter_s : time constant of a low-pass over position and attitude.
    flex_rad, flex_s : of a flexible mounting.
    jumps : number of steps by 5-30 cm and 1-3 degrees.

    """

    rate_hz: float = 10.0
    jitter_s: float = 0.0
    white: float = 0.0
    white_rad: float = 0.0
    walk: float = 0.0
    walk_rad: float = 0.0
    walk_s: float = 0.0
    walk_s_rad: float = 0.0
    coloured: tuple = ()
    scale: float = 1.0
    drift: tuple = (0.0, 0.0, 0.0)
    gain: float = 1.0
    late_s: float = 0.0
    filter_s: float = 0.0
    flex_rad: float = 0.0
    flex_s: float = 1.0
    jumps: int = 0
    phase_s: float = 0.0


def record(rng, path, mount, sensor, duration_s):
    """Return (N,) stamps and (N, 4, 4) poses in the sensor's own world.

    ``mount`` is (R, t), the pose of the sensor in the vehicle.
    """
    stamps = np.arange(sensor.phase_s, duration_s, 1 / sensor.rate_hz)
    taken = stamps + sensor.jitter_s * rng.normal(size=len(stamps))
    R, p = _mounted(path, taken, mount, sensor, rng)
    _, p_late = _mounted(path, taken - sensor.late_s, mount, sensor, None)
    if sensor.late_s:
        p = p_late
    dR = np.swapaxes(R[:-1], 1, 2) @ R[1:]
    dp = np.einsum('kji,kj->ki', R[:-1], np.diff(p, axis=0))
    way, time = np.linalg.norm(dp, axis=1), np.diff(stamps)
    dp = sensor.scale * dp + way[:, None] * np.array(sensor.drift)
    wander = np.sqrt(sensor.walk**2 * way + sensor.walk_s**2 * time)
    wander_rad = np.sqrt(sensor.walk_rad**2 * way + sensor.walk_s_rad**2 * time)
    dp += wander[:, None] * rng.normal(size=dp.shape)
    turn = wander_rad[:, None] * rng.normal(size=dp.shape)
    if sensor.gain != 1.0:
        turn[:, 2] += (sensor.gain - 1) * 0.5 * (dR[:, 1, 0] - dR[:, 0, 1])
    for k in rng.choice(len(dp), sensor.jumps, replace=False):
        dp[k] += rng.uniform(0.05, 0.3) * _unit(rng)
        turn[k] += np.deg2rad(rng.uniform(1, 3)) * _unit(rng)
    dR = dR @ rotation(turn)
    out = np.tile(np.eye(4), (len(stamps), 1, 1))
    out[0, :3, :3], out[0, :3, 3] = rotation(rng.normal(size=3)), rng.normal(size=3)
    for k in range(len(dR)):
        out[k + 1, :3, :3] = out[k, :3, :3] @ dR[k]
        out[k + 1, :3, 3] = out[k, :3, 3] + out[k, :3, :3] @ dp[k]
    # Rounding of thousands of products.
    u, _, v = np.linalg.svd(out[:, :3, :3])
    out[:, :3, :3] = u @ v
    noise = sensor.white * rng.normal(size=p.shape)
    noise_rad = sensor.white_rad * rng.normal(size=p.shape)
    for metres, radians, seconds in sensor.coloured:
        noise = noise + coloured(rng, stamps, metres, seconds)
        noise_rad = noise_rad + coloured(rng, stamps, radians, seconds)
    out[:, :3, 3] += noise
    out[:, :3, :3] = out[:, :3, :3] @ rotation(noise_rad)
    return stamps, out


def _mounted(path, times, mount, sensor, rng):
    if sensor.filter_s:
        # The mean of an exponential memory, by quadrature at its quantiles.
        delays = -sensor.filter_s * np.log(1 - (np.arange(16) + 0.5) / 16)
        parts = [path.at(times - delay) for delay in np.minimum(delays, 1.9)]
        R = np.mean([R for R, _ in parts], axis=0)
        u, _, v = np.linalg.svd(R)
        R, p = u @ v, np.mean([p for _, p in parts], axis=0)
    else:
        R, p = path.at(times)
    at, turned = np.asarray(mount[1]), np.asarray(mount[0])
    p = p + R @ at
    R = R @ turned
    if sensor.flex_rad and rng is not None:
        R = R @ rotation(coloured(rng, times, sensor.flex_rad, sensor.flex_s))
    return R, p


def _unit(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def mounts(rng, reach):
    """Return the poses of two sensors in the vehicle, with any orientation."""
    return [(rotation(rng.normal(size=3)), reach * rng.uniform(-1, 1, size=3)) for _ in range(2)]


@dataclass
class Drive:
    """Two recordings and their extrinsic.

    Attributes
    ----------
    a, b : (stamps in seconds, (N, 4, 4) poses).
    T_a_b : (4, 4).
    third : a third recording and its pose in a, or None.

    """

    a: tuple
    b: tuple
    T_a_b: np.ndarray
    third: tuple | None = None


def drive(rng, path, duration_s, sensors, reach=1.0, *, third=False, upright=False):
    """Return what two (or three) sensors on the path recorded."""
    sensors = list(sensors)
    places = mounts(rng, reach) + mounts(rng, reach)[:int(third)]
    if upright:
        # The vertical is an axis of each sensor, so that on flat ground x and y stay observed.
        places = [(rotation([0, 0, rng.uniform(-np.pi, np.pi)]), at) for _, at in places]
    if third:
        sensors.append(Sensor(walk=0.005, walk_rad=0.0008, white=0.002, white_rad=0.0005))
    recorded = [record(rng, path, place, sensor, duration_s)
                for place, sensor in zip(places, sensors, strict=True)]
    in_a = [_between(places[0], place) for place in places]
    return Drive(recorded[0], recorded[1], in_a[1],
                 (recorded[2], in_a[2]) if third else None)


def _between(one, other):
    T = np.eye(4)
    T[:3, :3] = one[0].T @ other[0]
    T[:3, 3] = one[0].T @ (other[1] - one[1])
    return T


def convoy(seed):
    """Return what one car and another some 1-4 s behind it on the same road recorded.

    The second passes every place as the first did, at a distance that varies by an eighth, on its
    own line within the lane.
    """
    rng = np.random.default_rng([7, seed])
    duration_s, gap_s, speed = 200.0, rng.uniform(1, 4), rng.uniform(8, 14)
    t = fine(duration_s)
    way = np.arange(0, 1.6 * speed * (duration_s + 20), 0.25)
    bend = smooth(rng, way, 1.0, rng.uniform(15, 30))
    bend = rng.uniform(0.02, 0.05) * np.sign(bend) * np.maximum(np.abs(bend) - 0.4, 0)
    heading = 0.25 * np.cumsum(bend)
    first = np.cumsum(np.maximum(speed * (1 + smooth(rng, t, 0.25, 8.0)), 2.0)) / FINE_HZ
    second = np.interp(t - gap_s * (1 + smooth(rng, t, 0.12, 15.0)), t, first)
    waves = [(length, *rng.uniform(0, 2 * np.pi, size=2)) for length in (15.0, 60.0, 250.0)]
    slope, recorded = rng.uniform(0.01, 0.04) / np.sqrt(3), []
    for driven, sensor in ((first, Sensor(**LIDAR)), (second, Sensor(**VISUAL, phase_s=0.03))):
        speed_t = np.gradient(driven, t)
        aside = np.gradient(smooth(rng, t, 0.15, 2.5), t) / np.maximum(speed_t, 1)
        yaw = np.interp(driven, way, heading) + aside
        pitch = smooth(rng, t, 0.003, 0.5) + slope * sum(
            np.sin(driven * 2 * np.pi / length + phase) for length, phase, _ in waves)
        roll = -0.003 * speed_t * np.gradient(yaw, t) + slope * sum(
            np.sin(driven * 2 * np.pi / length + phase) for length, _, phase in waves)
        R = euler(yaw, pitch, roll)
        path = Path(t, R, np.cumsum(R[:, :, 0] * speed_t[:, None], axis=0) / FINE_HZ)
        recorded.append(record(rng, path, mounts(rng, 1.0)[0], sensor, duration_s))
    return recorded


# --- families --------------------------------------------------------------------------------

LIDAR = {'rate_hz': 10.0, 'walk': 0.004, 'walk_rad': 0.0005, 'white': 0.005, 'white_rad': 0.0005}
VISUAL = {'rate_hz': 10.0, 'walk': 0.008, 'walk_rad': 0.0006, 'white': 0.003, 'white_rad': 0.0004}


def _road(rng, seconds):
    return car(rng, seconds, rng.uniform(6, 14), rng.uniform(0.15, 0.35),
               hills=rng.uniform(0.02, 0.05))


def white_noise(rng, *, third=False):
    path = car(rng, 60.0, 2.0, 0.4, hills=0.15)
    noise = {'white': 0.005, 'white_rad': 0.003}
    return drive(rng, path, 60.0, [Sensor(**noise), Sensor(**noise)], third=third)


def car_scale_drift(rng, *, third=False):
    path = _road(rng, 200.0)
    b = Sensor(**VISUAL, scale=1 + 0.01 * rng.normal(), phase_s=0.03,
               drift=tuple(0.002 * rng.standard_t(3, size=3)))
    return drive(rng, path, 200.0, [Sensor(**LIDAR), b], third=third)


def gnss_ins(rng, *, third=False):
    path = _road(rng, 200.0)
    metres, radians = rng.uniform(0.01, 0.03), np.deg2rad(rng.uniform(0.03, 0.1))
    a = Sensor(rate_hz=20.0, coloured=((metres, radians, 30.0),), white=0.002, white_rad=2e-4)
    return drive(rng, path, 200.0, [a, Sensor(**LIDAR, phase_s=0.02)], reach=1.5, third=third)


def wheels_gain(rng, *, third=False):
    if third:
        raise ValueError('wheels give a height of zero: there is no third sensor to compare')
    path = car(rng, 150.0, rng.uniform(1, 3), 0.4, hills=0.0)
    z = rotation([0, 0, rng.uniform(-3, 3)])
    places = [(np.eye(3), np.zeros(3)), (z, rng.uniform(-1, 1, 3))]
    a = Sensor(rate_hz=20.0, gain=1 + 0.015 * rng.normal(), scale=1 + 0.01 * rng.normal(),
               walk=0.003, walk_rad=0.002)
    b = Sensor(**LIDAR)
    recorded = [record(rng, path, place, sensor, 150.0)
                for place, sensor in zip(places, (a, b), strict=True)]
    return Drive(*recorded, _between(*places))


def latency(rng, *, third=False):
    path = _road(rng, 150.0)
    b = Sensor(**VISUAL, late_s=rng.uniform(0.02, 0.1))
    return drive(rng, path, 150.0, [Sensor(**LIDAR), b], third=third)


def filtered(rng, *, third=False):
    path = _road(rng, 150.0)
    b = Sensor(**VISUAL, filter_s=rng.uniform(0.05, 0.2))
    return drive(rng, path, 150.0, [Sensor(**LIDAR), b], third=third)


def jitter(rng, *, third=False):
    path = _road(rng, 150.0)
    return drive(rng, path, 150.0, [Sensor(**LIDAR), Sensor(**VISUAL, jitter_s=0.005)],
                 third=third)


def mast(rng, *, third=False):
    path = _road(rng, 150.0)
    b = Sensor(**LIDAR, flex_rad=np.deg2rad(rng.uniform(0.1, 0.4)), flex_s=rng.uniform(0.3, 2.0))
    return drive(rng, path, 150.0, [Sensor(**VISUAL), b], reach=2.0, third=third)


def arm(rng, *, third=False):
    path = free(rng, 40.0, 0.2, 0.4, 1.5, 0.4)
    a = Sensor(rate_hz=50.0, white=0.0002, white_rad=0.0002)
    b = Sensor(rate_hz=20.0, coloured=((0.004, np.deg2rad(0.3), 0.7),), white=0.001,
               white_rad=0.002)
    return drive(rng, path, 40.0, [a, b], reach=0.15, third=third)


def hand_held(rng, *, third=False):
    path = free(rng, 60.0, 0.8, 0.3, 1.2, 0.6)
    a = Sensor(rate_hz=50.0, white=0.001, white_rad=0.002)
    b = Sensor(rate_hz=20.0, walk=0.01, walk_rad=0.001, white=0.002, white_rad=0.001)
    return drive(rng, path, 60.0, [a, b], reach=0.1, third=third)


def drone(rng, *, third=False):
    path = free(rng, 90.0, 4.0, 0.12, 3.0, 0.4)
    b = Sensor(rate_hz=20.0, walk=0.006, walk_s_rad=0.0004, white=0.002, white_rad=0.0005)
    a = Sensor(rate_hz=20.0, coloured=((0.01, 0.001, 5.0),), white=0.003, white_rad=0.001)
    return drive(rng, path, 90.0, [a, b], reach=0.2, third=third)


def gait(rng, *, third=False):
    path = legged(rng, 120.0)
    a = Sensor(rate_hz=50.0, walk=0.01, walk_rad=0.003, coloured=((0.004, 0.003, 0.25),))
    return drive(rng, path, 120.0, [a, Sensor(**LIDAR)], reach=0.3, third=third)


def forklift(rng, *, third=False):
    path = car(rng, 120.0, rng.uniform(0.8, 2.0), 0.5, hills=0.0, turn_s=2.0)
    return drive(rng, path, 120.0, [Sensor(**LIDAR), Sensor(**VISUAL)], reach=1.0, third=third,
                 upright=True)


FAMILIES = {
    'white noise': white_noise,
    'car, scale and drift': car_scale_drift,
    'GNSS/INS against lidar': gnss_ins,
    'wheels with gain (flat)': wheels_gain,
    'position 20-100 ms late': latency,
    'low-pass 50-200 ms': filtered,
    'jitter of 5 ms': jitter,
    'flexible mast': mast,
    'arm': arm,
    'hand-held': hand_held,
    'drone': drone,
    'legged': gait,
    'forklift (flat)': forklift,
}


def make(name, seed, *, third=False):
    """Return the drive of a family; equal seeds give equal drives."""
    family = sorted(FAMILIES).index(name)
    return FAMILIES[name](np.random.default_rng([family, seed]), third=third)
