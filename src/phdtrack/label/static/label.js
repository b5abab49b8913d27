// Marking false detections and births: one click or key each, kept at once.

import { Clip } from "./clip.js";
import { Editor } from "./edit.js";
import { drawMaps } from "./maps.js";
import { Queue } from "./queue.js";
import { Sweep } from "./sweep.js";
import { boxesOf, placeOf, View } from "./view.js";

const $ = (id) => document.getElementById(id);
const view = new View($("canvas"));
const frames = new Map();
const pictures = new Map();
const MEANS = { false: "marked as false", birth: "marked as an object that enters", true: "set by hand" };
let overview = null;
let here = 0;
let alike = [];
let mapTimer = 0;

// From now on the cookie says who this is; nobody is to read the token here.
history.replaceState(null, "", location.pathname);

// Who labels: the name typed here in this tab, that of the command, that of another day; else one that nobody has.
let who = localStorage.getItem("phdtrack-who") ?? `labeller-${Math.random().toString(36).slice(2, 8)}`;
localStorage.setItem("phdtrack-who", who);

function named(name, storage) {
  if (!name.trim()) return;
  who = name.trim();
  storage?.setItem("phdtrack-who", who);
}

async function ask(path) {
  const response = await fetch(path);
  if (!response.ok) throw new Error((await response.json().catch(() => ({}))).error ?? response.statusText);
  return response.json();
}

const asked = (n) => ask(`/api/frame/${n}?who=${encodeURIComponent(who)}`);
const numbers = () => overview.frames.map((frame) => frame.number);
// The drawn frame, to which what is done belongs, and the one of its clip that is seen.
const number = () => numbers()[here];
const drawn = () => frames.get(number());
const seen = () => clip.at;
const frame = () => frames.get(seen());
const mode = () => document.querySelector("input[name=mode]:checked").value;

// --- frames -------------------------------------------------------------------------------------------------------------

const clip = new Clip({ load, show: shown });

async function load(n) {
  if (!frames.has(n)) frames.set(n, await asked(n));
  if (!pictures.has(n)) {
    const image = new Image();
    image.src = `/still/${n}.jpg`;
    await image.decode().catch(() => {});
    pictures.set(n, image.naturalWidth ? image : null);
  }
}

function shown() {
  view.show(frame(), pictures.get(seen()), overview);
  choose(-1);
  tell();
}

// Of clips that are past only the drawn frames stay: their pictures would fill the memory.
function forget() {
  const [first, last] = clip.range;
  const listed = new Set(numbers());
  for (const n of pictures.keys()) if (!listed.has(n) && (n < first || n > last)) [pictures, frames].forEach((all) => all.delete(n));
}

// A mark made while a frame is on its way is meant for the one that is seen: `here` changes when the new one is there.
// A step to the next frame counts from the one on its way, `aim`: two quick presses are two frames.
let going = 0;
let aim = 0;

async function go(place) {
  const ticket = ++going;
  const to = Math.min(Math.max(place, 0), overview.frames.length - 1);
  aim = to;
  try {
    await load(numbers()[to]);
  } catch (error) {
    if (ticket === going) aim = here;
    throw error;
  }
  if (ticket !== going) return;
  here = to;
  clip.begin(number(), overview.frames[here].clip, overview.frames[here].seconds);
  forget();
  shown();
  $("spoken").textContent = `${to + 1} of ${overview.frames.length}: frame ${number()}, ${frame().boxes.length} boxes`;
  if (!$("wall").hidden) wall();
  if (mode() === "birth") clip.ahead();
  // The next one is there before it is asked for.
  if (here + 1 < overview.frames.length) load(numbers()[here + 1]).catch(() => {});
}

// The frame that was finished last, while nothing else was done since: undo goes back to it. −1 for none.
let finished = -1;

function finish() {
  const one = overview.frames[here];
  finished = one.done ? -1 : here;
  if (!one.done) {
    one.done = true;
    overview.progress.done += 1;
    acted();
    queue.add(number(), "done", { done: true, who });
  }
  if (here + 1 < overview.frames.length) reach(here + 1);
  else tell();
}

// A server that is away: the frame stays, and the next press asks again.
const reach = (place) => go(place).catch((error) => say(`the frame did not come from the server (${error.message}): press again`));

function browse(place) {
  finished = -1;
  reach(place);
}

const step = (by) => browse(aim + by);

// An action more can be undone, and none redone.
function acted() {
  drawn().undo += 1;
  drawn().redo = 0;
}

