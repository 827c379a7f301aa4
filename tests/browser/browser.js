// Debian's Chromium under Playwright, and what must hold of every page that it shows.
import { mkdirSync } from 'node:fs';
import { join } from 'node:path';
import axe from 'axe-core';
import { chromium } from 'playwright-core';
import { OUTPUT, PATIENCE_MS } from './service.js';

const DESKTOP = { width: 1280, height: 1000 };
const PHONE = { width: 390, height: 844 };
// Pages higher than this are kept as far as the window shows them.
const TALLEST_PX = 6000;

export class Browser {
  // `folder` is where its screenshots go, below the output of the whole run.
  static async open(folder) {
    const browser = new Browser();
    browser.folder = join(OUTPUT, folder);
    mkdirSync(browser.folder, { recursive: true });
    browser.chromium = await chromium.launch({
      executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
      // Without a GPU, WebGL is drawn in software; pages of our own are to be trusted with that.
      args: ['--no-sandbox', '--disable-gpu', '--enable-unsafe-swiftshader', '--disable-dev-shm-usage'],
    });
    browser.context = await browser.chromium.newContext({ viewport: DESKTOP, colorScheme: 'light' });
    browser.context.setDefaultTimeout(PATIENCE_MS);
    return browser;
  }

  close() {
    return this.chromium.close();
  }

  // A new tab, which keeps what goes wrong in it: errors of the console and of scripts, and requests to other hosts.
  async tab(origin) {
    const page = await this.context.newPage();
    page.wrongs = [];
    page.on('pageerror', (error) => page.wrongs.push(`a script failed: ${error.message}`));
    page.on('console', (message) => {
      if (message.type() !== 'error') return;
      // That a page is not there is an error of the console, too: the one that was asked for.
      const isPageItself = message.location().url === page.url() && / status of 4\d\d/.test(message.text());
      if (!isPageItself) page.wrongs.push(`the console says: ${message.text()} (${message.location().url})`);
    });
    page.on('request', (request) => {
      const { protocol, origin: asked } = new URL(request.url());
      if (asked !== origin && !['data:', 'blob:'].includes(protocol)) page.wrongs.push(`asks for ${request.url()}`);
    });
    return page;
  }

  // Keeps a picture of the page.
  async keep(page, name) {
    const height = await page.evaluate(() => document.documentElement.scrollHeight);
    await page.screenshot({ path: join(this.folder, `${name}.png`), fullPage: height <= TALLEST_PX, animations: 'disabled' });
  }

  // Looks at the open page in light and dark colours and on a phone. Keeps a picture of each, and answers with what is
  // wrong. Only contrast depends on the colours.
  async audit(page, name) {
    await page.evaluate(axe.source);
    const wrongs = [];
    const look = async (as, rules) => {
      const found = await page.evaluate(async (options) => {
        const { violations } = await window.axe.run(document, options);
        const isWide = document.documentElement.scrollWidth > innerWidth;
        return { violations, isWide };
      }, { resultTypes: ['violations'], ...(rules && { runOnly: { type: 'rule', values: rules } }) });
      if (found.isWide) wrongs.push(`${name}, ${as}: scrolls sideways`);
      for (const { id, impact, help, nodes } of found.violations) {
        wrongs.push(`${name}, ${as}: ${impact}: ${help} (${id}): ${nodes.map((node) => `${node.target} ${node.failureSummary ?? ''}`).join('; ')}`);
      }
      await this.keep(page, `${name}-${as}`);
    };
    await look('light');
    await page.emulateMedia({ colorScheme: 'dark' });
    await look('dark', ['color-contrast']);
    await page.setViewportSize(PHONE);
    await look('phone');
    await page.emulateMedia({ colorScheme: 'light' });
    await page.setViewportSize(DESKTOP);
    return wrongs;
  }
}
