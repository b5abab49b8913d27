// The picture with its boxes on a canvas: where it lies, what is under the cursor, what is drawn.

const COLOUR = { none: "#ffd23e", false: "#ff3b30", birth: "#2fd573", true: "#5ab8ff" };
const LARGEST = 40;

// Where a box is: where a person drew it or moved it to, else where the detector has it.
export const placeOf = (frame, box) => frame.places[box] ?? frame.boxes[box];

// The numbers of all boxes: of the detections, and those that were drawn.
export function boxesOf(frame) {
  const drawn = Object.keys(frame.places).map(Number).filter((box) => !frame.boxes[box]);
  return [...frame.boxes.keys(), ...drawn];
}

export class View {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.frame = null;
    this.picture = null;
    this.hidden = false;
    this.chosen = -1;
    this.lasso = [];
    this.zoom = 1;
    this.pan = [0, 0];
    this.pending = false;
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  show(frame, picture, size) {
    this.frame = frame;
    this.picture = picture;
    this.size = size;
    this.chosen = -1;
    this.lasso = [];
    this.rubber = null;
    this.draw();
  }

  get scale() {
    const { clientWidth, clientHeight } = this.canvas;
    return Math.min(clientWidth / this.size.width, clientHeight / this.size.height) * this.zoom;
  }

  get origin() {
    const { clientWidth, clientHeight } = this.canvas;
    return [
      (clientWidth - this.size.width * this.scale) / 2 + this.pan[0],
      (clientHeight - this.size.height * this.scale) / 2 + this.pan[1],
    ];
  }

  // From the canvas to the picture.
  at(event) {
    const { left, top } = this.canvas.getBoundingClientRect();
    const [x, y] = this.origin;
    return [(event.clientX - left - x) / this.scale, (event.clientY - top - y) / this.scale];
  }

  zoomBy(factor, event) {
    const zoom = Math.min(LARGEST, Math.max(1, this.zoom * factor));
    if (event) {
      const [x, y] = this.at(event);
      const before = [this.origin[0] + x * this.scale, this.origin[1] + y * this.scale];
      this.zoom = zoom;
      this.pan[0] += before[0] - (this.origin[0] + x * this.scale);
      this.pan[1] += before[1] - (this.origin[1] + y * this.scale);
    } else this.zoom = zoom;
    if (zoom === 1) this.pan = [0, 0];
    this.draw();
  }

  // The boxes there, the smallest first: that is the one a click means.
  under([x, y]) {
    const area = ([left, top, right, bottom]) => (right - left) * (bottom - top);
    return boxesOf(this.frame).filter((k) => {
      const [left, top, right, bottom] = placeOf(this.frame, k);
      return left <= x && x <= right && top <= y && y <= bottom;
    }).sort((a, b) => area(placeOf(this.frame, a)) - area(placeOf(this.frame, b)));
  }

  // Boxes whose centre lies in the lasso.
  caught() {
    const path = this.lasso;
    return boxesOf(this.frame).flatMap((k) => {
      const [left, top, right, bottom] = placeOf(this.frame, k);
      const [x, y] = [(left + right) / 2, (top + bottom) / 2];
      let inside = false;
      for (let i = 0, j = path.length - 1; i < path.length; j = i++) {
        const [[xi, yi], [xj, yj]] = [path[i], path[j]];
        if (yi > y !== yj > y && x < ((xj - xi) * (y - yi)) / (yj - yi) + xi) inside = !inside;
      }
      return inside ? [k] : [];
    });
  }

  draw() {
    if (this.pending || !this.frame) return;
    this.pending = true;
    requestAnimationFrame(() => {
      this.pending = false;
      this.paint();
    });
  }

  paint() {
    const ratio = devicePixelRatio || 1;
    const { clientWidth, clientHeight } = this.canvas;
    const [width, height] = [Math.round(clientWidth * ratio), Math.round(clientHeight * ratio)];
    if (this.canvas.width !== width || this.canvas.height !== height) [this.canvas.width, this.canvas.height] = [width, height];
    const c = this.context;
    const [x, y] = this.origin;
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.clearRect(0, 0, width, height);
    c.setTransform(ratio * this.scale, 0, 0, ratio * this.scale, ratio * x, ratio * y);
    if (this.picture) c.drawImage(this.picture, 0, 0, this.size.width, this.size.height);
    if (!this.hidden) this.boxes(c, 1 / this.scale);
    if (this.lasso.length > 1) {
      c.beginPath();
      for (const [px, py] of this.lasso) c.lineTo(px, py);
      c.closePath();
      c.fillStyle = "#ffffff33";
      c.fill();
      c.lineWidth = 1 / this.scale;
      c.strokeStyle = "#fff";
      c.stroke();
    }
  }

  // Each box is stroked by itself: one path of a thousand boxes that overlap takes a browser without a graphics card 135 ms,
  // a thousand strokes take 5 ms.
  boxes(c, pixel) {
    const { marks } = this.frame;
    for (const [mark, colour] of Object.entries(COLOUR)) {
      const shown = boxesOf(this.frame).filter((k) => (marks[k] ?? "none") === mark).map((k) => placeOf(this.frame, k));
      for (const [width, style] of [[3.5, "#0009"], [1.75, colour]]) {
        c.lineWidth = width * pixel;
        c.strokeStyle = style;
        for (const box of shown) outline(c, box, mark === "false");
      }
    }
    const chosen = this.rubber ?? placeOf(this.frame, this.chosen);
    if (chosen) {
      const [left, top, right, bottom] = chosen;
      c.fillStyle = "#ffffff40";
      c.fillRect(left, top, right - left, bottom - top);
      c.lineWidth = 3 * pixel;
      c.strokeStyle = "#fff";
      c.strokeRect(left, top, right - left, bottom - top);
    }
  }
}

function outline(c, [left, top, right, bottom], crossed) {
  c.strokeRect(left, top, right - left, bottom - top);
  if (!crossed) return;
  c.beginPath();
  c.moveTo(left, top);
  c.lineTo(right, bottom);
  c.moveTo(right, top);
  c.lineTo(left, bottom);
  c.stroke();
}
