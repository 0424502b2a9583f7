"""What a command says of its progress, in a log and on a terminal."""

import sys
import threading

import pytest

from skyline.cli.terminal import Terminal


class Log:
    """A log that says when it has some words so many times."""

    def __init__(self, words, times=1):
        self.text = ""
        self.has_it = threading.Event()
        self._words = words
        self._times = times

    def write(self, text):
        self.text += text
        if self.text.count(self._words) >= self._times:
            self.has_it.set()

    def flush(self):
        pass

    def isatty(self):
        return False


@pytest.fixture
def log(monkeypatch):
    """Return a function that opens a log for standard error."""

    def opened(words, times=1):
        log = Log(words, times)
        monkeypatch.setattr(sys, "stderr", log)
        return log

    return opened


def says(log, words, steps, times=1):
    """Return whether a step that stays where it is says some words so many times."""
    opened = log(words, times)
    with Terminal(every_s=0.01).progress("matching photos") as step:
        for one in steps:
            step(*one)
        return opened.has_it.wait(60.0)


def test_a_line_says_how_far_a_step_is_again_and_again_while_no_part_of_it_ends(log):
    assert says(log, "matching photos: 3 of 6, about 0 s left\n", [(0, 6), (3, 6)], times=3)


def test_the_rest_is_estimated_once_a_part_is_done(log):
    assert says(log, "matching photos: 2 of 6\n", [(2, 6)])


@pytest.mark.parametrize("steps", [[], [(0, 1)]])
def test_a_step_without_parts_is_named_once(log, steps):
    opened = log("takes a while ...\n")
    with Terminal(every_s=0.001).progress("matching photos") as step:
        for one in steps:
            step(*one)
        assert opened.has_it.wait(60.0)
    assert opened.text == "matching photos takes a while ...\n"


def quiet(terminal):
    terminal.is_quiet = True


@pytest.mark.parametrize(("change", "done"), [(lambda _: None, 6), (quiet, 3)])
def test_a_step_that_has_ended_or_a_quiet_command_says_nothing(log, change, done):
    opened = log("matching photos: ")
    terminal = Terminal(every_s=0.01)
    change(terminal)
    with terminal.progress("matching photos") as step:
        step(done, 6)
        assert not opened.has_it.wait(0.1)


def terminal_of(monkeypatch):
    """Return a terminal whose standard error is one."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    return Terminal()


def test_a_terminal_names_a_step_at_once(monkeypatch, capsys):
    with terminal_of(monkeypatch).slow("opening a [b] {c}"):
        pass
    assert "opening a [b] {c}" in capsys.readouterr().err


def test_a_terminal_shows_a_bar_and_results_above_it(monkeypatch, capsys):
    terminal = terminal_of(monkeypatch)
    with terminal.progress("matching photos") as step:
        step(3, 6)
        terminal.line("photo.jpg")
        step(4, 6)
    printed = capsys.readouterr()
    assert printed.out == "photo.jpg\n"
    assert "4 of 6" in printed.err
