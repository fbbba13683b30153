import { add, clamp, cross, length, mix, scale, sub, viewFromWorld, type Vec3, type View } from '../math';

/** A camera that looks at `target` from `distance` metres: from yaw (from +x towards +z) and pitch (above the level), radians. */
export interface Pose {
  readonly target: Vec3;
  readonly yaw: number;
  readonly pitch: number;
  readonly distance: number;
}

/** Where the native viewer begins. */
export const kFirstPose: Pose = { target: [0, 0.4, 0], yaw: 0, pitch: 0.38, distance: 4.3 };

const kSteepest = 1.5;
const kNearest = 0.05;
const kFarthest = 1e4;
const kFovRadians = Math.PI / 3;
const kSpeed = 0.8; // distances to the target a second
/** Metres a second at least: who looks at a thing from near wants to leave it, too. */
const kSlowest = 1;
const kFaster = 4;
/** Of the sphere about all, what is framed: its corners are empty. */
const kFramed = 0.75;
/** Of the way to where the camera should be, 1/e is left after this. */
const kSmoothingS = 0.06;

export const backwardOf = (pose: Pose): Vec3 => [
  Math.cos(pose.pitch) * Math.cos(pose.yaw),
  Math.sin(pose.pitch),
  Math.cos(pose.pitch) * Math.sin(pose.yaw),
];
export const eyeOf = (pose: Pose): Vec3 => add(pose.target, scale(backwardOf(pose), pose.distance));
const rightOf = (pose: Pose): Vec3 => [Math.sin(pose.yaw), 0, -Math.cos(pose.yaw)];
const downOf = (pose: Pose): Vec3 => cross(scale(backwardOf(pose), -1), rightOf(pose));
/** The same turn, half a circle at most. */
const shortest = (turn: number): number => Math.atan2(Math.sin(turn), Math.cos(turn));

/** Focal length in pixels; an upright picture is as wide as it is high, by area. */
export function focalOf(width: number, height: number): number {
  return Math.sqrt(height * Math.min(width, height)) / (2 * Math.tan(kFovRadians / 2));
}

export function viewOf(pose: Pose, width: number, height: number): View {
  const focal = focalOf(width, height);
  const forward = scale(backwardOf(pose), -1);
  return { viewFromWorld: viewFromWorld(eyeOf(pose), forward), fx: focal, fy: focal, cx: width / 2, cy: height / 2, width, height };
}

/** Of world_from_camera, row-major 3x4: x right, y down, z forward. Without what it leans to a side. */
export function poseOf(camera: Float32Array, distance: number): Pose {
  const column = (k: number): Vec3 => [camera[k], camera[4 + k], camera[8 + k]];
  const forward = scale(column(2), 1 / Math.max(length(column(2)), 1e-12)); // an engine's numbers are rounded
  return {
    target: add(column(3), scale(forward, distance)),
    yaw: Math.atan2(-forward[2], -forward[0]),
    pitch: Math.asin(clamp(-forward[1], -1, 1)),
    distance,
  };
}

const limited = (pose: Pose): Pose => ({
  ...pose,
  pitch: clamp(pose.pitch, -kSteepest, kSteepest),
  distance: clamp(pose.distance, kNearest, kFarthest),
});

const isPlace = ({ target, yaw, pitch, distance }: Pose): boolean => [...target, yaw, pitch, distance].every(Number.isFinite);

/** To the right, up as the world has it, and to where one looks, each in [-1, 1] of the full speed. */
export interface Motion {
  readonly right: number;
  readonly up: number;
  readonly ahead: number;
  readonly fast: boolean;
  /** Ahead on the level: a headset's own lean is not the camera's. */
  readonly level?: boolean;
}

/** Where the camera should be, and where it is on its way there. */
export class Rig {
  #goal: Pose = kFirstPose;
  #shown: Pose = kFirstPose;
  /** False where a person asked for less motion. */
  smooth = true;
  /** Times the usual one. */
  speed = 1;

  get goal(): Pose {
    return this.#goal;
  }
  get shown(): Pose {
    return this.#shown;
  }

