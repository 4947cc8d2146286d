// The page of the laboratory: shows the drive of its worker, and passes on what one does to it.

import { Chart, SPAN_S } from "./chart.js";
import { CONTROLLER, EXTERNAL, fromFragment, toFragment } from "./exercises.js";
import { FASTEST, describe, drawStability } from "./stability.js";
import { View, degrees } from "./view.js";

const SCENARIOS = ["circle-car", "steps-car", "circle-lqi", "circle-mpc", "eight-losses"];
// Own controllers that do not come back within this are ended.
const SILENCE_MS = 3000;
// Around the path and the car, in m.
const AROUND_M = 0.4;
// The car is grasped within this, in m.
const GRASP_M = 0.3;
// l_f of the paper's car, which a scenario has by default.
const PAPER_FRONT_AXLE_M = 0.1368;

const element = (id) => document.getElementById(id);
const text = (id, words) => {
  if (element(id).textContent !== words) {
    element(id).textContent = words;
  }
};
const distance = (a, b) => (a && b ? Math.hypot(a[0] - b[0], a[1] - b[1]) : null);

// A view of what the car does, without the hall around it.
class LaboratoryView extends View {
  bounds() {
    if (this.follows || !this.setup) {
      return super.bounds();
    }
    const { state, setup } = this;
    const here = state?.point_m ? [state.point_m, [state.x_m, state.y_m]] : [];
    this.seen ??= [];
    this.seen.push(...here);
    const points = [...setup.reference.points_m, ...this.seen];
    const [xs, ys] = [points.map(([x]) => x), points.map(([, y]) => y)];
    const bounds = [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
    this.seen = points.length > 0 ? [bounds.slice(0, 2), bounds.slice(2)] : [];
    const around = [-AROUND_M, -AROUND_M, AROUND_M, AROUND_M];
    return points.length > 0 ? bounds.map((at, index) => at + around[index]) : [-2, -2, 2, 2];
  }
}

const view = new LaboratoryView(element("view"));
const charts = [
  { title: "P to reference", unit: "mm", digits: 1, least: 20,
    value: (state) => millimetres(distance(state.point_m, state.reference_m)) },
  { title: "Speed", unit: "m/s", digits: 2, least: 0.5, note: "dashed: commanded",
    value: (state) => state.speed_m_s, second: (state) => state.commanded_speed_m_s },
  { title: "Steering", unit: "°", digits: 1, least: 10, signed: true,
    value: (state) => degrees(state.steering_rad) },
].map((chart) => new Chart(element("charts"), { ...chart, onPoint: (ago) => redraw(pointed = ago) }));

let [states, record, pointed, reasons] = [[], null, null, {}];
// The scenario, its keys, and the own controller in force.
let [toml, keys, code] = ["", {}, null];
// What hands have done since the drive began: another drive than the scenario's.
let isTouched = false;
let isDirty = true;

// The worker.

let worker = null;
let waiting = new Map();
let heardAt = 0;

function startWorker() {
  worker?.terminate();
  waiting.forEach(({ reject }) => reject(new Error("the controller did not come back: ended")));
  waiting = new Map();
  worker = new Worker("worker.js", { type: "module" });
  worker.addEventListener("message", ({ data }) => {
    heardAt = performance.now();
    if (data.id !== undefined) {
      const { resolve, reject } = waiting.get(data.id) ?? {};
      waiting.delete(data.id);
      data.error === undefined ? resolve?.(data.answer) : reject?.(new Error(data.error));
    } else if (data.trouble) {
      code = null;
      view.state = null;
      text("code-mistake", data.trouble);
      text("mode", "Ended");
      text("meaning", data.trouble);
    } else if (data.states) {
      take(data);
    }
  });
}

function call(kind, given, transfer = []) {
  return new Promise((resolve, reject) => {
    const id = crypto.getRandomValues(new Uint32Array(1))[0];
    waiting.set(id, { resolve, reject });
    worker.postMessage({ id, kind, given }, transfer);
  });
}

const ask = (command, given = {}) => call("ask", { request: { command, ...given } });

// A drive.

async function begin() {
  text("mistake", "");
  text("code-mistake", "");
  try {
    const begun = await call("begin", { toml, code });
    record = null;
    element("at").hidden = true;
    [states, view.seen, view.state, isTouched] = [[], [], begun.state, false];
    view.setup = begun.setup;
    view.setup.reference.points_m = begun.goal ?? begun.setup.reference.points_m;
    reasons = begun.setup.reasons.host;
    document.querySelectorAll("[data-fault]").forEach((it) => it.setAttribute("aria-pressed", false));
    text("digest", "");
    element("link").dataset.link = "live";
    text("link", "Virtual time");
    redraw();
  } catch (error) {
    text(code === null ? "mistake" : "code-mistake", error.message);
    element(code === null ? "mistake" : "code-mistake").closest("details").open = true;
    text("mode", "No drive");
    text("meaning", error.message);
    code = null;
    view.state = null;
  }
  stability();
}

function take({ states: newer, digest }) {
  if (record !== null) {
    return;
  }
  states.push(...newer);
  const now = states.at(-1);
  states.splice(0, states.findIndex(({ t_s }) => t_s >= now.t_s - SPAN_S));
  view.state = now;
  document.body.dataset.driven = now.drive_time_s ?? "";
  if (digest && !element("digest").textContent) {
    text("digest", isTouched ? "Not the scenario's drive any more: hands were on the car. Its record replays."
      : `Digest ${digest}, as singletrack simulate --format digest prints it.`);
  }
  redraw();
}

async function use(given) {
  toml = given;
  element("toml").value = given;
  keys = await ask("keys", { toml }).catch(() => keys);
  fill();
  await begin();
}

async function change(given) {
  const changed = await call("text", { request: { command: "change", toml, keys: given } });
  await use(changed);
}

async function choose({ scenario, toml: own, keys: given = {}, code: controller = null }, runs) {
  const chosen = own ?? await (await fetch(`scenarios/${scenario}.toml`)).text();
  element("scenario").value = own ? "" : scenario;
  element("code").value = controller ?? CONTROLLER;
  element("own").open = controller !== null;
  // A controller of a link is shown, and runs when one says so.
  code = controller !== null && runs ? controller : null;
  toml = chosen;
  await (Object.keys(given).length > 0 ? change(given) : use(chosen));
}

// The set-up.

function fill() {
  for (const input of document.querySelectorAll("[data-key]")) {
    input.value = input.dataset.key.split(".").reduce((at, key) => at?.[key], keys) ?? "";
  }
  const loop = keys.outer_loop ?? {};
  element("loop").value = loop.kind;
  element("gain").value = loop.gain_per_s?.[0] ?? "";
  element("gain").disabled = element("feed-forward").disabled = loop.kind !== "proportional";
  element("feed-forward").checked = loop.feed_forward ?? false;
  element("dl").value = millimetres(deviation()).toFixed(1);
}

const deviation = () => (keys.law?.front_axle_distance_m ?? 0)
  - (keys.vehicle?.front_axle_distance_m ?? PAPER_FRONT_AXLE_M);

function millimetres(metres) {
  return metres === null ? null : metres * 1e3;
}

element("set-up").addEventListener("change", async ({ target }) => {
  const number = Number(target.value);
  if (target.id === "scenario") {
    await choose({ scenario: target.value });
  } else if (target.id === "dl") {
    await change({ law: { front_axle_distance_m: keys.law.front_axle_distance_m - deviation() + number / 1e3 } });
  } else if (["loop", "gain", "feed-forward"].includes(target.id)) {
    const kind = element("loop").value;
    const gain = Number(element("gain").value) || 1;
    await change({ outer_loop: kind === "proportional"
      ? { kind, gain_per_s: [gain, gain], feed_forward: element("feed-forward").checked } : { kind } });
  } else {
    const [section, key, index] = target.dataset.key.split(".");
    const whole = index === undefined ? number : keys[section][key].with(Number(index), number);
    await change({ [section]: { [key]: whole } });
  }
});

element("set-up").addEventListener("submit", (event) => event.preventDefault());
element("use").addEventListener("click", () => {
  code = null;
  use(element("toml").value);
});
element("run-code").addEventListener("click", () => {
  code = element("code").value;
  change(EXTERNAL);
});
element("restart").addEventListener("click", begin);

function pace() {
  const isPaused = element("pause").getAttribute("aria-pressed") === "true";
  call("pace", { pace: Number(element("speed").value), isPaused });
}

element("speed").addEventListener("change", pace);
element("pause").addEventListener("click", ({ currentTarget: it }) => {
  it.setAttribute("aria-pressed", it.getAttribute("aria-pressed") !== "true");
  pace();
});
element("follow").addEventListener("click", ({ currentTarget: it }) => {
  view.follows = !view.follows;
  it.setAttribute("aria-pressed", view.follows);
  redraw();
});

for (const button of document.querySelectorAll("[data-fault]")) {
  button.addEventListener("click", async () => {
    const isOn = button.getAttribute("aria-pressed") !== "true";
    const word = isOn ? button.dataset.on : button.dataset.off;
    const value = { true: true, false: false }[word] ?? word;
    isTouched = true;
    await ask("fault", { name: button.dataset.fault, value });
    button.setAttribute("aria-pressed", isOn);
  });
}
element("stop").addEventListener("click", () => {
  isTouched = true;
  ask("pilot", { word: "disarm" });
});

// The start is dragged: the car moves it, P turns it.

let grasped = null;

function place({ offsetX, offsetY }) {
  return view.from([offsetX, offsetY]);
}

element("view").addEventListener("pointerdown", (event) => {
  const at = place(event);
  const { state } = view;
  if (record !== null || !state?.point_m) {
    return;
  }
  const ends = { turn: state.point_m, move: [state.x_m, state.y_m] };
  const near = Object.entries(ends).sort((a, b) => distance(a[1], at) - distance(b[1], at))[0];
  if (distance(near[1], at) < GRASP_M) {
    grasped = near[0];
    element("view").setPointerCapture(event.pointerId);
  }
});

element("view").addEventListener("pointermove", (event) => {
  if (grasped === null) {
    return;
  }
  const [x, y] = place(event);
  const { state } = view;
  const reach = distance([state.x_m, state.y_m], state.point_m);
  const moved = grasped === "move" ? { ...state, x_m: x, y_m: y }
    : { ...state, yaw_rad: Math.atan2(y - state.y_m, x - state.x_m) };
  moved.point_m = [moved.x_m + reach * Math.cos(moved.yaw_rad), moved.y_m + reach * Math.sin(moved.yaw_rad)];
  view.state = moved;
  redraw();
});

element("view").addEventListener("pointerup", () => {
  if (grasped !== null) {
    grasped = null;
    const { point_m: at, yaw_rad: yaw } = view.state;
    const round = (value, digits) => Number(value.toFixed(digits));
    change({ start: { point_p_m: at.map((value) => round(value, 3)), yaw_deg: round(degrees(yaw), 1) } });
  }
});

// Stability.

async function stability() {
  const speed = Number(element("steady-speed").value);
  const given = { point_distance_m: keys.law?.point_distance_m ?? 0.35, speed_m_s: speed,
    deviation_m: deviation(), largest_speed_m_s: FASTEST };
  try {
    const map = await ask("stability", keys.vehicle ? { ...given, vehicle: keys.vehicle } : given);
    text("stability-text", `At ${speed.toFixed(2)} m/s: ${describe(map)}`);
    drawStability(element("stability-map"), map, { speed, deviation: given.deviation_m });
  } catch (error) {
    text("stability-text", error.message);
  }
}

element("steady-speed").addEventListener("input", stability);
element("stability").addEventListener("toggle", stability);

// Records.

async function verify(file) {
  text("verdict", `Replaying ${file.name}`);
  try {
    const bytes = await file.arrayBuffer();
    const found = await call("replay", { record: bytes }, [bytes]);
    const verdict = found.different === 0
      ? `${found.ticks} ticks, every output the same to the bit`
      : `${found.different} of ${found.ticks} ticks differ, first tick ${found.first[0]}:\n${found.first[1].join("\n")}`;
    text("verdict", `${file.name}: ${verdict}.\nDigest ${found.digest}, by ${Object.entries(found.software).map((it) => it.join(" ")).join(", ")}`
      + `${found.seed === null ? "" : `, simulated with seed ${found.seed}`}`
      + `${found.finished ? "" : "; the record is unfinished"}.`);
    record = found;
    [view.setup, view.seen, reasons] = [found.setup, [], found.setup.reasons.host];
    element("at").max = found.states.length - 1;
    element("at").value = found.states.length - 1;
    element("at").hidden = false;
    show();
  } catch (error) {
    text("verdict", `${file.name}: ${error.message}`);
  }
}

function show() {
  const until = Number(element("at").value);
  view.state = record.states[until];
  states = record.states.slice(0, until + 1).filter(({ t_s }) => t_s >= view.state.t_s - SPAN_S);
  redraw();
}

element("at").addEventListener("input", show);
element("file").addEventListener("change", ({ target }) => target.files[0] && verify(target.files[0]));
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", (event) => {
  event.preventDefault();
  event.dataTransfer.files[0] && verify(event.dataTransfer.files[0]);
});

