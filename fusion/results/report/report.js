"use strict";
// Fills the page from its data. All text goes in as text nodes: nothing in a capture can become markup.

const data = JSON.parse(document.getElementById("data").textContent);
const $ = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
const shown = { after: true, before: true, truth: false, contacts: true, next: false, grasp: true, cloud: true, hand: true };
const state = { frame: 0, picture: "depth", table: "frame" };

function el(tag, attributes, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes || {})) {
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (value !== null && value !== undefined && value !== false) node.setAttribute(name, value);
  }
  for (const child of children.flat()) if (child !== null && child !== undefined) node.append(child);
  return node;
}

function mark(tag, attributes, text) {
  const node = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  if (text !== undefined) node.textContent = text;
  return node;
}

const number = (value, digits = 2) => value === null || value === undefined ? "–"
  : value.toFixed(Math.abs(value) >= 100 ? 0 : Math.abs(value) >= 10 ? Math.min(1, digits) : digits);
const median = (values) => {
  const sorted = values.filter((v) => v !== null && v !== undefined).sort((a, b) => a - b), half = sorted.length >> 1;
  return !sorted.length ? null : sorted.length % 2 ? sorted[half] : (sorted[half - 1] + sorted[half]) / 2;
};
const pill = (verdict) => el("span", { class: `pill ${verdict || "none"}` }, verdict || "–");
const row = (tag, cells) => el("tr", {}, cells.map(([text, type]) => el(tag, { class: type }, text)));

function table(head, rows) {
  return el("div", { class: "scroll" }, el("table", {}, el("thead", {}, row("th", head)), el("tbody", {}, rows)));
}

function card(title, size, body, extra) {
  return el("section", { class: `card ${size}` }, el("header", {}, el("h2", {}, title), extra), body);
}

function choice(options, current, pick) {
  return options.map(([key, text]) => el("button", { type: "button", "aria-pressed": String(key === current), onclick: () => pick(key) }, text));
}

// --- the picture ---------------------------------------------------------------------------------------------------

function drawPicture(frame) {
  const image = frame.image;
  $("photo").hidden = !image;
  document.querySelector(".views").classList.toggle("single", !image);
  if (!image) return;
  const kinds = [["depth", "Depth"], ["colour", "Colour"]].filter(([kind]) => image[kind]);
  const kind = image[state.picture] ? state.picture : kinds[0][0];
  $("picture").src = image[kind];
  $("picture").alt = `${kind} image of frame ${frame.index}, cropped around the object`;
  $("swap").replaceChildren(...(kinds.length > 1 ? choice(kinds, kind, (key) => { state.picture = key; drawPicture(frame); }) : []));
  $("depthkey").replaceChildren(...(kind === "depth" && image.range_m ? [
    `${image.range_m[0].toFixed(2)} m`, el("i", { class: "ramp", style: "background:linear-gradient(90deg,#fae8c8,#f0aa78,#be5c6e,#683e78,#2c2854,#14162c)" }),
    `${image.range_m[1].toFixed(2)} m`] : []));
  const overlay = $("overlay");
  overlay.setAttribute("viewBox", `0 0 ${image.width} ${image.height}`);
  const layers = [];
  for (const name of ["truth", "before", "after"]) {
    if (!shown[name] || !image.outlines[name]) continue;
    const path = image.outlines[name].map((flat) => {
      let text = "";
      for (let i = 0; i < flat.length; i += 2) text += `${i ? "L" : "M"}${flat[i]} ${flat[i + 1]}`;
      return text + "Z";
    }).join("");
    if (name === "after") layers.push(mark("path", { d: path, class: "halo" }));
    layers.push(mark("path", { d: path, class: `line ${name}` }));
  }
  if (shown.contacts) image.marks.forEach((at, i) => {
    if (!at) return;
    const dot = mark("circle", { cx: at[0], cy: at[1], r: image.width / 100, class: `mark ${frame.contacts[i].outlier ? "outlier" : ""}`, "data-contact": i });
    dot.append(mark("title", {}, frame.contacts[i].sensor));
    layers.push(dot);
  });
  overlay.replaceChildren(...layers);
}

