// Light or dark, as the system has it until the reader decides.
"use strict";

class Theme {
  /** @param shown is told the theme, "light" or "dark", whenever it changes */
  constructor(shown) {
    this.shown = shown;
    this.box = document.getElementById("dark");
    const system = window.matchMedia("(prefers-color-scheme: dark)");
    const follow = () => this.use(system.matches);
    system.addEventListener("change", follow);
    this.box.addEventListener("change", () => {
      system.removeEventListener("change", follow);
      this.use(this.box.checked);
    });
    follow();
  }

  use(dark) {
    this.box.checked = dark;
    document.documentElement.dataset.theme = dark ? "dark" : "light";
    this.shown(document.documentElement.dataset.theme);
  }
}
