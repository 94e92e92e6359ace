"""Carries out the steps of the shared core with the standard library: Blender's Python has no HTTPX, and an extension
should bring no packages along that it can do without."""

from __future__ import annotations

import http.client
import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, TypeVar
from urllib.parse import urlencode, urlsplit

from .core.problems import RebakeError, TransportFailed
from .core.steps import Close, Flow, Item, Now, Open, Read, Request, Response, Send, Sleep, Step, Stream

T = TypeVar("T")

#: Seconds: until an answer begins, and until a stream, which tells of itself every 15 s, is taken for lost.
ANSWER_TIMEOUT, STREAM_SILENCE = 60.0, 60.0


class Stopped(RebakeError):
    """The driver was told to stop."""


class Driver:
    """Carries out flows, one at a time, on the thread that calls. :meth:`stop` ends it from any thread."""

    def __init__(self, server: str, token: str | None) -> None:
        parts = urlsplit(server if "//" in server else f"http://{server}")
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise RebakeError(f"not the address of a service: {server}")
        self._address, self._base = parts, parts.path.rstrip("/")
        self._token = token
        self._stream: tuple[http.client.HTTPConnection, http.client.HTTPResponse] | None = None
        self._stopped = False

    def run(self, flow: Flow[T]) -> T:
        """The answer of a flow."""
        answers: list[T] = []

        def stream() -> Stream[None]:
            answers.append((yield from flow))

        for _ in self.items(stream()):
            pass
        return answers[0]

    def items(self, stream: Stream[T]) -> Iterator[T]:
        """The items of a stream."""
        try:
            step = next(stream)
            while True:
                if self._stopped:
                    raise Stopped("stopped")
                if isinstance(step, Item):
                    yield step.value
                    step = next(stream)
                    continue
                try:
                    result = self._perform(step)
                except TransportFailed as failed:
                    step = stream.throw(failed)
                else:
                    step = stream.send(result)
        except StopIteration:
            return
        finally:
            self._close()

    def stop(self) -> None:
        """Ends what runs, soon."""
        self._stopped = True
        stream = self._stream
        if stream is not None and stream[0].sock is not None:
            with suppress(OSError):
                stream[0].sock.shutdown(socket.SHUT_RDWR)

    def _perform(self, step: Step) -> Any:
        if isinstance(step, Send):
            connection, response = self._send(step.request, ANSWER_TIMEOUT)
            return _whole(connection, response)
        if isinstance(step, Open):
            self._close()
            connection, response = self._send(step.request, STREAM_SILENCE)
            if response.status >= 400:
                return _whole(connection, response)
            self._stream = connection, response
            return Response(response.status, _headers(response), b"")
        if isinstance(step, Read):
            return b"" if self._stream is None else _guarded(lambda: self._stream[1].read1(1 << 16))
        if isinstance(step, Sleep):
            end = time.monotonic() + step.seconds
            while not self._stopped and (left := end - time.monotonic()) > 0:
                time.sleep(min(left, 0.1))
        if isinstance(step, Close):
            self._close()
        return time.monotonic() if isinstance(step, Now) else None

    def _send(self, request: Request, timeout: float) -> tuple[http.client.HTTPConnection, http.client.HTTPResponse]:
        secure = self._address.scheme == "https"
        kind = http.client.HTTPSConnection if secure else http.client.HTTPConnection
        connection = kind(self._address.hostname, self._address.port, timeout=5)
        try:
            connection.connect()
        except OSError as error:
            raise TransportFailed(f"the service cannot be reached: {error}", was_sent=False) from None
        connection.sock.settimeout(timeout)
        headers = dict(request.headers)
        if self._token:
            headers["authorization"] = f"Bearer {self._token}"
        target = self._base + request.path + (f"?{urlencode(request.query)}" if request.query else "")

        def exchange() -> http.client.HTTPResponse:
            connection.request(request.method, target, request.body, headers)
            return connection.getresponse()

        return connection, _guarded(exchange)

    def _close(self) -> None:
        if self._stream is not None:
            connection, self._stream = self._stream[0], None
            connection.close()


def _guarded(do: Any) -> Any:
    try:
        return do()
    except (OSError, http.client.HTTPException) as error:
        raise TransportFailed(f"{type(error).__name__}: {error}", was_sent=True) from None


def _headers(response: http.client.HTTPResponse) -> dict[str, str]:
    return {name.lower(): value for name, value in response.getheaders()}


def _whole(connection: http.client.HTTPConnection, response: http.client.HTTPResponse) -> Response:
    try:
        return Response(response.status, _headers(response), _guarded(response.read))
    finally:
        connection.close()
