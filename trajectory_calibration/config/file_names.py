# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Names of files and folders out of names of frames, sensors and recordings."""

from __future__ import annotations

from collections.abc import Iterable
import re


def file_name(name: str) -> str:
    """Return a name that stays in its folder, of letters, digits and ``_ . + -``, not hidden."""
    return re.sub(r'^\.', '_', re.sub(r'[^\w.+-]', '_', name.strip('/'))) or '_'


def file_names(names: Iterable[str], taken: Iterable[str] = ()) -> list[str]:
    """Return a name of its own for each, other than those ``taken``; equal ones get a number.

    Names that differ in case only count as equal, as some file systems have it.
    """
    used, found = {name.casefold() for name in taken}, []
    for name in names:
        one, count = file_name(name), 1
        while (own := one if count == 1 else f'{one}_{count}').casefold() in used:
            count += 1
        used.add(own.casefold())
        found.append(own)
    return found
