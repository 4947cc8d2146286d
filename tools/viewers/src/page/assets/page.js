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
const charts = {
  error: new Chart(element("charts"),
    { title: "P to reference", unit: "mm", least: 20, note: `last ${SPAN_S} s` }),
  speed: new Chart(element("charts"),
    { title: "Speed", unit: "m/s", least: 0.5, note: "dashed: commanded" }),
  steering: new Chart(element("charts"), { title: "Steering", unit: "°", least: 10, signed: true }),
  age: new Chart(element("charts"), { title: "Pose age", unit: "ms", least: 20 }),
};

let [setup, state, status] = [null, null, null];
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
  const events = new EventSource(`events${location.search}`);
  events.addEventListener("state", (event) => {
    heardAt = performance.now();
    state = JSON.parse(event.data);
    take(state);
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

function lost(why) {
  heardAt = -Infinity;
  isLost = true;
  const again = "The page connects again by itself.";
  if (why.includes("?token=")) {
    trouble = ["The page asks for its token.", why];
  } else if (why.startsWith("No daemon")) {
    trouble = ["There is no daemon; what is shown is old.", `${why} ${again}`];
  } else {
    trouble = ["The server of the page does not answer; what is shown is old.",
      `Check that \`singletrack page\` runs. ${again}`];
  }
}

// What a state shows.

function take(state) {
  const error = distance(state.point, state.reference);
  charts.error.push(state.t, error === null ? null : error * 1000);
  charts.speed.push(state.t, state.speed, state.commanded_speed);
  charts.steering.push(state.t, degrees(state.steering));
  charts.age.push(state.t, state.pose_age === null ? null : state.pose_age * 1000);
  view.push(state);
  isDirty = true;
}

function distance(a, b) {
  return a && b ? Math.hypot(a[0] - b[0], a[1] - b[1]) : null;
}

function draw() {
  requestAnimationFrame(draw);
  if (isDirty) {
    isDirty = false;
    view.draw();
    Object.values(charts).forEach((chart) => chart.draw());
  }
}

// Words.

function write() {
  const isOld = performance.now() - heardAt > SILENCE_MS;
  document.body.dataset.old = isOld;
  element("link").dataset.link = isOld ? "waiting" : "live";
  text(element("link"), isOld ? "Not connected" : "Live");
  writeNow(isOld);
  if (state === null || setup === null) {
    return;
  }
  const error = distance(state.point, state.reference);
  value("drive-time", state.drive_time, 1, "s", 1);
  value("speed", state.speed, 2, "m/s", 1);
  value("error", error, 0, "mm", 1000);
  value("pose-age", state.pose_age, 0, "ms", 1000, state.pose_age * 1000 > setup.hold_ms);
  value("board-age", state.board_age, 0, "ms", 1000, state.mode === "disconnected");
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
  const { mode } = state;
  now.dataset.tone = mode === "fault" ? "fault" : mode === "driving" ? "drives" : "";
  text(element("mode"), mode);
  // Of a car that waits, what keeps it from arming; else why it stops, or stopped.
  const word = (mode === "idle" && status?.preflight) || state.reason;
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
  text(element("remedy"), `What to do: ${remedy}${isExplained ? ` Cameras: ${status.cameras.text}.` : ""}`);
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
  Object.values(charts).forEach((chart) => chart.describe());
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
