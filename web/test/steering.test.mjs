// How a person steers the page: by keys, mouse, fingers and gamepad.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { goal, kPage, kStart, opened, reaches } from './opened_page.mjs';
import { readPng } from './png.mjs';

test('keys fly and turn, F shows all', () =>
  opened(kPage, async (page) => {
    const held = async (key, until) => {
      await page.keyboard.down(key);
      await page.waitForFunction(until);
      await page.keyboard.up(key);
    };
    await held('w', () => Math.hypot(window.splatbus.rig.goal.target[0], window.splatbus.rig.goal.target[2]) > 0.2);
    const ahead = await goal(page);
    // Towards where the camera looks, on the level.
    assert.ok(Math.abs(Math.atan2(-ahead.target[2], -ahead.target[0]) - kStart.yaw) < 1e-6);
    assert.equal(ahead.target[1], 0);
    await held('e', () => window.splatbus.rig.goal.target[1] > 0.1);
    await held('ArrowRight', () => window.splatbus.rig.goal.yaw > 1.1);
    const before = await goal(page);
    await held('d', () => window.splatbus.rig.goal.target[0] > 0);
    assert.equal((await goal(page)).distance, before.distance);
    await page.keyboard.press('f');
    await page.waitForFunction((distance) => window.splatbus.rig.goal.distance !== distance, before.distance);
    const all = await goal(page);
    assert.ok(Math.hypot(...all.target) < 1, `the middle of all is ${all.target}`);
    assert.ok(all.distance > 3 && all.distance < 8, `all is seen from ${all.distance} m`);
  }));

test('the mouse orbits, pans and zooms', () =>
  opened(kPage, async (page) => {
    await page.mouse.move(160, 100);
    await page.mouse.down();
    await page.mouse.move(210, 80, { steps: 4 });
    await page.mouse.up();
    await reaches(page, { yaw: kStart.yaw + 50 * 0.006, pitch: kStart.pitch - 20 * 0.006 });
    await page.mouse.down({ button: 'right' });
    await page.mouse.move(180, 80);
    await page.mouse.up({ button: 'right' });
    // 30 pixels to the left at the target's distance.
    const metres = (30 * kStart.distance) / (200 / (2 * Math.tan(Math.PI / 6)));
    await page.waitForFunction((far) => Math.abs(Math.hypot(...window.splatbus.rig.goal.target) - far) < 1e-6, metres);
    await page.mouse.wheel(0, -100);
    await reaches(page, { distance: 3.6 });
  }));

