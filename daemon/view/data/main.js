// The page: shows the newest frame and status of a source, at most once a picture.
import { Charts } from "./charts.js";
import { CLASSES, STATES, age, number, seconds, short } from "./format.js";
import { Picture } from "./picture.js";
import { LiveSource, RecordingSource } from "./source.js";

const $ = (id) => document.getElementById(id);
const root = document.documentElement;
const NAMES = { wrench: "force_torque" };
const SILENT_S = 1.0;
const STALE_MS = 1000;
const SEEN_MS = { distance: 250, camera: 1000, wrench: 250 };

let source = null;
let dirty = true;
const changed = () => { dirty = true; };
const station = new Picture($("station"), { turn: true });
const close = new Picture($("close"), { close: true });
const charts = new Charts($("charts"), (t) => { if (source && source.seek) source.seek(t); });

function text(id, value) { const element = $(id); if (element.textContent !== value) element.textContent = value; }
function mark(id, name, value) { const element = $(id); if (element.dataset[name] !== value) element.dataset[name] = value; }

function rows(body, cells) {
  const key = JSON.stringify(cells);
  if (body.dataset.key === key) return;
  body.dataset.key = key;
  body.replaceChildren(...cells.map((line) => {
    const row = document.createElement("tr");
    line.forEach((cell, i) => {
      const element = document.createElement(i ? "td" : "th");
      if (!i) element.scope = "row";
      element.textContent = cell.text ?? cell;
      if (cell.kind) { element.className = "is"; element.dataset.kind = cell.kind; }
      row.append(element);
    });
    return row;
  }));
}

// The condition of the source: ok, waiting (no message yet), ended (its task was done), lost.
function condition(frame, status) {
  const isSilent = source.kind === "live" && frame && source.silent > SILENT_S;
  if (source.link.up && !isSilent) return "ok";
  if (!frame && !status) return "waiting";
  return source.kind === "live" && source.hasEndedWell ? "ended" : "lost";
}

function bannerText(frame, status) {
  if (source.kind === "recording") return source.trouble;
  const stale = frame ? " What is shown is the last that was known." : "";
  return {
    ok: "",
    waiting: `Waiting for the daemon: ${source.link.reason}.`,
    ended: `The daemon has ended. Its task was done.${stale}`,
    lost: source.link.up ? `No news for ${source.silent.toFixed(0)} s.${stale}` : `No daemon: ${source.link.reason}.${stale || " Is it running?"}`,
  }[condition(frame, status)];
}

function showState(frame, status) {
  const now = condition(frame, status);
  const state = frame ? frame.state : "";
  const [glyph, kind] = STATES[state] || ["…", "unknown"];
  const isShown = now === "ok" || (now === "lost" && frame);
  text("state-glyph", now === "lost" ? "?" : now === "ended" ? "✓" : glyph);
  text("state-name", isShown ? state || "waiting" : now === "lost" ? "no daemon" : now);
  mark("state", "kind", now === "ok" ? kind : now === "lost" ? "bad" : "unknown");
  // "hold" adds nothing to a state; its cause does.
  const held = frame && frame.held && !(frame.held in STATES) ? frame.held : "";
  const cause = held || (status && !(status.because in STATES) ? status.cause || status.because : "") || "";
  text("state-why", { ok: cause, waiting: source.link.reason, ended: "the task was done", lost: frame ? "as last known" : source.link.reason }[now]);
  $("state-why").title = $("state-why").textContent;
  text("banner", bannerText(frame, status));
  mark("banner", "kind", now === "lost" || (source.kind === "recording" && source.trouble) ? "bad" : "");
  $("banner").hidden = !$("banner").textContent;
  document.title = `${state || "?"} · linemate`;
}

