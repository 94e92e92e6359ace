#!/usr/bin/env bash
# Sees to it that there is a NATS server, from Debian where it is not installed yet, and prints where.
set -euo pipefail
if ! command -v nats-server >/dev/null; then
    command -v apt-get >/dev/null || { echo "nats-server is not installed, and there is no apt-get" >&2; exit 1; }
    [ "$(id -u)" = 0 ] || { echo "nats-server is not installed, and only root can" >&2; exit 1; }
    export DEBIAN_FRONTEND=noninteractive
    timeout 300 sh -c 'apt-get update -qq && apt-get install -y -qq nats-server' >&2
fi
command -v nats-server
