#!/usr/bin/env python3
"""Real files against an independent reader: what is read, what is refused and why, objects, albedo and emission.

    check.py PATH/TO/rebake [-o TABLE.md] [FOLDER ...]          (needs npm, and Python with numpy and Pillow)

Files are those of the npm and Debian packages below, fetched into a temporary directory, and of the folders that are named;
none is part of this repository. A `.gltf` goes as a zip archive with the files beside it. Every file is uploaded without a bake. Albedo is the area-weighted mean over each object of base colour
factor x texture x COLOR_0 in linear light, emission that of emissive factor x strength x texture, both taken here by
sampling the triangles of the file; the service tells the first of each object, and the second in the materials of its
exported mesh. Exits 1 where a file that both read differs by more than the bounds below."""
import argparse, base64, collections, glob, io, json, os, re, socket, struct, subprocess, sys, tempfile, time, zipfile
import urllib.error, urllib.parse, urllib.request
import numpy as np
from PIL import Image

PACKAGES = ["@webxr-input-profiles/assets@1.0.20", "@pmndrs/assets@1.7.0"]
DEBIAN = ["assimp-testmodels"]    # left out where apt-get has it not
SAMPLES = 40_000          # of each object
ALBEDO, EMISSION = 0.02, 0.03   # absolute; relative to the brightest of an object, plus 0.002 of it
Image.MAX_IMAGE_PIXELS = None
UNREAD = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_basisu", "EXT_mesh_gpu_instancing")


# ---------------------------------------------------------------- the independent reader
class Unread(Exception):
    pass


