"""Client of rebake: light maps that stay up to date while a 3D scene is edited.

>>> from rebake import Client, Move
>>> with Client() as client:                               # doctest: +SKIP
...     scene = client.upload("room.glb", spacing=0.1)
...     scene.bake(samples=64)
...     job = scene.edit(Move("sofa", matrix))
...     for snapshot in scene.follow():
...         print(snapshot.version, snapshot.stated_error, len(snapshot.changed))
...         if snapshot.complete:
...             break
"""

from .asynchronous import AsyncClient, AsyncJob, AsyncScene
from .blocking import Client, Job, Scene
from .core.delta import Elements, Frame, FrameReader, LightMap
from .core.edits import (
    DirectionalLight,
    Edit,
    EnvironmentLight,
    GroupLights,
    Hide,
    Insert,
    InsertLight,
    LightChange,
    Material,
    Move,
    MoveLight,
    Node,
    PointLight,
    Redo,
    Remove,
    RemoveLight,
    Show,
    Sky,
    SpotLight,
    Undo,
)
from .core.follow import Snapshot
from .core.models import (
    Asset,
    AssetSummary,
    Atlas,
    AtlasObject,
    Budget,
    HistoryEntry,
    JobInfo,
    JobProgress,
    LightInfo,
    Samples,
    SceneInfo,
    SceneObject,
    ScenePlan,
    SceneSummary,
)
from .core.problems import DeltaError, JobFailed, Problem, RebakeError, TransportFailed
from .core.tiles import AtlasPage, AtlasPages, Tile, TileFrame, read_tiles
from .core.uploads import Upload

__all__ = [
    "Asset",
    "AssetSummary",
    "AsyncClient",
    "AsyncJob",
    "AsyncScene",
    "Atlas",
    "AtlasObject",
    "AtlasPage",
    "AtlasPages",
    "Budget",
    "Client",
    "DeltaError",
    "DirectionalLight",
    "Edit",
    "Elements",
    "EnvironmentLight",
    "Frame",
    "FrameReader",
    "GroupLights",
    "Hide",
    "HistoryEntry",
    "Insert",
    "InsertLight",
    "Job",
    "JobFailed",
    "JobInfo",
    "JobProgress",
    "LightChange",
    "LightInfo",
    "LightMap",
    "Material",
    "Move",
    "MoveLight",
    "Node",
    "PointLight",
    "Problem",
    "RebakeError",
    "Redo",
    "Remove",
    "RemoveLight",
    "Samples",
    "Scene",
    "SceneInfo",
    "SceneObject",
    "ScenePlan",
    "SceneSummary",
    "Show",
    "Sky",
    "Snapshot",
    "SpotLight",
    "Tile",
    "TileFrame",
    "TransportFailed",
    "Undo",
    "Upload",
    "read_tiles",
]
