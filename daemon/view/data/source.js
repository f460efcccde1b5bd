// Sources of frames: a live daemon, or a recording with its own clock.
const KEPT = 1000; // frames of a daemon: 40 s
const CHUNK = 250; // frames of a recording that are fetched at once
const CHUNKS = 24; // that are kept
const MAX_EVENTS = 200;
const ENDED = "the view has ended";
const BEGUN = ["armed", "track", "contact", "hold", "fault"]; // states of the next task

export class LiveSource {
  constructor(changed) {
    this.kind = "live";
    this.history = [];
    this.events = [];
    this.scene = null;
    this.status = null;
    this.link = { up: false, reason: "connecting" };
    this.frame = null;
    this.isDone = false; // the task was done, and nothing has begun since
    this.newestAt = performance.now();
    const stream = new EventSource("stream");
    const on = (name, handle) => stream.addEventListener(name, (event) => {
      handle(JSON.parse(event.data));
      changed();
    });
    on("scene", (scene) => { this.scene = scene; this.history = []; this.events = []; });
    on("link", (link) => { this.link = link; });
    on("status", (status) => { this.status = status; });
    on("history", (frames) => {
      frames.forEach((frame) => this.follow(frame));
      this.history = frames;
    });
    on("happened", (event) => { this.events.push(event); if (this.events.length > MAX_EVENTS) this.events.shift(); });
    on("frame", (frame) => {
      this.newestAt = performance.now();
      const last = this.history[this.history.length - 1];
      if (last && frame.t < last.t) this.history = [];
      else if (last && frame.t === last.t) this.history.pop();
      this.history.push(frame);
      if (this.history.length > KEPT) this.history.shift();
      this.follow(frame);
    });
    stream.onerror = () => { if (this.link.up) this.link = { up: false, reason: ENDED }; changed(); };
  }

  // A task ends in the phase "done", or in the state "idle" after a retreat.
  follow(frame) {
    const before = this.frame;
    if (frame.phase === "done") this.isDone = true;
    else if (before && before.state === "retreat" && frame.state === "idle") this.isDone = true;
    else if (BEGUN.includes(frame.state)) this.isDone = false;
    this.frame = frame;
  }

  // The last frames of a daemon can be missing: then its status says that the task has ended.
  get hasEndedWell() {
    const { state, because } = this.status || {};
    const isBack = state === "idle" && because === "retreated";
    return this.isDone || (isBack && !(this.frame && BEGUN.includes(this.frame.state)));
  }

  get silent() { return (performance.now() - this.newestAt) / 1000; }
  get now() { return this.frame ? this.frame.t : 0; }
  get span() { return [this.now - 30, this.now]; }
  before(step) { return this.history[Math.max(0, this.history.length - 1 - step)]; }
  advance() {}
}

export class RecordingSource {
  constructor(number, run, changed) {
    Object.assign(this, { kind: "recording", number, changed, scene: run.scene, name: run.name, trouble: run.trouble });
    this.times = run.times;
    this.history = run.overview;
    this.events = run.happened;
    this.summary = run.summary;
    this.length = run.length_s;
    this.status = null;
    this.link = { up: true, reason: "" };
    this.frame = null;
    this.paused = false;
    this.speed = 1;
    this.now = 0;
    this.foresight = { k: -1, done: false, inexact: 0, count: 0 };
    this.chunks = new Map();
    this.poll();
  }

  static async open(number, changed) {
    const answer = await fetch(`run?i=${number}`);
    return new RecordingSource(number, await answer.json(), changed);
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
    this.at(Math.min(this.times.length - 1, i + CHUNK / 2)); // fetch the next chunk early
    if (frame && frame !== this.frame) { this.frame = frame; this.shown = i; this.changed(); }
  }

  before(step) { return this.at(Math.max(0, (this.shown || 0) - step)); }

  at(i) {
    const number = Math.floor(i / CHUNK);
    const chunk = this.chunks.get(number);
    if (chunk === undefined || (chunk.frames && chunk.stale && !chunk.requested)) this.fetch(number, chunk);
    return chunk && chunk.frames ? chunk.frames[i - number * CHUNK] : null;
  }

  async fetch(number, known) {
    const chunk = known || { frames: null };
    chunk.requested = true;
    chunk.stale = false;
    this.chunks.set(number, chunk);
    while (this.chunks.size > CHUNKS) this.chunks.delete(this.chunks.keys().next().value);
    const from = number * CHUNK;
    try {
      const answer = await fetch(`frames?i=${this.number}&from=${from}&to=${from + CHUNK}`);
      chunk.frames = await answer.json();
    } catch { this.chunks.delete(number); }
    chunk.requested = false;
    this.show();
  }

  async poll() {
    try {
      const before = this.foresight;
      this.foresight = await (await fetch(`progress?i=${this.number}`)).json();
      if (this.foresight.count !== before.count) {
        // Chunks that were fetched without the new horizons are fetched again.
        for (const chunk of this.chunks.values()) {
          if (chunk.frames && chunk.frames.some((frame) => frame.k > before.k && frame.k <= this.foresight.k)) chunk.stale = true;
        }
      }
    } catch { this.link = { up: false, reason: ENDED }; }
    this.changed();
    if (!this.foresight.done) setTimeout(() => this.poll(), 700);
  }
}
