// Gaussians as arrays of numbers, the .ply and .glb files that hold them, and how two sets are compared. Written from the
// formats' texts, apart from the C++ code that it checks.

import fs from 'node:fs';

const degreeOf = rest => [0, 9, 24, 45].indexOf(rest);

// { position: [[x, y, z], ...], rotation: wxyz, scale: log, opacity: logit, sh: [coefficient][color] }, one a Gaussian.
export function randomSplats(count, degree, seed) {
  let state = seed;
  const uniform = (low, high) => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return Math.fround(low + (high - low) * (state / 4294967296));
  };
  const list = (n, low, high) => Array.from({ length: n }, () => uniform(low, high));
  return Array.from({ length: count }, () => {
    const rotation = list(4, -1, 1);
    const length = Math.hypot(...rotation);
    return {
      position: list(3, -20, 20),
      rotation: rotation.map(x => Math.fround(x / length)),
      scale: list(3, -8, 1),
      opacity: uniform(-4, 4),
      sh: Array.from({ length: (degree + 1) ** 2 }, (_, k) => list(3, k ? -0.9 : -3, k ? 0.9 : 3)),
    };
  });
}

export function writePly(path, splats, comments = []) {
  const rest = 3 * (splats[0].sh.length - 1);
  const names = ['x', 'y', 'z', 'f_dc_0', 'f_dc_1', 'f_dc_2', ...Array.from({ length: rest }, (_, k) => `f_rest_${k}`),
    'opacity', 'scale_0', 'scale_1', 'scale_2', 'rot_0', 'rot_1', 'rot_2', 'rot_3'];
  const header = ['ply', 'format binary_little_endian 1.0', ...comments.map(c => `comment ${c}`),
    `element vertex ${splats.length}`, ...names.map(n => `property float ${n}`), 'end_header', ''].join('\n');
  const rows = splats.flatMap(s => [...s.position, ...s.sh[0],
    ...[0, 1, 2].flatMap(c => s.sh.slice(1).map(k => k[c])), s.opacity, ...s.scale, ...s.rotation]);
  fs.writeFileSync(path, Buffer.concat([Buffer.from(header), Buffer.from(new Float32Array(rows).buffer)]));
}

export function readPly(path) {
  const bytes = fs.readFileSync(path);
  const end = bytes.indexOf('end_header\n') + 'end_header\n'.length;
  const lines = bytes.subarray(0, end).toString().split('\n');
  const names = lines.filter(l => l.startsWith('property float ')).map(l => l.split(' ')[2]);
  const count = Number(lines.find(l => l.startsWith('element vertex ')).split(' ')[2]);
  if (names.length !== lines.filter(l => l.startsWith('property ')).length) throw new Error(`${path}: not all floats`);
  const rest = names.filter(n => n.startsWith('f_rest_')).length;
  const at = Object.fromEntries(names.map((n, i) => [n, i]));
  const splats = [];
  for (let i = 0; i < count; ++i) {
    const get = name => bytes.readFloatLE(end + 4 * (i * names.length + at[name]));
    const sh = [[0, 1, 2].map(c => get(`f_dc_${c}`))];
    for (let k = 0; k < rest / 3; ++k) sh.push([0, 1, 2].map(c => get(`f_rest_${c * rest / 3 + k}`)));
    splats.push({ position: ['x', 'y', 'z'].map(get), rotation: [0, 1, 2, 3].map(k => get(`rot_${k}`)),
      scale: [0, 1, 2].map(k => get(`scale_${k}`)), opacity: get('opacity'), sh });
  }
  return { splats, degree: degreeOf(rest), comments: lines.filter(l => l.startsWith('comment ')).map(l => l.slice(8)) };
}

export function readGlb(path) {
  const bytes = fs.readFileSync(path);
  const jsonBytes = bytes.readUInt32LE(12);
  const gltf = JSON.parse(bytes.subarray(20, 20 + jsonBytes));
  const binary = bytes.subarray(28 + jsonBytes);
  const { attributes } = gltf.meshes[0].primitives[0];
  const khr = 'KHR_gaussian_splatting:';
  const columns = Object.fromEntries(Object.entries(attributes).filter(([n]) => n !== 'COLOR_0').map(([name, index]) => {
    const accessor = gltf.accessors[index];
    const n = { SCALAR: 1, VEC3: 3, VEC4: 4 }[accessor.type];
    const from = gltf.bufferViews[accessor.bufferView].byteOffset;
    const element = i => Array.from({ length: n }, (_, c) => binary.readFloatLE(from + 4 * (i * n + c)));
    return [name, Array.from({ length: accessor.count }, (_, i) => element(i))];
  }));
  return columns.POSITION.map((position, i) => {
    const [x, y, z, w] = columns[`${khr}ROTATION`][i];
    const sh = [];
    for (let l = 0; l <= 3; ++l) {
      for (let m = 0; m <= 2 * l; ++m) {
        const column = columns[`${khr}SH_DEGREE_${l}_COEF_${m}`];
        if (column) sh.push(column[i]);
      }
    }
    const opacity = columns[`${khr}OPACITY`][i][0];
    return { position, rotation: [w, x, y, z], scale: columns[`${khr}SCALE`][i].map(Math.log),
      opacity: Math.log(opacity / (1 - opacity)), sh };
  });
}

// Largest differences; rotations as the angle in radians, opacities after the sigmoid.
export function differences(actual, expected) {
  if (actual.length !== expected.length) throw new Error(`${actual.length} Gaussians, not ${expected.length}`);
  const worst = { position: 0, rotation: 0, scale: 0, opacity: 0, sh0: 0, sh1: 0, shRest: 0 };
  const sigmoid = x => 1 / (1 + Math.exp(-x));
  const note = (key, a, b) => {
    a.forEach((x, i) => { worst[key] = Math.max(worst[key], Number.isFinite(x) ? Math.abs(x - b[i]) : Infinity); });
  };
  actual.forEach((a, i) => {
    const e = expected[i];
    if (a.sh.length !== e.sh.length) throw new Error(`${a.sh.length} SH coefficients, not ${e.sh.length}`);
    note('position', a.position, e.position);
    note('scale', a.scale, e.scale);
    note('opacity', [sigmoid(a.opacity)], [sigmoid(e.opacity)]);
    a.sh.forEach((c, k) => note(k === 0 ? 'sh0' : k < 4 ? 'sh1' : 'shRest', c, e.sh[k]));
    const dot = a.rotation.reduce((sum, x, k) => sum + x * e.rotation[k], 0);
    const cross = Math.hypot(...a.rotation.map((x, k) => x - Math.sign(dot) * e.rotation[k]));
    worst.rotation = Math.max(worst.rotation, Number.isFinite(cross) ? 2 * cross : Infinity);
  });
  return worst;
}

// Upper triangle of R S S^T R^T.
export function covariance(splat) {
  const [w, x, y, z] = splat.rotation;
  const r = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]];
  const s = splat.scale.map(v => Math.exp(2 * v));
  const entry = (a, b) => s.reduce((sum, v, k) => sum + r[a][k] * v * r[b][k], 0);
  return [entry(0, 0), entry(0, 1), entry(0, 2), entry(1, 1), entry(1, 2), entry(2, 2)];
}
