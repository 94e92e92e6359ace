"""Tiles of atlas pages, and pages that are kept up to date with them (docs/delta-format.md)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .problems import DeltaError

_HEADER = struct.Struct("<4sHHQQIIII")
_LAST, _REPLACE, _HALF = 1, 2, 4
#: Texels of all pages together: what the service's own reader takes.
MAX_TEXELS = 1 << 28


@dataclass(frozen=True)
class Tile:
    """A rectangle of a page with what its texels hold."""

    page: int
    #: First column and row, from the top left.
    x: int
    y: int
    #: (height, width, 3), linear RGB.
    values: NDArray[np.float32]
    #: (height, width): whether a texel was read from a surface.
    valid: NDArray[np.bool_]


@dataclass(frozen=True)
class TileFrame:
    """Tiles that changed, on the way from one version to another."""

    base: int
    new: int
    #: The last frame of its snapshot.
    is_last: bool
    #: All pages are dropped first.
    replaces: bool
    #: Width and height of every page at the new version.
    pages: list[tuple[int, int]]
    tiles: list[Tile]


@dataclass(frozen=True)
class AtlasPage:
    """A page; its arrays are read-only."""

    #: (height, width, 3): irradiance / π, linear RGB.
    values: NDArray[np.float32]
    #: (height, width): whether a texel was read from a surface; others are filled or empty.
    valid: NDArray[np.bool_]


@dataclass(frozen=True)
class AtlasPages:
    """All pages of an atlas at one version; version 0 is before anything was loaded."""

    version: int = 0
    pages: tuple[AtlasPage, ...] = ()

    def apply(self, frames: Iterable[TileFrame]) -> AtlasPages:
        """The pages after the frames of one snapshot or several. These stay as they are. Raises :class:`DeltaError`
        where the frames do not begin at this version."""
        frames = list(frames)
        if not frames:
            return self
        values: list[NDArray[Any]] = [page.values.copy() for page in self.pages]
        valid: list[NDArray[Any]] = [page.valid.copy() for page in self.pages]
        version, is_whole = self.version, True
        for frame in frames:
            if is_whole and not frame.replaces and frame.base != version:
                raise DeltaError(f"a frame from version {frame.base} for pages of version {version}")
            if frame.replaces:
                values, valid = [], []
            values = [
                _sized(values, k, (height, width, 3), np.float32) for k, (width, height) in enumerate(frame.pages)
            ]
            valid = [_sized(valid, k, (height, width), np.bool_) for k, (width, height) in enumerate(frame.pages)]
            for tile in frame.tiles:
                height, width = tile.valid.shape
                place = np.s_[tile.y : tile.y + height, tile.x : tile.x + width]
                values[tile.page][place], valid[tile.page][place] = tile.values, tile.valid
            version, is_whole = frame.new, frame.is_last
        if not is_whole:
            raise DeltaError("the last frame of a snapshot is missing")
        for array in (*values, *valid):
            array.flags.writeable = False
        return AtlasPages(version, tuple(AtlasPage(*page) for page in zip(values, valid, strict=True)))


def _sized(pages: list[NDArray[Any]], page: int, shape: tuple[int, ...], kind: Any) -> NDArray[Any]:
    """The array of a page at its new size: what lies on the old one stays."""
    old = pages[page] if page < len(pages) else np.zeros((0, 0, *shape[2:]), kind)
    if old.shape == shape:
        return old
    new: NDArray[Any] = np.zeros(shape, kind)
    height, width = min(old.shape[0], shape[0]), min(old.shape[1], shape[1])
    new[:height, :width] = old[:height, :width]
    return new


def read_tiles(data: bytes) -> list[TileFrame]:
    """All frames of a whole answer. Raises :class:`DeltaError`."""
    frames, at = [], 0
    while at < len(data):
        if len(data) - at < _HEADER.size:
            raise DeltaError("the last frame ends too soon")
        magic, version, flags, base, new, pages, tiles, payload, crc = _HEADER.unpack_from(data, at)
        if magic != b"RBKT" or version != 1:
            raise DeltaError("not tiles, version 1")
        at += _HEADER.size
        body = data[at : at + payload]
        if len(body) < payload:
            raise DeltaError("the last frame ends too soon")
        if zlib.crc32(body) != crc:
            raise DeltaError("a frame's checksum is wrong")
        at += payload
        frames.append(_frame(flags, base, new, (pages, tiles), body))
    return frames


def _frame(flags: int, base: int, new: int, counts: tuple[int, int], body: bytes) -> TileFrame:
    pages, tiles = counts
    table = 8 * pages + 20 * tiles
    if len(body) < table:
        raise DeltaError(f"a frame of {len(body)} bytes does not hold {pages} pages and {tiles} tiles")
    sizes = np.frombuffer(body, "<u4", 2 * pages).reshape(-1, 2).astype(np.int64)
    places = np.frombuffer(body, "<u4", 5 * tiles, 8 * pages).reshape(-1, 5).astype(np.int64)
    if sizes.prod(axis=1).sum() > MAX_TEXELS:
        raise DeltaError("the pages are larger than an atlas can be")
    if tiles and (places[:, 0].max() >= pages or places[:, 3:].min() < 1):
        raise DeltaError("a tile does not lie on a page")
    if tiles and (places[:, 1:3] + places[:, 3:] > sizes[places[:, 0]]).any():
        raise DeltaError("a tile does not lie on a page")
    kind = np.dtype("<f2" if flags & _HALF else "<f4")
    texels = [int(width * height) for *_, width, height in places]
    at, bits_at = table, table + 3 * kind.itemsize * sum(texels)
    if len(body) != bits_at + sum((count + 7) // 8 for count in texels):
        raise DeltaError("a frame's tiles are not as long as its payload")
    found = []
    for (page, x, y, width, height), count in zip(places.tolist(), texels, strict=True):
        values = np.frombuffer(body, kind, 3 * count, at).astype(np.float32).reshape(height, width, 3)
        packed = np.frombuffer(body, np.uint8, (count + 7) // 8, bits_at)
        valid = np.unpackbits(packed, count=count, bitorder="little").astype(np.bool_).reshape(height, width)
        at, bits_at = at + 3 * count * kind.itemsize, bits_at + len(packed)
        found.append(Tile(page, x, y, values, valid))
    told = [(int(width), int(height)) for width, height in sizes]
    return TileFrame(base, new, bool(flags & _LAST), bool(flags & _REPLACE), told, found)
