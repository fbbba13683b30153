// The surface under a pixel, against one that is found by trying, in double precision; and the camera that goes to orbit it.
import assert from 'node:assert/strict';
import { resolve } from 'node:path';
import { test } from 'node:test';
import { pathToFileURL } from 'node:url';

const kPages = process.env.SPLATBUS_WEB_TESTS ?? '../build/release/web-tests';
const logic = await import(pathToFileURL(resolve(kPages, 'logic.js')));

const kSize = 256;
const kIdentity = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];

/** From there towards the origin. */
function viewFrom(eye) {
  const far = Math.hypot(...eye);
  const focal = kSize / (2 * Math.tan(0.5));
  return { viewFromWorld: logic.viewFromWorld(eye, eye.map((value) => -value / far)), fx: focal, fy: focal, cx: kSize / 2 + 3, cy: kSize / 2 - 2, width: kSize, height: kSize };
}

/** Where the picture has a point of the world. */
function seenAt({ viewFromWorld: v, fx, fy, cx, cy }, [x, y, z]) {
  const [right, down, ahead] = [0, 4, 8].map((r) => v[r] * x + v[r + 1] * y + v[r + 2] * z + v[r + 3]);
  return [cx + (fx * right) / ahead, cy + (fy * down) / ahead];
}

const sceneOf = (transforms, farField = 0) => ({ transforms: new Float32Array(transforms), farField, player: 0, background: [0, 0, 0], displaySpace: false });

/** What a page's mirror of these says. */
function mirrorOf(gaussians, nowS = 1) {
  const mirror = new logic.RowMirror();
  const rows = Uint32Array.from(gaussians, (_, row) => row);
  mirror.take({ rows, records: logic.packRecords(gaussians), turnover: { origins: rows.map(() => logic.kNoRow), left: new Uint8Array(rows.length) } }, nowS);
  return mirror;
}

for (const mip of [true, false]) {
  test(`what is hit is what the picture shows there, ${mip ? 'with' : 'without'} the filter of training`, () => {
    // As coarse as a young model, and so fine that most are about as large as a pixel.
    for (const [count, size] of [[1500, 1], [1500, 0.4]]) {
      const scene = logic.syntheticScene(count);
      for (const gaussian of scene.gaussians) gaussian.logScale = gaussian.logScale.map((value) => value + Math.log(size));
      const mirror = mirrorOf(scene.gaussians);
      const random = logic.randomNumbers(7);
      let hits = 0;
      let nothing = 0;
      for (const eye of [[3, 1.2, 0.5], [-1.5, 2, -2]]) {
        const view = viewFrom(eye);
        for (let k = 0; k < 40; ++k) {
          const { mean } = scene.gaussians[Math.floor(scene.gaussians.length * random())];
          const [x, y] = k % 2 === 0 ? [kSize * random(), kSize * random()] : seenAt(view, mean);
          const truth = logic.referenceSurface(scene, view, x, y, mip);
          const point = mirror.pick({ view, x, y, scene: sceneOf(scene.transforms), mip });
          assert.equal(point === null, truth === null, `${x}, ${y}`);
          if (!truth) {
            ++nothing;
            continue;
          }
          ++hits;
          const off = Math.hypot(...point.map((value, axis) => value - truth.point[axis]));
          assert.ok(off < 1e-3, `${off} m off at ${x}, ${y}, row ${truth.row}`);
        }
      }
      assert.ok(hits > 10 && nothing > 10, `${hits} hits, ${nothing} times nothing`);
    }
  });
}

/** A disc that faces +x, as wide as given, a tenth of a millimetre thick. */
const disc = (x, opacity, object = 0, width = 2) => ({
  mean: [x, 0, 0],
  logScale: [Math.log(1e-4), Math.log(width), Math.log(width)],
  rotation: [0, 0, 0],
  opacity,
  object,
  color: [1, 1, 1],
});
const kView = viewFrom([4, 0, 0]);
/** Where the middle of the picture meets what there is, along x. */
const middle = (mirror, scene = sceneOf(kIdentity)) => mirror.pick({ view: kView, x: kView.cx, y: kView.cy, scene, mip: false })?.[0] ?? null;
const near = (value, wanted) => assert.ok(value !== null && Math.abs(value - wanted) < 1e-4, `${value}, not ${wanted}`); // a record's turns are rounded

