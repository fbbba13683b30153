#!/bin/sh
# Chromium as one who is not root has it. Root's raises its own priority (nice -8), and starves what it is tested with.
exec setpriv --bounding-set=-sys_nice --inh-caps=-sys_nice "${SPLATBUS_CHROMIUM:-/usr/bin/chromium}" "$@"
