"""What a command says of its progress, in a log and on a terminal."""

import sys
import threading

import pytest

from skyline.cli.terminal import Terminal


class Log:
    """A log that says when it has so many lines."""

    def __init__(self, lines=1):
        self.text = ""
        self.is_full = threading.Event()
        self._lines = lines

    def write(self, text):
        self.text += text
        if self.text.count("\n") >= self._lines:
            self.is_full.set()

    def flush(self):
        pass

    def isatty(self):
        return False


@pytest.fixture
def log(monkeypatch):
    """Return a function that opens a log for standard error."""

    def opened(lines=1):
        log = Log(lines)
        monkeypatch.setattr(sys, "stderr", log)
        return log

    return opened


def in_log(log, every_s=0.01, steps=((0, 6), (3, 6))):
    """Return the first line of a log in which a step stays where it is."""
    opened = log()
    with Terminal(every_s=every_s).progress("matching photos") as step:
        for one in steps:
            step(*one)
        assert opened.is_full.wait(60.0)
    return opened.text.splitlines()[0]


def test_a_line_says_how_far_a_step_is_while_no_part_of_it_ends(log):
    line = in_log(log)
    assert line == "matching photos: 3 of 6, about 0 s left"


def test_the_rest_is_estimated_once_a_part_is_done(log):
    assert in_log(log, steps=((2, 6),)) == "matching photos: 2 of 6"


@pytest.mark.parametrize("steps", [(), ((0, 1),)])
def test_a_step_without_parts_is_named(log, steps):
    assert in_log(log, steps=steps) == "matching photos takes a while ..."


def test_a_step_says_it_again_and_again(log):
    opened = log(lines=3)
    with Terminal(every_s=0.001).progress("matching photos") as step:
        step(3, 6)
        assert opened.is_full.wait(60.0)
    assert set(opened.text.splitlines()) == {"matching photos: 3 of 6"}


def test_a_step_that_has_ended_says_nothing_more(log):
    opened = log()
    with Terminal(every_s=0.001).progress("matching photos") as step:
        step(6, 6)
        assert not opened.is_full.wait(0.1)
    assert opened.text == ""


def test_a_quiet_command_says_nothing_of_its_progress(log):
    opened = log()
    terminal = Terminal(every_s=0.001)
    terminal.is_quiet = True
    with terminal.progress("matching photos") as step:
        step(3, 6)
        assert not opened.is_full.wait(0.1)
    assert opened.text == ""


def test_a_terminal_shows_a_bar_and_results_above_it(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    terminal = Terminal()
    with terminal.progress("matching photos") as step:
        step(3, 6)
        terminal.line("photo.jpg")
        step(4, 6)
    printed = capsys.readouterr()
    assert printed.out == "photo.jpg\n"
    assert "4 of 6" in printed.err
