#!/usr/bin/env bash
# manifests.sh SPLATBUS FOLDER: fetches the packages of package.json into FOLDER and runs manifests.mjs there. Exits with
# 77 where they cannot be had.
set -euo pipefail
here="$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd)"
mkdir -p "$2"
cp "$here/package.json" "$here/package-lock.json" "$2"
if ! cmp -s "$here/package-lock.json" "$2/installed"; then
  if ! timeout 180 npm ci --prefix "$2" --ignore-scripts --no-audit --no-fund --loglevel=error; then
    echo "skipped: npm cannot fetch the schemas" >&2
    exit 77
  fi
  cp "$here/package-lock.json" "$2/installed"
fi
cp "$here/manifests.mjs" "$here/keys.mjs" "$2"  # beside its packages
exec node "$2/manifests.mjs" "$1" "$here"
