"""Calls about jobs, and events of whatever has some, as flows."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import quote

from . import models
from .decode import decode
from .problems import JobFailed, TransportFailed
from .sse import Event, EventReader
from .steps import (
    Close,
    Enough,
    Flow,
    Item,
    Now,
    Patience,
    Read,
    Request,
    Response,
    Sleep,
    Stream,
    call,
    for_each,
    waits,
)


@dataclass(frozen=True)
class EventFlows:
    """Server-sent events of one path, across lost connections."""

    patience: Patience
    path: str

    def events(self) -> Stream[Event]:
        """Events, until the service says that there will be no more. After a lost connection it goes on behind the last
        one, or with a `reset` that has the whole state; gives up when nothing has come for as long as patience
        lasts."""
        last: str | None = None
        attempts = waits(self.patience)
        while True:
            headers = {"accept": "text/event-stream", **({"last-event-id": last} if last else {})}
            response: Response = yield from call(Request("GET", self.path, headers=headers), self.patience, stream=True)
            if response.status == 204:
                return
            reader = EventReader()
            failure = TransportFailed("the stream of events ends again and again", was_sent=True)
            try:
                while data := (yield Read()):
                    for event in reader.feed(data):
                        last, attempts = event.id or last, waits(self.patience)
                        yield Item(event)
            except TransportFailed as failed:
                failure = failed
            yield Close()
            pause = next(attempts, None)
            if pause is None:
                raise failure
            yield Sleep(pause)


@dataclass(frozen=True)
class JobFlows:
    """Calls that are about one job."""

    patience: Patience
    id: str

    @property
    def path(self) -> str:
        return f"/v1/jobs/{quote(self.id, '')}"

    def _job(self, method: str, path: str) -> Flow[models.JobInfo]:
        response = yield from call(Request(method, path), self.patience)
        return decode(models.JobInfo, response.json())

    def info(self) -> Flow[models.JobInfo]:
        """The job as it is now."""
        return self._job("GET", self.path)

    def cancel(self) -> Flow[models.JobInfo]:
        """Stops it; the light map stays at the last consistent version, and edits stay made. A running job ends
        soon."""
        return self._job("DELETE", self.path)

    def pause(self) -> Flow[models.JobInfo]:
        """Makes it wait until :meth:`resume`."""
        return self._job("POST", f"{self.path}/pause")

    def resume(self) -> Flow[models.JobInfo]:
        """Puts it in line again."""
        return self._job("POST", f"{self.path}/resume")

    def progress(self) -> Stream[models.JobInfo]:
        """The job whenever something has happened to it, until it has ended: `progress.fraction`,
        `progress.remaining_ms`, `progress.estimated_rmse`; its `state` says whether it waits."""
        job = yield from self.info()
        yield Item(job)
        if not job.has_ended:
            yield from for_each(EventFlows(self.patience, f"{self.path}/events").events(), _job_of)

    def wait(self, timeout: float | None = None) -> Flow[models.JobInfo]:
        """Waits for its end; answers how it ended. Raises :class:`JobFailed` where it failed or was canceled, and
        `TimeoutError` where it has not ended within `timeout` seconds (it tells of itself every 15 s at least)."""
        end = None if timeout is None else (yield Now()) + timeout

        def each(job: models.JobInfo) -> Stream[None]:
            if job.has_ended:
                raise Enough
            if end is not None and (yield Now()) > end:
                raise TimeoutError(f"job {self.id} has not ended within {timeout} s")

        yield from for_each(self.progress(), each)  # type: ignore[misc]  # It gives no items.
        job = yield from self.info()
        if job.state != "succeeded":
            raise JobFailed(job)
        return job


def _job_of(event: Event) -> Stream[models.JobInfo]:
    if event.name in ("job", "reset"):
        yield Item(decode(models.JobInfo, event.data))
