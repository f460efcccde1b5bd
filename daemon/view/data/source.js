// Where frames come from: a daemon as it goes, or a recording with a clock of its own.
const KEPT = 1000; // frames of a daemon, 40 s
const CHUNK = 250; // frames of a recording that are fetched at once
const CHUNKS = 24; // and how many of those are kept

export class Live {
  constructor(changed) {
    this.kind = "live";
    this.history = [];
    this.events = [];
    this.scene = null;
    this.status = null;
    this.link = { up: false, reason: "asking" };
    this.frame = null;
    this.heard = performance.now();
    const stream = new EventSource("stream");
    const on = (name, take) => stream.addEventListener(name, (event) => {
      take(JSON.parse(event.data));
      changed();
    });
    on("scene", (told) => { this.scene = told; this.history = []; this.events = []; });
    on("link", (told) => { this.link = told; });
    on("status", (told) => { this.status = told; });
    on("history", (told) => { this.history = told; if (told.length) this.frame = told[told.length - 1]; });
    on("happened", (told) => { this.events.push(told); if (this.events.length > 200) this.events.shift(); });
    on("frame", (told) => {
      this.heard = performance.now();
      this.frame = told;
      const last = this.history[this.history.length - 1];
      if (last && told.t < last.t) this.history = [];
      else if (last && told.t === last.t) this.history.pop();
      this.history.push(told);
      if (this.history.length > KEPT) this.history.shift();
    });
    stream.onerror = () => { if (this.link.up) this.link = { up: false, reason: "the view has ended" }; changed(); };
  }

  get silent() { return (performance.now() - this.heard) / 1000; }
  get now() { return this.frame ? this.frame.t : 0; }
  get span() { return [this.now - 30, this.now]; }
  before(step) { return this.history[Math.max(0, this.history.length - 1 - step)]; }
  advance() {}
}

export class Tape {
  constructor(number, told, changed) {
    Object.assign(this, { kind: "recording", number, changed, scene: told.scene, name: told.name, trouble: told.trouble });
    this.times = told.times;
    this.history = told.overview;
    this.events = told.happened;
    this.summary = told.summary;
    this.length = told.length_s;
    this.status = null;
    this.link = { up: true, reason: "" };
    this.frame = null;
    this.paused = false;
    this.speed = 1;
    this.now = 0;
    this.foresight = { k: -1, done: false, inexact: 0, count: 0 };
    this.chunks = new Map();
    this.tick = null;
    this.poll();
  }

  static async open(number, changed) {
    const answer = await fetch(`tape?i=${number}`);
    return new Tape(number, await answer.json(), changed);
  }

  get silent() { return 0; }
  get span() { return [0, this.length]; }

  advance(milliseconds) {
    if (!this.paused && this.times.length) {
      this.now = Math.min(this.length, this.now + (this.speed * milliseconds) / 1000);
      if (this.now >= this.length) this.paused = true;
    }
    this.show();
  }

  seek(t) { this.now = Math.max(0, Math.min(this.length, t)); this.show(); this.changed(); }

  index(t) {
    let low = 0, high = this.times.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.times[middle] <= t + 1e-9) low = middle + 1; else high = middle;
    }
    return Math.max(0, low - 1);
  }

  show() {
    const i = this.index(this.now);
    const frame = this.at(i);
    this.at(Math.min(this.times.length - 1, i + CHUNK / 2)); // what comes next
    if (frame && frame !== this.frame) { this.frame = frame; this.shown = i; this.changed(); }
  }

  before(step) { return this.at(Math.max(0, (this.shown || 0) - step)); }

  at(i) {
    const number = Math.floor(i / CHUNK);
    const chunk = this.chunks.get(number);
    if (chunk === undefined || (chunk.frames && chunk.stale && !chunk.asked)) this.fetch(number, chunk);
    return chunk && chunk.frames ? chunk.frames[i - number * CHUNK] : null;
  }

  async fetch(number, known) {
    const chunk = known || { frames: null };
    chunk.asked = true;
    chunk.stale = false;
    this.chunks.set(number, chunk);
    while (this.chunks.size > CHUNKS) this.chunks.delete(this.chunks.keys().next().value);
    const from = number * CHUNK;
    try {
      const answer = await fetch(`frames?i=${this.number}&from=${from}&to=${from + CHUNK}`);
      chunk.frames = await answer.json();
    } catch { this.chunks.delete(number); }
    chunk.asked = false;
    this.show();
  }

  async poll() {
    try {
      const before = this.foresight;
      this.foresight = await (await fetch(`progress?i=${this.number}`)).json();
      if (this.foresight.count !== before.count) {
        // What was fetched before its horizons were made again is fetched anew.
        for (const chunk of this.chunks.values()) {
          if (chunk.frames && chunk.frames.some((frame) => frame.k > before.k && frame.k <= this.foresight.k)) chunk.stale = true;
        }
      }
    } catch { this.link = { up: false, reason: "the view has ended" }; }
    this.changed();
    if (!this.foresight.done) setTimeout(() => this.poll(), 700);
  }
}
