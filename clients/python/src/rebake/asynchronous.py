"""The client for `async` programs, on asyncio or Trio: the blocking one with `await`, by the same flows."""

from __future__ import annotations

import functools
from collections.abc import AsyncIterator, Callable, Coroutine
from types import TracebackType
from typing import TYPE_CHECKING, Any, Concatenate, Generic, ParamSpec, TypeVar

import anyio
import httpx

from .core.delta import LightMap
from .core.flows import SceneFlows, ServiceFlows
from .core.follow import Follower, Snapshot
from .core.jobs import JobFlows
from .core.models import JobInfo
from .core.steps import Close, Flow, Item, Now, Open, Patience, Read, Send, Sleep, Step, Stream
from .core.uploads import File, Upload
from .http import build, failure_of, head_of, options, whole_of

if TYPE_CHECKING:
    from typing_extensions import Self, Unpack

P = ParamSpec("P")
T = TypeVar("T")
F = TypeVar("F")


class _Driver:
    """Carries out the steps of one flow."""

    def __init__(self, http: httpx.AsyncClient) -> None:
        self.http = http
        self.open: httpx.Response | None = None
        self.pieces: AsyncIterator[bytes] | None = None

    async def items(self, stream: Stream[T]) -> AsyncIterator[T]:
        try:
            step = next(stream)
            while True:
                if isinstance(step, Item):
                    yield step.value
                    step = next(stream)
                    continue
                try:
                    result = await self.perform(step)
                except httpx.RequestError as error:
                    step = stream.throw(failure_of(error))
                else:
                    step = stream.send(result)
        except StopIteration:
            return
        finally:
            await self.close()

    async def perform(self, step: Step) -> Any:
        match step:
            case Send(request):
                return whole_of(await self.http.send(build(self.http, request)))
            case Open(request):
                await self.close()
                self.open = await self.http.send(build(self.http, request, stream=True), stream=True)
                if self.open.status_code >= 400:
                    await self.open.aread()
                    return whole_of(self.open)
                self.pieces = self.open.aiter_bytes()
                return head_of(self.open)
            case Read():
                return b"" if self.pieces is None else await anext(self.pieces, b"")
            case Close():
                await self.close()
            case Sleep(seconds):
                await anyio.sleep(seconds)
            case Now():
                return anyio.current_time()

    async def close(self) -> None:
        if self.open is not None:
            await self.open.aclose()
            self.open = None


class _Handle(Generic[F]):
    """Something of the service, by its flows."""

    def __init__(self, http: httpx.AsyncClient, flows: F) -> None:
        self._http, self._flows = http, flows

    async def _run(self, flow: Flow[T]) -> T:
        answers: list[T] = []

        def stream() -> Stream[None]:
            answers.append((yield from flow))

        async for _ in _Driver(self._http).items(stream()):
            pass
        return answers[0]

    def _items(self, stream: Stream[T]) -> AsyncIterator[T]:
        return _Driver(self._http).items(stream)


def _does(flow: Callable[Concatenate[F, P], Flow[T]]) -> Callable[Concatenate[_Handle[F], P], Coroutine[Any, Any, T]]:
    @functools.wraps(flow)
    async def method(self: _Handle[F], /, *args: P.args, **kwargs: P.kwargs) -> T:
        return await self._run(flow(self._flows, *args, **kwargs))

    return method


def _starts(
    flow: Callable[Concatenate[SceneFlows, P], Flow[JobInfo]],
) -> Callable[Concatenate[AsyncScene, P], Coroutine[Any, Any, AsyncJob]]:
    @functools.wraps(flow)
    async def method(self: AsyncScene, /, *args: P.args, **kwargs: P.kwargs) -> AsyncJob:
        return AsyncJob(
            self._http, JobFlows(self._flows.patience, (await self._run(flow(self._flows, *args, **kwargs))).id)
        )

    return method


