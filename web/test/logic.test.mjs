// Parts of the page that need no browser, with clocks that the tests make.
import assert from 'node:assert/strict';
import { resolve } from 'node:path';
import { test } from 'node:test';
import { pathToFileURL } from 'node:url';

const kPages = process.env.SPLATBUS_WEB_TESTS ?? '../build/release/web-tests';
const logic = await import(pathToFileURL(resolve(kPages, 'logic.js')));

/** Where a ball on a circle of a metre is, once around in two seconds, as a transform; the world comes first. */
const ball = (ms) => {
  const angle = (Math.PI * ms) / 1000;
  return new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 0, 0, Math.cos(angle), 0, 1, 0, 0, 0, 0, 1, Math.sin(angle)]);
};

const sceneOf = (transforms, background = [0, 0, 0]) => ({ transforms, background });

/** Between 0 and 1, the same for the same seed. */
const randomOf = (seed) => () => (seed = (seed * 16807) % 2147483647) / 2147483647;

for (const [jitterMs, seed] of [[0, 1], ...Array.from({ length: 20 }, (_, k) => [20, k + 1])]) {
  test(`a ball on a circle is where it was at the time played out, ${jitterMs} ms of jitter, seed ${seed}`, () => {
    const random = randomOf(seed);
    const playout = new logic.Playout();
    const kEngineAheadMs = 123456;
    // 30 scenes a second, each under way for 5 ms and up to as much again as the jitter says, in order.
    const scenes = [];
    for (let k = 0; k < 300; ++k) {
      const ms = (1000 * k) / 30;
      const arrival = ms + 5 + jitterMs * random();
      scenes.push({ ms, arrival: Math.max(arrival, scenes.at(-1)?.arrival ?? 0) });
    }
    // A pixel of 720 over 60 degrees, 4 m away.
    const pixel = (2 * 4 * Math.tan(Math.PI / 6)) / 720;
    let next = 0;
    let shownBefore = -Infinity;
    let latest = 0;
    let judged = 0;
    for (let frame = 0; frame < 600; ++frame) {
      const now = (1000 * frame) / 60 + 3;
      while (next < scenes.length && scenes[next].arrival <= now) {
        const { ms, arrival } = scenes[next++];
        playout.add(sceneOf(ball(ms)), { captureMs: kEngineAheadMs + ms, arrivedMs: arrival });
      }
      const at = playout.at(now)?.transforms;
      if (!at) continue;
      const shown = playout.shownMs(now) - kEngineAheadMs;
      ++judged;
      const truth = ball(shown);
      assert.ok(Math.hypot(at[15] - truth[15], at[23] - truth[23]) < pixel, `frame ${frame}`);
      assert.ok(shown >= shownBefore, 'time does not run backwards');
      shownBefore = shown;
      if (frame < 60) continue; // how late scenes come has to be seen first
      assert.ok(shown <= scenes[next - 1].ms + 1, 'nothing has to be guessed');
      latest = Math.max(latest, now - shown);
    }
    assert.ok(judged > 590, `${judged} frames`);
    assert.ok(latest < 34 + 5 + 1.5 * jitterMs, `${latest} ms late`);
  });
}

test('the age of a picture is since that was what it shows, but for the quickest way here', () => {
  const playout = new logic.Playout();
  assert.equal(playout.ageMs(0), null, 'nobody knows');
  const kAhead = 5000;
  const kWayMs = 30;
  for (let k = 0, now = 0; now < 3000; now += 1000 / 60) {
    for (; (1000 * k) / 30 + kWayMs + 20 * (k % 2) <= now; ++k) {
      const ms = (1000 * k) / 30;
      playout.add(sceneOf(ball(ms)), { captureMs: kAhead + ms, arrivedMs: ms + kWayMs + 20 * (k % 2) });
    }
    const at = playout.at(now)?.transforms;
    if (!at) continue;
    // Where the ball is seen says when that was, within its two seconds.
    const shown = (1000 / Math.PI) * Math.atan2(at[23], at[15]);
    const age = (((now - kWayMs - shown) % 2000) + 2000) % 2000;
    const said = playout.ageMs(now);
    assert.ok(Math.abs(said - age) < 2 || Math.abs(said - age) > 1998, `${said} ms for ${age} ms at ${now} ms`);
    if (now > 1000) assert.ok(said > 20 && said < 80, `${said}`);
  }
});

