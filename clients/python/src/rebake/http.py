"""Requests and answers of the core as those of HTTPX, for both clients."""

from __future__ import annotations

from typing import Any, TypedDict

import httpx

from .core.problems import TransportFailed
from .core.steps import Request, Response

#: Streams tell of themselves every 15 s; what is silent for longer than this is lost.
STREAM_SILENCE = 60.0


class Options(TypedDict):
    """What both of HTTPX's clients are made with."""

    base_url: str
    headers: dict[str, str]
    timeout: httpx.Timeout


def options(server: str, token: str | None, timeout: float) -> Options:
    """How to talk to a service: `timeout` bounds the silence within one answer, seconds."""
    headers = {"authorization": f"Bearer {token}"} if token else {}
    return {"base_url": server, "headers": headers, "timeout": httpx.Timeout(timeout, connect=min(timeout, 5.0))}


def build(http: httpx.Client | httpx.AsyncClient, request: Request, *, stream: bool = False) -> httpx.Request:
    """The request for HTTPX."""
    more: dict[str, Any] = {"timeout": httpx.Timeout(STREAM_SILENCE, connect=5.0)} if stream else {}
    headers = dict(request.headers)
    # httpx would encode the path once more: it gets the whole address.
    url = httpx.URL(str(http.base_url).rstrip("/") + request.path)
    if request.query:
        url = url.copy_merge_params(dict(request.query))
    return http.build_request(request.method, url, headers=headers, content=request.body, **more)


def head_of(response: httpx.Response) -> Response:
    """An answer whose body is still to come."""
    return Response(response.status_code, {name.lower(): value for name, value in response.headers.items()}, b"")


def whole_of(response: httpx.Response) -> Response:
    """An answer that was read to its end."""
    head = head_of(response)
    return Response(head.status, head.headers, response.content)


def failure_of(error: httpx.RequestError) -> TransportFailed:
    """What went wrong on the way."""
    was_sent = not isinstance(error, (httpx.ConnectError, httpx.ConnectTimeout, httpx.PoolTimeout))
    return TransportFailed(f"{type(error).__name__}: {error}".rstrip(": "), was_sent=was_sent)
