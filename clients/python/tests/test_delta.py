"""The delta format against bytes written by hand."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

from rebake import DeltaError, FrameReader, LightMap


def frame(base: int, new: int, runs: list[tuple[int, int]], values: list[float], flags: int = 1) -> bytes:
    numbers = np.array(values, "<f2" if flags & 4 else "<f4").tobytes()
    payload = b"".join(struct.pack("<II", *run) for run in runs) + numbers
    head = (b"RBKD", 1, flags, base, new, len(runs), len(values) // 3, len(payload), zlib.crc32(payload))
    return struct.pack("<4sHHQQIIII", *head) + payload


def test_frames_are_read_however_bytes_arrive() -> None:
    data = frame(0, 3, [(1, 2), (5, 1)], [1, 2, 3, 4, 5, 6, 7, 8, 9]) + frame(3, 4, [(0, 1)], [0.5, 0.25, 2], 1 | 4)
    reader = FrameReader()
    frames = [found for at in range(len(data)) for found in reader.feed(data[at : at + 1])]
    assert reader.is_between_frames and [found.indices.tolist() for found in frames] == [[1, 2, 5], [0]]
    light_map = LightMap().apply(frames)
    assert light_map.version == 4 and len(light_map) == 6
    assert light_map.values[[0, 2, 3, 5]].tolist() == [[0.5, 0.25, 2], [4, 5, 6], [0, 0, 0], [7, 8, 9]]
    with pytest.raises(ValueError):
        light_map.values[0] = 1


def test_a_snapshot_is_applied_as_a_whole_or_not_at_all() -> None:
    start = LightMap.read(frame(0, 2, [(0, 2)], [1.0] * 6))
    reader = FrameReader()
    first, last = reader.feed(frame(2, 3, [(0, 1)], [9, 9, 9], 0) + frame(2, 3, [(1, 1)], [8, 8, 8]))
    with pytest.raises(DeltaError, match="last frame"):
        start.apply([first])
    assert start.apply([first, last]).values.tolist() == [[9, 9, 9], [8, 8, 8]]
    assert start.values.tolist() == [[1, 1, 1], [1, 1, 1]], "maps that were given out stay as they are"
    (gap,) = FrameReader().feed(frame(1, 3, [(0, 1)], [9, 9, 9]))
    with pytest.raises(DeltaError, match="version"):
        start.apply([gap])
    (whole,) = FrameReader().feed(frame(1, 7, [(0, 1)], [5, 5, 5], 1 | 2))
    assert start.apply([whole]).values.tolist() == [[5, 5, 5]]


def test_damaged_frames_are_refused() -> None:
    good = frame(0, 3, [(1, 2)], [1, 2, 3, 4, 5, 6])
    for at in (0, 4, 28, 36, 40, len(good) - 1):
        damaged = bytearray(good)
        damaged[at] ^= 1
        with pytest.raises(DeltaError):
            LightMap.read(bytes(damaged))
    with pytest.raises(DeltaError, match="too soon"):
        LightMap.read(good[:-1])
    with pytest.raises(DeltaError, match="runs"):
        LightMap.read(frame(0, 3, [(1, 1)], [1, 2, 3, 4, 5, 6]))
