"use strict";
// The page of a track: time lines, the frames that matter, and a player. What belongs to one frame is in files beside
// the page, images and scripts, loaded when it is looked at. All text goes in as text nodes.

const data = JSON.parse(document.getElementById("data").textContent);
const rows = data.rows, count = rows.frame.length;
const $ = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
const state = { row: 0, seat: "camera", timer: null };

function el(tag, attributes, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes || {})) {
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (value !== null && value !== undefined && value !== false) node.setAttribute(name, value);
  }
  for (const child of children.flat()) if (child !== null && child !== undefined) node.append(child);
  return node;
}

function mark(tag, attributes) {
  const node = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  return node;
}

const number = (value, digits = 2) => value === null || value === undefined ? "–"
  : value.toFixed(Math.abs(value) >= 100 ? 0 : Math.abs(value) >= 10 ? Math.min(1, digits) : digits);
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// --- files beside the page -----------------------------------------------------------------------------------------

const parts = new Map(), waiting = new Map();

window.palpatePart = (part, entries) => {
  parts.set(part, entries);
  for (const done of waiting.get(part) || []) done();
  waiting.delete(part);
};

function details(row, then) {
  const part = Math.floor(row / data.part);
  const ready = () => then(parts.get(part)[row % data.part]);
  if (parts.has(part)) { ready(); return; }
  if (waiting.has(part)) { waiting.get(part).push(ready); return; }
  waiting.set(part, [ready]);
  document.head.append(el("script", { src: `${data.folder}/part_${String(part).padStart(4, "0")}.js` }));
}

const pictureOf = (frame) => `${data.folder}/${String(frame).padStart(6, "0")}.jpg`;

// --- the object's outline over a picture ---------------------------------------------------------------------------

// The mesh in the object's own frame, metres.
const mesh = new Mesh(unpack(data.mesh.v, Float32Array), unpack(data.mesh.f, Uint16Array));

function drawOutline(canvas, entry) {
  const [left, top, width, height] = entry.picture.window, [fx, fy, cx, cy] = entry.picture.camera, p = entry.pose;
  const ratio = Math.min(3, devicePixelRatio || 1), wide = canvas.clientWidth || 320, high = canvas.clientHeight || 240;
  canvas.width = wide * ratio; canvas.height = high * ratio;
  const n = mesh.points.length / 3, at = new Float32Array(3 * n), uv = new Float32Array(2 * n);
  for (let i = 0; i < n; i++) {
    const x = mesh.points[3 * i], y = mesh.points[3 * i + 1], z = mesh.points[3 * i + 2];
    for (let k = 0; k < 3; k++) at[3 * i + k] = p[4 * k] * x + p[4 * k + 1] * y + p[4 * k + 2] * z + p[4 * k + 3];
    if (at[3 * i + 2] < 1e-3) return;  // behind the camera
    uv[2 * i] = (fx * at[3 * i] / at[3 * i + 2] + cx + 0.5 - left) * canvas.width / width;
    uv[2 * i + 1] = (fy * at[3 * i + 1] / at[3 * i + 2] + cy + 0.5 - top) * canvas.height / height;
  }
  const f = mesh.faces, facing = new Uint8Array(f.length / 3);
  for (let t = 0; t < f.length; t += 3) {
    const [a, b, c] = [2 * f[t], 2 * f[t + 1], 2 * f[t + 2]];
    facing[t / 3] = (uv[b] - uv[a]) * (uv[c + 1] - uv[a + 1]) - (uv[b + 1] - uv[a + 1]) * (uv[c] - uv[a]) < 0 ? 1 : 0;
  }
  const pen = canvas.getContext("2d");
  pen.clearRect(0, 0, canvas.width, canvas.height);
  pen.lineJoin = pen.lineCap = "round";
  const path = new Path2D();
  for (const { a, b, s, t } of mesh.edges()) if (facing[s] !== facing[t]) {
    path.moveTo(uv[2 * a], uv[2 * a + 1]);
    path.lineTo(uv[2 * b], uv[2 * b + 1]);
  }
  pen.strokeStyle = "rgba(0,0,0,.5)"; pen.lineWidth = 3.2 * ratio; pen.stroke(path);
  pen.strokeStyle = "#43e0d2"; pen.lineWidth = 1.5 * ratio; pen.stroke(path);
}