class File:
    def __init__(self, data, folder=None):
        """Binary glTF, or a document whose files lie in a folder."""
        self.folder, binary = folder, None
        if data[:4] == b"glTF":
            n = struct.unpack_from("<I", data, 12)[0]
            data, binary = data[20:20 + n], data[28 + n:]
        self.json = json.loads(data.decode("utf-8-sig"))
        self.buffers = [self.named(b["uri"]) if "uri" in b else binary for b in self.json.get("buffers", [])]
        if any(e in self.json.get("extensionsUsed", []) for e in UNREAD):
            raise Unread("compressed or instanced: not read here")
        self.pictures = {}

    def named(self, uri):
        if uri.startswith("data:"):
            return base64.b64decode(uri.split(",", 1)[1])
        path = os.path.join(self.folder or "", urllib.parse.unquote(uri))
        if not (self.folder and os.path.isfile(path)):
            raise Unread("a file is missing")
        return open(path, "rb").read()

    def view(self, index):
        v = self.json["bufferViews"][index]
        start = v.get("byteOffset", 0)
        return self.buffers[v["buffer"]][start:start + v["byteLength"]], v.get("byteStride")

    def accessor(self, index):
        a = self.json["accessors"][index]
        if "sparse" in a or "bufferView" not in a:
            raise Unread("sparse accessors: not read here")
        kind = np.dtype({5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[a["componentType"]])
        parts = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[a["type"]]
        data, stride = self.view(a["bufferView"])
        size, start = kind.itemsize * parts, a.get("byteOffset", 0)
        rows = np.lib.stride_tricks.as_strided(
            np.frombuffer(data, "u1")[start:], (a["count"], size), (stride or size, 1)).copy()
        values = rows.view(kind).reshape(a["count"], parts)
        if a.get("normalized"):
            values = np.maximum(values / float(np.iinfo(kind).max), -1.0)
        return values

    def picture(self, info):
        """Linear RGB and alpha of a texture, with what its place is."""
        texture = self.json["textures"][info["index"]]
        source = texture.get("extensions", {}).get("EXT_texture_webp", {}).get("source", texture.get("source"))
        if source is None:
            raise Unread("a picture is not in the file")
        if source not in self.pictures:
            image = self.json["images"][source]
            data = self.view(image["bufferView"])[0] if "bufferView" in image else self.named(image["uri"])
            picture = Image.open(io.BytesIO(data))
            rgba = np.asarray(picture.convert("RGBA")) / 255.0
            rgb = rgba[..., :3]
            self.pictures[source] = np.where(rgb <= .04045, rgb / 12.92, ((rgb + .055) / 1.055) ** 2.4), rgba[..., 3]
        sampler = self.json.get("samplers", [{}])[texture["sampler"]] if "sampler" in texture else {}
        return self.pictures[source], sampler.get("wrapS", 10497), sampler.get("wrapT", 10497)

    def texels(self, info, uv_of):
        """Colour and alpha at places."""
        transform = info.get("extensions", {}).get("KHR_texture_transform", {})
        uv = uv_of(transform.get("texCoord", info.get("texCoord", 0)))
        (rgb, alpha), *wraps = self.picture(info)
        if uv is None:
            return rgb.mean((0, 1)), alpha.mean()
        if transform:
            scale, offset, r = transform.get("scale", [1, 1]), transform.get("offset", [0, 0]), transform.get("rotation", 0)
            s = uv * scale
            uv = np.stack([np.cos(r) * s[:, 0] + np.sin(r) * s[:, 1], -np.sin(r) * s[:, 0] + np.cos(r) * s[:, 1]], 1) + offset
        index = []
        for axis, wrap in zip((0, 1), wraps):
            n = rgb.shape[1 - axis]
            i = np.floor(uv[:, axis] * n).astype(np.int64)
            m = i % (2 * n)
            index.append({33071: np.clip(i, 0, n - 1), 33648: np.minimum(m, 2 * n - 1 - m)}.get(wrap, i % n))
        return rgb[index[1], index[0]], alpha[index[1], index[0]]

    def objects(self):
        """Name, mean albedo, mean emission of every node with a mesh."""
        scene = self.json["scenes"][self.json.get("scene", 0)]
        stack, found = [(i, np.eye(4)) for i in scene["nodes"]], []
        while stack:
            index, above = stack.pop()
            node = self.json["nodes"][index]
            matrix = above @ matrix_of(node)
            stack += [(i, matrix) for i in node.get("children", [])]
            if "mesh" in node:
                if "skin" in node or node.get("weights") or self.json["meshes"][node["mesh"]].get("weights"):
                    raise Unread("skins and morphs: not posed here")
                found.append((index, node.get("name", ""), *self.means(node["mesh"], matrix)))
        return sorted(found)

    def means(self, mesh, matrix):
        rng, parts = np.random.default_rng(1), []
        for p in self.json["meshes"][mesh]["primitives"]:
            mode = p.get("mode", 4)
            if mode < 4 or "POSITION" not in p["attributes"]:
                continue    # points and lines
            attributes = {k: self.accessor(v) for k, v in p["attributes"].items()
                          if re.match("POSITION|TEXCOORD_[01]|COLOR_0", k)}
            count = len(attributes["POSITION"])
            order = self.accessor(p["indices"])[:, 0] if "indices" in p else np.arange(count)
            first = np.arange(max(len(order) - 2, 0))[:, None]
            # Lists, strips (each other one turned), fans.
            corners = order[{4: first[::3] + [0, 1, 2], 5: first + np.where(first % 2, [0, 2, 1], [0, 1, 2]),
                             6: np.hstack([0 * first, first + 1, first + 2])}[mode]]
            a, b, c = (attributes["POSITION"][corners] @ matrix[:3, :3].T).transpose(1, 0, 2)
            parts.append((p, attributes, corners.astype(np.int64), np.linalg.norm(np.cross(b - a, c - a), axis=1)))
        total = sum(area.sum() for *_, area in parts)
        if not total:
            return None, None
        albedo, emission, weight = np.zeros(3), np.zeros(3), 0.0
        for p, attributes, corners, area in parts:
            n = max(1000, int(SAMPLES * area.sum() / total))
            picked = corners[np.searchsorted(area.cumsum() / area.sum(), (np.arange(n) + rng.random(n)) / n).clip(0, len(area) - 1)]
            u, v = rng.random((2, n))
            u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
            at = lambda values: (values[picked] * np.stack([1 - u - v, u, v], 1)[..., None]).sum(1)
            uv_of = lambda k: at(attributes[f"TEXCOORD_{k}"]) if f"TEXCOORD_{k}" in attributes else None
            share = area.sum() / total
            base, shown, emitted = self.surface(p.get("material"), attributes, at, uv_of, n)
            albedo, weight = albedo + share * (base * shown[:, None]).mean(0), weight + share * shown.mean()
            emission += share * emitted.mean(0)
        return (albedo / weight if weight > 1e-6 else None), emission

    def surface(self, material, attributes, at, uv_of, n):
        """Base colour, weight and emission at places."""
        base, shown, emitted = np.ones((n, 3)), np.ones(n), np.zeros((n, 3))
        if "COLOR_0" in attributes:
            base = base * at(attributes["COLOR_0"])[:, :3]
        if material is None:
            return base, shown, emitted
        m = self.json["materials"][material]
        other = m.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness")
        pbr = other or m.get("pbrMetallicRoughness", {})
        factor = pbr.get("diffuseFactor" if other else "baseColorFactor", [1, 1, 1, 1])
        info = pbr.get("diffuseTexture" if other else "baseColorTexture")
        base = base * factor[:3]
        if info:
            rgb, alpha = self.texels(info, uv_of)
            base = base * rgb
            if m.get("alphaMode") == "MASK":
                shown = shown * (alpha * factor[3] >= m.get("alphaCutoff", .5))
            elif m.get("alphaMode") == "BLEND":
                shown = shown * alpha
        strength = m.get("extensions", {}).get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1)
        emitted = emitted + np.array(m.get("emissiveFactor", [0, 0, 0])) * strength
        if "emissiveTexture" in m and emitted.any():
            emitted = emitted * self.texels(m["emissiveTexture"], uv_of)[0]
        return base, shown, emitted


