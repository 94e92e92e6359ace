#!/usr/bin/env python3
"""Edits, followers, uploads and downloads without a pause, with the service's memory printed every minute.

    python3 tests/soak.py PATH/TO/rebake [--minutes 30] [--memory 1.5] [--scenes 3]

Needs httpx and numpy (the Python client's). Scenes are the demo's room. Every scene has an editor (insert, move, remove,
relight, repaint, hide, show, undo, redo, lamps, drags), two followers and a reader of all kinds of files; beside them scenes and
assets are uploaded and deleted all the while. At the end all edits are waited for, and the service is killed and started
again. Ends with 1 where a job failed, a request was answered by 5xx or by something that this script does not expect, a
follower's light map is not the service's, resident memory after the first fifth of the time grew by more than a quarter, it
went above --memory by more than 512 MiB (what jobs work in, and freed memory that the process keeps), or a light map is not
there, bit for bit, after the restart.
"""
import argparse
import json
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

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "clients/python/src"))
from rebake import (  # noqa: E402
    Client, Hide, Insert, InsertLight, LightChange, Material, Move, MoveLight, PointLight, Problem, Remove, RemoveLight, Show,
)

#: What a full service may answer, and what two turns of undo and redo, or a cancel of what is just done, may meet.
EXPECTED = {
    "queue-full", "nothing-to-undo", "too-many-answers", "out-of-memory", "too-many-scenes", "too-many-assets", "asset-needed",
    "out-of-storage", "job-ended",
}