// --- the 3-D view --------------------------------------------------------------------------------------------------

const view = new TrackScene($("scene"), $("labels"), new Mesh(mesh.points.map((v, i) => 1e3 * (v - data.mesh.c[i % 3])), mesh.faces), data.object.diameter_mm);

// Of a row-major 3x4 pose: its rotation, and where it puts a point.
const turnOf = (pose) => [0, 1, 2].flatMap((k) => pose.slice(4 * k, 4 * k + 3));
const put = (pose, p) => [0, 1, 2].map((k) => pose[4 * k] * p[0] + pose[4 * k + 1] * p[1] + pose[4 * k + 2] * p[2] + pose[4 * k + 3]);
// Rotation A B^T: from the axes that B leads to, to those of A.
const between = (a, b) => [0, 1, 2].flatMap((i) => [0, 1, 2].map((j) => a[3 * i] * b[3 * j] + a[3 * i + 1] * b[3 * j + 1] + a[3 * i + 2] * b[3 * j + 2]));
const turned = (r, p) => [0, 1, 2].map((k) => r[3 * k] * p[0] + r[3 * k + 1] * p[1] + r[3 * k + 2] * p[2]);

function drawSpace(entry) {
  if (!view.painter) return;
  const inHand = state.seat === "hand", seen = turnOf(entry.pose), held = entry.held && turnOf(entry.held), here = put(entry.pose, data.mesh.c);
  // from the camera's axes to those of the view
  const to = inHand ? held && between(held, seen) : [1, 0, 0, 0, 1, 0, 0, 0, 1];
  const into = (vector) => turned(to, vector.map((v) => 1e3 * v));
  const others = !to ? [] : entry.others.map(([weight, ...pose]) => {
    const turn = turnOf(pose);
    return [weight, inHand ? between(to, [0, 1, 2].flatMap((i) => [turn[i], turn[3 + i], turn[6 + i]])) : turn, into(put(pose, data.mesh.c).map((v, k) => v - here[k]))];
  });
  let palm = null;
  if (held) {
    const middle = put(entry.held, data.mesh.c), fromHand = between(seen, held);
    palm = inHand ? [[1, 0, 0, 0, 1, 0, 0, 0, 1], middle.map((v) => -1e3 * v)] : [fromHand, turned(fromHand, middle).map((v) => -1e3 * v)];
  }
  view.at(state.row, inHand ? held : seen, others, palm);
  const key = (name, text) => el("span", { class: "key", style: `--c:${view.colours()[name]}` }, text);
  $("spacekey").replaceChildren(key("truth", inHand ? "its way in the hand" : "its way before the camera"), others.length ? key("before", `${others.length} other pose${others.length > 1 ? "s" : ""}: ${others.map(([weight]) => `${number(100 * weight, 0)} %`).join(", ")}`) : "");
}

function prepareSpace() {
  if (!view.painter) {
    document.querySelector(".space .frame").replaceChildren(el("p", { class: "absent" }, "This browser draws no WebGL, so the 3-D view is left out. Everything else is whole."));
    return;
  }
  view.along(state.seat === "hand" ? rows.held_position : rows.position, data.object.diameter_mm);
}

// --- time lines ----------------------------------------------------------------------------------------------------

const [first, last] = data.range, span = Math.max(1, last - first), WIDE = 1000;
const x = (frame) => WIDE * (frame - first) / span;
const verdictColour = { ok: "--good", ambiguous: "--warn", lost: "--bad" };
const axes = ["--bad", "--good", "--truth"];
const cursors = [];

