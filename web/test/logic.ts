// What tests of the logic need, without a browser.
export { addressWith, poseOf, poseText, readAddress } from '../src/camera/address';
export { Rig, viewOf } from '../src/camera/rig';
export { Playout } from '../src/motion/playout';
export { Pace, Rate } from '../src/pace';
export { Publisher } from '../src/stream/publisher';
export { RowMirror } from '../src/stream/row_mirror';
