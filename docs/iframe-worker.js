// Material for MkDocs fetches a script of this name from the web where the docs have none.
// The search of a page that is opened as a file. Browsers start no workers there: its script runs in a hidden frame,
// and what the page would send to a worker, and hear from it, goes through here.
if (location.protocol === "file:") {
  window.Worker = function HiddenFrame(url) {
    const frame = Object.assign(document.createElement("iframe"), { hidden: true });
    document.body.append(frame);
    const scope = frame.contentWindow;
    const page = new EventTarget();
    const hand = (data, to) => to.dispatchEvent(new MessageEvent("message", { data }));
    const run = (src) =>
      new Promise((onload, onerror) => {
        scope.document.body.append(Object.assign(scope.document.createElement("script"), { src, onload, onerror }));
      });
    scope.importScripts = (...sources) => Promise.all(sources.map(run));
    scope.postMessage = (data) => hand(data, page);
    const started = run(url);
    page.postMessage = (data) => started.then(() => hand(data, scope));
    return page;
  };
}
