// What tests of the logic need, without a browser.
export { addressWith, poseOf, poseText, readAddress } from '../src/camera/address';
export { Rig, viewOf } from '../src/camera/rig';
export { flip } from '../src/compare/flip';
export { ssim } from '../src/compare/ssim';
export { viewOfEye, xrFromWorld } from '../src/xr/xr_view';
export { inTime } from '../src/render/in_time';
export { randomNumbers } from './page/synthetic_scene';
export { ColorPlayout } from '../src/motion/color_playout';
export { Playout } from '../src/motion/playout';
export { Framing } from '../src/framing';
export { Pace, Rate } from '../src/pace';
export { Restarts } from '../src/restarts';
export { Arrival } from '../src/stream/arrival';
export { FiguresDue } from '../src/stream/figures_due';
export { saysOutOfMemory } from '../src/stream/out_of_memory';
export { StreamLink } from '../src/stream/stream_link';
export { Publisher } from '../src/stream/publisher';
export { RowMirror } from '../src/stream/row_mirror';
