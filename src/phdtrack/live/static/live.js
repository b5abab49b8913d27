// The page of live cameras. Everything that comes from outside goes into text nodes.
const $ = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
// From now on the cookie says who this is; nobody is to read the token here.
history.replaceState(null, "", location.pathname);
// `doomed`: the place that is to be deleted, if it is clicked once more.
let camera = "", known = null, minutes = [], span = 60, draft = null, shown = "", doomed = "";

function element(kind, attributes = {}, text = "", space = null) {
  const made = space ? document.createElementNS(space, kind) : document.createElement(kind);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (text !== "") made.textContent = text;
  return made;
}
const drawn = (kind, attributes, text = "") => element(kind, attributes, text, SVG);
const path = (name) => encodeURIComponent(name);

async function asked(address, options = {}) {
  const answer = await fetch(address, options);
  if (!answer.ok && answer.status !== 400) throw new Error(`the server answered ${answer.status}`);
  return answer;
}

// Calls `work` again and again, `pause` ms after it has ended; not while nobody looks.
async function forever(work, pause) {
  for (;;) {
    if (!document.hidden) {
      try {
        await work();
        if (pause === 1000) $("link").textContent = "";
      } catch (error) {
        $("link").textContent = "no connection to phdtrack";
        await new Promise((done) => setTimeout(done, 1000));
      }
    }
    await new Promise((done) => setTimeout(done, document.hidden ? 1000 : pause));
  }
}

let number = 0;
async function picture() {
  if (!camera) return void await new Promise((done) => setTimeout(done, 200));
  const of = camera;
  const answer = await asked(`/picture/${path(of)}.jpg?after=${number}`);
  if (of !== camera) return;
  if (answer.status === 204) return void await new Promise((done) => setTimeout(done, 300));
  const image = await createImageBitmap(await answer.blob());
  // Another camera may have been chosen meanwhile: its name must not stand over this picture.
  if (of !== camera) return;
  const canvas = $("picture");
  if (canvas.width !== image.width || canvas.height !== image.height) Object.assign(canvas, { width: image.width, height: image.height });
  canvas.getContext("2d").drawImage(image, 0, 0);
  number = Number(answer.headers.get("X-Frame"));
  $("waiting").hidden = true;
  document.body.dataset.frame = number;
}

async function state() {
  const all = await (await asked("/api/cameras")).json();
  if (!all.some((one) => one.name === camera)) choose(all.length ? all[0].name : "");
  $("cameras").replaceChildren(...all.map((one) => {
    const button = element("button", { "aria-current": one.name === camera, title: one.state });
    button.append(element("i", { class: one.state }), one.name, one.state === "live" ? ` ${one.tracks}` : "");
    button.onclick = () => { choose(one.name); state(); };
    return button;
  }));
  if (!camera) return;
  const of = camera, found = await (await asked(`/api/camera/${path(of)}`)).json();
  if (of !== camera) return;
  known = found;
  source();
  places();
  overlay();
  events();
}

function choose(name) {
  camera = name;
  known = null;
  number = 0;
  shown = "";
  minutes = [];
  stop();
  slow().catch(() => {});
  $("waiting").hidden = false;
  $("picture").getContext("2d").clearRect(0, 0, $("picture").width, $("picture").height);
}

const HIDDEN = { boxes: "boxes", faces: "upper third of boxes" };
const seconds = (value) => value === null ? "–" : value < 1 ? `${Math.round(1000 * value)} ms` : value < 120 ? `${value.toFixed(value < 10 ? 1 : 0)} s`
  : value < 7200 ? `${Math.round(value / 60)} min` : `${Math.round(value / 3600)} h`;

function source() {
  const rows = [
    ["state", `${known.state} for ${seconds(known.since)}`], ["objects now", known.tracks], ["pictures per second", known.fps.toFixed(1)],
    ["lag: median, 99 %", `${seconds(known.latency[0])}, ${seconds(known.latency[1])}`],
    ["pictures dropped", `${known.dropped.toLocaleString()} of ${known.frames.toLocaleString()}`],
    ["boxes left out", Object.entries(known.boxes_left_out).filter(([, count]) => count).map(([why, count]) => `${count.toLocaleString()} ${why}`).join(", ") || "none"],
    ["reconnections", Math.max(0, known.connects - 1)], ["size", known.width ? `${known.width} × ${known.height}` : "–"],
    ["last problem", known.problem || "none"], ...(known.blur ? [["hidden", HIDDEN[known.blur]]] : []),
  ];
  const old = known.state !== "live";
  $("stage").classList.toggle("old", old);
  $("waiting").textContent = old && number ? `no new pictures: ${known.state}` : "waiting for a picture …";
  $("waiting").hidden = number > 0 && !old;
  $("state").replaceChildren(...rows.flatMap(([what, value], k) => {
    const right = element("dd", {}, String(value));
    if (k === 0) right.prepend(element("i", { class: known.state }));
    return [element("dt", {}, what), right];
  }));
  $("reports").textContent = known.reports;
  $("problems").replaceChildren(...known.problems.map((sentence) => element("li", {}, sentence)));
}

