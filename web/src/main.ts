import { addressWith, readAddress, type Address } from './camera/address';
import type { Pose } from './camera/rig';
import type { Api } from './render/make_renderer';
import { texts } from './texts';
import { loadSettings } from './ui/settings';
import { Viewer } from './viewer';

const kFlightS = 20;
const kTokenKey = 'splatbus.token';

/** Once given it is known until the tab is closed, and nowhere else. */
function keptToken(given: string | null): string | null {
  try {
    if (given !== null) sessionStorage.setItem(kTokenKey, given);
    return given ?? sessionStorage.getItem(kTokenKey);
  } catch {
    return given;
  }
}

function wantedApi(options: URLSearchParams): Api | null {
  const gpu = options.get('gpu');
  return gpu === 'webgl2' || gpu === 'webgpu' ? gpu : null;
}

/** `bench=1` asks for a flight, `seconds` says how long it is. */
function flightSeconds(options: URLSearchParams): number {
  if (options.get('bench') !== '1') return 0;
  const seconds = Number(options.get('seconds'));
  return seconds > 0 ? seconds : kFlightS;
}

/** What the address says, which says no token any more then. */
function takeAddress(): Address {
  const url = new URL(location.href);
  const address = readAddress(url);
  if (address.token !== null) history.replaceState(null, '', addressWith(url, null));
  return address;
}

const address = takeAddress();
const socket = new URL('stream', location.href);
socket.protocol = location.protocol === 'https:' ? 'wss:' : 'ws:';
socket.search = '';
socket.hash = '';

document.title = texts.title;
const viewer = new Viewer(document.body, {
  api: wantedApi(address.options),
  socket: socket.href,
  token: keptToken(address.token),
  mip: address.options.get('mip') !== '0',
  settings: loadSettings(),
  bench: flightSeconds(address.options),
});
const show = (pose: Pose | null): void => {
  if (!pose) return;
  viewer.rig.jump(pose);
  viewer.overview.keepView();
};
show(address.pose);
// As when somebody pastes the link that they were given into the tab that asks for it.
addEventListener('hashchange', () => {
  const { token, pose } = takeAddress();
  if (token !== null) viewer.useToken(keptToken(token));
  show(pose);
});
viewer.start();
// For whoever measures or tests the page.
Object.assign(window, { splatbus: viewer });
