// Who is let in, asked by pages of a real browser of real gateways: by token, by origin and host, by certificate. What a
// gateway counts of those that it turned away says why it did.
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { createHash } from 'node:crypto';
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { createServer } from 'node:http';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { launch } from './browser.mjs';
import { freePort, startPipeline, until } from './pipeline.mjs';

const kCapture = { input_cameras: 4, input_size: 48, sample_budget: 3000, reference_cameras: 2, reference_size: 48, reference_rate_hz: 0.2 };
const kViewer = 'a-token-of-one-who-looks';
const kOwner = 'a-token-of-one-who-may-probe';
const kOther = 'rebound.example'; // a name that somebody else has resolve to this machine
let folder;
let tokens;
let pipeline;
let browser;
let elsewhere;
const urls = {};

/** A line of the tokens' file. */
const lineOf = (rights, token) => `${rights} ${createHash('sha256').update(token).digest('hex')}\n`;
const allowAll = () => writeFileSync(tokens, lineOf('view', kViewer) + lineOf('view,probe', kOwner), { mode: 0o600 });

/** For localhost alone, signed by itself; what Chromium knows its key by. */
function makeCertificate() {
  const [certificate, key] = ['certificate.pem', 'key.pem'].map((name) => join(folder, name));
  const asked = ['req', '-x509', '-newkey', 'ec', '-pkeyopt', 'ec_paramgen_curve:prime256v1', '-nodes', '-days', '1'];
  const named = ['-subj', '/CN=localhost', '-addext', 'subjectAltName=DNS:localhost,IP:127.0.0.1'];
  execFileSync('openssl', [...asked, ...named, '-keyout', key, '-out', certificate], { stdio: 'ignore' });
  const text = execFileSync('openssl', ['x509', '-in', certificate, '-noout', '-pubkey'], { encoding: 'utf8' });
  const publicKey = Buffer.from(text.replace(/-----.*-----|\s/g, ''), 'base64');
  return { certificate, key, pin: createHash('sha256').update(publicKey).digest('base64') };
}
let made;

before(async () => {
  folder = mkdtempSync(join(tmpdir(), 'splatbus-access-'));
  tokens = join(folder, 'tokens');
  allowAll();
  made = makeCertificate();
  elsewhere = createServer((_, response) => response.writeHead(200, { 'content-type': 'text/html' }).end('<title>Another site</title>'));
  await new Promise((resolve) => elsewhere.listen(0, '127.0.0.1', resolve));
  urls.elsewhere = `http://127.0.0.1:${elsewhere.address().port}`;
  const ports = { guarded: await freePort(), befriended: await freePort(), secure: await freePort() };
  const http = (name) => `127.0.0.1:${ports[name]}`;
  urls.guarded = `http://${http('guarded')}`;
  urls.befriended = `http://${http('befriended')}`;
  urls.secure = `https://${http('secure')}`;
  pipeline = await startPipeline(kCapture, {
    guarded: { http: http('guarded'), tokens },
    befriended: { http: http('befriended'), origins: urls.elsewhere },
    secure: { http: http('secure'), tokens, certificate: made.certificate, key: made.key },
  });
  urls.open = pipeline.url;
  browser = await launch([`--host-resolver-rules=MAP ${kOther} 127.0.0.1`]);
});
after(async () => {
  await browser?.close();
  await pipeline?.close();
  elsewhere?.close();
  rmSync(folder, { recursive: true, force: true });
});

/** With no other page's storage, where tokens are kept. */
async function opened(url, run, of = browser) {
  const context = await of.newContext({ viewport: { width: 240, height: 160 } });
  const page = await context.newPage();
  page.setDefaultTimeout(60_000);
  try {
    if (url) await page.goto(url);
    await run(page);
  } finally {
    await context.close();
  }
}

const showsTheModel = (page) =>
  page.waitForFunction(() => window.splatbus?.stage.standing && window.splatbus.connection === 'open' && window.splatbus.figures?.gaussians > 1000);
const says = (page, text) => page.waitForFunction((part) => document.querySelector('.notice')?.textContent.includes(part), text);
/** How many a gateway has turned away for this reason. */
const refused = async (url, why) => {
  const answer = await fetch(`${url}/status`, { headers: { authorization: `Bearer ${kOwner}` } });
  return (await answer.json()).gateway.refused[why];
};

/** What becomes of a WebSocket that the page opens; how an HTTP request of it ends besides, by what its script sees. */
const tries = (page, url, protocols = ['splatbus.stream.1']) =>
  page.evaluate(
    async ([at, asked]) => {
      const socket = await new Promise((resolve) => {
        const made = new WebSocket(`${at.replace('http', 'ws')}/stream`, asked);
        made.onopen = () => resolve('open');
        made.onclose = () => resolve('refused');
      });
      const status = await fetch(`${at}/status`).then((answer) => answer.status, () => 'unreadable');
      return { socket, status };
    },
    [url, protocols],
  );

test('who has the token sees the model and may do what it is for; it is gone from the address', () =>
  opened(`${urls.guarded}/#token=${kViewer}`, async (page) => {
    await showsTheModel(page);
    assert.ok(!page.url().includes(kViewer), page.url());
    await page.reload(); // it is kept as long as the tab is open
    await showsTheModel(page);
    await page.keyboard.press('c');
    await says(page, 'may not ask the engine');
    await page.keyboard.press('m');
    const download = page.waitForEvent('download');
    await page.getByRole('button', { name: '.ply' }).click();
    assert.equal(readFileSync(await (await download).path()).subarray(0, 4).toString(), 'ply\n');
  }));