// --- marks --------------------------------------------------------------------------------------------------------------

function mark(marks) {
  for (const { frame: n, box, mark: what, place } of marks) {
    const known = frames.get(n);
    if (!known) continue;
    for (const [all, value] of [[known.marks, what === "none" ? null : what], [known.by, who], [known.places, place]]) {
      value ? (all[box] = value) : delete all[box];
    }
  }
  acted();
  finished = -1;
  view.draw();
  queue.add(number(), "marks", { marks, who });
  if (!$("wall").hidden) colours();
  tell();
}

function swept(marks) {
  mark(marks);
  told(marks, "on this frame ");
}

function told(marks, where = "") {
  const [many, what] = [marks.length === 1 ? "box was" : "boxes were", marks[0].mark];
  say(`${marks.length} ${many} marked as ${what === "none" ? "nothing" : what}; Z ${where}undoes it`);
}

// Why a mark cannot be made on the frame that is seen, or nothing.
function objection() {
  if (mode() === "false" && seen() !== number()) return "false boxes are marked on the drawn frame itself: Home goes back there";
  if (mode() === "true" && seen() !== number()) return "boxes are drawn and moved on the drawn frame itself: Home goes back there";
  if (mode() === "birth" && seen() === clip.range[0]) return "who is there in a clip's first frame may have been there before";
  return "";
}

function turn(box) {
  if (box < 0) return;
  if (objection()) return say(objection());
  if (mode() === "true" && !frame().marks[box]) return say("this is a detection as it was made: drag it, or an edge of it");
  mark([changedTo(box, frame().marks[box] === mode())]);
}

// The mark of the mode for a box, or none of it. What was drawn is an object all the same, and goes only where nothing is left.
function changedTo(box, off) {
  const [place, own] = [frame().places[box], box >= overview.drawn];
  if (mode() === "birth") return { frame: seen(), box, mark: off ? (place ? "true" : "none") : "birth", place };
  return { frame: seen(), box, mark: off || own || mode() === "true" ? "none" : "false" };
}

function several(boxes, off) {
  if (objection()) return say(objection());
  const changing = boxes.filter((box) => {
    const has = frame().marks[box];
    // A lasso is about detections, unless it is about who enters: then boxes that were drawn or moved stay so.
    if (mode() === "false") return box < overview.drawn && (off ? has : has !== "false");
    return off ? has && has !== "true" : has !== "birth";
  });
  if (changing.length) mark(changing.map((box) => changedTo(box, off)));
}

async function undo(what) {
  const back = what === "undo" ? finished : -1;
  finished = -1;
  if (back >= 0 && back !== here) {
    await reach(back);
    if (here !== back) return;
  }
  if (drawn()[what] > 0) {
    queue.add(number(), what, { who });
    say(what === "undo" ? "taken back; Y does it again" : "done again");
  }
}

async function choose(box) {
  if (view.chosen === box && alike.length) return;
  view.chosen = box;
  alike = [];
  view.draw();
  tell();
  // Births are each of their own: only false boxes come again in the same place.
  if (box < 0 || box >= overview.drawn || mode() !== "false") return;
  const n = seen();
  const found = await ask(`/api/frame/${n}/alike/${box}`).catch(() => []);
  if (n === seen() && view.chosen === box) {
    alike = found;
    tell();
  }
}

function markAlike() {
  const marks = alike.map(([n, box]) => ({ frame: n, box, mark: mode() }));
  alike = [];
  if (!marks.length) return;
  mark(marks);
  told(marks);
}

// --- the queue ------------------------------------------------------------------------------------------------------------

// A sentence stays until the person does something else.
function say(sentence) {
  $("notice").textContent = sentence;
}

function kept(item, answer) {
  overview.progress = answer.progress;
  // While more is on its way for this frame, the page knows better than the server.
  if (!queue.concerns(item.frame)) {
    const known = frames.get(item.frame);
    if (known) for (const name of ["marks", "places", "by", "undo", "redo"]) known[name] = answer[name];
    const listed = overview.frames.find((one) => one.number === item.frame);
    if (listed) listed.done = answer.done;
    if (item.what === "undo" || item.what === "redo" || item.adopted) others(item.frame);
    if (item.body.marks?.length > 1) sweep.load().catch(() => {});
    view.draw();
    if (!$("wall").hidden) colours();
  }
  tell();
  clearTimeout(mapTimer);
  mapTimer = setTimeout(maps, 400);
}

