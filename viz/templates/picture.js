// The 3D view as a PNG file: what is drawn, with the title and the legend, without which colours say nothing.
"use strict";

/** Write the texts of a part of the page where they stand. @param scale of its letters on the page */
function drawTexts(context, root, left, top, scale = 1) {
  const walker = document.createTreeWalker(root, NodeFilter.SHOW_TEXT);
  const range = document.createRange();
  while (walker.nextNode()) {
    const text = walker.currentNode;
    if (!text.data.trim()) continue;
    range.selectNodeContents(text);
    const box = range.getBoundingClientRect();
    if (!box.width) continue; // hidden
    const { fontWeight, fontSize, fontFamily, color } = getComputedStyle(text.parentElement);
    context.font = `${fontWeight} ${scale * parseFloat(fontSize)}px ${fontFamily}`;
    context.fillStyle = color;
    context.fillText(text.data.trim(), box.left - left, (box.top + box.bottom) / 2 - top, box.width);
  }
}

/** Fill the place of an element with its background colour. */
function drawGround(context, node, left, top) {
  const box = node.getBoundingClientRect();
  context.fillStyle = getComputedStyle(node).backgroundColor;
  context.fillRect(box.left - left, box.top - top, box.width, box.height);
}

/** The legend: ground, bar of colours, marks, texts. */
function drawLegend(context, legend, left, top) {
  const scale = legend.getBoundingClientRect().width / legend.offsetWidth; // smaller in a frame of a report
  drawGround(context, legend, left, top);
  for (const bar of legend.querySelectorAll("canvas")) {
    const place = bar.getBoundingClientRect();
    if (place.width) context.drawImage(bar, place.left - left, place.top - top, place.width, place.height);
  }
  for (const mark of legend.querySelectorAll(".mark path")) {
    const box = mark.ownerSVGElement.getBoundingClientRect();
    const path = new Path2D();
    path.addPath(new Path2D(mark.getAttribute("d")), new DOMMatrix().translate(box.left - left, box.top - top).scale(scale));
    context.fillStyle = getComputedStyle(mark).fill;
    context.strokeStyle = getComputedStyle(mark).stroke;
    context.lineWidth = Number(mark.getAttribute("stroke-width"));
    context.fill(path);
    context.stroke(path);
  }
  const ghost = legend.querySelector("#legend-ghost i");
  if (ghost.offsetParent) drawGround(context, ghost, left, top);
  drawTexts(context, legend, left, top, scale);
}

/** The stage as a canvas, as large as the screen has points. */
function pictureOf(stage, title) {
  const page = document.getElementById("stage");
  const { left, top, width, height } = page.getBoundingClientRect();
  const scale = stage.viewer.renderer.getPixelRatio();
  const canvas = element("canvas", { width: Math.round(width * scale), height: Math.round(height * scale) });
  const context = canvas.getContext("2d");
  context.scale(scale, scale);
  context.textBaseline = "middle";
  const style = getComputedStyle(document.documentElement);
  const ground = context.createLinearGradient(0, 0, 0, height);
  ground.addColorStop(0, style.getPropertyValue("--sky").trim());
  ground.addColorStop(1, style.getPropertyValue("--ground").trim());
  context.fillStyle = ground;
  context.fillRect(0, 0, width, height);
  stage.viewer.render(); // a drawing buffer may be read only in the task that drew it
  const pane = stage.pane.getBoundingClientRect();
  context.drawImage(stage.viewer.renderer.domElement, pane.left - left, pane.top - top, pane.width, pane.height);
  for (const label of document.querySelectorAll("#labels span")) {
    if (label.offsetParent) drawGround(context, label, left, top);
  }
  drawTexts(context, document.getElementById("labels"), left, top);
  const legend = document.getElementById("legend");
  if (!legend.hidden) drawLegend(context, legend, left, top);
  context.font = `600 16px ${style.fontFamily}`;
  context.fillStyle = style.color;
  context.fillText(title, 16, 22, width - 32);
  return canvas;
}

/** Save the picture through the browser's download. */
function savePicture(stage, title, name) {
  pictureOf(stage, title).toBlob((data) => {
    const address = URL.createObjectURL(data);
    element("a", { href: address, download: `${name.replace(/[^\p{L}\p{N}._-]+/gu, "_")}.png` }).click();
    setTimeout(() => URL.revokeObjectURL(address), 10000);
  }, "image/png");
}
