# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Decompression of the formats that bags use. Packages are imported when they are needed."""

from __future__ import annotations

import bz2
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from trajectory_calibration.errors import require
from trajectory_calibration.sources.channels import errors_noted

ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'
_BLOCK = 1 << 22


def unpack(data: bytes, compression: str) -> bytes:
    """Return the content of compressed data; of a truncated zstd frame, its first part.

    Raise MissingPackageError if the required package is not installed, ValueError for an unknown
    format.
    """
    if compression in ('', 'none'):
        return data
    if compression == 'bz2':
        return bz2.decompress(data)
    if compression == 'lz4':
        return bytes(require('lz4.frame').decompress(data))
    if compression == 'zstd':
        return bytes(_zstd().decompress(data))
    raise ValueError(f'compression {compression!r} is not known')


def unpack_zstd_file(packed: Path, target: Path) -> str:
    """Write the content of a .zstd file; return the reason if it is incomplete, else ''."""
    decompressor, reasons = _zstd(), list[str]()
    with packed.open('rb') as source, target.open('wb') as sink, errors_noted(reasons.append):
        while block := source.read(_BLOCK):
            sink.write(decompressor.decompress(block))
        if not getattr(decompressor, 'eof', True):
            reasons.append('its end is missing')
    return ''.join(reasons)


def _zstd() -> Any:
    """Return a streaming decompressor of one zstd frame."""
    # The first is part of Python from 3.14 on.
    for name in ('compression.zstd', 'backports.zstd', 'zstandard'):
        with suppress(ModuleNotFoundError):
            decompressor = import_module(name).ZstdDecompressor()
            # In zstandard, which Ubuntu has, the streaming one is a separate object.
            of_pieces = getattr(decompressor, 'decompressobj', None)
            return of_pieces() if of_pieces else decompressor
    return require('backports.zstd')
