// Charts over one time axis: states, classes, confidence, errors, margin and ages.
import { LANES, STATES, CLASSES, number } from "./format.js";

const COLOURS = ["panel", "line", "text", "muted", "grid", "good", "warn", "bad", "calm", "running", "stopping", "standing",
  "starting", "control", "plan", "gap", "odds"];
const LEFT = 140, RIGHT = 104, TOP = 6, BOTTOM = 20, BETWEEN = 7;
const FONT = "11px system-ui, 'DejaVu Sans', sans-serif";
const ODDS = 13;
const ROWS = [
  { name: "state", weight: 0.42 },
  { name: "class", weight: 1.25 },
  { name: "odds", weight: 0.9 },
  { name: "errors", weight: 1.35 },
  { name: "margin", weight: 0.8 },
  { name: "ages", weight: 0.8 },
];
const ERRORS = [["control_mm", "control", []], ["plan_mm", "plan", [6, 3]], ["gap_mm", "gap", [1.5, 3]]];
const AGES = [["distance", "control", []], ["camera", "plan", [6, 3]], ["wrench", "gap", [1.5, 3]]];
const KINDS = { good: "good", warn: "warn", bad: "bad", unknown: "calm" };

export class Charts {
  constructor(canvas, seek) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.kept = null;
    this.restyle();
    let isDragging = false;
    const seekTo = (event) => {
      if (!this.span) return;
      const x = event.offsetX - LEFT;
      seek(this.span[0] + (x / (this.canvas.clientWidth - LEFT - RIGHT)) * (this.span[1] - this.span[0]));
    };
    canvas.addEventListener("pointerdown", (event) => { isDragging = true; seekTo(event); });
    canvas.addEventListener("pointermove", (event) => { if (isDragging) seekTo(event); });
    addEventListener("pointerup", () => { isDragging = false; });
  }

  restyle() {
    const style = getComputedStyle(document.documentElement);
    this.colour = Object.fromEntries(COLOURS.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
    this.kept = null;
  }

  draw(history, span, now, isWhole, events) {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.span = span[1] > span[0] ? span : [span[0], span[0] + 1];
    this.size = [width, height];
    const wanted = [Math.round(width * ratio), Math.round(height * ratio)];
    if (this.canvas.width !== wanted[0] || this.canvas.height !== wanted[1]) {
      [this.canvas.width, this.canvas.height] = wanted;
      this.kept = null;
    }
    const c = this.context;
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    if (isWhole && this.kept && this.kept.of === history) {
      c.setTransform(1, 0, 0, 1, 0, 0);
      c.drawImage(this.kept.image, 0, 0);
      c.setTransform(ratio, 0, 0, ratio, 0, 0);
    } else {
      this.all(history, isWhole, events, now);
      if (isWhole && history.length) {
        const image = new OffscreenCanvas(...wanted);
        image.getContext("2d").drawImage(this.canvas, 0, 0);
        this.kept = { of: history, image };
      }
    }
    if (isWhole) this.cursor(now, history);
    else this.newest(history[history.length - 1]);
  }

  x(t) { return LEFT + ((t - this.span[0]) / (this.span[1] - this.span[0])) * (this.size[0] - LEFT - RIGHT); }

  all(history, isWhole, events, now) {
    const c = this.context;
    c.font = FONT;
    const free = this.size[1] - TOP - BOTTOM - BETWEEN * (ROWS.length - 1);
    const weights = ROWS.reduce((sum, row) => sum + row.weight, 0);
    let y = TOP;
    this.rows = {};
    for (const row of ROWS) {
      const height = (free * row.weight) / weights;
      this.rows[row.name] = [y, y + height];
      y += height + BETWEEN;
    }
    this.axis(isWhole, now);
    const first = history.findIndex((frame) => frame.t >= this.span[0]);
    const shown = first < 0 ? [] : history.slice(Math.max(0, first - 1));
    c.save();
    c.beginPath(); c.rect(LEFT, 0, this.size[0] - LEFT - RIGHT, this.size[1]); c.clip();
    this.states(shown);
    this.classes(shown);
    c.restore();
    this.frameOf("odds", "change log odds", [[-10, "−10"], [0, "0"], [10, "+10"]], -ODDS, ODDS);
    this.series("odds", shown, (frame) => frame.confidence, "odds", [], -ODDS, ODDS);
    const decades = [[-2, "0.01"], [-1, "0.1"], [0, "1 mm"], [1, "10"], [2, "100"]];
    this.frameOf("errors", "errors", decades, -2.3, 2.9);
    for (const [name, colour, dash] of ERRORS) {
      this.series("errors", shown, (frame) => (frame.errors && frame.errors[name] !== undefined ? Math.log10(Math.max(1e-3, frame.errors[name])) : undefined), colour, dash, -2.3, 2.9);
    }
    const cycle = this.cycle(history);
    this.frameOf("margin", "margin", [[0, "0"], [cycle, `${number(cycle, 0)} ms`]], -0.1 * cycle, 1.1 * cycle);
    this.series("margin", shown, (frame) => frame.margin_ms, "good", [], -0.1 * cycle, 1.1 * cycle);
    const live = shown.some((frame) => frame.ages_ms);
    this.frameOf("ages", live || !isWhole ? "sensor ages" : "speed", live || !isWhole ? [[0, "1 ms"], [1, "10"], [2, "100"], [3, "1 s"]] : [[0, "0"], [0.1, "100 mm/s"]], ...(live || !isWhole ? [-0.2, 3.4] : [-0.02, 0.13]));
    if (live || !isWhole) {
      for (const [name, colour, dash] of AGES) {
        this.series("ages", shown, (frame) => (frame.ages_ms && frame.ages_ms[name] !== undefined ? Math.log10(Math.max(1, frame.ages_ms[name])) : undefined), colour, dash, -0.2, 3.4);
      }
    } else this.series("ages", shown, (frame) => frame.speed, "control", [], -0.02, 0.13);
    this.marks(events);
  }

  cycle(history) {
    const last = history[history.length - 1];
    if (last && last.cycle_ms) return last.cycle_ms;
    const most = Math.max(0, ...history.map((frame) => frame.margin_ms || 0));
    return most > 4 || !most ? 12 : 4;
  }

  axis(isWhole, now) {
    const c = this.context;
    const length = this.span[1] - this.span[0];
    const step = [1, 2, 5, 10, 30, 60, 300, 600, 1800].find((step_s) => length / step_s <= 14) || 3600;
    const origin = isWhole ? 0 : now;
    c.strokeStyle = this.colour.grid; c.fillStyle = this.colour.muted; c.lineWidth = 1; c.textAlign = "center";
    for (let i = Math.ceil((this.span[0] - origin) / step); i * step + origin <= this.span[1] + 1e-9; i += 1) {
      const x = this.x(i * step + origin);
      c.beginPath(); c.moveTo(x, TOP); c.lineTo(x, this.size[1] - BOTTOM); c.stroke();
      const label = !isWhole && i === 0 ? "now" : `${i * step} s`;
      c.fillText(label, x, this.size[1] - 6);
    }
    c.textAlign = "start";
  }

  // Stretches of frames with an equal key.
  stretches(frames, key) {
    const stretches = [];
    for (const frame of frames) {
      const value = key(frame);
      const last = stretches[stretches.length - 1];
      if (last && last.value === value) last.end = frame.t;
      else {
        if (last) last.end = frame.t;
        stretches.push({ value, begin: frame.t, end: frame.t });
      }
    }
    return stretches;
  }

  name(row, text) {
    const c = this.context;
    const [top, bottom] = this.rows[row];
    c.fillStyle = this.colour.text; c.textAlign = "start";
    c.fillText(text, 10, (top + bottom) / 2 + 4);
  }

  states(frames) {
    const c = this.context;
    const [top, bottom] = this.rows.state;
    for (const { value, begin, end } of this.stretches(frames, (frame) => frame.state)) {
      const [glyph, kind] = STATES[value] || ["?", "unknown"];
      const [from, to] = [this.x(begin), this.x(end)];
      c.fillStyle = this.colour[KINDS[kind]]; c.globalAlpha = 0.28; c.fillRect(from, top, to - from, bottom - top); c.globalAlpha = 1;
      c.fillRect(from, top, 2, bottom - top);
      c.save(); c.beginPath(); c.rect(from, top, Math.max(0, to - from), bottom - top); c.clip();
      c.fillStyle = this.colour.text; c.fillText(`${glyph} ${value}`, from + 6, (top + bottom) / 2 + 4); c.restore();
    }
    c.restore(); c.save(); this.name("state", "state");
    c.beginPath(); c.rect(LEFT, 0, this.size[0] - LEFT - RIGHT, this.size[1]); c.clip();
  }

  classes(frames) {
    const c = this.context;
    const [top, bottom] = this.rows.class;
    const height = (bottom - top) / LANES.length;
    const lane = (name) => top + (LANES.indexOf(name) + 0.5) * height;
    c.restore(); c.save();
    LANES.forEach((name) => {
      c.strokeStyle = this.colour.grid; c.beginPath(); c.moveTo(LEFT, lane(name)); c.lineTo(this.size[0] - RIGHT, lane(name)); c.stroke();
      c.fillStyle = this.colour[name]; c.textAlign = "right"; c.fillText(`${name} ${CLASSES[name]}`, LEFT - 8, lane(name) + 4); c.textAlign = "start";
    });
    c.beginPath(); c.rect(LEFT, 0, this.size[0] - LEFT - RIGHT, this.size[1]); c.clip();
    let before = null;
    for (const { value, begin, end } of this.stretches(frames, (frame) => `${frame.scenario || ""}|${frame.tentative ? 1 : 0}`)) {
      const [name, tentative] = value.split("|");
      if (LANES.includes(name)) {
        const [from, to, y] = [this.x(begin), Math.max(this.x(end), this.x(begin) + 3), lane(name)];
        if (before !== null && before !== y) { c.strokeStyle = this.colour.muted; c.beginPath(); c.moveTo(from, before); c.lineTo(from, y); c.stroke(); }
        const thick = Math.min(11, height - 4);
        if (tentative === "1") { c.strokeStyle = this.colour[name]; c.setLineDash([3, 2]); c.lineWidth = 1.5; c.strokeRect(from, y - thick / 2, to - from, thick); c.setLineDash([]); c.lineWidth = 1; }
        else { c.fillStyle = this.colour[name]; c.fillRect(from, y - thick / 2, to - from, thick); }
        before = y;
      } else before = null;
    }
  }

  frameOf(row, name, ticks, low, high) {
    const c = this.context;
    const [top, bottom] = this.rows[row];
    this.name(row, name);
    c.textAlign = "right";
    for (const [value, label] of ticks) {
      const y = bottom - ((value - low) / (high - low)) * (bottom - top);
      c.strokeStyle = this.colour.grid; c.beginPath(); c.moveTo(LEFT, y); c.lineTo(this.size[0] - RIGHT, y); c.stroke();
      c.fillStyle = this.colour.muted; c.fillText(label, LEFT - 8, y + 4);
    }
    c.textAlign = "start";
    c.strokeStyle = this.colour.line; c.strokeRect(LEFT, top, this.size[0] - LEFT - RIGHT, bottom - top);
  }

  series(row, frames, of, colour, dash, low, high) {
    const c = this.context;
    const [top, bottom] = this.rows[row];
    c.save();
    c.beginPath(); c.rect(LEFT, top, this.size[0] - LEFT - RIGHT, bottom - top); c.clip();
    c.beginPath();
    let last = null;
    for (const frame of frames) {
      const value = of(frame);
      if (value === undefined || value === null) { last = null; continue; }
      const x = this.x(frame.t);
      const y = bottom - ((Math.max(low, Math.min(high, value)) - low) / (high - low)) * (bottom - top);
      if (last === null || frame.t - last > 1) c.moveTo(x, y); else c.lineTo(x, y);
      last = frame.t;
    }
    c.strokeStyle = this.colour[colour]; c.lineWidth = 1.6; c.setLineDash(dash); c.lineJoin = "round"; c.stroke();
    c.restore();
  }

  marks(events) {
    const c = this.context;
    for (const event of events || []) {
      if (event.t < this.span[0] || event.t > this.span[1] || !/^conveyor: (stop|start) /.test(event.text)) continue;
      const x = this.x(event.t);
      c.strokeStyle = this.colour.muted; c.setLineDash(/confirmed/.test(event.text) ? [] : [2, 3]);
      c.beginPath(); c.moveTo(x, this.rows.class[0]); c.lineTo(x, this.rows.errors[1]); c.stroke(); c.setLineDash([]);
    }
  }

  cursor(now, history) {
    const c = this.context;
    const x = this.x(now);
    c.strokeStyle = this.colour.text; c.lineWidth = 1.5;
    c.beginPath(); c.moveTo(x, TOP); c.lineTo(x, this.size[1] - BOTTOM); c.stroke(); c.lineWidth = 1;
    let low = 0, high = history.length;
    while (low < high) { const middle = (low + high) >> 1; if (history[middle].t <= now) low = middle + 1; else high = middle; }
    this.newest(history[Math.max(0, low - 1)]);
  }

  // The values at the cursor, or the newest, to the right of their lines.
  newest(frame) {
    if (!frame || !this.rows) return;
    const c = this.context;
    c.font = FONT;
    const x = this.size[0] - RIGHT + 8;
    const label = (row, lines) => {
      const [top, bottom] = this.rows[row];
      const step = Math.min(14, (bottom - top) / lines.length);
      lines.forEach(([text, colour, dash], i) => {
        const y = (top + bottom) / 2 + (i - (lines.length - 1) / 2) * step;
        c.strokeStyle = c.fillStyle = this.colour[colour];
        if (dash) {
          // Lines differ by their dashes too.
          c.setLineDash(dash); c.lineWidth = 1.6;
          c.beginPath(); c.moveTo(x, y); c.lineTo(x + 14, y); c.stroke();
          c.setLineDash([]); c.lineWidth = 1;
        }
        c.fillText(text, x + (dash ? 18 : 0), y + 4);
      });
    };
    if (frame.confidence !== undefined) label("odds", [[`${frame.confidence > 0 ? "+" : ""}${number(frame.confidence, 1)}`, "odds"]]);
    const errors = frame.errors || {};
    label("errors", ERRORS.map(([name, colour, dash]) => [`${name.slice(0, -3)} ${number(errors[name])}`, colour, dash]));
    if (frame.margin_ms !== undefined) label("margin", [[`${number(frame.margin_ms, 2)} ms`, "good"]]);
    if (frame.ages_ms) label("ages", AGES.map(([name, colour, dash]) => [`${name} ${number(frame.ages_ms[name], 0)}`, colour, dash]));
    else if (frame.speed !== undefined) label("ages", [[`${number(1000 * frame.speed, 0)} mm/s`, "control"]]);
    if (frame.speed !== undefined && frame.scenario) label("class", [[`${number(1000 * frame.speed, 0)} mm/s`, frame.scenario in this.colour ? frame.scenario : "text"]]);
  }
}
