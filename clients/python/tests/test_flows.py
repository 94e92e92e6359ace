"""Flows without a network: a script plays the service."""

from __future__ import annotations

import inspect
import json
from typing import Any

import pytest
from test_delta import frame

import rebake
from rebake import Problem, RebakeError, Remove, TransportFailed
from rebake.core.flows import SceneFlows, ServiceFlows
from rebake.core.follow import Follower
from rebake.core.jobs import EventFlows, JobFlows
from rebake.core.steps import Close, Item, Now, Open, Patience, Read, Request, Response, Send, Sleep

JOB = {
    "id": "j1", "scene": "s1", "accepted_edits": 1, "kind": "edit", "state": "running", "cancel_requested": False,
    "pause_requested": False, "priority": "normal", "created_at": "now",
    "progress": {"fraction": 0.5, "samples_per_element": 4, "elapsed_ms": 10, "rays": 100, "remaining_ms": 10},
}  # fmt: skip


class Script:
    """Answers requests in order; what is an exception is raised. Keeps what was asked and how long was slept."""

    def __init__(
        self,
        *answers: Response | Exception,
        pieces: list[list[bytes | Exception]] | None = None,
        seconds_per_read: float = 0,
    ) -> None:
        self.answers, self.pieces = list(answers), pieces or []
        self.requests: list[Request] = []
        self.slept: list[float] = []
        self.open: list[bytes | Exception] = []
        self.clock, self.seconds_per_read = 0.0, seconds_per_read

    def play(self, stream: Any) -> list[Any]:
        items: list[Any] = []
        step = next(stream)
        try:
            while True:
                if isinstance(step, Item):
                    items.append(step.value)
                    step = next(stream)
                    continue
                answer = self.perform(step)
                step = stream.throw(answer) if isinstance(answer, Exception) else stream.send(answer)
        except StopIteration as stop:
            return [*items, stop.value]

    def perform(self, step: Any) -> Any:
        if isinstance(step, (Send, Open)):
            self.requests.append(step.request)
            if isinstance(step, Open) and self.pieces:
                self.open = self.pieces.pop(0)
            return self.answers.pop(0)
        if isinstance(step, Read):
            self.clock += self.seconds_per_read
            return self.open.pop(0) if self.open else b""
        if isinstance(step, Sleep):
            self.slept.append(step.seconds)
            self.clock += step.seconds
        if isinstance(step, Now):
            return self.clock
        assert isinstance(step, (Sleep, Close))
        return None


def ok(value: Any, status: int = 200) -> Response:
    return Response(status, {}, json.dumps(value).encode())


def problem(status: int, kind: str, **headers: str) -> Response:
    document = {"type": f"/problems/{kind}", "title": kind, "status": status, "detail": "why", "field": "edits[0]"}
    return Response(
        status, {name.replace("_", "-"): value for name, value in headers.items()}, json.dumps(document).encode()
    )


def test_an_edit_is_repeated_with_the_same_key() -> None:
    script = Script(
        TransportFailed("lost", was_sent=True),
        problem(429, "queue-full", retry_after="3"),
        Response(502, {}, b"<html>"),
    )
    with pytest.raises(Problem, match="HTTP 502"):
        script.play(SceneFlows(Patience(), "s1").edit(Remove("sofa")))
    keys = {request.headers["idempotency-key"] for request in script.requests}
    assert len(script.requests) == 3 and len(keys) == 1 and script.slept == [0.1, 3.0]


def test_an_upload_is_not_made_twice() -> None:
    lost = Script(TransportFailed("lost", was_sent=True), problem(400, "malformed-file"))
    with pytest.raises(Problem):
        lost.play(ServiceFlows().upload(b"glTF", {}))
    keys = {request.headers["idempotency-key"] for request in lost.requests}
    assert len(lost.requests) == 2 and len(keys) == 1
    refused = Script(
        TransportFailed("not there", was_sent=False), problem(503, "restoring"), problem(400, "malformed-file")
    )
    with pytest.raises(Problem) as told:
        refused.play(ServiceFlows().upload(b"glTF", {}))
    assert len(refused.requests) == 3
    assert (told.value.kind, told.value.field, told.value.status) == ("malformed-file", "edits[0]", 400)


def test_patience_ends() -> None:
    script = Script(*[TransportFailed("not there", was_sent=False)] * 99)
    with pytest.raises(TransportFailed):
        script.play(ServiceFlows(Patience(1)).assets())
    assert 1 <= sum(script.slept) < 2
    # But for a scene that is being laid out: that ends by itself.
    script = Script(*[problem(503, "scene-preparing")] * 200, ok({"points": []}), ok({}))
    with pytest.raises(RebakeError, match="SceneInfo.id is missing"):
        script.play(SceneFlows(Patience(1), "s1").info())
    assert len(script.requests) == 201


def test_lists_are_read_to_their_last_page() -> None:
    script = Script(ok({"items": [JOB], "next_cursor": "c"}), ok({"items": [JOB, JOB], "next_cursor": None}))
    (jobs,) = script.play(ServiceFlows().jobs(scene="s1"))
    assert len(jobs) == 3 and [dict(request.query) for request in script.requests] == [
        {"scene": "s1"},
        {"scene": "s1", "cursor": "c"},
    ]