function showClass(frame) {
  const name = (frame && frame.scenario) || "";
  mark("class", "class", name || "none");
  $("class").classList.toggle("tentative", Boolean(frame && frame.tentative));
  text("class-glyph", CLASSES[name] || "·");
  text("class-name", name ? name + (frame.tentative ? "?" : "") : "–");
  const speed = frame && frame.speed !== undefined ? `${(1000 * frame.speed).toFixed(0)} mm/s` : "";
  text("class-note", name ? `${frame.tentative ? "tentative" : "confirmed"}, ${speed}` : "not classified");
  text("phase", (frame && frame.phase) || "–");
  text("phase-note", frame && frame.task_time !== undefined
    ? `task clock ${frame.task_time.toFixed(2)} s${frame.contact ? ", in contact" : ""}${frame.overload ? ", OVERLOAD" : ""}` : "not started");
}

function showHealth(frame, status) {
  if (source.kind === "recording") {
    text("health-name", "Recording");
    const { done, count, inexact } = source.foresight;
    const note = !done ? `computing ${count} horizons again …` : !count ? "this program cannot compute its horizons again"
      : inexact ? "horizons of another version of the program: near, not bit for bit" : "horizons computed again, bit for bit";
    text("health-note", `${source.length.toFixed(1)} s, ${source.times.length} frames; ${note}`);
    mark("health", "kind", "unknown");
    return;
  }
  const health = status ? status.health : "";
  const isLost = !source.link.up;
  text("health-name", isLost ? "unknown" : { healthy: "✓ healthy", degraded: "▲ degraded", fault: "✕ fault" }[health] || "–");
  mark("health", "kind", isLost ? "unknown" : { healthy: "good", degraded: "warn", fault: "bad" }[health] || "unknown");
  const complaints = (status && status.complaints) || [];
  const count = complaints.length > 1 ? `${complaints.length}: ` : "";
  text("health-note", status ? count + complaints.join("; ") || (status.host || []).join("; ") || "no complaints" : "");
  $("health-note").title = complaints.join("\n");
}

function showNumbers(frame, status) {
  const errors = (frame && frame.errors) || {};
  text("err-control", number(errors.control_mm));
  text("err-plan", number(errors.plan_mm));
  text("err-gap", number(errors.gap_mm, 1));
  const cycle = frame && frame.cycle_ms;
  text("cycle", cycle ? `of ${cycle} ms` : "");
  const margin = frame && frame.margin_ms;
  const share = cycle && margin !== undefined ? margin / cycle : null;
  const bar = $("margin-bar");
  bar.firstElementChild.style.width = `${share === null ? 0 : Math.max(0, Math.min(100, 100 * share))}%`;
  bar.dataset.kind = share === null ? "" : share <= 0 ? "bad" : share < 0.25 ? "warn" : "good";
  const notes = [];
  if (share !== null) notes.push(`${margin <= 0 ? "LATE" : "margin"} ${number(margin, 2)} ms`);
  if (status) {
    notes.push(`${status.late} late`, `${status.missing} missing`);
    const p99 = status.turnaround_us && status.turnaround_us.p99;
    if (p99) notes.push(`p99 ${number(p99 / 1000, 2)} ms`);
  }
  text("margin-note", notes.join(" · ") || "–");
}

function linkRows(frame, status) {
  const ages = (frame && frame.ages_ms) || {};
  if (status && status.links) {
    return Object.entries(status.links).map(([name, link]) => {
      const sensor = link.up && Object.keys(ages).find((key) => (NAMES[key] || key) === name);
      const old = sensor ? ages[sensor] : link.age_s === null ? null : 1000 * link.age_s;
      const silent = old === null || old === undefined || old > STALE_MS;
      const is = !link.up ? { text: "✕ down", kind: "bad" } : silent ? { text: "▲ silent", kind: "warn" } : { text: "● up", kind: "good" };
      return [name, is, link.rate_hz ? `${Math.round(link.rate_hz)} Hz` : "–", age(old)];
    });
  }
  if (!frame || !frame.samples) return [];
  const earlier = source.before(33);
  return Object.entries(frame.samples).map(([name, count]) => {
    const span = earlier && earlier.samples ? frame.t - earlier.t : 0;
    const rate = span > 0 ? (count - earlier.samples[name]) / span : 0;
    const old = name === "robot" ? undefined : ages[name];
    const silent = name === "robot" ? rate === 0 && frame.t > 1.5 : old === undefined || old > (SEEN_MS[name] || STALE_MS);
    return [NAMES[name] || name, silent ? { text: "▲ silent", kind: "warn" } : { text: "● comes", kind: "good" }, rate ? `${Math.round(rate)} Hz` : "–", age(old)];
  });
}

