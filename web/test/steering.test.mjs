// How a person steers the page: by keys, mouse, fingers and gamepad.
import assert from 'node:assert/strict';
import { resolve } from 'node:path';
import { test } from 'node:test';
import { pathToFileURL } from 'node:url';
import { goal, kPage, kStart, opened, reaches } from './opened_page.mjs';
import { readPng } from './png.mjs';

const kPages = process.env.SPLATBUS_WEB_TESTS ?? '../build/release/web-tests';
const logic = await import(pathToFileURL(resolve(kPages, 'logic.js')));

/** Where the camera looks to begin with. */
const kAhead = [-Math.cos(kStart.pitch) * Math.cos(kStart.yaw), -Math.sin(kStart.pitch), -Math.cos(kStart.pitch) * Math.sin(kStart.yaw)];
const kFocal = 200 / (2 * Math.tan(Math.PI / 6));
const turns = (page) => page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => requestAnimationFrame(done)))));

test('keys fly and turn, F shows all', () =>
  opened(kPage, async (page) => {
    const held = async (key, until) => {
      await page.keyboard.down(key);
      await page.waitForFunction(until);
      await page.keyboard.up(key);
    };
    await held('w', () => Math.hypot(window.splatbus.rig.goal.target[0], window.splatbus.rig.goal.target[2]) > 0.2);
    const ahead = await goal(page);
    const far = Math.hypot(...ahead.target);
    kAhead.forEach((value, k) => assert.ok(Math.abs(ahead.target[k] - far * value) < 1e-6, `${ahead.target}`));
    await held('e', () => window.splatbus.rig.goal.target[1] > 0.1);
    const above = await goal(page);
    assert.deepEqual([above.target[0], above.target[2]], [ahead.target[0], ahead.target[2]], 'up is the world\'s');
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

test('a trackpad pinches as far as fingers go, scrolls to orbit and zoom, and pans with Shift', () =>
  opened(kPage, async (page) => {
    const wheel = (options) => page.evaluate((given) => void document.querySelector('.stage').dispatchEvent(new WheelEvent('wheel', { cancelable: true, ...given })), options);
    // Twice as far apart in 20 events, each of which says a hundred times its part of the logarithm.
    for (let k = 0; k < 20; ++k) await wheel({ deltaY: -5 * Math.LN2, ctrlKey: true });
    await reaches(page, { distance: 2 });
    // A wheel's notch looks like a pinch where Ctrl went down elsewhere: it does not go far, the other way neither.
    await wheel({ deltaY: 100, ctrlKey: true });
    await reaches(page, { distance: 2 * Math.exp(0.25) });
    await wheel({ deltaY: -100, ctrlKey: true });
    await reaches(page, { distance: 2 });
    // A wheel with Ctrl held is no pinch: a notch is one as ever.
    await page.keyboard.down('Control');
    await wheel({ deltaY: 100, ctrlKey: true });
    await page.keyboard.up('Control');
    await reaches(page, { distance: 2 / 0.9 });
    await wheel({ deltaY: -3, deltaMode: 1 }); // lines
    await reaches(page, { distance: (2 / 0.9) * 0.9 ** 0.99 });
    await wheel({ deltaX: 50, deltaY: 10 });
    await reaches(page, { yaw: kStart.yaw - 50 * 0.006, pitch: kStart.pitch, distance: (2 / 0.9) * 0.9 ** 0.99 });
    assert.deepEqual((await goal(page)).target, [0, 0, 0]);
    await wheel({ deltaX: 30, deltaY: 40, shiftKey: true });
    const metres = (50 * (2 / 0.9) * 0.9 ** 0.99) / kFocal;
    await page.waitForFunction((far) => Math.abs(Math.hypot(...window.splatbus.rig.goal.target) - far) < 1e-6, metres);
    // Safari's own.
    const { distance } = await goal(page);
    await page.evaluate(() => {
      for (const [name, scale] of [['gesturestart', 1], ['gesturechange', 1.5], ['gesturechange', 2]]) {
        document.querySelector('.stage').dispatchEvent(Object.assign(new Event(name, { cancelable: true }), { scale }));
      }
    });
    await reaches(page, { distance: distance / 2 });
  }));

/** The camera that stays where it is and has that pixel in its middle, by the pinhole's own formula. */
function centred(x, y) {
  const right = [Math.sin(kStart.yaw), 0, -Math.cos(kStart.yaw)];
  const up = [Math.sin(kStart.pitch) * -Math.cos(kStart.yaw), Math.cos(kStart.pitch), Math.sin(kStart.pitch) * -Math.sin(kStart.yaw)];
  const ray = kAhead.map((value, k) => value + ((x - 160) / kFocal) * right[k] - ((y - 100) / kFocal) * up[k]);
  const unit = ray.map((value) => value / Math.hypot(...ray));
  return { target: unit.map((value, k) => kStart.distance * (value - kAhead[k])), pitch: Math.asin(-unit[1]) };
}
const comesToCentre = (page, { target, pitch }) =>
  page.waitForFunction(
    ([wanted, wantedPitch]) => {
      const { rig } = window.splatbus;
      return rig.shown === rig.goal && Math.abs(rig.goal.pitch - wantedPitch) < 1e-6 && Math.hypot(...rig.goal.target.map((value, k) => value - wanted[k])) < 1e-6;
    },
    [target, pitch],
  );

/** What that pixel shows of the scene that the page is given, found in double precision. */
const surfaceAt = (x, y) => logic.referenceSurface(logic.syntheticScene(3000), logic.viewOf(kStart, 320, 200), x, y)?.point ?? null;
const eyeOf = ({ target, yaw, pitch, distance }) => [
  target[0] + distance * Math.cos(pitch) * Math.cos(yaw),
  target[1] + distance * Math.sin(pitch),
  target[2] + distance * Math.cos(pitch) * Math.sin(yaw),
];
/** Waits until the camera rests that looks at that point from where it was. */
async function comesToOrbit(page, point) {
  await page.waitForFunction((wanted) => {
    const { rig } = window.splatbus;
    return rig.shown === rig.goal && Math.hypot(...rig.goal.target.map((value, k) => value - wanted[k])) < 1e-3;
  }, point);
  const [eye, before] = [eyeOf(await goal(page)), eyeOf(kStart)];
  assert.ok(Math.hypot(...eye.map((value, k) => value - before[k])) < 1e-3, `the eye is at ${eye}, and was at ${before}`);
}

test('a double-click on a thing makes it what the camera orbits', () =>
  opened(kPage, async (page) => {
    const point = surfaceAt(100, 80);
    await page.mouse.dblclick(100, 80);
    await comesToOrbit(page, point);
    assert.ok(Math.abs((await goal(page)).distance - kStart.distance) > 0.1, 'it is elsewhere than what it orbited');
    const { pitch } = await goal(page);
    await page.mouse.move(160, 100);
    await page.mouse.down();
    await page.mouse.move(200, 100, { steps: 4 });
    await page.mouse.up();
    await reaches(page, { pitch });
    assert.ok(Math.hypot(...(await goal(page)).target.map((value, k) => value - point[k])) < 1e-3, 'and so it does');
  }));

test('a double-click where nothing is centres that direction; two clicks apart do not', () =>
  opened(kPage, async (page) => {
    await page.mouse.click(230, 60);
    await page.waitForTimeout(500);
    await page.mouse.click(230, 60);
    await page.mouse.click(120, 60);
    await turns(page);
    assert.deepEqual(await goal(page), kStart);
    await page.waitForTimeout(500);
    assert.equal(surfaceAt(230, 60), null);
    await page.mouse.dblclick(230, 60);
    await comesToCentre(page, centred(230, 60));
    assert.equal((await goal(page)).distance, kStart.distance);
  }));

test('R goes back to the view that the page was opened with', () =>
  opened(kPage, async (page) => {
    await page.evaluate(() => {
      window.splatbus.rig.orbit(20, 0.3);
      window.splatbus.rig.zoom(3);
    });
    await page.keyboard.press('r');
    await page.waitForFunction(() => window.splatbus.rig.shown === window.splatbus.rig.goal && window.splatbus.rig.goal.distance === 4);
    const back = await goal(page);
    assert.deepEqual(back.target, kStart.target);
    assert.equal(back.pitch, kStart.pitch);
    const turned = back.yaw - kStart.yaw - 20;
    assert.ok(Math.abs(Math.sin((back.yaw - kStart.yaw) / 2)) < 1e-9 && Math.abs(turned) <= Math.PI, `by the shorter way: ${back.yaw}`);
  }));

test('R without a view in the address goes back to what was shown first', () =>
  opened('index.html', async (page) => {
    await page.waitForFunction(() => window.splatbus.rig.shown === window.splatbus.rig.goal && window.splatbus.rig.goal.distance !== 4.3);
    const first = await goal(page);
    await page.evaluate(() => {
      window.splatbus.rig.pan(70, 20, 100);
      window.splatbus.rig.orbit(0.5, 0.1);
    });
    await page.keyboard.press('m');
    await page.getByRole('button', { name: 'Reset view' }).click();
    await reaches(page, { pitch: first.pitch, yaw: first.yaw, distance: first.distance });
    assert.deepEqual((await goal(page)).target, first.target);
  }));

test('a page of no size comes back from there', () =>
  opened(kPage, async (page) => {
    await page.evaluate(() => (document.querySelector('.stage').style.height = 0));
    await page.keyboard.press('f');
    await page.waitForFunction(() => window.splatbus.rig.goal.distance !== 4);
    const { distance, target } = await goal(page);
    // All of it in a square: its sphere's radius is three quarters of what is shown of half 60 degrees' sine.
    const radius = await page.evaluate(
      () =>
        new Promise((done) => {
          const { link } = window.splatbus;
          const hear = link.onMessage;
          link.onMessage = (message) => (message.kind === 'bounds' && done(message.radius), hear(message));
          link.send({ kind: 'bounds' });
        }),
    );
    assert.ok(Math.abs(distance - 1.5 * radius) < 1e-6 && target.every(Number.isFinite), `${distance} m, ${radius} m`);
    await page.evaluate(() => {
      document.querySelector('.stage').style.height = '';
      window.splatbus.rig.orbit(NaN, 0); // nor is that a place
    });
    await page.keyboard.press('f');
    await page.waitForFunction(() => window.splatbus.rig.shown === window.splatbus.rig.goal && window.splatbus.rig.goal.distance > 0);
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

test('two taps make what is there what the camera orbits; a tap and one elsewhere, or one of two fingers, do not', () =>
  opened(
    kPage,
    async (page) => {
      const touch = await fingers(page);
      const tap = async (...points) => {
        await touch('touchStart', ...points);
        await touch('touchEnd');
      };
      await tap([90, 60]);
      await tap([230, 60]);
      await tap([230, 60], [240, 60]);
      await tap([230, 60], [240, 60]);
      await turns(page);
      const { target, distance } = await goal(page);
      assert.ok(Math.hypot(...target) < 1e-9 && Math.abs(distance - kStart.distance) < 1e-9, `${target}`);
      await tap([160, 100]);
      await tap([160, 100]);
      await comesToOrbit(page, surfaceAt(160, 100));
    },
    { hasTouch: true },
  ));

/** Keys of a keyboard that is not English: where they are, and what they say. */
async function keyboard(page) {
  const session = await page.context().newCDPSession(page);
  const send = (type) => (code, key) => session.send('Input.dispatchKeyEvent', { type, code, key });
  const [down, up] = [send('rawKeyDown'), send('keyUp')];
  return { down, up, press: async (code, key) => [await down(code, key), await up(code, key)] };
}

test('keys that move count by where they are, letters and signs by what they say', () =>
  opened(kPage, async (page) => {
    const { down, up, press } = await keyboard(page);
    const menu = page.getByRole('dialog', { name: 'Menu' });
    await press('KeyM', ','); // as in France
    await turns(page);
    assert.equal(await menu.isVisible(), false);
    await press('Semicolon', 'm');
    await menu.waitFor();
    await press('KeyM', 'ь'); // as in Russia, where no key says M
    await menu.waitFor({ state: 'hidden' });
    await down('KeyW', 'z');
    await page.waitForFunction(() => window.splatbus.rig.goal.target[1] < -0.05);
    await up('KeyW', 'z');
    await down('BracketRight', '+'); // as in Germany
    await page.waitForFunction(() => window.splatbus.rig.goal.distance < 3.9);
    await up('BracketRight', '*'); // Shift went down meanwhile
    await turns(page);
    const nearer = await goal(page);
    await turns(page);
    assert.deepEqual(await goal(page), nearer, 'it has come up');
    await down('Slash', '-');
    await page.waitForFunction((distance) => window.splatbus.rig.goal.distance > distance + 0.1, nearer.distance);
    await up('Slash', '-');
  }));

test('what macOS does not tell of keys that come up beside Cmd leaves no camera that goes on', () =>
  opened(kPage, async (page) => {
    const { down, up } = await keyboard(page);
    await down('KeyD', 'd');
    await page.waitForFunction(() => Math.hypot(...window.splatbus.rig.goal.target) > 0.05);
    await down('MetaLeft', 'Meta');
    await up('MetaLeft', 'Meta');
    await turns(page);
    const stands = await goal(page);
    await turns(page);
    assert.deepEqual(await goal(page), stands);
  }));

test('the menu names keys as this keyboard does', () => {
  const french = () => {
    const layout = new Map([['KeyW', 'z'], ['KeyA', 'q'], ['KeyS', 's'], ['KeyD', 'd'], ['KeyQ', 'a'], ['KeyE', 'e']]);
    Object.defineProperty(navigator, 'keyboard', { value: { getLayoutMap: async () => layout } });
  };
  return opened(kPage, async (page) => {
    await page.keyboard.press('m');
    await page.waitForFunction(() => [...document.querySelectorAll('.keys dt')].slice(0, 2).map((dt) => dt.textContent).join() === 'Z Q S D,A E');
  }, { init: french });
});

test('F and R of Colemak, where E and S are of English keyboards, do what the menu says', () => {
  const colemak = () => {
    const rows = { QWERTYUIOP: 'qwfpgjluy;', ASDFGHJKL: 'arstdhnei', ZXCVBNM: 'zxcvbkm' };
    const layout = new Map(Object.entries(rows).flatMap(([places, says]) => [...places].map((place, k) => [`Key${place}`, says[k]])));
    Object.defineProperty(navigator, 'keyboard', { value: { getLayoutMap: async () => layout } });
  };
  return opened(kPage, async (page) => {
    const { down, up, press } = await keyboard(page);
    await press('KeyM', 'm');
    await page.waitForFunction(() => {
      const names = Object.fromEntries([...document.querySelectorAll('.keys div')].map((div) => [...div.children].map((part) => part.textContent).reverse()));
      return names['down, up'] === 'Q F' && names['show all'] === 'T' && names['reset view'] === 'P' && names['save picture'] === ';';
    });
    await down('KeyE', 'f');
    await page.waitForFunction(() => window.splatbus.rig.goal.target[1] > 0.1);
    await up('KeyE', 'f');
    await press('KeyF', 't');
    await page.waitForFunction((distance) => window.splatbus.rig.goal.distance !== distance, kStart.distance);
    await press('KeyR', 'p');
    await reaches(page, { distance: kStart.distance, yaw: kStart.yaw });
    assert.deepEqual((await goal(page)).target, kStart.target);
  }, { init: colemak });
});

test('a browser that does not tell has the names of an English keyboard', () =>
  opened(kPage, async (page) => {
    await page.keyboard.press('m');
    await page.waitForFunction(() => [...document.querySelectorAll('.keys dt')].slice(0, 2).map((dt) => dt.textContent).join() === 'W A S D,Q E');
  }, { init: () => Object.defineProperty(navigator, 'keyboard', { value: undefined }) }));

test('where there is no full screen it is not offered, and V says so', () => {
  const phone = () => {
    delete Element.prototype.requestFullscreen;
    delete Document.prototype.fullscreenEnabled;
    delete Document.prototype.fullscreenElement;
  };
  return opened(kPage, async (page) => {
    await page.keyboard.press('v');
    await page.waitForFunction(() => document.querySelector('.notice').textContent.includes('no full screen'));
    await page.keyboard.press('m');
    await page.getByRole('button', { name: 'Show all' }).waitFor();
    assert.equal(await page.getByRole('button', { name: 'Full screen' }).isVisible(), false);
  }, { init: phone });
});

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
      // A frame may come between the events of the two: then one of them is followed first, which is a pixel's matter.
      assert.ok(Math.abs(Math.hypot(...target) - 15 * metresAPixel) < 1.5 * metresAPixel, `${target}`);
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
    const kMenu = ['Show all', 'Reset view', 'Full screen', 'Save picture', 'Copy link', 'Figures', 'Compare', 'Quality', 'Gaussians at most', 'Mbit/s at most', 'Background', 'Speed'];
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
          // And a wheel, with pedals that nobody treads on.
          const wheel = { connected: true, mapping: '', axes: [0.5, -1, -1, -1], buttons: buttons.map(() => ({ value: 1 })) };
          navigator.getGamepads = () => [wheel, null, { connected: true, mapping: 'standard', axes: values, buttons }];
        },
        [axes, { 0: Number(pressed), ...others }],
      );
    await pad([0.05, 0, 0, 0.05]); // what a stick at rest says of itself does not count
    await turns(page);
    assert.deepEqual(await goal(page), kStart);
    await pad([0.05, -1, 0, 0]);
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

const kFollow = 'Follow the player';
const playerOf = (page) => (camera) => page.evaluate((transform) => new BroadcastChannel('player').postMessage(transform), camera);
const follows = (page, wanted) =>
  page.waitForFunction(
    ([text, pressed]) => [...document.querySelectorAll('.menu button')].find((one) => one.textContent === text).getAttribute('aria-pressed') === pressed,
    [kFollow, String(wanted)],
  );

test('G follows the player where there is one, until somebody steers', () =>
  opened(kPage, async (page) => {
    const says = (text) => page.waitForFunction((part) => document.querySelector('.notice').textContent.includes(part), text);
    await page.keyboard.press('g');
    await says('no player');
    assert.deepEqual(await goal(page), kStart);
    await page.keyboard.press('m');
    const entry = page.getByRole('button', { name: kFollow });
    assert.equal(await entry.isVisible(), false);
    const player = playerOf(page);
    // From (0, 1, 3) along -z, then along -x and down.
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
    await follows(page, true);
    await page.keyboard.press('Escape');
    await page.mouse.move(160, 100);
    await page.mouse.wheel(0, -100);
    await page.waitForFunction((distance) => window.splatbus.rig.goal.distance < distance, kStart.distance);
    await follows(page, false);
    const left = await goal(page);
    await player([1, 0, 0, 0, 0, -1, 0, 1, 0, 0, -1, 3]);
    await page.waitForFunction(() => window.splatbus.stage.scene.transforms.at(-1) === 3);
    assert.deepEqual(await goal(page), left);
    await player(null);
    await page.waitForFunction((text) => [...document.querySelectorAll('.menu button')].find((one) => one.textContent === text).hidden, kFollow);
  }));

for (const [key, what] of [['f', 'to see all'], ['r', 'to see what was seen first']]) {
  test(`who follows the player and asks ${what} follows no more, though nobody has steered`, () =>
    opened(kPage, async (page) => {
      await playerOf(page)([1, 0, 0, 0, 0, -1, 0, 1, 0, 0, -1, 3]);
      await page.waitForFunction(() => window.splatbus.stage.scene.player > 0);
      await page.keyboard.press('g');
      await follows(page, true);
      await page.keyboard.press(key);
      await follows(page, false);
      if (key === 'r') await reaches(page, { yaw: kStart.yaw, pitch: kStart.pitch, distance: kStart.distance });
      const { target } = await goal(page);
      await playerOf(page)([1, 0, 0, 0, 0, -1, 0, 1, 0, 0, -1, 30]);
      await page.waitForFunction(() => window.splatbus.stage.scene.transforms.at(-1) === 30);
      assert.ok(Math.abs((await goal(page)).target[2] - 30) > 10, `${(await goal(page)).target} after ${target}`);
    }));
}
