"use strict";
// What the 3-D view draws with: WebGL 2 and its depth buffer, so that what enters or hides something does so at every
// pixel. Lit triangles, dots, and lines of a width with dashes.

const EYE = `#version 300 es
precision highp float;
uniform mat3 turn;    // from camera axes to the view's (x right, y down, z away)
uniform vec4 lens;    // x and y to the clip volume, distance of the eye (mm), nearest depth (mm)
uniform float nudge;  // mm towards the viewer, in the depth test alone
vec4 seen(vec3 at) {
  vec3 p = turn * at;
  float w = p.z + lens.z, n = lens.w, f = 12.0 * lens.z;
  return vec4(lens.x * p.x, -lens.y * p.y, ((f + n) - 2.0 * f * n / max(w - nudge, 0.5 * n)) / (f - n) * w, w);
}`;

const SOURCES = {
  solid: [`${EYE}
in vec3 at, normal, tint;
out vec3 facing, sight, colour;
void main() {
  gl_Position = seen(at);
  facing = turn * normal;
  sight = turn * at + vec3(0.0, 0.0, lens.z);
  colour = tint;
}`, `#version 300 es
precision highp float;
uniform float alpha;
in vec3 facing, sight, colour;
out vec4 ink;
void main() {
  vec3 n = normalize(facing + 1e-9);
  if (dot(n, sight) > 0.0) n = -n;
  float lit = 0.52 + 0.5 * max(0.0, dot(n, vec3(-0.35, -0.62, -0.7)));
  ink = vec4(min(colour * lit, 1.0) * alpha, alpha);
}`],
  dots: [`${EYE}
in vec3 at; in vec4 tint; in float size;
out vec4 colour; out float wide;
void main() { gl_Position = seen(at); gl_PointSize = wide = size; colour = tint; }`, `#version 300 es
precision highp float;
uniform float alpha, round;  // round: 0 a square, 1 a disc with a rim, 2 a ring
uniform vec3 rim;
in vec4 colour; in float wide;
out vec4 ink;
void main() {
  float away = length(gl_PointCoord - 0.5) * wide, edge = 0.5 * wide - 1.0, band = max(1.5, 0.16 * wide);
  float inside = round > 0.5 ? clamp(edge - away + 0.5, 0.0, 1.0) : 1.0;
  if (round > 1.5) inside *= clamp(away - edge + band + 0.5, 0.0, 1.0);
  vec3 shade = round > 0.5 && round < 1.5 ? mix(rim, colour.rgb, clamp(edge - band - away + 0.5, 0.0, 1.0)) : colour.rgb;
  float a = inside * colour.a * alpha;
  if (a < 0.01) discard;
  ink = vec4(shade * a, a);
}`],
  lines: [`${EYE}
uniform vec2 half_size;  // of the canvas, pixels
uniform float width;
in vec2 corner; in vec3 at, to, tint; in vec2 run;
out vec3 colour; out float along;
void main() {
  vec4 a = seen(at), b = seen(to), p = corner.x < 0.5 ? a : b;
  vec2 way = (b.xy / b.w - a.xy / a.w) * half_size;
  way /= max(length(way), 1e-6);
  p.xy += vec2(-way.y, way.x) * corner.y * 0.5 * width / half_size * p.w;
  gl_Position = p;
  colour = tint;
  along = mix(run.x, run.y, corner.x);
}`, `#version 300 es
precision highp float;
uniform float alpha;
uniform vec2 dash;  // pixels drawn and left out; 0 left out is a whole line
in vec3 colour; in float along;
out vec4 ink;
void main() {
  if (dash.y > 0.0 && mod(along, dash.x + dash.y) > dash.x) discard;
  ink = vec4(colour * alpha, alpha);
}`],
};

// Raises when the browser has no WebGL 2.
class Painter {
  constructor(canvas) {
    this.gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
    if (!this.gl) throw new Error("no WebGL 2");
    this.canvas = canvas;
    this.start();
  }

