#!/usr/bin/env bash
# Throws generated requests at a running service and compares its answers with its own description:
#   tests/schemathesis.sh [examples per operation, default 50]
# Needs Python 3 with venv, and the Python package registry once.
set -euo pipefail
cd "$(dirname "$0")/.."
examples=${1:-50}
venv=target/schemathesis
port=${REBAKE_PORT:-17878}

if [ ! -x $venv/bin/schemathesis ]; then
  python3 -m venv $venv
  $venv/bin/pip install --quiet 'schemathesis==4.32.5'
fi
cargo build --quiet --package rebake
data=$(mktemp -d)
RUST_LOG=warn target/debug/rebake serve --listen "127.0.0.1:$port" --data-dir "$data" >/dev/null &
service=$!
trap 'kill "$service" 2>/dev/null || true; wait "$service" 2>/dev/null || true; rm -rf "$data"' EXIT
for _ in $(seq 100); do
  target/debug/rebake health --server "http://127.0.0.1:$port" >/dev/null 2>&1 && break
  kill -0 "$service"
  sleep 0.1
done

# Streams that follow never end by themselves: they have tests of their own.
export REBAKE_BASE="http://127.0.0.1:$port" SCHEMATHESIS_HOOKS=schemathesis_hooks PYTHONPATH=tests
$venv/bin/schemathesis run "http://127.0.0.1:$port/openapi.json" \
  --checks not_a_server_error,status_code_conformance,content_type_conformance,response_schema_conformance \
  --exclude-operation-id scene_events --exclude-operation-id job_events \
  --max-examples "$examples" --request-timeout 20 --seed 1 --no-color
kill -0 "$service"