test('a motion goes on for a tenth of a second without scenes, and rests then', () => {
  const playout = new logic.Playout();
  for (const ms of [1000, 1033, 1066]) playout.add(sceneOf(ball(ms)), { captureMs: ms, arrivedMs: ms });
  const at = (ms) => playout.at(ms).transforms[23];
  const before = at(1100);
  assert.ok(at(1150) < before, 'it goes on'); // towards negative z
  assert.ok(playout.movingAt(1150));
  assert.equal(at(1300), at(1400));
  assert.ok(!playout.movingAt(1400));
});

test('an engine whose clock is behind is followed as the first was', () => {
  const playout = new logic.Playout();
  for (let ms = 0; ms < 1000; ms += 33) playout.add(sceneOf(ball(ms)), { captureMs: 50_000 + ms, arrivedMs: ms });
  for (let ms = 1000; ms < 2000; ms += 33) playout.add(sceneOf(ball(ms)), { captureMs: ms, arrivedMs: ms });
  const shown = playout.shownMs(2000);
  assert.ok(shown > 1800 && shown <= 2000, `${shown}`);
  const truth = ball(shown);
  const at = playout.at(2000).transforms;
  assert.ok(Math.hypot(at[15] - truth[15], at[23] - truth[23]) < 0.01);
});

/** A world that stands, and an object a metre beside it, so large, that has turned by `angle` about an axis that leans. */
const spun = (angle, size = 1) => {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const lean = (x, y, z) => [0.8 * x - 0.6 * y, 0.6 * x + 0.8 * y, z].map((value) => size * value);
  const [x, y, z] = [lean(c, 0, -s), lean(0, 1, 0), lean(s, 0, c)];
  return new Float32Array([...ball(0).slice(0, 12), ...[0, 1, 2].flatMap((row) => [x[row], y[row], z[row], row === 0 ? 1 : 0])]);
};
const columnsOf = (transforms) => [0, 1, 2].map((k) => [12, 16, 20].map((row) => transforms[row + k]));

for (const rate of [5, 10]) {
  test(`an object that spins under an engine of ${rate} scenes a second keeps its size, and turns evenly, also beyond the last one`, () => {
    const playout = new logic.Playout();
    const turned = (ms) => (2 * Math.PI * ms) / 1000;
    let next = 0;
    let between = 0;
    let beyond = 0;
    for (let now = 0; now < 3400; now += 1000 / 144) {
      for (; (1000 * next) / rate <= Math.min(now, 3000); ++next) {
        const ms = (1000 * next) / rate;
        playout.add(sceneOf(spun(turned(ms))), { captureMs: 1000 + ms, arrivedMs: ms });
      }
      if (next < 3) continue;
      const at = columnsOf(playout.at(now).transforms);
      const shown = playout.shownMs(now) - 1000;
      for (const column of at) assert.ok(Math.abs(Math.hypot(...column) - 1) < 1e-4, `${Math.hypot(...column)} long at ${shown} ms`);
      const truth = columnsOf(spun(turned(shown)));
      at.flat().forEach((value, k) => assert.ok(Math.abs(value - truth.flat()[k]) < 1e-4, `${at} is not ${truth} at ${shown} ms`));
      shown > (1000 * (next - 1)) / rate ? ++beyond : ++between;
    }
    assert.ok(between > 300 && beyond > 5, `${between} between, ${beyond} beyond`);
  });
}

test('an object turns the shorter way, and grows evenly; one that is sheared or mirrored goes straight', () => {
  const halfWay = (from, to) => {
    const playout = new logic.Playout();
    for (const [transforms, captureMs] of [[from, 1000], [to, 1100]]) playout.add(sceneOf(transforms), { captureMs, arrivedMs: captureMs });
    return playout.at(1150).transforms; // a scene lasts 100 ms
  };
  const near = (at, truth) => at.forEach((value, k) => assert.ok(Math.abs(value - truth[k]) < 1e-6, `${at} is not ${truth}`));
  near(halfWay(spun(-1), spun(1, 3)), spun(0, 2));
  near(halfWay(spun(3, 2), spun(-3, 2)), spun(Math.PI, 2));
  const straight = (a, b) => a.map((value, k) => (value + b[k]) / 2);
  for (const changed of [{ 13: 0.5 }, { 12: -0.8, 16: -0.6 }]) {
    const other = Object.assign(spun(0), changed);
    near(halfWay(other, spun(1)), straight(other, spun(1)));
    near(halfWay(spun(1), other), straight(other, spun(1)));
  }
});

