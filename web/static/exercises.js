// Exercises that pages of the book link to, as `#exercise=lab-1`: a scenario, keys that differ, and
// a controller to begin with.

const CIRCLE = `// P shall go round a circle of 1 m at 0.5 rad/s, within 10 mm.
const w = 0.5;

// Where P should be at a time of the drive, in m.
function goal(t) {
  return [Math.cos(w * t), Math.sin(w * t)];
}

// Called at every tick, every 10 ms, with the keys of the state stream:
// point_m is P, drive_time_s the time. Returns the keys of a set-point.
function control(state) {
  const t = state.drive_time_s ?? 0;
  const [x, y] = goal(t);
  const K = 1.0;
  const [px, py] = state.point_m ?? [x, y];
  return { velocity_m_s: [K * (x - px), K * (y - py)] };
}
`;

// What the scenario of an own controller has: the worker arms the car when it is ready.
export const EXTERNAL = {
  operator: { arm: false },
  reference: { kind: "external", setpoint_timeout_ms: 200 },
  outer_loop: { kind: "open-loop" },
};

export const EXERCISES = {
  "lab-1": { scenario: "circle-car", keys: {}, code: CIRCLE },
  "lab-2": {
    scenario: "circle-car",
    keys: {
      law: { front_axle_distance_m: 0.1868 },
      outer_loop: { kind: "proportional", gain_per_s: [1.0, 1.0], feed_forward: true },
    },
    code: null,
  },
  "lab-3": {
    scenario: "circle-car",
    keys: {
      law: { point_distance_m: 0.15 },
      outer_loop: { kind: "proportional", gain_per_s: [4.0, 4.0], feed_forward: true },
    },
    code: null,
  },
};

export const CONTROLLER = CIRCLE;

// A set-up as a fragment of the address, and back.
export function toFragment(setUp) {
  const bytes = new TextEncoder().encode(JSON.stringify(setUp));
  const text = btoa(String.fromCharCode(...bytes));
  return `#setup=${text.replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "")}`;
}

export function fromFragment(fragment) {
  const [, kind, value] = fragment.match(/^#(setup|exercise)=([\w-]+)$/) ?? [];
  if (kind === "exercise") {
    return EXERCISES[value] ?? null;
  }
  if (kind === "setup") {
    const text = atob(value.replaceAll("-", "+").replaceAll("_", "/"));
    return JSON.parse(new TextDecoder().decode(Uint8Array.from(text, (one) => one.charCodeAt(0))));
  }
  return null;
}
