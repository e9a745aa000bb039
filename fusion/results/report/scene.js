"use strict";
// The 3-D view: what is shown, from where, and the hand on the mouse. The view looks along its own z, turned by yaw and
// pitch from the camera's; marks and words lie on a second canvas above.

class Scene {
  constructor(canvas, labels, mesh, diameter) {
    this.canvas = canvas;
    this.pen = labels.getContext("2d");
    this.mesh = mesh;
    this.diameter = diameter;
    this.shown = {};
    this.lit = -1;
    this.zoom = 1;
    try {
      this.painter = new Painter(canvas);
    } catch (error) {
      this.why = error.message;
      return;  // whoever asks `painter` says so in words
    }
    this.look("tilted", true);
    this.listen();
  }

  look(name, now) {
    const [yaw, pitch] = { camera: [0, 0], tilted: [0.5, 0.42], side: [Math.PI / 2, 0], top: [0, Math.PI / 2 - 0.01], back: [Math.PI, 0] }[name];
    this.zoom = 1;
    const still = now || matchMedia("(prefers-reduced-motion: reduce)").matches;
    const from = [this.yaw || 0, this.pitch || 0], began = performance.now();
    const step = (time) => {
      const s = still ? 1 : Math.min(1, Math.max(0, (time - began) / 320)), ease = s * s * (3 - 2 * s);
      this.yaw = from[0] + (yaw - from[0]) * ease;
      this.pitch = from[1] + (pitch - from[1]) * ease;
      this.draw();
      if (s < 1) requestAnimationFrame(step);
    };
    step(began);
  }