function lane(title, high, body, scales) {
  const picture = mark("svg", { viewBox: `0 0 ${WIDE} ${high}`, preserveAspectRatio: "none", height: high });
  picture.append(...body);
  const cursor = mark("line", { class: "cursor", y1: 0, y2: high });
  cursors.push(cursor);
  picture.append(cursor);
  const seek = (event) => {
    if (event.type === "pointermove" && !(event.buttons & 1)) return;
    const box = picture.getBoundingClientRect();
    go(nearest(first + span * (event.clientX - box.left) / box.width));
  };
  picture.addEventListener("pointerdown", seek);
  picture.addEventListener("pointermove", seek);
  return el("div", { class: "lane" }, el("h3", {}, title), picture,
    (scales || []).map(([share, text]) => el("span", { class: "scale", style: `top:calc(18px + ${share} * (100% - 32px))` }, text)));
}

function nearest(frame) {
  let low = 0, high = count - 1;
  while (low < high) { const middle = (low + high) >> 1; if (rows.frame[middle] < frame) low = middle + 1; else high = middle; }
  return low > 0 && frame - rows.frame[low - 1] < rows.frame[low] - frame ? low - 1 : low;
}

function bands(pick, high) {
  const out = [];
  for (let i = 0; i < count;) {
    const name = pick(i);
    let j = i;
    while (j + 1 < count && pick(j + 1) === name) j++;
    const from = x(rows.frame[i] - 0.5), to = x(rows.frame[j] + 0.5);
    if (name) out.push(mark("rect", { x: Math.max(0, from), y: 0, width: Math.max(1, Math.min(WIDE, to) - Math.max(0, from)), height: high, fill: `var(${name})` }));
    i = j + 1;
  }
  return out;
}

function chart(title, series, names, unit, options = {}) {
  const known = series.flat().filter((v) => v !== null), high = options.high || 84;
  if (!known.length) return null;
  const map = options.log ? (v) => Math.log10(Math.max(v, options.least)) : (v) => v;
  let low = Infinity, top = -Infinity;
  for (const value of known) { const v = map(value); if (v < low) low = v; if (v > top) top = v; }
  if (options.zero) low = Math.min(0, low);
  if (top - low < 1e-9) { top += 0.5; low -= 0.5; }
  const y = (v) => 4 + (high - 8) * (top - map(v)) / (top - low);
  const body = [mark("line", { class: "axis", x1: 0, x2: WIDE, y1: high - 1, y2: high - 1 })];
  if (!options.log && low < 0 && top > 0) body.push(mark("line", { class: "axis", x1: 0, x2: WIDE, y1: y(0), y2: y(0) }));
  if (options.limit && map(options.limit) < top) body.push(mark("line", { class: "limit", x1: 0, x2: WIDE, y1: y(options.limit), y2: y(options.limit) }));
  series.forEach((values, k) => {
    let text = "", pen = "M";
    for (let i = 0; i < count; i++) {
      if (values[i] === null) { pen = "M"; continue; }
      text += `${pen}${x(rows.frame[i]).toFixed(1)} ${y(values[i]).toFixed(1)}`;
      pen = "L";
    }
    body.push(mark("path", { class: "curve", d: text, stroke: `var(${names.length > 1 ? axes[k] : "--accent"})` }));
  });
  const back = (v) => number(options.log ? 10 ** v : v);
  const head = [el("b", {}, title), ...names.map((name, k) => el("span", { class: "key", style: `--c:var(${names.length > 1 ? axes[k] : "--accent"})` }, name)), el("span", {}, options.told || "")];
  return lane(head, high, body, [[0, `${back(top)} ${unit}`], [1, `${back(low)} ${unit}`]]);
}

