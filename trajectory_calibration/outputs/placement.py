# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A transform between two named frames for export, and its change to other frames."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.errors import ConfigError, counted
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.result import CalibrationResult


@dataclass(frozen=True, eq=False)
class Placement:
    """The pose of child in parent, as it is exported.

    ``T_parent_child`` is (4, 4), metres: ``p_parent = T_parent_child @ p_child``. ``covariance``
    (6, 6) has order and side as in ``CalibrationResult``, about the axes of the parent.
    ``unobserved`` are the degrees of freedom that neither the motion nor a prior determines ('z of
    camera in lidar'). ``kept_back`` names them if they must not be exported, because
    ``allow_unobserved`` is not set. ``origin`` names version, solver and number of motions.
    """

    parent: str
    child: str
    T_parent_child: FloatArray
    covariance: FloatArray | None = None
    unobserved: tuple[str, ...] = ()
    kept_back: str = ''
    origin: str = ''

    @classmethod
    def of(cls, result: CalibrationResult) -> Placement:
        """Return the extrinsic of a result: a is the parent, b the child."""
        item = cls(
            result.frame_a, result.frame_b, result.T_a_b, result.covariance,
            origin=f'trajectory_calibration {result.version}, solver {result.config.solver}, '
            f'{counted(result.motions, "motion")}')
        return item.with_unobserved(result.observability.unobserved, result.config)

    def with_unobserved(self, unobserved: Sequence[str], config: CalibrationConfig) -> Placement:
        """Return the same with ``unobserved`` degrees of freedom."""
        suffix = f' of {self.child} in {self.parent}'
        hidden = unobserved and not config.allow_unobserved
        return replace(
            self, unobserved=tuple(name + suffix for name in unobserved),
            kept_back=', '.join(unobserved) + suffix if hidden else '')

    def inverted(self) -> Placement:
        """Return the pose of the parent in the child."""
        return replace(
            self, parent=self.child, child=self.parent,
            T_parent_child=se3.inverse(self.T_parent_child),
            covariance=self._propagated(se3.inverse_step(self.T_parent_child)))

    def with_parent(self, parent: str, T_new_parent: FloatArray) -> Placement:
        """Return the pose of the child in another parent.

        ``T_new_parent`` (4, 4) is the pose of the old parent in the new one.
        """
        J = np.zeros((6, 6))
        J[:3, :3] = J[3:, 3:] = T_new_parent[:3, :3]
        return replace(
            self, parent=parent, T_parent_child=T_new_parent @ self.T_parent_child,
            covariance=self._propagated(J))

    def with_child(self, child: str, T_new_child: FloatArray) -> Placement:
        """Return the pose of another frame that is fixed to the child.

        ``T_new_child`` (4, 4) is the pose of the old child in the new one, for instance of the
        optical frame in ``camera_link``.
        """
        T_child_new = se3.inverse(T_new_child)
        J = np.eye(6)
        J[:3, 3:] = -se3.skew(self.T_parent_child[:3, :3] @ T_child_new[:3, 3])
        return replace(
            self, child=child, T_parent_child=self.T_parent_child @ T_child_new,
            covariance=self._propagated(J))

    def require_two_frames(self) -> Placement:
        """Return self; raises ConfigError if both frames have the same name."""
        if self.parent == self.child:
            raise ConfigError(
                f'both frames are named {self.parent}: a frame cannot be its own parent; '
                'name them with --frame-a and --frame-b of calibrate, or --parent and --child')
        return self

    def _propagated(self, jacobian: FloatArray) -> FloatArray | None:
        if self.covariance is None:
            return None
        return jacobian @ self.covariance @ jacobian.T


def kept_back(items: Iterable[Placement]) -> str:
    """Return the components of all placements that must not be exported, '' for none."""
    return '; '.join(item.kept_back for item in items if item.kept_back)
