"""What an upload may say, and what kind of file it is."""

from __future__ import annotations

import io
import json
import os
import posixpath
import re
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypedDict, Union
from urllib.parse import unquote

#: A file by its path, or its bytes.
File = Union[str, "os.PathLike[str]", bytes]


class Upload(TypedDict, total=False):
    """Settings of a new scene; what is absent the service chooses."""

    #: Name for people.
    name: str
    #: Largest distance between neighbouring elements, metres.
    spacing: float
    #: How many elements there are to be, in place of a spacing.
    elements: int
    #: `full` or `indirect`.
    mode: str
    #: What the scene works towards: samples per element, seconds from the upload, stated error.
    samples: int
    max_seconds: float
    target_rmse: float
    #: Begin to bake at once; true where absent.
    bake: bool
    #: `vertices` or `atlas`, and texels per metre of the latter.
    layout: str
    texels_per_metre: float
    #: `shared`, `each`, or layers by name with their lights.
    layers: str | Mapping[str, Sequence[str]]
    #: Radiance from everywhere outside, or a picture of the sky (an asset) with degrees about +y and a factor.
    environment: Sequence[float]
    sky: str
    sky_rotation: float
    sky_strength: float
    default_sky: bool
    #: Discs of directional lights, degrees; unit of point and spot lights, `candela` or `watt`.
    sun_angle: float
    unit: str
    max_albedo: float
    #: `low`, `normal` or `high`.
    priority: str


def upload_query(settings: Upload) -> dict[str, str]:
    """The settings as the API's query."""
    query = {}
    for name, value in settings.items():
        query["samples_per_element" if name == "samples" else name] = _text(value)
    return query


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        return json.dumps(dict(value), default=list)
    if isinstance(value, str):
        return value
    if isinstance(value, Sequence):
        return ",".join(repr(float(one)) for one in value)
    return str(value)


def read_file(file: File) -> bytes:
    """The bytes of a file; of a `.gltf` that names files beside it, a zip archive with them. Raises `OSError`."""
    if isinstance(file, bytes):
        return file
    path = Path(file)
    data = path.read_bytes()
    return _packed(path, data) if path.suffix.lower() == ".gltf" else data


def _packed(path: Path, data: bytes) -> bytes:
    try:
        document = json.loads(data.decode("utf-8-sig"))
        entries = [*document.get("buffers", []), *document.get("images", [])]
        uris = [entry["uri"] for entry in entries if "uri" in entry]
    except (ValueError, AttributeError, TypeError, KeyError):
        return data  # the service says what is wrong with it
    names = {unquote(re.split(r"[?#]", uri.strip())[0]).replace("\\", "/") for uri in uris}
    # Addresses and data within the document have a colon before the first slash.
    names = {name for name in names if name and not name.startswith("/") and ":" not in name.split("/")[0]}
    there = sorted(name for name in names if (path.parent / name).is_file())
    if not there:
        return data
    # Deep enough for names that lead out of the document's folder.
    depth = "/".join(["above"] * max(posixpath.normpath(name).split("/").count("..") for name in there))
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in [(path.name, data), *((name, (path.parent / name).read_bytes()) for name in there)]:
            # A fixed time: the same files are the same bytes, and the same asset.
            packed.writestr(zipfile.ZipInfo(posixpath.normpath(posixpath.join(depth, name))), content)
    return archive.getvalue()


def media_type(data: bytes) -> str:
    """Content type by the first bytes: a picture of the sky, else binary glTF, which the service checks."""
    if data.startswith(b"\x76\x2f\x31\x01"):
        return "image/x-exr"
    if data.startswith(b"#?"):
        return "image/vnd.radiance"
    if data.startswith(b"PK"):
        return "application/zip"
    return "model/gltf-binary"
