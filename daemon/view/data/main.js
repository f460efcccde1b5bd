// The page: takes what a source shows and puts it where it belongs, once a picture at most.
import { Charts } from "./charts.js";
import { CLASSES, STATES, age, number, seconds, short } from "./format.js";
import { Picture } from "./picture.js";
import { Live, Tape } from "./source.js";

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

function text(id, value) { const at = $(id); if (at.textContent !== value) at.textContent = value; }
function mark(id, name, value) { const at = $(id); if (at.dataset[name] !== value) at.dataset[name] = value; }

function rows(body, made) {
  const key = JSON.stringify(made);
  if (body.dataset.made === key) return;
  body.dataset.made = key;
  body.replaceChildren(...made.map((cells) => {
    const row = document.createElement("tr");
    cells.forEach((cell, i) => {
      const at = document.createElement(i ? "td" : "th");
      if (!i) at.scope = "row";
      at.textContent = cell.text ?? cell;
      if (cell.kind) { at.className = "is"; at.dataset.kind = cell.kind; }
      row.append(at);
    });
    return row;
  }));
}

function showState(frame, status) {
  const lost = !source.link.up || (source.kind === "live" && source.silent > SILENT_S);
  const state = frame ? frame.state : "";
  const [glyph, kind] = STATES[state] || ["?", "unknown"];
  text("state-glyph", lost ? "?" : glyph);
  text("state-name", lost && !frame ? "no daemon" : state || "waiting");
  mark("state", "kind", lost ? "bad" : kind);
  // "hold" says nothing beside a state; what brought it about does.
  const held = frame && frame.held && !(frame.held in STATES) ? frame.held : "";
  const why = held || (status && !(status.because in STATES) ? status.cause || status.because : "") || "";
  text("state-why", !lost ? why : frame ? "as last known" : source.link.reason);
  $("state-why").title = $("state-why").textContent;
  const banner = $("banner");
  const news = source.kind === "recording" ? source.trouble
    : !source.link.up ? `No daemon: ${source.link.reason}. ${frame ? "What is shown is the last that was known." : "Is it running?"}`
    : frame && source.silent > SILENT_S ? `No news for ${source.silent.toFixed(0)} s. What is shown is the last that was known.` : "";
  banner.hidden = !news;
  if (banner.textContent !== news) banner.textContent = news;
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
    const note = !done ? `making ${count} horizons again …` : !count ? "its horizons cannot be made again by this program"
      : inexact ? "horizons made again by another version of the program: near, not bit for bit" : "horizons made again, bit for bit";
    text("health-note", `${source.length.toFixed(1)} s, ${source.times.length} frames; ${note}`);
    mark("health", "kind", "unknown");
    return;
  }
  const health = status ? status.health : "";
  const lost = !source.link.up;
  text("health-name", lost ? "unknown" : { healthy: "✓ healthy", degraded: "▲ degraded", fault: "✕ fault" }[health] || "–");
  mark("health", "kind", lost ? "unknown" : { healthy: "good", degraded: "warn", fault: "bad" }[health] || "unknown");
  const complaints = (status && status.complaints) || [];
  const count = complaints.length > 1 ? `${complaints.length}: ` : "";
  text("health-note", status ? count + complaints.join("; ") || (status.host || []).join("; ") || "nothing to complain of" : "");
  $("health-note").title = complaints.join("\n");
}

function showNumbers(frame, status) {
  const errors = (frame && frame.errors) || {};
  text("err-control", number(errors.control_mm));
  text("err-plan", number(errors.plan_mm));
  text("err-gap", number(errors.gap_mm, 1));
  const cycle = frame && frame.cycle_ms;
  text("cycle", cycle ? `of ${cycle} ms` : "");
  const slack = frame && frame.slack_ms;
  const share = cycle && slack !== undefined ? slack / cycle : null;
  const bar = $("slack-bar");
  bar.firstElementChild.style.width = `${share === null ? 0 : Math.max(0, Math.min(100, 100 * share))}%`;
  bar.dataset.kind = share === null ? "" : share <= 0 ? "bad" : share < 0.25 ? "warn" : "good";
  const told = [];
  if (share !== null) told.push(`${slack <= 0 ? "LATE" : "slack"} ${number(slack, 2)} ms`);
  if (status) {
    told.push(`${status.late} late`, `${status.missing} missing`);
    const p99 = status.turnaround_us && status.turnaround_us.p99;
    if (p99) told.push(`p99 ${number(p99 / 1000, 2)} ms`);
  }
  text("slack-note", told.join(" · ") || "–");
}

