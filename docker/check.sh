#!/usr/bin/env bash
# Runs the steps of docker/Dockerfile without Docker: every image is a Debian root made by debootstrap, every RUN happens
# in it by chroot, and in the end the service has to pass its health check as the image's user.
#
#   sudo docker/check.sh
#
# Needs root, debootstrap and a Rust toolchain, which stands in for the one in the official image. DEBIAN_MIRROR says
# where packages come from [default: this machine's apt source], KEEP=1 keeps the roots, PORT is where the service
# listens meanwhile. Proxies and cargo's registries are those of this machine.
set -euo pipefail
cd "$(dirname "$0")/.."

work=$(mktemp -d "${TMPDIR:-/tmp}/rebake-image.XXXXXX")
port=${PORT:-17879}
service=
mounts=()

cleanup() {
  [ -z "$service" ] || kill "$service" 2>/dev/null || true
  for ((i = ${#mounts[@]} - 1; i >= 0; i--)); do umount "${mounts[i]}" || true; done
  # What is bound here belongs to this machine.
  if [ -n "${KEEP:-}" ] || grep -q " $work/" /proc/mounts; then
    echo "kept: $work"
  else
    rm -rf "$work"
  fi
}
trap cleanup EXIT

fail() {
  echo "docker/check.sh: $*" >&2
  exit 1
}

[ "$(id -u)" = 0 ] || fail "chroot needs root"
command -v debootstrap >/dev/null || fail "debootstrap is missing (Debian: apt-get install debootstrap)"

apt_mirror() {
  cat /etc/apt/sources.list.d/debian.sources /etc/apt/sources.list 2>/dev/null \
    | sed -nE 's/^(URIs:|deb( \[[^]]*\])?) +(https?:[^ ]+).*/\3/p' | head -n 1 || true
}
mirror=${DEBIAN_MIRROR:-$(apt_mirror)}
mirror=${mirror:-http://deb.debian.org/debian}

bind() { # what, where
  mkdir -p "$2"
  mount --bind "$1" "$2"
  mounts+=("$2")
}

# The toolchain of the version that the image's tag names, where rustup has it.
rust_sysroot() { # version
  local toolchain=
  if command -v rustup >/dev/null; then
    toolchain=$(rustup toolchain list | sed 's/ .*//' | grep -m 1 "^$1\b" || true)
  fi
  if [ -n "$toolchain" ]; then rustup run "$toolchain" rustc --print sysroot; else rustc --print sysroot; fi
}

# A root that has what the image has.
from() { # image, directory
  local suite packages=ca-certificates
  suite=$(grep -oE 'bookworm|trixie|forky' <<<"$1") || fail "no Debian in $1"
  case $1 in rust:*) packages+=,gcc,libc6-dev ;; esac
  debootstrap --variant=minbase --include="$packages" "$suite" "$2" "$mirror" >"$work/debootstrap.log" 2>&1 \
    || { tail "$work/debootstrap.log" >&2; fail "debootstrap $suite"; }
  cp -L /etc/resolv.conf /etc/hosts "$2/etc/"
  cp -L /etc/ssl/certs/ca-certificates.crt "$2/etc/ssl/certs/"
  mount -t proc proc "$2/proc"
  mounts+=("$2/proc")
  case $1 in
    rust:*)
      local version=${1#rust:}
      bind "$(rust_sysroot "${version%%-*}")" "$2/usr/local/rust"
      mount -o remount,bind,ro "$2/usr/local/rust"
      mkdir -p "$2/usr/local/cargo"
      cp "${CARGO_HOME:-$HOME/.cargo}"/config.toml "$2/usr/local/cargo/" 2>/dev/null || true
      ;;
  esac
}

# Variables of this machine that say how to reach the network.
network() {
  env | grep -iE '^(https?_proxy|no_proxy|ssl_cert_file|node_extra_ca_certs|npm_config_[a-z_]+|cargo_(http|net|source|registries|registry)_[a-z0-9_]+)=' || true
}

inside() { # command line for sh
  local -a variables
  mapfile -t variables < <(network)
  chroot "$root" /usr/bin/env -i PATH=/usr/local/rust/bin:/usr/local/bin:/usr/bin:/usr/sbin:/bin:/sbin HOME=/root \
    CARGO_HOME=/usr/local/cargo "${variables[@]}" "${environment[@]}" sh -euc "cd '$workdir'; $1"
}

run() { # the rest of a RUN line
  local line=$1 mount target
  while [[ $line =~ ^--mount=([^[:space:]]+)[[:space:]]+(.*)$ ]]; do
    mount=${BASH_REMATCH[1]} line=${BASH_REMATCH[2]}
    target=$(sed -nE 's/.*target=([^,]+).*/\1/p' <<<"$mount")
    case $target in
      # What this machine has downloaded already.
      */cargo/registry) mkdir -p "${CARGO_HOME:-$HOME/.cargo}/registry"; bind "${CARGO_HOME:-$HOME/.cargo}/registry" "$root$target" ;;
      *) mkdir -p "$work/cache$target"; bind "$work/cache$target" "$root$target" ;;
    esac
  done
  inside "$line"
}

copy() { # the rest of a COPY line
  if [[ $1 =~ ^--from=([^[:space:]]+)[[:space:]]+([^[:space:]]+)[[:space:]]+([^[:space:]]+)$ ]]; then
    mkdir -p "$(dirname "$root${BASH_REMATCH[3]}")"
    cp -a "$work/${BASH_REMATCH[1]}${BASH_REMATCH[2]}" "$root${BASH_REMATCH[3]}"
  elif [ "$1" = ". ." ]; then
    git ls-files -z --cached --others --exclude-standard | tar -c --null --ignore-failed-read -T - | tar -x -C "$root$workdir"
  else
    fail "COPY $1 is not understood"
  fi
}

# The list ["a", "b"] as words.
words() { tr -d '[],"' <<<"$1"; }

root= user=root workdir=/ health= entrypoint= arguments= environment=()
while read -r instruction rest <&3; do
  printf '\n== %s %s\n' "$instruction" "$rest"
  case $instruction in
    FROM)
      stage=final
      [[ $rest =~ ^([^[:space:]]+)[[:space:]]+AS[[:space:]]+(.*)$ ]] && { stage=${BASH_REMATCH[2]} rest=${BASH_REMATCH[1]}; }
      root=$work/$stage user=root workdir=/ environment=()
      from "$rest" "$root"
      ;;
    WORKDIR) workdir=$rest; mkdir -p "$root$workdir" ;;
    COPY) copy "$rest" ;;
    RUN) run "$rest" ;;
    ENV) environment+=("$rest") ;;
    USER) user=$rest ;;
    HEALTHCHECK) health=$(words "${rest#*CMD }") ;;
    ENTRYPOINT) entrypoint=$(words "$rest") ;;
    CMD) arguments=$(words "$rest") ;;
    EXPOSE | VOLUME) ;;
    *) fail "$instruction is not understood" ;;
  esac
done 3< <(sed -E '/^[[:space:]]*(#|$)/d' docker/Dockerfile | sed -e :a -e '/\\$/N; s/\\\n[[:space:]]*//; ta')

printf '\n== the service, as %s\n' "$user"
as_user=(chroot --userspec="$user" "$root" /usr/bin/env -i PATH=/usr/local/bin:/usr/bin:/bin "${environment[@]}"
  REBAKE_LISTEN="127.0.0.1:$port" REBAKE_SERVER="http://127.0.0.1:$port" REBAKE_DATA_DIR=/data)
# shellcheck disable=SC2086 # words
"${as_user[@]}" $entrypoint $arguments &
service=$!
for try in $(seq 30); do
  # shellcheck disable=SC2086
  if "${as_user[@]}" $health 2>/dev/null; then break; fi
  [ "$try" -lt 30 ] || fail "the health check does not pass"
  sleep 1
done
kill "$service"
wait "$service" || fail "the service did not end well"
service=
printf '\nall steps passed\n'
