"""What the motion so far would allow, kept up to date while it is driven.

Two sensors' motions over about a second each, non-overlapping, are enough for the separable
least-squares solution (``solvers.separable``), and that needs nothing but sums of fixed size:
with phi the rotation vectors and t the translations of a motion, D = R_A - I,

    R_a_b from sum phi_A phi_B^T,   t_a_b from (sum D^T D) t = sum D^T (R_a_b t_B - t_A),

their residuals and hence the standard deviations of an answer. The excitation is taken from the
product of what a and b saw, whose noises are independent: noise alone does not count as motion.
A second of driving costs one small update, whatever was driven before; when a tenth of what the
buffers hold has left them, the sums begin anew from the rest. Nothing here imports ROS.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration import se3
from trajectory_calibration.association import COINCIDENCE_NS, is_sparser
from trajectory_calibration.interpolation import left_of
from trajectory_calibration.ros.buffer import PoseBuffer
from trajectory_calibration.se3 import FloatArray

_STEP_NS = 1_000_000_000
# A motion over more than this, because of a gap, says little: drift and noise have grown.
_LONGEST_NS = 2_500_000_000
# Poses may leave the buffers for so much of the time held before their motions leave the sums.
_SHARE_LEFT = 0.1
# Fewer motions leave no residual to judge the noise by.
_FEWEST = 5

# A standard deviation so many times its limit is no number worth naming.
_HOPELESS = 100.0

_AXES = 'xyz'


@dataclass(frozen=True, eq=False)
class Excitation:
    """What the motion so far would allow; axes are those of sensor a.

    Attributes
    ----------
    motions : motions of about a second that both sensors saw.
    driven : the same with those that have left the buffers since these began.
    rotation_deg : (3,) root mean square rotation of a motion about x, y, z, degrees.
    translation_std : (3,) predicted standard deviations of the translation, metres.
    rotation_std_deg : (3,) predicted standard deviations of the rotation, degrees. Infinite
        where nothing is determined.

    """

    motions: int
    driven: int
    rotation_deg: FloatArray
    translation_std: FloatArray
    rotation_std_deg: FloatArray

    def sufficient(self, translation_limit: float, rotation_limit_deg: float) -> bool:
        """Return whether all standard deviations are within the limits, metres and degrees."""
        return bool((self.translation_std <= translation_limit).all()
                    and (self.rotation_std_deg <= rotation_limit_deg).all())

    def advice(self, frame_a: str, translation_limit: float, rotation_limit_deg: float) -> str:
        """Return one sentence for the driver."""
        if self.motions < _FEWEST:
            return (f'drive: {self.motions} motions seen by both sensors at the same time, '
                    f'needed {_FEWEST} to judge')
        ratios = np.concatenate([
            self.translation_std / translation_limit, self.rotation_std_deg / rotation_limit_deg])
        worst = int(np.argmax(ratios))
        if ratios[worst] <= 1.0:
            return 'enough motion: call ~/calibrate'
        axis = _AXES[worst % 3]
        what, std, limit, unit = (
            ('translation along', self.translation_std[worst], translation_limit, 'm')
            if worst < 3 else
            ('rotation about', self.rotation_std_deg[worst - 3], rotation_limit_deg, 'deg'))
        known = ('is not determined' if ratios[worst] > _HOPELESS else
                 f'has a standard deviation of {std:.2g} {unit}')
        weakest = int(np.argmin(self.rotation_deg))
        return (f'turn more about {_AXES[weakest]} of {frame_a} ({self.rotation_deg[weakest]:.1f} '
                f'deg a second so far): {what} {axis} {known}, needed {limit:g} {unit}')


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
    ) -> Excitation:
        """Take what has arrived since the last call and return the state of things."""
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
        return self._sums.excitation(self._left)

    def _much_has_left(self, a: PoseBuffer, b: PoseBuffer, time_offset_ns: int) -> bool:
        span_a, span_b = a.span_ns, b.span_ns
        if span_a is None or span_b is None or self._first_ns is None:
            return False
        oldest_ns = max(span_a[0], span_b[0] + time_offset_ns)
        held_ns = min(span_a[1], span_b[1] + time_offset_ns) - oldest_ns
        return oldest_ns - self._first_ns > max(_SHARE_LEFT * held_ns, _STEP_NS)

    def _clear(self) -> None:
        self._sums = _MotionSums()
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


class _MotionSums:
    """The sums of the module's formulas."""

    def __init__(self) -> None:
        self.motions = 0
        self._phi_a_phi_b = np.zeros((3, 3))
        self._weighted = np.zeros((3, 3))
        self._rotation_energy = 0.0
        self._DtD = np.zeros((3, 3))
        self._D_t_b = np.zeros((3, 3, 3))
        self._Dt_t_a = np.zeros(3)
        self._t_b_t_a = np.zeros((3, 3))
        self._translation_energy = 0.0

    def add(self, A: FloatArray, B: FloatArray) -> None:
        """Add (M, 4, 4) motions of both sensors."""
        phi_a, phi_b = se3.log_so3(A[:, :3, :3]), se3.log_so3(B[:, :3, :3])
        t_a, t_b = A[:, :3, 3], B[:, :3, 3]
        D = A[:, :3, :3] - np.eye(3)
        half = np.linalg.norm(phi_a, axis=1) / 2
        # |D v|^2 = (sin half / half)^2 |phi x v|^2.
        weight = np.sinc(half / np.pi)**2
        self.motions += len(A)
        self._phi_a_phi_b += phi_a.T @ phi_b
        self._weighted += (phi_a * weight[:, None]).T @ phi_b
        self._rotation_energy += float(np.sum(phi_a**2) + np.sum(phi_b**2))
        self._DtD += np.einsum('kmi,kmj->ij', D, D)
        self._D_t_b += np.einsum('kmi,kl->iml', D, t_b)
        self._Dt_t_a += np.einsum('kmi,km->i', D, t_a)
        self._t_b_t_a += t_b.T @ t_a
        self._translation_energy += float(np.sum(t_a**2) + np.sum(t_b**2))

    def excitation(self, left: int) -> Excitation:
        """Return what the sums say, after ``left`` motions that are no longer in them."""
        R = se3.nearest_rotation(self._phi_a_phi_b)
        seen = _symmetric(self._phi_a_phi_b @ R.T)
        rms = np.sqrt(np.maximum(np.diag(seen), 0.0) / max(1, self.motions))
        if self.motions < _FEWEST:
            unknown = np.full(3, np.inf)
            return Excitation(
                self.motions, self.motions + left, np.rad2deg(rms), unknown, unknown)
        freedom = 3 * self.motions - 3
        rotation_residual = self._rotation_energy - 2 * np.sum(R * self._phi_a_phi_b)
        rotation = _covariance(rotation_residual / freedom, _inverse(_seen_across(seen)))
        Dt_R_t_b = np.einsum('iml,ml->i', self._D_t_b, R)
        right = Dt_R_t_b - self._Dt_t_a
        t = np.linalg.lstsq(self._DtD, right, rcond=None)[0]
        translation_residual = (
            self._translation_energy - 2 * np.sum(R * self._t_b_t_a.T) - right @ t)
        information = _inverse(_seen_across(_symmetric(self._weighted @ R.T)))
        # An error of the rotation turns every t_B and moves the translation with it.
        turned = np.einsum('iml,jl->imj', self._D_t_b, R)
        lever = np.einsum('imj,mjk->ik', turned, _LEVI_CIVITA)
        moved = information @ lever if np.isfinite(information).all() else np.zeros((3, 3))
        translation = _covariance(translation_residual / freedom, information)
        if np.isfinite(rotation).all():
            translation = translation + moved @ rotation @ moved.T
        return Excitation(
            self.motions, self.motions + left, np.rad2deg(rms), np.sqrt(np.diag(translation)),
            np.rad2deg(np.sqrt(np.diag(rotation))))