// Equal events in a row are one line with the time of the last one.
function withoutRepeats(events) {
  const lines = [];
  for (const event of events) {
    const last = lines[lines.length - 1];
    if (last && last.text === event.text && !event.missed) { last.t = event.t; last.count += 1; } else lines.push({ ...event, count: 1 });
  }
  return lines;
}

function showEvents() {
  const list = $("events");
  const now = source.now;
  const shown = withoutRepeats(source.kind === "live" ? source.events.slice(-90) : source.events).reverse();
  const past = shown.filter((event) => event.t <= now + 1e-3).length;
  const newest = shown[0] || { t: 0, count: 0 };
  const key = `${shown.length}:${newest.t}:${newest.count}:${source.kind === "live" ? Math.floor(now) : past}:${source.number ?? ""}`;
  if (list.dataset.key === key) return;
  list.dataset.key = key;
  list.replaceChildren(...shown.map((event) => {
    const item = document.createElement("li");
    const when = document.createElement("time");
    when.textContent = source.kind === "live" ? `−${seconds(Math.max(0, now - event.t), 0)}` : seconds(event.t);
    const what = document.createElement("span");
    what.textContent = event.text + (event.count > 1 ? ` ×${event.count}` : "") + (event.missed ? ` (${event.missed} before it were missed)` : "");
    if (/^state|confirmed|down|refused/.test(event.text)) item.className = "strong";
    if (event.t > now + 1e-3) item.classList.add("future");
    item.append(when, what);
    if (source.seek) item.onclick = () => source.seek(event.t);
    return item;
  }));
  if (source.kind === "recording" && list.children.length > past) {
    const newestPast = list.children[list.children.length - past];
    if (newestPast) list.scrollTop = Math.max(0, newestPast.offsetTop - list.offsetTop - 40);
  }
}

function showTransport() {
  if (source.kind !== "recording") return;
  text("play", source.paused ? "▶ play" : "⏸ pause");
  text("time", `${source.now.toFixed(2)} / ${source.length.toFixed(1)} s`);
  const seek = $("seek");
  if (document.activeElement !== seek || !source.paused) seek.value = String(source.length ? source.now / source.length : 0);
}

// Describe the pictures for screen readers and tests.
function describe(frame) {
  root.dataset.frames = String(Number(root.dataset.frames || 0) + 1);
  root.dataset.tcp = frame && frame.tcp ? frame.tcp.slice(0, 3).join(" ") : "";
  root.dataset.foreseen = String(frame && frame.foreseen ? frame.foreseen.length : 0);
  if (!frame) return;
  const errors = frame.errors || {};
  $("station").setAttribute("aria-label", `Station: ${frame.state}, ${frame.phase}; the tool is ${number(errors.gap_mm, 0)} mm from the hub; the conveyor is ${frame.scenario || "not classified"}`);
}

function draw() {
  const { frame, status } = source;
  showState(frame, status);
  showClass(frame);
  showHealth(frame, status);
  showNumbers(frame, status);
  rows($("links"), linkRows(frame, status));
  showEvents();
  showTransport();
  const trail = source.kind === "live" ? source.history.slice(-75) : null;
  station.draw(source.scene, frame, trail);
  close.draw(source.scene, frame, trail);
  text("close-note", frame && frame.foreseen && frame.foreseen_ms ? `foresight ${frame.foreseen_ms} ms`
    : frame && frame.foreseen ? "with its foresight" : "");
  charts.draw(source.history, source.span, source.now, source.kind === "recording", source.events);
  describe(frame);
}

let last = performance.now();
let checked = 0;
function turn(now) {
  if (source) {
    source.advance(Math.min(250, now - last));
    if (dirty || now - checked > 500) { checked = now; dirty = false; draw(); }
  }
  last = now;
  requestAnimationFrame(turn);
}

