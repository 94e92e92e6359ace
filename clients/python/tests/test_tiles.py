"""Tiles of atlas pages against bytes written by hand."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

from rebake import AtlasPages, DeltaError, read_tiles

Placed = tuple[int, int, int, int, int, list[float], list[int]]


def frame(base: int, new: int, pages: list[tuple[int, int]], tiles: list[Placed], flags: int = 1) -> bytes:
    """`tiles`: page, x, y, width, height, values and bytes of validity."""
    payload = b"".join(struct.pack("<II", *size) for size in pages)
    payload += b"".join(struct.pack("<IIIII", *tile[:5]) for tile in tiles)
    payload += b"".join(np.array(tile[5], "<f2" if flags & 4 else "<f4").tobytes() for tile in tiles)
    payload += b"".join(bytes(tile[6]) for tile in tiles)
    head = (b"RBKT", 1, flags, base, new, len(pages), len(tiles), len(payload), zlib.crc32(payload))
    return struct.pack("<4sHHQQIIII", *head) + payload


def test_tiles_are_written_where_they_belong() -> None:
    first = frame(0, 3, [(3, 2)], [(0, 1, 0, 2, 2, [*range(12)], [0b0110])], 1 | 2)
    sizes = [(3, 2), (4, 4)]
    second = frame(3, 4, sizes, [(1, 3, 3, 1, 1, [0.5, -1, 65504], [1])], 4) + frame(3, 4, sizes, [])
    pages = AtlasPages().apply(read_tiles(first))
    after = pages.apply(read_tiles(second))
    assert (pages.version, len(pages.pages), after.version) == (3, 1, 4)
    assert after.pages[0].values[1].tolist() == [[0, 0, 0], [6, 7, 8], [9, 10, 11]]
    assert after.pages[0].valid.tolist() == [[False, False, True], [False, True, False]]
    assert after.pages[1].values[3, 3].tolist() == [0.5, -1, 65504] and after.pages[1].valid.sum() == 1
    with pytest.raises(ValueError):
        after.pages[0].values[0] = 1
    with pytest.raises(DeltaError, match="version"):
        pages.apply(read_tiles(first[:6] + b"\1\0" + first[8:]))
    with pytest.raises(DeltaError, match="last frame"):
        pages.apply(read_tiles(second)[:1])


def test_pages_that_grow_keep_what_they_have_and_others_go() -> None:
    pages = AtlasPages().apply(read_tiles(frame(0, 1, [(1, 1), (1, 1)], [(0, 0, 0, 1, 1, [1, 2, 3], [1])])))
    grown = pages.apply(read_tiles(frame(1, 2, [(2, 2)], [])))
    assert [page.valid.tolist() for page in grown.pages] == [[[True, False], [False, False]]]
    assert grown.pages[0].values[0, 0].tolist() == [1, 2, 3] and grown.pages[0].values[1].max() == 0


def test_damaged_frames_are_refused() -> None:
    good = frame(0, 3, [(2, 2)], [(0, 0, 0, 2, 1, [1, 2, 3, 4, 5, 6], [3])])
    for at in (0, 3, 4, 24, 28, 32, 36, 40, len(good) - 1):
        damaged = bytearray(good)
        damaged[at] ^= 1
        with pytest.raises(DeltaError):
            read_tiles(bytes(damaged))
    with pytest.raises(DeltaError, match="too soon"):
        read_tiles(good[:-1])
    for tile in [(1, 0, 0, 1, 1), (0, 2, 0, 1, 1), (0, 0, 0, 1, 3), (0, 0, 0, 0, 1), (0, 4294967295, 0, 1, 1)]:
        with pytest.raises(DeltaError):
            read_tiles(frame(0, 1, [(2, 2)], [(*tile, [0.0] * 3 * tile[3] * tile[4], [0])]))
    with pytest.raises(DeltaError, match="larger"):
        read_tiles(frame(0, 1, [(1 << 15, 1 << 15)], []))