function drawLines() {
  const held = state.seat === "hand", place = held ? rows.held_position : rows.position, turn = held ? rows.held_turn : rows.turn;
  cursors.length = 0;
  const key = (name, text) => el("span", { class: "key", style: `--c:var(${name})` }, text);
  const skipped = data.skipped.map((s) => mark("rect", { x: x(s.first - 0.5), y: 0, width: Math.max(1.5, x(s.last + 0.5) - x(s.first - 0.5)), height: 12, fill: `var(${s.cause === "behind" ? "--before" : "--bad"})` }));
  const without = (name) => (i) => rows.missing_words[rows.missing[i]].split(",").some((stage) => name.includes(stage)) ? "--quiet" : null;
  const lanes = [
    lane([el("b", {}, "Verdict"), key("--good", "ok"), key("--warn", "ambiguous"), key("--bad", "lost")], 14, bands((i) => verdictColour[rows.verdict[i]], 14)),
    lane([el("b", {}, "Slip"), key("--touch", "slips in the hand"), key("--before", "moves with its fingers")], 12, bands((i) => rows.slip[i] ? "--touch" : rows.moved[i] ? "--before" : null, 12)),
    lane([el("b", {}, "How"), key("--accent", "started or found again"), key("--truth", "carried, nothing sensed")], 12,
      bands((i) => rows.how[i] === "started" || rows.how[i] === "re-initialised" ? "--accent" : rows.how[i] === "carried" ? "--truth" : null, 12)),
    lane([el("b", {}, "Left out"), key("--before", "a newer frame had come"), key("--bad", "unreadable")], 12, skipped),
    lane([el("b", {}, "Skipped in the frame"), key("--quiet", "no vision")], 6, bands(without(["look", "vision"]), 6)),
    lane([el("b", {}, "\u00a0"), key("--quiet", "no touch")], 6, bands(without(["feel", "touch"]), 6)),
    chart("Position", place, ["x", "y", "z"], "mm", { told: held ? "of the object's middle in the hand, from the first" : "of the object's middle before the camera, from the first" }),
    chart("Rotation", turn, ["x", "y", "z"], "°", { told: "rotation vector from the first frame" }),
    chart("σ position", [rows.sigma_mm], ["worst direction"], "mm", { log: true, least: 0.01, high: 56 }),
    chart("σ rotation", [rows.sigma_deg], ["worst axis"], "°", { log: true, least: 0.01, high: 56 }),
    chart("Error", [rows.error_mm], ["ADD-S against the known pose"], "mm", { zero: true, limit: 5, high: 56 }),
    chart("Time", [data.summary.hertz ? rows.latency_ms : rows.step_ms], [data.summary.hertz ? "from a frame's arrival to its answer" : "of the tracker, a frame"], "ms", { log: true, least: 0.1, high: 56, limit: data.summary.hertz ? 1000 / data.summary.hertz : 0 }),
  ];
  const empty = [0, !rows.slip.some(Boolean) && !rows.moved.some(Boolean), !rows.how.some((h) => h === "carried" || h === "re-initialised"), !skipped.length, !rows.missing.some((_, i) => without(["look", "vision"])(i)), !rows.missing.some((_, i) => without(["feel", "touch"])(i))];
  $("lines").replaceChildren(...lanes.filter((one, k) => one && !empty[k]));
  const seats = rows.held_position[0].some((v) => v !== null) ? [["camera", "Camera"], ["hand", "Hand"]] : [];
  $("seat").replaceChildren(...seats.map(([name, text]) => el("button", { type: "button", "aria-pressed": String(name === state.seat), onclick: () => { state.seat = name; prepareSpace(); drawLines(); go(state.row); } }, text)));
}

function moveCursors() {
  const at = x(rows.frame[state.row]);
  for (const cursor of cursors) { cursor.setAttribute("x1", at); cursor.setAttribute("x2", at); }
}

// --- one frame -----------------------------------------------------------------------------------------------------