test('what is hidden does not come from where it was', () => {
  const playout = new logic.Playout();
  const hidden = ball(0).fill(0, 12);
  playout.add(sceneOf(hidden), { captureMs: 1000, arrivedMs: 1000 });
  playout.add(sceneOf(ball(500)), { captureMs: 1033, arrivedMs: 1033 });
  assert.deepEqual([...playout.at(1050).transforms.slice(12)], [...ball(500).slice(12)]);
});

test('the light of the background is that of the time played out, and does not go on beyond the last scene', () => {
  // A second's dawn: red comes, blue goes, in scenes of 30 a second, which come 12 ms late and in turn 8 ms later.
  const dawn = (ms) => [ms / 1000, 0.25, 1 - ms / 1000];
  const playout = new logic.Playout();
  const kEngineAheadMs = 5000;
  let next = 0;
  let steps = 0;
  let before = -1;
  for (let now = 0; now < 1100; now += 1000 / 144) {
    for (; next <= 30 && (1000 * next) / 30 + 12 + 8 * (next % 2) <= now; ++next) {
      const ms = (1000 * next) / 30;
      playout.add(sceneOf(ball(0), dawn(ms)), { captureMs: kEngineAheadMs + ms, arrivedMs: ms + 12 + 8 * (next % 2) });
    }
    const played = playout.at(now);
    if (!played) continue;
    const truth = dawn(Math.min(playout.shownMs(now) - kEngineAheadMs, 1000));
    played.background.forEach((value, k) => assert.ok(Math.abs(value - truth[k]) < 1e-6, `${now} ms: ${played.background}, ${truth}`));
    assert.ok(played.background[0] >= before);
    if (played.background[0] > before) ++steps;
    before = played.background[0];
    if (now > 200 && now < 900) assert.ok(playout.movingAt(now), 'it is to be drawn again');
  }
  assert.ok(steps > 130, `${steps} steps`); // not one a scene
});

test('an object whose rows come later than its scene is there with them', () => {
  const playout = new logic.Playout();
  playout.add(sceneOf(ball(0).slice(0, 12)), { captureMs: 1000, arrivedMs: 1000 });
  playout.add(sceneOf(ball(0)), { captureMs: 1000, arrivedMs: 1000 });
  assert.deepEqual([...playout.at(1050).transforms], [...ball(0)]);
});

test('below 50 frames a second it is drawn coarser, and finer again when it is quick', () => {
  const pace = new logic.Pace();
  let now = 1000;
  const frames = (count, ms) => {
    for (let i = 0; i < count; ++i) pace.drawn((now += ms));
  };
  frames(100, 16.7);
  assert.equal(pace.resolution, 1);
  frames(60, 40);
  const coarse = pace.resolution;
  assert.ok(coarse < 0.7 && coarse >= 0.35, `${coarse}`);
  frames(24, 8);
  assert.ok(pace.resolution > coarse);
  frames(1000, 8);
  assert.equal(pace.resolution, 1);
});

test('pictures that take long are counted, and drawn more coarsely', () => {
  const pace = new logic.Pace();
  for (let frame = 1; frame <= 40; ++frame) pace.drawn(1000 + 400 * frame);
  assert.ok(Math.abs(pace.framesPerSecond - 2.5) < 0.01, `${pace.framesPerSecond}`);
  assert.ok(pace.resolution < 0.7, `${pace.resolution}`);
  pace.rest();
  assert.ok(!pace.restsAt(17_500) && pace.framesPerSecond > 2, 'a scene whose news come late is not at rest');
  pace.drawn(17_600);
  pace.drawn(18_000);
  assert.ok(Math.abs(pace.framesPerSecond - 2.5) < 0.01, 'what it paused is no time of a picture');
  pace.rest();
  assert.ok(pace.restsAt(19_100));
  pace.drawn(100_000);
  assert.equal(pace.framesPerSecond, 0, 'the first after a rest follows nothing');
});

test('a rate is of the last seconds', () => {
  const rate = new logic.Rate();
  for (let ms = 0; ms <= 10000; ms += 250) rate.add(ms, ms < 5000 ? 0 : 250 * (ms - 5000));
  assert.ok(Math.abs(rate.megabits - 2) < 0.01, `${rate.megabits}`);
});

