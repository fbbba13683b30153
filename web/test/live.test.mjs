// The page before a real pipeline: compared with the engine, together with others, and while services are killed.
import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { browserProcesses, filmed, launch } from './browser.mjs';
import { startPipeline, until } from './pipeline.mjs';
import { colorsIn, readPng } from './png.mjs';
import { letTrap, trapIn } from './trapping.mjs';

const kCapture = { input_cameras: 8, input_size: 64, sample_budget: 6000, reference_cameras: 4, reference_size: 64, reference_rate_hz: 1 };
/** Of the page's 320 x 200 pixels, those that no words cover. */
const kMiddle = { x: 60, y: 40, width: 200, height: 80 };
let browser;
let pipeline;
let page;
const asked = [];
const errors = [];

before(async () => {
  pipeline = await startPipeline(kCapture);
  browser = await launch();
  // A script that a test has added to comes from nowhere, for the browser, and may otherwise not speak to this machine.
  page = await browser.newPage({ viewport: { width: 320, height: 200 }, permissions: ['local-network-access'] });
  page.setDefaultTimeout(90_000);
  page.on('request', (request) => asked.push(request.url()));
  page.on('pageerror', (error) => errors.push(String(error)));
  await letTrap(page, 'stream_worker.js');
});
after(async () => {
  await browser?.close();
  await pipeline?.close();
});

const figures = () => page.evaluate(() => window.splatbus.figures);
/** Waits for what the figures say. The site's policy lets no page make functions. */
const saidThat = (condition, before) =>
  page.waitForFunction(new Function('then', `return (${condition})(window.splatbus.figures, then);`), before);
/** Films what becomes of the page meanwhile: at no time may the picture be gone. */
async function standsWhile(act) {
  const film = await filmed(page);
  await act();
  const colors = (await film()).map((picture) => colorsIn(readPng(picture), kMiddle));
  assert.ok(Math.min(...colors) > 0.5 * colors[0], `${colors} colors`);
}

test('a scene that is made while it is watched', async () => {
  await page.goto(pipeline.url);
  await page.waitForFunction(() => window.splatbus?.stage.standing && window.splatbus.figures?.gaussians > 1000);
  assert.deepEqual(asked.filter((one) => !one.startsWith(pipeline.url) && !one.startsWith('blob:')), [], 'nothing is loaded from elsewhere');
  const { sequence } = await figures();
  await page.waitForFunction((before) => window.splatbus.figures.sequence > before, sequence);
  await page.waitForFunction(() => window.splatbus.figures.roundTripMs > 0);
});

test('a trace shows a frame on its way to the page', async () => {
  const file = join(pipeline.folder, 'trace.json');
  await pipeline.verb('trace', '--seconds', '2', '-o', file);
  const { traceEvents } = JSON.parse(readFileSync(file, 'utf8'));
  const nameOf = new Map(traceEvents.filter((one) => one.name === 'process_name').map((one) => [one.pid, one.args.name]));
  const done = traceEvents.filter((one) => one.ph === 'X').map((one) => ({ ...one, by: nameOf.get(one.pid) }));
  const relayed = done.filter((one) => one.by === 'gateway' && one.args?.capture_ns);
  assert.ok(relayed.length > 0, `${[...new Set(done.map((one) => `${one.by}: ${one.name}`))]}`);
  // Each scene goes out of the capture-bridge, through the streamer and to the page, in this order.
  const hasWholeWay = relayed.some((last) => {
    const begun = ['capture-bridge', 'streamer'].map((by) => done.find((one) => one.by === by && one.args?.capture_ns === last.args.capture_ns)?.ts);
    return begun[0] <= begun[1] && begun[1] <= last.ts;
  });
  assert.ok(hasWholeWay);
});

test('the engine\'s own picture is compared with the splats', async () => {
  await page.keyboard.press('c');
  await page.waitForFunction(() => window.splatbus.extras.comparison.quality);
  const { ssim, flip } = await page.evaluate(() => window.splatbus.extras.comparison.quality);
  // A young model of a toy scene; another view, or one upside down, is below 0.5.
  assert.ok(ssim > 0.7 && flip < 0.3, `SSIM ${ssim}, FLIP ${flip}`);
  await page.keyboard.press('c');
});

