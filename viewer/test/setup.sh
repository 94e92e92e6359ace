#!/usr/bin/env bash
# What the browser test needs: the page's packages, and a browser from the distribution where there is none.
set -euo pipefail
cd "$(dirname "$0")/.."

npm ci --no-audit --no-fund
if ! command -v chromium >/dev/null && [ -z "${CHROMIUM:-}" ]; then
  as_root=()
  [ "$(id -u)" = 0 ] || as_root=(sudo)
  "${as_root[@]}" apt-get update
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends chromium
fi
