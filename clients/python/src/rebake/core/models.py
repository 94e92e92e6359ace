"""What the service tells, as immutable dataclasses. Metres, +y up, right-handed; linear RGB with Rec. 709 primaries."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Budget:
    """When work stops: at the first bound that is reached."""

    samples_per_element: int | None = None
    #: From when the request was accepted.
    max_seconds: float | None = None
    #: Stated area-weighted RMSE, irradiance / π.
    target_rmse: float | None = None


@dataclass(frozen=True)
class Bounds:
    """An axis-aligned box in world space, metres."""

    min: tuple[float, ...]
    max: tuple[float, ...]


@dataclass(frozen=True)
class ElementRange:
    """Neighbouring elements of the light map."""

    first: int
    count: int

    @property
    def slice(self) -> slice:
        """Picks these elements from an array of all."""
        return slice(self.first, self.first + self.count)


@dataclass(frozen=True)
class LightError:
    """Errors of light, irradiance / π; none where nothing is known."""

    #: Of chance: it falls with samples.
    noise: float | None = None
    #: Of the distance between elements: it falls with that, and with nothing else.
    resolution: float | None = None


@dataclass(frozen=True)
class SceneObject:
    """An object: a node with a mesh, the unit of an edit."""

    index: int
    name: str
    elements: ElementRange
    with_back: bool
    triangles: int
    bounds: Bounds
    #: Mean diffuse albedo.
    albedo: tuple[float, ...]
    #: Object space to world space, column-major.
    transform: tuple[float, ...]
    hidden: bool
    #: Errors of its light.
    light_error: LightError = LightError()
    #: Index of the node in the uploaded file.
    node: int | None = None
    #: `extras.id` of the node, where the file has one.
    id: str | None = None

    @property
    def matrix(self) -> NDArray[np.float64]:
        """Object space to world space as a 4 × 4 matrix, `matrix @ (x, y, z, 1)`."""
        rows: NDArray[np.float64] = np.array(self.transform, np.float64).reshape(4, 4).T
        return rows


@dataclass(frozen=True)
class LightInfo:
    """A light; its strength is `color` × `intensity`, in the unit of its kind."""

    name: str
    #: `emissive`, `point`, `spot`, `directional` or `environment`.
    kind: str
    color: tuple[float, ...]
    intensity: float
    layer: str | None = None
    #: The object that emits.
    object: str | None = None
    position: tuple[float, ...] | None = None
    direction: tuple[float, ...] | None = None
    #: Where the light of a point or spot light ends, metres.
    range: float | None = None
    #: Radians from `direction`: full intensity up to the one, no light beyond the other.
    inner_cone_angle: float | None = None
    outer_cone_angle: float | None = None
    angle: float | None = None
    rotation: float | None = None
    #: Index of its node in the uploaded file, of an emissive surface that of its object; none for what was inserted.
    node: int | None = None
    #: `extras.id` of the node, where the file has one.
    id: str | None = None


@dataclass(frozen=True)
class LayerLight:
    """A light of a layer, with the strength at which the layer holds its light."""

    name: str
    reference: tuple[float, ...]


@dataclass(frozen=True)
class Layer:
    """Part of the light map: the light of some lights at reference strengths."""

    name: str
    weight: tuple[float, ...]
    lights: tuple[LayerLight, ...]
    memory_bytes: int


@dataclass(frozen=True)
class Camera:
    """A camera of the file."""

    index: int
    name: str
    eye: tuple[float, ...]
    target: tuple[float, ...]
    up: tuple[float, ...]
    #: Vertical field of view, radians.
    fov_y: float


@dataclass(frozen=True)
class SceneInfo:
    """A scene with all that is in it, as of when it was asked for."""

    id: str
    name: str
    #: `preparing`, `ready` or `damaged`.
    state: str
    #: What the light map holds: `full` or `indirect` light.
    mode: str
    spacing: float
    version: int
    #: Version at which elements, objects or lights last changed.
    elements_version: int
    #: Length of the light map; `live_elements` of them are in use.
    elements: int
    live_elements: int
    triangles: int
    memory_bytes: int
    #: Edit requests that were accepted so far: what `if_accepted` compares with.
    accepted_edits: int
    unlit_edits: int
    objects: tuple[SceneObject, ...]
    lights: tuple[LightInfo, ...]
    layers: tuple[Layer, ...]
    cameras: tuple[Camera, ...]
    warnings: tuple[str, ...]
    created_at: str
    #: How elements are spread: `uniform` or `light`.
    sizing: str | None = None
    texels_per_metre: float | None = None
    #: Stated error: area-weighted RMSE of the light map, irradiance / π.
    estimated_rmse: float | None = None
    #: Its errors, each: of chance, and of the distance between elements.
    light_error: LightError = LightError()
    target: Budget | None = None
    current_job: str | None = None
    error: str | None = None
    #: How many of the accepted edits `version` shows; objects and lights are told after all of them.
    published_edits: int = 0

    def object(self, name: str) -> SceneObject:
        """The object of that name. Raises `KeyError`."""
        return next((found for found in self.objects if found.name == name), None) or _missing(name)

    def light(self, name: str) -> LightInfo:
        """The light of that name. Raises `KeyError`."""
        return next((found for found in self.lights if found.name == name), None) or _missing(name)


def _missing(name: str) -> Any:
    raise KeyError(name)


@dataclass(frozen=True)
class SceneSummary:
    """A scene in a list."""

    id: str
    name: str
    state: str
    mode: str
    spacing: float
    version: int
    elements: int
    object_count: int
    created_at: str
    current_job: str | None = None
    error: str | None = None


@dataclass(frozen=True)
class ScenePlan:
    """What a scene would take, as a dry run tells."""

    spacing: float
    elements: int
    triangles: int
    objects: int
    lights: int
    memory_bytes: int
    warnings: tuple[str, ...]
    degenerate_triangles: int


@dataclass(frozen=True)
class JobProgress:
    """How far a job is."""

    #: Part of the budget that is used, 0 to 1.
    fraction: float
    samples_per_element: int
    elapsed_ms: int
    rays: int
    #: To the end of the budget at the pace so far; none while nothing is measured.
    remaining_ms: int | None = None
    estimated_rmse: float | None = None
    light_error: LightError = LightError()
    version: int | None = None


@dataclass(frozen=True)
class JobInfo:
    """The work that brings a light map up to date, as of when it was asked for."""

    id: str
    scene: str
    #: The scene's accepted edits up to this one are lit by it.
    accepted_edits: int
    #: `bake`, `edit` or `refine`.
    kind: str
    #: `queued`, `running`, `paused`, `succeeded`, `failed` or `canceled`.
    state: str
    cancel_requested: bool
    pause_requested: bool
    priority: str
    progress: JobProgress
    created_at: str
    started_at: str | None = None
    finished_at: str | None = None
    merged_into: str | None = None
    error: str | None = None
    #: What to know of how it ended.
    warnings: tuple[str, ...] = ()

    @property
    def has_ended(self) -> bool:
        """It succeeded, failed or was canceled."""
        return self.state in ("succeeded", "failed", "canceled")


@dataclass(frozen=True)
class HistoryEntry:
    """An accepted edit request, with the JSON that was sent."""

    sequence: int
    request: Any
    undone: bool
    job: str | None = None
    accepted_at: str | None = None
    undoes: int | None = None
    redoes: int | None = None


@dataclass(frozen=True)
class Asset:
    """An uploaded asset. `asset` is its content hash, which `Insert` and `Sky` name."""

    asset: str
    triangles: int
    warnings: tuple[str, ...] = ()
    #: Texels across and down of a picture of the sky.
    picture: tuple[int, ...] | None = None


@dataclass(frozen=True)
class AssetSummary:
    """An asset in a list."""

    asset: str
    triangles: int
    bytes: int
    memory_bytes: int
    scenes: tuple[str, ...]
    picture: tuple[int, ...] | None = None


@dataclass(frozen=True)
class AtlasPage:
    """Size of a page in texels."""

    width: int
    height: int


@dataclass(frozen=True)
class AtlasPlace:
    """A rectangle of a page: coordinates × `scale` + `offset`, from 0 to 1, origin top left."""

    page: int
    scale: tuple[float, ...]
    offset: tuple[float, ...]


@dataclass(frozen=True)
class AtlasObject:
    """Where an object lies in the atlas: coordinates × `scale` + `offset`, from 0 to 1, origin top left."""

    object: str
    page: int
    scale: tuple[float, ...]
    offset: tuple[float, ...]
    #: `file`: the coordinates are the file's `TEXCOORD_1`. `made`: those in the glTF of `layout="atlas"`.
    texcoord: str
    texels_per_metre: float
    #: Where its back lies, which has the same coordinates, where that has light of its own.
    back: AtlasPlace | None = None


@dataclass(frozen=True)
class Atlas:
    """Where the objects of a scene lie on the pages of its atlas."""

    version: int
    texels_per_metre: float
    pages: tuple[AtlasPage, ...]
    objects: tuple[AtlasObject, ...] = field(default=())


@dataclass(frozen=True)
class Samples:
    """Light at points: irradiance / π on the side of each normal, with standard errors."""

    version: int
    part: str
    #: (points, 3), linear RGB.
    light: NDArray[np.float32]
    #: (points,); NaN where none is stated.
    error: NDArray[np.float32]