  listen() {
    const c = this.canvas, held = new Map();
    let spread = 0;
    c.addEventListener("pointerdown", (e) => { held.set(e.pointerId, e); c.setPointerCapture(e.pointerId); c.focus({ preventScroll: true }); });
    const release = (e) => { held.delete(e.pointerId); spread = 0; };
    c.addEventListener("pointerup", release);
    c.addEventListener("pointercancel", release);
    c.addEventListener("pointermove", (e) => {
      const last = held.get(e.pointerId);
      if (!last) return;
      held.set(e.pointerId, e);
      if (held.size === 2) {
        const [a, b] = [...held.values()], wide = Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
        if (spread) this.scaleBy(wide / spread);
        spread = wide;
        return;
      }
      this.yaw += (e.clientX - last.clientX) * 0.009;
      this.pitch = Math.max(-1.56, Math.min(1.56, this.pitch + (e.clientY - last.clientY) * 0.009));
      this.draw();
    });
    // the page scrolls over the view until the view is clicked
    c.addEventListener("wheel", (e) => {
      if (document.activeElement !== c) return;
      e.preventDefault();
      this.scaleBy(Math.exp(-e.deltaY * 0.0015));
    }, { passive: false });
    c.addEventListener("keydown", (e) => {
      if (e.key === "+" || e.key === "=") this.scaleBy(1.2);
      if (e.key === "-") this.scaleBy(1 / 1.2);
    });
    c.addEventListener("webglcontextlost", (e) => e.preventDefault());
    c.addEventListener("webglcontextrestored", () => { this.painter.start(); this.loaded = {}; this.draw(); });
    new ResizeObserver(() => this.draw()).observe(c);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  scaleBy(factor) {
    this.zoom = Math.max(0.3, Math.min(12, this.zoom * factor));
    this.draw();
  }

  show(frame, handFaces) {
    this.frame = frame;
    this.cloud = frame.cloud && { points: millimetres(frame.cloud.p), away: unpack(frame.cloud.d, Uint8Array) };
    const faces = frame.hand && (frame.hand.f || handFaces);
    this.gains = frame.grasp && frame.grasp.map && unpack(frame.grasp.map, Uint8Array);
    this.hand = frame.hand && new Mesh(millimetres(frame.hand.v), unpack(faces, Uint16Array));
    if (!this.painter) return;
    for (const kept of Object.values(this.loaded || {})) this.painter.free(kept[1]);
    this.loaded = {};
    this.draw();
  }

  // What is on the card under that name, made again when `key` is another.
  kept(name, key, make) {
    const old = this.loaded[name];
    if (old && old[0] === key) return old[1];
    if (old) this.painter.free(old[1]);
    this.loaded[name] = [key, this.painter.load(make())];
    return this.loaded[name][1];
  }

  get turn() {
    const cy = Math.cos(this.yaw), sy = Math.sin(this.yaw), cp = Math.cos(this.pitch), sp = Math.sin(this.pitch);
    return [cy, 0, -sy, -sp * sy, cp, -sp * cy, cp * sy, sp, cp * cy];
  }

  get eye() {
    return 4 * this.diameter;
  }

  // Pixels a millimetre at the object.
  get scale() {
    return this.zoom * 0.71 * Math.min(this.canvas.width, this.canvas.height) / this.diameter;
  }

  // Screen x and y (device pixels) and depth (mm, larger is farther) of points.
  project(points) {
    const out = new Float32Array(points.length), r = this.turn, w = this.canvas.width / 2, h = this.canvas.height / 2;
    for (let i = 0; i < points.length; i += 3) {
      const x = points[i], y = points[i + 1], z = points[i + 2], deep = r[6] * x + r[7] * y + r[8] * z;
      const near = this.scale * this.eye / Math.max(0.1 * this.eye, this.eye + deep);
      out[i] = w + (r[0] * x + r[1] * y + r[2] * z) * near;
      out[i + 1] = h + (r[3] * x + r[4] * y + r[5] * z) * near;
      out[i + 2] = deep;
    }
    return out;
  }

  colours() {
    const style = getComputedStyle(document.documentElement), read = (name) => style.getPropertyValue(name).trim();
    const dark = matchMedia("(prefers-color-scheme: dark)").matches;
    return {
      dark, ink: read("--ink"), before: read("--before"), truth: read("--truth"), touch: read("--touch"), bad: read("--bad"), card: read("--card"),
      object: dark ? [52, 148, 140] : [96, 188, 180], hand: dark ? [168, 150, 138] : [206, 184, 168],
      near: dark ? "#c9fff8" : "#045c55", middling: dark ? "#ffb454" : "#d07a00", far: dark ? "#6d7080" : "#a9a7a2",
    };
  }

  // What another finger would add, 0 to 1, as [r, g, b]: from the object's own colour's grey to blue.
  gain(share) {
    const [low, high] = this.colours().dark ? [[74, 82, 92], [112, 170, 255]] : [[214, 214, 208], [38, 84, 214]];
    return low.map((v, i) => Math.round(v + (high[i] - v) * share));
  }

  // At the next picture, however often it is asked for.
  draw() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => { this.asked = false; this.paint(); });
  }

  // The canvases as large as they are shown, empty, seen from where the eye is; what is drawn with, null where nothing
  // can be.
  begin() {
    const c = this.canvas, labels = this.pen.canvas, ratio = Math.min(2, window.devicePixelRatio || 1);
    const width = Math.round(c.clientWidth * ratio), height = Math.round(c.clientHeight * ratio);
    if (!this.painter || !this.frame || !width || !height) return null;
    for (const one of [c, labels]) if (one.width !== width || one.height !== height) { one.width = width; one.height = height; }
    this.pen.clearRect(0, 0, width, height);
    this.painter.begin(this.turn, this.scale, this.eye);
    return { tint: this.colours(), brush: this.painter, nudge: Math.max(1.5, 0.015 * this.diameter), ratio };
  }

  paint() {
    const drawn = this.begin();
    if (!drawn) return;
    const { tint, brush, nudge, ratio } = drawn;
    const object = this.shown.after && this.frame.poses.after && this.object(tint);
    if (object) brush.solid(object);
    if (this.shown.cloud && this.cloud) brush.dots(this.dots(tint, ratio), { nudge });  // on the surface that they agree with
    if (this.shown.hand && this.hand) {
      // one layer of glass: the foremost surface, where no part of the object is before it
      const hand = this.solid("hand", tint.dark, this.hand, tint.hand);
      brush.depth(hand);
      brush.solid(hand, { alpha: 0.5 });
    }
    // only the object hides what follows; it is seen through faintly
    brush.forget();
    if (object) brush.depth(object);
    for (const name of ["before", "truth"]) {
      if (this.shown[name] && this.frame.poses[name]) this.wires(name, rgb(tint[name]), name === "before" ? [6, 5] : [2, 4], ratio, nudge);
    }
    if (this.shown.contacts) this.touches(tint, ratio, nudge);
    if (this.shown.next) this.rings(this.frame.next, tint.touch, ratio, nudge);
    if (this.shown.grasp && this.gains) this.rings(this.frame.grasp.places, tint.truth, ratio, nudge);
    this.ruler(tint, ratio);
  }

  solid(name, key, mesh, colour) {
    return this.kept(name, key, () => {
      const { points, normals } = mesh.corners(), tint = new Float32Array(points.length);
      for (let i = 0; i < tint.length; i++) tint[i] = colour[i % 3] / 255;
      return { at: [points, 3], normal: [normals, 3], tint: [tint, 3] };
    });
  }

  // The object at the estimate, coloured by what another finger would add when that is asked for.
  object(tint) {
    const map = Boolean(this.shown.grasp && this.gains);
    return this.kept("object", `${tint.dark} ${map}`, () => {
      const { points, normals } = this.mesh.corners(), pose = this.frame.poses.after, faces = this.mesh.faces;
      const colours = new Float32Array(points.length);
      for (let t = 0; t < faces.length; t += 3) {
        const colour = map ? this.shade(faces, t, tint) : tint.object;
        for (let k = 0; k < 9; k++) colours[3 * t + k] = colour[k % 3] / 255;
      }
      return { at: [placed(points, pose), 3], normal: [placed(normals, pose, true), 3], tint: [colours, 3] };
    });
  }

  // The mean of a triangle's corners on the finger map; the object's own colour, darker, where no finger can be.
  shade(faces, t, tint) {
    const corners = [this.gains[faces[t]], this.gains[faces[t + 1]], this.gains[faces[t + 2]]];
    return corners.includes(255) ? tint.object.map((v) => 0.55 * v) : this.gain((corners[0] + corners[1] + corners[2]) / 762);
  }

  dots(tint, ratio) {
    const size = 1.9 * ratio * Math.min(2.2, Math.sqrt(this.zoom));
    return this.kept("cloud", `${tint.dark} ${size}`, () => {
      const near = rgb(tint.near), middling = rgb(tint.middling), far = rgb(tint.far), colours = [], count = this.cloud.away.length;
      for (const away of this.cloud.away) colours.push(...(away <= 20 ? near : away <= 60 ? middling : far), away <= 60 ? 0.95 : 0.5);
      return { at: [this.cloud.points, 3], tint: [colours, 4], size: [new Float32Array(count).fill(size), 1] };
    });
  }

  // What a pose's object would show of its edges, dashed.
  wires(name, colour, dash, ratio, nudge) {
    const mesh = this.mesh, f = mesh.faces;
    const points = this.posed && this.posed[0] === this.frame && this.posed[1][name] || placed(mesh.points, this.frame.poses[name]);
    if (!this.posed || this.posed[0] !== this.frame) this.posed = [this.frame, {}];
    this.posed[1][name] = points;
    const p = this.project(points);
    const front = (t) => {
      const a = 3 * f[3 * t], b = 3 * f[3 * t + 1], c = 3 * f[3 * t + 2];
      return (p[b] - p[a]) * (p[c + 1] - p[a + 1]) - (p[b + 1] - p[a + 1]) * (p[c] - p[a]) < 0;
    };
    const list = [];
    for (const line of mesh.chains(front)) {
      let run = 0;
      for (let k = 1; k < line.length; k++) {
        const a = 3 * line[k - 1], b = 3 * line[k], long = Math.hypot(p[b] - p[a], p[b + 1] - p[a + 1]);
        list.push([points.subarray(a, a + 3), points.subarray(b, b + 3), colour, [run, run + long]]);
        run += long;
      }
    }
    this.strokes(list, { width: 1.6 * ratio, dash: dash.map((x) => x * ratio), nudge });
  }

  // Lines [from, to, colour, [length before, length after]].
  strokes(list, uniforms) {
    if (!list.length) return;
    const part = (k) => list.flatMap((one) => [...one[k]]), brush = this.painter;
    const kept = brush.load({ at: [part(0), 3], to: [part(1), 3], tint: [part(2), 3], run: [part(3), 2] });
    brush.throughout((alpha) => brush.lines(kept, { ...uniforms, alpha }));
    brush.free(kept);
  }

  // Marks [place, colour, diameter in pixels].
  marks(list, uniforms) {
    if (!list.length) return;
    const brush = this.painter;
    const kept = brush.load({ at: [list.flatMap((m) => m[0]), 3], tint: [list.flatMap((m) => [...m[1], 1]), 4], size: [list.map((m) => m[2]), 1] });
    brush.throughout((alpha) => brush.dots(kept, { ...uniforms, alpha }));
    brush.free(kept);
  }

  touches(tint, ratio, nudge) {
    const reach = 0.12 * this.diameter, sticks = [], discs = [], rings = [];
    this.frame.contacts.forEach((contact, i) => {
      if (!contact.p) return;
      const colour = rgb(contact.outlier ? tint.bad : tint.touch), [x, y, z] = contact.p, n = contact.n;
      if (n) sticks.push([contact.p, [x + reach * n[0], y + reach * n[1], z + reach * n[2]], colour, [0, 1]]);
      (contact.outlier ? rings : discs).push([contact.p, colour, (i === this.lit ? 17 : 12) * ratio]);
      if (i === this.lit) this.write(contact.sensor, contact.p, tint.ink, [11, 4], ratio);
    });
    // within the fingertip's own thickness of the surface a touch counts as before it
    this.strokes(sticks, { width: 2.2 * ratio, nudge: 2 * nudge });
    this.marks(discs, { round: 1, rim: rgb(tint.card), nudge: 2 * nudge });
    this.marks(rings, { round: 2, nudge: 2 * nudge });
  }

  rings(places, colour, ratio, nudge) {
    const reach = 0.12 * this.diameter, ink = rgb(colour);
    this.strokes(places.map(({ p: [x, y, z], n }) => [[x, y, z], [x + reach * n[0], y + reach * n[1], z + reach * n[2]], ink, [0, 30 * ratio]]), { width: 2 * ratio, dash: [3 * ratio, 3 * ratio], nudge: 2 * nudge });
    this.marks(places.map((place) => [place.p, ink, 16 * ratio]), { round: 2, nudge: 2 * nudge });
    places.forEach((place, i) => this.write(String(i + 1), place.p, colour, [10, -6], ratio));
  }

  // Words beside a place; off: pixels right and down.
  write(text, place, colour, off, ratio) {
    const p = this.project(place), pen = this.pen;
    pen.font = `${12 * ratio}px system-ui, sans-serif`;
    pen.fillStyle = colour;
    pen.fillText(text, p[0] + off[0] * ratio, p[1] + off[1] * ratio);
  }

  ruler(tint, ratio) {
    const pen = this.pen, px = this.scale;
    const length = [1, 2, 5, 10, 20, 50, 100, 200, 500].find((mm) => mm * px > 56 * ratio) || 500;
    const x = 16 * ratio, y = this.canvas.height - 16 * ratio;
    pen.globalAlpha = 0.6;
    pen.strokeStyle = pen.fillStyle = tint.ink;
    pen.lineWidth = 1.5 * ratio;
    pen.beginPath();
    pen.moveTo(x, y - 4 * ratio); pen.lineTo(x, y); pen.lineTo(x + length * px, y); pen.lineTo(x + length * px, y - 4 * ratio);
    pen.stroke();
    pen.font = `${11.5 * ratio}px system-ui, sans-serif`;
    pen.fillText(length >= 10 && length % 10 === 0 ? `${length / 10} cm` : `${length} mm`, x + 5 * ratio, y - 6 * ratio);
    pen.globalAlpha = 1;
  }
}

// "#rrggbb" as three shares.
function rgb(text) {
  return [1, 3, 5].map((i) => parseInt(text.slice(i, i + 2), 16) / 255);
}
