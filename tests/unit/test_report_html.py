"""Pages hold their text escaped, and load nothing from any network."""

import base64
import re
from html.parser import HTMLParser

import cv2
import numpy as np

from skyline.report.html import figures, page, picture, section, table, text

HOSTILE = "<script>alert('x')</script> & \"quoted\" 'too'"
PNG = cv2.imencode(".png", np.zeros((4, 6, 3), np.uint8))[1].tobytes()
JPEG = cv2.imencode(".jpg", np.zeros((4, 6, 3), np.uint8))[1].tobytes()


class Reader(HTMLParser):
    """The tags of a page, their attributes and its text."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.links, self.text, self.open = [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [(name, value) for name, value in attrs if name in {"src", "href"}]
        if tag not in {"meta", "img"}:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def hostile_page(words=HOSTILE):
    parts = [
        text(words, "answer"),
        figures([picture(PNG, words), picture(JPEG, words, wide=False)]),
        table((words, "b"), [(words, 1.5), (None, 22)], words),
        table(("", ""), [[words, words]]),
    ]
    return page(words, words, [section(words, parts), section("empty", [])], words)


def test_every_text_is_escaped():
    html = hostile_page()
    seen = Reader(html)
    assert not seen.open
    assert "script" not in seen.tags
    assert seen.text.count(HOSTILE) == 13
    assert "<script>" not in html


def test_pictures_are_inside_and_nothing_is_outside():
    html = hostile_page()
    sources = Reader(html).links
    assert [name for name, _ in sources] == ["src", "src"]
    assert base64.b64decode(sources[0][1].removeprefix("data:image/png;base64,")) == PNG
    assert base64.b64decode(sources[1][1].removeprefix("data:image/jpeg;base64,")) == JPEG
    assert not re.search(
        r"https?:|//|url\(|@import|<link|<iframe", re.sub(r"base64,[^\"]*", "", html)
    )
    assert "default-src 'none'" in html


def test_a_table_shows_numbers_to_the_right_and_dashes_for_nothing():
    html = table(
        ("n", "text", "flag"), [(1 / 3, "a", True), (None, "2", False), ("-4.50", "x", None)]
    )
    assert "<th class=n>n</th><th>text</th><th>flag</th>" in html
    assert "<td class=n>0.333333</td><td>a</td><td>yes</td>" in html
    assert "<td class=n>–</td><td>2</td><td>no</td>" in html
    assert "<td class=n>-4.50</td><td>x</td><td>–</td>" in html
