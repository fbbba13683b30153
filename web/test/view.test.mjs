// `splatbus view FILE --page`: real processes that bring a file to a real browser, and leave nothing behind.
import assert from 'node:assert/strict';
import { execFileSync, spawn, spawnSync } from 'node:child_process';
import { mkdirSync, mkdtempSync, readFileSync, readdirSync, rmSync, writeFileSync } from 'node:fs';
import { createServer } from 'node:net';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { launch } from './browser.mjs';
import { until } from './pipeline.mjs';
import { readPng } from './png.mjs';

const kProgram = join(process.env.SPLATBUS_BIN, 'splatbus');
const kSize = { width: 320, height: 240 };
/** Of the page's pixels, those that no words cover. */
const kMiddle = { x: 60, y: 60, width: 200, height: 130 };
/** As the address has it, and the eye that looks from there; the ball is one metre in radius, about the origin. */
const kPose = { target: [0, 0, 0], yaw: 0.7, pitch: 0.4, distance: 3 };
const kEye = [Math.cos(0.4) * Math.cos(0.7), Math.sin(0.4), Math.cos(0.4) * Math.sin(0.7)].map((value) => 3 * value);
const kView = `view=${[...kPose.target, kPose.yaw, kPose.pitch, kPose.distance]}`;
const kCount = 4000;

let folder;
let browser;
const file = (name) => join(folder, name);

/** A ball in colors that depend on where one looks from, as 3DGS' own training writes it: without any mark. */
function ballPly(count) {
  const harmonics = Array.from({ length: 9 }, (_, k) => `f_rest_${k}`);
  const names = ['x', 'y', 'z', 'f_dc_0', 'f_dc_1', 'f_dc_2', ...harmonics, 'opacity', 'scale_0', 'scale_1', 'scale_2', 'rot_0', 'rot_1', 'rot_2', 'rot_3'];
  const header = ['ply', 'format binary_little_endian 1.0', `element vertex ${count}`, ...names.map((name) => `property float ${name}`), 'end_header', ''];
  const values = new Float32Array(names.length * count);
  for (let i = 0; i < count; ++i) {
    // Along a spiral, evenly.
    const y = 1 - (2 * i + 1) / count;
    const turn = 2.399963 * i;
    const [x, z] = [Math.sqrt(1 - y * y) * Math.cos(turn), Math.sqrt(1 - y * y) * Math.sin(turn)];
    const color = [2 * Math.sin(5 * x), 2 * Math.cos(4 * y), 2 * Math.sin(6 * z)];
    const rest = harmonics.map((_, k) => 0.3 * Math.sin(k + 3 * x));
    const size = Math.log(i % 2 === 0 ? 0.03 : 0.004); // many are smaller than a pixel
    values.set([x, y, z, ...color, ...rest, i % 5 === 0 ? 0.5 : 6, size, size, size - 0.5, 1, 0.2 * x, 0.1, 0], names.length * i);
  }
  return Buffer.concat([Buffer.from(header.join('\n')), Buffer.from(values.buffer)]);
}

/** What runs with folders for temporary files of its own. */
const environment = () => ({ ...process.env, TMPDIR: file('tmp'), XDG_STATE_HOME: file('state') });

/** What runs in that environment: process id and command line. */
const processes = () =>
  readdirSync('/proc').flatMap((pid) => {
    try {
      const ours = readFileSync(`/proc/${pid}/environ`, 'latin1').includes(`TMPDIR=${file('tmp')}\0`);
      return ours ? [[Number(pid), readFileSync(`/proc/${pid}/cmdline`, 'latin1').split('\0')[0]]] : [];
    } catch {
      return []; // no process, or nobody's
    }
  });

