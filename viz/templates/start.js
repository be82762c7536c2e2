// Start the page, and follow the program that shows it, if it is live.
"use strict";

/** Take over the scene of the page that the program serves now; the camera stays. */
async function takeOver(controls) {
  const text = await (await fetch(window.location.href)).text();
  const page = new DOMParser().parseFromString(text, "text/html");
  controls.renew(JSON.parse(page.getElementById("scene").textContent));
}

/** Do what a live program sends; say so when it ends. */
function follow(controls) {
  const banner = document.getElementById("banner");
  const cockpit = new Cockpit();
  let taken = Promise.resolve(); // scenes follow each other
  const source = new EventSource("events");
  source.addEventListener("open", () => { banner.hidden = true; });
  source.addEventListener("error", () => {
    banner.textContent = "The program that showed this has ended. The picture stays as it is.";
    banner.hidden = false;
  });
  source.addEventListener("told", (event) => {
    cockpit.show(JSON.parse(event.data));
    if (controls.stage) controls.stage.resize();
  });
  source.addEventListener("reload", () => {
    taken = taken.then(() => takeOver(controls)).catch(() => { window.location.reload(); });
  });
  source.addEventListener("pose", (event) => {
    const row = JSON.parse(event.data);
    if (row < controls.table.n) controls.go(row);
  });
  source.addEventListener("joints", (event) => {
    taken = taken.then(() => controls.showLive(JSON.parse(event.data)));
  });
}

window.addEventListener("DOMContentLoaded", () => {
  const controls = new Controls(JSON.parse(document.getElementById("scene").textContent));
  window.calibrationViewer = controls;
  if (controls.scene.live) follow(controls);
  // two drawn frames later everything is on the screen
  requestAnimationFrame(() => requestAnimationFrame(() => { document.body.dataset.ready = "true"; }));
});
