# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Compressed data: the formats that bags use. Their packages load where they are met."""

from __future__ import annotations

import bz2
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from trajectory_calibration.errors import require
from trajectory_calibration.sources.channels import border

ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'
_BLOCK = 1 << 22


def unpack(data: bytes, compression: str, size: int) -> bytes:
    """Return the content of compressed data of a known size.

    Raise MissingPackageError where the package that this needs is not installed, ValueError where
    the format is not known.
    """
    if compression in ('', 'none'):
        return data
    if compression == 'bz2':
        return bz2.decompress(data)
    if compression == 'lz4':
        return bytes(require('lz4.frame').decompress(data))
    if compression == 'zstd':
        return unpack_zstd(data, size)
    raise ValueError(f'compression {compression!r} is not known')


def unpack_zstd(data: bytes, size: int = 0) -> bytes:
    """Return the content of one zstd frame; its size where it does not declare it."""
    module = _zstd()
    if hasattr(module, 'ZstdDecompressor') and not hasattr(module, 'ZstdFile'):
        # The package zstandard, which Ubuntu has.
        return bytes(module.ZstdDecompressor().decompress(data, max_output_size=size))
    return bytes(module.decompress(data))


def unpack_zstd_file(packed: Path, target: Path) -> str:
    """Write the content of a .zstd file; return why that ended too soon, empty if it did not."""
    decompressor = _zstd().ZstdDecompressor()
    # The package zstandard, which Ubuntu has, tells a stream from a block.
    decompressor = getattr(decompressor, 'decompressobj', lambda: decompressor)()
    reasons: list[str] = []
    with packed.open('rb') as source, target.open('wb') as sink, border(reasons.append):
        while block := source.read(_BLOCK):
            sink.write(decompressor.decompress(block))
        if not getattr(decompressor, 'eof', True):
            reasons.append('its end is missing')
    return ''.join(reasons)


def _zstd() -> Any:
    # The first is in Python from 3.14 on, the second is what Ubuntu has.
    for name in ('compression.zstd', 'backports.zstd', 'zstandard'):
        with suppress(ModuleNotFoundError):
            return import_module(name)
    return require('backports.zstd')
