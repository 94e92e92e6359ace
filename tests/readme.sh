#!/usr/bin/env bash
# Runs the README's five minutes as they are printed, in a folder of their own: tests/readme.sh PATH/TO/rebake
# The build of the first lines is left out: the binary is given. Fails with the first command that does.
set -euo pipefail
binary=$(realpath "$1")
readme=$(realpath "$(dirname "$0")/../README.md")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
mkdir bin && ln -s "$binary" bin/rebake
export PATH="$folder/bin:$PATH"
recipe=$(awk '/^## Five minutes/ { found = 1 } found && /^```$/ { exit } inside { print } found && /^```sh$/ { inside = 1 }' "$readme")
[ -n "$recipe" ] || { echo "there is no recipe in $readme" >&2; exit 1; }
# Jobs are numbered where job control is on; what is left running ends with the shell.
printf '%s\n' 'set -emo pipefail; trap "kill %1 2>/dev/null || true" EXIT' "$recipe" |
  grep -v -e '^cargo build' -e '^export PATH' >recipe.sh
# The recipe takes the default address: what answers there already is somebody else's service.
if (exec 3<>/dev/tcp/127.0.0.1/7878) 2>/dev/null; then
  echo "something listens on port 7878 already" >&2
  exit 1
fi
while read -r variable; do unset "$variable"; done < <(compgen -e REBAKE_ || true)
timeout 300 bash recipe.sh
for file in room.exr room-lit.glb room.png; do
  [ -s "$file" ] || { echo "$file was not written" >&2; exit 1; }
done
echo "the README's recipe ran as printed"