/** Serves a file, until `run` is through. Nothing may be left of it then. */
async function served(name, more, run) {
  const started = spawn(kProgram, ['view', file(name), '--page', '--port', '0', ...more], { stdio: ['ignore', 'pipe', 'pipe'], env: environment() });
  let said = '';
  for (const stream of [started.stdout, started.stderr]) stream.on('data', (text) => (said += text));
  const ended = new Promise((resolve) => started.once('exit', (code, signal) => resolve({ code, signal })));
  try {
    const url = () => /open (\S+) in a browser/.exec(said)?.[1];
    await until(() => url() || started.exitCode !== null);
    assert.ok(url(), said);
    await run(url(), said);
  } finally {
    started.kill('SIGINT');
  }
  assert.deepEqual(await ended, { code: 0, signal: null }, said);
  assert.deepEqual(readdirSync(file('tmp')), []);
  assert.deepEqual(processes(), []);
}

async function opened(url, run) {
  const page = await browser.newPage({ viewport: kSize });
  page.setDefaultTimeout(60_000);
  const errors = [];
  page.on('pageerror', (error) => errors.push(String(error)));
  try {
    await page.goto(url);
    await page.waitForFunction(() => window.splatbus?.stage.standing && window.splatbus.figures?.missing === 0);
    await run(page);
    assert.deepEqual(errors, []);
  } finally {
    await page.close();
  }
}

/** Its picture once nothing fades or moves any more. */
async function pictureOf(page) {
  await page.waitForFunction(() => {
    const { stage, rig } = window.splatbus;
    return rig.shown === rig.goal && !stage.movingAt(performance.now());
  });
  for (let last = null; ; ) {
    const bytes = await page.screenshot();
    if (last?.equals(bytes)) return readPng(bytes);
    last = bytes;
    await page.waitForTimeout(300);
  }
}

/** Of the middle, dB. */
function psnr(a, b) {
  let sum = 0;
  for (let y = kMiddle.y; y < kMiddle.y + kMiddle.height; ++y) {
    for (let k = 3 * kMiddle.x; k < 3 * (kMiddle.x + kMiddle.width); ++k) sum += (a.rgb[3 * kSize.width * y + k] - b.rgb[3 * kSize.width * y + k]) ** 2;
  }
  return 10 * Math.log10((255 ** 2 * 3 * kMiddle.width * kMiddle.height) / sum);
}

/** What the CPU's rasteriser makes of a file from where the page looks. */
function rasterised(name) {
  const out = file(`${name}.png`);
  const size = ['--width', String(kSize.width), '--height', String(kSize.height)];
  execFileSync(kProgram, ['view', file(name), '--out', out, '--backend', 'cpu', ...size, '--eye', kEye.join(), '--target', '0,0,0'], { stdio: 'ignore' });
  return readPng(readFileSync(out));
}

before(async () => {
  folder = mkdtempSync(join(tmpdir(), 'splatbus-view-'));
  mkdirSync(file('tmp'));
  writeFileSync(file('ball.ply'), ballPly(kCount));
  browser = await launch();
});
after(async () => {
  await browser?.close();
  rmSync(folder, { recursive: true, force: true });
});

