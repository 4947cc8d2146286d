// Runs the laboratory beside the page: the drive in its own time, and answers to the page.

import { System } from "./system.js";

const TICKS_PER_S = 100;
// States a second of real time, and the time for the ticks of one turn, in ms.
const TURN_MS = 20;
const WORK_MS = 15;
// Ticks between two answers of a drive that goes as fast as it can.
const MANY = 40;
// Until an own controller drives: the ESC, the board and the estimate take some seconds.
const READY_TICKS = 1500;

const system = fetch("singletrack.wasm")
  .then((answer) => answer.arrayBuffer())
  .then((bytes) => System.from(bytes));
// Pace: virtual seconds per second. `control` is the own controller, `goal` its wanted place of P.
let drive = null;
let pace = 1;
let isPaused = false;

const requests = {
  begin: (lab, { toml, code }) => {
    drive = null;
    const own = code === null ? {} : controller(code);
    const begun = lab.ask({ command: "begin", toml });
    drive = { ...own, owed: 0, before: performance.now(), state: begun.state };
    for (let tick = 0; own.control && tick < READY_TICKS && drive.state?.mode !== "driving"; tick += 1) {
      step(lab, 1, 1);
      if (drive.state?.mode === "ready") {
        lab.ask({ command: "pilot", word: "arm" });
      }
    }
    begun.state = drive.state;
    drive.before = performance.now();
    return { ...begun, goal: path(own.goal) };
  },
  pace: (_, given) => ({ pace, isPaused } = given),
  ask: (lab, { request }) => lab.ask(request),
  text: (lab, { request }) => lab.text(request),
  bytes: (lab, { request }) => lab.bytes(request),
  replay: (lab, { record }) => lab.replay(new Uint8Array(record)),
};

addEventListener("message", async ({ data: { id, kind, given } }) => {
  try {
    postMessage({ id, answer: requests[kind](await system, given) });
  } catch (error) {
    postMessage({ id, error: error.message });
  }
});

// The functions of an own controller. Its mistakes are the page's to show.
function controller(code) {
  const find = "typeof goal === 'function' ? goal : null";
  const made = new Function(`"use strict";${code}\n;return { control, goal: ${find} };`)();
  if (typeof made.control !== "function") {
    throw new Error("control is not a function: write function control(state) { ... }");
  }
  return made;
}

// Where a goal goes in a minute.
function path(goal) {
  return goal ? Array.from({ length: 601 }, (_, index) => goal(index * 0.1)) : null;
}

function step(lab, ticks, every) {
  const { control, goal } = drive;
  if (!control) {
    return lab.ask({ command: "step", ticks, every });
  }
  let answer = null;
  const states = [];
  for (let tick = 0; tick < ticks; tick += 1) {
    // Before the first tick there is no state.
    const keys = drive.state && control(drive.state);
    if (keys) {
      lab.ask({ command: "setpoint", keys });
    }
    answer = lab.ask({ command: "step", ticks: 1, every: 1 });
    for (const state of answer.states) {
      if (goal && state.drive_time_s !== null) {
        state.reference_m = goal(state.drive_time_s);
      }
      drive.state = state;
    }
    if (tick % every === 0 || tick === ticks - 1) {
      states.push(drive.state);
    }
  }
  return { ...answer, states, digest: null };
}

function turn(lab) {
  setTimeout(turn, TURN_MS, lab);
  const now = performance.now();
  if (drive === null || isPaused) {
    drive && (drive.before = now);
    return;
  }
  // What a slow computer owes is forgotten: the time is slower then.
  drive.owed = pace === Infinity ? Infinity : Math.min(pace * TICKS_PER_S * 0.1,
    drive.owed + (now - drive.before) * 1e-3 * pace * TICKS_PER_S);
  drive.before = now;
  const states = [];
  let last = null;
  try {
    while (drive.owed >= 1 && performance.now() - now < WORK_MS) {
      const ticks = Math.min(MANY, Math.floor(drive.owed));
      last = step(lab, ticks, pace > 4 ? 10 : 2);
      states.push(...last.states);
      drive.owed -= ticks;
    }
  } catch (error) {
    drive = null;
    postMessage({ trouble: error.message });
  }
  if (last !== null) {
    postMessage({ ...last, states });
  }
}

turn(await system);
postMessage({ ready: true });
