// The top view: geofence, path of the reference, trail of P, and the cars to scale.

import { SPAN_S, colours, context, line } from "./chart.js";

// Seen to either side of a car that is followed, in m.
const NEAR_M = 1;
// Around what is shown, in CSS pixels.
const BORDER = 22;

export class View {
  constructor(canvas) {
    Object.assign(this, { canvas, setup: null, state: null, follows: false });
    // Without its time, the trail is whole.
    this.cleared = { t_s: -Infinity };
  }

  clear() {
    this.cleared = this.state ?? this.cleared;
  }

  describe() {
    const { state } = this;
    const text = state === null || state.x_m === null ? "the place of the car is not known"
      : `the car is at x ${state.x_m.toFixed(2)} m, y ${state.y_m.toFixed(2)} m, `
        + `yaw ${degrees(state.yaw_rad).toFixed(0)}°`;
    const beside = others(state).map(({ car }) => car.name).join(", ");
    this.canvas.setAttribute("aria-label",
      `Top view: ${text}${beside ? `; other cars: ${beside}` : ""}`);
  }

  // What is shown, in m.
  bounds() {
    const { setup, state } = this;
    if (this.follows && state?.x_m != null) {
      const { x_m, y_m } = state;
      return [x_m - NEAR_M, y_m - NEAR_M, x_m + NEAR_M, y_m + NEAR_M];
    }
    const points = [...setup.fence.corners_m, ...setup.reference.points_m,
      ...others(state).flatMap(({ corners_m }) => corners_m)];
    const [xs, ys] = [points.map(([x]) => x), points.map(([, y]) => y)];
    return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
  }

  draw(states) {
    const { pen, width, height } = context(this.canvas);
    const { setup, state } = this;
    if (setup === null) {
      return;
    }
    const colour = colours(this.canvas);
    const [x0, y0, x1, y1] = this.bounds();
    const scale = Math.min((width - 2 * BORDER) / (x1 - x0), (height - 2 * BORDER) / (y1 - y0));
    const to = ([x, y]) => [
      width / 2 + (x - (x0 + x1) / 2) * scale,
      height / 2 - (y - (y0 + y1) / 2) * scale,
    ];
    // Where a place of the canvas is, in m.
    this.from = ([x, y]) => [
      (x - width / 2) / scale + (x0 + x1) / 2,
      (height / 2 - y) / scale + (y0 + y1) / 2,
    ];
    pen.lineJoin = "round";
    this.drawGrid(pen, width, height, to, scale, colour);

    pen.lineWidth = 1.5;
    pen.strokeStyle = colour.soft;
    outline(pen, setup.fence.corners_m.map(to));
    pen.lineWidth = 1;
    pen.setLineDash([5, 4]);
    line(pen, setup.reference.points_m.map(to));
    pen.setLineDash([]);
    if (state === null) {
      return;
    }
    if (state.drive_time_s === null) {
      this.drawStart(pen, to, scale, colour);
    }
    this.drawTrail(pen, states, to, colour);
    pen.font = colour.font;
    for (const other of others(state).filter(({ x_m }) => x_m !== null)) {
      drawCar(pen, to, scale, { ...colour, ink: other.colour ?? colour.ink }, other, other);
      const [x, y] = to([other.x_m, other.y_m]);
      pen.fillStyle = colour.soft;
      pen.fillText(other.car.name, x + 12, y - 12);
    }
    if (state.x_m !== null) {
      drawCar(pen, to, scale, colour, setup, state);
      this.drawArm(pen, to, colour);
    }
    const { point_m: point, reference_m: reference } = state;
    if (reference) {
      if (point) {
        pen.strokeStyle = colour.soft;
        pen.lineWidth = 1;
        line(pen, [to(point), to(reference)]);
      }
      pen.strokeStyle = colour.wanted;
      pen.lineWidth = 2.5;
      disc(pen, to(reference), 6, colour.paper);
      pen.stroke();
    }
    if (point) {
      disc(pen, to(point), 4.5, colour.point);
    }
  }

  drawGrid(pen, width, height, to, scale, colour) {
    const step = scale > 150 ? 0.5 : scale > 30 ? 1 : scale > 6 ? 5 : 50;
    const origin = to([0, 0]);
    const from = (at) => at - Math.ceil(at / (step * scale)) * step * scale;
    pen.strokeStyle = colour.line;
    pen.lineWidth = 0.5;
    pen.fillStyle = colour.soft;
    pen.font = colour.font;
    const name = (pixels) => String(Number((pixels / scale).toFixed(1)));
    for (let x = from(origin[0]); x < width; x += step * scale) {
      line(pen, [[x, 0], [x, height]]);
      // The corner is that of the names of the axes.
      if (x > 40) {
        pen.fillText(name(x - origin[0]), x + 3, height - 6);
      }
    }
    for (let y = from(origin[1]); y < height; y += step * scale) {
      line(pen, [[0, y], [width, y]]);
      if (y < height - 30) {
        pen.fillText(name(origin[1] - y), 4, y - 3);
      }
    }
    pen.fillText("x, y, m", 4, height - 6);
  }

