# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Signs of progress on standard error, where a person watches and the work takes its time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import sys
from threading import Event, Thread
import time

# Work that ends sooner needs no bar.
_PATIENCE_S = 0.5
_WIDTH = 30

# The same for a clock, and the time between two of its readings.
_CLOCK_PATIENCE_S = 2.0
_TICK_S = 1.0


@contextmanager
def _line() -> Iterator[Callable[[str], None]]:
    """Yield a function that writes over the line of a terminal; clear the line at the end."""
    written = False

    def write(text: str) -> None:
        nonlocal written
        if sys.stderr.isatty():
            print(f'\r{text}', end='', file=sys.stderr, flush=True)
            written = True

    try:
        yield write
    finally:
        if written:
            write('\033[K')


@contextmanager
def progress_bar(label: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function of the part done and the whole, which draws a bar."""
    start = time.monotonic()
    with _line() as write:
        def draw(done: int, total: int) -> None:
            if time.monotonic() - start >= _PATIENCE_S:
                share = done / total if total else 1.0
                write(f'{label} [{"#" * round(_WIDTH * share):.<{_WIDTH}}] {share:4.0%}')

        yield draw


@contextmanager
def running_clock(label: str) -> Iterator[None]:
    """Show the seconds that the work takes, whose end is not known."""
    start, ended = time.monotonic(), Event()
    with _line() as write:
        def tick() -> None:
            pause_s = _CLOCK_PATIENCE_S
            while not ended.wait(pause_s):
                write(f'{label}, {time.monotonic() - start:.0f} s')
                pause_s = _TICK_S

        clock = Thread(target=tick, daemon=True)
        clock.start()
        try:
            yield
        finally:
            # Before anything else is written: an answer, or the reason why there is none.
            ended.set()
            clock.join()