// Where there is no WebGL the words take the view's place; everything else is the same.
function withoutScene() {
  document.querySelector(".space .frame").replaceChildren(el("p", { class: "absent" },
    "This browser draws no WebGL, so the 3-D view is left out. The picture, the numbers and the tables are whole; another browser, or this one with graphics acceleration switched on, shows the view."));
  $("cloudkey").hidden = true;
}

function light(index) {
  scene.lit = index;
  scene.draw();
  for (const node of document.querySelectorAll("[data-contact]")) node.classList.toggle("lit", Number(node.dataset.contact) === index);
}

// --- the cards -----------------------------------------------------------------------------------------------------

function methodRows() {
  const rows = data.comparison, framed = rows.some((r) => r.frame !== null && r.frame !== undefined);
  const index = data.frames[state.frame].index;
  const many = new Set(rows.map((r) => r.frame)).size > 1;
  if (!framed || (many && state.table === "all") || !rows.some((r) => r.frame === index)) {
    return [...new Set(rows.map((r) => r.method))].map((method) => {
      const own = rows.filter((r) => r.method === method), pick = (key) => median(own.map((r) => r[key]));
      const good = own.filter((r) => r.adds_mm !== null && r.adds_mm < 5).length;
      return { method, name: own[0].name, adds_mm: pick("adds_mm"), rotation_deg: pick("rotation_deg"), translation_mm: pick("translation_mm"), cloud_mm: pick("cloud_mm"), contacts_mm: pick("contacts_mm"),
        ms: pick("ms"), verdict: own.length === 1 ? own[0].verdict : "", success: own.length > 1 ? `${Math.round(100 * good / own.length)} %` : null };
    });
  }
  return rows.filter((r) => r.frame === index);
}

function comparisonCard() {
  if (!data.comparison.length) return null;
  const rows = methodRows(), many = new Set(data.comparison.map((r) => r.frame)).size > 1, success = rows.some((r) => r.success);
  // without ground truth, how well the sensed points lie on the surface stands in for the errors
  const known = data.comparison.some((r) => r.adds_mm !== null), main = known ? "adds_mm" : "cloud_mm";
  const others = known ? [["rotation_deg", "Rotation °", "n"], ["translation_mm", "Position mm", "n hide-small"]] : [["contacts_mm", "Contacts as reported, mm", "n"]];
  const largest = Math.max(1e-6, ...rows.map((r) => r[main] || 0)), smallest = Math.min(...rows.map((r) => r[main] || largest)) / 2;
  const share = (v) => !v ? 0 : Math.max(3, 100 * Math.log(v / smallest) / Math.log(largest / smallest));
  const last = known && success ? ["Within 5 mm", "n"] : ["Verdict", ""];
  const head = [["Method"], [known ? "ADD-S mm" : "Cloud mm"], ...others.map(([, text, type]) => [text, type]), ["Time ms", "n"], last];
  const body = rows.map((r) => {
    const bar = r[main] === null ? null : el("span", { class: `bar ${r.method.startsWith("icp") ? "icp" : ""}`, style: `width:${share(r[main]).toFixed(1)}%` });
    return el("tr", { class: r.method }, el("td", {}, r.name), el("td", { class: "meter" }, number(r[main]), bar), others.map(([key, , type]) => el("td", { class: type }, number(r[key]))),
      el("td", { class: "n" }, number(r.ms, 1)), el("td", { class: last[1] }, last[1] ? r.success : pill(r.verdict)));
  });
  const swap = many ? el("span", { class: "swap" }, choice([["frame", "This frame"], ["all", "Median of all"]], state.table, (key) => { state.table = key; drawCards(); })) : null;
  return card("Methods", "wide", [table(head, body), many && known ? dotPlot() : null], swap);
}

