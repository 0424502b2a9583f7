"""A server to send requests to, and a page in a browser, for tests of the page."""

import base64
import http.client
import json
from contextlib import closing, contextmanager
from dataclasses import dataclass
from subprocess import Popen
from urllib.parse import urlsplit

from selenium.common.exceptions import StaleElementReferenceException
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait
from websockets.sync.client import connect

from skyline_bench import page

TIMEOUT_S = 240


@dataclass(frozen=True)
class Served:
    """A running server."""

    address: str
    process: Popen
    said: str = ""
    """The line that it has printed."""

    def ask(self, method, path, body=None, headers=None):
        """Return the status and the body of an answer, JSON read where it is JSON."""
        with closing(http.client.HTTPConnection(self.address, timeout=TIMEOUT_S)) as connection:
            connection.request(method, path, body, headers or {})
            answer = connection.getresponse()
            content = answer.read()
        if answer.headers.get_content_type() == "application/json":
            content = json.loads(content)
        return answer.status, content

    def begin(self):
        """Return the path of a new session."""
        status, said = self.ask("POST", "/session")
        assert status == 200
        return f"/session/{said['session']}"

    def upload(self, session, name, data):
        """Return the status and the record, or the error, of an upload."""
        return self.ask("POST", f"{session}/photos?name={name}", data)


SIZES = {"wide": (1280, 800), "tall": (800, 1100)}


@contextmanager
def serving(*arguments, port=0):
    """Run ``skyline serve``, by default on any free port."""
    with page.serving(*arguments, port=port) as (said, process):
        yield Served(urlsplit(page.address_in(said)).netloc, process, said)


TINY = b'{"fov_deg": 60}'


def ready(served, photo):
    """Return a session's path and the record of a photo in it."""
    session = served.begin()
    status, record = served.upload(session, "photo.jpg", photo.read_bytes())
    assert (status, record["state"]) == (200, "ready")
    return session, f"{session}/photos/{record['id']}"


def live(served, session, **options):
    """Open the live channel of a session."""
    return connect(f"ws://{served.address}{session}/live", open_timeout=TIMEOUT_S, **options)


def received(socket, kind):
    """Return the next message of a kind."""
    while True:
        message = json.loads(socket.recv(timeout=TIMEOUT_S))
        if message["type"] == kind:
            return message


POSE = {"lon": 10.3327, "lat": 46.7478, "heading_deg": 141, "fov_deg": 60, "eye_height_m": 2}


def look(path, pose=POSE, seq=1):
    return json.dumps({"type": "look", "photo": path.split("/")[-1], "pose": pose, "seq": seq})


_DROP = """
const [data, name, type] = arguments;
const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
const transfer = new DataTransfer();
transfer.items.add(new File([bytes], name, { type }));
for (const kind of ["dragenter", "dragover", "drop"]) {
  document.body.dispatchEvent(new DragEvent(kind, { bubbles: true, dataTransfer: transfer }));
}
"""
_MODULE = (
    "const done = arguments[arguments.length - 1]; import('/page/{}.js').then((it) => done({}));"
)


