// What the reader does: sliders, boxes, keys, and clicks on points.
"use strict";

const FACTORS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];
const SIZES = [0.25, 0.35, 0.5, 0.7, 1, 1.4, 2, 3]; // of a point, beside the usual one

/** A slider over steps of a factor: shows it beside, and applies it. */
function factorSlider(id, steps, start, apply) {
  const slider = document.getElementById(id);
  slider.max = steps.length - 1;
  slider.show = (factor) => {
    slider.value = Math.max(0, steps.findIndex((listed) => listed >= factor));
    changed();
  };
  const changed = () => {
    const factor = steps[Number(slider.value)];
    document.getElementById(`${id}-text`).textContent = `\u00d7${factor}`;
    slider.setAttribute("aria-valuetext", `${factor} times`);
    apply(factor);
  };
  slider.addEventListener("input", changed);
  slider.show(start);
}

/** What every control changes. */
function wireControls(controls) {
  const on = (id, event, action) => document.getElementById(id).addEventListener(event, action);
  for (const state of ["before", "after"]) {
    on(`state-${state}`, "change", () => controls.become(state));
  }
  on("same-scale", "change", () => controls.applyState());
  on("part", "change", (event) => controls.showPart(Number(event.target.value)));
  factorSlider("vector-factor", FACTORS, controls.vectorFactors[controls.part][controls.vectorState()], (factor) => {
    controls.vectorFactors[controls.part][controls.vectorState()] = factor;
    controls.setMark("factor", factor);
    controls.noteFactors();
  });
  factorSlider("ghost-factor", FACTORS, controls.ghostFactor, (factor) => {
    controls.ghostFactor = factor;
    if (controls.stage) {
      controls.stage.ghostFactor = factor;
      controls.stage.showPose(controls.stage.pose);
    }
    controls.noteFactors();
  });
  factorSlider("point-size", SIZES, 1, (size) => {
    controls.setMark("size", size);
  });
  for (const id of ["show-vectors", "show-ghost", "show-robot", "show-decorations", "show-frames"]) {
    on(id, "change", () => controls.applyVisibility());
  }
  on("pose", "input", (event) => controls.go(controls.rows[Number(event.target.value)]));
  on("previous", "click", () => controls.step(-1));
  on("next", "click", () => controls.step(1));
  on("drive-back", "click", () => controls.go(controls.row));
  on("reset-camera", "click", () => controls.resetCamera());
  on("save-picture", "click", () => controls.savePicture());
  document.getElementById("save-picture").hidden = !controls.stage;
  for (const button of document.querySelectorAll("[data-view]")) {
    button.addEventListener("click", () => controls.lookFrom(button.dataset.view));
  }
  document.addEventListener("keydown", (event) => press(controls, event));
  wirePicking(controls);
}

/** A click on a point goes to its row. */
function wirePicking(controls) {
  if (!controls.stage) return;
  const { pane } = controls.stage; // the camera's controls capture the pointer there
  let start = null;
  pane.addEventListener("pointerdown", (event) => { start = [event.clientX, event.clientY]; });
  pane.addEventListener("pointerup", (event) => {
    if (!start || Math.hypot(event.clientX - start[0], event.clientY - start[1]) > 5 || !controls.stage.marks) return;
    const box = pane.getBoundingClientRect();
    const reach = event.pointerType === "touch" ? 24 : 12;
    const row = controls.stage.marks.pick(controls.stage.viewer.camera, event.clientX - box.left, event.clientY - box.top,
                                          box.width, box.height, reach);
    if (row < 0) return;
    controls.go(row);
    document.dispatchEvent(new CustomEvent("picked", { detail: row })); // the report around this page follows
  });
  // In a page that scrolls, the wheel belongs to the page until the reader has clicked here.
  if (document.body.classList.contains("embedded")) {
    window.addEventListener("wheel", (event) => { if (document.activeElement !== pane) event.stopImmediatePropagation(); }, true);
    pane.addEventListener("pointerdown", () => pane.focus());
  }
}

/** Arrow keys step through the poses unless a control of its own uses them. */
function press(controls, event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const target = event.target;
  const usesArrows = target.matches("input[type=range], input[type=radio], select");
  const toggles = { v: "show-vectors", g: "show-ghost", f: "show-frames" };
  const name = event.key.toLowerCase();
  if (!usesArrows && event.key === "ArrowLeft") controls.step(-1);
  else if (!usesArrows && event.key === "ArrowRight") controls.step(1);
  else if (!usesArrows && event.key === "Home" && controls.rows.length) controls.go(controls.rows[0]);
  else if (!usesArrows && event.key === "End" && controls.rows.length) controls.go(controls.rows[controls.rows.length - 1]);
  else if (name === "p") controls.player.toggle();
  else if (name === "b" && controls.scene.states.length > 1) {
    controls.become(controls.state === "before" ? "after" : "before");
  } else if (name === "r") controls.resetCamera();
  else if (name === "s") controls.savePicture();
  else if (name === "d") document.getElementById("dark").click();
  else if (name in toggles) {
    const box = document.getElementById(toggles[name]);
    box.checked = !box.checked;
    controls.applyVisibility();
  } else return;
  event.preventDefault();
}