// An action may have marked boxes of other frames: they are asked for anew, the one that is seen at once.
function others(but) {
  for (const n of frames.keys()) if (n !== but && n !== seen() && n !== number() && !queue.concerns(n)) frames.delete(n);
  sweep.load().catch(() => {});
  if (seen() === but) return;
  const n = seen();
  asked(n).then((answer) => {
    frames.set(n, answer);
    if (n === seen()) shown();
  }).catch(() => {});
}

function saving(waiting, away) {
  // What goes well at every click is not read out.
  $("saving").setAttribute("aria-live", away ? "polite" : "off");
  $("saving").className = away ? "waiting" : "";
  $("saving").textContent = away
    ? `no answer from the server; ${waiting} to be saved, retrying`
    : waiting ? "…" : "all kept";
}

// --- what is shown -----------------------------------------------------------------------------------------------------------

function tell() {
  const { done, frames: all, false: wrong, births, drawn: missed, disputed } = overview.progress;
  $("progress").textContent = `${done} of ${all} frames · ${wrong} false · ${births} ${births === 1 ? "birth" : "births"}` +
    (missed ? ` · ${missed} drawn` : "");
  $("dispute").hidden = !disputed;
  $("dispute").textContent = `${disputed} ${disputed === 1 ? "disagreement" : "disagreements"} (D)`;
  $("title").textContent = `${overview.name || "detections"}, frame ${number()}`;
  nextStep(all, overview.progress.next);
  $("undo").disabled = !(drawn()?.undo > 0 || finished >= 0);
  $("redo").disabled = !(drawn()?.redo > 0);
  tellClip();
  $("alike").disabled = alike.length < 2;
  $("alike").textContent = alike.length > 1 ? `all ${alike.length} like this (A)` : "all like this (A)";
  const box = $("wall").hidden && frame() && placeOf(frame(), view.chosen);
  $("tip").textContent = box
    ? `${score(view.chosen)} · ${Math.round(box[2] - box[0])}×${Math.round(box[3] - box[1])}` +
      (frame().marks[view.chosen] ? ` · ${MEANS[frame().marks[view.chosen]]}, by ${frame().by[view.chosen] || "an unnamed labeller"}` : "") +
      (alike.length > 1 ? ` · ${alike.length} like this on all frames` : "")
    : "";
  [...$("frames").children].forEach(({ firstChild: button }, k) => {
    const { done } = overview.frames[k];
    const name = `frame ${k + 1} of ${overview.frames.length}${done ? ", done" : ""}`;
    if (button.ariaLabel !== name) Object.assign(button, { ariaLabel: name, textContent: done ? "✓" : "" });
    button.className = (done ? "done" : "") + (k === here ? " here" : "");
    button.ariaCurrent = k === here ? "true" : "false";
  });
}

const score = (box) => (frame().boxes[box] ? `score ${frame().boxes[box][4]}` : "drawn");

// All frames are done: what to do now.
function nextStep(all, command) {
  if ($("next-step").dataset.command === command) return;
  $("next-step").dataset.command = command;
  $("next-step").hidden = !command;
  const code = document.createElement("code");
  // A line ends between words, not behind the hyphens of an option.
  for (const word of command.split(" ")) {
    const span = document.createElement("span");
    span.textContent = word;
    code.append(code.hasChildNodes() ? " " : "", span);
  }
  $("next-step").replaceChildren(`All ${all} frames are done. Now run in a terminal: `, code);
}

// The server may be away: the next click asks again.
const maps = () => drawMaps(overview.progress, number(), ask).catch(() => {});

function tellClip() {
  const [first, last] = clip.range;
  $("clip").hidden = first === last || !$("wall").hidden || (mode() !== "birth" && seen() === number() && !clip.playing);
  Object.assign($("moment"), { min: first, max: last, value: seen() });
  $("play").textContent = clip.playing ? "❚❚" : "▶";
  const by = seen() - number();
  $("when").textContent = by ? `frame ${seen()} (${by > 0 ? "+" : "−"}${Math.abs(by)})` : `frame ${seen()}, drawn`;
}

