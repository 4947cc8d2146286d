// A strip chart: the last seconds of one or two quantities, newest on the right.

export const SPAN_S = 20;
// Larger than the interval of the states: a pause is drawn as a gap.
const GAP_S = 0.3;

export function colours(element) {
  const style = getComputedStyle(element);
  const colour = (name) => style.getPropertyValue(`--${name}`).trim();
  return { paper: colour("paper"), ink: colour("ink"), soft: colour("soft"), line: colour("line"),
    accent: colour("accent"), font: `11px ${style.fontFamily}` };
}

// Makes the canvas as fine as the screen. Returns its context, in CSS pixels, and its size.
export function context(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas;
  const ratio = window.devicePixelRatio || 1;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  return { pen, width, height };
}

// The smallest of 1, 2, 5, 10, ... that is not below the value.
function niceAbove(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 5, 10].map((step) => step * power).find((step) => step >= value * 0.999) ?? value;
}

export class Chart {
  // `least` is the smallest top of the scale; with `signed` the scale goes as far below zero.
  constructor(parent, { title, unit, least, signed = false, note = "" }) {
    Object.assign(this, { title, unit, least, signed, points: [] });
    const box = document.createElement("div");
    box.className = "chart";
    const head = document.createElement("div");
    const heading = document.createElement("h2");
    heading.textContent = `${title}, ${unit}`;
    const aside = document.createElement("p");
    aside.textContent = note;
    head.append(heading, aside);
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("role", "img");
    box.append(head, this.canvas);
    parent.append(box);
  }

  // `t` in s; a value that is null is left out.
  push(t, first, second = null) {
    const last = this.points.at(-1);
    if (last && t < last.t) {
      this.points = [];
    }
    this.points.push({ t, values: [first, second] });
    const from = this.points.findIndex((point) => point.t >= t - SPAN_S);
    this.points.splice(0, from);
  }

  // The extremes of the first quantity, in words.
  describe() {
    const values = this.points.map((point) => point.values[0]).filter((value) => value !== null);
    const text = values.length === 0 ? "no values"
      : `${Math.min(...values).toPrecision(2)} to ${Math.max(...values).toPrecision(2)} ${this.unit}`;
    this.canvas.setAttribute("aria-label", `${this.title} in the last ${SPAN_S} s: ${text}`);
  }

  draw() {
    const { pen, width, height } = context(this.canvas);
    const colour = colours(this.canvas);
    const values = this.points.flatMap((point) => point.values).filter((value) => value !== null);
    const top = niceAbove(Math.max(this.least, ...values.map(Math.abs)));
    const bottom = this.signed ? -top : 0;
    const [left, edge] = [36, 5];
    const end = this.points.at(-1)?.t ?? 0;
    const x = (t) => left + (width - left) * (1 - (end - t) / SPAN_S);
    const y = (value) => edge + (height - 2 * edge) * (top - value) / (top - bottom);
    pen.font = colour.font;
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    pen.lineWidth = 1;
    for (const value of this.signed ? [top, 0, bottom] : [top, 0]) {
      pen.strokeStyle = colour.line;
      line(pen, [[left, Math.round(y(value)) + 0.5], [width, Math.round(y(value)) + 0.5]]);
      pen.fillStyle = colour.soft;
      pen.fillText(String(Number(value.toPrecision(2))), left - 6, y(value));
    }
    for (const [index, stroke, dash, thick] of [[1, colour.soft, [3, 3], 1], [0, colour.accent, [], 1.5]]) {
      pen.strokeStyle = stroke;
      pen.lineWidth = thick;
      pen.setLineDash(dash);
      let run = [];
      let before = -Infinity;
      for (const { t, values } of this.points) {
        if (values[index] === null || t - before > GAP_S) {
          line(pen, run);
          run = [];
        }
        if (values[index] !== null) {
          run.push([x(t), y(Math.min(top, Math.max(bottom, values[index])))]);
          before = t;
        }
      }
      line(pen, run);
    }
    pen.setLineDash([]);
  }
}

// Strokes an open line.
export function line(pen, points) {
  pen.beginPath();
  points.forEach(([x, y], index) => (index === 0 ? pen.moveTo(x, y) : pen.lineTo(x, y)));
  pen.stroke();
}
