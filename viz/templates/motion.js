// What moves by itself: errors that become those of the other state. Nothing does where the reader wants it still.
"use strict";

const MORPH_TIME = 1200; // [ms]

/** Whether the reader asked the system for less motion. */
function wantsLessMotion() {
  return window.matchMedia("(prefers-reduced-motion: reduce)").matches;
}

class Morph {
  /** @param show draws a part of the way, 0 to 1 */
  constructor(show) {
    this.show = show;
    this.part = 0;
    this.frame = null;
  }

  /** Go to a part of the way, gradually or at once. */
  to(goal, gradually) {
    cancelAnimationFrame(this.frame);
    this.frame = null;
    if (!gradually || wantsLessMotion()) this.draw(goal);
    else if (goal !== this.part) this.run(this.part, goal);
  }

  run(from, goal) {
    let start = null;
    const step = (now) => {
      start = start ?? now;
      const time = Math.min((now - start) / MORPH_TIME, 1);
      this.draw(from + (goal - from) * time * time * (3 - 2 * time)); // starts and ends gently
      this.frame = time < 1 ? requestAnimationFrame(step) : null;
    };
    this.frame = requestAnimationFrame(step);
  }

  draw(part) {
    this.part = part;
    this.show(part);
  }
}
