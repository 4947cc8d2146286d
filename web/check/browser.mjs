// The laboratory in Chromium:
//     node browser.mjs SITE RECORD DIGEST FOLDER
// It opens, drives, has the digest of the scenario, replays a dropped record, drives by an own
// controller, and shows mistakes. Screenshots go to the folder.

import assert from "node:assert/strict";
import { writeFileSync } from "node:fs";
import { join } from "node:path";

import { Chromium, serve } from "./chromium.mjs";

const [site, record, digest, folder] = process.argv.slice(2);
const server = await serve(site);
const chromium = await Chromium.start();
const click = (id) => chromium.run(`document.getElementById("${id}").click()`);
const shown = (id) => chromium.run(`document.getElementById("${id}").textContent`);
const choose = (id, value) => chromium.run(`{ const it = document.getElementById("${id}");
  it.value = ${JSON.stringify(value)}; it.dispatchEvent(new Event("change", { bubbles: true })); }`);
const open = async (fragment) => {
  await chromium.send("Page.navigate", { url: "about:blank" });
  await chromium.send("Page.navigate", { url: `${server.address}${fragment}` });
};
// To the errors of P in the last seconds of the drive, in mm.
const error = async () => Number.parseFloat(await shown("error"));

// Opens, and drives.
let begin = performance.now();
await open("");
await chromium.until("Number(document.body?.dataset.driven) > 0");
console.log(`first moving car ${((performance.now() - begin) / 1e3).toFixed(2)} s after opening`);
for (const [width, height] of [[1280, 900], [768, 1024], [390, 844]]) {
  for (const scheme of ["light", "dark"]) {
    writeFileSync(join(folder, `${width}-${scheme}.png`), await chromium.screenshot(width, height, scheme));
  }
  const excess = await chromium.run("document.documentElement.scrollWidth - innerWidth");
  assert.ok(excess <= 0, `at ${width} pixels the page is wider than the window`);
}

// As fast as it goes, with the digest of the command line.
await click("restart");
await choose("speed", "Infinity");
begin = performance.now();
await chromium.until('document.getElementById("digest").textContent');
assert.match(await shown("digest"), new RegExp(`Digest ${digest},`));
console.log(`digest ${digest}, after ${((performance.now() - begin) / 1e3).toFixed(2)} s`);

// A dropped record.
const { root } = await chromium.send("DOM.getDocument");
const { nodeId } = await chromium.send("DOM.querySelector", { nodeId: root.nodeId, selector: "#file" });
await chromium.send("DOM.setFileInputFiles", { nodeId, files: [record] });
await chromium.run(`{ const { files } = document.getElementById("file");
  const dataTransfer = new DataTransfer(); dataTransfer.items.add(files[0]);
  document.getElementById("verdict").textContent = "";
  dispatchEvent(new DragEvent("drop", { dataTransfer, cancelable: true })); }`);
await chromium.until('document.getElementById("verdict").textContent.includes("Digest")');
assert.match(await shown("verdict"), new RegExp(`every output the same to the bit[^]*Digest ${digest}`));
writeFileSync(join(folder, "record.png"), await chromium.screenshot(1280, 900, "light"));

// The controller of an exercise, completed by its feed-forward.
await open("#exercise=lab-1");
await chromium.until("Number(document.body?.dataset.driven) > 0");
await chromium.run(`{ const code = document.getElementById("code"); code.value = code.value.replace(
  "[K * (x - px), K * (y - py)]", "[K * (x - px) - w * y, K * (y - py) + w * x]")
  .replace("K = 1.0", "K = 2.0"); }`);
await click("run-code");
await choose("speed", "20");
await chromium.until('Number.parseFloat(document.getElementById("drive-time").textContent) > 20');
console.log(`own controller: P is ${await error()} mm from its goal`);
assert.ok(await error() < 10);
writeFileSync(join(folder, "own.png"), await chromium.screenshot(1280, 900, "light"));
await chromium.run('document.getElementById("code").value = "function control() { for (;;) {} }"');
await click("run-code");
await chromium.until('document.getElementById("code-mistake").textContent.includes("endless loop")');

// A link has the whole set-up; a mistake has the text of the command line.
await open("#exercise=lab-2");
await chromium.until("Number(document.body?.dataset.driven) > 0");
await click("share");
await chromium.until('location.hash.startsWith("#setup=")');
const fragment = await chromium.run("location.hash");
await open(fragment);
await chromium.until("Number(document.body?.dataset.driven) > 0");
assert.equal(await chromium.run('document.getElementById("dl").value'), "50.0");
await chromium.run(`{ const toml = document.getElementById("toml");
  toml.value = toml.value.replace("duration_s", "duration"); }`);
await click("use");
await chromium.until('document.getElementById("mistake").textContent.includes("duration")');
// P is dragged from where it begins, which turns the car. The map of stability is drawn.
await open("#exercise=lab-3");
await chromium.until("Number(document.body?.dataset.driven) > 0");
await click("restart");
await click("pause");
await chromium.run('document.getElementById("stability").open = true');
const before = await chromium.run('document.querySelector("[data-key=\\"start.yaw_deg\\"]").value');
// The view shows the circle, P at (1.5, -0.5) m, the car behind it, and 0.4 m around.
const at = await chromium.run(`{ const { left, top, width, height } = document.getElementById("view").getBoundingClientRect();
  const scale = Math.min((width - 44) / 3.5, (height - 44) / 2.8);
  [left + width / 2 + (1.5 - 0.35) * scale, top + height / 2 + 0.5 * scale]; }`);
for (const [type, dx] of [["mousePressed", 0], ["mouseMoved", 40], ["mouseReleased", 40]]) {
  await chromium.send("Input.dispatchMouseEvent",
    { type, x: at[0] + dx, y: at[1], button: "left", buttons: 1, clickCount: 1 });
}
await chromium.until(`document.querySelector('[data-key="start.yaw_deg"]').value !== "${before}"`);
await chromium.until('document.getElementById("stability-text").textContent.includes("with the servo")');
console.log(await shown("stability-text"));
writeFileSync(join(folder, "stability.png"), await chromium.screenshot(1280, 900, "light"));

// Hands: without the cable the board stops the car.
await open("");
await chromium.until("Number(document.body?.dataset.driven) > 0");
await chromium.run("document.querySelector('[data-fault=cable]').click()");
await chromium.until('document.getElementById("mode").textContent.toLowerCase() !== "driving"');

assert.deepEqual(chromium.troubles, []);
await chromium.end();
server.close();
