// Stock three.js in a browser on files: three.mjs FOLDER. No light and no environment is added: what is seen is what the file
// says. Keeps a picture of each; fails where one that shall need no light of the viewer's is black, or lacks a name.
import { createServer } from "node:http";
import { existsSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";

const folder = process.argv[2];
const require = createRequire(process.cwd() + "/");
const { chromium } = require("playwright-core");
const three = dirname(dirname(require.resolve("three")));
const executablePath = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"].find((path) => existsSync(path));
if (!executablePath) {
  console.log("skipped: there is no browser");
  process.exit(0);
}

const PAGE = `<!doctype html><canvas id="canvas" width="480" height="360"></canvas>
<script type="importmap">{"imports": {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}</script>
<script type="module">
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
window.show = async (name) => {
  const canvas = document.getElementById("canvas");
  const renderer = new THREE.WebGLRenderer({ canvas, preserveDrawingBuffer: true });
  const gltf = await new GLTFLoader().loadAsync("/files/" + name);
  const box = new THREE.Box3().setFromObject(gltf.scene);
  const camera = gltf.cameras[0] ?? new THREE.PerspectiveCamera(50);
  camera.aspect = 4 / 3;
  if (!gltf.cameras[0]) {
    const size = box.getSize(new THREE.Vector3()).length();
    camera.position.copy(box.getCenter(new THREE.Vector3())).add(new THREE.Vector3(0.4, 0.5, 0.8).multiplyScalar(size));
    camera.lookAt(box.getCenter(new THREE.Vector3()));
    camera.far = 4 * size;
  }
  camera.updateProjectionMatrix();
  renderer.render(gltf.scene, camera);
  const copy = document.createElement("canvas");
  [copy.width, copy.height] = [canvas.width, canvas.height];
  const context = copy.getContext("2d");
  context.drawImage(canvas, 0, 0);
  const { data } = context.getImageData(0, 0, copy.width, copy.height);
  let sum = 0;
  for (let k = 0; k < data.length; k += 4) sum += data[k] + data[k + 1] + data[k + 2];
  const paths = [];
  gltf.scene.traverse((node) => {
    const names = [];
    for (let at = node; at !== gltf.scene; at = at.parent) names.unshift(at.name);
    paths.push(names.join("/"));
  });
  renderer.dispose();
  return { mean: sum / (data.length / 4) / 3 / 255, paths };
};
</script>`;

const types = { js: "text/javascript", glb: "model/gltf-binary" };
const server = createServer((request, response) => {
  const path = decodeURIComponent(new URL(request.url, "http://x").pathname);
  if (path === "/") return response.setHeader("content-type", "text/html").end(PAGE);
  const file = path.startsWith("/three/") ? join(three, path.slice(7)) : join(folder, path.slice(7));
  if (!existsSync(file)) return response.writeHead(404).end();
  response.setHeader("content-type", types[file.split(".").pop()] ?? "application/octet-stream");
  response.end(readFileSync(file));
});
await new Promise((listening) => server.listen(0, "127.0.0.1", listening));

// Without a graphics card, and in containers.
const args = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--no-sandbox"];
const browser = await chromium.launch({ executablePath, args });
const page = await browser.newPage();
page.on("pageerror", (error) => console.log(`  page: ${error}`));
const names = {
  room: ["House/Furniture/Table/Vase", "House/Furniture/Screen", "House/Spot", "Camera", "Marker"],
  edited: ["House/Furniture/Table/Vase", "stool", "House/Spot", "Camera", "Marker"],
};
let failed = false;
for (const name of readdirSync(folder).filter((name) => /\..*\.glb$/.test(name)).sort()) {
  await page.goto(`http://127.0.0.1:${server.address().port}/`);
  await page.waitForFunction(() => window.show);
  const { mean, paths } = await page.evaluate((name) => window.show(name), name);
  writeFileSync(join(folder, name.replace(/glb$/, "png")), await page.locator("canvas").screenshot());
  console.log(`${name}: mean ${mean.toFixed(3)}, ${paths.length} nodes`);
  const [scene, variant] = name.split(".").slice(-3);
  const missing = (names[scene] ?? []).filter((path) => !paths.includes(path));
  if (missing.length) console.log(`  missing: ${missing.join(", ")}`);
  const dark = ["unlit", "atlas"].includes(variant) && mean < 0.02;
  if (dark) console.log("  black");
  failed ||= missing.length > 0 || dark;
}
await browser.close();
server.close();
process.exit(failed ? 1 : 0);
