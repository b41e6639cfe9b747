"""What motions of both sensors would allow, from sums of fixed size.

With phi the rotation vectors and t the translations of a motion, D = R_A - I, and s the metres
of a per metre of b, the two halves of A X = X B are

    r_R = phi_A - R phi_B,   r_t = D t + t_A - s R t_B,

linear in a shift dt, and in a turn R -> exp(dtheta) R and a step ds up to first order:

    dr_R = [R phi_B] dtheta,   dr_t = D dt + s [R t_B] dtheta - R t_B ds.

Everything that least squares needs of them, their minimum, the size of their residuals and the
information about the extrinsic, is a function of sums over the motions; [v] is the skew matrix.
The information is taken from products of what a and b saw, whose noises are independent: noise
alone does not count as motion, and what does not stand out of it does not, either. Nothing here
imports ROS.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajectory_calibration.config.prior import Prior
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.solution import UNKNOWN

# These find the rotation first, from the rotations alone.
_SEPARABLE = ('park', 'taylor', 'zhuang')
# What these multiply the squares of r_R and of r_t with; the others weigh both by their noise.
_WEIGHTS = {'dnl': (2.0, 1.0), 'dnlo': (2.0, 1.0), 'ali': (0.0, 1.0)}

# Starts around the axis that the rotations leave open on flat ground.
_STARTS = 8
_MAX_STEPS = 20
_SETTLED = 1e-9

# Products of noises add up to no more than so many standard deviations of their sum.
_SIGNIFICANT = 4.0
# A sum of squares is taken for so many of its standard deviations more.
_LUCK = 2.0
# Of a sum of squares, and of its largest eigenvalue: nothing but rounding.
_ROUNDING = 1e-13
_UNSEEN = 1e-12
# Rounding of poses without noise: a micrometre and a microradian, squared.
_FLOOR = 1e-12
# A prior that fixes a component: small enough to be exact, large enough to divide by.
_FIXED = 1e-12

# (a x b)_m = sum of e_mjk a_j b_k.
_LEVI_CIVITA = np.zeros((3, 3, 3))
_LEVI_CIVITA[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
_LEVI_CIVITA[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0


@dataclass(frozen=True, eq=False)
class _Fit:
    """An extrinsic, and how far the motions are from it.

    Attributes
    ----------
    R : (3, 3), t : (3,) metres, scale : of b.
    rotation, translation : mean squares of one component of r_R and of r_t, rad^2 and m^2,
        rather too large than too small.

    """

    R: FloatArray
    t: FloatArray
    scale: float
    rotation: float
    translation: float


class MotionSums:
    """The sums of the module's formulas.

    Attributes
    ----------
    motions : number of motions in them.

    """

    def __init__(self) -> None:
        self.motions = 0
        self._phi_a_phi_b = np.zeros((3, 3))
        self._phi_b_phi_b = np.zeros((3, 3))
        self._weighted = np.zeros((3, 3))
        self._rotation_energy = 0.0
        self._DtD = np.zeros((3, 3))
        self._D_t_b = np.zeros((3, 3, 3))
        self._Dt_t_a = np.zeros(3)
        self._t_a_t_b = np.zeros((3, 3))
        self._t_b_t_b = np.zeros((3, 3))
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
        self._phi_b_phi_b += phi_b.T @ phi_b
        self._weighted += (phi_a * weight[:, None]).T @ phi_b
        self._rotation_energy += float(np.sum(phi_a**2) + np.sum(phi_b**2))
        self._DtD += np.einsum('kmi,kmj->ij', D, D)
        self._D_t_b += np.einsum('kmi,kl->iml', D, t_b)
        self._Dt_t_a += np.einsum('kmi,km->i', D, t_a)
        self._t_a_t_b += t_a.T @ t_b
        self._t_b_t_b += t_b.T @ t_b
        self._translation_energy += float(np.sum(t_a**2))

    def rotation_rms(self) -> FloatArray:
        """Return (3,) the root mean square rotation that both saw about x, y, z of a, radians."""
        R = se3.nearest_rotation(self._phi_a_phi_b)
        seen = np.diag(self._phi_a_phi_b @ R.T)
        rms: FloatArray = np.sqrt(np.maximum(seen, 0.0) / max(1, self.motions))
        return rms

    def covariance(self, config: CalibrationConfig) -> FloatArray:
        """Return the (6, 6) covariance that an answer with these settings would have.

        Translation before rotation, m^2 and rad^2, about the fixed axes of a; the prior is in
        it. A direction that is not determined is as wide as ``excitation.UNKNOWN``.
        """
        free_scale = config.solver == 'drift_aware' and config.mode('scale') != 'fixed'
        fit = self._fit(None if free_scale else config.scale)
        rotation, translation = self._information(fit)
        root = (_separable_root if config.solver in _SEPARABLE else _joint_root)(
            rotation, translation, fit, config.solver, free_scale=free_scale)
        return _with_prior(root, config.prior)

    def _fit(self, scale: float | None) -> _Fit:
        """Return the least squares of both halves, each weighed by its own residuals."""
        fit = min((self._aligned(R, scale) for R in self._starts()),
                  key=lambda found: found.translation)
        for _ in range(_MAX_STEPS):
            step = self._step(fit)
            fit = self._aligned(se3.exp_so3(step) @ fit.R, scale)
            if np.abs(step).max() < _SETTLED:
                break
        return fit

    def _starts(self) -> list[FloatArray]:
        """Return rotations: the best by the rotations, and turned about their common axis."""
        best = se3.nearest_rotation(self._phi_a_phi_b)
        common = np.linalg.svd(self._phi_a_phi_b)[0][:, 0]
        turns = np.arange(_STARTS) * (2 * np.pi / _STARTS)
        return [*(se3.exp_so3(turns[:, None] * common) @ best),
                se3.nearest_rotation(self._t_a_t_b)]

    def _aligned(self, R: FloatArray, scale: float | None) -> _Fit:
        """Return the best translation, and scale where none is given, for a (3, 3) rotation."""
        moved = self._moved(R)
        along = np.einsum('ikk->i', moved)
        t_a_m = float(np.sum(R * self._t_a_t_b))
        t_b_t_b = float(np.trace(self._t_b_t_b))
        if scale is None:
            normal = np.block([[self._DtD, -along[:, None]], [-along, t_b_t_b]])
            solved = np.linalg.lstsq(
                normal, np.append(-self._Dt_t_a, t_a_m), rcond=_UNSEEN)[0]
            # Below zero it would be half a turn about the common axis: of the wrong rotations.
            lengths = np.sqrt(self._translation_energy / t_b_t_b) if t_b_t_b else 1.0
            scale = float(solved[3]) if solved[3] > 0 else float(lengths)
        t = np.linalg.lstsq(self._DtD, scale * along - self._Dt_t_a, rcond=_UNSEEN)[0]
        energy = self._translation_energy + scale**2 * t_b_t_b
        translation = (energy + t @ self._DtD @ t + 2 * t @ self._Dt_t_a
                       - 2 * scale * (t @ along + t_a_m))
        rotation = self._rotation_energy - 2 * float(np.sum(R * self._phi_a_phi_b))
        freedom = 3 * max(self.motions, 3) - 4
        # What the squares of a few motions add up to may be luck, and whoever waits for enough
        # motion meets that.
        freedom = freedom / (1 + _LUCK * np.sqrt(2 / freedom))
        return _Fit(
            R, t, scale,
            max(rotation, _ROUNDING * self._rotation_energy) / freedom + _FLOOR,
            max(float(translation), _ROUNDING * float(energy)) / freedom + _FLOOR)

    def _moved(self, R: FloatArray) -> FloatArray:
        """Return (3, 3, 3) ``sum D_ki (R t_B)_j`` in the order i, k, j."""
        moved: FloatArray = np.einsum('ikl,jl->ikj', self._D_t_b, R)
        return moved

    def _seen_by_a(self, fit: _Fit) -> FloatArray:
        """Return (3, 3) ``sum (D t + t_A) (s R t_B)^T``: where b went, as a says and as b does."""
        seen: FloatArray = fit.scale * (
            np.einsum('i,ikj->kj', fit.t, self._moved(fit.R)) + self._t_a_t_b @ fit.R.T)
        return seen

    def _step(self, fit: _Fit) -> FloatArray:
        """Return (3,) the turn of a step of Gauss and Newton, the rest following it."""
        R = fit.R
        lever = fit.scale * _lever(self._moved(R))
        turn = (_across(R @ self._phi_b_phi_b @ R.T) / fit.rotation
                + _across(fit.scale**2 * R @ self._t_b_t_b @ R.T) / fit.translation)
        gradient = -(_curl(self._phi_a_phi_b @ R.T) / fit.rotation
                     + _curl(self._seen_by_a(fit)) / fit.translation)
        # The translation is at its best already: only the rotation has a gradient.
        follows = lever.T @ np.linalg.pinv(self._DtD, rcond=_UNSEEN, hermitian=True) @ lever
        normal = turn - follows / fit.translation
        step: FloatArray = -np.linalg.lstsq(normal, gradient, rcond=1e-9)[0]
        return step

    def _information(self, fit: _Fit) -> tuple[FloatArray, FloatArray]:
        """Return (7, 7) of the rotations and of the translations, for translation, turn, scale.

        Without their noise: to be divided by the mean squares of the fit.
        """
        R, rotation, translation = fit.R, np.zeros((7, 7)), np.zeros((7, 7))
        noise = _SIGNIFICANT * np.sqrt(self.motions) / 2
        rotation[3:6, 3:6] = _across(_standing_out(
            self._phi_a_phi_b @ R.T, noise * fit.rotation))
        shift = _across(_standing_out(self._weighted @ R.T, noise * fit.rotation))
        went = _standing_out(self._seen_by_a(fit), noise * fit.translation)
        moved = self._moved(R)
        # Along what the turns do not show, only noise couples the rest.
        values, vectors = np.linalg.eigh(shift)
        shown = vectors[:, values > _UNSEEN * max(values[2], _FLOOR)]
        coupled = shown @ shown.T @ np.column_stack(
            [fit.scale * _lever(moved), -np.einsum('ikk->i', moved)])
        translation[:3, :3], translation[:3, 3:] = shift, coupled
        translation[3:, :3] = coupled.T
        translation[3:6, 3:6] = _across(went)
        translation[6, 6] = np.trace(went) / max(fit.scale, _FLOOR)**2
        return rotation, translation


def _joint_root(
    rotation: FloatArray, translation: FloatArray, fit: _Fit, solver: str, *, free_scale: bool,
) -> FloatArray:
    """Return a (6, N) root of the covariance of least squares in both halves at once."""
    weights = np.array(_WEIGHTS.get(solver, (1 / fit.rotation, 1 / fit.translation)))
    noise = np.array([fit.rotation, fit.translation])
    # In units of the unknown, and no more certain than the noise of the weighted sum.
    weights = weights / max(weights * noise)
    size = 7 if free_scale else 6
    unit = np.append(UNKNOWN, 1.0)[:size]
    halves = [unit[:, None] * half[:size, :size] * unit for half in (rotation, translation)]
    values, vectors = np.linalg.eigh(weights[0] * halves[0] + weights[1] * halves[1])
    values = np.where(values > _UNSEEN * max(values[-1], _FLOOR), values, 0.0)
    spread = (weights[0]**2 * noise[0] * halves[0] + weights[1]**2 * noise[1] * halves[1])
    meat = vectors.T @ spread @ vectors
    known = values > 0
    meat[~known] = meat[:, ~known] = 0.0
    sizes, axes = np.linalg.eigh(meat)
    inverse = vectors / (values + 1.0)
    root: FloatArray = (unit[:, None] * np.column_stack(
        [inverse @ (axes * np.sqrt(np.maximum(sizes, 0.0))), inverse]))[:6]
    return root


def _separable_root(
    rotation: FloatArray, translation: FloatArray, fit: _Fit, solver: str, *, free_scale: bool,
) -> FloatArray:
    """Return a (6, 6) root of the covariance where the rotation is found first, by itself."""
    del solver, free_scale
    turn = _inverse_root(rotation[3:6, 3:6] / fit.rotation, UNKNOWN[3:])
    shift = _inverse_root(translation[:3, :3] / fit.translation, UNKNOWN[:3])
    # An error of the rotation turns every t_B and moves the translation with it.
    moved = shift @ shift.T @ translation[:3, 3:6] / fit.translation
    return np.block([[shift, -moved @ turn], [np.zeros((3, 3)), turn]])


def _inverse_root(information: FloatArray, unknown: FloatArray) -> FloatArray:
    """Return a (3, 3) root of the inverse, no wider than (3,) what stands for unknown."""
    values, vectors = np.linalg.eigh(unknown[:, None] * information * unknown)
    values = np.where(values > _UNSEEN * max(values[-1], _FLOOR), values, 0.0)
    root: FloatArray = unknown[:, None] * vectors / np.sqrt(values + 1.0)
    return root


def _with_prior(root: FloatArray, prior: Prior) -> FloatArray:
    """Return the (6, 6) covariance of which (6, N) is a root, with the prior added."""
    known = np.isfinite(prior.std)
    std = np.maximum(prior.std[known], _FIXED)
    # As a factorisation: a component that is fixed has 1e13 times the weight of an open one.
    triangle = np.asarray(np.linalg.qr(
        np.concatenate([root[known] / std[:, None], np.eye(root.shape[1])]), mode='r'))
    half = np.linalg.solve(triangle.T, root.T)
    covariance: FloatArray = half.T @ half
    return covariance


def _standing_out(products: FloatArray, noise: float) -> FloatArray:
    """Return (3, 3) sums of products of what a and b saw, less what noise adds up to."""
    values, vectors = np.linalg.eigh(0.5 * (products + products.T))
    result: FloatArray = (vectors * np.maximum(values - noise, 0.0)) @ vectors.T
    return result


def _across(seen: FloatArray) -> FloatArray:
    """Return ``sum |v|^2 I - v v^T`` of ``sum v v^T``: a vector shows what lies across it."""
    return np.trace(seen) * np.eye(3) - seen


def _lever(moved: FloatArray) -> FloatArray:
    """Return (3, 3) ``sum D^T [m]`` of ``sum D_ki m_j``."""
    lever: FloatArray = np.einsum('ikj,kjl->il', moved, _LEVI_CIVITA)
    return lever


def _curl(products: FloatArray) -> FloatArray:
    """Return (3,) ``sum b x a`` of ``sum a b^T``."""
    curl: FloatArray = np.einsum('ijk,kj->i', _LEVI_CIVITA, products)
    return curl
