// Debian's Firefox, driven by its own Marionette over a socket: no driver besides it is needed.
import { spawn } from 'node:child_process';
import { existsSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { connect } from 'node:net';
import { tmpdir } from 'node:os';
import { join } from 'node:path';

export const kFirefox = process.env.SPLATBUS_FIREFOX ?? '/usr/bin/firefox-esr';
export const hasFirefox = existsSync(kFirefox);
const kXvfb = process.env.SPLATBUS_XVFB ?? '/usr/bin/Xvfb';

const kPreferences = {
  'marionette.port': 0, // it says which

  'webgl.force-enabled': true, // of a software driver too
  'webgl.disabled': false,
  'dom.webgpu.enabled': false,
  'app.update.enabled': false,
  'browser.shell.checkDefaultBrowser': false,
  'datareporting.policy.dataSubmissionEnabled': false,
  'toolkit.telemetry.enabled': false,
  'network.captive-portal-service.enabled': false,
  'network.connectivity-service.enabled': false,
  'browser.safebrowsing.update.enabled': false,
  'extensions.systemAddon.update.enabled': false,
};

/** Marionette's messages: the length in bytes, ':', and JSON; [0, id, command, parameters], [1, id, error, result]. */
class Marionette {
  #socket;
  #bytes = Buffer.alloc(0);
  #waiting = new Map();
  #calls = 0;

  static async at(port) {
    const marionette = new Marionette();
    await new Promise((resolve, reject) => {
      marionette.#socket = connect(port, '127.0.0.1');
      marionette.#socket.on('data', (data) => marionette.#take(data, resolve));
      marionette.#socket.on('error', reject);
      marionette.#socket.on('close', () => marionette.#waiting.forEach((call) => call.reject(new Error('Firefox has ended'))));
    });
    return marionette;
  }

  call(command, parameters = {}) {
    const text = JSON.stringify([0, ++this.#calls, command, parameters]);
    this.#socket.write(`${Buffer.byteLength(text)}:${text}`);
    return new Promise((resolve, reject) => this.#waiting.set(this.#calls, { resolve, reject }));
  }

  close() {
    this.#socket.destroy();
  }

  #take(data, greeted) {
    this.#bytes = Buffer.concat([this.#bytes, data]);
    for (;;) {
      const colon = this.#bytes.indexOf(':');
      const end = colon + 1 + Number(this.#bytes.subarray(0, Math.max(colon, 0)));
      if (colon < 0 || this.#bytes.length < end) return;
      const message = JSON.parse(this.#bytes.subarray(colon + 1, end));
      this.#bytes = this.#bytes.subarray(end);
      if (!Array.isArray(message)) {
        greeted(); // who it is
        continue;
      }
      const [, id, error, result] = message;
      const call = this.#waiting.get(id);
      this.#waiting.delete(id);
      if (error) call?.reject(new Error(error.message));
      else call?.resolve(result);
    }
  }
}

/** A display that nobody sees: without one Firefox has no WebGL2. */
async function startDisplay(width, height) {
  const args = ['-displayfd', '3', '-screen', '0', `${width + 100}x${height + 200}x24`, '-nolisten', 'tcp'];
  const server = spawn(kXvfb, args, { stdio: ['ignore', 'ignore', 'ignore', 'pipe'] });
  const number = await new Promise((resolve, reject) => {
    server.stdio[3].once('data', (data) => resolve(String(data).trim()));
    server.once('exit', (status) => reject(new Error(`Xvfb ended with ${status}`)));
    server.once('error', reject);
  });
  const ended = new Promise((resolve) => server.once('exit', resolve));
  return {
    name: `:${number}`,
    async close() {
      server.kill();
      await ended;
    },
  };
}

const kPatienceMs = 60_000;
const kShown = `{
  text: document.body?.innerText.slice(0, 500),
  figures: window.splatbus?.figures,
  connection: window.splatbus?.connection,
  standing: window.splatbus?.stage?.standing,
  comparison: window.splatbus?.extras && { on: window.splatbus.extras.comparison.on, text: window.splatbus.extras.comparison.element.innerText },
}`;
const pause = () => new Promise((resolve) => setTimeout(resolve, 100));

/** One page of a Firefox of its own. */
export async function launchFirefox({ width, height }) {
  const profile = mkdtempSync(join(tmpdir(), 'splatbus-firefox-'));
  const preferences = Object.entries(kPreferences).map(([key, value]) => `user_pref(${JSON.stringify(key)}, ${JSON.stringify(value)});`);
  writeFileSync(join(profile, 'user.js'), preferences.join('\n'));
  const display = await startDisplay(width, height);
  const env = { ...process.env, HOME: profile, DISPLAY: display.name, MOZ_ENABLE_WAYLAND: '0', LIBGL_ALWAYS_SOFTWARE: '1' };
  const firefox = spawn(kFirefox, ['--no-remote', '--profile', profile, '--marionette'], { stdio: 'ignore', env });
  const ended = new Promise((resolve) => firefox.once('exit', resolve));
  const close = async () => {
    firefox.kill();
    await ended;
    await display.close();
    rmSync(profile, { recursive: true, force: true, maxRetries: 5 });
  };
  try {
    const file = join(profile, 'MarionetteActivePort');
    while (!existsSync(file) || readFileSync(file, 'utf8') === '') {
      if (firefox.exitCode !== null) throw new Error(`Firefox ended with ${firefox.exitCode}`);
      await pause();
    }
    const marionette = await Marionette.at(Number(readFileSync(file, 'utf8')));
    await marionette.call('WebDriver:NewSession', {});
    await marionette.call('WebDriver:SetTimeouts', { script: 600_000, pageLoad: 600_000 });
    await marionette.call('WebDriver:SetWindowRect', { width, height: height + 90 }); // with its own bars
    const evaluate = async (expression) =>
      (await marionette.call('WebDriver:ExecuteScript', { script: `return (${expression});`, args: [], sandbox: null })).value;
    return {
      /** What an expression is in the page, by JSON. */
      evaluate,
      goto: (url) => marionette.call('WebDriver:Navigate', { url }),
      /** Until it is so; after a minute it throws what the page shows and says. */
      async waitFor(expression) {
        const until = Date.now() + kPatienceMs;
        while (!(await evaluate(expression))) {
          if (Date.now() > until) throw new Error(`${expression}: not so after ${kPatienceMs / 1000} s; ${JSON.stringify(await evaluate(kShown))}`);
          await pause();
        }
      },
      press: (key) =>
        marionette.call('WebDriver:PerformActions', {
          actions: [{ type: 'key', id: 'keys', actions: [{ type: 'keyDown', value: key }, { type: 'keyUp', value: key }] }],
        }),
      screenshot: async () => Buffer.from((await marionette.call('WebDriver:TakeScreenshot', { full: false })).value, 'base64'),
      async close() {
        marionette.close();
        await close();
      },
    };
  } catch (error) {
    await close();
    throw error;
  }
}
