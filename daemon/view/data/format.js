// Text of states, classes, numbers and times.
export const STATES = {
  init: ["…", "unknown"], idle: ["■", "unknown"], armed: ["◇", "unknown"], track: ["▶", "good"],
  contact: ["◉", "good"], retreat: ["◀", "good"], hold: ["‖", "warn"], fault: ["✕", "bad"],
};
export const CLASSES = { running: "▶▶", stopping: "▼", standing: "■", starting: "▲" };
export const LANES = ["running", "starting", "stopping", "standing"];

export function number(value, digits = 2) {
  if (value === undefined || value === null || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  return value.toFixed(size >= 100 ? 0 : size >= 10 ? Math.min(1, digits) : digits);
}

export function seconds(value, digits = 1) {
  if (!Number.isFinite(value)) return "–";
  const minutes = Math.floor(value / 60);
  return minutes ? `${minutes}:${(value - 60 * minutes).toFixed(digits).padStart(digits + 3, "0")}` : `${value.toFixed(digits)} s`;
}

export function age(milliseconds) {
  if (milliseconds === undefined || milliseconds === null) return "–";
  if (milliseconds < 1000) return `${Math.round(milliseconds)} ms`;
  return milliseconds < 60000 ? `${(milliseconds / 1000).toFixed(1)} s` : `${Math.round(milliseconds / 60000)} min`;
}

// A file's name without its middle if it is long: names of files differ at their ends.
export function short(name) {
  const bare = name.replace(/\.mcap$/, "");
  return bare.length > 13 ? `${bare.slice(0, 4)}…${bare.slice(-8)}` : bare;
}
