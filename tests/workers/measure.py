#!/usr/bin/env python3
"""What workers cost and bring: bakes of one scene by a service alone, and with its parts left to workers.

    tests/workers/measure.py SCENE.glb [--spacing M] [--samples N] [--workers 1,2] [--runs 3]

Every process has one thread, so that two workers have a core each on a machine of two. Prints seconds from the upload to the end
of the bake, CPU seconds of all processes, and bytes and milliseconds per part; and from these what 4, 16 and 64 machines would
take, which share one network link of 10 Gbit/s at the coordinator. Needs `nats-server` and a release build.
"""

import argparse
import hashlib
import json
import os
import pathlib
import re
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request

LINK = 10e9 / 8
PART = 16


def parse():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=pathlib.Path)
    parser.add_argument("--rebake", default="target/release/rebake")
    parser.add_argument("--spacing", type=float, default=0.1)
    parser.add_argument("--samples", type=int, default=128)
    parser.add_argument("--workers", default="1,2")
    parser.add_argument("--runs", type=int, default=3)
    return parser.parse_args()


class Processes:
    """Processes that end with the block, and their CPU seconds."""

    def __enter__(self):
        self.all = []
        return self

    def start(self, *command, wait_for=None):
        child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self.all.append(child)
        if wait_for is None:
            return None
        for line in child.stdout:
            if found := re.search(wait_for, line):
                return found.group(1)
        sys.exit(f"{command[:2]} ended")

    def cpu_seconds(self):
        ticks = 0
        for child in self.all:
            fields = pathlib.Path(f"/proc/{child.pid}/stat").read_text().rsplit(")", 1)[1].split()
            ticks += int(fields[11]) + int(fields[12])
        return ticks / os.sysconf("SC_CLK_TCK")

    def __exit__(self, *_):
        for child in self.all:
            child.terminate()
        for child in self.all:
            child.wait()


def get(base, path):
    return urllib.request.urlopen(base + path).read()


def metric(base, name):
    found = re.search(rf"^{re.escape(name)} (\d+)", get(base, "/metrics").decode(), re.M)
    return int(found.group(1)) if found else 0


def bake(args, workers):
    """Seconds, CPU seconds, elements, a hash of the light, and parts that others have done."""
    with tempfile.TemporaryDirectory() as folder, Processes() as processes:
        serve = [args.rebake, "serve", "--listen", "127.0.0.1:0", "--threads", "1"]
        if workers:
            processes.start("nats-server", "-js", "-a", "127.0.0.1", "-p", "-1", "-sd", folder, "--ports_file_dir", folder)
            port = pathlib.Path(folder) / f"nats-server_{processes.all[0].pid}.ports"
            while not port.exists() or not port.read_text().strip().endswith("}"):
                time.sleep(0.05)
            queue = json.loads(port.read_text())["nats"][0]
            meet = ["--queue", queue, "--objects", folder + "/objects"]
            serve += [*meet, "--delegate"]
            for _ in range(workers):
                processes.start(args.rebake, "worker", "--threads", "1", *meet)
        base = processes.start(*serve, wait_for=r"listening on (\S+)")
        while workers and metric(base, "rebake_workers") < workers:
            time.sleep(0.05)
        before, begun = processes.cpu_seconds(), time.monotonic()
        request = urllib.request.Request(
            f"{base}/v1/scenes?spacing={args.spacing}&samples_per_element={args.samples}",
            data=args.scene.read_bytes(),
            headers={"content-type": "model/gltf-binary"},
        )
        scene = json.load(urllib.request.urlopen(request))
        while (job := json.loads(get(base, f"/v1/jobs/{scene['current_job']}")))["state"] not in ("succeeded", "failed"):
            time.sleep(0.02)
        seconds, cpu = time.monotonic() - begun, processes.cpu_seconds() - before
        if job["state"] != "succeeded":
            sys.exit(f"the bake: {job}")
        light = hashlib.blake2b(get(base, f"/v1/scenes/{scene['id']}/lightmap?format=raw")).hexdigest()
        elements = json.loads(get(base, f"/v1/scenes/{scene['id']}"))["elements"]
        return seconds, cpu, elements, light, metric(base, 'rebake_parts_total{place="elsewhere"}')


def rounds(samples):
    """Samples of the rounds of a bake."""
    done = 0
    while done < samples:
        size = min(max(done, 4), samples - done)
        yield size
        done += size


def model(samples, per_sample, fixed, bytes_per_part, machines):
    """Seconds of a bake with so many machines: rounds follow each other, parts of a round share the machines and the link."""
    seconds = fixed
    for size in rounds(samples):
        parts = -(-size // PART)
        if parts == 1:
            seconds += size * per_sample
        else:
            turns = -(-parts // machines)
            seconds += max(turns * (size / parts) * per_sample, parts * bytes_per_part / LINK) + bytes_per_part / LINK
    return seconds


def main():
    args = parse()
    print(f"{args.scene.name}, spacing {args.spacing}, {args.samples} samples, {args.runs} runs in turn")
    counts = [0, *map(int, args.workers.split(","))]
    results = {count: [] for count in counts}
    for _ in range(args.runs):
        for count in counts:
            results[count].append(bake(args, count))
    lights = {light for runs in results.values() for *_, light, _ in runs}
    alone = statistics.median(run[0] for run in results[0])
    print("workers  seconds (min, median, max)     CPU s  parts elsewhere  of alone")
    for count, runs in results.items():
        seconds = sorted(run[0] for run in runs)
        median, cpu = statistics.median(seconds), statistics.median(run[1] for run in runs)
        print(f"{count:7}  {seconds[0]:8.2f} {median:8.2f} {seconds[-1]:8.2f} {cpu:12.2f} {runs[0][4]:16} {median / alone:9.3f}")
    elements = results[0][0][2]
    bytes_per_part = 24 * elements + 36
    print(f"the same light, bit for bit: {'yes' if len(lights) == 1 else 'NO'}")
    print(f"{elements} elements, {bytes_per_part / 1e6:.1f} MB per part, {1000 * PART * alone / args.samples:.0f} ms per part of one thread")
    for samples in (args.samples, 1024):
        per_sample = alone / args.samples
        told = [model(samples, per_sample, 0.0, bytes_per_part, machines) for machines in (1, 4, 16, 64)]
        gains = ", ".join(f"{n}: {told[0] / t:.1f}" for n, t in zip((4, 16, 64), told[1:]))
        print(f"model, {samples} samples: times faster with machines {gains}")
    sys.exit(len(lights) != 1)


main()
