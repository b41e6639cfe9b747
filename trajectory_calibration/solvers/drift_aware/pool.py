"""Memory that is used again.

An evaluation of a long chain needs gigabytes. To be given them anew each time, by a system that
clears every page first, costs a third of what the evaluation itself does.
"""

from __future__ import annotations

import math
import sys

import numpy as np

from trajectory_calibration.geometry.se3 import FloatArray

# Arrays of fewer numbers: up to 32 MiB the allocator of the C library keeps memory by itself.
_SMALL = 1 << 22


class Pool:
    """Large arrays, whose memory is given out again when nothing refers to it any more."""

    def __init__(self) -> None:
        self._buffers: list[FloatArray] = []

    def empty(self, shape: tuple[int, ...]) -> FloatArray:
        """Return an array with arbitrary values."""
        size = math.prod(shape)
        if size < _SMALL:
            return np.empty(shape)
        references = _references(self._buffers)
        free = [buffer for buffer, count in zip(self._buffers, references, strict=True)
                if count == _UNUSED]
        fitting = [buffer for buffer in free if size <= len(buffer) < 2 * size]
        if fitting:
            buffer = min(fitting, key=len)
        else:
            # What has become a little too small is not going to be asked for again.
            outgrown = {id(buffer) for buffer in free if size / 2 < len(buffer) < size}
            self._buffers = [kept for kept in self._buffers if id(kept) not in outgrown]
            buffer = np.empty(size)
            self._buffers.append(buffer)
        return buffer[:size].reshape(shape)

    def zeros(self, shape: tuple[int, ...]) -> FloatArray:
        """Return an array of zeros."""
        array = self.empty(shape)
        array.fill(0.0)
        return array


def _references(buffers: list[FloatArray]) -> list[int]:
    """Count references: every array that NumPy makes of a buffer, views of views too, is one."""
    return [sys.getrefcount(buffer) for buffer in buffers]


# Counted rather than known: interpreters differ in what the counting itself adds.
_UNUSED = _references([np.empty(1)])[0]