function dotPlot() {
  const methods = [...new Set(data.comparison.map((r) => r.method))], narrow = innerWidth < 600;
  const wide = narrow ? 380 : 900, high = 30, left = narrow ? 104 : 132, right = wide - 22, height = high * methods.length + 34;
  const values = data.comparison.map((r) => r.adds_mm).filter((v) => v > 0);
  const ticks = [];
  for (let power = -3; power < 4; power++) for (const step of [1, 2, 5]) ticks.push(step * 10 ** power);
  const first = Math.max(0, ticks.findLastIndex((t) => t <= Math.min(2, ...values))), last = ticks.findIndex((t) => t >= Math.max(6, ...values));
  const used = ticks.slice(first, last < 0 ? undefined : last + 1), low = Math.log10(used[0]), top = Math.log10(used[used.length - 1]);
  const x = (v) => left + (right - left) * (Math.log10(Math.min(Math.max(v, 10 ** low), 10 ** top)) - low) / (top - low);
  const plot = mark("svg", { class: "plot", viewBox: `0 0 ${wide} ${height}`, role: "img", "aria-label": "Surface error of every frame by method, logarithmic" });
  used.forEach((tick, i) => {
    if (narrow && used.length > 6 && i % 2) return;
    plot.append(mark("line", { x1: x(tick), x2: x(tick), y1: 0, y2: height - 24 }));
    plot.append(mark("text", { x: x(tick), y: height - 6, "text-anchor": "middle" }, `${Number(tick.toPrecision(1))}${i === used.length - 1 ? " mm" : ""}`));
  });
  plot.append(mark("line", { x1: x(5), x2: x(5), y1: 0, y2: height - 24, class: "limit" }));
  const index = data.frames[state.frame].index;
  methods.forEach((method, k) => {
    const own = data.comparison.filter((r) => r.method === method), y = high * (k + 0.5), middle = median(own.map((r) => r.adds_mm));
    plot.append(mark("text", { x: 0, y: y + 4 }, own[0].name));
    const dots = own.filter((r) => r.adds_mm !== null).map((r) => mark("circle", { cx: x(r.adds_mm), cy: y, r: r.frame === index ? 5.5 : 4.5, class: `${r.frame === index ? "on" : ""} ${method}` }));
    plot.append(...dots.sort((a, b) => a.classList.contains("on") - b.classList.contains("on")));
    if (middle) plot.append(mark("path", { d: `M${x(middle)} ${y - 9}V${y + 9}` }));
  });
  return plot;
}

function traceCard(frame) {
  if (!frame.trace.length) return null;
  const longest = Math.max(1e-6, ...frame.trace.map((s) => s.ms || 0));
  const body = frame.trace.map((s) => el("tr", { class: s.ran ? "" : "skipped" },
    el("td", {}, s.stage), el("td", {}, s.ran ? s.why : `skipped: ${s.why}`), el("td", { class: "n" }, s.ran && s.rows ? s.rows.toLocaleString("en") : ""),
    el("td", { class: "n load" }, s.ran ? number(s.ms, 1) : "", s.ran ? el("span", { class: "bar", style: `width:${(100 * (s.ms || 0) / longest).toFixed(1)}%;margin-left:auto` }) : null)));
  return card("What ran, and why", frame.contacts.length ? "" : "wide", table([["Stage"], ["Why"], ["Rows", "n"], ["ms", "n"]], body), el("span", { class: "quiet" }, `${number(frame.ms, 1)} ms`));
}

function contactsCard(frame) {
  if (!frame.contacts.length) return null;
  const body = frame.contacts.map((c, i) => el("tr", { "data-contact": i, onmouseenter: () => light(i), onmouseleave: () => light(-1) },
    el("td", {}, c.sensor), el("td", { class: "n" }, c.mm === null ? "–" : (c.mm > 0 ? "+" : "") + number(c.mm)), el("td", { class: "n" }, c.deg === null ? "–" : number(c.deg, 1)),
    el("td", { class: "n" }, c.outlier ? el("span", { class: "pill outlier" }, "outlier") : c.mm === null ? "" : el("span", { class: "pill ok" }, "agrees"))));
  return card("Contacts", frame.trace.length ? "" : "wide", table([["Sensor"], ["To the surface, mm", "n"], ["Normal °", "n"], ["", "n"]], body));
}

