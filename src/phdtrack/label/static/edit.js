// Boxes are drawn, moved and resized: by dragging, or by arrow keys.

import { boxesOf, placeOf } from "./view.js";

// Screen pixels about an edge in which it is taken hold of; the smallest box that is drawn, in pixels of the picture.
const NEAR = 10;
const SMALLEST = 3;

export class Editor {
  // `change(box, place)` keeps a place; `first` is the smallest number of a drawn box.
  constructor(view, first, { change, choose }) {
    Object.assign(this, { view, first, change, choose, hold: null, nudged: null });
  }

  // Which edges of the chosen box are near a point: [left, top, right, bottom]; all of them inside, nothing elsewhere.
  grip([x, y]) {
    const place = placeOf(this.view.frame, this.view.chosen);
    if (!place) return null;
    const reach = NEAR / this.view.scale;
    const [left, top, right, bottom] = place;
    if (x < left - reach || x > right + reach || y < top - reach || y > bottom + reach) return null;
    // The right and lower edges win, so that a box smaller than the reach can be made larger.
    const [r, b] = [Math.abs(x - right) <= reach, Math.abs(y - bottom) <= reach];
    const edges = [!r && Math.abs(x - left) <= reach, !b && Math.abs(y - top) <= reach, r, b];
    return edges.some(Boolean) ? edges : [true, true, true, true];
  }

  press(at) {
    const grip = this.grip(at);
    const from = grip ? placeOf(this.view.frame, this.view.chosen).slice(0, 4) : [...at, ...at];
    this.hold = { at, from, edges: grip ?? [false, false, true, true], box: grip ? this.view.chosen : -1 };
  }

  drag([x, y]) {
    const { at, from, edges } = this.hold;
    this.view.rubber = this.inside(from.map((value, k) => value + (edges[k] ? (k % 2 ? y - at[1] : x - at[0]) : 0)), edges);
  }

  release(moved) {
    const { at, box } = this.hold;
    const place = this.view.rubber;
    this.hold = this.view.rubber = null;
    if (!moved) this.choose(this.view.under(at).find((k) => this.view.frame.marks[k] !== "false") ?? -1);
    else if (place && place[2] - place[0] >= SMALLEST && place[3] - place[1] >= SMALLEST) this.keep(box, place);
  }

  keep(box, place) {
    // At random: somebody else may draw at the same time.
    const number = box >= 0 ? box : this.first + 1 + Math.floor(Math.random() * (this.first - 1));
    this.change(number, place.map((value) => Math.round(100 * value) / 100));
    this.choose(number);
  }

  // Left before right; what is moved as a whole keeps its size at the border.
  inside([x1, y1, x2, y2], edges) {
    const { width, height } = this.view.size;
    const [dx, dy] = edges.every(Boolean)
      ? [Math.max(0, -x1) + Math.min(0, width - x2), Math.max(0, -y1) + Math.min(0, height - y2)] : [0, 0];
    const held = (value, most) => Math.min(Math.max(value, 0), most);
    const [across, down] = [[x1, x2].map((x) => held(x + dx, width)), [y1, y2].map((y) => held(y + dy, height))];
    return [Math.min(...across), Math.min(...down), Math.max(...across), Math.max(...down)];
  }

  // An arrow key moves the chosen box by a pixel of the picture, with Shift its right and lower edges; `still` keeps it.
  nudge([dx, dy], resize) {
    const { frame, chosen } = this.view;
    if (!placeOf(frame, chosen)) return;
    const [x1, y1, x2, y2] = this.view.rubber ?? placeOf(frame, chosen);
    const moved = resize ? [x1, y1, Math.max(x2 + dx, x1 + SMALLEST), Math.max(y2 + dy, y1 + SMALLEST)] : [x1 + dx, y1 + dy, x2 + dx, y2 + dy];
    this.view.rubber = this.inside(moved, [!resize, !resize, true, true]);
    this.view.draw();
  }

  still() {
    const { rubber, chosen } = this.view;
    if (!rubber || this.hold) return;
    this.view.rubber = null;
    this.keep(chosen, rubber);
  }

  // A new box in the middle of what is seen, of the usual size.
  add() {
    const { frame, size, canvas } = this.view;
    const area = canvas.getBoundingClientRect();
    const [x, y] = this.view.at({ clientX: area.left + area.width / 2, clientY: area.top + area.height / 2 });
    const median = (values) => values.sort((a, b) => a - b)[values.length >> 1];
    const places = boxesOf(frame).map((box) => placeOf(frame, box));
    const [w, h] = places.length ? [0, 1].map((k) => median(places.map((p) => p[k + 2] - p[k])) / 2) : [size.width / 30, size.height / 15];
    this.keep(-1, this.inside([x - w, y - h, x + w, y + h], [true, true, true, true]));
  }
}
