// The wall of suggested false detections, worst first: a click unticks a crop, one key marks all that are ticked.

const POLL = 1500;
const WHY = {
  rejected: "Rejected by the filter as false alarms",
  short: "Only in a short track, or in none",
};

export class Sweep {
  constructor(element, button, { ask, confirm, closed }) {
    Object.assign(this, { element, button, ask, confirm, closed });
    this.answer = { ready: false, share: 0, items: [], more: 0 };
    // What was ticked or unticked stays so while the page is open: key "frame/box".
    this.turned = new Map();
    this.poll();
  }

  get open() {
    return !this.element.hidden;
  }

  async poll() {
    await this.load().catch(() => {});
    if (!this.answer.ready) setTimeout(() => this.poll(), POLL);
  }

  async load() {
    this.answer = await this.ask("/api/suggestions");
    const { ready, share, problem, items, more } = this.answer;
    this.button.disabled = !ready || !items.length;
    this.button.textContent = problem ? `no suggestions: ${problem}`
      : !ready ? `suggestions … ${Math.floor(100 * share)} %`
      : items.length ? `${items.length + more} ${items.length + more === 1 ? "suggestion" : "suggestions"} (S)` : "no more suggestions";
  }

  async toggle() {
    if (this.open) return this.close();
    if (this.button.disabled) return;
    await this.load();
    this.build();
    this.element.hidden = false;
    this.element.scrollTop = 0;
    this.yes.focus();
  }

  close() {
    this.element.hidden = true;
    this.closed();
  }

  ticked() {
    return this.answer.items.filter((item) => this.isTicked(item));
  }

  isTicked([frame, box, , score]) {
    return this.turned.get(`${frame}/${box}`) ?? score >= this.answer.ticked;
  }

  build() {
    const header = document.createElement("header");
    const note = document.createElement("p");
    note.textContent = `Crops that score ${this.answer.ticked} or more are ticked. Click a crop to untick or tick it. Nothing is marked yet.` +
      (this.answer.more ? ` ${this.answer.more} more follow after these.` : "");
    this.yes = document.createElement("button");
    this.yes.id = "sweep-confirm";
    this.yes.className = "strong";
    this.yes.addEventListener("click", () => this.sweep());
    const no = document.createElement("button");
    no.textContent = "close (Esc)";
    no.addEventListener("click", () => this.close());
    header.append(note, this.yes, no);
    this.element.replaceChildren(header, ...this.groups().map(([title, items]) => this.group(title, items)));
    this.count();
  }

  // By place, and what is at no place by reason; in the order of their worst.
  groups() {
    const groups = new Map();
    for (const item of this.answer.items) {
      const [, , reason, , place] = item;
      const name = reason === "place" ? `place ${place}` : reason;
      if (!groups.has(name)) groups.set(name, []);
      groups.get(name).push(item);
    }
    return [...groups].map(([name, items]) => [
      WHY[name] ?? `A place with too many detections, on ${new Set(items.map(([frame]) => frame)).size} of the frames`, items,
    ]);
  }

  group(title, items) {
    const section = document.createElement("section");
    const head = document.createElement("h2");
    const all = document.createElement("button");
    const crops = document.createElement("div");
    crops.className = "crops";
    crops.append(...items.map((item) => this.crop(item)));
    all.addEventListener("click", () => {
      const to = !items.every((item) => this.isTicked(item));
      items.forEach(([frame, box]) => this.turned.set(`${frame}/${box}`, to));
      this.count();
    });
    head.append(`${title} (${items.length})`, all);
    section.append(head, crops);
    section.update = () => {
      all.textContent = items.every((item) => this.isTicked(item)) ? "untick all" : "tick all";
      items.forEach((item, k) => crops.children[k].setAttribute("aria-pressed", this.isTicked(item)));
    };
    return section;
  }

  crop(item) {
    const [frame, box, reason, score] = item;
    const button = document.createElement("button");
    button.setAttribute("aria-label", `frame ${frame}, box ${box}`);
    button.title = `frame ${frame}, score ${score.toFixed(2)} (${reason})`;
    const image = document.createElement("img");
    image.loading = "lazy";
    image.alt = "";
    image.src = `/crop/${frame}/${box}.jpg`;
    button.append(image);
    button.addEventListener("click", () => {
      this.turned.set(`${frame}/${box}`, !this.isTicked(item));
      this.count();
    });
    return button;
  }

  count() {
    for (const section of this.element.querySelectorAll("section")) section.update();
    const many = this.ticked().length;
    this.yes.disabled = !many;
    this.yes.textContent = `mark ${many} of ${this.answer.items.length} as false (Enter)`;
  }

  sweep() {
    const marks = this.ticked().map(([frame, box]) => ({ frame, box, mark: "false" }));
    if (!marks.length) return;
    this.close();
    this.confirm(marks);
  }
}
