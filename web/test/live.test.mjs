// The page before a real pipeline: what it shows when the gateway and the streamer are killed.
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
const killed = async (source) => {
  const service = (await answering()).services.find((one) => one.source === source);
  process.kill(service.pid, 'SIGKILL');
};
const figures = () => page.evaluate(() => window.splatbus.figures);

test('a scene that is made while it is watched', async () => {
  await page.goto(url);
  await page.waitForFunction(() => window.splatbus?.stage.standing && window.splatbus.figures.gaussians > 1000);
  assert.deepEqual(asked.filter((one) => !one.startsWith(url) && !one.startsWith('blob:')), [], 'nothing is loaded from elsewhere');
  const { sequence } = await figures();
  await page.waitForFunction((before) => window.splatbus.figures.sequence > before, sequence);
  await page.waitForFunction(() => window.splatbus.figures.roundTripMs > 0);
});

test('the gateway is killed: the picture stands, and the stream goes on', async () => {
  const { bytes } = await figures();
  await killed('gateway');
  await page.waitForFunction(() => window.splatbus.connection === 'waiting');
  assert.ok(await page.evaluate(() => window.splatbus.stage.standing && window.splatbus.figures.gaussians > 1000));
  await page.waitForFunction((before) => window.splatbus.connection === 'open' && window.splatbus.figures.bytes > before, bytes);
});

test('the streamer is killed: the picture stands until another has a whole one', async () => {
  const { epoch } = await figures();
  await killed('streamer');
  await page.waitForFunction((before) => {
    if (window.splatbus.figures.gaussians === 0) throw new Error('the picture is gone');
    return window.splatbus.figures.epoch !== before;
  }, epoch);
  const { sequence } = await figures();
  await page.waitForFunction((before) => window.splatbus.figures.sequence > before, sequence);
  assert.deepEqual(errors, []);
});
