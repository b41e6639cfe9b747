# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trajectories from files and bags. Live buffers are in ``online``.

``FileSource('a.tum').load()`` and ``BagSource(['drive.mcap'], '/odometry').load()`` return a
``Trajectory``; ``inputs.load_inputs`` accepts both, and pairs of TF frames.
"""

from typing import Any, TYPE_CHECKING

from trajectory_calibration.sources.files import FileSource

if TYPE_CHECKING:
    from trajectory_calibration.sources.bags import BagSource

__all__ = ['BagSource', 'FileSource']


def __getattr__(name: str) -> Any:
    if name == 'BagSource':
        from trajectory_calibration.sources.bags import BagSource
        return BagSource
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
