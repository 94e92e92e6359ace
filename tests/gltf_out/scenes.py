"""Uploads scenes, edits one, and keeps what `lightmap?format=glb` answers: scenes.py SERVER OUT [SCENE.glb ...]

Beside the scenes named, a room that is made here: groups, a textured floor with a second set of coordinates, a clear pane,
a two-sided screen, a lamp that shines, one that is punctual, a camera, a marker.
"""

import json
import math
import pathlib
import struct
import sys
import time
import urllib.request
import zlib

BUDGET = {"samples_per_element": 16}
VARIANTS = {
    "vertices": "layout=vertices",
    "unlit": "layout=vertices&unlit=true",
    "atlas": "layout=atlas",
    "plain-atlas": "layout=atlas&unlit=false",
}


def png(width, height, pixel):
    """An RGB picture."""
    rows = b"".join(b"\0" + bytes(c for x in range(width) for c in pixel(x, y)) for y in range(height))

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


class Glb:
    """A file while it is put together."""

    def __init__(self):
        self.bin = b""
        self.json = {"asset": {"version": "2.0", "copyright": "nobody"}, "scene": 0, "scenes": [{"name": "Flat"}]}

    def add(self, key, value):
        self.json.setdefault(key, []).append(value)
        return len(self.json[key]) - 1

    def view(self, data):
        self.bin += b"\0" * (-len(self.bin) % 4)
        view = self.add("bufferViews", {"buffer": 0, "byteOffset": len(self.bin), "byteLength": len(data)})
        self.bin += data
        return view

    def floats(self, values, kind):
        flat = [c for value in values for c in value]
        accessor = {"bufferView": self.view(struct.pack(f"<{len(flat)}f", *flat)), "componentType": 5126,
                    "count": len(values), "type": kind}
        if kind == "VEC3":
            accessor |= {"min": [min(c) for c in zip(*values)], "max": [max(c) for c in zip(*values)]}
        return self.add("accessors", accessor)

    def quads(self, quads, material, sets=0):
        """A primitive of quads given by origin and two edges; counter-clockwise is their front."""
        corners, uvs, indices = [], [], []
        for o, u, v in quads:
            indices += [len(corners) + k for k in (0, 1, 2, 0, 2, 3)]
            for s, t in ((0, 0), (1, 0), (1, 1), (0, 1)):
                corners.append([o[k] + s * u[k] + t * v[k] for k in range(3)])
                uvs.append([float(s), float(t)])
        index = self.view(struct.pack(f"<{len(indices)}H", *indices))
        accessor = {"bufferView": index, "componentType": 5123, "count": len(indices), "type": "SCALAR"}
        attributes = {"POSITION": self.floats(corners, "VEC3")}
        for number in range(sets):
            attributes[f"TEXCOORD_{number}"] = self.floats(uvs, "VEC2")
        return {"attributes": attributes, "indices": self.add("accessors", accessor), "material": material}

    def box(self, low, high, material):
        (x, y, z), (a, b, c) = low, [high[k] - low[k] for k in range(3)]
        sides = [((x, y, z), (a, 0, 0), (0, 0, c)), ((x, y + b, z), (0, 0, c), (a, 0, 0)),
                 ((x, y, z), (0, b, 0), (a, 0, 0)), ((x, y, z + c), (a, 0, 0), (0, b, 0)),
                 ((x, y, z), (0, 0, c), (0, b, 0)), ((x + a, y, z), (0, b, 0), (0, 0, c))]
        return self.quads(sides, material)

    def bytes(self):
        self.json["buffers"] = [{"byteLength": len(self.bin)}]
        document = json.dumps(self.json).encode()
        document += b" " * (-len(document) % 4)
        data = self.bin + b"\0" * (-len(self.bin) % 4)
        chunks = struct.pack("<I4s", len(document), b"JSON") + document + struct.pack("<I4s", len(data), b"BIN\0") + data
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def paint(name, color, **more):
    pbr = {"baseColorFactor": [*color, 1.0], "metallicFactor": 0.0}
    return {"name": name, "pbrMetallicRoughness": pbr | more.pop("pbr", {}), **more}


