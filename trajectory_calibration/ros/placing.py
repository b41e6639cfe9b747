# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""When and where an extrinsic goes to /tf_static, and how it compares with the vehicle's own."""

from __future__ import annotations

from rclpy.node import Node

from trajectory_calibration.online.vehicle_frames import difference
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.ros.frames import VehicleTransforms


class TransformKeeper:
    """Holds the newest answer until the node has listened, then publishes it where it may.

    Attributes
    ----------
    placed : what became of the newest answer in TF, '' where TF is none of its business.

    """

    def __init__(self, node: Node, transforms: VehicleTransforms) -> None:
        self._node, self._transforms = node, transforms
        self._waiting: tuple[CalibrationResult, frozenset[str]] | None = None
        self._conflicts: tuple[str, ...] = ()
        self.placed = ''

    def take(self, result: CalibrationResult, invented: frozenset[str]) -> None:
        """Take a new answer; ``invented`` are names of frames that nobody gave."""
        if self._transforms.publishes:
            self._waiting = result, invented
            self.placed = 'not on /tf_static yet: listening first to what the vehicle publishes'
            self.settle()

    def settle(self) -> None:
        """Publish what waits, once the vehicle has been heard; log what is wrong in TF."""
        if self._waiting is not None and self._transforms.has_listened:
            (result, invented), self._waiting = self._waiting, None
            placement = self._transforms.publish(
                result.frame_a, result.frame_b, result.T_a_b, invented)
            edge = placement.edge
            if edge is None:
                self.placed = f'not on /tf_static: {placement.reason}'
                self._node.get_logger().error(self.placed)
            else:
                reason = f' ({placement.reason})' if placement.reason else ''
                self.placed = f'on /tf_static: {edge.parent} -> {edge.child}{reason}'
                self._node.get_logger().info(self.placed)
        conflicts = self._transforms.frames.conflicts
        if self._transforms.publishes and conflicts != self._conflicts:
            for conflict in conflicts:
                if conflict not in self._conflicts:
                    self._node.get_logger().error(f'/tf: {conflict}')
            self._conflicts = conflicts

    def today(self, result: CalibrationResult | None) -> str:
        """Return how far an answer is from the transform that the vehicle has itself."""
        if result is None:
            return ''
        T_today = self._transforms.frames.transform(result.frame_a, result.frame_b)
        if T_today is None:
            return ''
        return (f"differs from the vehicle's own transform {result.frame_a} -> {result.frame_b} "
                f'by {difference(result.T_a_b, T_today)}')