def matrix_of(node):
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = node.get("rotation", [0, 0, 0, 1])
    turn = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn * node.get("scale", [1, 1, 1]), node.get("translation", [0, 0, 0])
    return matrix


# ---------------------------------------------------------------- the service
class Service:
    def __init__(self, binary):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.process = subprocess.Popen([binary, "serve", "--listen", f"127.0.0.1:{self.port}"],
                                        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for _ in range(300):
            try:
                if self.call("GET", "/readyz")[0] == 200:
                    return
            except OSError:
                pass
            time.sleep(.1)
        raise SystemExit("the service does not start")

    def call(self, method, path, body=None):
        request = urllib.request.Request(f"http://127.0.0.1:{self.port}{path}", data=body, method=method,
                                         headers={"Content-Type": media_type(body)} if body else {})
        try:
            with urllib.request.urlopen(request, timeout=600) as answer:
                return answer.status, answer.read()
        except urllib.error.HTTPError as error:
            return error.code, error.read()

    def read(self, data):
        """Scene, or why it is refused; means of emission by object; seconds."""
        start = time.time()
        status, body = self.call("POST", "/v1/scenes?bake=false&max_albedo=0.999", data)
        scene, seconds = json.loads(body), time.time() - start
        if status != 201:
            return None, f"{status}: {scene.get('detail', '')}", {}, seconds
        while scene["state"] == "preparing":
            time.sleep(.05)
            scene = json.loads(self.call("GET", f"/v1/scenes/{scene['id']}")[1])
        _, lit = self.call("GET", f"/v1/scenes/{scene['id']}/lightmap?format=glb")
        self.call("DELETE", f"/v1/scenes/{scene['id']}")
        return scene, "", emission_of(lit), seconds


def media_type(body):
    return "application/zip" if body.startswith(b"PK") else "model/gltf-binary"


def emission_of(data):
    """Of an exported mesh: area-weighted mean emission per node."""
    file, found = File(data), {}
    for node in file.json.get("nodes", []):
        total, sum_ = 0.0, np.zeros(3)
        for p in file.json["meshes"][node["mesh"]]["primitives"] if "mesh" in node else []:
            a, b, c = file.accessor(p["attributes"]["POSITION"])[file.accessor(p["indices"]).reshape(-1, 3)].transpose(1, 0, 2)
            area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
            m = file.json["materials"][p["material"]]
            strength = m.get("extensions", {}).get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1)
            total, sum_ = total + area, sum_ + area * strength * np.array(m.get("emissiveFactor", [0, 0, 0]))
        found[node["name"]] = sum_ / total if total else sum_
    return found


# ---------------------------------------------------------------- files
def fetch(folder):
    for package in PACKAGES:
        target = os.path.join(folder, re.sub(r"\W+", "-", package))
        os.makedirs(target)
        packed = subprocess.run(["npm", "pack", "--silent", package], cwd=target, capture_output=True, text=True, check=True)
        subprocess.run(["tar", "xzf", packed.stdout.strip().splitlines()[-1]], cwd=target, check=True)
    for package in DEBIAN:
        target = os.path.join(folder, package)
        os.makedirs(target)
        subprocess.run(["apt-get", "download", package], cwd=target, capture_output=True)
        for deb in glob.glob(os.path.join(target, "*.deb")):
            subprocess.run(["dpkg-deb", "-x", deb, target], check=True)