# (a x b)_m = sum of e_mjk a_j b_k.
_LEVI_CIVITA = np.zeros((3, 3, 3))
_LEVI_CIVITA[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
_LEVI_CIVITA[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0


def _covariance(variance: float, inverse: FloatArray) -> FloatArray:
    """Return their product; without any noise, what is not determined stays so."""
    determined = np.isfinite(inverse)
    product = max(variance, 0.0) * np.where(determined, inverse, 0.0)
    result: FloatArray = np.where(determined, product, np.inf)
    return result


def _symmetric(matrix: FloatArray) -> FloatArray:
    return 0.5 * (matrix + matrix.T)


def _seen_across(seen: FloatArray) -> FloatArray:
    """Return ``sum |phi|^2 I - phi phi^T``: a rotation shows what lies across its axis."""
    return np.trace(seen) * np.eye(3) - seen


def _inverse(information: FloatArray) -> FloatArray:
    """Return the inverse, infinite on the diagonal where a direction is not determined."""
    values, vectors = np.linalg.eigh(information)
    if values[0] <= 1e-12 * max(values[2], 1e-300):
        weak = vectors[:, values <= 1e-12 * max(values[2], 1e-300)]
        return np.diag(np.where((np.abs(weak) > 1e-3).any(axis=1), np.inf, 0.0))
    inverse: FloatArray = (vectors / values) @ vectors.T
    return inverse


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
