# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Width and colours of a terminal, and text wrapped to fit."""

from __future__ import annotations

from dataclasses import dataclass
import os
import shutil
import sys
import textwrap
from typing import TextIO

# Columns without a terminal, as from the Python API.
PLAIN_WIDTH = 99
# In a file or a pipe sentences are not wrapped, for grep, unless COLUMNS is set.
UNBROKEN = 1_000_000
_MIN_WIDTH, _MAX_WIDTH = 40, 120
# A longer label has its own line.
_MAX_LABEL = 30

_CODES = {'ok': '32', 'weak': '33', 'unknown': '31', 'prior': '35', 'serious': '31',
          'warning': '33', 'note': '2', 'head': '1', 'soft': '2'}


@dataclass(frozen=True)
class Terminal:
    """The number of columns, and whether to use colours."""

    width: int = PLAIN_WIDTH
    colour: bool = False

    @classmethod
    def of(cls, stream: TextIO | None = None) -> Terminal:
        """Return the terminal of a stream, by default standard output; NO_COLOR is honoured."""
        stream = stream or sys.stdout
        # sys.stdout is None if standard output is closed.
        if stream is None or not stream.isatty():
            return cls(shutil.get_terminal_size((UNBROKEN, 1)).columns
                       if 'COLUMNS' in os.environ else UNBROKEN)
        width = min(max(shutil.get_terminal_size().columns, _MIN_WIDTH), _MAX_WIDTH)
        plain = os.environ.get('NO_COLOR') or os.environ.get('TERM') == 'dumb'
        return cls(width, not plain)

    def paint(self, text: str, style: str) -> str:
        """Return a text in the colour of a style: 'ok', 'weak', 'serious', 'head', ..."""
        return f'\033[{_CODES[style]}m{text}\033[0m' if self.colour else text

    def wrapped(self, text: str, first: str = '', rest: str = '') -> list[str]:
        """Wrap a text into lines; paths and names are never broken."""
        return textwrap.wrap(
            text, self.width, initial_indent=first, subsequent_indent=rest,
            break_long_words=False, break_on_hyphens=False)

    def aligned(self, rows: dict[str, str]) -> list[str]:
        """Return labels and values in two columns, long values wrapped within their column."""
        width = min(max(map(len, rows), default=0), _MAX_LABEL)
        lines = []
        for name, value in rows.items():
            head = f'  {name:<{width}}  '
            if len(name) > width:
                lines.append(head.rstrip())
                head = ' ' * (width + 4)
            lines += self.wrapped(value, head, ' ' * (width + 4))
        return lines
