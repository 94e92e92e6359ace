"""The other client against the real service: what differs is how it waits."""

from __future__ import annotations

import asyncio

import numpy as np
from conftest import Service
from rooms import crate, room

from rebake import AsyncClient, Insert, Snapshot


def test_two_scenes_at_once(service: Service) -> None:
    asyncio.run(asyncio.wait_for(edit_two(service), 90))


async def edit_two(service: Service) -> None:
    async with AsyncClient(service.server, service.token) as client:
        asset = await client.add_asset(crate())
        snapshots = await asyncio.gather(*(edit_one(client, asset.asset) for _ in range(2)))
        assert all(snapshot.complete for snapshot in snapshots)


async def edit_one(client: AsyncClient, asset: str) -> Snapshot:
    scene = await client.upload(room(), spacing=0.25, bake=False)
    await scene.bake(samples=4)
    job = await scene.edit(Insert(asset, "crate 2", np.eye(4)), samples=4)
    async for progress in job.progress():
        assert progress.id == job.id
    async for snapshot in scene.follow():
        if snapshot.complete:
            break
    assert snapshot.version == (await scene.light_map()).version
    await scene.delete()
    return snapshot
