// Marking false detections: one click or key each, kept at once.

import { Queue } from "./queue.js";
import { View } from "./view.js";

const $ = (id) => document.getElementById(id);
const view = new View($("canvas"));
const frames = new Map();
const pictures = new Map();
let overview = null;
let here = 0;
let alike = [];
let mapTimer = 0;

const who = (localStorage.getItem("phdtrack-who") ?? Math.random().toString(36).slice(2, 10));
localStorage.setItem("phdtrack-who", who);

async function ask(path) {
  const response = await fetch(path);
  if (!response.ok) throw new Error((await response.json().catch(() => ({}))).error ?? response.statusText);
  return response.json();
}

const numbers = () => overview.frames.map((frame) => frame.number);
const number = () => numbers()[here];
const frame = () => frames.get(number());
const mode = () => document.querySelector("input[name=mode]:checked").value;

// --- frames -------------------------------------------------------------------------------------------------------------

async function load(n) {
  if (!frames.has(n)) frames.set(n, await ask(`/api/frame/${n}`));
  if (!pictures.has(n)) {
    const image = new Image();
    image.src = `/still/${n}.jpg`;
    await image.decode().catch(() => {});
    pictures.set(n, image.naturalWidth ? image : null);
  }
}

// What is pressed while a frame is on its way is meant for the one that is seen: `here` changes when the new one is there.
let going = 0;

async function go(place) {
  const ticket = ++going;
  const to = Math.min(Math.max(place, 0), overview.frames.length - 1);
  await load(numbers()[to]);
  if (ticket !== going) return;
  here = to;
  view.show(frame(), pictures.get(number()), overview);
  choose(-1);
  if (!$("wall").hidden) wall();
  tell();
  // The next one is there before it is asked for.
  if (here + 1 < overview.frames.length) load(numbers()[here + 1]).catch(() => {});
}

function next() {
  if (overview.frames[here].done !== true) {
    overview.frames[here].done = true;
    overview.progress.done += 1;
    queue.add(number(), "done", { done: true });
  }
  if (here + 1 < overview.frames.length) go(here + 1);
  else tell();
}

// --- marks --------------------------------------------------------------------------------------------------------------

function mark(marks) {
  for (const { frame: n, box, mark: what } of marks) {
    const known = frames.get(n);
    if (known) what === "none" ? delete known.marks[box] : (known.marks[box] = what);
  }
  frame().undo += 1;
  frame().redo = 0;
  view.draw();
  queue.add(number(), "marks", { marks, who });
  if (!$("wall").hidden) colours();
  tell();
}

function turn(box) {
  if (box < 0) return;
  const what = frame().marks[box] === mode() ? "none" : mode();
  mark([{ frame: number(), box, mark: what }]);
}

function several(boxes, off) {
  const what = off ? "none" : mode();
  const changing = boxes.filter((box) => (frame().marks[box] ?? "none") !== what);
  if (changing.length) mark(changing.map((box) => ({ frame: number(), box, mark: what })));
}

function undo(what) {
  if (frame()[what] > 0) queue.add(number(), what);
}

async function choose(box) {
  if (view.chosen === box && alike.length) return;
  view.chosen = box;
  alike = [];
  view.draw();
  tell();
  if (box < 0) return;
  const n = number();
  const found = await ask(`/api/frame/${n}/alike/${box}`).catch(() => []);
  if (n === number() && view.chosen === box) {
    alike = found;
    tell();
  }
}

function markAlike() {
  if (alike.length) mark(alike.map(([n, box]) => ({ frame: n, box, mark: mode() })));
  alike = [];
}

// --- the queue ------------------------------------------------------------------------------------------------------------

function refused(sentence) {
  $("tip").textContent = sentence;
}

