#!/bin/sh
# Chromium without root's privilege to raise its own priority, which starves the services under test.
chromium="${SPLATBUS_CHROMIUM:-/usr/bin/chromium}"
without='--bounding-set=-sys_nice --inh-caps=-sys_nice'
if setpriv $without true 2>/dev/null; then exec setpriv $without "$chromium" "$@"; fi
exec "$chromium" "$@"