function doubtCards(frame) {
  const free = frame.unobservable.length ? el("ul", { class: "plain" }, frame.unobservable.map((text) => el("li", {}, text)))
    : el("p", { class: "quiet" }, "Nothing: what was sensed holds the object in all six directions.");
  const modes = frame.modes.length ? el("ul", { class: "plain" }, frame.modes.map((m, i) => el("li", {}, el("span", { class: "share" }, m.weight === null ? "–" : `${Math.round(100 * m.weight)} %`),
    i === 0 && !m.deg && !m.mm ? "the pose shown" : `${number(m.mm, 1)} mm and ${number(m.deg, 1)}° from the pose shown`)))
    : el("p", { class: "quiet" }, "None was kept.");
  const cards = [card("What cannot be known", "slim", free), card("Poses that fit", "slim", modes)];
  if (frame.notes.length) cards.push(card("Notes", "slim", el("ul", { class: "plain" }, frame.notes.map((text) => el("li", {}, text)))));
  if (data.summary.length) cards.push(card("Over all frames", "slim", table([["Measure"], ["", "n"]], data.summary.map(([name, value]) => row("td", [[name], [value, "n"]])))));
  return cards;
}

function contributionsCard(frame) {
  if (!frame.contributions.length) return null;
  const body = frame.contributions.map(([source, rows, position, rotation]) => row("td", [[source], [rows, "n"], [position, "n"], [rotation, "n"]]));
  return card("What each source added", "", table([["Source"], ["Rows", "n"], ["σ position, without → with", "n"], ["σ rotation", "n"]], body));
}

function nextCard(frame) {
  if (!frame.next.length) return null;
  return card("Where to touch next", "", el("ol", { class: "plain" }, frame.next.map((t) => el("li", {}, t.text))), el("span", { class: "quiet" }, "σ now → with a contact that shares no error with the others; dashed rings in the view"));
}

function graspCard(frame) {
  if (!frame.grasp) return null;
  const grasp = frame.grasp, places = grasp.places.length ? el("ol", { class: "plain" }, grasp.places.map((t) => el("li", {}, t.text))) : el("p", { class: "quiet" }, grasp.map ? "No place within reach would make it hold better." : "");
  const figures = table([["Grasp"], ["", "n"]], grasp.rows.map(([name, value]) => row("td", [[name], [value, "n"]])));
  return card("How it is held", "", [el("p", {}, el("span", { class: `pill ${grasp.closure ? "ok" : "outlier"}` }, grasp.verdict), ` ${grasp.why}`), figures, el("h2", { class: "sub" }, "Where another finger would help"), places]);
}

// Rows of the grid are full: cards of a row that is not share it.
function settle(cards) {
  let row = [], used = 0;
  const end = () => {
    if (used < 12) row.forEach((c) => { c.classList.remove("slim"); c.classList.toggle("wide", row.length === 1); });
    row = [];
    used = 0;
  };
  for (const c of cards) {
    const span = c.classList.contains("wide") ? 12 : c.classList.contains("slim") ? 4 : 6;
    if (used + span > 12) end();
    row.push(c);
    used += span;
  }
  end();
  return cards;
}

function drawCards() {
  const frame = data.frames[state.frame];
  $("cards").replaceChildren(...settle([comparisonCard(), traceCard(frame), contactsCard(frame), contributionsCard(frame), graspCard(frame), nextCard(frame), ...doubtCards(frame)].filter(Boolean)));
}

// --- the page ------------------------------------------------------------------------------------------------------

function drawControls() {
  const frame = data.frames[state.frame];
  const options = [["after", "Estimate", "--accent", ""], ["before", "Start", "--before", "dash"], ["truth", "Truth", "--truth", "dash"], ["contacts", "Contacts", "--touch", "dot"], ["next", "Next touch", "--touch", "dash"], ["grasp", "Finger map", "--truth", "dot"], ["cloud", "Cloud", "--quiet", "dot"], ["hand", "Hand", "--quiet", "dot"]];
  const here = (key) => key === "contacts" ? frame.contacts.some((c) => c.p) : key === "next" ? frame.next.length : key === "grasp" ? frame.grasp && frame.grasp.map : key === "cloud" ? frame.cloud : key === "hand" ? frame.hand : frame.poses[key];
  $("controls").replaceChildren(...options.filter(([key]) => here(key)).map(([key, text, colour, shape]) => el("button", {
    type: "button", class: shape, style: `--mark:var(${colour})`, "aria-pressed": String(shown[key]),
    onclick: () => { shown[key] = !shown[key]; drawControls(); drawPicture(frame); drawKey(frame); scene.draw(); },
  }, text)));
}

