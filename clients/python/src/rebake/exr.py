"""OpenEXR files as NumPy arrays; needs the extra `rebake[exr]`."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


def channels(data: bytes) -> dict[str, NDArray[Any]]:
    """The channels of a file by name, each (height, width)."""
    import OpenEXR

    # The library reads files only.
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "page.exr")
        path.write_bytes(data)
        with OpenEXR.File(str(path), separate_channels=True) as file:
            return {name: np.array(channel.pixels) for name, channel in file.channels().items()}


def read(data: bytes) -> NDArray[np.float32]:
    """The channels R, G and B of a file, (height, width, 3): of a page of an atlas irradiance / π, linear RGB."""
    found = channels(data)
    return np.stack([found[name] for name in "RGB"], axis=-1).astype(np.float32)
