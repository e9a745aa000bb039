"use strict";
// A small 3-D view on a 2-D canvas: shaded triangles and points, sorted back to front. No WebGL, so it works
// everywhere. Camera axes (x right, y down, z away), millimetres, relative to the object.

function unpack(text, kind) {
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return new kind(bytes.buffer);
}

function millimetres(text) {
  return Float32Array.from(unpack(text, Int16Array), (tenths) => tenths / 10);
}

function placed(points, pose) {
  const out = new Float32Array(points.length);
  for (let i = 0; i < points.length; i += 3) {
    const x = points[i], y = points[i + 1], z = points[i + 2];
    out[i] = pose[0] * x + pose[1] * y + pose[2] * z + pose[3];
    out[i + 1] = pose[4] * x + pose[5] * y + pose[6] * z + pose[7];
    out[i + 2] = pose[8] * x + pose[9] * y + pose[10] * z + pose[11];
  }
  return out;
}

class Mesh {
  constructor(points, faces) {
    this.points = points;
    this.faces = faces;
  }

  // Every edge with the two triangles that share it: silhouettes and creases are drawn from these.
  edges() {
    if (this.edgeList) return this.edgeList;
    const open = new Map(), list = [], f = this.faces, count = this.points.length / 3;
    for (let t = 0; t < f.length; t += 3) {
      for (let k = 0; k < 3; k++) {
        const a = f[t + k], b = f[t + (k + 1) % 3], key = Math.min(a, b) * count + Math.max(a, b);
        if (open.has(key)) { list.push([a, b, open.get(key), t / 3]); open.delete(key); } else open.set(key, t / 3);
      }
    }
    const n = this.normals(this.points);
    const sharp = (s, t) => n[3 * s] * n[3 * t] + n[3 * s + 1] * n[3 * t + 1] + n[3 * s + 2] * n[3 * t + 2] < 0.72;
    this.edgeList = list.map(([a, b, s, t]) => ({ a, b, s, t, crease: sharp(s, t) }));
    return this.edgeList;
  }

  normals(p) {
    const f = this.faces, out = new Float32Array(f.length);
    for (let t = 0; t < f.length; t += 3) {
      const a = 3 * f[t], b = 3 * f[t + 1], c = 3 * f[t + 2];
      const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
      const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
      const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx, l = Math.hypot(x, y, z) || 1;
      out[t] = x / l; out[t + 1] = y / l; out[t + 2] = z / l;
    }
    return out;
  }
}

class Scene {
  constructor(canvas, mesh, diameter) {
    this.canvas = canvas;
    this.pen = canvas.getContext("2d");
    this.layer = document.createElement("canvas");
    this.mesh = mesh;
    this.diameter = diameter;
    this.shown = {};
    this.lit = -1;
    this.zoom = 1;
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
    this.draw();
  }

