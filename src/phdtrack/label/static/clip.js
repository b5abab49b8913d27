// The short clip about a drawn frame: a few frames before it and behind it, one by one or played in a loop.

// Seconds for which a frame is seen at least, so that one can follow, and at most, where the video pauses.
const [LEAST, MOST] = [1 / 12, 2];

export class Clip {
  constructor({ show, load }) {
    Object.assign(this, { show, load });
    this.range = [1, 1];
    // The frame that is seen, and the one that is asked for and may be on its way.
    this.at = this.wanted = 1;
    this.playing = 0;
    this.ticket = 0;
  }

  // From now on the clip about the frame `drawn`, which is there.
  begin(drawn, [first, last], seconds) {
    this.stop();
    Object.assign(this, { drawn, range: [first, last], at: drawn, wanted: drawn, seconds });
    this.ticket += 1;
  }

  async go(number) {
    const [first, last] = this.range;
    const to = Math.min(Math.max(number, first), last);
    const ticket = ++this.ticket;
    this.wanted = to;
    await this.load(to);
    // Something else was asked for meanwhile: another frame, or another clip.
    if (ticket !== this.ticket) return;
    this.at = to;
    this.show();
  }

  step(by) {
    this.stop();
    return this.go(this.wanted + by);
  }

  // To the drawn frame.
  back() {
    this.stop();
    if (this.wanted !== this.drawn) this.go(this.drawn);
  }

  ahead() {
    for (let n = this.range[0]; n <= this.range[1]; n++) this.load(n).catch(() => {});
  }

  // Each frame for as long as the video shows it.
  play() {
    if (this.playing) return this.stop();
    this.ahead();
    this.later();
    this.show();
  }

  later() {
    const [first, last] = this.range;
    const seconds = Math.min(Math.max(this.seconds[this.at - first], LEAST), MOST);
    const own = setTimeout(async () => {
      // A frame that does not come ends nothing: it is asked for again.
      await this.go(this.at >= last ? first : this.at + 1).catch(() => {});
      if (this.playing === own) this.later();
    }, 1000 * seconds);
    this.playing = own;
  }

  stop() {
    if (!this.playing) return;
    clearTimeout(this.playing);
    this.playing = 0;
    this.ticket += 1;
    this.wanted = this.at;
    this.show();
  }
}
