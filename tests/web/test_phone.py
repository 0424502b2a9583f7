"""The page on a phone, worked by finger, and what axe-core finds on it."""

from importlib.resources import files

import pytest
from pages import Page

PHONE = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}


class Phone(Page):
    """The page on a phone, which counts its taps."""

    def __init__(self, browser, server):
        self.taps = 0
        self.do("Emulation.setTouchEmulationEnabled", browser, enabled=True, maxTouchPoints=5)
        super().__init__(browser, server, (PHONE["width"], PHONE["height"]))

    def do(self, command, browser=None, **options):
        return (browser or self.browser).execute_cdp_cmd(command, options)

    def resize(self, width, height):
        self.do("Emulation.setDeviceMetricsOverride", **PHONE | {"width": width, "height": height})

    def middle(self, selector):
        """Return where an element's middle is in the window; it must be there."""
        self.script("return new Promise(requestAnimationFrame)")
        x, y, is_whole = self.script(
            "const box = document.querySelector(arguments[0]).getBoundingClientRect();"
            "return [(box.left + box.right) / 2, (box.top + box.bottom) / 2,"
            " box.top >= 0 && box.left >= 0 &&"
            " box.bottom <= innerHeight && box.right <= innerWidth]",
            selector,
        )
        assert is_whole, f"{selector} is out of view"
        return x, y

    def tap(self, selector):
        self.swipe(self.middle(selector), steps=0)
        self.taps += 1

    def swipe(self, *fingers, by=(0, 0), apart=0, steps=10):
        """Put fingers down, move them by a way and away from the first one, and lift them."""
        for count in range(1, len(fingers) + 1):
            self._touch("touchStart", fingers[:count])
        for step in range(1, steps + 1):
            share = step / steps
            places = [
                (x + share * (by[0] + rank * apart), y + share * by[1])
                for rank, (x, y) in enumerate(fingers)
            ]
            self._touch("touchMove", places)
        self._touch("touchEnd", [])

    def _touch(self, kind, places):
        points = [{"x": x, "y": y, "id": rank} for rank, (x, y) in enumerate(places)]
        self.do("Input.dispatchTouchEvent", type=kind, touchPoints=points)

    def in_colours(self, scheme):
        feature = {"name": "prefers-color-scheme", "value": scheme}
        self.do("Emulation.setEmulatedMedia", features=[feature])

    def found_by_axe(self):
        """Return what axe-core objects to, with the elements."""
        said = self.browser.execute_async_script(
            "axe.run().then((it) => arguments[0](it.violations))"
        )
        return [(one["id"], [node["html"] for node in one["nodes"]]) for one in said]


@pytest.fixture
def phone(chromium, served):
    """The page on a phone."""
    made = Phone(chromium, served)
    yield made
    made.do("Emulation.setTouchEmulationEnabled", enabled=False)
    made.do("Page.setInterceptFileChooserDialog", enabled=False)
    made.do("Emulation.setEmulatedMedia", features=[])


def test_three_taps_lead_from_a_photo_to_an_answer(phone, photo):
    phone.do("Page.setInterceptFileChooserDialog", enabled=True)
    phone.tap("#choose")
    phone.taps += 1  # on the photo in the phone's own picker
    phone.find("#files").send_keys(str(photo))
    phone.until(lambda: phone.state("state.rows && state.rows.length"))
    phone.until(lambda: not phone.find("#busy").is_displayed())
    phone.tap("#find")
    phone.middle("#cancel")
    phone.until(lambda: "Found" in phone.find("#answer").text)
    phone.middle("#answer")
    assert phone.taps == 3
    assert phone.script("return document.documentElement.scrollWidth") == PHONE["width"]
    order = phone.script(
        "return ['photo', 'find', 'answer', 'map', 'mend', 'save-trace'].map((id) =>"
        " document.getElementById(id).getBoundingClientRect().top)"
    )
    assert order == sorted(order)


TARGETS = """
return [...document.querySelectorAll("button, summary, .tools label, input:not([type=radio])")]
  .filter((one) => one.checkVisibility() && one.type !== "checkbox")
  .map((one) => [one.id || one.textContent, one.getBoundingClientRect().height])
  .filter(([, height]) => height < 44);
"""


def test_one_finger_scrolls_or_draws_two_zoom_and_axe_finds_nothing(phone, photo):
    phone.open(photo)
    x, y = phone.middle("#photo")

    def seen():
        return phone.script("return scrollY"), phone.of("view", "it.view.scale")

    _, scale = seen()
    phone.swipe((x - 40, y), (x, y), apart=40)
    phone.until(lambda: seen()[1] > 1.5 * scale)
    scrolled, scale = seen()
    assert scrolled == 0
    phone.swipe((x, y), by=(0, -150))
    phone.until(lambda: seen()[0] > 100)
    assert seen()[1] == scale
    phone.script("document.getElementById('mend').scrollIntoView()")
    phone.tap("#mend")
    x, y = phone.middle("#photo")
    phone.swipe((x, y), by=(40, 5))
    phone.until(lambda: phone.state("state.photo.strokes.length") == 1)
    phone.script("scrollTo(0, 0)")
    phone.match()
    phone.script("document.getElementById('known').open = true")
    assert phone.script(TARGETS) == []
    pytest.importorskip("axe_core_python", reason="axe-core is not installed (extra dev)")
    phone.script(files("axe_core_python").joinpath("axe.min.js").read_text())
    for scheme in ("light", "dark"):
        phone.in_colours(scheme)
        assert phone.found_by_axe() == []