const SAID = { ok: "Followed", ambiguous: "Ambiguous", lost: "Lost" };
const HOW = { started: "Found by a search of this frame.", tracked: "Followed from the frames before.", carried: "Nothing was sensed: moved with the hand.", "re-initialised": "Was lost, and found again by a search.", lost: "No pose explains what was sensed." };

function card(title, size, body) {
  return el("section", { class: `card ${size}` }, el("header", {}, el("h2", {}, title)), body);
}

function table(head, body) {
  const line = (tag, cells) => el("tr", {}, cells.map(([text, type]) => el(tag, { class: type }, text)));
  return el("div", { class: "scroll" }, el("table", {}, el("thead", {}, line("th", head)), el("tbody", {}, body.map((cells) => line("td", cells)))));
}

function go(row) {
  state.row = Math.max(0, Math.min(count - 1, row));
  const i = state.row, frame = rows.frame[i], verdict = rows.verdict[i];
  $("slider").value = String(i);
  $("where").textContent = `frame ${frame} · ${i + 1}/${count}`;
  $("verdict").className = `verdict ${verdict}`;
  $("headline").textContent = SAID[verdict] || verdict;
  $("sentence").textContent = (HOW[rows.how[i]] || rows.how[i]) + (rows.slip[i] ? " It slips in the hand." : rows.moved[i] ? " It moves in the hand, with its fingers." : "");
  const figures = [["Moved", Math.hypot(...rows.position.map((v) => v[i] || 0)), "mm"], ["Turned", Math.hypot(...rows.turn.map((v) => v[i] || 0)), "°"], ["σ position", rows.sigma_mm[i], "mm"], ["σ rotation", rows.sigma_deg[i], "°"], ["Sure", rows.confidence[i] === null ? null : 100 * rows.confidence[i], "%"], ["Error", rows.error_mm[i], "mm"], [data.summary.hertz ? "Late" : "Time", data.summary.hertz ? rows.latency_ms[i] : rows.step_ms[i], "ms"]];
  $("numbers").replaceChildren(...figures.filter(([, value]) => value !== null).map(([name, value, unit]) => el("div", {}, el("dt", {}, name), el("dd", {}, number(value), el("small", {}, unit)))));
  for (const button of $("moments").children) button.classList.toggle("on", Number(button.dataset.row) === i);
  moveCursors();
  details(i, (entry) => { if (state.row === i) show(entry); });
}

function show(entry) {
  const seen = Boolean(entry.picture);
  $("picture").hidden = $("outline").hidden = !seen;
  $("unseen").hidden = seen;
  if (seen) {
    $("picture").src = pictureOf(entry.frame);
    $("picture").alt = `frame ${entry.frame}, cropped around the object, with its outline where the track has it`;
    document.querySelector(".photo .frame").style.aspectRatio = `${entry.picture.window[2]} / ${entry.picture.window[3]}`;
    drawOutline($("outline"), entry);
  }
  drawSpace(entry);
  $("notes").replaceChildren(...entry.notes.map((text) => el("li", {}, text)), ...entry.unobservable.map((text) => el("li", {}, `not known: ${text}`)));
  if (state.timer !== null) return;  // while it plays, tables would only flicker
  const trace = entry.trace.map(([stage, ran, why, ms, many]) => [[stage], [ran ? why : `skipped: ${why}`], [ran && many ? String(many) : "", "n"], [ran ? number(ms, 1) : "", "n"]]);
  const contacts = entry.contacts.map(([sensor, mm, degrees, outlier]) => [[sensor], [number(mm), "n"], [number(degrees, 1), "n"], [outlier ? "outlier" : ""]]);
  $("cards").replaceChildren(...[
    trace.length ? card("What ran, and why", contacts.length ? "" : "wide", table([["Stage"], ["Why"], ["Rows", "n"], ["ms", "n"]], trace)) : null,
    contacts.length ? card("Contacts", "", table([["Sensor"], ["To the surface, mm", "n"], ["Normal °", "n"], [""]], contacts)) : null,
  ].filter(Boolean));
}

