// A strip chart: the last seconds of one or two quantities, newest on the right.

export const SPAN_S = 20;
const TICK_S = 5;
// Larger than the interval of the states: a pause is drawn as a gap.
const GAP_S = 0.3;
// Around the area of the curves, in CSS pixels.
const [LEFT, TOP, BOTTOM] = [36, 5, 18];

export function colours(element) {
  const style = getComputedStyle(element);
  const colour = (name) => style.getPropertyValue(`--${name}`).trim();
  return { paper: colour("paper"), ink: colour("ink"), soft: colour("soft"), line: colour("line"),
    point: colour("point"), wanted: colour("wanted"), trail: colour("trail"),
    font: `11px ${style.fontFamily}` };
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
  // `value` and `second` are the quantities of a state, null where not known. `least` is the
  // smallest top of the scale; with `signed` the scale goes as far below zero. `onPoint` gets the
  // pointed time in s before the newest state, or null.
  constructor(parent, { title, unit, digits, least, signed = false, note = "", value, second, onPoint }) {
    Object.assign(this, { title, unit, digits, least, signed, note, value, second });
    const box = document.createElement("div");
    box.className = "chart";
    const head = document.createElement("div");
    const heading = document.createElement("h2");
    heading.textContent = `${title}, ${unit}`;
    this.aside = document.createElement("p");
    head.append(heading, this.aside);
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("role", "img");
    box.append(head, this.canvas);
    parent.append(box);
    const point = ({ offsetX }) => {
      const ago = SPAN_S * (1 - (offsetX - LEFT) / (this.canvas.clientWidth - LEFT));
      onPoint(Math.min(SPAN_S, Math.max(0, ago)));
    };
    this.canvas.addEventListener("pointerdown", point);
    this.canvas.addEventListener("pointermove", point);
    this.canvas.addEventListener("pointerleave", () => onPoint(null));
  }

  // The extremes of the first quantity, in words.
  describe(states) {
    const values = states.map(this.value).filter((value) => value !== null);
    const text = values.length === 0 ? "no values"
      : `${Math.min(...values).toPrecision(2)} to ${Math.max(...values).toPrecision(2)} ${this.unit}`;
    this.canvas.setAttribute("aria-label", `${this.title} in the last ${SPAN_S} s: ${text}`);
  }

  draw(states, ago) {
    const { pen, width, height } = context(this.canvas);
    const colour = colours(this.canvas);
    const curves = [[this.value, colour.point, [], 1.5], [this.second, colour.wanted, [3, 3], 1.5]]
      .filter(([quantity]) => quantity)
      .map(([quantity, ...look]) => [states.map(quantity), ...look]);
    const values = curves.flatMap(([all]) => all).filter((value) => value !== null);
    const top = niceAbove(Math.max(this.least, ...values.map(Math.abs)));
    const bottom = this.signed ? -top : 0;
    const end = states.at(-1)?.t_s ?? 0;
    const x = (t) => LEFT + (width - LEFT) * (1 - (end - t) / SPAN_S);
    const y = (value) => TOP + (height - TOP - BOTTOM) * (top - value) / (top - bottom);
    pen.font = colour.font;
    pen.textBaseline = "middle";
    pen.lineWidth = 1;
    pen.strokeStyle = colour.line;
    pen.fillStyle = colour.soft;
    pen.textAlign = "right";
    for (const value of this.signed ? [top, 0, bottom] : [top, 0]) {
      line(pen, [[LEFT, Math.round(y(value)) + 0.5], [width, Math.round(y(value)) + 0.5]]);
      pen.fillText(shown(value, 0), LEFT - 6, y(value));
    }
    for (let before = 0; before <= SPAN_S; before += TICK_S) {
      const at = Math.min(width - 0.5, Math.round(x(end - before)) + 0.5);
      line(pen, [[at, TOP], [at, height - BOTTOM]]);
      pen.textAlign = before === 0 ? "right" : before === SPAN_S ? "left" : "center";
      pen.fillText(before === 0 ? "now" : `${shown(-before, 0)} s`, at, height - 6);
    }
    for (const [all, stroke, dash, thick] of curves) {
      pen.strokeStyle = stroke;
      pen.lineWidth = thick;
      pen.setLineDash(dash);
      let run = [];
      let before = -Infinity;
      for (const [index, { t_s }] of states.entries()) {
        if (all[index] === null || t_s - before > GAP_S) {
          line(pen, run);
          run = [];
        }
        if (all[index] !== null) {
          run.push([x(t_s), y(Math.min(top, Math.max(bottom, all[index])))]);
          before = t_s;
        }
      }
      line(pen, run);
    }
    pen.setLineDash([]);
    this.aside.textContent = this.note;
    if (ago === null) {
      return;
    }
    pen.strokeStyle = colour.ink;
    pen.lineWidth = 1;
    line(pen, [[x(end - ago), TOP], [x(end - ago), height - BOTTOM]]);
    const index = states.findIndex(({ t_s }) => t_s >= end - ago);
    const at = states[index] && states[index].t_s - (end - ago) < GAP_S ? states[index] : null;
    const read = (quantity) => {
      const value = at && quantity(at);
      return value === null ? "–" : shown(value, this.digits);
    };
    this.aside.textContent = `${shown(-ago, 1)} s: ${read(this.value)} ${this.unit}`
      + (this.second ? `, ${this.note.split(":")[1]} ${read(this.second)}` : "");
  }
}

function shown(value, digits) {
  return value.toFixed(Math.abs(value) < 1 && value !== 0 ? Math.max(1, digits) : digits)
    .replace("-", "−");
}

// Strokes an open line.
export function line(pen, points) {
  pen.beginPath();
  points.forEach(([x, y], index) => (index === 0 ? pen.moveTo(x, y) : pen.lineTo(x, y)));
  pen.stroke();
}