  // Also after the graphics card was lost and came back.
  start() {
    const gl = this.gl;
    this.programs = {};
    for (const [name, [vertex, fragment]] of Object.entries(SOURCES)) {
      const program = gl.createProgram();
      for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
        const shader = gl.createShader(kind);
        gl.shaderSource(shader, text);
        gl.compileShader(shader);
        gl.attachShader(program, shader);
      }
      gl.linkProgram(program);
      if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(`no WebGL 2: ${name}: ${gl.getProgramInfoLog(program)}`);
      this.programs[name] = { program, places: new Map() };
    }
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  // turn: 3x3, row by row; scale: pixels a millimetre at the object; eye: its distance, mm.
  begin(turn, scale, eye) {
    const gl = this.gl, w = this.canvas.width, h = this.canvas.height;
    gl.viewport(0, 0, w, h);
    gl.colorMask(true, true, true, true);
    gl.depthMask(true);
    gl.depthFunc(gl.LEQUAL);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.eye = { turn: [0, 3, 6, 1, 4, 7, 2, 5, 8].map((i) => turn[i]), lens: [2 * scale * eye / w, 2 * scale * eye / h, eye, 0.1 * eye] };
  }

  // Numbers on the card. data: by name, [array, numbers a vertex]; keep what is returned and free it.
  load(data) {
    const gl = this.gl, kept = { parts: {}, count: Infinity };
    for (const [name, [array, wide]] of Object.entries(data)) {
      const buffer = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, array instanceof Float32Array ? array : new Float32Array(array), gl.DYNAMIC_DRAW);
      kept.parts[name] = { buffer, wide };
      kept.count = Math.min(kept.count, array.length / wide);
    }
    return kept;
  }

  free(kept) {
    if (kept) for (const part of Object.values(kept.parts)) this.gl.deleteBuffer(part.buffer);
  }

  use(name, uniforms) {
    const gl = this.gl, { program, places } = this.programs[name];
    gl.useProgram(program);
    const put = (key, value) => {
      if (!places.has(key)) places.set(key, gl.getUniformLocation(program, key));
      const at = places.get(key);
      if (key === "turn") gl.uniformMatrix3fv(at, false, value);
      else if (Array.isArray(value)) gl[`uniform${value.length}fv`](at, value);
      else gl.uniform1f(at, value);
    };
    const all = { ...this.eye, nudge: 0, alpha: 1, ...uniforms };
    for (const [key, value] of Object.entries(all)) put(key, value);
    // what covers in part leaves what is behind
    if (all.alpha < 1 || name === "dots") gl.enable(gl.BLEND); else gl.disable(gl.BLEND);
    return program;
  }

  bind(program, kept, each) {
    const gl = this.gl;
    for (let at = 0; at < 8; at++) gl.disableVertexAttribArray(at);  // what another program had may be gone
    for (const [name, { buffer, wide }] of Object.entries(kept.parts)) {
      const at = gl.getAttribLocation(program, name);
      if (at < 0) continue;
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, wide, gl.FLOAT, false, 0, 0);
      gl.vertexAttribDivisor(at, each && name !== "corner" ? 1 : 0);
    }
  }

  solid(kept, uniforms = {}) {
    this.bind(this.use("solid", uniforms), kept);
    this.gl.drawArrays(this.gl.TRIANGLES, 0, kept.count);
  }

  // Depth alone: what is drawn next is hidden behind it.
  depth(kept) {
    this.gl.colorMask(false, false, false, false);
    this.solid(kept);
    this.gl.colorMask(true, true, true, true);
  }

  // Nothing drawn so far hides what is drawn next.
  forget() {
    this.gl.clear(this.gl.DEPTH_BUFFER_BIT);
  }

  dots(kept, uniforms) {
    this.bind(this.use("dots", { round: 0, rim: [1, 1, 1], ...uniforms }), kept);
    this.gl.drawArrays(this.gl.POINTS, 0, kept.count);
  }

  lines(kept, uniforms) {
    const program = this.use("lines", { half_size: [this.canvas.width / 2, this.canvas.height / 2], dash: [1, 0], ...uniforms });
    const corner = this.load({ corner: [[0, -1, 0, 1, 1, -1, 1, 1], 2] });
    this.bind(program, { parts: { ...kept.parts, ...corner.parts } }, true);
    this.gl.drawArraysInstanced(this.gl.TRIANGLE_STRIP, 0, 4, kept.count);
    this.free(corner);
  }

  // Twice: whole where it is before everything, faint where something is before it. Writes no depth.
  throughout(draw) {
    const gl = this.gl;
    gl.depthMask(false);
    gl.depthFunc(gl.GREATER);
    draw(0.3);
    gl.depthFunc(gl.LEQUAL);
    draw(1);
    gl.depthMask(true);
  }
}