  // A ghost of the car where it can begin to drive.
  drawStart(pen, to, scale, colour) {
    const { setup } = this;
    if (setup.start) {
      pen.globalAlpha = 0.4;
      drawCar(pen, to, scale, { ...colour, ink: colour.soft }, setup,
        { ...setup.start, steering_rad: 0, pose_age_s: Infinity });
      pen.globalAlpha = 1;
      const { x_m, y_m } = setup.start;
      const [x, y] = to([x_m, y_m]);
      pen.fillStyle = colour.soft;
      pen.font = colour.font;
      pen.fillText(`start (${x_m.toFixed(2)}, ${y_m.toFixed(2)})`, x + 12, y - 12);
    }
  }

  // The older, the fainter.
  drawTrail(pen, states, to, colour) {
    const { cleared, state } = this;
    // A clock that began again has another trail.
    const from = cleared.t_s > state.t_s ? -Infinity : cleared.t_s;
    const trail = states.filter(({ t_s, point_m }) => point_m && t_s > from);
    pen.strokeStyle = colour.trail;
    pen.lineWidth = 2.5;
    for (let index = 1; index < trail.length; index += 1) {
      const [before, { t_s, point_m }] = [trail[index - 1], trail[index]];
      pen.globalAlpha = Math.max(0.2, 1 - (state.t_s - t_s) / SPAN_S);
      line(pen, [to(before.point_m), to(point_m)]);
    }
    pen.globalAlpha = 1;
  }

  // From the middle of the front axle to P.
  drawArm(pen, to, colour) {
    const { state, setup: { car } } = this;
    if (state.point_m) {
      const axle = [
        state.x_m + car.front_axle_m * Math.cos(state.yaw_rad),
        state.y_m + car.front_axle_m * Math.sin(state.yaw_rad),
      ];
      pen.strokeStyle = colour.point;
      pen.lineWidth = 1;
      line(pen, [to(axle), to(state.point_m)]);
    }
  }
}

function others(state) {
  return state?.others?.filter((other) => other !== null) ?? [];
}

function drawCar(pen, to, scale, colour, { car, hold_ms }, state) {
  const overhang = (car.length_m - car.front_axle_m - car.rear_axle_m) / 2;
  const [wheel, tyre] = [0.17 * car.length_m, 0.07 * car.length_m];
  const side = (car.width_m - tyre) / 2;
  pen.save();
  pen.translate(...to([state.x_m, state.y_m]));
  pen.rotate(-state.yaw_rad);
  pen.scale(scale, -scale);
  // What follows is in m, in the frame of the car.
  const pixel = 1 / scale;
  pen.lineWidth = 1.5 * pixel;
  pen.strokeStyle = colour.ink;
  pen.fillStyle = colour.paper;
  pen.beginPath();
  pen.roundRect(-car.rear_axle_m - overhang, -car.width_m / 2, car.length_m, car.width_m,
    0.12 * car.length_m);
  pen.fill();
  // A place that is not known any more.
  pen.setLineDash(state.pose_age_s * 1000 > hold_ms ? [3 * pixel, 3 * pixel] : []);
  pen.stroke();
  pen.setLineDash([]);
  pen.fillStyle = colour.ink;
  for (const [x, angle] of [[car.front_axle_m, state.steering_rad], [-car.rear_axle_m, 0]]) {
    for (const y of [side, -side]) {
      pen.save();
      pen.translate(x, y);
      pen.rotate(angle);
      pen.fillRect(-wheel / 2, -tyre / 2, wheel, tyre);
      pen.restore();
    }
  }
  pen.lineWidth = pixel;
  pen.strokeStyle = colour.soft;
  line(pen, [[-car.rear_axle_m, 0], [car.front_axle_m, 0]]);
  pen.restore();
}

export function degrees(radians) {
  return (radians * 180) / Math.PI;
}

function outline(pen, points) {
  pen.beginPath();
  points.forEach(([x, y]) => pen.lineTo(x, y));
  pen.closePath();
  pen.stroke();
}

function disc(pen, [x, y], radius, fill) {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 2 * Math.PI);
  pen.fillStyle = fill;
  pen.fill();
}
