// The page while a stream comes, and when the page goes.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { WebSocketServer } from 'ws';
import { launch, serve } from './browser.mjs';
import { kPage, opened, posted } from './opened_page.mjs';

const kLimit = { timeout: 60_000 };
const kSite = process.env.SPLATBUS_WEB ?? '../build/release/share/splatbus/web';
/** There is room for a part of the scene; the rest never comes. */
const roomFor = (count) => (page) =>
  page.addInitScript((gaussians) => localStorage.setItem('splatbus.settings', JSON.stringify({ budget: { gaussians } })), count);

/** Fewer pictures a second than are wanted: without a flight they would become coarser. */
function slowTurns() {
  const turn = () => {
    requestAnimationFrame(turn);
    for (const begun = performance.now(); performance.now() - begun < 30; );
  };
  turn();
}

test('a flight begins though the rest of the scene never comes, at one resolution, and says what it waits for', kLimit, () =>
  opened(
    kPage.replace('#', '?bench=1&seconds=3#'),
    async (page) => {
      await page.waitForFunction(() => document.querySelector('.notice').textContent.includes('missing: 7 pages'));
      await page.waitForFunction(() => document.body.dataset.bench);
      const { body } = posted.at(-1);
      const report = JSON.parse(body);
      assert.equal(report.gaussians, 2000);
      assert.ok(report.frames > 3, body);
      assert.deepEqual(report.resolutions, [1], body);
    },
    { before: roomFor(2000), init: slowTurns },
  ));

test('a flight of a quality that somebody has chosen, and changes, is reported with both', kLimit, () =>
  opened(
    kPage.replace('#', '?bench=1&seconds=4#'),
    async (page) => {
      await page.waitForFunction(() => document.querySelector('.notice').textContent.startsWith('Measuring'));
      await page.evaluate(() => new Promise((resolve) => setTimeout(resolve, 1000)));
      await page.keyboard.press('m');
      await page.getByLabel('Quality').selectOption('low');
      await page.waitForFunction(() => document.body.dataset.bench);
      assert.deepEqual(JSON.parse(posted.at(-1).body).resolutions, [0.75, 0.35]);
    },
    { init: () => localStorage.setItem('splatbus.settings', JSON.stringify({ quality: 'high' })) },
  ));

test('what is framed first grows with the scene, smoothly, until somebody steers', kLimit, () =>
  opened(
    'index.html',
    async (page) => {
      await page.waitForFunction(() => window.splatbus.rig.goal.distance !== 4.3 && window.splatbus.rig.shown === window.splatbus.rig.goal);
      const seen = await page.evaluate(async () => {
        const { link, rig, figures } = window.splatbus;
        const { send } = link;
        let asked = 0;
        link.send = (message, transfer) => {
          if (message.kind === 'bounds') ++asked;
          else if (message.kind !== 'pose') send.call(link, message, transfer); // figures are the test's now
        };
        const come = async (gaussians) => {
          await new Promise((resolve) => setTimeout(resolve, 600)); // it does not ask more often
          link.onMessage({ kind: 'figures', figures: { ...figures, gaussians } });
        };
        const turn = () => new Promise(requestAnimationFrame);
        await come(2500);
        const askedAgain = asked;
        const before = rig.shown.target[0];
        await turn(); // however long a turn takes here, the camera has not been moved for since then
        const begun = performance.now();
        link.onMessage({ kind: 'bounds', centre: [10, 0, 0], radius: 20 });
        let halfMs = 0;
        for (let k = 0; k < 2000 && Math.abs(rig.shown.target[0] - 10) > 0.05; ++k) {
          await turn();
          if (halfMs === 0 && rig.shown.target[0] > 5) halfMs = performance.now() - begun;
        }
        const reached = rig.shown.target[0];
        // Not what somebody asked for by a key, which comes at once; and nothing more of its own accord.
        rig.orbit(0.1, 0);
        await turn();
        await turn();
        await come(2600);
        return { askedAgain, before, halfMs, reached, asked };
      });
      assert.equal(seen.askedAgain, 1);
      assert.ok(Math.abs(seen.before) < 1, `${seen.before}`);
      assert.ok(Math.abs(seen.reached - 10) <= 0.05, `${seen.reached}`);
      // A key's way is at its half after 40 ms.
      assert.ok(seen.halfMs > 120, `half of the way in ${seen.halfMs} ms`);
      assert.equal(seen.asked, 1, 'who has steered stays where they are');
    },
    { before: roomFor(2000) },
  ));

test('the age of a picture is that of the scene that it shows', kLimit, () =>
  opened(kPage, async (page) => {
    const age = () => page.evaluate(() => Number.parseFloat(document.querySelector('[data-figure=age]').textContent));
    assert.equal(await age(), 5, 'without a clock that is known it is since the last scene came');
    // An engine whose clock is far ahead, of which two scenes come 40 ms after one another; then none.
    const { shown, since } = await page.evaluate(async () => {
      const light = new BroadcastChannel('light');
      const first = performance.now();
      light.postMessage({ ms: 1e6, arrivedMs: first, part: 0.4 });
      await new Promise((resolve) => setTimeout(resolve, 40));
      light.postMessage({ ms: 1e6 + 40, arrivedMs: first + 40, part: 0.5 });
      await new Promise((resolve) => setTimeout(resolve, 1000));
      const figure = document.querySelector('[data-figure=age]');
      const { textContent } = figure;
      while (figure.textContent === textContent) await new Promise(requestAnimationFrame);
      return { shown: Number.parseFloat(figure.textContent), since: performance.now() - (first + 40) };
    });
    // What is seen rests a tenth of a second beyond the last scene. The figure is of the turn of the display that has just been.
    assert.ok(shown > since - 100 - 300 && shown < since + 50, `${shown} ms, ${since} ms since the last scene`);
  }));

test('a page that goes says goodbye', kLimit, async () => {
  const site = await serve([kSite]);
  const sockets = new WebSocketServer({ server: site.server, path: '/stream', handleProtocols: () => 'splatbus.stream.1' });
  const browser = await launch();
  try {
    const said = [];
    const connected = new Promise((resolve) => sockets.once('connection', resolve));
    const page = await browser.newPage({ viewport: { width: 200, height: 100 } });
    await page.goto(`${site.url}/index.html?gpu=webgl2`);
    const socket = await connected;
    const closed = new Promise((resolve) => socket.once('close', resolve));
    const greeted = new Promise((resolve) => socket.once('message', resolve));
    socket.on('message', (message) => said.push(message));
    await greeted;
    assert.ok(!said.some((message) => message.includes('the viewer ends')));
    await page.goto('about:blank');
    await closed;
    assert.ok(said.at(-1).includes('the viewer ends'), `the last of ${said.length} is ${said.at(-1)}`);
    // Who comes back to it is shown the stream again.
    const again = new Promise((resolve) => sockets.once('connection', resolve));
    await page.goBack();
    await again;
  } finally {
    await browser.close();
    sockets.close();
    site.close();
  }
});