class Soak:
    def __init__(self, args, folder):
        self.args, self.folder = args, folder
        self.stop, self.failures, self.counts = threading.Event(), [], {}
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.address = f"127.0.0.1:{free.getsockname()[1]}"
        subprocess.run([args.rebake, "demo", "--exit", "--save", folder], check=True, capture_output=True)
        self.room, self.chair = Path(folder) / "room.glb", Path(folder) / "chair.glb"

    def start(self):
        log = open(Path(self.folder) / "service.log", "ab")
        self.service = subprocess.Popen(
            [self.args.rebake, "serve", "--listen", self.address, "--data-dir", Path(self.folder) / "data",
             "--memory", str(self.args.memory)], stdout=log, stderr=log)
        with self.client() as client:
            while not client.is_ready():
                time.sleep(0.05)

    def client(self):
        return Client(f"http://{self.address}", patience=20)

    def resident(self):
        status = Path(f"/proc/{self.service.pid}/status").read_text()
        return int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1]) / 1024

    def count(self, what):
        self.counts[what] = self.counts.get(what, 0) + 1

    def worker(self, work, *about):
        def run():
            with self.client() as client:
                while not self.stop.is_set():
                    try:
                        work(client, *about)
                    except Problem as problem:
                        self.count(f"refused: {problem.kind}")
                        if problem.kind not in EXPECTED:
                            self.failures.append(f"{work.__name__}: {problem.kind}: {problem}")
                        time.sleep(0.05)
                    except Exception:  # whatever it is, it is told
                        if not self.stop.is_set():
                            self.failures.append(f"{work.__name__}: {traceback.format_exc()}")
                            time.sleep(1)
        thread = threading.Thread(target=run, name=work.__name__, daemon=True)
        thread.start()
        return thread

    # ---- what goes on

    def edit(self, client, id, rng, chair):
        scene = client.scene(id)
        info = scene.info()
        mine = [o for o in info.objects if o.name.startswith("chair-")]
        lamps = [light for light in info.lights if light.name.startswith("lamp-")]
        place = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, rng.uniform(0.3, 2.5), 0, rng.uniform(0.3, 2.5), 1]
        free = f"{rng.randrange(10**9)}"
        kind = rng.randrange(12)
        if kind == 0 and len(mine) < 6:
            edits = [Insert(chair, f"chair-{free}", place)]
        elif kind == 1 and mine:
            edits = [Remove(rng.choice(mine).name)]
        elif kind in (2, 3) and mine:
            edits = [Move(rng.choice(mine).name, place, drag=kind == 3 or None)]
        elif kind == 4:
            edits = [LightChange(rng.choice(info.lights).name, intensity=rng.uniform(0.5, 8))]
        elif kind == 5:
            edits = [Material([rng.random() for _ in range(3)], object=rng.choice(info.objects).name)]
        elif kind == 6 and mine:
            edits = [rng.choice([Hide, Show])(rng.choice(mine).name)]
        elif kind == 7 and len(lamps) < 4:
            edits = [InsertLight(f"lamp-{free}", PointLight([place[12], 2, place[14]], intensity=3))]
        elif kind == 8 and lamps:
            edits = [RemoveLight(rng.choice(lamps).name)]
        elif kind == 9 and lamps:
            edits = [MoveLight(rng.choice(lamps).name, position=[place[12], 1.5, place[14]])]
        else:
            rng.choice([scene.undo, scene.redo])()
            self.count("undo and redo")
            return
        job = scene.edit(*edits, samples=rng.choice([1, 4, 16]))
        self.count("edits")
        if rng.random() < 0.1:
            job.cancel()
            self.count("cancels")
        elif rng.random() < 0.3:
            job.wait()

    def follow(self, client, id, rng):
        for snapshot in client.scene(id).follow():
            self.count("snapshots")
            # Followers go away and come back.
            if self.stop.is_set() or rng.random() < 0.02:
                return

    def read(self, client, id, rng):
        scene = client.scene(id)
        kind = rng.randrange(7)
        if kind == 0:
            scene.export("glb", layout=rng.choice(["vertices", "atlas"]))
        elif kind == 1:
            scene.export("exr")
        elif kind == 2:
            scene.light_map(part=rng.choice(["full", "direct", "error"]), filter=rng.choice(["none", "statistical"]))
        elif kind == 3:
            for page in range(len(scene.atlas().pages)):
                scene.atlas_page(page)
        elif kind == 4:
            scene.render(width=160, height=90, spp=1)
        elif kind == 5:
            scene.sample([[1, 1, 1, 0, 1, 0]], samples=16)
        else:
            scene.history(), scene.jobs()
        self.count("reads")
        time.sleep(0.2)

    def churn(self, client, rng):
        scene = client.upload(self.room, spacing=rng.choice([0.2, 0.3]), samples=8)
        # A thing of its own each time: what follows the JSON's closing brace is blank.
        data = bytearray(self.chair.read_bytes())
        length = int.from_bytes(data[12:16], "little")
        document = json.loads(data[20:20 + length])
        document["asset"]["generator"] = str(rng.random())
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        whole = data[:8] + (len(data) - length + len(text)).to_bytes(4, "little") + len(text).to_bytes(4, "little")
        asset = client.add_asset(bytes(whole + data[16:20] + text + data[20 + length:]))
        scene.edit(Insert(asset.asset, "thing", [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 0, 1, 1]), samples=4).wait()
        scene.delete()
        client.delete_asset(asset.asset)
        self.count("scenes")

    # ---- the whole

    def run(self):
        self.start()
        with self.client() as client:
            chair = client.add_asset(self.chair).asset
            ids = [client.upload(self.room, spacing=0.15, samples=32).id for _ in range(self.args.scenes)]
            threads = [self.worker(self.churn, random.Random(99))]
            for k, id in enumerate(ids):
                rng = lambda n: random.Random(100 * k + n)  # noqa: E731
                threads += [self.worker(self.edit, id, rng(0), chair), self.worker(self.read, id, rng(1))]
                threads += [self.worker(self.follow, id, rng(2 + n)) for n in range(2)]
            memory, start = [], time.monotonic()
            while (minutes := (time.monotonic() - start) / 60) < self.args.minutes and not self.failures[20:]:
                time.sleep(min(15, 60 * self.args.minutes - 60 * minutes + 0.01))
                memory.append(self.resident())
                if len(memory) % 4 == 0 or 60 * self.args.minutes < 60:
                    told = ", ".join(f"{n} {what}" for what, n in sorted(self.counts.items()))
                    print(f"{minutes + 0.25:5.1f} min, {memory[-1]:6.0f} MiB resident; {told}", flush=True)
            self.stop.set()
            for thread in threads:
                thread.join(60)
            self.end(client, ids, memory)

    def end(self, client, ids, memory):
        check = lambda is_so, text: is_so or self.failures.append(text)  # noqa: E731
        for id in ids:
            scene = client.scene(id)
            while any(not job.has_ended for job in scene.jobs()):
                time.sleep(0.1)
            check(not scene.jobs(state="failed"), f"{id}: jobs failed")
            last = None
            for last in scene.follow():
                if last.complete:
                    break
            check(last is not None and (last.values == scene.light_map().values).all(), f"{id}: a follower has another light map")
        maps = {id: client.scene(id).light_map() for id in ids}
        settled, later = memory[len(memory) // 5:len(memory) // 5 + 4], memory[-4:]
        growth = (sum(later) / len(later)) / (sum(settled) / len(settled)) - 1
        print(f"resident: {settled[0]:.0f} MiB after a fifth of the time, {later[-1]:.0f} at the end ({growth:+.1%}), most {max(memory):.0f}")
        check(growth < 0.25, f"memory grew by {growth:.1%}")
        check(max(memory) < 1024 * self.args.memory + 512, "more memory than --memory and what jobs work in")
        self.service.send_signal(signal.SIGKILL)
        self.service.wait()
        start = time.monotonic()
        self.start()
        print(f"killed, and back after {time.monotonic() - start:.1f} s with {sum(len(client.scene(id).history()) for id in ids)} edits told")
        for id in ids:
            # Versions go on behind all that a killed service may have told.
            was, now = maps[id].values, client.scene(id).light_map().values
            check(was.shape == now.shape and (was == now).all(), f"{id}: another light map after the restart")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rebake")
    parser.add_argument("--minutes", type=float, default=30)
    parser.add_argument("--memory", type=float, default=1.5, help="of the service, GiB")
    parser.add_argument("--scenes", type=int, default=3)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        soak = Soak(args, folder)
        try:
            soak.run()
        finally:
            soak.stop.set()
            if getattr(soak, "service", None):
                soak.service.kill()
                soak.service.wait()
            bad = [line for line in (Path(folder) / "service.log").read_text(errors="replace").splitlines() if "ERROR" in line or "panicked" in line]
            soak.failures += [f"log: {line}" for line in bad[:5]]
    for failure in soak.failures[:20]:
        print("FAILED", failure)
    sys.exit(bool(soak.failures))


if __name__ == "__main__":
    main()