// Before the first picture its size is not known.
const drawable = () => Boolean(known?.drawable && known.width);

function places() {
  $("none").hidden = known.places.length > 0;
  $("places").hidden = known.places.length === 0;
  $("line").hidden = $("zone").hidden = draft !== null || !drawable();
  const key = JSON.stringify(known.places);
  if (key === shown) return;
  shown = key;
  $("places").tBodies[0].replaceChildren(...known.places.map((place, k) => {
    const row = element("tr"), remove = element("button", { "aria-label": `delete ${place.name}` }, "×");
    const now = place.kind === "zone" ? place.entered - place.left : "";
    row.append(...[place.name, place.entered, place.left, now].map((value) => element("td", {}, String(value))), element("td"));
    // The first click asks, the second deletes, also where the counts have changed in between.
    const ask = (name) => { doomed = name; remove.className = name ? "bad" : ""; remove.textContent = name ? "delete?" : "×"; };
    if (doomed === place.name) ask(doomed);
    remove.onclick = () => {
      if (doomed !== place.name) {
        ask(place.name);
        setTimeout(() => { if (doomed === place.name) { doomed = shown = ""; } }, 4000);
        return;
      }
      doomed = "";
      save(known.places.filter((_, other) => other !== k), `${place.name} was deleted`);
    };
    if (known.drawable) row.lastChild.append(remove);
    return row;
  }));
}

function overlay() {
  const svg = $("overlay"), width = known?.width || 16, height = known?.height || 9, parts = [];
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  // So large that letters and corners have the same size on a phone.
  const unit = width / Math.max(1, svg.clientWidth);
  for (const place of known?.places || []) parts.push(...shape(place, unit));
  if (draft) {
    const points = draft.points.map((p) => p.join(",")).join(" ");
    if (draft.points.length > 1) {
      const kind = draft.kind === "zone" && draft.points.length > 2 ? "polygon" : "polyline";
      parts.push(drawn(kind, { class: "halo", points }), drawn(kind, { class: `shape new ${draft.kind}`, points }));
    }
    parts.push(...draft.points.map(([cx, cy]) => drawn("circle", { class: "corner", cx, cy, r: 5 * unit })));
  }
  svg.replaceChildren(...parts);
}

