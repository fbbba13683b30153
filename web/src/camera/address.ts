// What the page's address says: the view, which is there to be shared, and the token, which is not and is taken out.
import type { Pose } from './rig';

export interface Address {
  readonly token: string | null;
  readonly pose: Pose | null;
  readonly options: URLSearchParams;
}

export function poseText(pose: Pose): string {
  const digits = (x: number): string => String(Number(x.toPrecision(5)));
  const turn = ((pose.yaw % (2 * Math.PI)) + 2 * Math.PI) % (2 * Math.PI);
  return [...pose.target.map((x) => Math.round(x * 1e3) / 1e3), turn, pose.pitch, pose.distance].map(digits).join(',');
}

export function poseOf(text: string): Pose | null {
  const numbers = text.split(',').map(Number);
  if (numbers.length !== 6 || !numbers.every(Number.isFinite)) return null;
  const [x, y, z, yaw, pitch, distance] = numbers;
  if (distance <= 0) return null;
  return { target: [x, y, z], yaw, pitch, distance };
}

export function readAddress(url: URL): Address {
  const hash = new URLSearchParams(url.hash.slice(1));
  const token = hash.get('token') ?? url.searchParams.get('token');
  const view = hash.get('view');
  return { token, pose: view === null ? null : poseOf(view), options: url.searchParams };
}

/** The same address without its token, and with this view if there is one. */
export function addressWith(url: URL, pose: Pose | null): string {
  const next = new URL(url);
  next.searchParams.delete('token');
  const hash = new URLSearchParams(next.hash.slice(1));
  hash.delete('token');
  if (pose) hash.set('view', poseText(pose));
  next.hash = hash.toString().replaceAll('%2C', ',');
  return next.href;
}

/** The same to be passed on: who gets it wants to look, not to measure. */
export function sharedAddress(url: URL, pose: Pose): string {
  const next = new URL(addressWith(url, pose));
  for (const name of ['bench', 'seconds']) next.searchParams.delete(name);
  return next.href;
}

const kKeptEveryMs = 500;

/** The page's own address has the view. */
export class KeptAddress {
  #keptMs = 0;

  /** May be called at any time. */
  keep(nowMs: number, pose: Pose): void {
    if (nowMs - this.#keptMs <= kKeptEveryMs) return;
    this.#keptMs = nowMs;
    const here = new URL(location.href);
    if (readAddress(here).token !== null) return; // it has just come, and has not been taken yet
    const address = addressWith(here, pose);
    if (address !== location.href) history.replaceState(null, '', address);
  }
}