function wall() {
  const boxes = drawn().boxes.map((_, k) => {
    const button = document.createElement("button");
    button.dataset.box = k;
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
  for (const button of $("wall").children) {
    const mark = drawn().marks[button.dataset.box] ?? "";
    button.className = mark;
    button.ariaLabel = `box ${Number(button.dataset.box) + 1}${MEANS[mark] ? `, ${MEANS[mark]}` : ""}`;
  }
}

function toggleWall() {
  clip.back();
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
  if (mode() === "true" && event.button === 0) objection() ? say(objection()) : editor.press(view.at(event));
  else view.lasso = [view.at(event)];
});
$("canvas").addEventListener("pointermove", (event) => {
  cursor = view.at(event);
  if (!pressed) return mode() === "true" ? pointer() : void choose(view.under(cursor)[0] ?? -1);
  const [dx, dy] = [event.clientX - pressed.x, event.clientY - pressed.y];
  pressed.moved ||= Math.hypot(dx, dy) > 4;
  if (pressed.button !== 0) view.pan = [pressed.pan[0] + dx, pressed.pan[1] + dy];
  else if (pressed.moved) editor.hold ? editor.drag(cursor) : view.lasso.push(cursor);
  view.draw();
});
$("canvas").addEventListener("pointerup", (event) => {
  if (!pressed) return;
  const { moved, button } = pressed;
  pressed = null;
  if (editor.hold) editor.release(moved);
  else if (mode() === "true") return view.draw();
  else if (button === 0 && moved) several(view.caught(), event.shiftKey);
  else if (button === 0) {
    const under = view.under(view.at(event));
    turn(under.includes(view.chosen) ? view.chosen : under[0] ?? -1);
  }
  view.lasso = [];
  view.draw();
});
// What a drag would do here.
function pointer() {
  const [left, top, right, bottom] = editor.grip(cursor) ?? [];
  const side = (top ? "n" : bottom ? "s" : "") + (left ? "w" : right ? "e" : "");
  $("canvas").style.cursor = left && right ? "move" : side ? `${side}-resize` : "crosshair";
}
$("canvas").addEventListener("pointerleave", () => (cursor = null));
$("canvas").addEventListener("contextmenu", (event) => event.preventDefault());
$("canvas").addEventListener("wheel", (event) => {
  event.preventDefault();
  view.zoomBy(Math.exp(-event.deltaY / 400), event);
}, { passive: false });

function nextBox(back) {
  const under = cursor ? view.under(cursor) : [];
  const list = under.length ? under : boxesOf(frame());
  if (!list.length) return;
  const at = list.indexOf(view.chosen);
  choose(list[(at + (back ? -1 : 1) + list.length) % list.length] ?? list[0]);
  speak();
}

// What is chosen or marked by keyboard is read out; what the mouse passes over is only shown.
function speak() {
  const box = view.chosen;
  if (!placeOf(frame(), box)) return;
  const all = boxesOf(frame());
  const [left, top, right, bottom] = placeOf(frame(), box).map(Math.round);
  const at = mode() === "true" ? `, from ${left}, ${top} to ${right}, ${bottom}` : "";
  $("spoken").textContent = `box ${all.indexOf(box) + 1} of ${all.length}, ${score(box)}, ${MEANS[frame().marks[box]] ?? "no mark"}${at}`;
}

const KEYS = {
  Enter: finish, ArrowRight: () => step(1), ArrowLeft: () => step(-1), x: turnChosen, a: markAlike,
  z: () => undo("undo"), y: () => undo("redo"), h: toggleBoxes, w: toggleWall,
  "1": () => setMode("false"), "2": () => setMode("birth"), "3": () => setMode("true"), n: add,
  Delete: turnChosen, d: () => dispute(), s: () => sweep.toggle(),
  ",": () => clip.step(-1), ".": () => clip.step(1), " ": () => clip.play(), Home: () => clip.back(),
  "+": () => view.zoomBy(1.25), "-": () => view.zoomBy(0.8), "0": () => view.zoomBy(0),
};

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

function add() {
  setMode("true");
  if (objection()) return say(objection());
  editor.add();
  speak();
}

function turnChosen() {
  turn(view.chosen);
  speak();
}

function setMode(value) {
  document.querySelector(`input[name=mode][value=${value}]`).checked = true;
  changed();
}

function changed() {
  $("canvas").style.cursor = "";
  for (const kind of ["false", "birth", "true"]) $(`rule-${kind}`).hidden = mode() !== kind;
  alike = [];
  if (mode() === "birth") clip.ahead();
  else clip.back();
  tell();
}

for (const act of ["pointerdown", "keydown"]) document.addEventListener(act, () => say(""), true);
document.addEventListener("keydown", (event) => {
  if (!overview || event.altKey || event.target === $("who")) return;
  // Buttons and links are reached with Tab from elsewhere; on the picture it goes from box to box.
  const onPicture = document.activeElement === $("canvas") || document.activeElement === document.body;
  // The wall of suggestions lies over everything: its crops are buttons, and what is behind does not hear.
  if (sweep.open) {
    if (event.key === "Escape" || event.key === "s") sweep.close();
    else if (event.key === "Enter") sweep.sweep();
    else return;
    return void event.preventDefault();
  }
  if (event.key === "Tab") {
    if (!onPicture) return;
    event.preventDefault();
    return void nextBox(event.shiftKey);
  }
  if ((event.key === "Enter" || event.key === " ") && !onPicture) return;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  // In the mode that moves boxes arrows move the chosen one.
  if (ARROWS[key] && mode() === "true" && view.chosen >= 0 && onPicture && !objection()) {
    event.preventDefault();
    return editor.nudge(ARROWS[key], event.shiftKey);
  }
  editor.still();
  const action = key === "z" && event.shiftKey ? KEYS.y : KEYS[key];
  if (!action || ((event.ctrlKey || event.metaKey) && key !== "z" && key !== "y")) return;
  event.preventDefault();
  action();
});
// Who has clicked on a button with a mouse goes on with the keys of the picture.
document.addEventListener("click", (event) => {
  if (event.detail > 0 && event.target.closest("#frames, #next, #previous, #undo, #redo, #hide, #alike")) $("canvas").focus();
});
// Who leaves the picture by Escape can go through the buttons with Tab.
document.addEventListener("keydown", (event) => event.key === "Escape" && !event.defaultPrevented && $("previous").focus());

document.addEventListener("keyup", (event) => {
  if (!ARROWS[event.key] || !view.rubber) return;
  editor.still();
  speak();
});

// To the next box of which people say different things, and what they say.
async function dispute() {
  const all = await ask("/api/disputes").catch(() => []);
  if (!all.length) return say("nobody disagrees");
  const at = all.findIndex(([n, box]) => n === seen() && box === view.chosen);
  const [n, box, said] = all[(at + 1) % all.length];
  const about = overview.frames.findIndex(({ clip: [first, last] }) => first <= n && n <= last);
  await go(numbers().includes(n) ? numbers().indexOf(n) : about);
  if (seen() !== n) await clip.go(n);
  choose(box);
  say(Object.entries(said).map(([name, mark]) => `${name || "an unnamed labeller"}: ${mark}`).join(" · "));
}

$("dispute").addEventListener("click", dispute);
$("who").addEventListener("change", () => {
  named($("who").value, sessionStorage);
  localStorage.setItem("phdtrack-who", who);
  asked(number()).then(({ undo, redo }) => Object.assign(drawn(), { undo, redo })).then(tell).catch(() => {});
});
$("done").addEventListener("click", finish);
$("next").addEventListener("click", () => step(1));
$("previous").addEventListener("click", () => step(-1));
$("undo").addEventListener("click", () => undo("undo"));
$("redo").addEventListener("click", () => undo("redo"));
$("alike").addEventListener("click", markAlike);
$("wall-button").addEventListener("click", toggleWall);
$("hide").addEventListener("click", toggleBoxes);
$("sweep-button").addEventListener("click", () => sweep.toggle());
$("play").addEventListener("click", () => {
  clip.play();
  $("canvas").focus();
});
$("moment").addEventListener("input", () => {
  clip.stop();
  clip.go(Number($("moment").value));
});
$("mode").addEventListener("change", () => {
  changed();
  $("canvas").focus();
});

// --- begin ------------------------------------------------------------------------------------------------------------------

overview = await ask("/api/overview");
named(sessionStorage.getItem("phdtrack-who") ?? overview.labeller);
$("who").value = who;
const editor = new Editor(view, overview.drawn, {
  change: (box, place) => mark([{ frame: seen(), box, mark: frame().marks[box] === "birth" ? "birth" : "true", place }]),
  choose,
});
const queue = new Queue(overview.file, overview.name, { kept, refused: say, changed: saving });
$("kept").textContent = overview.kept;
$("frames").replaceChildren(...overview.frames.map((_, k) => {
  const item = document.createElement("li");
  const button = document.createElement("button");
  button.addEventListener("click", () => browse(k));
  item.append(button);
  return item;
}));
const sweep = new Sweep($("sweep"), $("sweep-button"), { ask, confirm: swept, closed: () => $("canvas").focus() });
saving(queue.length, false);
const open = overview.frames.findIndex((one) => !one.done);
await go(open < 0 ? 0 : open);
maps();
$("canvas").focus();
document.body.dataset.ready = "1";
