#!/usr/bin/env bash
# Has others load what `lightmap?format=glb` answers, before and after edits:
#   tests/gltf_out.sh [SCENE.glb ...]
# the Khronos validator, three.js in a browser (with no light but the file's), Blender. What they need is installed into a
# folder that is removed at the end (REBAKE_TOOLS names one to keep); where the registries cannot be reached, or there is no
# browser or no Python that Blender comes for, it says so and goes on without. REBAKE_BINARY: a build to use instead of making
# one. KEEP: a folder for the files and for pictures of them.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
scenes=()
for scene in "$@"; do scenes+=("$(realpath "$scene")"); done
cd "$here/.."
work=$(mktemp -d)
tools=${REBAKE_TOOLS:-$work/tools}
out=${KEEP:-$work/out}
service=
trap '[ -z "$service" ] || { kill "$service" 2>/dev/null || true; wait "$service" 2>/dev/null || true; }; rm -rf "$work"' EXIT

step() { printf '\n== %s\n' "$*"; }
skip() {
  printf '\n== skipped: %s\n' "$*"
  exit 0
}

step "install the tools"
mkdir -p "$tools" "$out"
command -v python3 >/dev/null || skip "there is no python3"
command -v npm >/dev/null || skip "there is no npm"
npm install --prefix "$tools" --silent --no-fund --no-audit --fetch-retries 1 gltf-validator@2.0.0-dev.3.10 three@0.180 \
  playwright-core@1 >"$work/npm.log" 2>&1 || skip "the npm registry cannot be reached: $(tail -n 1 "$work/npm.log")"
blender=
if ! command -v python3.11 >/dev/null; then
  echo "no Blender: there is no python3.11, which its module is for"
elif [ -x "$tools/py/bin/python" ] || python3.11 -m venv "$tools/py"; then
  "$tools/py/bin/pip" install --quiet --retries 1 --timeout 20 bpy==4.2.0 >"$work/pip.log" 2>&1 \
    && blender=$tools/py/bin/python || echo "no Blender: $(tail -n 1 "$work/pip.log")"
fi

step "write the files"
binary=${REBAKE_BINARY:-target/debug/rebake}
[ -n "${REBAKE_BINARY:-}" ] || cargo build --quiet --package rebake
port=$(python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')
server="http://127.0.0.1:$port"
RUST_LOG=warn "$binary" serve --listen "127.0.0.1:$port" >"$work/service.log" 2>&1 &
service=$!
for _ in $(seq 300); do
  "$binary" health --server "$server" >/dev/null 2>&1 && break
  kill -0 "$service" || { cat "$work/service.log"; exit 1; }
  sleep 0.1
done
python3 "$here/gltf_out/scenes.py" "$server" "$out" ${scenes[@]+"${scenes[@]}"}

cd "$tools"
step "the Khronos validator"
node "$here/gltf_out/validate.mjs" "$out"

step "three.js"
node "$here/gltf_out/three.mjs" "$out"

step "Blender"
if [ -n "$blender" ]; then "$blender" "$here/gltf_out/blender.py" "$out"; else echo "left out"; fi