function kept(item, answer) {
  overview.progress = answer.progress;
  // While more is on its way for this frame, the page knows better than the server.
  if (!queue.concerns(item.frame)) {
    const known = frames.get(item.frame);
    if (known) Object.assign(known, { marks: answer.marks, undo: answer.undo, redo: answer.redo });
    if (item.what === "undo" || item.what === "redo") others(item.frame);
    view.draw();
    if (!$("wall").hidden) colours();
  }
  tell();
  clearTimeout(mapTimer);
  mapTimer = setTimeout(map, 400);
}

// An action may have marked boxes of other frames: they are asked for anew when they are looked at again.
function others(but) {
  for (const n of frames.keys()) if (n !== but && n !== number() && !queue.concerns(n)) frames.delete(n);
}

function saving(waiting, away) {
  $("saving").className = away ? "waiting" : "";
  $("saving").textContent = away
    ? `the server does not answer; ${waiting} to be kept, trying again`
    : waiting ? "…" : "all kept";
}

// --- what is told -----------------------------------------------------------------------------------------------------------

function tell() {
  const { done, frames: all, false: wrong, births } = overview.progress;
  $("progress").textContent = `${done} of ${all} frames · ${wrong} false` + (births ? ` · ${births} births` : "");
  $("title").textContent = `${overview.name || "detections"}, frame ${number()}`;
  $("undo").disabled = !(frame()?.undo > 0);
  $("redo").disabled = !(frame()?.redo > 0);
  $("alike").disabled = alike.length < 2;
  $("alike").textContent = alike.length > 1 ? `all ${alike.length} like this (A)` : "all like this (A)";
  const box = $("wall").hidden ? frame()?.boxes[view.chosen] : null;
  $("tip").textContent = box
    ? `score ${box[4]} · ${Math.round(box[2] - box[0])}×${Math.round(box[3] - box[1])}` +
      (alike.length > 1 ? ` · ${alike.length} like this on all frames` : "")
    : "";
  [...$("frames").children].forEach((item, k) => {
    item.firstChild.className = (overview.frames[k].done ? "done" : "") + (k === here ? " here" : "");
  });
}

function map() {
  const image = $("map");
  image.src = `/api/map.png?${Date.now()}`;
  const n = number();
  image.style.backgroundImage = `url(/still/${n}.jpg)`;
  $("map-caption").textContent = overview.progress.false < 10
    ? `the map of false alarms begins with 10 marked boxes (${overview.progress.false} so far)`
    : `learned from ${overview.progress.false} false boxes: red is where more are expected`;
}

function wall() {
  const boxes = frame().boxes.map((_, k) => {
    const button = document.createElement("button");
    button.dataset.box = k;
    button.setAttribute("aria-label", `box ${k}`);
    const image = document.createElement("img");
    image.loading = "lazy";
    image.alt = "";
    image.src = `/crop/${number()}/${k}.jpg`;
    button.append(image);
    button.addEventListener("click", () => turn(k));
    return button;
  });
  $("wall").replaceChildren(...boxes);
  colours();
}

function colours() {
  for (const button of $("wall").children) button.className = frame().marks[button.dataset.box] ?? "";
}

function toggleWall() {
  $("wall").hidden = !$("wall").hidden;
  if (!$("wall").hidden) wall();
  tell();
}

function toggleBoxes() {
  view.hidden = !view.hidden;
  $("hide").textContent = view.hidden ? "show boxes" : "hide boxes";
  view.draw();
}

// --- mouse and keys -----------------------------------------------------------------------------------------------------------

let pressed = null;
let cursor = null;