class Page:
    """The page in a browser."""

    def __init__(self, browser, server, size=(1280, 800)):
        self.browser, self.server = browser, server
        self.resize(*size)
        browser.get(f"http://{server.address}/")
        browser.execute_script("sessionStorage.clear(); localStorage.clear()")
        browser.get_log("browser")
        browser.get_log("performance")
        self.reload()

    def reload(self):
        """Load the page again, and wait until it is ready."""
        self.browser.get(f"http://{self.server.address}/")
        self.until(lambda: self.script("return document.documentElement.dataset.ready"))

    def resize(self, width, height):
        """Set what the page has of a screen."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)

    def script(self, code, *arguments):
        return self.browser.execute_script(code, *arguments)

    def of(self, module, code):
        """Return an expression of ``it``, one of the page's modules."""
        return self.browser.execute_async_script(_MODULE.format(module, code))

    def state(self, code):
        return self.of("state", f"(({code}) ?? null)".replace("state.", "it.state."))

    def until(self, true, timeout_s=TIMEOUT_S):
        return WebDriverWait(self.browser, timeout_s, poll_frequency=0.05).until(lambda _: true())

    def find(self, selector):
        return self.browser.find_element(By.CSS_SELECTOR, selector)

    def all(self, selector):
        return self.browser.find_elements(By.CSS_SELECTOR, selector)

    def click(self, selector):
        """Click an element, scrolled into view, that may be drawn anew meanwhile."""

        def clicked(_):
            element = self.find(selector)
            self.script("arguments[0].scrollIntoView({block: 'center'})", element)
            element.click()
            return True

        ignored = [StaleElementReferenceException]
        WebDriverWait(self.browser, TIMEOUT_S, 0.05, ignored_exceptions=ignored).until(clicked)

    def drop(self, path, kind="image/jpeg"):
        data = base64.b64encode(path.read_bytes()).decode()
        self.script(_DROP, data, path.name, kind)

    def open(self, path):
        """Drop a photo and wait until its skyline is drawn."""
        before = self.state("state.photo && state.photo.id")
        self.drop(path)
        self.until(lambda: self.state("state.photo && state.photo.id") != before)
        self.until(lambda: self.state("state.rows && state.rows.length"))
        self.until(lambda: not self.find("#busy").is_displayed())

    def on_photo(self, column, row):
        """Return where a pixel of the photo lies, from the middle of its canvas."""
        view = self.of("view", "({...it.view})")
        return (
            round((column + 0.5) * view["scale"] + view["left"] - view["width"] / 2),
            round((row + 0.5) * view["scale"] + view["top"] - view["height"] / 2),
        )

    def draw(self, tool, points, is_solved=True):
        """Draw a stroke with the mouse, and wait until the skyline is solved again, if it is."""
        self.find(f"#tools label:has([value={tool}])").click()
        canvas, count = self.find("#photo"), self.measured("stroke")
        chain = ActionChains(self.browser, duration=40)
        chain.move_to_element_with_offset(canvas, *self.on_photo(*points[0])).click_and_hold()
        for point in points[1:]:
            chain.move_to_element_with_offset(canvas, *self.on_photo(*point))
        chain.release().perform()
        if is_solved:
            self.until(lambda: self.measured("stroke") > count)

    def measured(self, name):
        """Return how often the page has measured the time of a thing."""
        return self.script("return performance.getEntriesByName(arguments[0]).length", name)

    def rows(self):
        """Return the rows of the photo's skyline, None where there is none."""
        return self.state("[...state.rows].map((row) => (Number.isNaN(row) ? null : row))")

    def type_into(self, selector, text):
        """Type a number into a field, and leave it."""
        self.script("arguments[0].scrollIntoView({block: 'center'})", self.find(selector))
        self.find(selector).clear()
        self.find(selector).send_keys(text, Keys.ENTER)

    def match(self):
        """Find the place, and wait for the answer."""
        self.click("#find")
        self.until(lambda: self.find("#answer").text)

    def drag(self, selector, right, down, steps=12):
        """Drag an element of the map with the mouse, when the map stands still."""
        self.script("arguments[0].scrollIntoView({block: 'center'})", self.find(selector))
        seen = [None] * 5

        def is_still():
            seen[:] = [*seen[1:], self.find(selector).rect]
            return all(one == seen[0] for one in seen)

        self.until(is_still)
        chain = ActionChains(self.browser, duration=30).click_and_hold(self.find(selector))
        for _ in range(steps):
            chain.move_by_offset(right / steps, down / steps)
        chain.release().perform()

    def press(self, *keys, times=1):
        """Press keys at whatever has the focus."""
        ActionChains(self.browser).send_keys(*keys * times).perform()

    def settled(self):
        """Wait until the skyline of the last pose is shown."""
        return self.until(lambda: self.state("state.sight && state.sight.median_gap_deg"))

    def messages(self):
        """Return the errors that are shown."""
        texts = "return [...document.querySelectorAll('.alert span')].map((one) => one.textContent)"
        return self.script(texts)

    def alerts(self):
        """Return the errors that are shown, and close them."""
        said = []
        for alert in self.all(".alert"):
            said.append(alert.find_element(By.TAG_NAME, "span").text)
            alert.find_element(By.TAG_NAME, "button").click()
        return said

    def asked_elsewhere(self):
        """Return addresses beyond the server that the page has asked for."""
        log = self.browser.get_log("performance")
        sent = (json.loads(entry["message"])["message"] for entry in log)
        asked = (one["params"] for one in sent if one["method"] == "Network.requestWillBeSent")
        urls = [one["request"]["url"] for one in asked]
        assert urls
        own = (f"http://{self.server.address}/", "blob:", "data:")
        return [url for url in urls if not url.startswith(own)]
