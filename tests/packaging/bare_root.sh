#!/usr/bin/env bash
# bare_root.sh FOLDER [WEB]: takes the packages of a folder (`./splatbus package`, or cpack of any build) to a bare Debian 12:
# installs them there, launches the user service's command until a page shows a picture, builds the engine's example, and
# purges all of it. WEB: the project's folder web, with its node_modules, for a Chromium of this machine to open the page. Needs root,
# debootstrap and the network. Says how long each step took; what was downloaded before is not in it.
set -euo pipefail
packages="$(realpath "$1")" web="${2:+$(realpath "$2")}" port=7680
fail() { echo "FAILED: $*" >&2; exit 1; }
begin() { step="$1" begun="$(date +%s.%N)"; }
end() { printf '%s: %.1f s\n' "$step" "$(bc <<<"$(date +%s.%N) - $begun")"; }

source "$(dirname "$0")/bare.sh"
# One of the two: each takes the other's place.
programs=("$packages"/splatbus_*.deb); [ -e "${programs[0]}" ] || programs=("$packages"/splatbus-cuda_*.deb)
mkdir "$root/packages"; cp "${programs[0]}" "$packages"/libsplatbus-engine*.deb "$root/packages"
names="$(for deb in "$root"/packages/*.deb; do dpkg-deb -f "$deb" Package; done)"
debs="$(cd "$root" && ls packages/*.deb | sed 's|^|/|')"
within apt-get install -y -qq --no-install-recommends gcc libc6-dev pkg-config bc >/dev/null 2>&1
within apt-get install -y -qq --download-only $debs >/dev/null 2>&1
before="$(cd "$root" && find usr etc opt -xdev | sort)"

begin install; within apt-get install -y -qq $debs >"$root/log" 2>&1 || { cat "$root/log"; fail install; }; end
sed "s|=/usr/bin|=$root/usr/bin|" "$root/usr/lib/systemd/user/splatbus.service" >"$root/packages/splatbus.service"
XDG_RUNTIME_DIR="$root/tmp" systemd-analyze verify --user --man=no "$root/packages/splatbus.service" || fail "the user service"

begin 'first picture of the demo'
within splatbus demo --seconds 600 --out /root/demo >"$root/demo.log" 2>&1 & run=$!
url() { grep -oE 'http://localhost:[0-9]+' "$root/demo.log" | head -1; }
until [ -n "$(url)" ]; do kill -0 "$run" 2>/dev/null || { cat "$root/demo.log"; fail demo; }; sleep 0.1; done
if [ -n "$web" ]; then
  (cd "$web" && node --input-type=module -e "
    import { launch } from './test/browser.mjs';
    const browser = await launch();
    const page = await browser.newPage({ viewport: { width: 640, height: 480 } });
    await page.goto('$(url)');
    await page.waitForFunction(() => window.splatbus?.firstPictureMs > 0, null, { timeout: 120000 });
    if (process.env.PICTURE) await page.screenshot({ path: process.env.PICTURE });
    await browser.close();") || fail "no picture"
else
  until curl -sf "$(url)/status" | grep -q '"gaussians":[1-9]'; do sleep 0.1; done
fi
end
kill "$run"; wait "$run" || true; run=

begin 'an engine'
within sh -c 'cd /tmp && cc -Wall -Wextra -Werror -o engine $(find /usr/share/doc/libsplatbus-engine-dev -name engine_c.c) \
  $(pkg-config --cflags --libs splatbus-engine) -lm && timeout 2 ./engine; [ $? = 124 ]' || fail "the example engine"
end

begin purge
within apt-get purge -y -qq $names >"$root/log" 2>&1 || { cat "$root/log"; fail purge; }
end
[ -z "$(comm -12 <(sort <<<"$names") <(within dpkg-query -W -f '${Package}\n' | sort))" ] || fail "packages are left"
left="$(cd "$root" && comm -13 <(echo "$before") <(find usr etc opt -xdev | sort) | grep -i splatbus || true)"
[ -z "$left" ] || fail "files are left: $left"
echo "nothing of it is left"
