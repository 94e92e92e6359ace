"""A client that openapi-python-client made, against a running service: tests/openapi.sh puts it on the path.

    openapi_client.py http://127.0.0.1:PORT
"""

import json
import sys
import time
from io import BytesIO

from rebake_client import Client
from rebake_client.api.assets import create_asset, list_assets
from rebake_client.api.edits import create_edit, list_edits
from rebake_client.api.jobs import get_job
from rebake_client.api.light_map import get_delta_between, get_elements, get_lightmap, sample_light
from rebake_client.api.scenes import create_scene, delete_scene, get_object, get_scene, list_objects
from rebake_client.models import EditList, GetObjectFormat, Insert, InsertOp, JobState, Relight, RelightOne, RelightOp
from rebake_client.models import ObjectDetail, SampleRequest, Undo, UndoOp
from rebake_client.types import File

from schemathesis_hooks import glb

PLACE = [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.5, 1, 0.5, 1]


def file() -> File:
    return File(payload=BytesIO(glb()))


def finish(client: Client, job) -> None:
    """Waits for the end of a job, not for ever."""
    end = time.monotonic() + 120
    while job.state in (JobState.QUEUED, JobState.RUNNING, JobState.PAUSED):
        assert time.monotonic() < end, job
        time.sleep(0.05)
        job = get_job.sync(job.id, client=client)
    assert job.state == JobState.SUCCEEDED, job


def main() -> None:
    client = Client(base_url=sys.argv[1], raise_on_unexpected_status=True, timeout=30)
    scene = create_scene.sync(client=client, body=file(), name="room", spacing=0.5, samples_per_element=4)
    assert [o.name for o in scene.objects] == ["sofa"] and scene.lights[0].name == "lamp", scene
    finish(client, get_job.sync(scene.current_job, client=client))
    asset = create_asset.sync(client=client, body=file())
    assert asset.asset in [known.asset for known in list_assets.sync(client=client).items]
    edits = [
        Insert(op=InsertOp.INSERT, asset=asset.asset, name="sofa/2", transform=PLACE),
        Relight(op=RelightOp.RELIGHT, lights=[RelightOne(light="lamp", intensity=5.0)]),
    ]
    finish(client, create_edit.sync(scene.id, client=client, body=EditList(edits=edits)))
    assert [o.name for o in list_objects.sync(scene.id, client=client).items] == ["sofa", "sofa/2"]
    # Of an answer in several media types the generated client knows the bytes.
    answer = get_object.sync(scene.id, "sofa/2", client=client, format_=GetObjectFormat.JSON)
    detail = ObjectDetail.from_dict(json.load(answer.payload))
    assert detail.object_.name == "sofa/2" and detail.mesh.triangles == 2, detail
    finish(client, create_edit.sync(scene.id, client=client, body=Undo(op=UndoOp.UNDO)))
    history = list_edits.sync(scene.id, client=client)
    assert [type(entry.request) for entry in history.items] == [EditList, Undo], history
    scene = get_scene.sync(scene.id, client=client)
    elements = get_elements.sync(scene.id, client=client).payload.read()
    whole = get_lightmap.sync(scene.id, client=client).payload.read()
    delta = get_delta_between.sync(scene.id, 0, scene.version, client=client).payload.read()
    assert len(elements) == 32 * scene.elements and whole == delta and whole.startswith(b"RBKD"), scene
    points = sample_light.sync(scene.id, client=client, body=SampleRequest(points=[[1, 0.5, 1, 0, 1, 0]]))
    assert len(points.points) == 1 and points.points[0].light[0] > 0, points
    assert get_object.sync(scene.id, "none", client=client).status == 404, detail
    delete_scene.sync_detailed(scene.id, client=client)
    print("the generated Python client did all it was asked for")


main()