function drawKey(frame) {
  const grasp = shown.grasp && frame.grasp && frame.grasp.map;
  const cloud = frame.cloud && frame.poses.after ? [["within 2 mm", "near"], ["2–6 mm", "middling"], ["farther", "far"]].map(([text, key]) =>
    el("span", { class: "key", style: `--c:${scene.colours()[key]}` }, text)) : [];
  $("cloudkey").replaceChildren(...cloud, ...(grasp ? ["no gain", el("i", { class: "ramp", style: `background:linear-gradient(90deg,${[0, 0.5, 1].map((s) => scene.gain(s)).map((c) => `rgb(${c})`).join(",")})` }), `ε +${number(frame.grasp.largest, 3)} with a finger there`] : []));
}

function go(index) {
  state.frame = Math.max(0, Math.min(data.frames.length - 1, index));
  const frame = data.frames[state.frame];
  $("slider").value = String(state.frame);
  $("position").textContent = `frame ${frame.index} · ${state.frame + 1}/${data.frames.length}`;
  [...$("cells").children].forEach((cell, i) => cell.classList.toggle("on", i === state.frame));
  $("verdict").className = `verdict ${frame.verdict}`;
  $("headline").textContent = frame.headline;
  $("sentence").textContent = frame.sentence;
  // rows of one length, where that can be
  const figures = frame.numbers.length;
  $("numbers").style.setProperty("--across", figures > 7 ? Math.ceil(figures / 2) : figures);
  $("numbers").style.setProperty("--narrow", figures % 4 ? 3 : 4);
  $("numbers").replaceChildren(...frame.numbers.map((n) => el("div", { title: n.hint }, el("dt", {}, n.label), el("dd", {}, n.value, el("small", {}, n.unit)))));
  drawKey(frame);
  drawControls();
  drawPicture(frame);
  scene.show(frame, data.handFaces);
  drawCards();
}

const scene = new Scene($("scene"), $("labels"), new Mesh(millimetres(data.mesh.v), unpack(data.mesh.f, Uint16Array)), data.object.diameter_mm);
scene.shown = shown;

(function start() {
  $("capture").textContent = data.capture;
  $("object").textContent = data.object.name.replaceAll("_", " ");
  const count = (verdict) => data.frames.filter((f) => f.verdict === verdict).length;
  const facts = [`${number(data.object.diameter_mm, 0)} mm across`, data.object.symmetry];
  if (data.frames.length > 1) facts.push(`${count("ok")} of ${data.frames.length} frames found`, count("ambiguous") ? `${count("ambiguous")} ambiguous` : "", count("lost") ? `${count("lost")} lost` : "");
  $("facts").textContent = facts.filter(Boolean).join(" · ");
  if (!data.frames.length) {
    document.querySelector("main").replaceChildren(el("p", { class: "quiet" }, "No frame was estimated."));
    return;
  }
  if (!scene.painter) withoutScene();
  else $("angles").replaceChildren(...[["camera", "Camera"], ["tilted", "Tilted"], ["side", "Side"], ["top", "Top"], ["back", "Back"]].map(([key, text]) => el("button", { type: "button", onclick: () => scene.look(key) }, text)));
  if (data.frames.length > 1) {
    $("frames").hidden = false;
    $("cells").replaceChildren(...data.frames.map((f) => el("i", { class: f.verdict })));
    $("slider").max = String(data.frames.length - 1);
    $("slider").addEventListener("input", (e) => go(Number(e.target.value)));
    $("previous").addEventListener("click", () => go(state.frame - 1));
    $("next").addEventListener("click", () => go(state.frame + 1));
    addEventListener("keydown", (e) => {
      if (e.target === $("slider") || e.ctrlKey || e.metaKey || e.altKey) return;
      if (e.key === "ArrowLeft") go(state.frame - 1);
      if (e.key === "ArrowRight") go(state.frame + 1);
    });
  }
  go(0);
})();