$("canvas").addEventListener("pointerdown", (event) => {
  $("canvas").setPointerCapture(event.pointerId);
  $("canvas").focus();
  pressed = { x: event.clientX, y: event.clientY, moved: false, button: event.button, pan: [...view.pan] };
  view.lasso = [view.at(event)];
});
$("canvas").addEventListener("pointermove", (event) => {
  cursor = view.at(event);
  if (!pressed) return void choose(view.under(cursor)[0] ?? -1);
  const [dx, dy] = [event.clientX - pressed.x, event.clientY - pressed.y];
  pressed.moved ||= Math.hypot(dx, dy) > 4;
  if (pressed.button !== 0) view.pan = [pressed.pan[0] + dx, pressed.pan[1] + dy];
  else if (pressed.moved) view.lasso.push(cursor);
  view.draw();
});
$("canvas").addEventListener("pointerup", (event) => {
  if (!pressed) return;
  const { moved, button } = pressed;
  pressed = null;
  if (button === 0 && moved) several(view.caught(), event.shiftKey);
  else if (button === 0) {
    const under = view.under(view.at(event));
    turn(under.includes(view.chosen) ? view.chosen : under[0] ?? -1);
  }
  view.lasso = [];
  view.draw();
});
$("canvas").addEventListener("pointerleave", () => (cursor = null));
$("canvas").addEventListener("contextmenu", (event) => event.preventDefault());
$("canvas").addEventListener("wheel", (event) => {
  event.preventDefault();
  view.zoomBy(Math.exp(-event.deltaY / 400), event);
}, { passive: false });

function step(back) {
  const under = cursor ? view.under(cursor) : [];
  const list = under.length ? under : frame().boxes.map((_, k) => k);
  if (!list.length) return;
  const at = list.indexOf(view.chosen);
  choose(list[(at + (back ? -1 : 1) + list.length) % list.length] ?? list[0]);
}

const KEYS = {
  Enter: next, ArrowRight: next, ArrowLeft: () => go(here - 1), x: () => turn(view.chosen), a: markAlike,
  z: () => undo("undo"), y: () => undo("redo"), h: toggleBoxes, w: toggleWall,
  "1": () => setMode("false"), "2": () => setMode("birth"),
  "+": () => view.zoomBy(1.25), "-": () => view.zoomBy(0.8), "0": () => view.zoomBy(0),
};

function setMode(value) {
  document.querySelector(`input[name=mode][value=${value}]`).checked = true;
}

document.addEventListener("keydown", (event) => {
  if (!overview || event.altKey) return;
  // Buttons and links are reached with Tab from elsewhere; on the picture it goes from box to box.
  const onPicture = document.activeElement === $("canvas") || document.activeElement === document.body;
  if (event.key === "Tab") {
    if (!onPicture) return;
    event.preventDefault();
    return void step(event.shiftKey);
  }
  if (event.key === "Enter" && !onPicture) return;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  const action = key === "z" && event.shiftKey ? KEYS.y : KEYS[key];
  if (!action || ((event.ctrlKey || event.metaKey) && key !== "z" && key !== "y")) return;
  event.preventDefault();
  action();
});
// Who leaves the picture by Escape can go through the buttons with Tab.
document.addEventListener("keydown", (event) => event.key === "Escape" && $("previous").focus());

$("next").addEventListener("click", next);
$("previous").addEventListener("click", () => go(here - 1));
$("undo").addEventListener("click", () => undo("undo"));
$("redo").addEventListener("click", () => undo("redo"));
$("alike").addEventListener("click", markAlike);
$("wall-button").addEventListener("click", toggleWall);
$("hide").addEventListener("click", toggleBoxes);

// --- begin ------------------------------------------------------------------------------------------------------------------

overview = await ask("/api/overview");
const queue = new Queue(overview.name, { kept, refused, changed: saving });
$("frames").replaceChildren(...overview.frames.map((_, k) => {
  const item = document.createElement("li");
  const button = document.createElement("button");
  button.setAttribute("aria-label", `frame ${k + 1} of ${overview.frames.length}`);
  button.addEventListener("click", () => go(k));
  item.append(button);
  return item;
}));
saving(queue.length, false);
const open = overview.frames.findIndex((one) => !one.done);
await go(open < 0 ? 0 : open);
map();
$("canvas").focus();
document.body.dataset.ready = "1";
