#!/usr/bin/env python3
"""Kills workers, the broker and the service at random while scenes are edited, and holds the light maps against one process.

    python3 tests/workers/faults.py PATH/TO/rebake [--kill worker,broker,service] [--minutes 10] [--scenes 10] [--workers 2] [--s3]

With --s3 files are shared in an S3 server, which is never killed, in place of a folder: moto's (PyPI: moto[server]), and a build with
the feature s3.

Needs nats-server, and httpx and numpy (the Python client's). Scenes are the demo's room; each is edited by a client of its own,
which waits for the light of one step before it asks for the next, and now and then bakes another scene beside it, for workers to
do parts of. Meanwhile something is killed every few seconds and started again, the broker once for a minute. Then the same steps
are taken by a service alone that nobody kills. Ends with 1 where an acknowledged edit is not there, a job failed, or the light map
of an edited scene differs in one bit. Scenes that are baked beside others take turns, and which bits they have goes by when: they
have to succeed.
"""
import argparse
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "clients/python/src"))
from rebake import Client, Hide, Insert, LightChange, Material, Move, Remove, Show  # noqa: E402


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


class Machines:
    """A service, with a broker and workers or alone."""

    def __init__(self, args, folder, workers):
        self.args, self.folder, self.workers = args, Path(folder), workers
        self.folder.mkdir(parents=True)
        self.port, self.broker_port = free_port(), free_port()
        self.all, self.objects = {}, self.folder / "objects"
        if args.s3 and workers:
            self.objects = self.start_s3()
        for name in (["broker"] if workers else []) + ["service"] + [f"worker-{k}" for k in range(workers)]:
            self.start(name)
        with self.client() as client:
            while not client.is_ready():
                time.sleep(0.05)

    def start_s3(self):
        """An S3 server with a bucket, which its clients find in the environment; answers the address of a folder."""
        server = f"http://127.0.0.1:{free_port()}"
        with open(self.folder / "s3.log", "ab") as log:
            command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", server.rsplit(":", 1)[1]]
            self.all["s3"] = subprocess.Popen(command, stdout=log, stderr=log)
        os.environ |= {"AWS_ENDPOINT": server, "AWS_ALLOW_HTTP": "true", "AWS_REGION": "us-east-1",
                       "AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": "secret"}
        import httpx
        while self.all["s3"].poll() is None:
            try:
                httpx.put(f"{server}/rebake", timeout=5).raise_for_status()
                return "s3://rebake/shared"
            except httpx.TransportError:
                time.sleep(0.1)
        sys.exit(f"the S3 server does not start: {(self.folder / 's3.log').read_text()}")

    def start(self, name):
        meet = ["--queue", f"nats://127.0.0.1:{self.broker_port}", "--objects", self.objects]
        command = {
            "broker": ["nats-server", "-js", "-a", "127.0.0.1", "-p", str(self.broker_port), "-sd", self.folder / "broker"],
            "service": [self.args.rebake, "serve", "--listen", f"127.0.0.1:{self.port}", "--data-dir", self.folder / "data",
                        "--threads", "1", *([*meet, "--delegate"] if self.workers else [])],
        }.get(name, [self.args.rebake, "worker", "--threads", "1", *meet])
        log = open(self.folder / f"{name}.log", "ab")
        self.all[name] = subprocess.Popen(command, stdout=log, stderr=log)

    def kill(self, name):
        self.all[name].send_signal(signal.SIGKILL)
        self.all[name].wait()

    def end(self):
        for process in self.all.values():
            process.kill()
            process.wait()

    def client(self):
        return Client(f"http://127.0.0.1:{self.port}", patience=120)


class Steps:
    """What one client asks of its scene: the same again from the same seed. Counts edits that were acknowledged."""

    def __init__(self, client, scene, room, chair, seed):
        self.client, self.scene, self.room, self.chair = client, client.scene(scene), room, chair
        self.rng, self.acknowledged, self.taken, self.baked = random.Random(seed), 0, 0, 0

    def take(self):
        """One step, to the end of its light."""
        rng, info = self.rng, self.scene.info()
        mine = [o.name for o in info.objects if o.name.startswith("chair-")]
        place = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, rng.uniform(0.3, 2.5), 0, rng.uniform(0.3, 2.5), 1]
        kind, which = rng.randrange(8), rng.random()
        if kind == 0:
            # Another scene from scratch, in rounds that workers do parts of.
            other = self.client.upload(self.room, spacing=0.2, samples=64 + 64 * rng.randrange(2))
            other.wait()
            other.delete()
            self.baked += 1
        elif kind in (1, 2) and len(mine) < 5:
            self.edit(Insert(self.chair, f"chair-{self.taken}", place))
        elif kind == 3 and mine:
            self.edit(Remove(mine[int(which * len(mine))]))
        elif kind == 4 and mine:
            self.edit(Move(mine[int(which * len(mine))], place))
        elif kind == 5 and mine:
            name = mine[int(which * len(mine))]
            hidden = next(o for o in info.objects if o.name == name).hidden
            self.edit(Show(name) if hidden else Hide(name))
        elif kind == 6:
            self.edit(LightChange(info.lights[int(which * len(info.lights))].name, intensity=1 + 6 * rng.random()))
        else:
            walls = next(o.name for o in info.objects if not o.name.startswith("chair-"))
            self.edit(Material([rng.random() for _ in range(3)], object=walls))
        self.scene.wait()
        self.taken += 1

    def edit(self, edit):
        self.scene.edit(edit, samples=8)
        self.acknowledged += 1


