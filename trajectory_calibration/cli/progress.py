# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Signs of progress on standard error, where a person watches."""

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

_CLEAR = '\r\033[K'


@contextmanager
def progress_bar(label: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function of the part done and the whole, which draws a bar; clear it at the end.

    Nothing is written unless standard error is a terminal and the work takes its time.
    """
    start = time.monotonic()
    shown = False

    def draw(done: int, total: int) -> None:
        nonlocal shown
        if not sys.stderr.isatty() or time.monotonic() - start < _PATIENCE_S:
            return
        share = done / total if total else 1.0
        filled = round(_WIDTH * share)
        _write(f'\r{label} [{"#" * filled:.<{_WIDTH}}] {share:4.0%}')
        shown = True

    try:
        yield draw
    finally:
        if shown:
            _write(_CLEAR)


@contextmanager
def running_clock(label: str) -> Iterator[None]:
    """Show the seconds that the work takes, whose end is not known; clear them at the end.

    Nothing is written unless standard error is a terminal and the work takes its time.
    """
    if not sys.stderr.isatty():
        yield
        return
    ended = Event()
    clock = Thread(target=_tick, args=(label, time.monotonic(), ended), daemon=True)
    clock.start()
    try:
        yield
    finally:
        # Before anything else is written: an answer, or the reason why there is none.
        ended.set()
        clock.join()


def _tick(label: str, start: float, ended: Event) -> None:
    if ended.wait(_CLOCK_PATIENCE_S):
        return
    while True:
        _write(f'\r{label}, {time.monotonic() - start:.0f} s')
        if ended.wait(_TICK_S):
            break
    _write(_CLEAR)


def _write(text: str) -> None:
    print(text, end='', file=sys.stderr, flush=True)