  /** There at once. */
  jump(pose: Pose): void {
    this.move(pose);
    this.#shown = this.#goal;
  }
  /** What is no place is nowhere to go: nothing would come back from there. */
  move(pose: Pose): void {
    if (isPlace(pose)) this.#goal = limited(pose);
  }
  /** Without the turns about itself that it is behind or ahead. */
  moveStraight(pose: Pose): void {
    this.move({ ...pose, yaw: this.#goal.yaw + shortest(pose.yaw - this.#goal.yaw) });
  }

  /** About the target. */
  orbit(yaw: number, pitch: number): void {
    this.move({ ...this.#goal, yaw: this.#goal.yaw + yaw, pitch: this.#goal.pitch + pitch });
  }

  /** About the eye. */
  look(yaw: number, pitch: number): void {
    const eye = eyeOf(this.#goal);
    const turned = limited({ ...this.#goal, yaw: this.#goal.yaw + yaw, pitch: this.#goal.pitch + pitch });
    this.move({ ...turned, target: sub(eye, scale(backwardOf(turned), turned.distance)) });
  }

  /**
   * What is seen there, in focal lengths off the middle, comes to the middle. How far it is nobody knows here, so the eye stays,
   * as does the distance to the target: it is centred however far it is.
   */
  centre(right: number, down: number): void {
    const seen = this.#shown;
    const ray = sub(add(scale(rightOf(seen), right), scale(downOf(seen), down)), backwardOf(seen));
    const [x, y, z] = scale(ray, 1 / length(ray));
    this.look(shortest(Math.atan2(-z, -x) - this.#goal.yaw), Math.asin(-y) - this.#goal.pitch);
  }

  /** That point comes to the middle and is what one orbits; the eye stays. */
  orbitAbout(point: Vec3): void {
    const from = sub(eyeOf(this.#goal), point);
    const [x, y, z] = scale(from, 1 / Math.max(length(from), 1e-12));
    const goal = { target: point, yaw: Math.atan2(z, x), pitch: Math.asin(clamp(y, -1, 1)), distance: length(from) };
    if (!isPlace(goal)) return;
    this.moveStraight(goal);
    // On its way it would come nearer or go farther by the difference: what it orbits lies elsewhere on its axis from now on.
    const { distance } = this.#goal;
    this.#shown = { ...this.#shown, target: sub(eyeOf(this.#shown), scale(backwardOf(this.#shown), distance)), distance };
  }

  /** What is at the target's distance follows by as many of a picture's pixels. */
  pan(right: number, down: number, focal: number): void {
    const pose = this.#goal;
    const metres = pose.distance / focal;
    this.move({ ...pose, target: sub(pose.target, scale(add(scale(rightOf(pose), right), scale(downOf(pose), down)), metres)) });
  }

  /** Times the distance. */
  zoom(factor: number): void {
    this.move({ ...this.#goal, distance: this.#goal.distance * factor });
  }

  fly(motion: Motion, seconds: number): void {
    const pose = this.#goal;
    const speed = Math.max(kSpeed * pose.distance, kSlowest) * this.speed * (motion.fast ? kFaster : 1);
    const ahead = scale(backwardOf(motion.level ? { ...pose, pitch: 0 } : pose), -1);
    const way = add(add(scale(rightOf(pose), motion.right), scale(ahead, motion.ahead)), [0, motion.up, 0]);
    this.move({ ...pose, target: add(pose.target, scale(way, speed * seconds)) });
  }

  /** All of a sphere, from where the camera looks now. A picture that has no size yet will be about as wide as it is high. */
  frame(centre: Vec3, radius: number, width: number, height: number): void {
    const [across, high] = width > 0 && height > 0 ? [width, height] : [1, 1];
    const half = Math.atan(Math.min(across, high) / (2 * focalOf(across, high)));
    this.move({ ...this.#goal, target: centre, distance: (kFramed * radius) / Math.sin(half) });
  }

  /** Comes nearer to the goal; false when it is there. */
  advance(seconds: number): boolean {
    const from = this.#shown;
    const to = this.#goal;
    if (from === to) return false;
    const part = this.smooth ? 1 - Math.exp(-seconds / kSmoothingS) : 1;
    const next: Pose = {
      target: [0, 1, 2].map((k) => mix(from.target[k], to.target[k], part)) as unknown as Vec3,
      yaw: mix(from.yaw, to.yaw, part),
      pitch: mix(from.pitch, to.pitch, part),
      distance: Math.exp(mix(Math.log(from.distance), Math.log(to.distance), part)),
    };
    const left =
      length(sub(eyeOf(next), eyeOf(to))) / to.distance + Math.abs(next.yaw - to.yaw) + Math.abs(next.pitch - to.pitch);
    this.#shown = left < 1e-4 ? to : next;
    return true;
  }
}
