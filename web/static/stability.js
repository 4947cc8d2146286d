// The map of stability: the Hopf curve over dl and speed with the car on it, and its eigenvalues.

import { colours, context, line } from "./chart.js";

// The largest speed of the map, in m/s.
export const FASTEST = 5;
const [LEFT, BOTTOM, BORDER] = [36, 22, 8];

export function describe({ stable, critical_speed_m_s: critical, first_unstable_speed_m_s: first }) {
  const paper = critical === null ? "at every speed" : critical === 0 ? "at no speed"
    : `up to ${critical.toFixed(2)} m/s`;
  const car = first === null ? "up to 20 m/s and beyond" : `below ${first.toFixed(2)} m/s`;
  return `${stable ? "stable" : "unstable"}. The paper's loop is stable ${paper}; in `
    + `ticks of 10 ms, with the servo and the delays of the simulated car, ${car}.`;
}

export function drawStability(canvas, map, { speed, deviation }) {
  const { pen, width, height } = context(canvas);
  const colour = colours(canvas);
  pen.font = colour.font;
  pen.lineWidth = 1;
  const split = width * 0.55;
  drawMap(pen, [LEFT, BORDER, split - BORDER, height - BOTTOM], map, { speed, deviation }, colour);
  drawEigenvalues(pen, [split + LEFT, BORDER, width - BORDER, height - BOTTOM], map, colour);
  canvas.setAttribute("aria-label", describe(map));
}

function frame(pen, [x0, y0, x1, y1], colour, below, beside) {
  pen.strokeStyle = colour.line;
  pen.strokeRect(x0, y0, x1 - x0, y1 - y0);
  pen.fillStyle = colour.soft;
  pen.textBaseline = "middle";
  pen.textAlign = "center";
  pen.fillText(below, (x0 + x1) / 2, y1 + 12);
  pen.textAlign = "left";
  pen.fillText(beside, x0 + 4, y0 + 10);
}

function drawMap(pen, area, { hopf, meaningful_m: [least, most], stable }, at, colour) {
  const [x0, y0, x1, y1] = area;
  frame(pen, area, colour, `dl, ${(least * 1e3).toFixed(0)} to ${(most * 1e3).toFixed(0)} mm`,
    `speed, 0 to ${FASTEST} m/s`);
  const to = ([dl, speed]) => [
    x0 + (x1 - x0) * (dl - least) / (most - least), y1 - (y1 - y0) * speed / FASTEST,
  ];
  pen.save();
  pen.beginPath();
  pen.rect(x0, y0, x1 - x0, y1 - y0);
  pen.clip();
  pen.fillStyle = colour.wanted;
  for (const point of hopf) {
    const [x, y] = to(point);
    pen.fillRect(x - 1, y - 1, 2, 2);
  }
  pen.setLineDash([3, 3]);
  pen.strokeStyle = colour.soft;
  const [x, y] = to([at.deviation, at.speed]);
  line(pen, [[x, y0], [x, y1]]);
  line(pen, [[x0, y], [x1, y]]);
  pen.setLineDash([]);
  pen.beginPath();
  pen.arc(x, y, 5, 0, 2 * Math.PI);
  pen.lineWidth = 2;
  pen.strokeStyle = colour.point;
  pen.fillStyle = stable ? colour.point : colour.paper;
  pen.fill();
  pen.stroke();
  pen.restore();
}

// The imaginary axis is where stability ends.
function drawEigenvalues(pen, area, { eigenvalues }, colour) {
  const [x0, y0, x1, y1] = area;
  const size = Math.max(5, ...eigenvalues.flat().map(Math.abs)) * 1.1;
  frame(pen, area, colour, `real, ±${size.toFixed(0)} 1/s`, "eigenvalues, imaginary");
  const [x, y] = [(x0 + x1) / 2, (y0 + y1) / 2];
  line(pen, [[x, y0], [x, y1]]);
  line(pen, [[x0, y], [x1, y]]);
  pen.strokeStyle = colour.point;
  pen.lineWidth = 1.5;
  for (const [re, im] of eigenvalues) {
    const [px, py] = [x + re / size * (x1 - x0) / 2, y - im / size * (y1 - y0) / 2];
    line(pen, [[px - 4, py - 4], [px + 4, py + 4]]);
    line(pen, [[px - 4, py + 4], [px + 4, py - 4]]);
  }
}
