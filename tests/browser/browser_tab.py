"""A page in the browser, and what the tests ask of it."""

import io

import numpy as np
from PIL import Image

SIZE = (960, 640)
"""Of a window [px]: where no graphics card draws the picture, its time goes with the number of points."""

SEEN = """() => { const v = calibrationViewer; const { stage } = v;
  const controls = [...document.querySelectorAll('input, select, button, details')];
  return JSON.stringify([document.body.innerText, document.documentElement.dataset.theme, innerWidth, innerHeight,
    controls.map((e) => [e.id, e.value, e.checked, e.open, e.disabled, e.hidden]), document.activeElement.id,
    [v.row, v.live, v.state, v.groups.shown, v.vectorFactors, v.ghostFactor, v.scene.title, v.player.playing],
    [v.morph.frame],
    stage && [stage.viewer.camera.position.toArray().map((x) => x.toFixed(9)), stage.root.children.length],
    stage && stage.marks && Object.values(stage.marks.uniforms).map((u) => u.value)]); }"""
"""What a page shows, and the state behind it."""

OUTSIDE = """v.scene.view.outline.filter(([x, y, z]) => { const p = new v.stage.THREE.Vector3(x, z, -y)
  .project(v.stage.viewer.camera); return Math.abs(p.x) > 1 || Math.abs(p.y) > 1; }).length"""
"""How many corners of the scene the picture does not show."""

FIRST = """() => { const controls = [...document.querySelectorAll('input, select, details')];
  const marked = (e) => e.matches('[type=checkbox], [type=radio]');
  window.firstControls = controls.map((e) => [e, e.tagName === 'DETAILS' ? e.open : marked(e) ? e.checked : e.value]);
  window.firstPlaying = calibrationViewer.player.playing;
  document.getElementById('dark').addEventListener('change', () => { window.themeDecided = true; }); }"""

BACK = """() => { const v = calibrationViewer;
  v.player.pause();
  for (const [control, first] of firstControls) {
    if (control.tagName === 'DETAILS') control.open = first;
    else if (control.id === 'pose' || control.closest('#drive-block')) continue; // these follow the pose
    else if (control.type === 'checkbox') { if (control.checked !== first) control.click(); }
    else if (control.type === 'radio') { if (first && !control.checked) control.click(); }
    else if (control.value !== first) {
      control.value = first;
      control.dispatchEvent(new Event(control.tagName === 'SELECT' ? 'change' : 'input'));
    }
  }
  document.activeElement.blur();
  for (const scrolled of document.querySelectorAll('*')) if (scrolled.scrollTop) scrolled.scrollTop = 0;
  v.go(0);
  v.resetCamera();
  return !window.themeDecided; }"""


class Tab:
    """A page in the browser and what it complained about or asked for."""

    def __init__(self, browser, size=SIZE, **options):
        still = {"reduced_motion": "reduce", **options}  # pictures are compared: only tests of motion want any
        self.context = browser.new_context(viewport={"width": size[0], "height": size[1]}, offline=True, **still)
        self.page = self.context.new_page()
        self.problems, self.requests, self.first = [], [], None
        self.page.on("console", lambda message: message.type == "error" and self.problems.append(message.text))
        self.page.on("pageerror", lambda error: self.problems.append(str(error)))
        self.page.on("dialog", lambda dialog: self.problems.append(dialog.message))
        self.page.on("request", lambda request: self.requests.append(request.url))

    def __enter__(self):
        return self

    def __exit__(self, *ended):
        self.context.close()
        assert ended[0] or self.problems == []

    def open(self, address, ready="body[data-ready]"):
        self.first = None
        self.page.goto(address)
        self.page.wait_for_selector(ready, state="attached")
        return self

    def empty(self):
        """Show nothing; the next test opens its page again."""
        self.first = None
        self.page.goto("about:blank")

    def like_new(self, address):
        """Open a viewer's page, or where it is open already bring it back to how it was at first: much quicker.

        Where anything is left over that a reader could see, the page is loaded again.
        """
        self.problems.clear()
        if self.first is not None and self.page.url == address:
            motion = self.page.evaluate("matchMedia('(prefers-reduced-motion: reduce)').matches")
            self.page.emulate_media(color_scheme="light", reduced_motion="reduce")
            self.page.mouse.move(0, 0)
            untouched = self.page.evaluate(BACK)
            self.drawn()
            if not motion:
                self.page.emulate_media(reduced_motion="no-preference")
            if untouched and self.page.evaluate(SEEN) == self.first:
                return self
        self.open(address)
        self.page.evaluate(FIRST)
        self.drawn()
        self.first = self.page.evaluate(SEEN)
        return self

    def drawn(self):
        """Wait until a new picture is on the screen."""
        self.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def state(self, expression):
        return self.page.evaluate(f"() => {{ const v = calibrationViewer; return {expression}; }}")

    def picture(self):
        """The 3D picture as an array (height, width, 3)."""
        self.drawn()
        with Image.open(io.BytesIO(self.page.locator("#pane").screenshot())) as image:
            return np.asarray(image.convert("RGB")).astype(int)

    def changed(self, action, *arguments):
        """Share of the picture's points that an action changes visibly."""
        before = self.picture()
        action(*arguments)
        return float(np.mean(np.abs(self.picture() - before).max(axis=2) > 24))


def wait(tab, condition):
    """Wait until a condition on the viewer `v` holds."""
    tab.page.wait_for_function(f"() => {{ const v = calibrationViewer; return {condition}; }}", timeout=10000)


def slide(tab, name, value):
    """Set a slider to a step, as a hand does."""
    tab.page.locator(f"#{name}").evaluate(
        "(slider, value) => { slider.value = value; slider.dispatchEvent(new Event('input')); }", value
    )
