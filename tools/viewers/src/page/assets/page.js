// The page: shows what its server sends of the daemon.

import { Chart, SPAN_S } from "./chart.js";
import { View, degrees } from "./view.js";

// Without a state for this long, what is shown is old.
const SILENCE_MS = 1000;
const RETRY_MS = 1000;
// Texts are for people: a few a second.
const TEXT_MS = 200;
const SLOW_TEXT_MS = 2000;

// Reasons that the diagnosis of the cameras explains.
const ABOUT_POSES = ["no-pose", "pose-too-old", "pose-implausible"];
const NO_TROUBLE = ["good", "starting"];

const element = (id) => document.getElementById(id);
const view = new View(element("view"));
const scaled = (number, factor) => (number === null ? null : number * factor);
const charts = [
  { title: "P to reference", unit: "mm", digits: 0, least: 20,
    value: (state) => scaled(distance(state.point_m, state.reference_m), 1000) },
  { title: "Speed", unit: "m/s", digits: 2, least: 0.5, note: "dashed: commanded",
    value: (state) => state.speed_m_s, second: (state) => state.commanded_speed_m_s },
  { title: "Steering", unit: "°", digits: 1, least: 10, signed: true,
    value: (state) => degrees(state.steering_rad) },
  { title: "Pose age", unit: "ms", digits: 0, least: 20,
    value: (state) => scaled(state.pose_age_s, 1000) },
].map((chart) => new Chart(element("charts"), { ...chart, onPoint }));

let [setup, state, status] = [null, null, null];
// The states of the last seconds, the oldest first.
let states = [];
// In s before the newest state.
let pointed = null;
let heardAt = -Infinity;
// Whether the daemon was lost: another one may have another setup.
let isLost = false;
// Why there is no connection: a sentence and what to do.
let trouble = ["", ""];
let isDirty = false;

// The connection.

async function connect() {
  try {
    await load();
  } catch (error) {
    lost(error.message);
    setTimeout(connect, RETRY_MS);
    return;
  }
  states = [];
  const events = new EventSource(`events${location.search}`);
  events.addEventListener("open", () => fill().catch(() => {}));
  events.addEventListener("state", (event) => {
    heardAt = performance.now();
    state = JSON.parse(event.data);
    view.state = state;
    if (state.t_s < states.at(-1)?.t_s) {
      states = [];
    }
    states.push(state);
    states.splice(0, states.findIndex(({ t_s }) => t_s >= state.t_s - SPAN_S));
    isDirty = true;
  });
  events.addEventListener("status", (event) => {
    status = JSON.parse(event.data);
    if (isLost || setup.configuration !== status.configuration.number) {
      load().catch(() => {});
    }
  });
  events.addEventListener("lost", (event) => {
    lost(`No daemon: ${JSON.parse(event.data)}`);
  });
  events.addEventListener("error", () => {
    events.close();
    lost("");
    setTimeout(connect, RETRY_MS);
  });
}

async function load() {
  const answer = await fetch(`setup.json${location.search}`);
  if (!answer.ok) {
    throw new Error(await answer.text());
  }
  setup = await answer.json();
  isLost = false;
  view.setup = setup;
  isDirty = true;
}

// Puts before the states those of before the page was loaded.
async function fill() {
  const answer = await fetch(`history.json${location.search}`);
  const old = answer.ok ? await answer.json() : [];
  const begin = states[0]?.t_s ?? Infinity;
  states.unshift(...old.filter(({ t_s }) => t_s < begin));
  isDirty = true;
}

function lost(why) {
  heardAt = -Infinity;
  isLost = true;
  const again = "The page connects again by itself.";
  if (why.includes("?token=")) {
    trouble = ["The page asks for its token.", why];
  } else if (why.startsWith("No daemon")) {
    trouble = ["There is no daemon; what is shown is old.", `${why.trim()}. ${again}`];
  } else {
    trouble = ["The server of the page does not answer; what is shown is old.",
      `Check that \`singletrack page\` runs. ${again}`];
  }
}

// What a state shows.

function onPoint(ago) {
  pointed = ago;
  isDirty = true;
}

function distance(a, b) {
  return a && b ? Math.hypot(a[0] - b[0], a[1] - b[1]) : null;
}

function draw() {
  requestAnimationFrame(draw);
  if (isDirty) {
    isDirty = false;
    view.draw(states);
    charts.forEach((chart) => chart.draw(states, pointed));
  }
}

// Words.