def prepared(machines, args):
    """The scenes, baked as far as they go before anything is killed, and the chair."""
    folder = machines.folder
    subprocess.run([args.rebake, "demo", "--exit", "--save", folder], check=True, capture_output=True)
    with machines.client() as client:
        chair = client.add_asset(folder / "chair.glb").asset
        scenes = []
        for _ in range(args.scenes):
            scene = client.upload(folder / "room.glb", spacing=0.2, samples=64)
            # One after the other: bakes that take turns have other bits.
            scene.wait()
            scenes.append(scene.id)
        return scenes, chair


def under_faults(args, folder):
    """Per scene the steps taken, the edits acknowledged and told, and its light; and what went wrong."""
    machines = Machines(args, folder, args.workers)
    failures, done, stop = [], {}, threading.Event()
    try:
        scenes, chair = prepared(machines, args)

        def work(index):
            with machines.client() as client:
                steps = Steps(client, scenes[index], machines.folder / "room.glb", chair, 1000 * args.seed + index)
                try:
                    while not stop.is_set():
                        steps.take()
                except Exception:  # whatever it is, it is told
                    failures.append(f"scene {index}, step {steps.taken}: {traceback.format_exc()}")
                done[index] = steps

        threads = [threading.Thread(target=work, args=(index,), daemon=True) for index in range(args.scenes)]
        for thread in threads:
            thread.start()
        kill_at_random(machines, args, failures)
        stop.set()
        for thread in threads:
            thread.join(600)
        results = []
        with machines.client() as client:
            for index, id in enumerate(scenes):
                scene = client.scene(id)
                scene.wait()
                failed = scene.jobs(state="failed")
                if failed:
                    failures.append(f"scene {index}: jobs failed: {failed[0].error}")
                results.append((done[index], scene.info(), scene.light_map().values))
            elsewhere = metric(machines, 'rebake_parts_total{place="elsewhere"}')
        print(f"parts that workers did since the service was last started: {elsewhere}")
        return results, failures
    finally:
        machines.end()


def metric(machines, name):
    import httpx
    text = httpx.get(f"http://127.0.0.1:{machines.port}/metrics").text
    return next((line.rsplit(" ", 1)[1] for line in text.splitlines() if line.startswith(name)), "0")


def kill_at_random(machines, args, failures):
    rng, start, counts = random.Random(args.seed), time.monotonic(), {}
    minute = 0.4 * 60 * args.minutes
    while (elapsed := time.monotonic() - start) < 60 * args.minutes and not failures:
        time.sleep(rng.uniform(2, 8))
        name = rng.choice([name for name in machines.all if name.split("-")[0] in args.kill])
        away = rng.uniform(0, 3)
        if minute and elapsed > minute and "broker" in args.kill:
            name, away, minute = "broker", min(60, 12 * args.minutes), None
        machines.kill(name)
        time.sleep(away)
        machines.start(name)
        counts[name] = counts.get(name, 0) + 1
    print("killed: " + ", ".join(f"{name} {count} times" for name, count in sorted(counts.items())), flush=True)


def alone(args, folder, steps):
    """The light of the same steps by a service that is left in peace."""
    machines = Machines(args, folder, 0)
    try:
        scenes, chair = prepared(machines, args)
        with machines.client() as client:
            for index, id in enumerate(scenes):
                one = Steps(client, id, machines.folder / "room.glb", chair, 1000 * args.seed + index)
                while one.taken < steps[index]:
                    one.take()
                yield client.scene(id).light_map().values
    finally:
        machines.end()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rebake")
    parser.add_argument("--kill", type=lambda text: text.split(","), default=["worker", "broker", "service"])
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--scenes", type=int, default=10)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--s3", action="store_true")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        results, failures = under_faults(args, Path(folder) / "faults")
        taken = [steps.taken for steps, *_ in results]
        edits, bakes = (sum(count(steps) for steps, *_ in results) for count in (lambda s: s.acknowledged, lambda s: s.baked))
        print(f"{sum(taken)} steps of {args.scenes} scenes: {edits} edits acknowledged, {bakes} others baked", flush=True)
        for index, light in enumerate(alone(args, Path(folder) / "alone", taken)):
            steps, info, theirs = results[index]
            if info.accepted_edits != steps.acknowledged:
                failures.append(f"scene {index}: {steps.acknowledged} edits were acknowledged, {info.accepted_edits} are there")
            if light.shape != theirs.shape or (light != theirs).any():
                failures.append(f"scene {index}: another light map after {steps.taken} steps")
    for failure in failures[:20]:
        print("FAILED", failure)
    print("nothing was lost, and every edited scene has the light map of one process" if not failures else f"{len(failures)} failures")
    sys.exit(bool(failures))


if __name__ == "__main__":
    main()