test('haze is no surface until it hides half of what is behind it', () => {
  const wall = disc(-3, 1);
  near(middle(mirrorOf([wall])), -3);
  near(middle(mirrorOf([wall, disc(1, 0.2), disc(2, 0.2)])), -3);
  near(middle(mirrorOf([wall, disc(1, 0.2), disc(2, 0.2), disc(0.5, 0.2), disc(0, 0.2)])), 0); // 0.8 ** 3 lets 0.51 through
  assert.equal(middle(mirrorOf([disc(1, 0.2), disc(2, 0.2)])), null);
});

test('what is thin at its edge counts as far as it reaches', () => {
  // 2.8 standard deviations off the middle each of them hides exp(-2.8 ** 2 / 2), a fiftieth.
  const stack = mirrorOf(Array.from({ length: 60 }, (_, k) => disc(-0.01 * k, 1, 0, 0.2)));
  const view = viewFrom([1000, 0, 0]);
  const point = stack.pick({ view: { ...view, fx: 1e5, fy: 1e5 }, x: view.cx + 1e5 * (0.56 / 1000), y: view.cy, scene: sceneOf(kIdentity), mip: false });
  assert.ok(point && Math.abs(point[0] + 0.34) < 0.015, `the 35th: ${point}`);
});

test('a large disc is hit where the ray meets it, and not as far off as its middle', () => {
  const leaning = { ...disc(0, 1), rotation: [0, 0, Math.PI / 4] };
  const view = viewFrom([4, 0, 0]);
  const down = 0.1; // of the focal length
  const [x, y, z] = mirrorOf([leaning]).pick({ view, x: view.cx, y: view.cy + down * view.fy, scene: sceneOf(kIdentity), mip: false });
  // The plane x = -y; the ray is (4 - t, -0.1 t, 0).
  near(x, 4 - 4 / 1.1);
  near(y, -0.4 / 1.1);
  near(z, 0);
});

test('what is hidden, far away or on its way out is no surface, and what moves is where it is shown', () => {
  const moved = [...kIdentity];
  moved[3] = 0.75;
  const one = mirrorOf([disc(-3, 1), disc(1, 1, 1)]);
  near(middle(one, sceneOf([...kIdentity, ...kIdentity])), 1);
  near(middle(one, sceneOf([...kIdentity, ...moved])), 1.75);
  near(middle(one, sceneOf([...kIdentity, ...new Array(12).fill(0)])), -3);
  near(middle(one, sceneOf(kIdentity)), -3); // the scene that is shown knows nothing of it yet
  const sky = mirrorOf([disc(-3, 1), disc(-2, 1, 1)]); // 2 m before the eye
  near(middle(sky, sceneOf([...kIdentity, ...kIdentity], 1)), -3);

  const vanishing = mirrorOf([disc(-3, 1), disc(1, 1)]);
  vanishing.take({ rows: new Uint32Array([1]), records: new Uint32Array(8), turnover: { origins: new Uint32Array([logic.kNoRow]), left: new Uint8Array([1]) } }, 2);
  near(middle(vanishing), -3);
  assert.equal(middle(new logic.RowMirror()), null);
  assert.equal(middle(mirrorOf([disc(4.5, 1), disc(3.97, 1)])), null, 'behind the eye, or too near to it');
});