function write() {
  const isOld = performance.now() - heardAt > SILENCE_MS;
  document.body.dataset.old = isOld;
  element("link").dataset.link = isOld ? "waiting" : "live";
  text(element("link"), isOld ? "Daemon not connected" : "Daemon connected");
  writeNow(isOld);
  text(element("calibration"), advice(status?.calibration));
  text(element("others"), beside(state?.others));
  if (state === null || setup === null) {
    return;
  }
  text(element("names"), [
    `car \`${setup.car.name}\`${setup.car.id ? `, number ${setup.car.id}` : ""}`,
    `configuration ${setup.configuration}${named(status?.config_path)}`,
    status?.record ? `record${named(status.record)}` : "no record",
  ].join(" · "));
  const error = distance(state.point_m, state.reference_m);
  value("drive-time", state.drive_time_s, 1, "s", 1);
  value("speed", state.speed_m_s, 2, "m/s", 1);
  value("error", error, 0, "mm", 1000);
  value("pose-age", state.pose_age_s, 0, "ms", 1000, state.pose_age_s * 1000 > setup.hold_ms);
  value("board-age", state.board_age_s, 0, "ms", 1000, state.mode === "disconnected");
  // Without a divider on the board, 0 V is no measurement.
  const volts = (status?.board?.battery_mv || null) && status.board.battery_mv / 1000;
  value("battery", volts, 1, "V", 1, volts < setup.arm_battery_v);
}

function writeNow(isOld) {
  const now = element("now");
  if (isOld || state === null) {
    const isNew = state === null && trouble[0] === "";
    now.dataset.tone = "";
    text(element("mode"), isNew ? "Connecting" : "No connection");
    text(element("meaning"), trouble[0]);
    text(element("remedy"), trouble[1]);
    return;
  }
  trouble = ["No tick comes from the daemon; what is shown is old.", "Look at the daemon's log."];
  const { mode, preflight, reason } = state;
  now.dataset.tone = mode === "fault" ? "fault" : mode === "driving" ? "drives" : "";
  // The daemon is connected to the page, the board is not to the daemon.
  text(element("mode"), mode === "disconnected" ? "Board disconnected" : mode);
  // Of a car that waits, what keeps it from arming; else why it stops, or stopped.
  const word = (mode === "idle" && preflight) || reason;
  if (!word) {
    text(element("meaning"), "");
    text(element("remedy"), "");
    return;
  }
  const known = setup.reasons.host[word] ?? { meaning: "", remedy: "" };
  const cause = word === "board-failsafe" && setup.reasons["board stop"][status?.board?.stop_cause];
  const { meaning, remedy } = cause || known;
  const before = mode === "ready" ? "The last drive ended: " : "";
  const isExplained = ABOUT_POSES.includes(word)
    && status && !NO_TROUBLE.includes(status.cameras.diagnosis);
  text(element("meaning"), `${before}\`${word}\`. ${meaning}`);
  if (word === "link-down" && mode === "ready") {
    // The board answers again.
    text(element("remedy"), "");
    return;
  }
  const port = word === "link-down" && status?.serial_error;
  const cameras = isExplained ? ` Cameras: ${sentence(status.cameras.text)}` : "";
  text(element("remedy"), `What to do: ${port ? sentence(port) : remedy}${cameras}`);
}

function sentence(words) {
  return /[.?!]$/.test(words) ? words : `${words}.`;
}

// What the drives say of the calibration.
function advice(calibration) {
  if (!calibration?.advice.length) {
    return "";
  }
  const accept = calibration.corrections.length ? ", or `singletrack accept`" : "";
  return `${calibration.advice.join("; ")}: run \`singletrack calibrate\`${accept}.`;
}

// What the other cars do.
function beside(others) {
  return others?.map((other) => (other === null ? "a car without a daemon"
    : `\`${other.car.name}\` ${other.mode}${other.reason ? `, ${other.reason}` : ""}`)).join(" · ") ?? "";
}

function named(path) {
  return path ? ` \`${path.split("/").at(-1)}\`` : "";
}

function value(id, number, digits, unit, factor, isLate = false) {
  const shown = number === null || number === undefined ? "–"
    : `${(number * factor).toFixed(digits)} ${unit}`;
  text(element(id), shown);
  element(id).dataset.late = isLate;
}

// Replaces the text if it changed: a screen reader reads every change aloud. Of Markdown, code is
// shown as such, and of a link its text.
function text(node, markdown) {
  if (node.dataset.text === markdown) {
    return;
  }
  node.dataset.text = markdown;
  const parts = markdown.replace(/\[([^\]]*)\]\([^)]*\)/g, "$1").split("`");
  node.replaceChildren(...parts.map((part, index) => {
    if (index % 2 === 0) {
      return part;
    }
    const code = document.createElement("code");
    code.textContent = part;
    return code;
  }));
}

function describe() {
  view.describe();
  charts.forEach((chart) => chart.describe(states));
}

element("follow").addEventListener("click", () => {
  view.follows = !view.follows;
  element("follow").setAttribute("aria-pressed", view.follows);
  isDirty = true;
});
element("clear").addEventListener("click", () => {
  view.clear();
  isDirty = true;
});
const redraw = () => {
  isDirty = true;
};
addEventListener("resize", redraw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
setInterval(write, TEXT_MS);
setInterval(describe, SLOW_TEXT_MS);
draw();
connect();