function shape(place, unit) {
  const points = place.points.map((p) => p.join(",")).join(" "), kind = place.kind === "zone" ? "polygon" : "polyline";
  const parts = [drawn(kind, { class: "halo", points }), drawn(kind, { class: `shape ${place.kind}`, points })];
  let [x, y] = place.points[0];
  if (place.kind === "line") {
    // An arrow shows which way is in: to the right of somebody who looks along the line.
    const k = Math.floor((place.points.length - 1) / 2), [a, b] = [place.points[k], place.points[k + 1]];
    const long = Math.hypot(b[0] - a[0], b[1] - a[1]), along = [(b[0] - a[0]) / long, (b[1] - a[1]) / long], across = [-along[1], along[0]];
    [x, y] = [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
    const at = (u, v) => [x + unit * (u * along[0] + v * across[0]), y + unit * (u * along[1] + v * across[1])].join(",");
    parts.push(drawn("polygon", { class: "arrow", points: `${at(-7, 2)} ${at(7, 2)} ${at(0, 14)}` }));
  } else {
    [x, y] = [0, 1].map((axis) => place.points.reduce((sum, p) => sum + p[axis], 0) / place.points.length);
  }
  const label = drawn("text", { x: x + (place.kind === "line" ? 12 * unit : 0), y, "font-size": 14 * unit,
    "text-anchor": place.kind === "line" ? "start" : "middle" }, place.name);
  return [...parts, label];
}

function start(kind) {
  draft = { kind, points: [] };
  $("stage").classList.add("drawing");
  $("drawing").hidden = false;
  $("line").hidden = $("zone").hidden = true;
  const names = known.places.map((place) => place.name);
  let k = 1;
  while (names.includes(`${kind} ${k}`)) k += 1;
  $("name").value = `${kind} ${k}`;
  progress();
}

function stop(words = "", bad = false) {
  draft = null;
  $("stage").classList.remove("drawing");
  $("drawing").hidden = true;
  $("line").hidden = $("zone").hidden = !drawable();
  hint(words, bad);
  overlay();
}

function hint(words, bad = false) {
  $("hint").textContent = words;
  $("hint").className = bad ? "bad" : "";
}

function progress() {
  const least = draft.kind === "zone" ? 3 : 2, count = draft.points.length;
  $("save").disabled = count < least;
  $("undo").disabled = count === 0;
  hint(count < least ? `Touch or click ${least - count} ${count ? "more " : ""}point${least - count > 1 ? "s" : ""} on the picture.`
    : draft.kind === "zone" ? "More corners, or save." : "More points, or save. The arrow will show which way is in.");
  overlay();
}

async function save(list, words) {
  const tables = { line: [], zone: [] };
  for (const { kind, name, points, anchor, classes } of list) tables[kind].push({ name, points, anchor, classes });
  try {
    const answer = await asked(`/api/camera/${path(camera)}/places`, {
      method: "POST", headers: { "X-Phdtrack": "1", "Content-Type": "application/json" }, body: JSON.stringify(tables) });
    const said = await answer.json();
    if (said.error) return hint(said.error, true);
    stop(words);
    await state();
  } catch (error) {
    hint(`not saved: ${error.message}`, true);
  }
}

$("overlay").addEventListener("pointerdown", (event) => {
  if (!draft || event.button > 0) return;
  event.preventDefault();
  const at = new DOMPoint(event.clientX, event.clientY).matrixTransform($("overlay").getScreenCTM().inverse());
  draft.points.push([at.x, at.y].map((value) => Math.round(10 * value) / 10));
  progress();
});
$("line").onclick = () => start("line");
$("zone").onclick = () => start("zone");
$("undo").onclick = () => { draft.points.pop(); progress(); };
$("cancel").onclick = () => stop();
$("tools").onsubmit = (event) => {
  event.preventDefault();
  if (!draft || $("save").disabled) return;
  const name = $("name").value.trim();
  if (!name) return hint("Give it a name.", true);
  save([...known.places, { kind: draft.kind, name, points: draft.points, anchor: "feet", classes: [] }], `${name} was saved`);
};
addEventListener("keydown", (event) => { if (event.key === "Escape" && draft) stop(); });
addEventListener("resize", () => { overlay(); chart(); });

const SAID = { appear: "appears", leave: "leaves", enter: "enters", exit: "leaves", dwell: "stays in", cross: "crosses" };
function events() {
  const rows = known.events.map((event) => {
    const row = element("li"), time = new Date(event.time);
    let what = event.kind === "group" ? `group: ${event.place}` : [SAID[event.kind], event.place].filter(Boolean).join(" ");
    if (event.direction) what += `, ${event.direction}`;
    if (event.seconds !== undefined) what += `, ${seconds(event.seconds)}`;
    row.append(element("time", { datetime: event.time }, time.toLocaleTimeString([], { hour12: false })), element("span", { class: "what" }, what),
      element("span", { class: "who" }, `${event.kind === "group" ? "g" : "#"}${event.identity}`));
    return row;
  });
  $("list").replaceChildren(...(rows.length ? rows : [element("li", { class: "none" }, "No events yet.")]));
}

function chart() {
  // In pixels of the screen, so that letters have their size.
  const [left, right, top, bottom] = [34, Math.max(200, $("chart").clientWidth - 8), 10, 176], now = Date.now() / 1000, begin = now - 60 * span;
  const inside = minutes.filter(([wall]) => wall + 60 > begin), most = Math.max(1, ...inside.map((row) => row[2]));
  const x = (wall) => left + (right - left) * Math.min(1, Math.max(0, (wall - begin) / (60 * span)));
  const step = [1, 2, 5, 10, 20, 50, 100, 200, 500].find((one) => most / one <= 4) || 1000, high = Math.ceil(most / step) * step;
  $("chart").setAttribute("viewBox", `0 0 ${right + 8} 200`);
  const y = (value) => bottom - (bottom - top) * value / high, parts = [];
  for (let value = 0; value <= high; value += step) {
    parts.push(drawn("line", { class: "grid", x1: left, x2: right, y1: y(value), y2: y(value) }));
    parts.push(drawn("text", { x: left - 6, y: y(value) + 4, "text-anchor": "end" }, value));
  }
  const each = { 60: 15, 360: 60, 1440: 240 }[span] * 60, zone = new Date().getTimezoneOffset() * 60;
  for (let wall = Math.ceil((begin - zone) / each) * each + zone; wall <= now; wall += each) {
    const words = new Date(1000 * wall).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", hour12: false });
    if (x(wall) > left + 20 && x(wall) < right - 12) parts.push(drawn("text", { x: x(wall), y: bottom + 18, "text-anchor": "middle" }, words));
  }
  const bars = inside.map(([wall, , value]) => `M${x(wall)} ${bottom}V${y(value)}H${x(Math.min(wall + 60, now))}V${bottom}Z`);
  parts.push(drawn("path", { class: "most", d: bars.join("") }));
  // Where minutes are missing the line is broken.
  const line = inside.map(([wall, mean], k) => `${k && wall - inside[k - 1][0] === 60 ? "L" : "M"}${x(wall + 30)} ${y(mean)}h.01`);
  parts.push(drawn("path", { class: "mean", d: line.join("") }));
  $("chart").replaceChildren(...parts);
}

async function slow() {
  if (!camera) return;
  const of = camera, found = await (await asked(`/api/camera/${path(of)}/minutes`)).json();
  if (of !== camera) return;
  minutes = found;
  chart();
  for (const what of ["people", "clutter"]) $(what).src = `/map/${path(of)}/${what}.jpg?${Date.now()}`;
  document.body.dataset.ready = of;
}
for (const button of $("spans").children) {
  button.onclick = () => {
    span = Number(button.value);
    for (const one of $("spans").children) one.setAttribute("aria-pressed", one === button);
    chart();
  };
}

forever(state, 1000);
forever(picture, 0);
forever(slow, 5000);
