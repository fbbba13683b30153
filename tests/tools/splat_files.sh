#!/usr/bin/env bash
# splat_files.sh SPLATBUS FOLDER: fetches the packages of package.json into FOLDER and runs splat_files.mjs there. Exits
# with 77 where they cannot be had.
set -euo pipefail
here="$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd)"
splatbus="$1"
mkdir -p "$2"
cp "$here/package.json" "$here/package-lock.json" "$2"
if ! cmp -s "$here/package-lock.json" "$2/installed"; then
  if ! timeout 180 npm ci --prefix "$2" --ignore-scripts --no-audit --no-fund --loglevel=error; then
    echo "skipped: npm cannot fetch $(sed -n 's/^ *"\(@playcanvas[^"]*\)".*/\1/p' "$here/package.json") and the others" >&2
    exit 77
  fi
  cp "$here/package-lock.json" "$2/installed"
fi
exec node "$here/splat_files.mjs" "$splatbus" "$2"
