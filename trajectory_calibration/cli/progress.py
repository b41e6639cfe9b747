# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Signs of progress on standard error, where a person watches and the work takes its time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import sys
from threading import Event, Thread
import time

# Work that ends sooner shows nothing; what is shown is written anew after each tick.
_PATIENCE_S, _TICK_S = 1.0, 0.5
_WIDTH = 30


@contextmanager
def progress(label: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function of the part done and the whole, which a bar shows.

    Until it is called the end is not known: the seconds that the work has taken are shown.
    """
    start, ended, shares = time.monotonic(), Event(), [-1.0]

    def draw(done: int, total: int) -> None:
        shares[0] = done / total if total else 1.0

    def show() -> None:
        pause_s, written = _PATIENCE_S, False
        while not ended.wait(pause_s):
            (share,) = shares
            text = (f', {time.monotonic() - start:.0f} s' if share < 0 else
                    f' [{"#" * round(_WIDTH * share):.<{_WIDTH}}] {share:4.0%}')
            print(f'\r{label}{text}', end='', file=sys.stderr, flush=True)
            pause_s, written = _TICK_S, True
        if written:
            print('\r\033[K', end='', file=sys.stderr, flush=True)

    shown = Thread(target=show, daemon=True)
    if sys.stderr.isatty():
        shown.start()
    try:
        yield draw
    finally:
        # Cleared before anything else is written: an answer, or the reason why there is none.
        ended.set()
        if shown.is_alive():
            shown.join()
