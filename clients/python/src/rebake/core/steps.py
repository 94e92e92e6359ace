"""The steps that flows ask of a driver, and what they share: repeating what failed for the moment.

A *flow* is a generator: it yields steps, is sent their results, and returns its answer. A *stream* is a flow that also
yields :class:`Item`, one for each thing that whoever iterates over it gets.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar, Union

from .problems import Problem, TransportFailed

T = TypeVar("T")
U = TypeVar("U")

#: Seconds between attempts: the first, and the longest.
FIRST_WAIT, LONGEST_WAIT = 0.1, 5.0


@dataclass(frozen=True)
class Request:
    """One HTTP request. `path` begins with `/` and is percent-encoded; `query` is not encoded yet."""

    method: str
    path: str
    query: Mapping[str, str] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    body: bytes | None = None


@dataclass(frozen=True)
class Response:
    """One HTTP answer. Names of headers are in lower case. The body of an open stream is empty."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    def json(self) -> Any:
        """The body, which is JSON."""
        return json.loads(self.body)


@dataclass(frozen=True)
class Send:
    """Send a request; answers the :class:`Response` with its whole body."""

    request: Request


@dataclass(frozen=True)
class Open:
    """Send a request and keep its body open for :class:`Read`; answers the :class:`Response`. Errors (400 and above)
    are read to their end. There is one open body at a time."""

    request: Request


@dataclass(frozen=True)
class Read:
    """Answers the next bytes of the open body, none at its end."""


@dataclass(frozen=True)
class Close:
    """Close the open body. Where a flow ends, or nobody wants more of a stream, drivers do that by themselves."""


@dataclass(frozen=True)
class Sleep:
    """Wait."""

    seconds: float


@dataclass(frozen=True)
class Now:
    """Answers seconds on a clock that never goes back."""


@dataclass(frozen=True)
class Item(Generic[T]):
    """What a stream gives to whoever iterates over it."""

    value: T


Step = Union[Send, Open, Read, Close, Sleep, Now]
Flow = Generator[Step, Any, T]
Stream = Generator[Union[Step, Item[T]], Any, None]


@dataclass(frozen=True)
class Patience:
    """How long requests that fail for the moment are repeated: `seconds` of waiting between attempts, in all."""

    seconds: float = 10.0


def waits(patience: Patience) -> Generator[float, None, None]:
    """Seconds to wait before each new attempt."""
    wait, waited = FIRST_WAIT, 0.0
    while waited < patience.seconds:
        yield wait
        waited += wait
        wait = min(2 * wait, LONGEST_WAIT)


def call(request: Request, patience: Patience, *, repeatable: bool = True, stream: bool = False) -> Flow[Response]:
    """Sends a request, again where it failed for the moment.

    What the service has refused for the moment (429, 503) has changed nothing and is always repeated, after
    `Retry-After`; while a scene is being laid out without a limit, as that ends by itself. A connection that broke
    says not whether the request was carried out: it is repeated where that does no harm (`repeatable`), or where
    nothing of it was sent. Raises :class:`Problem` and :class:`TransportFailed`.
    """
    attempts = waits(patience)
    while True:
        failure: Problem | TransportFailed
        try:
            response: Response = yield (Open(request) if stream else Send(request))
        except TransportFailed as failed:
            if failed.was_sent and not repeatable:
                raise
            failure, wait = failed, 0.0
        else:
            if response.status < 400:
                return response
            failure = Problem.of(response.status, response.headers, response.body)
            if not failure.is_passing:
                raise failure
            wait = failure.retry_after or 0.0
        if isinstance(failure, Problem) and failure.kind == "scene-preparing":
            yield Sleep(max(wait, FIRST_WAIT))
            continue
        pause = next(attempts, None)
        if pause is None:
            raise failure
        yield Sleep(max(wait, pause))


class Enough(Exception):
    """Raised by what :func:`for_each` calls: nothing more is wanted of the stream."""


def for_each(stream: Stream[T], each: Callable[[T], Stream[U]]) -> Stream[U]:
    """The stream's steps, and in place of each of its items what `each` makes of it."""
    step: Step | Item[T] | None = next(stream, None)
    try:
        while step is not None:
            if isinstance(step, Item):
                yield from each(step.value)
                step = next(stream, None)
            else:
                step = yield from _forward(stream, step)
    except Enough:
        stream.close()


def _forward(stream: Stream[T], step: Step) -> Generator[Step, Any, Step | Item[T] | None]:
    """Carries out a step of the stream; answers its next one, none at its end."""
    try:
        result = yield step
    except TransportFailed as failed:
        return _or_none(stream.throw, failed)
    return _or_none(stream.send, result)


def _or_none(advance: Callable[[Any], Step | Item[T]], value: Any) -> Step | Item[T] | None:
    try:
        return advance(value)
    except StopIteration:
        return None
