#!/usr/bin/env bash
# Makes what is given to people: an archive with the service, the page inside it, its documents and the Blender
# extension; a Debian package of the same; their checksums.
#
#   docker/release.sh [--binary FILE] [FOLDER]         FOLDER: where they go [default: target/package]
#
# Builds the service with the page, which takes Node 20.19 or newer beside Rust; FILE is one that was built before, with
# `--features viewer`. What is in the archive is unpacked again and has to answer with the page. The package is left out
# where there is no dpkg-deb.
set -euo pipefail
cd "$(dirname "$0")/.."

binary=
folder=target/package
while [ $# -gt 0 ]; do
  case $1 in
    --binary) binary=${2:?--binary wants a file}; shift 2 ;;
    -*) sed -n '2,/^set/{/^#/s/^# \{0,1\}//p}' "$0" >&2; exit 2 ;;
    *) folder=$1; shift ;;
  esac
done

fail() {
  echo "docker/release.sh: $*" >&2
  exit 1
}

work=$(mktemp -d)
service=
trap '[ -z "$service" ] || kill "$service" 2>/dev/null || true; rm -rf "$work"' EXIT

# The page is part of a build, or the build says so on its page: here it has to be.
check() { # binary
  "$1" serve --listen 127.0.0.1:0 >"$work/log" 2>&1 &
  service=$!
  local address=
  for _ in $(seq 100); do
    address=$(sed -n 's/^listening on //p' "$work/log")
    [ -z "$address" ] || break
    kill -0 "$service" 2>/dev/null || fail "$1 does not start: $(cat "$work/log")"
    sleep 0.1
  done
  [ -n "$address" ] || fail "$1 does not say where it listens"
  curl -sf --max-time 20 "$address/" | grep -q viewer.js || fail "$1 has no page in it: it is built with --features viewer, and Node"
  curl -sf --max-time 20 "$address/viewer.js" >/dev/null || fail "$1 has half a page in it"
  REBAKE_SERVER=$address "$1" health >/dev/null || fail "$1 is not ready"
  kill "$service"
  wait "$service" || fail "$1 does not end well"
  service=
}

version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -n 1)
machine=$(uname -m)
# Files are as old as the commit: the same source makes the same archive.
when=@${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct 2>/dev/null || date +%s)}

if [ -z "$binary" ]; then
  cargo build --release --locked --package rebake --features viewer
  binary=${CARGO_TARGET_DIR:-target}/release/rebake
fi

name=rebake-$version-linux-$machine
top=$work/$name
mkdir -p "$top/clients"
install -m 755 "$binary" "$top/rebake"
! command -v strip >/dev/null || strip --strip-debug "$top/rebake"
cp -R README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE docs "$top/"
cp -R openapi "$top/"
mv "$(python3 clients/blender/build.py "$work/blender")" "$top/clients/rebake-blender-$version.zip"
mkdir -p "$folder"
# Unpacked by whom it is for: what is checked is what is in the archive.
tar -C "$work" --sort=name --mtime="$when" --owner=0 --group=0 --numeric-owner -c "$name" | gzip -n >"$folder/$name.tar.gz"
mkdir "$work/unpacked"
tar -C "$work/unpacked" -xzf "$folder/$name.tar.gz"
check "$work/unpacked/$name/rebake"
made=("$name.tar.gz")

# The oldest C library that has all that the program wants.
libc() {
  local newest
  newest=$(objdump -T "$1" 2>/dev/null | grep -oE 'GLIBC_2\.[0-9]+' | sort -uV | tail -n 1 || true)
  echo "libc6${newest:+ (>= ${newest#GLIBC_})}"
}

if command -v dpkg-deb >/dev/null; then
  package=$work/package
  architecture=$(dpkg --print-architecture)
  install -D -m 755 "$top/rebake" "$package/usr/bin/rebake"
  install -D -m 644 docker/rebake.service "$package/usr/lib/systemd/system/rebake.service"
  install -d "$package/usr/share/doc/rebake" "$package/DEBIAN"
  cp -R README.md CHANGELOG.md docs "$package/usr/share/doc/rebake/"
  cat LICENSE-MIT LICENSE-APACHE >"$package/usr/share/doc/rebake/copyright"
  cat >"$package/DEBIAN/control" <<EOF
Package: rebake
Version: $version
Architecture: $architecture
Maintainer: rebake
Section: graphics
Priority: optional
Depends: $(libc "$top/rebake"), libgcc-s1
Description: service that keeps the light map of a 3D scene up to date
 Upload a room as binary glTF, edit it, and get just the values of its light
 map that changed, with their stated error. Its page is a small level-lighting
 editor. systemctl enable --now rebake has it listen on 127.0.0.1:7878.
EOF
  find "$package" -exec touch --no-dereference --date="$when" {} +
  dpkg-deb --root-owner-group --build "$package" "$folder/rebake_${version}_$architecture.deb" >/dev/null
  dpkg-deb --extract "$folder/rebake_${version}_$architecture.deb" "$work/installed"
  check "$work/installed/usr/bin/rebake"
  made+=("rebake_${version}_$architecture.deb")
fi

(cd "$folder" && sha256sum "${made[@]}" >SHA256SUMS)
printf '%s\n' "${made[@]/#/$folder/}" "$folder/SHA256SUMS"