test('the page shows all of a .ply file as the CPU does, and is whole again when the bus and the streamer have died', () =>
  served('ball.ply', [], async (url, said) => {
    assert.match(said, new RegExp(`ball\\.ply: ${kCount} Gaussians`));
    const truth = rasterised('ball.ply');
    await opened(`${url}/#${kView}`, async (page) => {
      assert.match(page.url(), /\?mip=0#view=/, 'it was trained without the filter');
      assert.equal(await page.evaluate(() => window.splatbus.figures.gaussians), kCount);
      const shown = await pictureOf(page);
      const near = psnr(shown, truth);
      console.log(`${near.toFixed(2)} dB`);
      assert.ok(near > 40, `${near} dB`);

      // The middle of the picture is on the ball, and so is what is orbited from then on.
      await page.mouse.dblclick(kSize.width / 2, kSize.height / 2);
      await page.waitForFunction((before) => Math.abs(window.splatbus.rig.goal.distance - before) > 0.5, kPose.distance);
      const { target, distance } = await page.evaluate(() => window.splatbus.rig.goal);
      assert.ok(Math.abs(Math.hypot(...target) - 1) < 0.05 && Math.abs(distance - 2) < 0.05, `${target}, from ${distance} m`);

      const { epoch } = await page.evaluate(() => window.splatbus.figures);
      const due = processes().filter(([, program]) => /splatbus-(bus|streamer)$/.test(program));
      assert.equal(due.length, 2);
      for (const [pid] of due) process.kill(pid, 'SIGKILL');
      await page.waitForFunction(
        ([before, count]) => {
          const { figures, stage } = window.splatbus;
          if (!stage.standing) throw new Error('the picture is gone');
          return figures.epoch !== before && figures.gaussians === count && figures.missing === 0;
        },
        [epoch, kCount],
      );
    });
    await opened(`${url}/?mip=1#${kView}`, async (page) => {
      const near = psnr(await pictureOf(page), truth);
      assert.ok(near < 35, `${near} dB: the filter makes a difference`);
    });
    const model = Buffer.from(await (await fetch(`${url}/model.ply`)).arrayBuffer()).toString('latin1');
    assert.match(model, new RegExp(`element vertex ${kCount}\n`));
    assert.doesNotMatch(model, /SplatRenderMode/);
  }));

test('a .spz file is seen from where it was asked to be, before the background that was', async () => {
  execFileSync(kProgram, ['export', file('ball.spz'), '--from', file('ball.ply')], { stdio: 'ignore' });
  const place = ['--eye', kEye.map((value) => 2 * value).join(), '--target', '0,0,0', '--background', '0,0.5,0'];
  await served('ball.spz', place, (url) =>
    opened(url, async (page) => {
      const { gaussians, goal } = await page.evaluate(() => ({ gaussians: window.splatbus.figures.gaussians, goal: window.splatbus.rig.goal }));
      assert.equal(gaussians, kCount);
      for (const [key, value] of [['yaw', 0.7], ['pitch', 0.4], ['distance', 6]]) assert.ok(Math.abs(goal[key] - value) < 1e-3, `${key} ${goal[key]}`);
      const { rgb } = await pictureOf(page);
      const at = 3 * (kSize.width * (kMiddle.y + 1) + kMiddle.x + 1);
      assert.deepEqual([...rgb.subarray(at, at + 3)], [0, 188, 0]);
    }),
  );
});

/** Ends by itself: its status, and what it said. */
function fails(...options) {
  const { status, stderr, stdout } = spawnSync(kProgram, ['view', ...options], { encoding: 'utf8', env: environment(), timeout: 60_000 });
  assert.equal(stdout, '');
  assert.deepEqual(readdirSync(file('tmp')), []);
  return { status, stderr };
}

test('what cannot be served is said at once, and nothing is started', async () => {
  writeFileSync(file('garbage.ply'), 'This is no model.');
  writeFileSync(file('empty.ply'), ballPly(0));
  const taken = createServer();
  await new Promise((resolve) => taken.listen(0, '127.0.0.1', resolve));
  try {
    for (const [options, why] of [
      [[file('none.ply')], /none\.ply: cannot be opened/],
      [[file('garbage.ply')], /garbage\.ply: /],
      [[file('empty.ply')], /empty\.ply: no Gaussians to show/],
      [[file('ball.ply'), '--port', String(taken.address().port)], new RegExp(`port ${taken.address().port} is taken`)],
      [[file('ball.ply'), '--port', '0', '--eye', '1,2,3', '--target', '1,2,3'], /--eye and --target are one point/],
    ]) {
      const { status, stderr } = fails('--page', ...options);
      assert.equal(status, 1, stderr);
      assert.match(stderr, why);
    }
    for (const [options, why] of [
      [['--page', '--port', '65536'], /--port/],
      [['--page', '--port', 'http'], /--port/],
      [['--port', '7680'], /--page/],
      [['--page', '--out', file('x.png')], /--out/],
      [['--page', '--fov', '40'], /--fov/],
    ]) {
      const { status, stderr } = fails(file('ball.ply'), ...options);
      assert.equal(status, 2, stderr);
      assert.match(stderr, why);
    }
  } finally {
    taken.close();
  }
});
