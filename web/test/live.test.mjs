// The page before a real pipeline: compared with the engine, together with others, and while services are killed.
import assert from 'node:assert/strict';
import { spawn } from 'node:child_process';
import { mkdtempSync, rmSync, writeFileSync } from 'node:fs';
import { createServer } from 'node:net';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { launch } from './browser.mjs';

const { SPLATBUS_WEB: site, SPLATBUS_BIN: bin } = process.env;
let browser;
let pipeline;
let folder;
let url;
let page;
const asked = [];
const errors = [];

/** A port that nobody listens on now. */
const freePort = () =>
  new Promise((resolve) => {
    const server = createServer().listen(0, '127.0.0.1', () => {
      const { port } = server.address();
      server.close(() => resolve(port));
    });
  });

const launchFile = (port) => `
services:
  - name: bus
  - name: engine
    program: splatbus-engine-sim
    args: [--dynamics, --sun-rate, "6"]
  - name: capture-bridge
    parameters: {input_cameras: 8, input_size: 64, sample_budget: 6000, reference_rig: ring, reference_cameras: 4, reference_size: 64, reference_rate_hz: 1}
  - name: expander
  - name: trainer
  - name: relight
  - name: streamer
  - name: gateway
    parameters: {http: "127.0.0.1:${port}", web_root: "${site}"}
`;

before(async () => {
  folder = mkdtempSync(join(tmpdir(), 'splatbus-live-'));
  const port = await freePort();
  url = `http://127.0.0.1:${port}`;
  writeFileSync(join(folder, 'live.yaml'), launchFile(port));
  pipeline = spawn(join(bin, 'splatbus'), ['launch', join(folder, 'live.yaml'), '--bus', `ipc://${folder}/bus`], { stdio: 'ignore' });
  await answering();
  browser = await launch();
  page = await browser.newPage({ viewport: { width: 320, height: 200 } });
  page.setDefaultTimeout(90_000);
  page.on('request', (request) => asked.push(request.url()));
  page.on('pageerror', (error) => errors.push(String(error)));
});
after(async () => {
  await browser?.close();
  if (pipeline) {
    const ended = new Promise((resolve) => pipeline.once('exit', resolve));
    pipeline.kill('SIGINT');
    await ended;
  }
  rmSync(folder, { recursive: true, force: true });
});

const status = async () => (await fetch(`${url}/status`)).json();
/** Waits for the gateway. */
async function answering() {
  for (;;) {
    try {
      return await status();
    } catch {
      await new Promise((resolve) => setTimeout(resolve, 50));
    }
  }
}
const serviceOf = async (source) => (await answering()).services.find((one) => one.source === source);
/** Kills it, and waits until another one lives. */
async function restarted(source) {
  const { pid } = await serviceOf(source);
  process.kill(pid, 'SIGKILL');
  await until(async () => {
    const service = await serviceOf(source);
    return service && service.pid !== pid && service.alive;
  });
}
async function until(condition) {
  while (!(await condition())) await new Promise((resolve) => setTimeout(resolve, 50));
}
const figures = () => page.evaluate(() => window.splatbus.figures);
/** Waits for what the figures say; at no time may the picture be gone. The site's policy lets no page make functions. */
const standsUntil = (condition, before) =>
  page.waitForFunction(
    new Function(
      'then',
      `const { stage, figures } = window.splatbus;
      if (!stage.standing || figures.gaussians < 1000) throw new Error('the picture is gone');
      return (${condition})(figures, then);`,
    ),
    before,
  );

test('a scene that is made while it is watched', async () => {
  await page.goto(url);
  await page.waitForFunction(() => window.splatbus?.stage.standing && window.splatbus.figures.gaussians > 1000);
  assert.deepEqual(asked.filter((one) => !one.startsWith(url) && !one.startsWith('blob:')), [], 'nothing is loaded from elsewhere');
  const { sequence } = await figures();
  await page.waitForFunction((before) => window.splatbus.figures.sequence > before, sequence);
  await page.waitForFunction(() => window.splatbus.figures.roundTripMs > 0);
});

test('the engine\'s own picture is compared with the splats', async () => {
  await page.keyboard.press('c');
  await page.waitForFunction(() => window.splatbus.comparison.quality);
  const { ssim, flip } = await page.evaluate(() => window.splatbus.comparison.quality);
  // A young model of a toy scene; another view, or one upside down, is below 0.5.
  assert.ok(ssim > 0.7 && flip < 0.3, `SSIM ${ssim}, FLIP ${flip}`);
  await page.keyboard.press('c');
});

test('twenty pages at once', async () => {
  // Twenty of a page's stream workers: twenty tabs that draw by software take a machine of two cores minutes.
  const rows = await page.evaluate(async () => {
    const follow = () =>
      new Promise((resolve, reject) => {
        const worker = new Worker('stream_worker.js', { type: 'module' });
        const { port1, port2 } = new MessageChannel();
        let rows = 0;
        port1.onmessage = ({ data }) => {
          rows += data.update.rows.length;
          worker.postMessage({ kind: 'taken', batches: 1 });
        };
        worker.onerror = () => reject(new Error('a worker died'));
        worker.onmessage = ({ data }) => {
          if (data.kind !== 'figures') return;
          const { gaussians, missing } = data.figures;
          if (gaussians < 1000 || missing > 0 || rows < gaussians / 2) return;
          worker.terminate();
          resolve(rows);
        };
        const socket = new URL('stream', location.href.replace('http', 'ws')).href;
        worker.postMessage({ kind: 'start', socket, token: null, clockOriginMs: performance.timeOrigin, budget: { gaussians: 1e6 } });
        worker.postMessage({ kind: 'attach', port: port2, standing: false }, [port2]);
      });
    return Promise.all(Array.from({ length: 20 }, follow));
  });
  assert.equal(rows.length, 20);
  // The twenty-first has gone on.
  await standsUntil((now, then) => now.sequence > then, (await figures()).sequence);
});

test('the gateway is killed: the picture stands, and the stream goes on', async () => {
  await restarted('gateway');
  const { bytes } = await figures();
  await standsUntil((now, then) => window.splatbus.connection === 'open' && now.bytes > then && now.missing === 0, bytes);
});

test('the streamer is killed: the picture stands until another has a whole one', async () => {
  const { epoch } = await figures();
  await restarted('streamer');
  await standsUntil((now, then) => now.epoch !== then && now.missing === 0, epoch);
  await standsUntil((now, then) => now.sequence > then, (await figures()).sequence);
});

test('the trainer is killed: the picture stands, and what another makes of it arrives', async () => {
  await restarted('trainer');
  const { version } = (await status()).stream;
  await until(async () => (await status()).stream?.version > version);
  await standsUntil((now, then) => now.sequence > then && now.missing === 0, (await figures()).sequence);
});

test('the engine is killed: the picture stands, and lives again with another', async () => {
  await restarted('engine');
  await standsUntil((now, then) => now.sceneVersion > then && now.missing === 0, (await figures()).sceneVersion);
  assert.deepEqual(errors, []);
});
