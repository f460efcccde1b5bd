// The station in perspective on a plain canvas, the farthest things first. Poses are those of the
// frame: position and quaternion (w first) in base, Z up.
const VIEWS = { // of an arm with the reach REACH_M; others are scaled to it
  corner: { azimuth: -2.1, elevation: 0.3, distance: 5.0, height: 1.12 },
  side: { azimuth: -1.5708, elevation: 0.1, distance: 5.0, height: 1.2 },
  top: { azimuth: -1.5707, elevation: 1.52, distance: 5.4, height: 1.0 },
};
const REACH_M = 3.591;
const CENTRE = 0.66; // of the way from the arm's base to the part
const NOMINAL = [2.2, 0, 1.1, 1, 0, 0, 0];
const RAIL_GAUGE_M = 0.44;
const COLOURS = ["panel", "line", "text", "muted", "grid", "arm", "arm-edge", "body", "hub", "tyre",
  "control", "plan", "gap", "ahead", "good", "bad", "warn"];
const PROFILE = [ // of a car's side, (along, up) from the hub [m]
  [0.86, -0.13], [0.9, 0.14], [0.78, 0.38], [-0.38, 0.57], [-1.18, 1.0], [-1.95, 1.05], [-2.8, 0.7],
  [-3.3, 0.64], [-3.42, 0.2], [-3.35, -0.13], [-3.03, -0.13], ...arch(-2.65, 0.38), [-2.27, -0.13],
  [-0.38, -0.13], ...arch(0, 0.38), [0.38, -0.13],
];
const WINDOW = [[-0.55, 0.57], [-1.2, 0.94], [-1.9, 0.98], [-2.6, 0.66]];

function arch(at, radius) {
  return [...Array(7).keys()].map((i) => {
    const angle = Math.PI * (1 - (i + 0.5) / 7);
    return [at + radius * Math.cos(angle), radius * Math.sin(angle)];
  });
}

function turned(q, v) {
  const [w, x, y, z] = q;
  const tx = 2 * (y * v[2] - z * v[1]), ty = 2 * (z * v[0] - x * v[2]), tz = 2 * (x * v[1] - y * v[0]);
  return [v[0] + w * tx + y * tz - z * ty, v[1] + w * ty + z * tx - x * tz, v[2] + w * tz + x * ty - y * tx];
}
const placed = (pose, v) => { const r = turned(pose.slice(3), v); return [pose[0] + r[0], pose[1] + r[1], pose[2] + r[2]]; };
const apart = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
const middle = (a, b) => a.map((x, i) => (x + b[i]) / 2);
const circle = (pose, radius, depth, count = 36) => [...Array(count).keys()].map((i) => {
  const angle = (2 * Math.PI * i) / count;
  return placed(pose, [radius * Math.cos(angle), radius * Math.sin(angle), depth]);
});

