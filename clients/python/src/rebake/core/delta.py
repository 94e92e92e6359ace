"""The delta format, and light maps that are put together from it (docs/delta-format.md)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .problems import DeltaError

_HEADER = struct.Struct("<4sHHQQIIII")
_LAST, _REPLACE, _HALF = 1, 2, 4
#: Longest light map: what the service itself takes.
MAX_ELEMENTS = 1 << 27


@dataclass(frozen=True)
class Frame:
    """New values of some elements, on the way from one version to another."""

    base: int
    new: int
    #: The last frame of its snapshot.
    is_last: bool
    #: The map is emptied first.
    replaces: bool
    #: (runs, 2): first element and count of each.
    runs: NDArray[np.uint32]
    #: (elements, 3), linear RGB, in the order of the runs.
    values: NDArray[np.float32]

    @property
    def indices(self) -> NDArray[np.intp]:
        """The elements that have a new value, as indices into the light map."""
        firsts, counts = self.runs[:, 0].astype(np.intp), self.runs[:, 1].astype(np.intp)
        starts = np.cumsum(counts) - counts
        return np.repeat(firsts - starts, counts) + np.arange(len(self.values), dtype=np.intp)

    @property
    def end(self) -> int:
        """One past the last element that it changes."""
        return int(self.runs.astype(np.int64).sum(axis=1).max(initial=0))


class FrameReader:
    """Bytes as they arrive to frames."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    @property
    def is_between_frames(self) -> bool:
        """All bytes that came belong to frames that were given out."""
        return not self._bytes

    def feed(self, data: bytes) -> list[Frame]:
        """The frames that are complete with these bytes. Raises :class:`DeltaError`."""
        self._bytes += data
        frames = []
        while len(self._bytes) >= _HEADER.size:
            magic, version, flags, base, new, runs, values, payload, crc = _HEADER.unpack_from(self._bytes)
            if magic != b"RBKD" or version != 1:
                raise DeltaError("not the delta format, version 1")
            if payload != 8 * runs + (6 if flags & _HALF else 12) * values or values > MAX_ELEMENTS:
                raise DeltaError(f"a frame of {payload} bytes does not hold {runs} runs and {values} values")
            if len(self._bytes) < _HEADER.size + payload:
                break
            body = bytes(memoryview(self._bytes)[_HEADER.size : _HEADER.size + payload])
            del self._bytes[: _HEADER.size + payload]
            if zlib.crc32(body) != crc:
                raise DeltaError("a frame's checksum is wrong")
            frames.append(_frame(flags, base, new, runs, body))
        return frames


def _frame(flags: int, base: int, new: int, runs: int, body: bytes) -> Frame:
    spans = np.frombuffer(body, "<u4", 2 * runs).reshape(-1, 2).astype(np.uint32)
    kind = "<f2" if flags & _HALF else "<f4"
    values = np.frombuffer(body, kind, offset=8 * runs).reshape(-1, 3).astype(np.float32)
    frame = Frame(base, new, bool(flags & _LAST), bool(flags & _REPLACE), spans, values)
    if int(spans[:, 1].sum(dtype=np.int64)) != len(values) or frame.end > MAX_ELEMENTS:
        raise DeltaError("a frame's runs are not as long as its values, or end too far")
    return frame


def _no_values() -> NDArray[np.float32]:
    return np.zeros((0, 3), np.float32)


@dataclass(frozen=True)
class LightMap:
    """A light map at one version. `values` are irradiance / π = outgoing radiance / albedo, linear RGB, (elements, 3),
    read-only; multiply by the albedo to get radiance. `Scene.elements` tells where each element is. Of the part `error`
    they are standard errors, three times the same."""

    version: int = 0
    values: NDArray[np.float32] = field(default_factory=_no_values)

    def __len__(self) -> int:
        return len(self.values)

    def apply(self, frames: Iterable[Frame]) -> LightMap:
        """The light map after the frames of one snapshot or several. This one stays as it is. Raises
        :class:`DeltaError` where they do not begin at this version."""
        values, version, is_whole = self.values.copy(), self.version, True
        for frame in frames:
            if is_whole and not frame.replaces and frame.base != version:
                raise DeltaError(f"a frame from version {frame.base} for a light map of version {version}")
            if frame.replaces:
                values = _no_values()
            if frame.end > len(values):
                values = np.concatenate([values, np.zeros((frame.end - len(values), 3), np.float32)])
            values[frame.indices] = frame.values
            version, is_whole = frame.new, frame.is_last
        if not is_whole:
            raise DeltaError("the last frame of a snapshot is missing")
        values.flags.writeable = False
        return LightMap(version, values)

    @staticmethod
    def read(data: bytes) -> LightMap:
        """The light map that bytes in the delta format from version 0 hold. Raises :class:`DeltaError`."""
        return LightMap().apply(read_frames(data))


def read_frames(data: bytes) -> list[Frame]:
    """All frames of a whole answer. Raises :class:`DeltaError`."""
    reader = FrameReader()
    frames = reader.feed(data)
    if not reader.is_between_frames:
        raise DeltaError("the last frame ends too soon")
    return frames


@dataclass(frozen=True)
class Elements:
    """Where every element of the light map is. Holes that removed objects left have area 0 and object 4294967295."""

    #: (elements, 3), world space, metres.
    position: NDArray[np.float32]
    #: (elements, 3).
    normal: NDArray[np.float32]
    #: (elements,), m².
    area: NDArray[np.float32]
    #: (elements,), `index` of the object.
    object: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.area)

    @staticmethod
    def read(data: bytes) -> Elements:
        """From 32 bytes per element; the arrays are views of them."""
        kind = np.dtype([("position", "<f4", 3), ("normal", "<f4", 3), ("area", "<f4"), ("object", "<u4")])
        rows = np.frombuffer(data, kind)
        return Elements(rows["position"], rows["normal"], rows["area"], rows["object"])
