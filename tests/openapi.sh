#!/usr/bin/env bash
# Checks the API's description with the tools that others use, and what they make of it against a running service:
#   tests/openapi.sh [examples per operation of schemathesis, default 10]
# validators, openapi-typescript, openapi-python-client, schemathesis. Everything they need is installed into a folder that
# is removed at the end (REBAKE_TOOLS names one to keep); where the registries cannot be reached it says so and passes.
# REBAKE_BINARY: a build to use instead of making one.
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD
work=$(mktemp -d)
tools=${REBAKE_TOOLS:-$work/tools}
service=
trap '[ -z "$service" ] || { kill "$service" 2>/dev/null || true; wait "$service" 2>/dev/null || true; }; rm -rf "$work"' EXIT

step() { printf '\n== %s\n' "$*"; }
skip() {
  printf '\n== skipped: %s\n' "$*"
  exit 0
}

step "install the tools"
mkdir -p "$tools"
command -v python3 >/dev/null || skip "there is no python3"
command -v npm >/dev/null || skip "there is no npm"
[ -x "$tools/py/bin/python" ] || python3 -m venv "$tools/py" || skip "python3 cannot make a venv"
"$tools/py/bin/pip" install --quiet --retries 1 --timeout 20 openapi-spec-validator==0.9.0 openapi-python-client==0.29.1 \
  schemathesis==4.32.5 >"$work/pip.log" 2>&1 || skip "the Python registry cannot be reached: $(tail -n 1 "$work/pip.log")"
npm install --prefix "$tools" --silent --no-fund --no-audit --fetch-retries 1 @redocly/cli@2 openapi-typescript@7 \
  typescript@5 >"$work/npm.log" 2>&1 || skip "the npm registry cannot be reached: $(tail -n 1 "$work/npm.log")"
export PATH="$tools/py/bin:$tools/node_modules/.bin:$PATH" REDOCLY_TELEMETRY=off REDOCLY_SUPPRESS_UPDATE_NOTICE=true

step "validate openapi/openapi.json"
openapi-spec-validator openapi/openapi.json
redocly lint openapi/openapi.json --format=stylish

step "openapi-typescript"
mkdir "$work/ts"
openapi-typescript openapi/openapi.json -o "$work/ts/api.d.ts"
cp tests/openapi.ts "$work/ts/use.ts"
tsc --noEmit --strict "$work/ts/use.ts"

step "openapi-python-client"
openapi-python-client generate --path openapi/openapi.json --output-path "$work/client" \
  --config tests/openapi-python-client.yaml --fail-on-warning

step "the generated client against a service"
binary=${REBAKE_BINARY:-target/debug/rebake}
[ -n "${REBAKE_BINARY:-}" ] || cargo build --quiet --package rebake
port=$(python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')
server="http://127.0.0.1:$port"
RUST_LOG=warn "$binary" serve --listen "127.0.0.1:$port" --data-dir "$work/data" >"$work/service.log" 2>&1 &
service=$!
for _ in $(seq 300); do
  "$binary" health --server "$server" >/dev/null 2>&1 && break
  kill -0 "$service" || { cat "$work/service.log"; exit 1; }
  sleep 0.1
done
export REBAKE_BASE=$server PYTHONPATH="$work/client:$root/tests"
python "$root/tests/openapi_client.py" "$server"

step "schemathesis"
# Streams that follow never end by themselves: they have tests of their own. tests/schemathesis.sh goes through all phases.
cd "$work"
SCHEMATHESIS_HOOKS=schemathesis_hooks schemathesis run "$server/openapi.json" \
  --checks not_a_server_error,status_code_conformance,content_type_conformance,response_schema_conformance \
  --exclude-operation-id scene_events --exclude-operation-id job_events --phases examples,fuzzing \
  --max-examples "${1:-10}" --request-timeout 20 --seed 1 --no-color
kill -0 "$service"