test('twenty pages at once', async () => {
  // Twenty of a page's stream workers: twenty tabs that draw by software take a machine of two cores minutes.
  const followed = (count) => page.evaluate(async (count) => {
    const follow = () =>
      new Promise((resolve, reject) => {
        const worker = new Worker('stream_worker.js', { type: 'module' });
        const { port1, port2 } = new MessageChannel();
        let rows = 0;
        let last = null; // figures
        let after = null; // message
        let [openedMs, wholeMs] = [Infinity, Infinity]; // after the figures before
        port1.onmessage = ({ data }) => {
          rows += data.update.rows.length;
          worker.postMessage({ kind: 'taken', batches: 1 });
        };
        worker.onerror = () => reject(new Error('a worker died'));
        worker.onmessage = ({ data }) => {
          const before = after;
          after = data.kind;
          if (data.kind === 'failed') reject(new Error(`a worker failed: ${JSON.stringify(data)}`));
          if (data.kind !== 'figures') return;
          const { gaussians, missing, epoch, atMs } = data.figures;
          if (last && before === 'connection' && missing < 0 && epoch === last.epoch) openedMs = Math.min(openedMs, atMs - last.atMs);
          if (last && gaussians > 0 && missing === 0 && last.missing !== 0) wholeMs = Math.min(wholeMs, atMs - last.atMs);
          last = data.figures;
          if (gaussians < 1000 || missing > 0 || rows < gaussians / 2) return;
          worker.terminate();
          resolve({ rows, openedMs, wholeMs });
        };
        const socket = new URL('stream', location.href.replace('http', 'ws')).href;
        worker.postMessage({ kind: 'start', socket, token: null, clockOriginMs: performance.timeOrigin, budget: { gaussians: 1e6 } });
        worker.postMessage({ kind: 'attach', port: port2, shown: 0 }, [port2]);
      });
    return Promise.all(Array.from({ length: count }, follow));
  }, count);
  const all = await followed(20);
  assert.equal(all.length, 20);
  // What is said now and then comes 250 ms after the last at least. A busy machine may be slower than that, but not each time.
  for (const news of ['openedMs', 'wholeMs']) {
    for (let more = 0; more < 20 && !all.some((one) => one[news] < 250); ++more) all.push(...(await followed(1)));
    assert.ok(all.some((one) => one[news] < 250), `it is said at once: ${news} ${all.map((one) => one[news])}`);
  }
  // The twenty-first has gone on.
  await saidThat((now, then) => now.sequence > then, (await figures()).sequence);
});

test('a page that stops reading harms none, and goes on when it reads again', async () => {
  const before = browserProcesses();
  const other = await launch();
  let stopped = [];
  const signal = (name) => [...browserProcesses()].filter((pid) => stopped.includes(pid)).forEach((pid) => process.kill(pid, name));
  try {
    const theirs = await other.newPage({ viewport: { width: 320, height: 200 } });
    theirs.setDefaultTimeout(60_000);
    await theirs.goto(pipeline.url);
    await theirs.waitForFunction(() => window.splatbus?.figures?.gaussians > 1000 && window.splatbus.figures.missing === 0);
    const heard = await theirs.evaluate(() => window.splatbus.figures.sequence);
    stopped = [...browserProcesses()].filter((pid) => !before.has(pid));
    signal('SIGSTOP');
    // Some seconds, of which the good page hears as before.
    const { sequence } = await figures();
    await standsWhile(() => saidThat((now, then) => now.sequence > then + 40, sequence));
    signal('SIGCONT');
    await theirs.waitForFunction((then) => window.splatbus.connection === 'open' && window.splatbus.figures.sequence > then && window.splatbus.figures.missing === 0, heard);
  } finally {
    signal('SIGCONT');
    await other.close();
  }
});

test('the gateway is killed: the picture stands, and the stream goes on', () =>
  standsWhile(async () => {
    await pipeline.restarted('gateway');
    const { bytes } = await figures();
    await saidThat((now, then) => window.splatbus.connection === 'open' && now.bytes > then && now.missing === 0, bytes);
  }));

test('the streamer is killed: the picture stands until another has a whole one', () =>
  standsWhile(async () => {
    const { epoch } = await figures();
    await pipeline.restarted('streamer');
    await saidThat((now, then) => now.epoch !== then && now.missing === 0, epoch);
    await saidThat((now, then) => now.sequence > then, (await figures()).sequence);
  }));

test('the trainer is killed: the picture stands, and what another makes of it arrives', () =>
  standsWhile(async () => {
    await pipeline.restarted('trainer');
    // Of the streamer that the test before has put there: the page can have its model before the gateway has its report.
    let version;
    await until(async () => (version = (await pipeline.status()).stream?.version) !== undefined);
    await until(async () => (await pipeline.status()).stream?.version > version);
    await saidThat((now, then) => now.sequence > then && now.missing === 0, (await figures()).sequence);
  }));

test('the engine is killed: the picture stands, and lives again with another', async () => {
  await standsWhile(async () => {
    await pipeline.restarted('engine');
    await saidThat((now, then) => now.sceneVersion > then && now.missing === 0, (await figures()).sceneVersion);
  });
  assert.deepEqual(errors, []);
});

// In what comes through the WebSocket, what the page says, and what it is given.
for (const called of ['receive', 'set_pose', 'take_changes']) {
  test(`a trap in the stream worker's ${called}(): another follows the stream, and the picture stands`, async () => {
    const { bytes } = await figures();
    const trap = await trapIn(page, called);
    await standsWhile(async () => {
      await trap();
      await page.waitForFunction((before) => window.splatbus.figures.bytes < before, bytes); // counted anew
      await page.waitForFunction(() => window.splatbus.connection === 'open' && window.splatbus.figures.gaussians > 1000 && window.splatbus.figures.missing === 0);
      await saidThat((now, then) => now.sequence > then, (await figures()).sequence);
    });
  });
}

test('the traps are all that went wrong', () => {
  assert.ok(errors.every((error) => error === 'RuntimeError: memory access out of bounds'), `${errors}`);
});
