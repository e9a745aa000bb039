"use strict";
// The 3-D view of a track: the object where it is in a frame, the way of its middle, other poses that are still open,
// and the palm. Millimetres, in the camera's axes or in the hand's, about the middle of the way.

class TrackScene extends Scene {
  // mesh: about the object's middle; way: three lists of the middle's place, a row each, null where unknown.
  along(way, diameter) {
    const known = way[0].flatMap((x, i) => (x === null ? [] : [[x, way[1][i], way[2][i]]]));
    if (!known.length) known.push([0, 0, 0]);
    const low = [0, 1, 2].map((k) => Math.min(...known.map((p) => p[k]))), high = [0, 1, 2].map((k) => Math.max(...known.map((p) => p[k])));
    this.way = way;
    this.middle = low.map((v, k) => (v + high[k]) / 2);
    this.diameter = diameter + Math.hypot(...high.map((v, k) => v - low[k]));
  }

  // Where the object's middle is in a row, about the middle of the way; null where unknown.
  place(row) {
    return this.way[0][row] === null ? null : this.way.map((axis, k) => axis[row] - this.middle[k]);
  }

  // turn: (9) of the object; others: [weight, turn, shift of the middle] of open poses; palm: [turn, shift] or null.
  at(row, turn, others, palm) {
    const here = this.place(row);
    const posed = (rotation, shift) => [0, 1, 2].flatMap((k) => [...rotation.slice(3 * k, 3 * k + 3), here[k] + shift[k]]);
    const poses = here && turn ? { after: posed(turn, [0, 0, 0]) } : {};
    if (poses.after) others.forEach(([, rotation, shift], k) => { poses[`other${k}`] = posed(rotation, shift); });
    this.row = row;
    this.palm = palm && here && { turn: palm[0], place: palm[1].map((v, k) => here[k] + v) };
    this.show({ poses, others: others.length });
  }

  paint() {
    const drawn = this.begin();
    if (!drawn) return;
    const { tint, brush, nudge, ratio } = drawn, poses = this.frame.poses;
    if (poses.after) {
      const object = this.object(tint);
      brush.solid(object);
      brush.forget();
      brush.depth(object);
    }
    for (const name of Object.keys(poses)) if (name !== "after") this.wires(name, rgb(tint.before), [6, 5], ratio, nudge);
    this.drawWay(tint, ratio, nudge);
    if (this.palm) this.drawPalm(tint, ratio, nudge);
    this.ruler(tint, ratio);
  }

  // Whole up to this row, dashed after it.
  drawWay(tint, ratio, nudge) {
    const ink = rgb(tint.truth), parts = [[], []];
    let last = null;
    for (let i = 0; i < this.way[0].length; i++) {
      const here = this.place(i);
      if (here && last) parts[i <= this.row ? 0 : 1].push([last, here, ink, [0, 1]]);
      last = here;
    }
    this.strokes(parts[0], { width: 2.4 * ratio, nudge });
    this.strokes(parts[1], { width: 1 * ratio, nudge });
  }

  drawPalm(tint, ratio, nudge) {
    const { turn, place } = this.palm, reach = 0.12 * this.diameter;
    const axes = [tint.bad, tint.touch, tint.truth].map((colour, k) => [place, place.map((v, i) => v + reach * turn[3 * i + k]), rgb(colour), [0, 1]]);
    this.strokes(axes, { width: 2.4 * ratio, nudge });
    this.write("palm", place, tint.ink, [8, 14], ratio);
  }
}
