// Search in pages that are opened from disk: browsers start no workers from file: addresses, so the script of one runs in
// a hidden frame. The plugin `offline` looks for a polyfill of this name; pages of a server keep the browser's workers.
"use strict";

class IFrameWorker extends EventTarget {
  constructor(url) {
    super();
    this.frame = document.createElement("iframe");
    this.frame.hidden = true;
    document.body.append(this.frame);
    const inside = this.frame.contentWindow;
    inside.postMessage = (data) => this.received("message", data); // what the worker answers
    const script = inside.document.createElement("script");
    script.src = new URL(url, document.baseURI).href;
    this.loaded = new Promise((resolve) => script.addEventListener("load", resolve));
    inside.document.body.append(script);
  }

  postMessage(data) {
    const inside = this.frame.contentWindow;
    this.loaded.then(() => inside.dispatchEvent(new MessageEvent("message", { data })));
  }

  terminate() {
    this.frame.remove();
  }

  received(kind, data) {
    const event = new MessageEvent(kind, { data });
    this.dispatchEvent(event);
    if (this.onmessage) this.onmessage(event);
  }
}

if (location.protocol === "file:") {
  window.IFrameWorker = window.Worker = IFrameWorker;
}