element("save").addEventListener("click", async () => {
  const bytes = await call("bytes", { request: { command: "record" } });
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([bytes]));
  link.download = "drive.mcap";
  link.click();
  URL.revokeObjectURL(link.href);
  await begin();
});

element("share").addEventListener("click", async () => {
  const isOwn = keys.reference?.kind === "external";
  history.replaceState(null, "", toFragment({ toml, code: isOwn ? element("code").value : null }));
  await navigator.clipboard?.writeText(location.href).catch(() => {});
  text("verdict", "The link is in the address bar, and copied.");
});

// What is shown.

function redraw() {
  isDirty = true;
}

function draw() {
  requestAnimationFrame(draw);
  if (isDirty) {
    isDirty = false;
    view.draw(states);
    charts.forEach((chart) => chart.draw(states, pointed));
  }
}

function write() {
  const { state } = view;
  if (code !== null && record === null && performance.now() - heardAt > SILENCE_MS
      && element("pause").getAttribute("aria-pressed") !== "true") {
    code = null;
    view.state = null;
    startWorker();
    pace();
    text("mode", "Ended");
    text("code-mistake", "The controller did not come back, and was ended. Is there an endless loop?");
    return;
  }
  if (!state) {
    return;
  }
  const shown = (value, digits, unit) => (value === null || value === undefined ? "–" : `${value.toFixed(digits)} ${unit}`);
  const word = state.reason ?? (state.mode === "idle" ? state.preflight : null);
  element("now").dataset.tone = state.mode === "fault" ? "fault" : state.mode === "driving" ? "drives" : "";
  text("mode", state.mode === "disconnected" ? "Board disconnected" : state.mode);
  text("meaning", word ? `${word}. ${reasons[word]?.meaning ?? ""}` : "");
  text("remedy", word ? reasons[word]?.remedy ?? "" : "");
  text("drive-time", shown(state.drive_time_s, 1, "s"));
  text("car-speed", shown(state.speed_m_s, 2, "m/s"));
  text("error", shown(millimetres(distance(state.point_m, state.reference_m)), 1, "mm"));
}

function describeAll() {
  view.describe();
  charts.forEach((chart) => chart.describe(states));
}

addEventListener("resize", () => redraw(stability()));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => redraw(stability()));
addEventListener("hashchange", () => location.reload());
element("scenario").replaceChildren(...["", ...SCENARIOS].map((name) => new Option(name || "own", name)));
setInterval(write, 100);
setInterval(describeAll, 2000);
startWorker();
draw();
choose(fromFragment(location.hash) ?? { scenario: SCENARIOS[0] }, false);
