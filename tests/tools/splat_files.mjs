// Opens what `splatbus export` writes with programs of others, and the other way round, and compares Gaussian by
// Gaussian. node splat_files.mjs SPLATBUS FOLDER, where FOLDER has node_modules.

import { execFileSync } from 'node:child_process';
import fs from 'node:fs';
import { createRequire } from 'node:module';
import path from 'node:path';
import { pathToFileURL } from 'node:url';

import { covariance, differences, randomSplats, readGlb, readPly, writePly } from './splat_values.mjs';

const [splatbus, folder] = process.argv.slice(2);
const modules = path.join(folder, 'node_modules');
const load = name => import(pathToFileURL(createRequire(path.join(modules, 'x.js')).resolve(name)));
const file = name => path.join(folder, name);
const run = (program, ...parameters) => execFileSync(program, parameters, { encoding: 'utf8' });
const transform = (...parameters) =>
  run('node', path.join(modules, '@playcanvas/splat-transform/bin/cli.mjs'), '-w', '-q', ...parameters);

let failed = 0;
const say = (good, text) => {
  console.log(`${good ? 'ok  ' : 'FAIL'} ${text}`);
  if (!good) ++failed;
};
function compare(what, actual, expected, limits) {
  const worst = differences(actual, expected);
  const over = Object.keys(worst).filter(k => !(worst[k] <= limits[k]));
  const text = Object.entries(worst).map(([k, v]) => `${k} ${v.toExponential(1)}`).join(', ');
  say(over.length === 0, `${what}: ${text}${over.length ? `; over the limit: ${over}` : ''}`);
}

const exact = { position: 0, rotation: 1e-6, scale: 0, opacity: 0, sh0: 0, sh1: 0, shRest: 0 };
const floats = { position: 1e-5, rotation: 2e-6, scale: 2e-6, opacity: 1e-7, sh0: 1e-6, sh1: 2e-6, shRest: 2e-6 };
const spz = { position: 0.51 / 4096, rotation: 5e-3, scale: 0.501 / 16, opacity: 0.501 / 255, sh0: 0.501 / 255 / 0.15,
  sh1: 4.51 / 128, shRest: 8.51 / 128 };

const { GLTFLoader } = await load('three/addons/loaders/GLTFLoader.js');
const { GLTFGaussianSplatLoaderExtension } = await load('three/addons/loaders/GLTFGaussianSplatLoaderExtension.js');
const { SPZLoader } = await load('three/addons/loaders/SPZLoader.js');
const { default: validator } = await load('gltf-validator');

// three's are y up, `splats` a PLY file's. Covariances tell whether rotations and scales mean what we think.
function compareThree(what, geometry, splats, limits) {
  const centers = geometry.getAttribute('position').array, covariances = geometry.getAttribute('covariance').array;
  let far = centers.length === 3 * splats.length ? 0 : Infinity, other = 0;
  splats.forEach((s, i) => {
    const [x, y, z] = s.position;
    [-x, -y, z].forEach((v, c) => { far = Math.max(far, Math.abs(v - centers[3 * i + c])); });
    const [xx, xy, xz, yy, yz, zz] = covariance(s);
    [xx, xy, -xz, yy, -yz, zz].forEach((v, c) => {
      other = Math.max(other, Math.abs(v - covariances[6 * i + c]) / (xx + yy + zz));
    });
  });
  say(far <= limits.position && other <= 2.1 * (limits.scale + limits.rotation),
    `${what}: position ${far.toExponential(1)}, covariance ${other.toExponential(1)} of its trace`);
}

for (const degree of [0, 1, 2, 3]) {
  const truth = randomSplats(300, degree, 7 + degree);
  const name = suffix => file(`degree${degree}${suffix}`);
  writePly(name('.ply'), truth, ['SplatRenderMode: mip']);
  const exported = (suffix, ...parameters) => {
    run(splatbus, 'export', name(suffix), '--from', name('.ply'), ...parameters);
    return name(suffix);
  };
  const taken = (from, suffix, ...parameters) => {
    run(splatbus, 'export', name(suffix), '--from', from, ...parameters);
    return readPly(name(suffix)).splats;
  };
  const theirs = (from, suffix, ...parameters) => {
    transform(from, ...parameters.filter(p => p !== '--spz-version' && p !== '3'), name(suffix),
      ...parameters.filter(p => p === '--spz-version' || p === '3'));
    return name(suffix);
  };

  const ours = readPly(exported('.ours.ply'));
  compare(`degree ${degree}: .ply, read and written by us`, ours.splats, truth, exact);
  say(ours.comments.includes('SplatRenderMode: mip'), `degree ${degree}: .ply keeps the mark of its filter`);
  compare(`degree ${degree}: our .ply through splat-transform`,
    readPly(theirs(name('.ours.ply'), '.theirs.ply')).splats, truth, floats);
  say(readPly(name('.theirs.ply')).comments.includes('SplatRenderMode: mip'), `degree ${degree}: and it saw the mark`);

  exported('.ours.glb');
  compare(`degree ${degree}: our .glb and splat-transform's`, readGlb(name('.ours.glb')),
    readGlb(theirs(name('.ply'), '.theirs.glb')), floats);
  const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(name('.ours.glb'))),
    { maxIssues: 1000 });
  // It knows no attributes of extensions.
  const issues = report.issues.messages.filter(m => m.severity < 2 && !m.pointer.includes('KHR_gaussian_splatting:'));
  say(issues.length === 0 && !report.issues.truncated,
    `degree ${degree}: gltf-validator${issues.map(m => `; ${m.pointer}: ${m.message}`).join('')}`);

  // splat-transform takes the numbers of .spz for a PLY file's, y down; the format's text has y up, as we do.
  for (const [version, suffix] of [['4', '4'], ['3', '3']]) {
    exported(`.ours${suffix}.spz`, '--spz-version', version);
    compare(`degree ${degree}: our .spz ${version} through splat-transform`,
      readPly(theirs(name(`.ours${suffix}.spz`), `.theirs${suffix}.ply`, '-r', '0,0,180')).splats, truth, spz);
    say(readPly(name(`.theirs${suffix}.ply`)).comments.includes('SplatRenderMode: mip'),
      `degree ${degree}: .spz ${version} has the mark of its filter`);
    transform(name('.ply'), '--spz-version', version, name(`.theirs${suffix}.spz`));
    compare(`degree ${degree}: splat-transform's .spz ${version}, read by us`,
      taken(name(`.theirs${suffix}.spz`), `.back${suffix}.ply`, '--from-axes', 'turn'), truth, spz);
  }

  const loader = new GLTFLoader().register(parser => new GLTFGaussianSplatLoaderExtension(parser));
  const glb = fs.readFileSync(name('.ours.glb'));
  const { scene } = await loader.parseAsync(glb.buffer.slice(glb.byteOffset, glb.byteOffset + glb.length), '');
  let seen = 0;
  scene.traverse(o => {
    seen += o.splatGeometry ? 1 : 0;
    if (o.splatGeometry) compareThree(`degree ${degree}: our .glb in three.js`, o.splatGeometry, truth, floats);
  });
  say(seen === 1, `degree ${degree}: three.js sees ${seen} primitive of splats`);
  for (const suffix of ['4', '3']) {
    const bytes = fs.readFileSync(name(`.ours${suffix}.spz`));
    const geometry = await new SPZLoader().parse(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
    compareThree(`degree ${degree}: our .spz ${suffix} in three.js`, geometry, truth, spz);
  }
}
console.log(failed === 0 ? 'all agree' : `${failed} do not agree`);
process.exit(failed === 0 ? 0 : 1);