for (const [who, suffix, text] of [
  ['no token', '', 'asks for a token'],
  ['a wrong token', '/#token=a-token-of-nobody', 'does not accept the token'],
  ['a token that no subprotocol can say', '/#token=a%20token', 'does not accept the token'],
]) {
  test(`who has ${who} is told so in words, and is sent nothing`, async () => {
    const before = await refused(urls.guarded, 'token');
    await opened(urls.guarded + suffix, async (page) => {
      await says(page, text);
      const { standing, bytes } = await page.evaluate(() => ({ standing: window.splatbus.stage.standing, bytes: window.splatbus.figures?.bytes ?? 0 }));
      assert.deepEqual({ standing, bytes }, { standing: false, bytes: 0 });
    });
    assert.ok((await refused(urls.guarded, 'token')) > before);
  });
}

test('who has no token may paste the link that has one into the same tab', () =>
  opened(urls.guarded, async (page) => {
    await says(page, 'asks for a token');
    await page.evaluate(() => (window.sameDocument = true));
    await page.goto(`${urls.guarded}/#token=${kViewer}`);
    await showsTheModel(page);
    assert.ok(await page.evaluate(() => window.sameDocument), 'as an address bar does with a link to the same page');
    assert.ok(!page.url().includes(kViewer), page.url());
    await page.keyboard.press('m');
    const download = page.waitForEvent('download');
    await page.getByRole('button', { name: '.ply' }).click();
    assert.equal(readFileSync(await (await download).path()).subarray(0, 4).toString(), 'ply\n');
  }));

test('a token that is taken away ends what its page gets, until it is given back; the picture stands', () =>
  opened(`${urls.guarded}/#token=${kViewer}`, async (page) => {
    await showsTheModel(page);
    writeFileSync(tokens, lineOf('view,probe', kOwner));
    await says(page, 'does not accept the token');
    assert.ok(await page.evaluate(() => window.splatbus.stage.standing && window.splatbus.connection !== 'open'));
    allowAll();
    await page.waitForFunction(() => window.splatbus.connection === 'open' && document.querySelector('.notice').textContent === '');
    await showsTheModel(page);
  }));

test('pages of another origin are refused, those of our own and of one that is named are not', async () => {
  const before = await refused(urls.open, 'origin');
  await opened(urls.elsewhere, async (page) => {
    assert.deepEqual(await tries(page, urls.open), { socket: 'refused', status: 'unreadable' });
    assert.equal((await refused(urls.open, 'origin')) - before, 2, 'the socket and the request');
    assert.equal((await tries(page, urls.befriended)).socket, 'open');
    // Whatever it knows: an origin is no question of tokens.
    assert.equal((await tries(page, urls.guarded, ['splatbus.stream.1', `splatbus.token.${kViewer}`])).socket, 'refused');
  });
  await opened(urls.open, async (page) => assert.deepEqual(await tries(page, urls.open), { socket: 'open', status: 200 }));
});

test('a page of another site cannot frame ours', () =>
  opened(urls.elsewhere, async (page) => {
    await page.evaluate((url) => {
      document.body.append(Object.assign(document.createElement('iframe'), { src: url }));
    }, urls.open);
    await until(() => page.frames().length === 2);
    await page.frames()[1].waitForLoadState();
    assert.equal(await page.frames()[1].evaluate(() => Boolean(window.splatbus)), false);
  }));

test('a name that somebody has resolve to this machine is refused where nothing else protects us', async () => {
  const before = await refused(urls.open, 'host');
  await opened(null, async (page) => {
    const answer = await page.goto(urls.open.replace('127.0.0.1', kOther));
    assert.equal(answer.status(), 421);
    assert.equal((await tries(page, urls.open.replace('127.0.0.1', kOther))).socket, 'refused');
  });
  assert.ok((await refused(urls.open, 'host')) >= before + 2);
  // A token does; this one is of who may also ask the engine for its picture.
  await opened(`${urls.guarded.replace('127.0.0.1', kOther)}/#token=${kOwner}`, async (page) => {
    await showsTheModel(page);
    await page.keyboard.press('c');
    await page.waitForFunction(() => window.splatbus.extras.comparison.quality);
  });
});

test('by TLS the page and its stream come to who trusts the certificate, and to nobody else', async () => {
  await opened(null, async (page) => {
    await assert.rejects(page.goto(urls.secure), /ERR_CERT_AUTHORITY_INVALID/);
    await assert.rejects(page.goto(urls.secure.replace('https', 'http')), /ERR_/, 'without TLS');
  });
  const trusting = await launch([`--ignore-certificate-errors-spki-list=${made.pin}`]);
  try {
    await opened(`${urls.secure}/#token=${kViewer}`, async (page) => {
      await showsTheModel(page);
      assert.match(await page.evaluate(() => window.splatbus.link.options.socket), /^wss:/);
      assert.ok(await page.evaluate(() => isSecureContext));
    }, trusting);
  } finally {
    await trusting.close();
  }
});
