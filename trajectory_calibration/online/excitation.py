"""What the motion so far would allow, kept up to date while it is driven.

Two sensors' motions over about a second each, non-overlapping, are summed (``motion_sums``).
A second of driving costs one small update, whatever was driven before; when a tenth of what the
buffers hold has left them, the sums begin anew from the rest. Nothing here imports ROS.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.assessment.observability import axis_name
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.interpolation import left_of
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.online.buffer import PoseBuffer
from trajectory_calibration.online.motion_sums import MotionSums
from trajectory_calibration.solvers.solution import UNKNOWN
from trajectory_calibration.time_alignment.pairing import COINCIDENCE_NS, is_sparser

_STEP_NS = 1_000_000_000
# A motion over more than this, because of a gap, says little: drift and noise have grown.
_LONGEST_NS = 2_500_000_000
# Poses may leave the buffers for so much of the time held before their motions leave the sums.
_SHARE_LEFT = 0.1
# Fewer motions leave no residual to judge the noise by.
_FEWEST = 5

# A standard deviation so many times its limit, or more than this share of what stands for
# unknown, is no number worth naming.
_HOPELESS = 100.0
_UNKNOWN_SHARE = 0.5

# Turns about one axis are all there is where those about the others are less than this share.
_SINGLE = 0.1

_AXES = 'xyz'

# Metres, then degrees.
_UNKNOWN = np.concatenate([UNKNOWN[:3], np.rad2deg(UNKNOWN[3:])])


@dataclass(frozen=True, eq=False)
class Excitation:
    """What the motion so far would allow; axes are those of sensor a.

    Attributes
    ----------
    motions : motions of about a second that both sensors saw.
    driven : the same with those that have left the buffers since these began.
    rotation_deg : (3,) root mean square rotation of a motion about x, y, z, degrees.
    covariance : (6, 6) predicted of an answer, priors included, translation before rotation,
        m^2 and rad^2; as wide as ``assessment.excitation.UNKNOWN`` where nothing is determined.
    missing : (3,) unit vector: the one direction of the translation that the answer may leave
        open; None where there is none, or where it is asked for.

    """

    motions: int
    driven: int
    rotation_deg: FloatArray
    covariance: FloatArray
    missing: FloatArray | None = None

    @property
    def translation_std(self) -> FloatArray:
        """Return (3,) predicted standard deviations of the translation, metres."""
        std: FloatArray = np.sqrt(np.diagonal(self.covariance)[:3])
        return std

    @property
    def rotation_std_deg(self) -> FloatArray:
        """Return (3,) predicted standard deviations of the rotation, degrees."""
        std: FloatArray = np.rad2deg(np.sqrt(np.diagonal(self.covariance)[3:]))
        return std

    def sufficient(self, translation_limit: float, rotation_limit_deg: float) -> bool:
        """Return whether what is asked for is within the limits, metres and degrees."""
        return bool(self.motions >= _FEWEST
                    and (self._ratios(translation_limit, rotation_limit_deg) <= 1.0).all())

    def advice(self, frame_a: str, translation_limit: float, rotation_limit_deg: float) -> str:
        """Return one sentence for the driver."""
        if self.motions < _FEWEST:
            return (f'drive: {self.motions} motions seen by both sensors at the same time, '
                    f'needed {_FEWEST} to judge')
        ratios = self._ratios(translation_limit, rotation_limit_deg)
        worst = int(np.argmax(ratios))
        if ratios[worst] <= 1.0:
            left_out = ('' if self.missing is None else
                        f'; translation along {axis_name(self.missing)} of {frame_a} stays open')
            return f'enough motion: call ~/calibrate{left_out}'
        std = np.concatenate([self.translation_std, self.rotation_std_deg])[worst]
        limit, unit, what = (
            (translation_limit, 'm', 'translation along') if worst < 3 else
            (rotation_limit_deg, 'deg', 'rotation about'))
        unknown = ratios[worst] > _HOPELESS or std > _UNKNOWN_SHARE * _UNKNOWN[worst]
        known = 'is not determined' if unknown else f'has a standard deviation of {std:.2g} {unit}'
        return (f'{self._manoeuvre(worst, frame_a)}: {what} {_AXES[worst % 3]} {known}, '
                f'needed {limit:g} {unit}')

    def _manoeuvre(self, worst: int, frame_a: str) -> str:
        """Return what to drive, or to give, for the worst component."""
        weakest, _, most = np.argsort(self.rotation_deg)
        turned = self.rotation_deg
        if turned[most] and np.sort(turned)[1] <= _SINGLE * turned[most]:
            if worst == most:
                return ('drive a ramp or a bank, or give prior_translation along '
                        f'{_AXES[most]} of {frame_a}')
            if worst == 3 + most:
                return f'drive farther, not on the spot, and curves both ways, for {frame_a}'
        return (f'turn more about {_AXES[weakest]} of {frame_a} ({turned[weakest]:.1f} deg a '
                'second so far)')

    def _ratios(self, translation_limit: float, rotation_limit_deg: float) -> FloatArray:
        """Return (6,) standard deviations over their limits, of what is asked for."""
        translation = self.covariance[:3, :3]
        if self.missing is not None:
            across = np.eye(3) - np.outer(self.missing, self.missing)
            translation = across @ translation @ across
        return np.concatenate([
            np.sqrt(np.maximum(np.diagonal(translation), 0.0)) / translation_limit,
            self.rotation_std_deg / rotation_limit_deg])


class ExcitationMonitor:
    """Follows two buffers and keeps the sums of their motions.

    Attributes
    ----------
    at_a : whether b is interpolated at the stamps of a, which has fewer poses a second, rather
        than a at those of b: as the association 'auto' has it.

    """

    def __init__(self) -> None:
        self.at_a = False
        self._basis = (-1, -1, 0, 0, False)
        # Motions whose poses have left the buffers.
        self._left = 0
        self._clear()

    def update(
        self, a: PoseBuffer, b: PoseBuffer, time_offset_ns: int, max_gap_ns: int,
        config: CalibrationConfig | None = None,
    ) -> Excitation:
        """Take what has arrived since the last call and return the state of things.

        ``config`` is how an answer would be found: its solver, scale, priors, and whether a
        direction may stay open.
        """
        self.at_a = is_sparser(a.stamps_ns, b.stamps_ns)
        # Sums over other poses, or over pairs at another offset or across other gaps, say nothing
        # about these.
        basis = (a.generation, b.generation, time_offset_ns, max_gap_ns, self.at_a)
        if basis != self._basis:
            self._basis = basis
            self._left = 0
            self._clear()
        self._advance(a, b, time_offset_ns, max_gap_ns)
        if self._much_has_left(a, b, time_offset_ns):
            summed = self._sums.motions
            self._clear()
            self._advance(a, b, time_offset_ns, max_gap_ns)
            self._left += summed - self._sums.motions
        return self._state(config or CalibrationConfig())

    def _state(self, config: CalibrationConfig) -> Excitation:
        sums, missing = self._sums, None
        covariance = sums.covariance(config)
        if config.allow_unobserved:
            variances, axes = np.linalg.eigh(covariance[:3, :3])
            if np.sqrt(variances[2]) > config.unobserved_translation:
                missing = axes[:, 2]
        return Excitation(
            sums.motions, sums.motions + self._left, np.rad2deg(sums.rotation_rms()),
            covariance, missing)

    def _much_has_left(self, a: PoseBuffer, b: PoseBuffer, time_offset_ns: int) -> bool:
        span_a, span_b = a.span_ns, b.span_ns
        if span_a is None or span_b is None or self._first_ns is None:
            return False
        oldest_ns = max(span_a[0], span_b[0] + time_offset_ns)
        held_ns = min(span_a[1], span_b[1] + time_offset_ns) - oldest_ns
        return oldest_ns - self._first_ns > max(_SHARE_LEFT * held_ns, _STEP_NS)

    def _clear(self) -> None:
        self._sums = MotionSums()
        # The first instant in the sums.
        self._first_ns: int | None = None
        # The last instant looked at, and the last one with poses of both sensors.
        self._seen_ns = np.iinfo(np.int64).min
        self._stamps_ns = np.empty(0, np.int64)
        self._poses_a = self._poses_b = np.empty((0, 4, 4))

    def _advance(
        self, a: PoseBuffer, b: PoseBuffer, time_offset_ns: int, max_gap_ns: int,
    ) -> None:
        timed, other, offset_ns = (
            (a, b, -time_offset_ns) if self.at_a else (b, a, time_offset_ns))
        span = other.span_ns
        if span is None:
            return
        stamps, rows = timed.after(self._seen_ns)
        # What the other has not reached yet waits for the next call.
        count = int(np.searchsorted(stamps + offset_ns, span[1], side='right'))
        stamps, rows = stamps[:count], rows[:count]
        if not count:
            return
        # The first pose of each second; the seconds themselves are not listed, for one wrong
        # stamp in a Path can make them decades.
        steps = (stamps - stamps[0]) // _STEP_NS
        chosen = np.flatnonzero(np.diff(steps, prepend=-1))
        self._seen_ns = int(stamps[chosen[-1]]) + _STEP_NS - 1
        stamps = stamps[chosen]
        bridged, poses = _poses_at(other, stamps + offset_ns, max_gap_ns)
        poses_a, poses_b = _matrices(rows[chosen][bridged]), poses
        if not self.at_a:
            poses_a, poses_b = poses_b, poses_a
            stamps = stamps + offset_ns
        self._stamps_ns = np.concatenate([self._stamps_ns, stamps[bridged]])
        self._poses_a = np.concatenate([self._poses_a, poses_a])
        self._poses_b = np.concatenate([self._poses_b, poses_b])
        near = np.diff(self._stamps_ns) <= _LONGEST_NS
        self._sums.add(
            (se3.inverse(self._poses_a[:-1]) @ self._poses_a[1:])[near],
            (se3.inverse(self._poses_b[:-1]) @ self._poses_b[1:])[near])
        if self._first_ns is None and len(self._stamps_ns):
            self._first_ns = int(self._stamps_ns[0])
        self._stamps_ns = self._stamps_ns[-1:]
        self._poses_a, self._poses_b = self._poses_a[-1:], self._poses_b[-1:]


def _matrices(rows: FloatArray) -> FloatArray:
    """Return (K, 4, 4) poses of (K, 7) positions and quaternions."""
    q = rows[:, 3:] / np.linalg.norm(rows[:, 3:], axis=1, keepdims=True)
    return se3.from_rotation_translation(se3.quaternion_to_rotation(q), rows[:, :3])


def _poses_at(
    buffer: PoseBuffer, stamps_ns: NDArray[np.int64], max_gap_ns: int,
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Return which of the (K,) stamps lie in no gap of the buffer, and its poses there."""
    stamps, rows = buffer.after(int(stamps_ns[0]) - max_gap_ns - _STEP_NS)
    if len(stamps) < 2:
        return np.zeros(len(stamps_ns), bool), np.empty((0, 4, 4))
    right = left_of(stamps, stamps_ns) + 1
    gap = stamps[right] - stamps[right - 1]
    since = stamps_ns - stamps[right - 1]
    coincides = np.minimum(np.abs(since), np.abs(gap - since)) <= COINCIDENCE_NS
    bridged = ((since >= 0) & (since <= gap) & (gap <= max_gap_ns)) | coincides
    right = right[bridged]
    poses = se3.interpolate(
        _matrices(rows[right - 1]), _matrices(rows[right]), since[bridged] / gap[bridged])
    return bridged, poses
