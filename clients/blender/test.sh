#!/usr/bin/env bash
# Tests the add-on in Blender without a window (the module bpy, 350 MB, which needs Python 3.11), against a service:
#   clients/blender/test.sh [folder for pictures, default clients/blender/dist]
# bpy is installed into a folder that is removed at the end (REBAKE_TOOLS names one to keep; REBAKE_BLENDER=as-is takes what is
# there). Where that cannot be, it says so and passes, or fails with REBAKE_BLENDER=required. REBAKE_SERVER and REBAKE_TOKEN: a
# service to use; else one is started, of REBAKE_BINARY or of a build made here.
set -euo pipefail
cd "$(dirname "$0")"
pictures=$(realpath -m "${1:-dist}")
work=$(mktemp -d)
tools=${REBAKE_TOOLS:-$work/tools}
service=
trap '[ -z "$service" ] || { kill "$service" 2>/dev/null || true; wait "$service" 2>/dev/null || true; }; rm -rf "$work"' EXIT

skip() {
  [ "${REBAKE_BLENDER:-}" != required ] || { printf 'Blender is missing: %s\n' "$*" >&2; exit 1; }
  printf 'Blender test skipped: %s\n' "$*"
  exit 0
}

python=$(command -v python3.11) || skip "there is no Python 3.11, which bpy 4.2 needs"
mkdir -p "$tools" "$pictures"
if [ "${REBAKE_BLENDER:-}" != as-is ]; then
  [ -x "$tools/blender/bin/python" ] || "$python" -m venv "$tools/blender" || skip "Python 3.11 cannot make a venv"
  timeout 600 "$tools/blender/bin/pip" install --quiet --retries 1 --timeout 60 bpy==4.2.0 >"$work/pip.log" 2>&1 ||
    skip "bpy cannot be installed: $(tail -n 1 "$work/pip.log")"
fi
"$tools/blender/bin/python" -c 'import bpy, os; os._exit(0)' >"$work/bpy.log" 2>&1 ||
  skip "bpy does not run here: $(tail -n 1 "$work/bpy.log")"

if [ -z "${REBAKE_SERVER:-}" ]; then
  binary=${REBAKE_BINARY:-../../target/debug/rebake}
  [ -n "${REBAKE_BINARY:-}" ] || (cd ../.. && cargo build --quiet --package rebake)
  : >"$work/service.log"
  RUST_LOG=warn "$binary" serve --listen 127.0.0.1:0 >>"$work/service.log" 2>&1 &
  service=$!
  for _ in $(seq 300); do
    REBAKE_SERVER=$(sed -n 's/^listening on //p' "$work/service.log")
    [ -z "$REBAKE_SERVER" ] || break
    kill -0 "$service" || { cat "$work/service.log"; exit 1; }
    sleep 0.1
  done
fi
archive=$(python3 build.py "$work")
"$tools/blender/bin/python" tests/in_blender.py "$archive" "$REBAKE_SERVER" "$pictures" 2>"$work/errors.log" |
  grep --line-buffered -vE '^Fra:|^Info:|^Saved:|^Time:|INFO:|Draco|^ *$' || { cat "$work/errors.log"; exit 1; }