def files_of(folders):
    """Name, what is uploaded, and how it is opened here."""
    for folder in folders:
        for path in sorted(glob.glob(os.path.join(folder, "**", "*.gl*"), recursive=True)):
            data, name = open(path, "rb").read(), os.path.relpath(path, folder)
            if path.endswith(".glb"):
                yield name, data, lambda data=data: File(data)
            elif path.endswith(".glb.js"):
                inner = re.search(rb"base64,([A-Za-z0-9+/=]+)", data)
                if inner:
                    whole = base64.b64decode(inner.group(1))
                    yield name, whole, lambda whole=whole: File(whole)
            elif path.endswith(".gltf") and re.search(rb'"version"\s*:\s*"2', data):
                yield name, packed(path, data), lambda data=data, path=path: File(data, os.path.dirname(path))


def packed(path, data):
    """A document with all that lies in its folder."""
    archive, folder = io.BytesIO(), os.path.dirname(path)
    with zipfile.ZipFile(archive, "w") as out:
        out.writestr(os.path.basename(path), data)
        for other in glob.glob(os.path.join(folder, "**"), recursive=True):
            if os.path.isfile(other) and not other.endswith((".gltf", ".glb")):
                out.write(other, os.path.relpath(other, folder))
    return archive.getvalue()


def compare(scene, emission, opened):
    """What differs, and how many objects were compared; none where it is not read here."""
    objects = [o for o in opened().objects()]
    told = {o["node"]: o for o in scene["objects"]}
    worst, light, counted, empty = 0.0, 0.0, 0, 0
    for node, _, albedo, emitted in objects:
        if node not in told or albedo is None:
            empty += albedo is None
            continue
        counted += 1
        worst = max(worst, np.abs(np.array(told[node]["albedo"]) - np.minimum(albedo, 1)).max())
        there, top = emission.get(told[node]["name"], np.zeros(3)), max(emitted.max(), 1e-3)
        light = max(light, np.abs(there - emitted).max() / top if emitted.max() > 1e-4 or there.max() > 1e-4 else 0.0)
    return worst, light, counted, len(objects) - empty


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rebake"), parser.add_argument("folders", nargs="*"), parser.add_argument("-o", "--output")
    parser.add_argument("--no-npm", action="store_true", help="only the folders")
    args = parser.parse_intermixed_args()
    rows, failed, tally, slow = [], [], collections.Counter(), 0.0
    with tempfile.TemporaryDirectory() as folder:
        args.no_npm or fetch(folder)
        service = Service(args.rebake)
        try:
            for name, data, opened in files_of(args.folders if args.no_npm else [folder, *args.folders]):
                rows and print(*rows[-1], sep=" | ", flush=True)
                scene, why, emission, seconds = service.read(data)
                slow = max(slow, seconds)
                if scene is None:
                    tally["refused"] += 1
                    rows.append((name, why, "", "", "", f"{seconds:.2f}"))
                    continue
                tally["read"] += 1
                objects = len(scene["objects"])
                try:
                    albedo, light, counted, expected = compare(scene, emission, opened)
                    ok = albedo <= ALBEDO and light <= EMISSION and counted == expected
                    tally["compared"] += 1
                    ok or failed.append(name)
                    rows.append((name, "read" if ok else "DIFFERS", f"{objects} of {expected}", f"{albedo:.4f}", f"{light:.4f}", f"{seconds:.2f}"))
                except Unread as reason:
                    rows.append((name, f"read; {reason}", objects, "", "", f"{seconds:.2f}"))
                except Exception as error:  # the reader here, not the service
                    rows.append((name, f"read; the reader here fails: {error!r}"[:120], objects, "", "", f"{seconds:.2f}"))
        finally:
            service.process.terminate()
            service.process.wait(30)
    table = ["| file | read | objects | albedo off by | emission off by | seconds |", "| --- | --- | --- | --- | --- | --- |"]
    table += ["| " + " | ".join(str(cell).replace("|", "/") for cell in row) + " |" for row in rows]
    table.append(f"\n{dict(tally)}, {len(failed)} differ, slowest upload {slow:.1f} s")
    print(table[-1])
    if args.output:
        open(args.output, "w").write("\n".join(table) + "\n")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
