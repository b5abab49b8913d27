// Browsers run no workers for pages that are read as files. There the search runs in a hidden frame instead, with the few names
// of a worker that it uses: the theme would fetch the like of this from the network.
class IFrameWorker extends EventTarget {
  onmessage = null;

  constructor(url) {
    super();
    this.frame = document.createElement("iframe");
    this.frame.hidden = true;
    document.body.append(this.frame);
    const inside = this.frame.contentWindow;
    const load = (address) => new Promise((loaded, failed) => {
      const script = inside.document.createElement("script");
      Object.assign(script, { src: address, onload: loaded, onerror: failed });
      inside.document.body.append(script);
    });
    // One after the other, as a worker does.
    inside.importScripts = (...urls) => urls.reduce((before, one) => before.then(() => load(one)), Promise.resolve());
    inside.postMessage = (data) => {
      const event = new MessageEvent("message", { data });
      this.dispatchEvent(event);
      this.onmessage?.(event);
    };
    this.ready = load(url);
  }

  postMessage(data) {
    this.ready.then(() => this.frame.contentWindow.dispatchEvent(new MessageEvent("message", { data })));
  }

  terminate() {
    this.frame.remove();
  }
}

if (location.protocol === "file:") Object.assign(window, { IFrameWorker, Worker: IFrameWorker });
