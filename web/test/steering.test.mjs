// How a person steers the page: by keys, mouse, fingers and gamepad.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { goal, kPage, kStart, opened, reaches } from './opened_page.mjs';

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

test('one finger orbits, two pinch and pan, a stick moves', () =>
  opened(
    kPage,
    async (page) => {
      const session = await page.context().newCDPSession(page);
      const touch = (type, ...points) =>
        session.send('Input.dispatchTouchEvent', { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
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

test('a gamepad flies, turns and shows all', () =>
  opened(kPage, async (page) => {
    const pad = (axes, pressed = false) =>
      page.evaluate(
        ([values, value]) => {
          const buttons = Array.from({ length: 16 }, (_, index) => ({ value: index === 0 ? value : 0 }));
          navigator.getGamepads = () => [{ connected: true, axes: values, buttons }];
        },
        [axes, Number(pressed)],
      );
    await pad([0.05, -1, 0, 0]); // what a stick at rest says of itself does not count
    await page.waitForFunction(() => Math.hypot(window.splatbus.rig.goal.target[0], window.splatbus.rig.goal.target[2]) > 0.2);
    const ahead = await goal(page);
    assert.ok(Math.abs(Math.atan2(-ahead.target[2], -ahead.target[0]) - kStart.yaw) < 1e-6);
    await pad([0, 0, 1, 0]);
    await page.waitForFunction((yaw) => window.splatbus.rig.goal.yaw > yaw + 0.05, kStart.yaw);
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
