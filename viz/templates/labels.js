// Names beside the frames. A name that has no room is left out; pointing at a frame shows the names of all that lie there.
"use strict";

const SAME_PLACE = 10; // frames this near to each other on the screen [px] are named together when pointed at
const REACH = 18; // how near to a frame one must point [px]

class FrameLabels {
  /**
   * @param container element that holds the labels
   * @param names of the frames
   * @param note element that says how many names have no room
   */
  constructor(container, names, note) {
    this.container = container;
    this.names = names;
    this.note = note;
    this.spans = names.map((name) => element("span", {}, name));
    this.pointed = element("span", { class: "pointed" });
    container.append(...this.spans, this.pointed);
    this.pointer = null;
    this.show(false);
  }

  show(visible) {
    this.visible = visible;
    this.container.hidden = !visible;
    this.note.textContent = "";
    if (visible && !this.sizes) {
      this.sizes = this.spans.map((span) => [span.offsetWidth, span.offsetHeight]);
    }
  }

  /** Put the labels beside the frames' places on the screen: [x, y] of each [px], null where it is not seen. */
  place(places, width, height, obstacles) {
    if (!this.visible) return;
    const taken = [...obstacles];
    let without = 0;
    this.spans.forEach((span, k) => {
      const box = places[k] && this.room(places[k], this.sizes[k], taken, width, height);
      span.hidden = !box;
      if (box) {
        taken.push(box);
        span.style.transform = `translate(${box[0].toFixed(1)}px, ${box[1].toFixed(1)}px)`;
      } else if (places[k]) {
        without += 1;
      }
    });
    this.note.textContent = without ? `Names without room (${without}): point at their frames` : "";
    this.point(places, width, height);
  }

  /** The first place around a frame where its label covers no other: [left, top, right, bottom], or null. */
  room([x, y], [w, h], taken, width, height) {
    for (const [left, top] of [[x + 7, y - h - 3], [x + 7, y + 3], [x - w - 7, y - h - 3], [x - w - 7, y + 3],
      [x - w / 2, y - h - 9], [x - w / 2, y + 9]]) {
      const box = [left, top, left + w, top + h];
      const inside = left >= 0 && top >= 0 && box[2] <= width && box[3] <= height;
      if (inside && taken.every((other) => box[0] >= other[2] || box[2] <= other[0] || box[1] >= other[3] || box[3] <= other[1])) {
        return box;
      }
    }
    return null;
  }

  /** Show all names at the frame that is pointed at. */
  point(places, width, height) {
    const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);
    let nearest = null;
    for (const place of this.pointer ? places.filter(Boolean) : []) {
      if (distance(place, this.pointer) <= REACH && (!nearest || distance(place, this.pointer) < distance(nearest, this.pointer))) {
        nearest = place;
      }
    }
    this.pointed.hidden = !nearest;
    if (!nearest) return;
    this.pointed.replaceChildren(...this.names.filter((_, k) => places[k] && distance(places[k], nearest) <= SAME_PLACE)
      .map((name) => element("div", {}, name)));
    const x = Math.min(nearest[0] + 14, width - this.pointed.offsetWidth);
    const y = Math.min(Math.max(nearest[1] - this.pointed.offsetHeight / 2, 0), height - this.pointed.offsetHeight);
    this.pointed.style.transform = `translate(${Math.max(x, 0).toFixed(1)}px, ${Math.max(y, 0).toFixed(1)}px)`;
  }
}