test('an address keeps a view and loses a token', () => {
  const pose = { target: [1.5, -2.25, 3], yaw: 1.25, pitch: -0.5, distance: 4.5 };
  assert.deepEqual(logic.poseOf(logic.poseText(pose)), pose);
  assert.equal(logic.poseOf('1,2,3,x,5,6'), null);
  assert.equal(logic.poseOf('1,2,3,4,5,0'), null);
  const url = new URL('https://example.org/?token=secret&gpu=webgpu#token=other');
  assert.equal(logic.readAddress(url).token, 'other');
  const next = logic.addressWith(url, pose);
  assert.ok(!/secret|other/.test(next), next);
  assert.deepEqual(logic.readAddress(new URL(next)).pose, pose);
  assert.equal(logic.readAddress(new URL(next)).options.get('gpu'), 'webgpu');
  const shared = new URL(logic.sharedAddress(new URL('https://example.org/?bench=1&seconds=9&gpu=webgl2#token=secret'), pose));
  assert.deepEqual([...shared.searchParams], [['gpu', 'webgl2']], 'nobody is to measure who is to look');
  assert.deepEqual(logic.readAddress(shared).pose, pose);
});

test('a token in the address is not taken away before it is taken', () => {
  const pose = { target: [1, 2, 3], yaw: 1, pitch: 0.5, distance: 4 };
  const kept = [];
  Object.assign(globalThis, { location: { href: 'https://example.org/' }, history: { replaceState: (state, title, address) => kept.push(address) } });
  try {
    const address = new logic.KeptAddress();
    address.keep(1000, pose);
    assert.deepEqual(kept.map((one) => logic.readAddress(new URL(one)).pose), [pose]);
    location.href = 'https://example.org/#token=abc';
    address.keep(2000, pose);
    assert.equal(kept.length, 1, `${kept}`);
  } finally {
    delete globalThis.location;
    delete globalThis.history;
  }
});

test('the camera comes to its goal without a jump, in the same time at any rate of pictures; at once where less motion is asked for', () => {
  const goal = { target: [1, 0.4, 0], yaw: 1, pitch: 0.5, distance: 2 };
  const after = (seconds, rate) => {
    const rig = new logic.Rig();
    rig.move(goal);
    let largest = 0;
    for (let k = 0; k < seconds * rate; ++k) {
      const before = rig.shown.yaw;
      rig.advance(1 / rate);
      largest = Math.max(largest, rig.shown.yaw - before);
    }
    return { yaw: rig.shown.yaw, largest };
  };
  const [slow, quick] = [after(0.1, 30), after(0.1, 240)];
  assert.ok(Math.abs(slow.yaw - quick.yaw) < 1e-9 && slow.yaw > 0.7 && slow.yaw < 0.9, `${slow.yaw}, ${quick.yaw}`);
  assert.ok(quick.largest < 0.1, `a step of ${quick.largest}`);
  assert.equal(after(1, 60).yaw, 1);
  const still = new logic.Rig();
  still.smooth = false;
  still.move(goal);
  still.advance(1 / 60);
  assert.deepEqual([still.shown.yaw, still.shown.distance], [1, 2]);
});

test('a camera flies to where it looks, and leaves what is near at a metre a second', () => {
  const rig = new logic.Rig();
  rig.jump({ target: [0, 0, 0], yaw: 1, pitch: 0.5, distance: 5 });
  const motion = { right: 0, up: 0, ahead: 1, fast: false };
  const near = (a, b) => a.forEach((value, k) => assert.ok(Math.abs(value - b[k]) < 1e-9, `${a} is not ${b}`));
  const { viewFromWorld } = logic.viewOf(rig.goal, 640, 480);
  const ahead = [...viewFromWorld.subarray(8, 11)];
  rig.fly(motion, 0.5);
  near(rig.goal.target, ahead.map((value) => 2 * value)); // 0.8 times the distance a second
  rig.fly({ ...motion, fast: true }, 0.5);
  near(rig.goal.target, ahead.map((value) => 10 * value));
  rig.jump({ target: [0, 0, 0], yaw: 1, pitch: 0.5, distance: 0.05 });
  rig.fly(motion, 0.5);
  near(rig.goal.target, ahead.map((value) => 0.5 * value));
  rig.jump({ target: [0, 0, 0], yaw: 1, pitch: 0.5, distance: 5 });
  rig.fly({ ...motion, level: true }, 0.5);
  near(rig.goal.target, [-2 * Math.cos(1), 0, -2 * Math.sin(1)]);
});

test('a driver that never answers is an error, and what it gives later is handed back', async () => {
  assert.equal(await logic.inTime(Promise.resolve(7), () => assert.fail(), 20), 7);
  await assert.rejects(logic.inTime(Promise.reject(new Error('lost')), () => assert.fail(), 20), /lost/);
  let answer;
  const given = new Promise((late) => {
    const promise = new Promise((resolve) => (answer = resolve));
    assert.rejects(logic.inTime(promise, late, 20), /does not answer/).then(() => answer('late'));
  });
  assert.equal(await given, 'late');
});