class AsyncJob(_Handle[JobFlows]):
    """The work that brings a light map up to date after an upload or an edit."""

    @property
    def id(self) -> str:
        """Its id."""
        return self._flows.id

    info = _does(JobFlows.info)
    cancel = _does(JobFlows.cancel)
    pause = _does(JobFlows.pause)
    resume = _does(JobFlows.resume)
    wait = _does(JobFlows.wait)

    def progress(self) -> AsyncIterator[JobInfo]:
        """The job whenever something has happened to it, until it has ended: `progress.fraction`,
        `progress.remaining_ms`, `progress.estimated_rmse`; its `state` says whether it waits."""
        return self._items(self._flows.progress())


class AsyncScene(_Handle[SceneFlows]):
    """A scene of the service. Holds nothing of it but its id: every call asks."""

    @property
    def id(self) -> str:
        """Its id."""
        return self._flows.id

    info = _does(SceneFlows.info)
    change = _does(SceneFlows.change)
    bake = _does(SceneFlows.bake)
    wait = _does(SceneFlows.wait)
    edit = _starts(SceneFlows.edit)
    undo = _starts(SceneFlows.undo)
    redo = _starts(SceneFlows.redo)
    history = _does(SceneFlows.history)
    jobs = _does(SceneFlows.jobs)
    light_map = _does(SceneFlows.light_map)
    elements = _does(SceneFlows.elements)
    export = _does(SceneFlows.export)
    object_file = _does(SceneFlows.object_file)
    atlas = _does(SceneFlows.atlas)
    atlas_page = _does(SceneFlows.atlas_page)
    atlas_pages = _does(SceneFlows.atlas_pages)
    render = _does(SceneFlows.render)
    sample = _does(SceneFlows.sample)
    delete = _does(SceneFlows.delete)

    def follow(self, start: LightMap | None = None) -> AsyncIterator[Snapshot]:
        """The light map whenever a new version is published, until the scene is deleted or the loop is left. Goes on by
        itself after a lost connection, from `start` where that is given: what has changed since is all that is fetched.
        The last snapshot for now is `complete`; it may have the version of the one before."""
        return self._items(Follower(self._flows, start or LightMap()).snapshots())


class AsyncClient(_Handle[ServiceFlows]):
    """A connection to one service.

    `token`: what it asks for, where it does. `timeout`: longest silence within one answer, seconds. `patience`: how
    long requests that fail for the moment are repeated, seconds. Use it in a `async with` statement, or close it.
    """

    def __init__(
        self, server: str = "http://127.0.0.1:7878", token: str | None = None, timeout: float = 60, patience: float = 10
    ) -> None:
        super().__init__(httpx.AsyncClient(**options(server, token, timeout)), ServiceFlows(Patience(patience)))

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Closes its connections."""
        await self._http.aclose()

    async def upload(self, file: File, **settings: Unpack[Upload]) -> AsyncScene:
        """Uploads a scene, a path or bytes: binary glTF, or a zip archive of a `.gltf` with its files. Its bake starts
        at once; :class:`Upload` has the settings."""
        return self.scene((await self._run(self._flows.upload(file, settings))).id)

    def scene(self, id: str) -> AsyncScene:
        """The scene of that id. Asks nothing."""
        return AsyncScene(self._http, SceneFlows(self._flows.patience, id))

    def job(self, id: str) -> AsyncJob:
        """The job of that id. Asks nothing."""
        return AsyncJob(self._http, JobFlows(self._flows.patience, id))

    plan = _does(ServiceFlows.plan)
    scenes = _does(ServiceFlows.scenes)
    jobs = _does(ServiceFlows.jobs)
    add_asset = _does(ServiceFlows.add_asset)
    assets = _does(ServiceFlows.assets)
    delete_asset = _does(ServiceFlows.delete_asset)
    is_ready = _does(ServiceFlows.is_ready)
    request = _does(ServiceFlows.request)