test('a camera goes to orbit a point from where its eye is', () => {
  const eyeOf = ({ target, yaw, pitch, distance }) => [
    target[0] + distance * Math.cos(pitch) * Math.cos(yaw),
    target[1] + distance * Math.sin(pitch),
    target[2] + distance * Math.cos(pitch) * Math.sin(yaw),
  ];
  const apart = (a, b) => Math.hypot(...a.map((value, k) => value - b[k]));
  const rig = new logic.Rig();
  rig.jump({ target: [1, 0.5, -2], yaw: 9, pitch: 0.3, distance: 12 });
  const eye = eyeOf(rig.goal);
  const point = [0.2, 1.4, 2.5];
  rig.orbitAbout(point);
  assert.deepEqual(rig.goal.target, point);
  assert.ok(apart(eyeOf(rig.goal), eye) < 1e-9 && Math.abs(rig.goal.distance - apart(eye, point)) < 1e-9);
  assert.ok(Math.abs(rig.goal.yaw - 9) < Math.PI, 'without a turn about itself');
  assert.ok(apart(eyeOf(rig.shown), eye) < 1e-9, 'what is shown does not jump');
  const turn = rig.goal.distance * Math.hypot(rig.goal.yaw - 9, rig.goal.pitch - 0.3);
  for (let k = 0; k < 60; ++k) {
    rig.advance(1 / 60);
    // On the chord between two targets it is nearer to them: by what an arc is higher than its chord, and no more.
    assert.ok(apart(eyeOf(rig.shown), eye) < turn ** 2 / (4 * rig.goal.distance), `${apart(eyeOf(rig.shown), eye)} m in picture ${k}`);
  }
  assert.equal(rig.shown, rig.goal);

  // Straight ahead: the picture is not to change at all.
  rig.jump({ target: [1, 0.5, -2], yaw: 1, pitch: 0.3, distance: 12 });
  const ahead = eyeOf({ ...rig.goal, distance: 9 }); // 3 m before the eye
  const still = eyeOf(rig.goal);
  rig.orbitAbout(ahead);
  for (let k = 0; k < 60; ++k) {
    assert.ok(apart(eyeOf(rig.shown), still) < 1e-9, `${apart(eyeOf(rig.shown), still)} m in picture ${k}`);
    rig.advance(1 / 60);
  }
  assert.ok(Math.abs(rig.shown.distance - 3) < 1e-9);

  const before = rig.goal;
  rig.orbitAbout([NaN, 0, 0]);
  assert.equal(rig.goal, before);
  rig.orbitAbout(eyeOf(rig.goal)); // there is no direction to it
  assert.ok(Object.values(rig.goal).flat().every(Number.isFinite));
  rig.jump({ target: [0, 0, 0], yaw: 0, pitch: 0.2, distance: 3 });
  rig.orbitAbout([2.9, -2, 0]);
  assert.deepEqual(rig.goal.target, [2.9, -2, 0], 'steeper than a camera looks, it comes to be above');
});

test('what was picked is not gone to when somebody steers meanwhile, or has picked something else', () => {
  const start = { target: [0, 0, 0], yaw: 0, pitch: 0, distance: 4 };
  const begin = () => {
    const rig = new logic.Rig();
    rig.jump(start);
    const asked = [];
    const picking = new logic.Picking({ sceneAt: () => sceneOf(kIdentity) }, rig, { send: (message) => asked.push(message) }, () => kView, true);
    return { rig, asked, picking };
  };
  const point = [1, 0.5, 0.25];
  {
    const { rig, asked, picking } = begin();
    picking.at(0.1, -0.2);
    const [{ number, at }] = asked;
    near(at.x, kView.cx + 0.1 * kView.fx);
    near(at.y, kView.cy - 0.2 * kView.fy);
    assert.ok(at.mip && at.view === kView);
    assert.ok(rig.goal.pitch < -0.1 && rig.goal.distance === 4, 'it turns there before anybody has answered');
    const centred = rig.goal;
    picking.hear(number, null);
    assert.equal(rig.goal, centred);
    picking.hear(number, point);
    assert.deepEqual(rig.goal.target, point);
  }
  {
    const { rig, asked, picking } = begin();
    picking.at(0.1, -0.2);
    rig.zoom(0.5);
    const steered = rig.goal;
    picking.hear(asked[0].number, point);
    assert.equal(rig.goal, steered);
  }
  {
    const { rig, asked, picking } = begin();
    picking.at(0.1, -0.2);
    picking.at(-0.1, 0.2);
    const second = rig.goal;
    picking.hear(asked[0].number, point);
    assert.equal(rig.goal, second);
    picking.hear(asked[1].number, point);
    assert.deepEqual(rig.goal.target, point);
  }
});
