// What the server is to keep, in order. Nothing leaves the queue before the server has said that it is on its disk: while the
// server is away everything waits here, and in the browser's storage, so that not even a reload loses it.

const RETRY = 500;

export class Queue {
  constructor(name, { kept, refused, changed }) {
    this.name = `phdtrack-label:${name}`;
    this.kept = kept;
    this.refused = refused;
    this.changed = changed;
    this.waiting = JSON.parse(localStorage.getItem(this.name) ?? "[]");
    this.busy = false;
    this.away = false;
    this.work();
  }

  get length() {
    return this.waiting.length;
  }

  concerns(frame) {
    return this.waiting.some((item) => item.frame === frame);
  }

  add(frame, what, body = {}) {
    this.waiting.push({ frame, what, body: { ...body, key: crypto.randomUUID?.() ?? `${Date.now()}-${Math.random()}` } });
    this.store();
    this.work();
  }

  store() {
    localStorage.setItem(this.name, JSON.stringify(this.waiting));
    this.changed(this.waiting.length, this.away);
  }

  async work() {
    if (this.busy) return;
    this.busy = true;
    while (this.waiting.length) {
      const item = this.waiting[0];
      try {
        const response = await fetch(`/api/frame/${item.frame}/${item.what}`, {
          method: "POST",
          headers: { "Content-Type": "application/json", "X-Phdtrack": "1" },
          body: JSON.stringify(item.body),
        });
        // Something on the way that is not the server's own answer: it is not there.
        if (response.status >= 500) throw new Error(response.statusText);
        const answer = await response.json();
        this.waiting.shift();
        this.away = false;
        this.store();
        if (response.ok) this.kept(item, answer);
        else this.refused(answer.error ?? response.statusText);
      } catch {
        this.away = true;
        this.changed(this.waiting.length, true);
        await new Promise((done) => setTimeout(done, RETRY));
      }
    }
    this.busy = false;
  }
}
