// Bundles the page: node build.mjs OUT [--watch]. With --tests also the pages that tests drive, into OUT itself.
import { cp, mkdir } from 'node:fs/promises';
import { createRequire } from 'node:module';
import { dirname, join, resolve } from 'node:path';
import { fileURLToPath } from 'node:url';
import { parseArgs } from 'node:util';

// Of the lock file; where npm has installed nothing, Debian's, which require() alone finds.
const { build, context } = createRequire(import.meta.url)('esbuild');
const here = dirname(fileURLToPath(import.meta.url));
const { values, positionals } = parseArgs({
  allowPositionals: true,
  options: { tests: { type: 'boolean' }, watch: { type: 'boolean' } },
});
const out = positionals[0] && resolve(positionals[0]);
if (!out) {
  console.error('usage: node build.mjs OUT [--tests] [--watch]');
  process.exit(2);
}

const entries = values.tests
  ? {
      picture_page: 'test/page/picture_page.ts',
      stream_worker: 'test/page/fake_stream_worker.ts',
      logic: 'test/logic.ts',
    }
  : { app: 'src/main.ts', stream_worker: 'src/stream/stream_worker.ts', sort_worker: 'src/stream/sort_worker.ts', metrics_worker: 'src/compare/metrics_worker.ts' };
const options = {
  absWorkingDir: here,
  entryPoints: entries,
  outdir: out,
  bundle: true,
  loader: { '.glsl': 'text' },
  format: 'esm',
  target: ['es2022'],
  minify: !values.tests,
  sourcemap: 'linked',
  legalComments: 'none',
  logLevel: 'warning',
};
await mkdir(out, { recursive: true });
await cp(join(here, values.tests ? 'test/page/static' : 'static'), out, { recursive: true });
if (values.watch) {
  await (await context(options)).watch();
} else {
  await build(options);
}
