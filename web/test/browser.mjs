// A headless Chromium and a server of static files, for the tests.
import { createReadStream, existsSync, readdirSync, readFileSync } from 'node:fs';
import { createServer } from 'node:http';
import { extname, join, normalize } from 'node:path';
import { fileURLToPath } from 'node:url';
import { chromium } from 'playwright-core';

export const kChromium = process.env.SPLATBUS_CHROMIUM ?? '/usr/bin/chromium';
export const hasChromium = existsSync(kChromium);

const kTypes = {
  '.html': 'text/html; charset=utf-8',
  '.js': 'text/javascript; charset=utf-8',
  '.css': 'text/css; charset=utf-8',
  '.map': 'application/json',
  '.wasm': 'application/wasm',
  '.svg': 'image/svg+xml',
};

/** Serves the first of `folders` that has a file; `posted` gets the bodies of POSTs as { path, body }. */
export async function serve(folders, posted = []) {
  const server = createServer((request, response) => {
    const path = normalize(new URL(request.url, 'http://localhost').pathname);
    if (request.method === 'POST') {
      let body = '';
      request.on('data', (chunk) => (body += chunk));
      request.on('end', () => {
        posted.push({ path, body });
        response.writeHead(204).end();
      });
      return;
    }
    const file = folders.map((folder) => join(folder, path.endsWith('/') ? 'index.html' : path)).find(existsSync);
    if (!file) return response.writeHead(404).end();
    response.writeHead(200, { 'content-type': kTypes[extname(file)] ?? 'application/octet-stream' });
    createReadStream(file).pipe(response);
  });
  await new Promise((resolve) => server.listen(0, '127.0.0.1', resolve));
  return { url: `http://127.0.0.1:${server.address().port}`, server, close: () => server.close() };
}

/**
 * Chromium with the software devices that it brings, so that WebGL2 and WebGPU both work without a GPU or a display.
 * `more`: further arguments.
 */
export function launch(more = []) {
  return chromium.launch({
    executablePath: process.getuid() === 0 ? fileURLToPath(new URL('chromium.sh', import.meta.url)) : kChromium,
    headless: true,
    args: [
      '--no-sandbox',
      '--use-angle=swiftshader',
      '--enable-unsafe-webgpu',
      '--enable-gpu',
      '--enable-features=Vulkan',
      '--use-vulkan=swiftshader',
      '--disable-dev-shm-usage',
      ...more,
    ],
  });
}

/** The processes of browsers that this one has started and that run now. */
export function browserProcesses() {
  const parents = new Map();
  for (const pid of readdirSync('/proc').filter((name) => /^\d+$/.test(name)).map(Number)) {
    try {
      const [, name, parent] = readFileSync(`/proc/${pid}/stat`, 'utf8').match(/^\d+ \((.*)\) \S (\d+)/s);
      parents.set(pid, { name, parent: Number(parent) });
    } catch {
      // it has ended
    }
  }
  const isOurs = (pid) => pid === process.pid || (parents.has(pid) && isOurs(parents.get(pid).parent));
  return new Set([...parents].filter(([pid, { name }]) => name.startsWith('chrom') && isOurs(pid)).map(([pid]) => pid));
}

/** Every picture that the page comes to show from now on; call what this returns for them, as PNG. */
export async function filmed(page) {
  const session = await page.context().newCDPSession(page);
  const pictures = [];
  session.on('Page.screencastFrame', ({ data, sessionId }) => {
    pictures.push(Buffer.from(data, 'base64'));
    session.send('Page.screencastFrameAck', { sessionId }).catch(() => {}); // the page may be closed
  });
  await session.send('Page.startScreencast', { format: 'png' });
  return async () => {
    await session.send('Page.stopScreencast');
    return pictures;
  };
}