const rmsAndWorst = (errors) => (errors ? `${number(errors.rms)} / ${number(errors.max)}` : "–");

async function openRun(i) {
  source = null;
  [...$("compare-rows").children].forEach((row, n) => (n === i ? row.setAttribute("aria-current", "true") : row.removeAttribute("aria-current")));
  source = await RecordingSource.open(i, changed);
  const summary = (source.summary || []).map((row) => [`${row.state}, ${row.scenario}`, String(row.seconds),
    rmsAndWorst(row.control_mm), rmsAndWorst(row.plan_mm)]);
  rows($("summary-rows"), summary);
  $("summary").hidden = !summary.length;
  const query = new URLSearchParams(location.search);
  if (query.has("t")) { source.seek(Number(query.get("t"))); source.paused = query.has("paused"); }
  text("source", `recording ${source.name}`);
  changed();
}

async function begin() {
  let mode = await (await fetch("mode")).json();
  while (mode.mode === "reading") {
    text("state-name", "reading");
    text("state-why", `${Math.round(100 * mode.share)} % of the recording`);
    await new Promise((done) => { setTimeout(done, 300); });
    mode = await (await fetch("mode")).json();
  }
  if (mode.mode === "live") {
    source = new LiveSource(changed);
    text("source", `live: ${mode.source}`);
    return;
  }
  $("transport").hidden = false;
  const runs = $("runs");
  runs.hidden = mode.runs.length < 2;
  mode.runs.forEach((run, i) => runs.add(new Option(run.name, String(i))));
  runs.onchange = () => openRun(Number(runs.value));
  $("compare").hidden = mode.runs.length < 2;
  rows($("compare-rows"), mode.runs.map((run) => [short(run.name), rmsAndWorst(run.control_mm), rmsAndWorst(run.plan_mm), number(run.margin_ms, 1)]));
  [...$("compare-rows").children].forEach((row, i) => {
    row.firstChild.title = mode.runs[i].name;
    row.firstChild.onclick = () => { runs.value = String(i); openRun(i); };
  });
  $("play").onclick = () => {
    if (source.paused && source.now >= source.length) source.seek(0);
    source.paused = !source.paused;
    changed();
  };
  $("speed").onchange = () => { source.speed = Number($("speed").value); };
  $("seek").oninput = () => source.seek(Number($("seek").value) * source.length);
  await openRun(0);
}

function theme(name) {
  root.dataset.theme = name;
  station.restyle(); close.restyle(); charts.restyle();
  changed();
}
$("theme").onclick = () => { theme(root.dataset.theme === "light" ? "dark" : "light"); try { localStorage.setItem("theme", root.dataset.theme); } catch { /* private */ } };
let kept = null;
try { kept = localStorage.getItem("theme"); } catch { /* private */ }
theme(new URLSearchParams(location.search).get("theme") || kept || (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark"));

for (const button of document.querySelectorAll("[data-view]")) {
  button.onclick = () => {
    station.setView(button.dataset.view);
    for (const other of document.querySelectorAll("[data-view]")) other.setAttribute("aria-pressed", String(other === button));
    changed();
  };
}
station.onTurn = changed;
addEventListener("resize", changed);
addEventListener("keydown", (event) => {
  if (event.target.matches("input, select, button") && event.key !== "Escape") return;
  if (event.key === "t") $("theme").click();
  if (!source || !source.seek) return;
  if (event.key === " ") { $("play").click(); event.preventDefault(); }
  if (event.key === "ArrowRight") source.seek(source.now + (event.shiftKey ? 0.05 : 1));
  if (event.key === "ArrowLeft") source.seek(source.now - (event.shiftKey ? 0.05 : 1));
  if (event.key === "Home") source.seek(0);
});
requestAnimationFrame(turn);
begin().catch((error) => { const banner = $("banner"); banner.hidden = false; banner.dataset.kind = "bad"; banner.textContent = `The view does not answer: ${error}`; });
