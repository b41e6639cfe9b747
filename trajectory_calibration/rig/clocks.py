# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Clocks of a rig: each sensor's stamps become those of the base."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Clock:
    """Stamps t of a sensor are ``t + drift (t - epoch_ns) + offset_s`` in the base.

    Attributes
    ----------
    offset_s : seconds added to the stamps at the epoch.
    drift : seconds a second.
    epoch_ns : stamp of the sensor.
    offset_std_s : standard deviation of the offset.

    """

    offset_s: float = 0.0
    drift: float = 0.0
    epoch_ns: int = 0
    offset_std_s: float = 0.0

    def apply(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return (N,) stamps of the sensor as stamps of the base."""
        drifted = self.drift * (stamps_ns - self.epoch_ns).astype(np.float64)
        return stamps_ns + np.rint(drifted + 1e9 * self.offset_s).astype(np.int64)

    def at(self, stamp_ns: int) -> float:
        """Return by how much, seconds, stamps near ``stamp_ns`` of the sensor are corrected."""
        return self.offset_s + self.drift * (stamp_ns - self.epoch_ns) * 1e-9
