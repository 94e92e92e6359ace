"""Everything that can go wrong, as exceptions below :class:`RebakeError`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .models import JobInfo


class RebakeError(Exception):
    """Something that a rebake service, or the way to it, did not do."""


class TransportFailed(RebakeError):
    """The service could not be reached, or a connection broke or took too long. `was_sent`: the service may have got
    the request all the same."""

    def __init__(self, why: str, *, was_sent: bool) -> None:
        super().__init__(why)
        self.was_sent = was_sent


class DeltaError(RebakeError):
    """Bytes of the delta format are damaged, or do not belong to the light map that they were to change."""


class JobFailed(RebakeError):
    """A job that was waited for failed or was canceled."""

    def __init__(self, job: JobInfo) -> None:
        super().__init__(f"job {job.id} {job.state}" + (f": {job.error}" if job.error else ""))
        self.job = job


class Problem(RebakeError):
    """The service refused a request, and says why in a problem document (RFC 9457).

    - `kind`: stable name of the problem, as `unknown-object`; the last segment of the document's `type`.
    - `title`: the kind in words. `detail`: what was wrong. `status`: HTTP status.
    - `field`: the field at fault, as `edits[1].objects[0]`, where there is one.
    - `retry_after`: seconds after which to ask again, where the service says so.
    """

    def __init__(
        self,
        kind: str,
        title: str,
        status: int,
        detail: str,
        field: str | None = None,
        retry_after: float | None = None,
    ) -> None:
        super().__init__(detail or title)
        self.kind, self.title, self.status = kind, title, status
        self.detail, self.field, self.retry_after = detail, field, retry_after

    @property
    def is_passing(self) -> bool:
        """Nothing was changed, and the same request may be accepted soon."""
        return self.status in (429, 503)

    @staticmethod
    def of(status: int, headers: Mapping[str, str], body: bytes) -> Problem:
        """Reads an answer of status 400 or above, also one that is not the service's own."""
        try:
            document = json.loads(body)
            kind = str(document["type"]).rsplit("/", 1)[-1]
            title, detail = str(document["title"]), str(document["detail"])
            field = document.get("field")
        except (ValueError, KeyError, TypeError):
            kind, title, field = "not-a-problem-document", f"HTTP {status}", None
            detail = f"HTTP {status}: {body[:200].decode('utf-8', 'replace')}"
        try:
            retry_after = float(headers["retry-after"])
        except (KeyError, ValueError):
            retry_after = None
        return Problem(kind, title, status, detail, field, retry_after)