function play(on) {
  const played = state.timer !== null;
  clearInterval(state.timer);
  state.timer = on ? setInterval(() => { if (state.row + 1 < count) go(state.row + 1); else play(false); }, 1000 / 30) : null;
  $("play").textContent = on ? "❚❚" : "▶";
  $("play").setAttribute("aria-label", on ? "Pause" : "Play");
  if (!on && played) go(state.row);  // with its tables
}

function drawMoments() {
  const made = data.moments.map(({ row, why }) => {
    const image = el("img", { alt: "" }), canvas = el("canvas", {});
    const button = el("button", { type: "button", "data-row": row, onclick: () => { play(false); go(row); scrollTo({ top: 0, behavior: "smooth" }); } },
      el("span", { class: "thumb" }, image, canvas), el("span", { class: "said" }, el("b", {}, `frame ${rows.frame[row]}`), why));
    details(row, (entry) => {
      if (!entry.picture) { image.remove(); return; }
      image.src = pictureOf(entry.frame);
      drawOutline(canvas, entry);
    });
    return button;
  });
  $("moments").replaceChildren(...made);
  $("momentcard").hidden = !made.length;
}

(function start() {
  const s = data.summary, left = s.frames_skipped;
  $("capture").textContent = data.capture;
  $("object").textContent = data.object.name.replaceAll("_", " ");
  const facts = [`${s.frames_answered} of ${s.frames_recorded} frames followed`, `${s.verdicts.ok || 0} ok`, s.verdicts.ambiguous ? `${s.verdicts.ambiguous} ambiguous` : "", s.verdicts.lost ? `${s.verdicts.lost} lost` : "", `${s.slips.count} slips`,
    left.behind ? `${left.behind} left out because newer ones had come` : "", left.unreadable ? `${left.unreadable} unreadable` : "", s.step_ms.p50 === null ? "" : `${number(s.step_ms.p50, 1)} ms a frame, 99 % within ${number(s.step_ms.p99, 1)} ms`,
    s.hertz ? `at ${s.hertz} Hz: answered ${number(s.latency_ms.p50, 1)} ms after arrival, 99 % within ${number(s.latency_ms.p99, 1)} ms` : "", s.complete ? "" : "interrupted", data.every > 1 ? `every ${data.every}th frame is drawn, and those in which something changes` : ""];
  $("facts").textContent = facts.filter(Boolean).join(" · ");
  if (!count) {
    document.querySelector("main").replaceChildren(el("p", { class: "quiet" }, "No frame was tracked."));
    return;
  }
  $("slider").max = String(count - 1);
  $("slider").addEventListener("input", (e) => { const row = Number(e.target.value); play(false); go(row); });
  $("play").addEventListener("click", () => { if (state.timer === null && state.row === count - 1) state.row = 0; play(state.timer === null); });
  $("previous").addEventListener("click", () => { play(false); go(state.row - 1); });
  $("next").addEventListener("click", () => { play(false); go(state.row + 1); });
  addEventListener("keydown", (e) => {
    if (e.target === $("slider") || e.ctrlKey || e.metaKey || e.altKey) return;
    if (e.key === "ArrowLeft") { play(false); go(state.row - 1); }
    if (e.key === "ArrowRight") { play(false); go(state.row + 1); }
    if (e.key === " " && e.target === document.body) { e.preventDefault(); play(state.timer === null); }
  });
  addEventListener("resize", () => { drawMoments(); go(state.row); });
  prepareSpace();
  if (view.painter) $("angles").replaceChildren(...[["camera", "Camera"], ["tilted", "Tilted"], ["side", "Side"], ["top", "Top"]].map(([key, text]) => el("button", { type: "button", onclick: () => view.look(key) }, text)));
  drawLines();
  drawMoments();
  const asked = Number(location.hash.slice(1));
  go(location.hash && Number.isFinite(asked) ? nearest(asked) : 0);
})();