def event(id: int, name: str, data: Any) -> bytes:
    return f"id: {id}\nevent: {name}\ndata: {json.dumps(data)}\n\n".encode()


def test_events_go_on_behind_the_last_one() -> None:
    first = event(7, "job", {"a": 1}) + b": ping\n\n" + event(8, "job", {"a": 2})[:20]
    pieces: list[list[bytes | Exception]] = [
        [first, TransportFailed("lost", was_sent=True)],
        [event(8, "job", {"a": 2})],
    ]
    script = Script(Response(200, {}, b""), Response(200, {}, b""), Response(204, {}, b""), pieces=pieces)
    *events, _ = script.play(EventFlows(Patience(), "/e").events())
    assert [(found.id, found.data) for found in events] == [("7", {"a": 1}), ("8", {"a": 2})]
    assert [request.headers.get("last-event-id") for request in script.requests] == [None, "7", "8"]


def test_waiting_for_a_job_has_an_end() -> None:
    pieces: list[list[bytes | Exception]] = [[event(at, "job", JOB) for at in range(99)]]
    script = Script(ok(JOB), Response(200, {}, b""), pieces=pieces, seconds_per_read=1)
    with pytest.raises(TimeoutError, match="j1"):
        script.play(JobFlows(Patience(), "j1").wait(timeout=5))
    assert len(pieces) == 0 and 90 < len(script.open) < 99


def scene_of(**values: Any) -> dict[str, Any]:
    names = ("spacing", "elements_version", "elements", "live_elements", "triangles", "memory_bytes")
    scene: dict[str, Any] = dict.fromkeys((*names, "accepted_edits", "unlit_edits"), 0)
    scene |= {name: [] for name in ("objects", "lights", "layers", "cameras", "warnings")}
    return (
        scene | {"id": "s1", "name": "", "state": "ready", "mode": "full", "version": 5, "created_at": "now"} | values
    )


def test_an_upload_is_done_when_the_scene_is_laid_out() -> None:
    script = Script(*[ok(scene_of(state=state)) for state in ("preparing", "preparing", "ready")])
    (scene,) = script.play(ServiceFlows().upload(b"glTF", {}))
    assert scene.state == "ready" and [one.method for one in script.requests] == ["POST", "GET", "GET"]


def test_following_starts_over_where_its_version_is_unknown() -> None:
    scene = scene_of()
    gone = problem(410, "version-forgotten")
    whole = Response(200, {}, frame(0, 5, [(0, 1)], [1, 2, 3]))
    deleted = event(2, "scene", {"scene": "s1", "what": "deleted", "version": 5, "elements_version": 0})
    pieces: list[list[bytes | Exception]] = [[event(1, "reset", {}), deleted]]
    script = Script(Response(200, {}, b""), ok(scene), gone, ok(scene), whole, pieces=pieces)
    old = rebake.LightMap(3, rebake.LightMap.read(frame(0, 3, [(0, 2)], [1.0] * 6)).values)
    snapshot, _ = script.play(Follower(SceneFlows(Patience(), "s1"), old).snapshots())
    assert [request.path.rsplit("/", 1)[-1] for request in script.requests[2::2]] == ["3-5", "0-5"]
    assert snapshot.version == 5 and snapshot.values.tolist() == [[1, 2, 3]] and snapshot.complete


def test_old_light_on_new_geometry_states_no_error() -> None:
    def snapshot_of(version: int, samples: int | None) -> bytes:
        data = {"scene": "s1", "version": version, "elements_version": 1, "estimated_rmse": 0.5}
        return event(version, "snapshot", {**data, "samples_per_element": samples})

    pieces: list[list[bytes | Exception]] = [[snapshot_of(1, None) + snapshot_of(2, 4)]]
    deltas = [Response(200, {}, frame(at, at + 1, [(0, 1)], [1, 2, at])) for at in range(2)]
    script = Script(Response(200, {}, b""), *deltas, Response(204, {}, b""), pieces=pieces)
    *snapshots, _ = script.play(Follower(SceneFlows(Patience(), "s1"), rebake.LightMap()).snapshots())
    assert [(found.version, found.stated_error) for found in snapshots] == [(1, None), (2, 0.5)]


def test_both_clients_do_the_same() -> None:
    for blocking, waiting in [
        (rebake.Client, rebake.AsyncClient),
        (rebake.Scene, rebake.AsyncScene),
        (rebake.Job, rebake.AsyncJob),
    ]:
        names = [{name for name in dir(kind) if not name.startswith("_")} for kind in (blocking, waiting)]
        assert names[0] == names[1] and len(names[0]) > 5
        for name in names[0] - {"id"}:
            one, other = getattr(blocking, name), getattr(waiting, name)
            assert list(inspect.signature(one).parameters) == list(inspect.signature(other).parameters), name
            assert one.__doc__, name
