// A real pipeline, whose gateway serves the page.
import { spawn } from 'node:child_process';
import { mkdtempSync, rmSync, writeFileSync } from 'node:fs';
import { createServer } from 'node:net';
import { tmpdir } from 'node:os';
import { join } from 'node:path';

const { SPLATBUS_WEB: site, SPLATBUS_BIN: bin } = process.env;

/** A port that nobody listens on now. */
export const freePort = () =>
  new Promise((resolve) => {
    const server = createServer().listen(0, '127.0.0.1', () => {
      const { port } = server.address();
      server.close(() => resolve(port));
    });
  });

export async function until(condition) {
  while (!(await condition())) await new Promise((resolve) => setTimeout(resolve, 50));
}

const serviceOf = ([name, parameters]) => `  - name: ${name}
    program: splatbus-gateway
    parameters: ${JSON.stringify({ web_root: site, ...parameters })}
`;

/**
 * Of the toy scene that lives; `capture`: parameters of the capture-bridge. `gateways`: parameters of further ones besides
 * the one that serves anybody here, by the names of their processes.
 */
export async function startPipeline(capture, gateways = {}) {
  const folder = mkdtempSync(join(tmpdir(), 'splatbus-live-'));
  const port = await freePort();
  const url = `http://127.0.0.1:${port}`;
  const services = `
services:
  - name: bus
  - name: engine
    program: splatbus-engine-sim
    args: [--dynamics, --sun-rate, "6"]
  - name: capture-bridge
    parameters: ${JSON.stringify({ ...capture, reference_rig: 'ring' })}
  - name: expander
  - name: trainer
  - name: relight
  - name: streamer
    parameters: {join_kbps: 50000}
  - name: gateway
    parameters: {http: "127.0.0.1:${port}", web_root: "${site}"}
${Object.entries(gateways).map(serviceOf).join('')}`;
  writeFileSync(join(folder, 'live.yaml'), services);
  const env = { ...process.env, XDG_STATE_HOME: join(folder, 'state') };  // log files
  const bus = `ipc://${folder}/bus`;
  const launched = spawn(join(bin, 'splatbus'), ['launch', join(folder, 'live.yaml'), '--bus', bus], { stdio: ['ignore', 'pipe', 'pipe'], env });
  let said = '';
  for (const stream of [launched.stdout, launched.stderr]) stream.on('data', (text) => (said = (said + text).slice(-4000)));
  const ended = new Promise((resolve) => launched.once('exit', resolve));
  /** Of the gateway, as soon as there is one. */
  const status = async () => {
    for (;;) {
      try {
        return await (await fetch(`${url}/status`)).json();
      } catch {
        if (launched.exitCode !== null) throw new Error(`the pipeline has ended: ${said}`);
        await new Promise((resolve) => setTimeout(resolve, 50));
      }
    }
  };
  await status();
  return {
    url,
    status,
    /** Kills a service; what it returns waits until another one lives. */
    async kill(source) {
      const service = async () => (await status()).services.find((one) => one.source === source);
      const { pid } = await service();
      process.kill(pid, 'SIGKILL');
      return () =>
        until(async () => {
          const now = await service();
          return now && now.pid !== pid && now.alive;
        });
    },
    async restarted(source) {
      await (await this.kill(source))();
    },
    /** What an operator types; returns what it prints, and throws that when it fails. */
    async verb(...words) {
      const verb = spawn(join(bin, 'splatbus'), [...words, '--bus', bus], { stdio: ['ignore', 'pipe', 'pipe'], env });
      let answer = '';
      for (const stream of [verb.stdout, verb.stderr]) stream.on('data', (text) => (answer += text));
      const code = await new Promise((resolve) => verb.once('close', resolve));
      if (code !== 0) throw new Error(`splatbus ${words.join(' ')}: ${answer}`);
      return answer;
    },
    /** Puts another process in a service's place. */
    swap(source) {
      return this.verb('swap', source);
    },
    folder,
    async close() {
      launched.kill('SIGINT');
      await ended;
      rmSync(folder, { recursive: true, force: true });
    },
  };
}
