"""A progress bar on standard error, where a person watches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import sys
import time

# Work that ends sooner needs no bar.
_PATIENCE_S = 0.5
_WIDTH = 30


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
        sys.stderr.write(f'\r{label} [{"#" * filled:.<{_WIDTH}}] {share:4.0%}')
        sys.stderr.flush()
        shown = True

    try:
        yield draw
    finally:
        if shown:
            sys.stderr.write('\r\033[K')
            sys.stderr.flush()