function linkRows(frame, status) {
  const ages = (frame && frame.ages_ms) || {};
  if (status && status.links) {
    return Object.entries(status.links).map(([name, link]) => {
      const own = link.up && Object.keys(ages).find((key) => (NAMES[key] || key) === name);
      const old = own ? ages[own] : link.age_s === null ? null : 1000 * link.age_s;
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

// The same thing again and again is one line, of its last time.
function alike(events) {
  const made = [];
  for (const one of events) {
    const last = made[made.length - 1];
    if (last && last.text === one.text && !one.missed) { last.t = one.t; last.count += 1; } else made.push({ ...one, count: 1 });
  }
  return made;
}

function showEvents() {
  const list = $("events");
  const now = source.now;
  const shown = alike(source.kind === "live" ? source.events.slice(-90) : source.events).reverse();
  const past = shown.filter((one) => one.t <= now + 1e-3).length;
  const newest = shown[0] || { t: 0, count: 0 };
  const key = `${shown.length}:${newest.t}:${newest.count}:${source.kind === "live" ? Math.floor(now) : past}:${source.number ?? ""}`;
  if (list.dataset.made === key) return;
  list.dataset.made = key;
  list.replaceChildren(...shown.map((one) => {
    const item = document.createElement("li");
    const when = document.createElement("time");
    when.textContent = source.kind === "live" ? `−${seconds(Math.max(0, now - one.t), 0)}` : seconds(one.t);
    const what = document.createElement("span");
    what.textContent = one.text + (one.count > 1 ? ` ×${one.count}` : "") + (one.missed ? ` (${one.missed} before it were missed)` : "");
    if (/^state|confirmed|down|refused/.test(one.text)) item.className = "strong";
    if (one.t > now + 1e-3) item.classList.add("future");
    item.append(when, what);
    if (source.seek) item.onclick = () => source.seek(one.t);
    return item;
  }));
  if (source.kind === "recording" && list.children.length > past) {
    const at = list.children[list.children.length - past];
    if (at) list.scrollTop = Math.max(0, at.offsetTop - list.offsetTop - 40);
  }
}

function showTransport() {
  if (source.kind !== "recording") return;
  text("play", source.paused ? "▶ play" : "⏸ pause");
  text("time", `${source.now.toFixed(2)} / ${source.length.toFixed(1)} s`);
  const seek = $("seek");
  if (document.activeElement !== seek || !source.paused) seek.value = String(source.length ? source.now / source.length : 0);
}

function tell(frame) {
  // For whoever cannot see the pictures, and for tests.
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
  tell(frame);
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

const both = (told) => (told ? `${number(told.rms)} / ${number(told.max)}` : "–");

async function openTape(i) {
  source = null;
  [...$("compare-rows").children].forEach((row, n) => (n === i ? row.setAttribute("aria-current", "true") : row.removeAttribute("aria-current")));
  source = await Tape.open(i, changed);
  const made = (source.summary || []).map((row) => [`${row.state}, ${row.scenario}`, String(row.seconds),
    both(row.control_mm), both(row.plan_mm)]);
  rows($("summary-rows"), made);
  $("summary").hidden = !made.length;
  const asked = new URLSearchParams(location.search);
  if (asked.has("t")) { source.seek(Number(asked.get("t"))); source.paused = asked.has("paused"); }
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
    source = new Live(changed);
    text("source", `live: ${mode.source}`);
    return;
  }
  $("transport").hidden = false;
  const tapes = $("tapes");
  tapes.hidden = mode.tapes.length < 2;
  mode.tapes.forEach((tape, i) => tapes.add(new Option(tape.name, String(i))));
  tapes.onchange = () => openTape(Number(tapes.value));
  $("compare").hidden = mode.tapes.length < 2;
  rows($("compare-rows"), mode.tapes.map((tape) => [short(tape.name), both(tape.control_mm), both(tape.plan_mm), number(tape.slack_ms, 1)]));
  [...$("compare-rows").children].forEach((row, i) => {
    row.firstChild.title = mode.tapes[i].name;
    row.firstChild.onclick = () => { tapes.value = String(i); openTape(i); };
  });
  $("play").onclick = () => {
    if (source.paused && source.now >= source.length) source.seek(0);
    source.paused = !source.paused;
    changed();
  };
  $("speed").onchange = () => { source.speed = Number($("speed").value); };
  $("seek").oninput = () => source.seek(Number($("seek").value) * source.length);
  await openTape(0);
}

function theme(name) {
  root.dataset.theme = name;
  station.restyle(); close.restyle(); charts.restyle();
  changed();
}
const other = () => theme(root.dataset.theme === "light" ? "dark" : "light");
$("theme").onclick = () => { other(); try { localStorage.setItem("theme", root.dataset.theme); } catch { /* private */ } };
let kept = null;
try { kept = localStorage.getItem("theme"); } catch { /* private */ }
theme(new URLSearchParams(location.search).get("theme") || kept || (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark"));

for (const button of document.querySelectorAll("[data-view]")) {
  button.onclick = () => {
    station.look(button.dataset.view);
    for (const one of document.querySelectorAll("[data-view]")) one.setAttribute("aria-pressed", String(one === button));
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
begin().catch((error) => { const banner = $("banner"); banner.hidden = false; banner.textContent = `The view does not answer: ${error}`; });