def room():
    """A room of 4 x 3 x 4 metres, open to +z."""
    glb = Glb()
    picture = png(16, 16, lambda x, y: (200, 160, 90) if (x // 4 + y // 4) % 2 else (90, 60, 40))
    image = glb.add("images", {"name": "planks", "bufferView": glb.view(picture), "mimeType": "image/png"})
    sampler = glb.add("samplers", {"magFilter": 9729, "minFilter": 9987, "wrapS": 10497, "wrapT": 10497})
    texture = glb.add("textures", {"source": image, "sampler": sampler})
    tiled = {"index": texture, "extensions": {"KHR_texture_transform": {"scale": [4, 4]}}}
    materials = [
        paint("Plaster", (0.8, 0.8, 0.75)),
        paint("Planks", (1, 1, 1), pbr={"baseColorTexture": tiled},
              occlusionTexture={"index": texture, "texCoord": 1, "strength": 0.0}),
        paint("Red", (0.6, 0.1, 0.1)),
        paint("Glow", (0.5, 0.5, 0.5), emissiveFactor=[1, 0.9, 0.7],
              extensions={"KHR_materials_emissive_strength": {"emissiveStrength": 8}}),
        paint("Glass", (1, 1, 1), alphaMode="BLEND", pbr={"baseColorFactor": [1, 1, 1, 0.0]}),
        paint("Cloth", (0.3, 0.4, 0.7), doubleSided=True),
        paint("Smoke", (0.5, 0.5, 0.5), alphaMode="BLEND", pbr={"baseColorFactor": [0.5, 0.5, 0.5, 0.5]}),
    ]
    for material in materials:
        glb.add("materials", material)
    walls = [((0, 0, 0), (4, 0, 0), (0, 3, 0)), ((0, 0, 4), (0, 0, -4), (0, 3, 0)), ((4, 0, 0), (0, 0, 4), (0, 3, 0)),
             ((0, 3, 0), (4, 0, 0), (0, 0, 4))]
    meshes = {
        "Walls": [glb.quads(walls, 0)],
        "Floor": [glb.quads([((0, 0, 4), (4, 0, 0), (0, 0, -4))], 1, 2)],
        "Table": [glb.box((-0.6, 0.6, -0.4), (0.6, 0.7, 0.4), 2), glb.box((-0.05, 0, -0.05), (0.05, 0.6, 0.05), 0)],
        "Vase": [glb.box((-0.1, 0, -0.1), (0.1, 0.3, 0.1), 2)],
        "Bulb": [glb.quads([((-0.3, 0, 0.3), (0, 0, -0.6), (0.6, 0, 0))], 3)],
        "Window": [glb.quads([((1, 1, 0), (2, 0, 0), (0, 1, 0))], 4), glb.quads([((0.9, 0.9, 0.02), (2.2, 0, 0), (0, 0.08, 0))], 0)],
        "Screen": [glb.quads([((0, 0, 0), (0.8, 0, 0), (0, 1.6, 0))], 5)],
        "Pane": [glb.quads([((0, 0, 0), (0.6, 0, 0), (0, 0.6, 0))], 6)],
    }
    index = {name: glb.add("meshes", {"name": name + " mesh", "primitives": parts}) for name, parts in meshes.items()}
    half = math.sqrt(0.5)
    nodes = [
        {"name": "House", "children": [1, 2, 3, 6, 7, 10]},
        {"name": "Walls", "mesh": index["Walls"]},
        {"name": "Floor", "mesh": index["Floor"], "extras": {"id": "floor-1"}},
        {"name": "Furniture", "children": [4, 8, 9], "translation": [2, 0, 2], "rotation": [0, half, 0, half]},
        {"name": "Table", "mesh": index["Table"], "children": [5], "scale": [1.2, 1, 1.2]},
        {"name": "Vase", "mesh": index["Vase"], "translation": [0.2, 0.7, 0.1]},
        {"name": "Bulb", "mesh": index["Bulb"], "translation": [2, 2.9, 2]},
        {"name": "Window", "mesh": index["Window"], "translation": [0, 0, 0.01]},
        {"name": "Screen", "mesh": index["Screen"], "translation": [-1, 0, 1.2]},
        {"name": "Pane", "mesh": index["Pane"], "translation": [0.8, 0.2, -1.5]},
        {"name": "Spot", "translation": [3, 2.5, 3], "rotation": [-half, 0, 0, half],
         "extensions": {"KHR_lights_punctual": {"light": 0}}},
        {"name": "Camera", "translation": [2, 1.5, 7.5], "camera": 0},
        {"name": "Marker", "translation": [1, 0, 1]},
    ]
    for node in nodes:
        glb.add("nodes", node)
    glb.json["scenes"][0]["nodes"] = [0, 11, 12]
    glb.add("cameras", {"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.05}})
    spot = {"type": "spot", "intensity": 30, "spot": {"innerConeAngle": 0.3, "outerConeAngle": 0.6}}
    glb.json["extensions"] = {"KHR_lights_punctual": {"lights": [spot]}}
    glb.json["extensionsUsed"] = ["KHR_lights_punctual", "KHR_texture_transform", "KHR_materials_emissive_strength"]
    return glb.bytes()


def stool():
    """Two parts below a group."""
    glb = Glb()
    glb.add("materials", paint("Oak", (0.7, 0.5, 0.3)))
    glb.add("meshes", {"primitives": [glb.box((-0.2, 0.4, -0.2), (0.2, 0.45, 0.2), 0)]})
    glb.add("meshes", {"primitives": [glb.box((-0.03, 0, -0.03), (0.03, 0.4, 0.03), 0)]})
    for node in ({"name": "Stool", "children": [1, 2]}, {"name": "Seat", "mesh": 0}, {"name": "Leg", "mesh": 1}):
        glb.add("nodes", node)
    glb.json["scenes"][0]["nodes"] = [0]
    return glb.bytes()


class Service:
    def __init__(self, server, out):
        self.server, self.out = server, out

    def ask(self, method, path, body=None, kind="application/json"):
        data = body if isinstance(body, (bytes, type(None))) else json.dumps(body).encode()
        request = urllib.request.Request(self.server + path, data, {"content-type": kind}, method=method)
        with urllib.request.urlopen(request) as answer:
            return answer.read()

    def wait(self, job):
        while (state := json.loads(self.ask("GET", f"/v1/jobs/{job}"))["state"]) in ("queued", "running"):
            time.sleep(0.1)
        assert state == "succeeded", (job, state)

    def upload(self, glb):
        answer = self.ask("POST", "/v1/scenes?samples_per_element=16", glb, "model/gltf-binary")
        scene = json.loads(answer)
        self.wait(scene["current_job"])
        return f"/v1/scenes/{scene['id']}"

    def keep(self, scene, name):
        for variant, query in VARIANTS.items():
            file = self.ask("GET", f"{scene}/lightmap?format=glb&{query}")
            (self.out / f"{name}.{variant}.glb").write_bytes(file)

    def edit(self, scene, edits):
        job = json.loads(self.ask("POST", f"{scene}/edits", {"edits": edits, "budget": BUDGET}))
        self.wait(job["id"])


def moved(x, y, z, scale=(1, 1, 1)):
    return [scale[0], 0, 0, 0, 0, scale[1], 0, 0, 0, 0, scale[2], 0, x, y, z, 1]


def main():
    server, out, files = sys.argv[1], pathlib.Path(sys.argv[2]), sys.argv[3:]
    service = Service(server, out)
    (out / "room.glb").write_bytes(room())
    scene = service.upload(room())
    service.keep(scene, "room")
    asset = json.loads(service.ask("POST", "/v1/assets", stool(), "model/gltf-binary"))["asset"]
    service.edit(scene, [
        {"op": "insert", "asset": asset, "name": "stool", "transform": moved(3, 0, 3)},
        {"op": "move", "object": "Table", "transform": moved(1.5, 0, 2, (1, 1, 2))},
        {"op": "remove", "objects": ["Screen"]},
        {"op": "hide", "objects": ["Pane"]},
        {"op": "material", "object": "Walls", "albedo": [0.2, 0.6, 0.3]},
        {"op": "material", "object": "Floor", "albedo": [0.5, 0.5, 0.5]},
        {"op": "move_light", "light": "Spot", "position": [2, 2.5, 3]},
    ])
    service.keep(scene, "edited")
    for file in map(pathlib.Path, files):
        scene = service.upload(file.read_bytes())
        service.keep(scene, file.stem)
        service.ask("DELETE", scene)


main()