  // Screen x, y (device pixels) and depth (mm, larger is farther) of points.
  project(points) {
    const out = new Float32Array(points.length);
    const cy = Math.cos(this.yaw), sy = Math.sin(this.yaw), cp = Math.cos(this.pitch), sp = Math.sin(this.pitch);
    const far = 4 * this.diameter, w = this.canvas.width / 2, h = this.canvas.height / 2;
    const scale = this.zoom * 1.42 * Math.min(w, h) / this.diameter;
    for (let i = 0; i < points.length; i += 3) {
      const x = cy * points[i] - sy * points[i + 2], z = sy * points[i] + cy * points[i + 2];
      const y = cp * points[i + 1] - sp * z, deep = sp * points[i + 1] + cp * z;
      const near = far / Math.max(0.1 * far, far + deep);
      out[i] = w + x * scale * near;
      out[i + 1] = h + y * scale * near;
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

  draw() {
    const c = this.canvas, ratio = Math.min(2, window.devicePixelRatio || 1);
    const width = Math.round(c.clientWidth * ratio), height = Math.round(c.clientHeight * ratio);
    if (!this.frame || !width || !height) return;
    if (c.width !== width || c.height !== height) { c.width = width; c.height = height; }
    if (this.layer.width !== width || this.layer.height !== height) { this.layer.width = width; this.layer.height = height; }
    const pen = this.pen, tint = this.colours(), poses = this.frame.poses;
    pen.clearRect(0, 0, width, height);
    const hand = this.shown.hand && this.hand;
    if (hand) this.glass(hand, tint, 1, 0.6);
    this.solids(pen, tint, ratio);
    if (hand) this.glass(hand, tint, -1, 0.34);
    for (const name of ["before", "truth"]) {
      if (this.shown[name] && poses[name]) this.wires(pen, poses[name], tint[name], name === "before" ? [6, 5] : [1.5, 4], ratio);
    }
    if (this.shown.contacts) this.touches(pen, tint, ratio);
    if (this.shown.next) this.rings(pen, this.frame.next, tint, ratio);
    if (this.shown.grasp && this.gains) this.rings(pen, this.frame.grasp.places, { touch: tint.truth }, ratio);
    this.ruler(pen, tint, ratio);
  }

  solids(pen, tint, ratio) {
    const jobs = [], depths = [], poses = this.frame.poses;
    let seen, normals, faces = [];
    if (this.shown.after && poses.after) {
      seen = this.project(placed(this.mesh.points, poses.after));
      faces = this.mesh.faces;
      normals = this.mesh.normals(this.unscaled(placed(this.mesh.points, poses.after)));
      for (let t = 0; t < faces.length; t += 3) {
        const a = 3 * faces[t], b = 3 * faces[t + 1], c = 3 * faces[t + 2];
        // z points away: an outward triangle that faces the viewer has a negative turn on the screen
        if ((seen[b] - seen[a]) * (seen[c + 1] - seen[a + 1]) - (seen[b + 1] - seen[a + 1]) * (seen[c] - seen[a]) >= 0) continue;
        jobs.push(t);
        depths.push((seen[a + 2] + seen[b + 2] + seen[c + 2]) / 3);
      }
    }
    const dots = this.shown.cloud && this.cloud && this.project(this.cloud.points);
    if (dots) for (let i = 0; i < dots.length; i += 3) {
      jobs.push(-1 - i / 3);
      // points sit on the surface that they agree with: nudged forward, or every other one drowns in it
      depths.push(dots[i + 2] - Math.max(1.5, 0.015 * this.diameter));
    }
    const order = Uint32Array.from(jobs.keys()).sort((p, q) => depths[q] - depths[p]);
    const size = 1.7 * ratio * Math.min(2.2, Math.sqrt(this.zoom));
    for (const k of order) {
      const job = jobs[k];
      if (job >= 0) this.triangle(pen, seen, faces, job, this.shown.grasp && this.gains ? this.shade(faces, job, tint) : tint.object, normals);
      else {
        const away = this.cloud.away[-1 - job], i = 3 * (-1 - job);
        pen.fillStyle = away <= 20 ? tint.near : away <= 60 ? tint.middling : tint.far;
        pen.globalAlpha = away <= 60 ? 0.95 : 0.5;
        pen.fillRect(dots[i] - size / 2, dots[i + 1] - size / 2, size, size);
        pen.globalAlpha = 1;
      }
    }
  }

  // The mean of a triangle's corners on the finger map; the object's own colour where no finger can be.
  shade(faces, t, tint) {
    const corners = [this.gains[faces[t]], this.gains[faces[t + 1]], this.gains[faces[t + 2]]];
    return corners.includes(255) ? tint.object.map((v) => Math.round(0.55 * v)) : this.gain((corners[0] + corners[1] + corners[2]) / 762);
  }

  // Points turned into the view, without perspective: what shading needs.
  unscaled(points) {
    const out = new Float32Array(points.length);
    const cy = Math.cos(this.yaw), sy = Math.sin(this.yaw), cp = Math.cos(this.pitch), sp = Math.sin(this.pitch);
    for (let i = 0; i < points.length; i += 3) {
      const z = sy * points[i] + cy * points[i + 2];
      out[i] = cy * points[i] - sy * points[i + 2];
      out[i + 1] = cp * points[i + 1] - sp * z;
      out[i + 2] = sp * points[i + 1] + cp * z;
    }
    return out;
  }

  triangle(pen, p, faces, t, base, normals) {
    const a = 3 * faces[t], b = 3 * faces[t + 1], c = 3 * faces[t + 2];
    const lit = 0.52 + 0.5 * Math.max(0, -0.35 * normals[t] - 0.62 * normals[t + 1] - 0.7 * normals[t + 2]);
    const colour = `rgb(${base.map((v) => Math.round(Math.min(255, v * lit))).join(",")})`;
    pen.fillStyle = pen.strokeStyle = colour;
    pen.lineWidth = 1;
    pen.beginPath();
    pen.moveTo(p[a], p[a + 1]);
    pen.lineTo(p[b], p[b + 1]);
    pen.lineTo(p[c], p[c + 1]);
    pen.closePath();
    pen.fill();
    pen.stroke();  // hides the seams between neighbours
  }

  // The part of the hand behind (side 1) or before (side -1) the object's middle, as one translucent layer.
  glass(mesh, tint, side, alpha) {
    const pen = this.layer.getContext("2d"), p = this.project(mesh.points), normals = mesh.normals(this.unscaled(mesh.points));
    pen.clearRect(0, 0, this.layer.width, this.layer.height);
    const jobs = [], depths = [];
    for (let t = 0; t < mesh.faces.length; t += 3) {
      const deep = (p[3 * mesh.faces[t] + 2] + p[3 * mesh.faces[t + 1] + 2] + p[3 * mesh.faces[t + 2] + 2]) / 3;
      if (deep * side < 0 || normals[t + 2] > 0.25) continue;
      jobs.push(t);
      depths.push(deep);
    }
    for (const k of Uint32Array.from(jobs.keys()).sort((i, j) => depths[j] - depths[i])) this.triangle(pen, p, mesh.faces, jobs[k], tint.hand, normals);
    this.pen.globalAlpha = alpha;
    this.pen.drawImage(this.layer, 0, 0);
    this.pen.globalAlpha = 1;
  }

  wires(pen, pose, colour, dash, ratio) {
    const points = placed(this.mesh.points, pose), p = this.project(points), f = this.mesh.faces;
    const front = (t) => {
      const a = 3 * f[3 * t], b = 3 * f[3 * t + 1], c = 3 * f[3 * t + 2];
      return (p[b] - p[a]) * (p[c + 1] - p[a + 1]) - (p[b + 1] - p[a + 1]) * (p[c] - p[a]) < 0;
    };
    pen.strokeStyle = colour;
    pen.lineWidth = 1.5 * ratio;
    pen.setLineDash(dash.map((x) => x * ratio));
    pen.beginPath();
    for (const line of this.chains(front)) {
      pen.moveTo(p[3 * line[0]], p[3 * line[0] + 1]);
      for (const v of line.slice(1)) pen.lineTo(p[3 * v], p[3 * v + 1]);
    }
    pen.stroke();
    pen.setLineDash([]);
  }

  // Visible silhouette edges and creases, joined into long lines so that dashes stay dashes.
  chains(front) {
    const next = new Map();
    const join = (a, b) => { if (!next.has(a)) next.set(a, []); next.get(a).push(b); };
    for (const e of this.mesh.edges()) {
      const s = front(e.s), t = front(e.t);
      if (s !== t || (e.crease && s && t)) { join(e.a, e.b); join(e.b, e.a); }
    }
    const lines = [];
    for (const start of next.keys()) {
      while (next.get(start).length) {
        const line = [start];
        let here = start;
        while (next.get(here).length) {
          const there = next.get(here).pop(), back = next.get(there);
          back.splice(back.indexOf(here), 1);
          line.push(there);
          here = there;
        }
        lines.push(line);
      }
    }
    return lines;
  }

  touches(pen, tint, ratio) {
    this.frame.contacts.forEach((contact, i) => {
      if (!contact.p) return;
      const n = contact.n || [0, 0, 0], reach = 0.12 * this.diameter;
      const p = this.project([...contact.p, contact.p[0] + reach * n[0], contact.p[1] + reach * n[1], contact.p[2] + reach * n[2]]);
      pen.strokeStyle = pen.fillStyle = contact.outlier ? tint.bad : tint.touch;
      pen.lineWidth = 2 * ratio;
      if (contact.n) { pen.beginPath(); pen.moveTo(p[0], p[1]); pen.lineTo(p[3], p[4]); pen.stroke(); }
      pen.beginPath();
      pen.arc(p[0], p[1], (i === this.lit ? 7 : 4.6) * ratio, 0, 7);
      if (contact.outlier) pen.stroke(); else pen.fill();
      pen.strokeStyle = tint.card;
      pen.lineWidth = 1.4 * ratio;
      if (!contact.outlier) pen.stroke();
      if (i === this.lit) {
        pen.font = `${12 * ratio}px system-ui, sans-serif`;
        pen.fillStyle = tint.ink;
        pen.fillText(contact.sensor, p[0] + 11 * ratio, p[1] + 4 * ratio);
      }
    });
  }

  rings(pen, places, tint, ratio) {
    pen.font = `${11 * ratio}px system-ui, sans-serif`;
    pen.lineWidth = 2 * ratio;
    places.forEach((touch, i) => {
      const reach = 0.12 * this.diameter, [x, y, z] = touch.p, n = touch.n;
      const p = this.project([x, y, z, x + reach * n[0], y + reach * n[1], z + reach * n[2]]);
      pen.strokeStyle = pen.fillStyle = tint.touch;
      pen.setLineDash([3 * ratio, 3 * ratio]);
      pen.beginPath(); pen.moveTo(p[0], p[1]); pen.lineTo(p[3], p[4]); pen.stroke();
      pen.beginPath(); pen.arc(p[0], p[1], 7 * ratio, 0, 7); pen.stroke();
      pen.setLineDash([]);
      pen.fillText(String(i + 1), p[0] + 10 * ratio, p[1] - 6 * ratio);
    });
  }

  ruler(pen, tint, ratio) {
    const one = this.project([-0.5, 0, 0, 0.5, 0, 0]), face = Math.abs(Math.cos(this.yaw)) > 0.3 ? Math.abs((one[3] - one[0]) / Math.cos(this.yaw)) : 0;
    const px = face || this.zoom * 1.42 * Math.min(this.canvas.width, this.canvas.height) / 2 / this.diameter;
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