export class Picture {
  constructor(canvas, { turn = false, close = false }) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.close = close;
    this.onTurn = () => {};
    this.camera = { ...VIEWS.corner };
    this.restyle();
    if (turn) this.listen();
  }

  restyle() {
    const style = getComputedStyle(document.documentElement);
    this.colour = Object.fromEntries(COLOURS.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  }

  setView(name) { this.camera = { ...VIEWS[name] }; }

  listen() {
    let from = null;
    const canvas = this.canvas;
    canvas.addEventListener("pointerdown", (event) => { from = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); });
    canvas.addEventListener("pointerup", () => { from = null; });
    canvas.addEventListener("pointermove", (event) => {
      if (!from) return;
      this.turn((from[0] - event.clientX) * 0.006, (event.clientY - from[1]) * 0.006);
      from = [event.clientX, event.clientY];
    });
    canvas.addEventListener("wheel", (event) => { this.nearer(Math.exp(event.deltaY * 0.001)); event.preventDefault(); }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.08], ArrowDown: [0, -0.08] }[event.key];
      if (by) { this.turn(...by); event.preventDefault(); event.stopPropagation(); }
      if (event.key === "+") this.nearer(0.9);
      if (event.key === "-") this.nearer(1.1);
    });
  }

  turn(azimuth, elevation) {
    this.camera.azimuth += azimuth;
    this.camera.elevation = Math.max(-0.2, Math.min(1.52, this.camera.elevation + elevation));
    this.onTurn();
  }

  nearer(factor) { this.camera.distance = Math.max(1.2, Math.min(16, this.camera.distance * factor)); this.onTurn(); }

  // Fit the canvas to its place, and the projection to the canvas.
  begin(scene, frame) {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(height * ratio)) {
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
    }
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.context.clearRect(0, 0, width, height);
    this.size = [width, height];
    this.scale = ((scene && scene.reach) || REACH_M) / REACH_M;
    const { azimuth: a, elevation: e, distance: d, at } = this.close ? this.closeCamera(frame) : this.stationCamera(scene, frame);
    const out = [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
    this.eye = at.map((x, i) => x + d * out[i]);
    this.ahead = out.map((x) => -x);
    this.right = [-Math.sin(a), Math.cos(a), 0];
    this.up = [-Math.sin(e) * Math.cos(a), -Math.sin(e) * Math.sin(a), Math.cos(e)];
    this.focal = 1.28 * Math.min(height, width * 0.62);
    this.items = [];
  }

  // Look at the arm and the part, and go along with the tool on its way along the conveyor.
  stationCamera(scene, frame) {
    const { azimuth, elevation, distance, height } = this.camera;
    const nominal = (scene && scene.nominal) || NOMINAL;
    const travel = turned(nominal.slice(3), [0, 1, 0]);
    const tcp = frame.tcp || frame.target || nominal;
    const along = tcp.slice(0, 3).reduce((sum, x, i) => sum + (x - nominal[i]) * travel[i], 0) - 0.05;
    return {
      azimuth: azimuth + Math.atan2(travel[1], travel[0]) - Math.PI / 2,
      elevation,
      distance: distance * this.scale,
      at: [CENTRE * nominal[0] + along * travel[0], CENTRE * nominal[1] + along * travel[1], height * this.scale],
    };
  }

  closeCamera(frame) {
    const tcp = frame.tcp || frame.target || [1.8, 0, 1.1];
    const near = frame.part && apart(tcp, frame.part) < 0.75;
    const at = near ? middle(tcp.slice(0, 3), frame.part.slice(0, 3)) : tcp.slice(0, 3);
    const span = near ? Math.max(0.12, 1.2 * apart(tcp, frame.part)) : 0.4;
    return { azimuth: -1.95, elevation: 0.92, distance: 2.0 * span + 0.12, at };
  }

  project(p) {
    const v = [p[0] - this.eye[0], p[1] - this.eye[1], p[2] - this.eye[2]];
    const depth = Math.max(0.05, v[0] * this.ahead[0] + v[1] * this.ahead[1] + v[2] * this.ahead[2]);
    const scale = this.focal / depth;
    const x = v[0] * this.right[0] + v[1] * this.right[1];
    const y = v[0] * this.up[0] + v[1] * this.up[1] + v[2] * this.up[2];
    return [this.size[0] / 2 + x * scale, this.size[1] / 2 - y * scale, depth, scale];
  }

  add(depth, draw) { this.items.push([depth, draw]); }

  path(points, closed) {
    const c = this.context;
    c.beginPath();
    points.forEach((p, i) => (i ? c.lineTo(p[0], p[1]) : c.moveTo(p[0], p[1])));
    if (closed) c.closePath();
  }

  line(points, { colour, width = 1, dash = [], closed = false, fill = null, alpha = 1, bias = 0 }) {
    const flat = points.map((p) => this.project(p));
    const depth = flat.reduce((sum, p) => sum + p[2], 0) / flat.length;
    this.add(depth + bias, () => {
      const c = this.context;
      this.path(flat, closed);
      c.globalAlpha = alpha;
      if (fill) { c.fillStyle = fill; c.fill(); }
      c.globalAlpha = 1;
      if (colour) { c.setLineDash(dash); c.lineWidth = width; c.strokeStyle = colour; c.lineJoin = c.lineCap = "round"; c.stroke(); c.setLineDash([]); }
    });
  }

  label(p, text, colour, dx = 8, dy = -6, bias = -9) {
    const [x, y, depth] = this.project(p);
    this.add(depth + bias, () => {
      const c = this.context;
      c.font = "12px system-ui, 'DejaVu Sans', sans-serif";
      c.lineWidth = 3; c.strokeStyle = this.colour.panel; c.lineJoin = "round";
      c.strokeText(text, x + dx, y + dy);
      c.fillStyle = colour; c.fillText(text, x + dx, y + dy);
    });
  }

  draw(scene, frame, trail) {
    if (!this.canvas.clientWidth) return;
    this.begin(scene, frame || {});
    if (!frame) { this.say("no message yet"); return; }
    this.floor(scene);
    if (frame.part) this.car(frame.part, frame);
    if (frame.arm) this.arm(frame.arm);
    this.tool(frame);
    if (scene && scene.camera && frame.tcp && !this.close) this.eyeOf(frame.tcp, scene.camera);
    if (trail && trail.length > 1) this.trail(trail);
    this.foresight(frame);
    if (this.close) this.gap(frame);
    this.items.sort((a, b) => b[0] - a[0]).forEach(([, draw]) => draw());
    if (!frame.arm && !this.close) this.say((scene && scene.trouble) || "the arm is not known");
    if (!frame.part) this.say(this.close ? "the hub has not been seen yet" : "", 0.92);
  }

  say(text, height = 0.5) {
    const c = this.context;
    c.font = "13px system-ui, 'DejaVu Sans', sans-serif";
    c.fillStyle = this.colour.muted; c.textAlign = "center";
    c.fillText(text, this.size[0] / 2, this.size[1] * height);
    c.textAlign = "start";
  }

  floor(scene) {
    const { grid, line } = this.colour;
    for (let x = -1; x <= 5; x += 1) this.line([[x, -4, 0], [x, 4, 0]], { colour: grid, bias: 50 });
    for (let y = -4; y <= 4; y += 1) this.line([[-1, y, 0], [5, y, 0]], { colour: grid, bias: 50 });
    if (!scene || !scene.rail) return;
    const [from, to] = scene.rail;
    const length = apart(from, to) || 1;
    const aside = (RAIL_GAUGE_M / 2) * this.scale / length;
    for (const side of [-aside, aside]) {
      const [x, y] = [-side * (to[1] - from[1]), side * (to[0] - from[0])];
      this.line([from, to].map((p) => [p[0] + x, p[1] + y, p[2] + 0.02]), { colour: line, width: 3, bias: 40 });
    }
  }

  car(part, frame) {
    const { body, hub, muted } = this.colour;
    const at = ([along, up], z) => placed(part, [-up, along, z]);
    const near = 0.03, far = 1.62;
    if (!this.close) {
      this.line(PROFILE.map((p) => at(p, far)), { colour: body, width: 1, closed: true, fill: body, alpha: 0.08, bias: 1 });
      for (const i of [1, 2, 3, 4, 5, 6, 7, 8]) this.line([at(PROFILE[i], near), at(PROFILE[i], far)], { colour: body, width: 1, bias: 0.5 });
      this.line(PROFILE.map((p) => at(p, near)), { colour: body, width: 2, closed: true, fill: body, alpha: 0.2, bias: 0.4 });
      this.line(WINDOW.map((p) => at(p, near)), { colour: body, width: 1, closed: true, fill: this.colour.panel, alpha: 0.5, bias: 0.35 });
      for (const along of [-0.6, -2.6]) {
        const top = at([along, 0.8], 0.8);
        this.line([top, [top[0], top[1], 2.75]], { colour: muted, width: 3, bias: 1 });
      }
      const top = at([-1.6, 1], 0.8);
      this.line([[top[0], -4, 2.75], [top[0], 4, 2.75]], { colour: this.colour.line, width: 6, bias: 2 });
    } else {
      this.line(arch(0, 0.38).map((p) => at(p, near)), { colour: body, width: 2, bias: 0.4 });
    }
    this.line(circle(part, 0.165, 0.03), { colour: muted, width: 1.5, closed: true, fill: this.colour.tyre, alpha: 0.55, bias: 0.05 });
    this.line(circle(part, 0.075, 0), { colour: hub, width: 2, closed: true, fill: this.colour.panel, alpha: 0.7, bias: 0.02 });
    for (let i = 0; i < 5; i += 1) {
      const angle = (2 * Math.PI * i) / 5;
      const bolt = placed(part, [0.056 * Math.cos(angle), 0.056 * Math.sin(angle), -0.01]);
      this.dot(bolt, this.close ? 3 : 1.4, hub);
    }
    const isLeft = frame.phase === "retreat" || frame.phase === "done";
    if (isLeft) this.wheel(part);
    if (this.close) this.label(placed(part, [0.165, 0, 0]), "hub (estimated)", hub, -20, 16);
  }

  wheel(pose) {
    const { tyre, hub } = this.colour;
    const alpha = this.close ? 0.12 : 0.8;
    this.line(circle(pose, 0.31, 0.08), { colour: tyre, width: 2, closed: true, fill: tyre, alpha, bias: 0.03 });
    this.line(circle(pose, 0.31, -0.09), { colour: hub, width: this.close ? 1 : 1.5, closed: true, fill: tyre, alpha, bias: 0 });
    this.line(circle(pose, 0.2, -0.09), { colour: hub, width: 1, closed: true, fill: this.colour.panel, alpha: alpha * 0.6, bias: -0.01 });
    for (let i = 0; i < 5 && !this.close; i += 1) {
      const angle = (2 * Math.PI * (i + 0.5)) / 5;
      const spoke = (radius) => placed(pose, [radius * Math.cos(angle), radius * Math.sin(angle), -0.05]);
      this.line([spoke(0.05), spoke(0.2)], { colour: hub, width: this.close ? 1 : 2, bias: -0.02 });
    }
  }

  arm(points) {
    const { arm, "arm-edge": edge } = this.colour;
    const joints = points.slice(1);
    const widths = joints.map((_, i) => this.scale * Math.max(0.07, 0.27 - 0.026 * i));
    joints.forEach((p, i) => {
      if (!i) return;
      const before = joints[i - 1];
      if (apart(before, p) < 1e-6) return;
      const [a, b] = [this.project(before), this.project(p)];
      this.add((a[2] + b[2]) / 2, () => this.limb(a, b, widths[i - 1] * a[3], widths[i] * b[3], arm, edge));
    });
    const base = joints[0];
    if (base && !this.close) {
      const half = 0.3 * this.scale;
      const foot = [[-half, -half], [half, -half], [half, half], [-half, half]].map(([x, y]) => [base[0] + x, base[1] + y, base[2] + 0.1 * this.scale]);
      this.line(foot, { colour: edge, width: 2, closed: true, fill: arm, alpha: 0.55, bias: 0.3 });
    }
  }

  // A tapered limb: the hull of two discs.
  limb(a, b, wide, narrow, fill, edge) {
    const c = this.context;
    const angle = Math.atan2(b[1] - a[1], b[0] - a[0]);
    c.beginPath();
    c.arc(a[0], a[1], wide / 2, angle + Math.PI / 2, angle - Math.PI / 2);
    c.arc(b[0], b[1], narrow / 2, angle - Math.PI / 2, angle + Math.PI / 2);
    c.closePath();
    c.globalAlpha = this.close ? 0.22 : 1;
    c.fillStyle = fill; c.strokeStyle = edge; c.lineWidth = 1.5; c.fill(); c.stroke();
    c.globalAlpha = 1;
    if (this.close) return;
    for (const [p, r] of [[a, wide], [b, narrow]]) {
      c.beginPath(); c.arc(p[0], p[1], Math.max(1, r * 0.26), 0, 2 * Math.PI);
      c.fillStyle = edge; c.fill();
    }
  }

  tool(frame) {
    if (!frame.tcp) return;
    const carries = frame.phase !== "retreat" && frame.phase !== "done";
    if (carries) this.wheel(frame.tcp);
    const { control } = this.colour;
    const reach = this.close ? 0.05 : 0.14;
    const at = (v) => placed(frame.tcp, v);
    this.line([at([-reach, 0, 0]), at([reach, 0, 0])], { colour: control, width: 2, bias: -1 });
    this.line([at([0, -reach, 0]), at([0, reach, 0])], { colour: control, width: 2, bias: -1 });
    if (this.close) this.label(at([-reach, 0, 0]), "tool", control, -38, -2);
  }

  eyeOf(tcp, camera) {
    const pose = [...placed(tcp, camera.slice(0, 3)), ...tcp.slice(3)];
    const far = 0.14;
    const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([x, y]) => placed(pose, [0.6 * far * x, 0.8 * far * y, far]));
    const { muted } = this.colour;
    this.line(corners, { colour: muted, width: 1, closed: true });
    corners.forEach((p) => this.line([pose.slice(0, 3), p], { colour: muted, width: 1 }));
  }

  trail(frames) {
    const points = frames.filter((frame) => frame.tcp).map((frame) => frame.tcp.slice(0, 3));
    if (points.length > 1) this.line(points, { colour: this.colour.control, width: 1.5, dash: [2, 3], bias: -0.5 });
  }

  foresight(frame) {
    const points = frame.foreseen;
    if (!points || points.length < 2) return;
    const { ahead } = this.colour;
    this.line(points, { colour: ahead, width: this.close ? 3 : 2.5, bias: -2 });
    points.forEach((p, i) => this.dot(p, (this.close ? 3 : 1.8) + (i === points.length - 1 ? 2 : 0), ahead));
    const last = points[points.length - 1];
    const label = frame.foreseen_ms ? `+${(frame.foreseen_ms / 1000).toFixed(1)} s` : "foreseen";
    if (this.close || apart(points[0], last) > 0.02) this.label(last, label, ahead, 8, 4);
  }

  gap(frame) {
    if (!frame.tcp || !frame.part) return;
    const a = frame.tcp.slice(0, 3), b = frame.part.slice(0, 3);
    this.line([a, b], { colour: this.colour.text, width: 1.5, dash: [5, 4], bias: -1.5 });
    const millimetres = frame.errors && frame.errors.gap_mm !== undefined ? frame.errors.gap_mm : 1000 * apart(a, b);
    this.label(middle(a, b), `${millimetres.toFixed(millimetres < 10 ? 2 : 0)} mm`, this.colour.text, -10, 22);
  }

  dot(p, radius, colour) {
    const [x, y, depth] = this.project(p);
    this.add(depth - 2, () => {
      const c = this.context;
      c.beginPath(); c.arc(x, y, radius, 0, 2 * Math.PI); c.fillStyle = colour; c.fill();
    });
  }
}
