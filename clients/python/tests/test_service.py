"""The blocking client against the real service."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import Service
from rooms import crate, room

from rebake import (
    Client,
    Hide,
    Insert,
    InsertLight,
    JobFailed,
    LightChange,
    LightMap,
    Material,
    Move,
    MoveLight,
    PointLight,
    Problem,
    Remove,
    Scene,
    Show,
    TransportFailed,
)

ASIDE = np.array([[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 0.3], [0, 0, 0, 1]])


def test_a_scene_is_baked_edited_and_deleted(client: Client, tmp_path: Path) -> None:
    file = tmp_path / "room.glb"
    file.write_bytes(room())
    plan = client.plan(file, {"spacing": 0.25})
    scene = client.upload(file, name="room of its own", spacing=0.25, bake=False, target_rmse=0.5)
    info = scene.info()
    assert info.elements == plan.elements and info.version == 0 and info.object("crate").id == "id of crate"
    assert info.light("lamp").kind == "point" and info.light("lamp").intensity == 4
    baked = scene.bake(samples=8, timeout=60)
    assert baked.version > 0 and baked.estimated_rmse is not None and 0 < baked.estimated_rmse < 1
    assert baked.target is not None and baked.target.samples_per_element == 8

    light_map, elements = scene.light_map(), scene.elements()
    assert len(light_map) == len(elements) == info.elements and light_map.version == baked.version
    assert light_map.values.dtype == np.float32 and light_map.values.min() >= 0 and light_map.values.mean() > 0.1
    top = (elements.object == 1) & (elements.normal[:, 1] > 0.9)
    assert np.allclose(elements.position[top, 1], 0.4) and top.any()
    smooth = scene.light_map(filter="statistical")
    assert smooth.values.shape == light_map.values.shape and not np.array_equal(smooth.values, light_map.values)
    error = scene.light_map(part="error").values[:, 0]
    stated = np.sqrt(np.average(error.astype(float) ** 2, weights=elements.area))
    assert stated == pytest.approx(baked.estimated_rmse, rel=0.05), "the error of the elements is that of the map"

    scene.edit(Move("crate", ASIDE), LightChange("lamp", intensity=8), samples=4).wait(60)
    moved = scene.info()
    assert np.allclose(moved.object("crate").matrix, ASIDE) and moved.light("lamp").intensity == 8
    assert [entry.request["edits"][0]["op"] for entry in scene.history()] == ["move"]
    scene.undo().wait(60)
    assert np.allclose(scene.info().object("crate").matrix, np.eye(4)) and scene.history()[0].undone
    scene.redo().wait(60)
    assert np.allclose(scene.info().object("crate").matrix, ASIDE)
    scene.delete()
    with pytest.raises(Problem) as gone:
        scene.info()
    assert (gone.value.kind, gone.value.status) == ("unknown-scene", 404)


def test_every_kind_of_edit_is_accepted(client: Client, scene: Scene) -> None:
    asset = client.add_asset(crate())
    assert asset.asset in [known.asset for known in client.assets()]
    scene.edit(
        Insert(asset.asset, "crate/2 ä", np.eye(4)),
        Material((0.1, 0.2, 0.3), object="crate"),
        InsertLight("lamp 2", PointLight((0.5, 1.5, 0.5), intensity=2)),
        MoveLight("lamp", position=(1.2, 1.5, 1.2)),
        samples=4,
    ).wait(60)
    info = scene.info()
    assert info.object("crate/2 ä").triangles >= 12 and np.allclose(info.object("crate").albedo, (0.1, 0.2, 0.3))
    assert np.allclose(info.light("lamp").position or (), (1.2, 1.5, 1.2)) and info.light("lamp 2").intensity == 2
    assert scene.object_file("crate/2 ä").startswith(b"glTF")
    scene.edit(Hide("crate*"), samples=4).wait(60)
    assert all(found.hidden for found in scene.info().objects if found.name != "room")
    scene.edit(Show("crate"), Remove("crate/2*"), samples=4).wait(60)
    assert [found.name for found in scene.info().objects if not found.hidden] == ["room", "crate"]
    with pytest.raises(Problem) as needed:
        client.delete_asset(asset.asset)
    assert needed.value.kind == "asset-needed"


def test_problems_name_the_field(client: Client, scene: Scene) -> None:
    with pytest.raises(Problem, match="sofa") as unknown:
        scene.edit(Remove("crate"), Remove(["room", "sofa"]))
    assert (unknown.value.kind, unknown.value.field) == ("unknown-object", "edits[1].objects[1]")
    assert [found.name for found in scene.info().objects] == ["room", "crate"], "all of a request or nothing"
    with pytest.raises(Problem) as query:
        client.upload(room(), spacing=-1)
    assert query.value.field == "spacing"
    with pytest.raises(Problem) as file:
        client.upload(b"no glTF")
    assert file.value.kind == "malformed-file"


def test_of_two_clients_one_wins(scene: Scene) -> None:
    accepted = scene.info().accepted_edits
    scene.edit(Hide("crate"), if_accepted=accepted)
    with pytest.raises(Problem) as late:
        scene.edit(Show("crate"), if_accepted=accepted)
    assert late.value.kind == "precondition-failed"


def test_a_key_makes_an_edit_safe_to_repeat(scene: Scene) -> None:
    jobs = {scene.edit(Hide("crate"), key="the same").id for _ in range(2)}
    assert len(jobs) == 1 and len(scene.history()) == 1


def test_snapshots_follow_an_edit(scene: Scene) -> None:
    scene.bake(samples=8, timeout=60)
    snapshots = scene.follow()
    first = next(snapshots)
    assert first.complete and first.stated_error == scene.info().estimated_rmse
    assert np.array_equal(first.values, scene.light_map().values)
    before = first.values.copy()
    job = scene.edit(Move("crate", ASIDE), samples=8)
    versions, errors = [first.version], []
    for snapshot in snapshots:
        errors.append(snapshot.stated_error)
        assert snapshot.version >= versions[-1] and snapshot.complete <= (snapshot.unlit_edits == 0)
        versions.append(snapshot.version)
        if snapshot.complete:
            break
    assert errors[-1] == scene.info().estimated_rmse
    assert versions[-1] > first.version and job.info().state == "succeeded"
    now = scene.light_map()
    assert snapshot.version == now.version and np.array_equal(snapshot.values, now.values), "bit for bit a download"
    assert np.array_equal(first.values, before), "what was given out stays as it is"
    # A client that comes back later gets what has changed since.
    resumed = next(scene.follow(first.light_map))
    assert resumed.complete and np.array_equal(resumed.values, now.values)
    assert {*np.flatnonzero((before != now.values[: len(before)]).any(axis=1))} <= {*resumed.changed}
    # And one whose copy is of another map gets the whole.
    other = LightMap(now.version + 1000, now.values)
    assert np.array_equal(next(scene.follow(other)).values, now.values)


def test_jobs_tell_of_themselves_and_stop(client: Client, scene: Scene) -> None:
    scene.change(name="long", max_seconds=50)
    running = scene.info().current_job
    assert running is not None
    job = client.job(running)
    seen = []
    for state in job.progress():
        seen.append(state)
        if state.progress.remaining_ms is not None:
            job.cancel()
            break
    seen += job.progress()
    assert seen[-1].state == "canceled" and any((one.progress.remaining_ms or 0) > 1000 for one in seen)
    assert running in [known.id for known in scene.jobs(state="canceled")]
    with pytest.raises(JobFailed, match="canceled") as canceled:
        job.wait(5)
    assert canceled.value.job.id == running
    with pytest.raises(Problem) as ended:
        job.cancel()
    assert ended.value.kind == "job-ended"


def test_light_is_sampled_at_points(scene: Scene) -> None:
    scene.bake(samples=16, timeout=60)
    samples = scene.sample([[1, 1.2, 1, 0, 1, 0], [1, 1.2, 1, 0, -1, 0]], samples=64, part="direct")
    # A lamp of 4 cd, 0.5 m above: E / π = 4 / 0.25 / π. None from below.
    assert samples.light[0] == pytest.approx(4 / 0.25 / np.pi, rel=1e-4) and samples.light[1].max() == 0
    with pytest.raises(ValueError, match="points"):
        scene.sample([[1, 2, 3]])


def test_files_and_pictures(scene: Scene) -> None:
    scene.bake(samples=4, timeout=60)
    assert scene.export("glb").startswith(b"glTF") and scene.export("exr").startswith(b"\x76\x2f\x31\x01")
    picture = scene.render(eye=(1, 1, 1.9), target=(1, 0.5, 0), width=32, height=32, spp=1)
    assert picture.startswith(b"\x89PNG")


def test_atlases_are_arrays(client: Client) -> None:
    pytest.importorskip("OpenEXR", reason="the extra rebake[exr] is not installed")
    from rebake import exr

    scene = client.upload(room(), spacing=0.25, texels_per_metre=8, samples=8)
    scene.wait(60)
    atlas = scene.atlas()
    assert {place.object for place in atlas.objects} == {"room", "crate"}
    page = exr.read(scene.atlas_page(atlas.objects[0].page, precision="float"))
    valid = exr.channels(scene.atlas_page(atlas.objects[0].page))["valid"]
    assert page.shape == (atlas.pages[0].height, atlas.pages[0].width, 3)
    # Texels are read from the elements: no brighter than those, and lit where there is a surface.
    assert page[valid > 0.5].mean() > 0 and page.max() <= scene.light_map().values.max() * 1.001
    # Tiles lead to the same bits, before and after an edit.
    pages = scene.atlas_pages(precision="float")
    assert np.array_equal(pages.pages[0].values, page) and np.array_equal(pages.pages[0].valid, valid > 0.5)
    scene.edit(Move("crate", ASIDE), samples=8).wait(60)
    after = scene.atlas_pages(pages, precision="float")
    now = exr.read(scene.atlas_page(0, precision="float"))
    assert after.version > pages.version and np.array_equal(after.pages[0].values, now) and (now != page).any()
    assert scene.atlas_pages(after, precision="float") is after
    scene.delete()


def test_a_token_opens_the_service(service: Service) -> None:
    if not service.token:
        pytest.skip("the service at REBAKE_SERVER needs no token")
    with Client(service.server, patience=0) as stranger, pytest.raises(Problem) as refused:
        stranger.scenes()
    assert refused.value.kind == "unauthorized"
    with service.client() as friend:
        assert friend.is_ready()


def test_a_service_that_is_not_there() -> None:
    with Client("http://127.0.0.1:9", patience=0) as client:
        assert not client.is_ready()
        with pytest.raises(TransportFailed) as failed:
            client.scenes()
        assert not failed.value.was_sent
