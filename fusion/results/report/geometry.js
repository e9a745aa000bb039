"use strict";
// Geometry of the 3-D view. Camera axes (x right, y down, z away), millimetres, relative to the object.

function unpack(text, kind) {
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return new kind(bytes.buffer);
}

function millimetres(text) {
  return Float32Array.from(unpack(text, Int16Array), (tenths) => tenths / 10);
}

// Points by a row-major 3x4 pose; without its translation for directions.
function placed(points, pose, directions) {
  const out = new Float32Array(points.length), [tx, ty, tz] = directions ? [0, 0, 0] : [pose[3], pose[7], pose[11]];
  for (let i = 0; i < points.length; i += 3) {
    const x = points[i], y = points[i + 1], z = points[i + 2];
    out[i] = pose[0] * x + pose[1] * y + pose[2] * z + tx;
    out[i + 1] = pose[4] * x + pose[5] * y + pose[6] * z + ty;
    out[i + 2] = pose[8] * x + pose[9] * y + pose[10] * z + tz;
  }
  return out;
}

// Cosine of the angle between two triangles beyond which their edge is a crease, drawn and shaded as one.
const CREASE = 0.72;

class Mesh {
  constructor(points, faces) {
    this.points = points;
    this.faces = faces;
  }

  // Unit normals of the triangles.
  normals() {
    if (this.normalList) return this.normalList;
    const f = this.faces, p = this.points, out = new Float32Array(f.length);
    for (let t = 0; t < f.length; t += 3) {
      const a = 3 * f[t], b = 3 * f[t + 1], c = 3 * f[t + 2];
      const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
      const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
      const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx, l = Math.hypot(x, y, z) || 1;
      out[t] = x / l; out[t + 1] = y / l; out[t + 2] = z / l;
    }
    return this.normalList = out;
  }

  // Every triangle's corners one after the other, each with the mean normal of the triangles that meet there without a
  // crease: what a graphics card draws as round where it is round.
  corners() {
    if (this.cornerList) return this.cornerList;
    const f = this.faces, n = this.normals(), around = new Map();
    for (let k = 0; k < f.length; k++) {
      if (!around.has(f[k])) around.set(f[k], []);
      around.get(f[k]).push(k - k % 3);
    }
    const points = new Float32Array(3 * f.length), normals = new Float32Array(3 * f.length);
    for (let k = 0; k < f.length; k++) {
      const own = k - k % 3;
      for (let i = 0; i < 3; i++) points[3 * k + i] = this.points[3 * f[k] + i];
      for (const t of around.get(f[k])) {
        if (n[own] * n[t] + n[own + 1] * n[t + 1] + n[own + 2] * n[t + 2] < CREASE) continue;
        for (let i = 0; i < 3; i++) normals[3 * k + i] += n[t + i];
      }
    }
    return this.cornerList = { points, normals };
  }

  // Every edge with the two triangles that share it: silhouettes and creases are drawn from these.
  edges() {
    if (this.edgeList) return this.edgeList;
    const open = new Map(), list = [], f = this.faces, count = this.points.length / 3, n = this.normals();
    for (let t = 0; t < f.length; t += 3) {
      for (let k = 0; k < 3; k++) {
        const a = f[t + k], b = f[t + (k + 1) % 3], key = Math.min(a, b) * count + Math.max(a, b);
        if (open.has(key)) { list.push([a, b, open.get(key), t / 3]); open.delete(key); } else open.set(key, t / 3);
      }
    }
    const sharp = (s, t) => n[3 * s] * n[3 * t] + n[3 * s + 1] * n[3 * t + 1] + n[3 * s + 2] * n[3 * t + 2] < CREASE;
    return this.edgeList = list.map(([a, b, s, t]) => ({ a, b, s, t, crease: sharp(s, t) }));
  }

  // Silhouette edges and creases of what front(triangle) calls turned to the viewer, joined into long lines of vertex
  // numbers so that dashes stay dashes.
  chains(front) {
    const next = new Map();
    const join = (a, b) => { if (!next.has(a)) next.set(a, []); next.get(a).push(b); };
    for (const e of this.edges()) {
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
}
