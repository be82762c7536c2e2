// What moves by itself: errors that become those of the other state, and the poses one after another, when asked to.
// Where the reader wants less motion, errors change at once and the poses begin slowly.
"use strict";

const MORPH_TIME = 1200; // [ms]
const USUAL_SPEED = 5; // poses per second
const CALM_SPEED = 1;

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

/** Goes from pose to pose. Poses are not blended: between two measured poses the loops would be open. */
class Player {
  /** @param advance shows the next pose */
  constructor(advance) {
    this.advance = advance;
    this.button = document.getElementById("play");
    this.speed = document.getElementById("speed");
    this.speed.value = wantsLessMotion() ? CALM_SPEED : USUAL_SPEED;
    this.timer = null;
    this.button.addEventListener("click", () => this.toggle());
    this.speed.addEventListener("change", () => { if (this.playing) this.schedule(); });
  }

  get playing() {
    return this.timer !== null;
  }

  toggle() {
    if (this.playing) this.pause();
    else if (!this.button.disabled) this.schedule();
    this.show();
  }

  pause() {
    clearTimeout(this.timer);
    this.timer = null;
    this.show();
  }

  schedule() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      this.schedule();
      this.advance();
    }, 1000 / Number(this.speed.value));
  }

  /** The button says what it does next; screen readers are not told every pose that goes by. */
  show() {
    this.button.textContent = this.playing ? "\u275a\u275a" : "\u25b6\ufe0e";
    this.button.title = `${this.playing ? "Pause" : "Play the poses"} (P)`;
    this.button.setAttribute("aria-label", this.playing ? "Pause" : "Play the poses");
    document.getElementById("pose-head").setAttribute("aria-live", this.playing ? "off" : "polite");
  }
}
