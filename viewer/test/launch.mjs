// Chromium with software WebGL, and a page in it.
//
// CHROMIUM names the browser. PAGE_DIR serves the page's files from a directory instead of from the service.

import { mkdtemp, readFile, rm } from 'node:fs/promises';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { chromium } from 'playwright-core';

const FLAGS = [
  '--headless', '--no-sandbox', '--disable-quic', '--no-first-run', '--disable-background-networking',
  '--disable-component-update', '--disable-sync', '--use-gl=angle', '--use-angle=swiftshader',
  '--enable-unsafe-swiftshader',
];
/** The policy that the service sends with the page. */
const POLICY = /const POLICY: &str = "([^"]*)"/
  .exec(await readFile(new URL('../../service/src/viewer.rs', import.meta.url), 'utf8'))[1]
  .replaceAll(/\\\n\s*/g, '');
const KINDS = { html: 'text/html', js: 'text/javascript', css: 'text/css' };

/** An empty page, and what ends the browser. */
export async function launch(base, viewport) {
  const profile = await mkdtemp(join(tmpdir(), 'rebake-browser-'));
  const context = await chromium.launchPersistentContext(profile, {
    executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
    args: FLAGS,
    viewport,
  });
  const page = await context.newPage();
  if (process.env.PAGE_DIR) {
    await page.route(
      (url) => url.href.startsWith(base) && !url.pathname.startsWith('/v1'),
      async (route) => {
        const name = new URL(route.request().url()).pathname.slice(1) || 'index.html';
        const body = await readFile(join(process.env.PAGE_DIR, name));
        const contentType = KINDS[name.split('.').at(-1)];
        await route.fulfill({ body, contentType, headers: { 'content-security-policy': POLICY } });
      },
    );
  }
  const close = async () => {
    await context.close();
    await rm(profile, { recursive: true, force: true });
  };
  return { page, close };
}
