"""A page in the browser, and what the tests ask of it."""

import io

import numpy as np
from PIL import Image


class Tab:
    """A page in the browser and what it complained about or asked for."""

    def __init__(self, browser, size=(1200, 800), **options):
        still = {"reduced_motion": "reduce", **options}  # pictures are compared: only tests of motion want any
        self.context = browser.new_context(viewport={"width": size[0], "height": size[1]}, offline=True, **still)
        self.page = self.context.new_page()
        self.problems, self.requests = [], []
        self.page.on("console", lambda message: message.type == "error" and self.problems.append(message.text))
        self.page.on("pageerror", lambda error: self.problems.append(str(error)))
        self.page.on("dialog", lambda dialog: self.problems.append(dialog.message))
        self.page.on("request", lambda request: self.requests.append(request.url))

    def open(self, address, ready="body[data-ready]"):
        self.page.goto(address)
        self.page.wait_for_selector(ready, state="attached")
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


def slide(tab, name, value):
    """Set a slider to a step, as a hand does."""
    tab.page.locator(f"#{name}").evaluate(
        "(slider, value) => { slider.value = value; slider.dispatchEvent(new Event('input')); }", value
    )
