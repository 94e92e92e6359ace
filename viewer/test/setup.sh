#!/usr/bin/env bash
# Gets what the browser test needs: Node and Chromium, by the distribution's package manager where they are not there and
# this user may (root, or sudo without a password), and the page's packages, by npm into viewer/node_modules.
#
#   viewer/test/setup.sh [--check]      --check installs nothing
#
# Prints the path of the browser. Where something is missing that cannot be installed, prints that in one line instead and
# ends with 1. What it does meanwhile it says on standard error; nothing where everything is there.
# CHROMIUM names a browser to be used instead of those it looks for.
set -uo pipefail
cd "$(dirname "$0")/.."

# Seconds after which nothing waits for a network any more, and seconds for the package manager's work on the disk: a
# limit of its own, as to end that half-way would leave half a package.
NETWORK=300
UNPACK=240
root=''
quiet='-q -y -o Acquire::Retries=1 -o Acquire::http::Timeout=20 -o DPkg::Lock::Timeout=100'
has_lists=''
check=no
[ "${1:-}" != --check ] || check=yes
log=$(mktemp)
trap 'rm -f "$log"' EXIT

cannot() {
  echo "$*"
  exit 1
}

# step SECONDS WHAT COMMAND…
step() {
  local seconds=$1 what=$2 start=$SECONDS status=0
  shift 2
  echo "viewer/test/setup.sh: $what ..." >&2
  timeout --kill-after=5 "$((seconds > 0 ? seconds : 1))" "$@" </dev/null >"$log" 2>&1 || status=$?
  [ "$status" != 0 ] || echo "viewer/test/setup.sh: done after $((SECONDS - start)) s" >&2
  return "$status"
}

# The reason why a step ended with this.
why() {
  if [ "$1" = 124 ] || [ "$1" = 137 ]; then echo "it took too long"; else grep . "$log" | tail -n 1; fi
}

# may_install REASON: whether packages may be installed here, which is why something is wanted; with fresh lists of them.
may_install() {
  [ "$check" = no ] || cannot "$1"
  command -v apt-get >/dev/null || cannot "$1, and there is no apt-get to install it"
  if [ "$(id -u)" != 0 ]; then
    root='sudo -n'
    $root true 2>/dev/null || cannot "$1, and to install it takes root, or sudo without a password"
  fi
  [ -z "$has_lists" ] || return
  # An installation that was cut short is completed first. Lists that cannot be had anew may still be good.
  step "$UNPACK" "dpkg --configure -a" $root env DEBIAN_FRONTEND=noninteractive dpkg --configure -a
  step "$((NETWORK - SECONDS))" "apt-get update" $root apt-get update $quiet
  has_lists=yes
}

# packages REASON NAME…: installs them.
packages() {
  local reason=$1
  shift
  may_install "$reason"
  step "$((NETWORK - SECONDS))" "downloading $*" \
    $root apt-get install $quiet --no-install-recommends --download-only "$@" ||
    cannot "$reason; apt-get install $*: $(why $?)"
  step "$UNPACK" "installing $*" $root env DEBIAN_FRONTEND=noninteractive \
    apt-get install $quiet --no-install-recommends -o Dpkg::Options::=--force-confold "$@" ||
    cannot "$reason; apt-get install $*: $(why $?)"
}

has_node() {
  node -e 'const [a, b] = process.versions.node.split(".").map(Number); process.exit(a > 20 || (a === 20 && b >= 19) ? 0 : 1)' \
    2>/dev/null
}

browser() {
  local name
  for name in "${CHROMIUM:-}" chromium chromium-browser google-chrome-stable google-chrome; do
    # Some distributions have a stand-in there that only tells how to get the real one.
    [ -n "$name" ] && timeout 20 "$name" --version >/dev/null 2>&1 && command -v "$name" && return
    # Who names one wants that one.
    [ -z "${CHROMIUM:-}" ] || return 1
  done
  return 1
}

command -v timeout >/dev/null || cannot "there is no timeout (GNU coreutils)"

if ! has_node; then
  missing="there is no Node 20.19 or newer"
  may_install "$missing"
  offered=$(apt-cache policy nodejs | awk '/Candidate:/ { print $2 }')
  dpkg --compare-versions "$offered" ge 20.19 || cannot "$missing, and the distribution's is $offered"
  packages "$missing" nodejs
  has_node || cannot "$missing: the one that is found first is older than the one just installed"
fi
command -v npm >/dev/null || packages "there is no npm" npm

# npm writes that file last: packages that were installed half-way, or for another lock file, are not taken for whole.
if [ package-lock.json -nt node_modules/.package-lock.json ]; then
  [ "$check" = no ] || cannot "the page's packages are not installed"
  step "$((NETWORK - SECONDS))" "npm ci" npm ci --no-audit --no-fund --prefer-offline --fetch-retries=1 ||
    cannot "the page's packages cannot be installed; npm ci: $(why $?)"
fi

if ! browser; then
  [ -z "${CHROMIUM:-}" ] || cannot "CHROMIUM=$CHROMIUM does not run"
  packages "there is no Chromium" chromium
  browser || cannot "chromium was installed, but does not run"
fi
