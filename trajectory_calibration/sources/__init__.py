"""Where trajectories come from: files and bags here; live buffers in ``ros``.

Everything that can give a trajectory offers ``load() -> Trajectory``, and whoever needs one
asks for no more than that.
"""

from __future__ import annotations

from typing import Protocol

from trajectory_calibration.trajectory import Trajectory


class TrajectorySource(Protocol):
    """Anything that can give the trajectory of one sensor."""

    def load(self) -> Trajectory:
        """Read the trajectory; raises SourceError or TrajectoryError where there is none."""
        ...
