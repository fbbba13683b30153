#!/usr/bin/env bash
# bare_source.sh WEB: what a newcomer's first command takes. Clones this project into a bare Debian 12, types `./splatbus demo`
# there, and says after how long the demo names its URL and Chromium and Firefox of this machine show a picture of it. WEB: the
# project's folder web, with its node_modules. Needs root, debootstrap and the network. PICTURES: a folder for screenshots.
set -euo pipefail
web="$(realpath "$1")" project="$(git -C "$(dirname "$0")" rev-parse --show-toplevel)"
source "$(dirname "$0")/bare.sh"
git clone -q "$project" "$root/root/splatbus"

begun="$(date +%s.%N)"
say() { printf '%s: %.0f s\n' "$1" "$(bc <<<"$(date +%s.%N) - $begun")"; }
within sh -c 'cd /root/splatbus && exec ./splatbus demo --seconds 900' >"$root/demo.log" 2>&1 & run=$!
url() { grep -oE 'http://localhost:[0-9]+' "$root/demo.log" | head -1; }
until [ -e "$root/root/splatbus/build" ]; do kill -0 "$run" || { tail -20 "$root/demo.log"; exit 1; }; sleep 0.2; done
say 'packages are there'
until [ -n "$(url)" ]; do kill -0 "$run" || { tail -50 "$root/demo.log"; exit 1; }; sleep 0.2; done
say 'the demo says its URL'
cd "$web"
node --input-type=module -e "
  import { launch } from './test/browser.mjs';
  const browser = await launch();
  const page = await browser.newPage({ viewport: { width: 640, height: 480 } });
  await page.goto('$(url)');
  await page.waitForFunction(() => window.splatbus?.firstPictureMs > 0, null, { timeout: 120000 });
  console.log(\`Chromium, of its own page: \${Math.round(await page.evaluate(() => window.splatbus.firstPictureMs))} ms\`);
  if (process.env.PICTURES) await page.screenshot({ path: process.env.PICTURES + '/chromium.png' });
  await browser.close();"
say 'Chromium shows a picture'
node --input-type=module -e "
  import { writeFileSync } from 'node:fs';
  import { launchFirefox } from './test/firefox.mjs';
  const firefox = await launchFirefox({ width: 640, height: 480 });
  await firefox.goto('$(url)');
  await firefox.waitFor('window.splatbus?.firstPictureMs > 0');
  console.log(\`Firefox, of its own page: \${Math.round(await firefox.evaluate('window.splatbus.firstPictureMs'))} ms\`);
  if (process.env.PICTURES) writeFileSync(process.env.PICTURES + '/firefox.png', await firefox.screenshot());
  await firefox.close();"
say 'Firefox shows a picture, after Chromium'
