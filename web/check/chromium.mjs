// A headless Chromium and its DevTools protocol over a pipe, and a server of static files.

import { spawn } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
import { extname, join, normalize } from "node:path";

const TYPES = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css",
  ".svg": "image/svg+xml", ".wasm": "application/wasm" };
// A busy machine takes long.
const PATIENCE_MS = 60_000;

// Serves a folder; returns its address.
export function serve(folder) {
  const server = createServer(({ url }, answer) => {
    const path = normalize(new URL(url, "http://here").pathname).replace(/\/$/, "/index.html");
    try {
      const bytes = readFileSync(join(folder, path));
      answer.writeHead(200, { "Content-Type": TYPES[extname(path)] ?? "text/plain" }).end(bytes);
    } catch {
      answer.writeHead(404).end();
    }
  });
  return new Promise((done) => server.listen(0, "127.0.0.1", () => done({
    address: `http://127.0.0.1:${server.address().port}/`, close: () => server.close(),
  })));
}

export class Chromium {
  static async start() {
    const chromium = new Chromium();
    const { targetInfos } = await chromium.send("Target.getTargets");
    const { targetId } = targetInfos.find(({ type }) => type === "page");
    const attach = { targetId, flatten: true };
    chromium.session = (await chromium.send("Target.attachToTarget", attach)).sessionId;
    await chromium.send("Page.enable");
    await chromium.send("Runtime.enable");
    return chromium;
  }

  constructor() {
    this.profile = mkdtempSync(join(tmpdir(), "singletrack-web-"));
    this.process = spawn("chromium", ["--headless=new", "--no-sandbox", "--disable-gpu",
      "--remote-debugging-pipe", `--user-data-dir=${this.profile}`, "about:blank"],
    { stdio: ["ignore", "ignore", "ignore", "pipe", "pipe"] });
    [this.last, this.waiting, this.troubles] = [0, new Map(), []];
    let rest = "";
    this.process.stdio[4].on("data", (bytes) => {
      const messages = (rest + bytes).split("\0");
      rest = messages.pop();
      messages.forEach((message) => this.take(JSON.parse(message)));
    });
  }

  take({ id, result, error, method, params }) {
    if (method === "Runtime.exceptionThrown") {
      this.troubles.push(params.exceptionDetails.exception?.description ?? params.exceptionDetails.text);
    }
    const { resolve, reject } = this.waiting.get(id) ?? {};
    error ? reject?.(new Error(error.message)) : resolve?.(result);
  }

  send(method, params = {}) {
    this.last += 1;
    const message = { id: this.last, method, params, sessionId: this.session };
    this.process.stdio[3].write(`${JSON.stringify(message)}\0`);
    return new Promise((resolve, reject) => this.waiting.set(this.last, { resolve, reject }));
  }

  async run(expression) {
    const given = { expression, awaitPromise: true, returnByValue: true };
    const { result, exceptionDetails } = await this.send("Runtime.evaluate", given);
    if (exceptionDetails) {
      throw new Error(`${expression}: ${exceptionDetails.exception?.description}`);
    }
    return result.value;
  }

  // Waits until an expression is true; returns the time that it took, in s.
  async until(expression) {
    const before = performance.now();
    while (!await this.run(`Boolean(${expression})`)) {
      if (performance.now() - before > PATIENCE_MS) {
        const shown = await this.run("document.querySelector('main')?.innerText.slice(0, 600)");
        throw new Error(`not within ${PATIENCE_MS} ms: ${expression}\n${this.troubles.join("\n")}\n${shown}`);
      }
      await new Promise((done) => setTimeout(done, 20));
    }
    return (performance.now() - before) / 1e3;
  }

  async screenshot(width, height, scheme) {
    const media = [{ name: "prefers-color-scheme", value: scheme }];
    await this.send("Emulation.setEmulatedMedia", { features: media });
    await this.send("Emulation.setDeviceMetricsOverride",
      { width, height, deviceScaleFactor: 1, mobile: width < 500 });
    await this.run("new Promise((done) => setTimeout(done, 600))");
    const { data } = await this.send("Page.captureScreenshot", { captureBeyondViewport: true });
    return Buffer.from(data, "base64");
  }

  async end() {
    const ended = new Promise((done) => this.process.on("exit", done));
    this.process.stdio[3].write(`${JSON.stringify({ id: 0, method: "Browser.close" })}\0`);
    await ended;
    rmSync(this.profile, { recursive: true, force: true });
  }
}
