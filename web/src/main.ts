import { addressWith, readAddress } from './camera/address';
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

const url = new URL(location.href);
const address = readAddress(url);
if (address.token !== null) history.replaceState(null, '', addressWith(url, null));

const socket = new URL('stream', url);
socket.protocol = url.protocol === 'https:' ? 'wss:' : 'ws:';
socket.search = '';
socket.hash = '';

document.title = texts.title;
const viewer = new Viewer(document.body, {
  api: wantedApi(address.options),
  socket: socket.href,
  token: keptToken(address.token),
  settings: loadSettings(),
  bench: flightSeconds(address.options),
});
const show = (): void => {
  const { pose } = readAddress(new URL(location.href));
  if (!pose) return;
  viewer.rig.jump(pose);
  viewer.keepView();
};
show();
addEventListener('hashchange', show);
viewer.start();
// For whoever measures or tests the page.
Object.assign(window, { splatbus: viewer });