/** Sends touches of fingers at points of the page. */
async function fingers(page) {
  const session = await page.context().newCDPSession(page);
  return (type, ...points) =>
    session.send('Input.dispatchTouchEvent', { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
}

test('one finger orbits, two pinch and pan, a stick moves', () =>
  opened(
    kPage,
    async (page) => {
      const touch = await fingers(page);
      await touch('touchStart', [160, 100]);
      await touch('touchMove', [180, 110]);
      await touch('touchEnd');
      await reaches(page, { yaw: kStart.yaw + 20 * 0.006 });
      await touch('touchStart', [200, 100], [240, 100]);
      await touch('touchMove', [180, 100], [260, 100]);
      await touch('touchEnd');
      // Twice as far apart.
      await reaches(page, { distance: 2 });
      const pinched = await goal(page);
      assert.ok(Math.hypot(...pinched.target) < 0.1, 'a pinch about the middle does not pan');
      const stick = await page.locator('.stick').boundingBox();
      const middle = [stick.x + stick.width / 2, stick.y + stick.height / 2];
      await touch('touchStart', middle);
      await touch('touchMove', [middle[0], middle[1] - 60]);
      await page.waitForFunction((x) => Math.abs(window.splatbus.rig.goal.target[0] - x) > 0.1, pinched.target[0]);
      await touch('touchEnd');
      const flown = await goal(page);
      const [dx, , dz] = flown.target.map((value, k) => value - pinched.target[k]);
      assert.ok(Math.abs(Math.atan2(-dz, -dx) - flown.yaw) < 1e-6);
    },
    { hasTouch: true },
  ));

test('two fingers pan, and pinch while they do', () =>
  opened(
    kPage,
    async (page) => {
      const touch = await fingers(page);
      const metresAPixel = kStart.distance / (200 / (2 * Math.tan(Math.PI / 6)));
      await touch('touchStart', [140, 90], [180, 110]);
      // What is under the fingers follows them: the camera goes the other way, to its left.
      await touch('touchMove', [170, 90], [210, 110]);
      const right = [Math.sin(kStart.yaw), 0, -Math.cos(kStart.yaw)];
      await page.waitForFunction(
        (wanted) => Math.hypot(...window.splatbus.rig.goal.target.map((value, k) => value - wanted[k])) < 1e-6,
        right.map((value) => -30 * metresAPixel * value),
      );
      await reaches(page, { distance: kStart.distance, yaw: kStart.yaw, pitch: kStart.pitch });
      // Half as far apart, and 15 pixels back.
      await touch('touchMove', [165, 95], [185, 105]);
      await touch('touchEnd');
      await reaches(page, { distance: 2 * kStart.distance, yaw: kStart.yaw });
      const { target } = await goal(page);
      assert.ok(Math.abs(Math.hypot(...target) - 15 * metresAPixel) < 1e-6, `${target}`);
    },
    { hasTouch: true },
  ));

test('V and the menu fill the screen, and leave it again', () =>
  opened(kPage, async (page) => {
    const filled = (is) => page.waitForFunction((wanted) => (document.fullscreenElement === document.documentElement) === wanted, is);
    await page.keyboard.press('v');
    await filled(true);
    // The picture is as large as what it fills.
    await page.waitForFunction(() => document.querySelector('.stage canvas').width === Math.round(innerWidth * devicePixelRatio));
    await page.keyboard.press('v');
    await filled(false);
    await page.keyboard.press('m');
    await page.getByRole('button', { name: 'Full screen' }).click();
    await filled(true);
  }));

test('all of the page is reached and used by Tab alone', () =>
  opened(kPage, async (page) => {
    /** What has the focus, by the name that is read out, and whether a person sees that. */
    const focused = () =>
      page.evaluate(() => {
        const element = document.activeElement;
        const { top, bottom, left, right, width } = element.getBoundingClientRect();
        const ring = getComputedStyle(element, element.classList.contains('stage') ? '::after' : null);
        return {
          name: element.getAttribute('aria-label') ?? (element.closest('label')?.querySelector('span') ?? element).textContent,
          seen: width > 0 && top >= 0 && left >= 0 && bottom <= innerHeight && right <= innerWidth,
          ringed: element.matches(':focus-visible') && [ring.outlineWidth, ring.borderTopWidth].includes('3px'),
        };
      });
    const tab = async (key = 'Tab') => {
      await page.keyboard.press(key);
      return focused();
    };
    assert.match((await focused()).name, /live scene/, 'the picture has the focus to begin with');
    assert.equal((await tab()).name, 'Menu');
    assert.match((await tab('Shift+Tab')).name, /live scene/);
    assert.ok((await focused()).ringed);
    const [r, g, b] = readPng(await page.screenshot()).rgb.subarray(3 * 320 * 100, 3 * 320 * 100 + 3);
    assert.deepEqual([r, g, b], [0x56, 0xb4, 0xe9], 'the ring is over the picture');
    await tab();
    await page.keyboard.press('Enter');
    const stops = [await focused()];
    while (stops.at(-1).name !== 'Close' && stops.length < 30) stops.push(await tab());
    const kMenu = ['Show all', 'Full screen', 'Save picture', 'Copy link', 'Figures', 'Compare', 'Quality', 'Gaussians at most', 'Mbit/s at most', 'Background'];
    assert.deepEqual(stops.map(({ name }) => name), [...kMenu, '.ply', '.glb', '.spz', 'Close']);
    for (const stop of stops) assert.ok(stop.seen && stop.ringed, JSON.stringify(stop));

    const back = async (name) => {
      while ((await tab('Shift+Tab')).name !== name);
    };
    await back('Quality');
    await page.keyboard.press('ArrowDown');
    await page.waitForFunction(() => JSON.parse(localStorage.getItem('splatbus.settings') ?? '{}').quality === 'full');
    assert.equal((await goal(page)).yaw, kStart.yaw, 'what chooses does not turn the camera');
    await back('Figures');
    const hidden = () => page.evaluate(() => document.querySelector('.figures').hidden);
    const before = await hidden();
    await page.keyboard.press('Space');
    assert.equal(await hidden(), !before);
    await back('Show all');
    await page.keyboard.press('Enter');
    await page.waitForFunction((distance) => window.splatbus.rig.goal.distance !== distance, kStart.distance);
    await page.keyboard.press('Escape');
    await page.getByRole('dialog').waitFor({ state: 'hidden' });
    assert.equal((await focused()).name, 'Menu', 'the focus is where it was before');
  }));

test('a gamepad flies, turns and shows all', () =>
  opened(kPage, async (page) => {
    const pad = (axes, pressed = false, others = {}) =>
      page.evaluate(
        ([values, held]) => {
          const buttons = Array.from({ length: 16 }, (_, index) => ({ value: held[index] ?? 0 }));
          navigator.getGamepads = () => [{ connected: true, axes: values, buttons }];
        },
        [axes, { 0: Number(pressed), ...others }],
      );
    await pad([0.05, -1, 0, 0]); // what a stick at rest says of itself does not count
    await page.waitForFunction(() => Math.hypot(window.splatbus.rig.goal.target[0], window.splatbus.rig.goal.target[2]) > 0.2);
    const ahead = await goal(page);
    assert.ok(Math.abs(Math.atan2(-ahead.target[2], -ahead.target[0]) - kStart.yaw) < 1e-6);
    await pad([0, 0, 1, 0]);
    await page.waitForFunction((yaw) => window.splatbus.rig.goal.yaw > yaw + 0.05, kStart.yaw);
    await pad([0, 0, 0, -1]);
    await page.waitForFunction((pitch) => window.splatbus.rig.goal.pitch < pitch - 0.05, kStart.pitch); // it looks up
    await pad([0, 0, 0, 0], false, { 7: 1 });
    await page.waitForFunction((y) => window.splatbus.rig.goal.target[1] > y + 0.1, (await goal(page)).target[1]);
    await pad([0, 0, 0, 0], true);
    await page.waitForFunction(() => window.splatbus.rig.goal.distance > 4.01);
  }));

test('G follows the player where there is one, until somebody steers', () =>
  opened(kPage, async (page) => {
    const says = (text) => page.waitForFunction((part) => document.querySelector('.notice').textContent.includes(part), text);
    await page.keyboard.press('g');
    await says('no player');
    assert.deepEqual(await goal(page), kStart);
    await page.keyboard.press('m');
    const entry = page.getByRole('button', { name: 'Follow the player' });
    assert.equal(await entry.isVisible(), false);
    // From (0, 1, 3) along -z, then along -x and down.
    const player = (camera) => page.evaluate((transform) => new BroadcastChannel('player').postMessage(transform), camera);
    await player([1, 0, 0, 0, 0, -1, 0, 1, 0, 0, -1, 3]);
    await entry.click();
    await says('Following');
    const stands = (eye, yaw, pitch) =>
      page.waitForFunction(
        ([[x, y, z], wantedYaw, wantedPitch]) => {
          const { target, yaw, pitch, distance } = window.splatbus.rig.shown;
          const at = [target[0] + distance * Math.cos(pitch) * Math.cos(yaw), target[1] + distance * Math.sin(pitch), target[2] + distance * Math.cos(pitch) * Math.sin(yaw)];
          const off = Math.hypot(at[0] - x, at[1] - y, at[2] - z) + Math.abs(Math.sin((yaw - wantedYaw) / 2)) + Math.abs(pitch - wantedPitch);
          return off < 1e-4;
        },
        [eye, yaw, pitch],
      );
    await stands([0, 1, 3], Math.PI / 2, 0);
    const [c, s] = [Math.cos(0.3), Math.sin(0.3)];
    await player([0, s, -c, 2, 0, -c, -s, 1.5, -1, 0, 0, 0]);
    await stands([2, 1.5, 0], 0, 0.3);
    await page.waitForFunction(() => document.querySelector('[aria-pressed]').getAttribute('aria-pressed') === 'true');
    await page.keyboard.press('Escape');
    await page.mouse.move(160, 100);
    await page.mouse.wheel(0, -100);
    await page.waitForFunction((distance) => window.splatbus.rig.goal.distance < distance, kStart.distance);
    await page.waitForFunction(() => document.querySelector('[aria-pressed]').getAttribute('aria-pressed') === 'false');
    const left = await goal(page);
    await player([1, 0, 0, 0, 0, -1, 0, 1, 0, 0, -1, 3]);
    await page.waitForFunction(() => window.splatbus.stage.scene.transforms.at(-1) === 3);
    assert.deepEqual(await goal(page), left);
    await player(null);
    await page.waitForFunction(() => document.querySelector('[aria-pressed]').hidden);
  }));
