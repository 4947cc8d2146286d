// Draws the figures of a report on canvases: zoom and cursor are shared by all
// plots over time, and the map follows them. No library, no network.
"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const columns = data.columns.map((text) => {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    return new Float32Array(bytes.buffer);
  });
  const whole = { from: 0, to: Math.max(data.end, 1e-3) };
  const view = { ...whole };
  let cursor = null;
  const panels = [];
  const clock = document.getElementById("clock");

  // ---- numbers -----------------------------------------------------------

  const round = (value, digits) => {
    const text = value.toFixed(digits).replace("-", "\u2212");
    return /[1-9]/.test(text) ? text : text.replace("\u2212", "");
  };
  const digitsOf = (step) => Math.max(0, -Math.floor(Math.log10(step) + 1e-9));

  /** Round numbers within a range, about `count` of them, and their digits. */
  function ticks(low, high, count) {
    const least = (high - low) / Math.max(1, count);
    const power = 10 ** Math.floor(Math.log10(least));
    const step = [1, 2, 5, 10].map((f) => f * power).find((s) => s >= least * (1 - 1e-9));
    const values = [];
    for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) {
      values.push(i * step);
    }
    return { values, digits: digitsOf(step) };
  }

  /** The decades within a range, and 2 and 5 times them between few. */
  function powers(low, high) {
    const factors = Math.log10(high / low) < 2.5 ? [1, 2, 5] : [1];
    const values = [];
    for (let power = Math.floor(Math.log10(low)); 10 ** power <= high; power++) {
      values.push(...factors.map((factor) => factor * 10 ** power));
    }
    return values.filter((value) => value >= low * (1 - 1e-9) && value <= high * (1 + 1e-9));
  }

  /** The first index whose value is not less than `time`. */
  function firstFrom(times, time) {
    let [low, high] = [0, times.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (times[middle] < time) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** The index nearest to `time`; -1 if there is none near. */
  function nearest(times, time) {
    const after = firstFrom(times, time);
    const before = after - 1;
    const best = before >= 0 && (after >= times.length || time - times[before] < times[after] - time)
      ? before : after;
    return best < times.length && Math.abs(times[best] - time) < 0.5 ? best : -1;
  }

  // A gap has no time; its neighbours' keeps the times in order.
  function orderly(times) {
    for (let i = 0; i < times.length; i++) {
      if (Number.isNaN(times[i])) times[i] = i > 0 ? times[i - 1] : 0;
    }
    return times;
  }

  function padded(low, high, edge) {
    if (!(low <= high)) return [0, 1];
    const spread = high - low;
    const pad = spread > 1e-6 ? 0.06 * spread : Math.max(0.1 * Math.abs(high), 1e-3);
    return [edge === low ? low : low - pad, high + pad];
  }

  // ---- colours -----------------------------------------------------------

  const looks = {
    nominal: { width: 3.5, dash: [] },
    actual: { width: 1.4, dash: [] },
    measured: { width: 1, dash: [] },
    truth: { width: 1.3, dash: [5, 3] },
    lost: { width: 9, dash: [] },
  };
  const colour = (name) =>
    getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

  // ---- panels ------------------------------------------------------------

  const element = (tag, attributes, parent) => {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    if (parent) parent.append(made);
    return made;
  };

  const plain = ({ quantity, letter, below, unit }) => `${quantity} ${letter}${below} in ${unit}`.trim();

  /** The name of an axis about a point, its symbol with a subscript. */
  function writeName(pen, { quantity, letter, below, unit }, x, y) {
    const font = colour("font");
    const parts = [
      [`${quantity} `.trimStart(), `13px ${font}`, 0],
      [letter, `italic 13px ${font}`, 0],
      [below, `10px ${font}`, 4],
      [` (${unit})`, `13px ${font}`, 0],
    ].map(([text, face, drop]) => {
      pen.font = face;
      return { text, face, drop, width: pen.measureText(text).width };
    });
    let left = x - parts.reduce((sum, part) => sum + part.width, 0) / 2;
    pen.textAlign = "left";
    for (const { text, face, drop, width } of parts) {
      pen.font = face;
      pen.fillText(text, left, y + drop);
      left += width;
    }
  }

  // What can't be seen need not be drawn.
  const onScreen = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) target.panel.visible = isIntersecting;
    schedule("cursor");
  }, { rootMargin: "200px" });

  class Panel {
    constructor(spec, figure, parent) {
      this.spec = spec;
      this.hidden = new Set();
      this.curves = spec.curves.map((curve) => ({
        ...curve,
        x: columns[curve.x],
        y: columns[curve.y],
        time: orderly(columns[curve.time]),
      }));
      const box = element("div", { class: "panel" }, parent);
      this.legend = element("div", { class: spec.equal ? "legend map-legend" : "legend" }, box);
      this.curves.forEach((curve) => this.addToggle(curve));
      if (spec.spans.length > 0) {
        const key = element("span", { class: "key" }, this.legend);
        element("i", { class: "sample lost", "aria-hidden": "true" }, key);
        key.append(spec.span);
      }
      this.stage = element("div", { class: spec.equal ? "stage map" : "stage" }, box);
      this.base = element("canvas", { "aria-hidden": "true" }, this.stage);
      this.over = element("canvas", {
        tabindex: "0",
        role: "img",
        "aria-label": `${figure.title}: ${plain(spec.y)} over ${plain(spec.x)}. ${figure.caption}`,
      }, this.stage);
      [this.visible, this.stale] = [false, true];
      this.stage.panel = this;
      onScreen.observe(this.stage);
      listen(this);
    }

    addToggle(curve) {
      const button = element("button", { type: "button", "aria-pressed": "true" }, this.legend);
      element("i", { class: `sample ${curve.look}`, "aria-hidden": "true" }, button);
      button.append(curve.name);
      curve.value = element("span", { class: "value" }, button);
      button.addEventListener("click", () => {
        const hide = !this.hidden.has(curve);
        this.hidden[hide ? "add" : "delete"](curve);
        button.setAttribute("aria-pressed", String(!hide));
        redraw();
      });
    }

    /** Sizes the canvases and finds the ranges of the axes. */
    measure() {
      const { clientWidth: width, clientHeight: height } = this.stage;
      const scale = window.devicePixelRatio || 1;
      for (const canvas of [this.base, this.over]) {
        canvas.width = Math.round(width * scale);
        canvas.height = Math.round(height * scale);
        canvas.getContext("2d").setTransform(scale, 0, 0, scale, 0, 0);
      }
      this.size = { width, height };
      this.area = { left: 58, right: width - 12, top: 8, bottom: height - 40 };
      const shown = this.curves.filter((curve) => !this.hidden.has(curve));
      const extremes = (name, from, to) => {
        let [low, high] = [Infinity, -Infinity];
        for (const curve of shown) {
          const end = to === undefined ? curve[name].length : firstFrom(curve.time, to) + 1;
          const begin = from === undefined ? 0 : Math.max(0, firstFrom(curve.time, from) - 1);
          for (let i = begin; i < Math.min(end, curve[name].length); i++) {
            if (curve[name][i] < low) low = curve[name][i];
            if (curve[name][i] > high) high = curve[name][i];
          }
        }
        return [low, high];
      };
      if (!this.spec.equal) {
        this.xRange = [view.from, view.to];
        const [low, high] = extremes("y", view.from, view.to);
        const edge = this.spec.y.include;
        const zoomed = view.from > whole.from || view.to < whole.to;
        const least = edge === null || zoomed ? low : Math.min(low, edge);
        this.yRange = !this.spec.y.log ? padded(least, high, edge) : least <= high
          ? [10 ** Math.floor(Math.log10(least)), 10 ** Math.ceil(Math.log10(high * 1.001))] : [1, 10];
        return;
      }
      const [x, y] = [padded(...extremes("x")), padded(...extremes("y"))];
      const { left, right, top, bottom } = this.area;
      const unit = Math.max((x[1] - x[0]) / (right - left), (y[1] - y[0]) / (bottom - top));
      const widen = ([low, high], length) => {
        const middle = (low + high) / 2;
        return [middle - unit * length / 2, middle + unit * length / 2];
      };
      this.xRange = widen(x, right - left);
      this.yRange = widen(y, bottom - top);
    }

    px(x) {
      const [low, high] = this.xRange;
      return this.area.left + (x - low) / (high - low) * (this.area.right - this.area.left);
    }

    py(y) {
      const even = this.spec.y.log ? Math.log10 : (value) => value;
      const [low, high] = this.yRange.map(even);
      return this.area.bottom - (even(y) - low) / (high - low) * (this.area.bottom - this.area.top);
    }

    timeAt(pixel) {
      const part = (pixel - this.area.left) / (this.area.right - this.area.left);
      return view.from + Math.min(1, Math.max(0, part)) * (view.to - view.from);
    }

    draw() {
      this.measure();
      const pen = this.base.getContext("2d");
      const { left, right, top, bottom } = this.area;
      pen.clearRect(0, 0, this.size.width, this.size.height);
      pen.save();
      pen.beginPath();
      pen.rect(left, top, right - left, bottom - top);
      pen.clip();
      pen.fillStyle = colour("lost");
      for (const [from, to] of this.spec.spans) {
        const x = this.px(from);
        pen.fillRect(x, top, Math.max(1, this.px(to) - x), bottom - top);
      }
      pen.restore();
      this.drawAxes(pen);
      pen.save();
      pen.beginPath();
      pen.rect(left, top, right - left, bottom - top);
      pen.clip();
      for (const curve of this.curves) {
        if (!this.hidden.has(curve)) this.drawCurve(pen, curve);
      }
      pen.restore();
      this.drawMarks(pen);
      this.drawCursor();
      this.stale = false;
    }

    drawAxes(pen) {
      const { left, right, top, bottom } = this.area;
      const x = ticks(...this.xRange, (right - left) / 80);
      const y = this.spec.y.log ? { values: powers(...this.yRange) }
        : ticks(...this.yRange, (bottom - top) / 38);
      pen.font = `12px ${colour("font")}`;
      pen.lineWidth = 1;
      pen.strokeStyle = colour("grid");
      pen.fillStyle = colour("ink");
      pen.textAlign = "center";
      pen.textBaseline = "top";
      for (const value of x.values) {
        const at = Math.round(this.px(value)) + 0.5;
        stroke(pen, [[at, top], [at, bottom]]);
        pen.fillText(round(value, x.digits), at, bottom + 5);
      }
      pen.textAlign = "right";
      pen.textBaseline = "middle";
      for (const value of y.values) {
        const at = Math.round(this.py(value)) + 0.5;
        stroke(pen, [[left, at], [right, at]]);
        pen.fillText(round(value, y.digits ?? digitsOf(value)), left - 6, at);
      }
      pen.strokeStyle = colour("ink");
      pen.strokeRect(left + 0.5, top + 0.5, right - left - 1, bottom - top - 1);
      writeName(pen, this.spec.x, (left + right) / 2, bottom + 30);
      pen.save();
      pen.translate(10, (top + bottom) / 2);
      pen.rotate(-Math.PI / 2);
      writeName(pen, this.spec.y, 0, 0);
      pen.restore();
    }

    drawCurve(pen, curve) {
      const look = looks[curve.look];
      pen.strokeStyle = colour(curve.look);
      pen.lineWidth = look.width;
      pen.setLineDash(look.dash);
      pen.lineJoin = "round";
      const begin = Math.max(0, firstFrom(curve.time, view.from) - 1);
      const end = Math.min(curve.time.length, firstFrom(curve.time, view.to) + 1);
      if (!this.spec.equal) {
        this.strokeDecimated(pen, curve, begin, end);
      } else {
        const zoomed = view.from > whole.from || view.to < whole.to;
        if (zoomed) {
          pen.globalAlpha = 0.2;
          this.strokePath(pen, curve, 0, curve.x.length);
          pen.globalAlpha = 1;
        }
        this.strokePath(pen, curve, begin, end);
      }
      pen.setLineDash([]);
    }

    /** All points, but those that fall on the one before. */
    strokePath(pen, { x, y }, begin, end) {
      pen.beginPath();
      let down = false;
      let [lastX, lastY] = [0, 0];
      for (let i = begin; i < end; i++) {
        const [px, py] = [this.px(x[i]), this.py(y[i])];
        if (Number.isNaN(px) || Number.isNaN(py)) {
          down = false;
        } else if (!down) {
          pen.moveTo(px, py);
          [down, lastX, lastY] = [true, px, py];
        } else if (Math.abs(px - lastX) + Math.abs(py - lastY) > 0.4) {
          pen.lineTo(px, py);
          [lastX, lastY] = [px, py];
        }
      }
      pen.stroke();
    }

    /** First, lowest, highest and last point of every column of pixels. */
    strokeDecimated(pen, { time, y }, begin, end) {
      pen.beginPath();
      let down = false;
      let i = begin;
      const perPixel = (view.to - view.from) / (this.area.right - this.area.left);
      while (i < end) {
        if (Number.isNaN(y[i])) {
          down = false;
          i += 1;
          continue;
        }
        const until = time[i] + perPixel / 2;
        const x = this.px(time[i]);
        const first = y[i];
        let [low, high, last] = [first, first, first];
        for (i += 1; i < end && time[i] < until && !Number.isNaN(y[i]); i++) {
          last = y[i];
          if (last < low) low = last;
          if (last > high) high = last;
        }
        if (down) pen.lineTo(x, this.py(first));
        else pen.moveTo(x, this.py(first));
        down = true;
        if (low !== high) {
          pen.lineTo(x, this.py(low));
          pen.lineTo(x, this.py(high));
          pen.lineTo(x, this.py(last));
        }
      }
      pen.stroke();
    }

    drawMarks(pen) {
      pen.fillStyle = colour("page");
      pen.strokeStyle = colour("ink");
      pen.lineWidth = 1.6;
      for (const { kind, point } of this.spec.marks) {
        const [x, y] = [this.px(point[0]), this.py(point[1])];
        pen.beginPath();
        if (kind === "start") {
          pen.moveTo(x, y - 7);
          pen.lineTo(x + 6.5, y + 5);
          pen.lineTo(x - 6.5, y + 5);
          pen.closePath();
        } else {
          pen.arc(x, y, 5.5, 0, 2 * Math.PI);
        }
        pen.fill();
        pen.stroke();
      }
    }

    /** The cursor, what is at it, and the range that is being dragged. */
    drawCursor() {
      const pen = this.over.getContext("2d");
      const { left, top, bottom } = this.area;
      pen.clearRect(0, 0, this.size.width, this.size.height);
      if (this.dragged) {
        const [from, to] = this.dragged;
        pen.fillStyle = colour("select");
        pen.fillRect(Math.min(from, to), top, Math.abs(to - from), bottom - top);
      }
      const visible = cursor !== null && cursor >= view.from && cursor <= view.to;
      if (visible && !this.spec.equal) {
        const x = Math.max(left, this.px(cursor));
        pen.strokeStyle = colour("cursor");
        pen.lineWidth = 1;
        stroke(pen, [[x, top], [x, bottom]]);
      }
      for (const curve of this.curves) {
        const index = visible && !this.hidden.has(curve) ? nearest(curve.time, cursor) : -1;
        const [x, y] = index < 0 ? [NaN, NaN] : [curve.x[index], curve.y[index]];
        const known = !Number.isNaN(x) && !Number.isNaN(y);
        const digits = this.spec.y.log ? 1 : digitsOf((this.yRange[1] - this.yRange[0]) / 1000);
        const value = this.spec.equal ? `(${round(x, digits)}, ${round(y, digits)})` : round(y, digits);
        curve.value.textContent = known ? value : "";
        if (!known || curve.look === "lost") continue;
        pen.beginPath();
        pen.arc(this.px(x), this.py(y), 4, 0, 2 * Math.PI);
        pen.fillStyle = colour(curve.look);
        pen.strokeStyle = colour("page");
        pen.lineWidth = 1.5;
        pen.fill();
        pen.stroke();
      }
    }
  }

  function stroke(pen, [[x1, y1], [x2, y2]]) {
    pen.beginPath();
    pen.moveTo(x1, y1);
    pen.lineTo(x2, y2);
    pen.stroke();
  }

  // ---- what a person does ------------------------------------------------

  function look(from, to) {
    const least = Math.min(0.02, whole.to);
    if (to - from < least) {
      const middle = (from + to) / 2;
      [from, to] = [middle - least / 2, middle + least / 2];
    }
    const length = Math.min(to - from, whole.to - whole.from);
    view.from = Math.min(Math.max(from, whole.from), whole.to - length);
    view.to = view.from + length;
    redraw();
  }

  const zoom = (factor, at) => look(at - (at - view.from) * factor, at + (view.to - at) * factor);
  const pan = (by) => look(view.from + by, view.to + by);

  function point(time) {
    cursor = time;
    clock.textContent = time === null ? "" : `t = ${round(time, 3)} s`;
    schedule("cursor");
  }

  function listen(panel) {
    const surface = panel.over;
    surface.addEventListener("dblclick", () => look(whole.from, whole.to));
    surface.addEventListener("keydown", (event) => {
      const length = view.to - view.from;
      const step = length * (event.shiftKey ? 0.1 : 0.01);
      const at = cursor ?? (view.from + view.to) / 2;
      const within = (time) => Math.min(view.to, Math.max(view.from, time));
      const actions = {
        ArrowLeft: () => point(within(at - step)),
        ArrowRight: () => point(within(at + step)),
        Home: () => point(view.from),
        End: () => point(view.to),
        PageUp: () => pan(-length / 2),
        PageDown: () => pan(length / 2),
        "+": () => zoom(0.7, at),
        "-": () => zoom(1 / 0.7, at),
        Escape: () => look(whole.from, whole.to),
      };
      if (actions[event.key]) {
        actions[event.key]();
        event.preventDefault();
      }
    });
    surface.addEventListener("pointerleave", () => point(null));
    if (panel.spec.equal) {
      surface.addEventListener("pointermove", (event) => point(nearestOnMap(panel, event)));
      return;
    }
    surface.addEventListener("wheel", (event) => {
      event.preventDefault();
      zoom(Math.exp(Math.max(-1, Math.min(1, event.deltaY * 0.003))), panel.timeAt(event.offsetX));
    }, { passive: false });
    let start = null;
    surface.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      start = { pixel: event.offsetX, pan: event.shiftKey };
      surface.setPointerCapture(event.pointerId);
    });
    surface.addEventListener("pointermove", (event) => {
      if (start?.pan) {
        pan(panel.timeAt(start.pixel) - panel.timeAt(event.offsetX));
        start.pixel = event.offsetX;
      } else if (start) {
        panel.dragged = [start.pixel, event.offsetX];
      }
      point(panel.timeAt(event.offsetX));
    });
    const end = (event) => {
      if (panel.dragged && event.type === "pointerup") {
        const [from, to] = [...panel.dragged].sort((one, other) => one - other);
        if (to - from > 4) look(panel.timeAt(from), panel.timeAt(to));
      }
      panel.dragged = null;
      start = null;
      schedule("cursor");
    };
    surface.addEventListener("pointerup", end);
    surface.addEventListener("pointercancel", end);
  }

  /** When the actual path, within the times in view, was nearest to the pointer. */
  function nearestOnMap(panel, event) {
    const curve = panel.curves.find((one) => one.look === "actual") ?? panel.curves[0];
    let [best, time] = [40 ** 2, null];
    const end = firstFrom(curve.time, view.to);
    for (let i = firstFrom(curve.time, view.from); i < end; i++) {
      const [dx, dy] = [panel.px(curve.x[i]) - event.offsetX, panel.py(curve.y[i]) - event.offsetY];
      const square = dx * dx + dy * dy;
      if (square < best) [best, time] = [square, curve.time[i]];
    }
    return time;
  }

  // ---- drawing in time with the screen ------------------------------------

  let due = null;
  function schedule(what) {
    if (due === null) {
      requestAnimationFrame(() => {
        const todo = due;
        due = null;
        for (const panel of panels) {
          panel.stale ||= todo === "all";
          if (!panel.visible) continue;
          if (panel.stale) panel.draw();
          else panel.drawCursor();
        }
      });
    }
    if (due !== "all") due = what;
  }
  const redraw = () => schedule("all");

  for (const figure of data.figures) {
    const live = document.querySelector(`#${figure.id} .live`);
    for (const spec of figure.panels) panels.push(new Panel(spec, figure, live));
  }
  document.documentElement.classList.add("interactive");
  document.getElementById("reset").addEventListener("click", () => look(whole.from, whole.to));
  window.addEventListener("resize", redraw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  redraw();
})();
