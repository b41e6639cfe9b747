# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A progress display on standard error, for slow work on a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import sys
from threading import Event, Thread
import time

# Time until the display appears, and between its updates.
_DELAY_S, _UPDATE_S = 1.0, 0.5
_WIDTH = 30


@contextmanager
def progress(label: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function ``draw(done, total)`` that updates a progress bar.

    Until its first call the display shows the elapsed seconds.
    """
    start, ended, shares = time.monotonic(), Event(), [-1.0]

    def draw(done: int, total: int) -> None:
        shares[0] = done / total if total else 1.0

    def show() -> None:
        pause_s, written = _DELAY_S, False
        while not ended.wait(pause_s):
            (share,) = shares
            text = (f', {time.monotonic() - start:.0f} s' if share < 0 else
                    f' [{"#" * round(_WIDTH * share):.<{_WIDTH}}] {share:4.0%}')
            print(f'\r{label}{text}', end='', file=sys.stderr, flush=True)
            pause_s, written = _UPDATE_S, True
        if written:
            print('\r\033[K', end='', file=sys.stderr, flush=True)

    thread = Thread(target=show, daemon=True)
    if sys.stderr.isatty():
        thread.start()
    try:
        yield draw
    finally:
        # Cleared before the answer or an error message is written.
        ended.set()
        if thread.is_alive():
            thread.join()
