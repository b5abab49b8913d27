// What the server is to keep, in order. Nothing leaves the queue before the server has said that it is on its disk: while the
// server is away everything waits here, and in the browser's storage, so that not even a reload loses it.
//
// Each waiting action is an entry of its own in the storage: tabs never write each other's. What another tab has left, because
// it was closed or is waiting too, is sent by this one as well. The server counts an action once, by its key, and each tab
// sends all of them in order, so that it does not matter who is first.

const RETRY = 500;
const LOOK = 2000;
let made = 0;

export class Queue {
  // `file` names the file of labels, `before` what earlier versions called it.
  constructor(file, before, { kept, refused, changed }) {
    this.prefix = `phdtrack-label:${file}:`;
    Object.assign(this, { file, kept, refused, changed });
    this.waiting = [];
    this.busy = false;
    this.away = false;
    this.convert(`phdtrack-label:${before}`);
    this.adopt();
    setInterval(() => this.adopt(), LOOK);
  }

  get length() {
    return this.waiting.length;
  }

  concerns(frame) {
    return this.waiting.some((item) => item.frame === frame);
  }

  add(frame, what, body = {}) {
    const key = crypto.randomUUID?.() ?? `${Date.now()}-${Math.random()}`;
    this.wait({ frame, what, body: { ...body, key } });
  }

  wait(item) {
    // Names in the order of the actions.
    const name = `${this.prefix}${String(Date.now()).padStart(15, "0")}-${String(made++).padStart(9, "0")}-${item.body.key}`;
    try {
      localStorage.setItem(name, JSON.stringify(item));
    } catch {
      // The storage is full or forbidden: the action waits in this tab only.
    }
    this.waiting.push({ ...item, name });
    this.changed(this.length, this.away);
    this.work();
  }

  // What other tabs have left waiting, behind what waits here.
  adopt() {
    const known = new Set(this.waiting.map(({ name }) => name));
    const names = Object.keys(localStorage).filter((name) => name.startsWith(this.prefix) && !known.has(name)).sort();
    for (const name of names) {
      const item = localStorage.getItem(name);
      if (item) this.waiting.push({ ...JSON.parse(item), name, adopted: true });
    }
    if (names.length) this.changed(this.length, this.away);
    this.work();
  }

  // Earlier versions kept one list for all tabs.
  convert(name) {
    const items = JSON.parse(localStorage.getItem(name) ?? "[]");
    items.forEach((item) => this.wait(item));
    localStorage.removeItem(name);
  }

  async work() {
    if (this.busy) return;
    this.busy = true;
    while (this.waiting.length) {
      const item = this.waiting[0];
      try {
        // Who answers again may be another command on the same port, with other labels.
        if (this.away && (await (await fetch("/api/overview")).json()).file !== this.file) throw new Error("another file");
        const response = await fetch(`/api/frame/${item.frame}/${item.what}`, {
          method: "POST",
          headers: { "Content-Type": "application/json", "X-Phdtrack": "1" },
          body: JSON.stringify(item.body),
        });
        // Something on the way that is not the server's own answer: it is not there.
        if (response.status >= 500) throw new Error(response.statusText);
        const answer = await response.json();
        this.waiting.shift();
        localStorage.removeItem(item.name);
        this.away = false;
        this.changed(this.length, false);
        if (response.ok) this.kept(item, answer);
        else this.refused(answer.error ?? response.statusText);
      } catch {
        this.away = true;
        this.changed(this.length, true);
        await new Promise((done) => setTimeout(done, RETRY));
      }
    }
    this.busy = false;
  }
}
