import io
import threading
import time

import pytest

from logs.progress import unwatched, watch


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def shown(terminal: Terminal, text: str) -> bool:
    """Whether the text appears within five seconds."""
    until = time.monotonic() + 5.0
    while text not in terminal.getvalue():
        if time.monotonic() > until:
            return False
        time.sleep(0.002)
    return True


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    monkeypatch.setattr("logs.progress._PATIENCE_S", 0.002)
    return Terminal()


def test_counted_work_shows_its_share_and_uncounted_work_its_time(terminal: Terminal) -> None:
    with watch("robot", terminal) as progress:
        progress(3, 4, "reading")
        assert shown(terminal, "robot reading  75 % ")
        progress(0, 0, "solving")
        assert shown(terminal, "robot solving 00:0")
        progress(1, 8)
        assert shown(terminal, "robot  12 % ")


def test_the_line_is_gone_in_the_end_also_after_an_error(terminal: Terminal) -> None:
    def fail() -> None:
        with watch("robot", terminal) as progress:
            progress(1, 2)
            assert shown(terminal, "robot  50 % ")
            raise ValueError

    with pytest.raises(ValueError):
        fail()
    assert terminal.getvalue().rpartition("\r")[0].rstrip(" ").endswith("\r")  # blanks over it


def test_nothing_goes_on_drawing_after_the_end(terminal: Terminal) -> None:
    before = threading.active_count()
    with watch("robot", terminal):
        assert shown(terminal, "robot 00:0")
    assert threading.active_count() == before


def test_short_work_shows_nothing(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("logs.progress._PATIENCE_S", 60.0)
    with watch("robot", terminal) as progress:
        progress(1, 2)
        progress(0, 0, "solving")
    assert "robot" not in terminal.getvalue()


def test_nobody_watches_what_is_no_terminal() -> None:
    for stream in (None, io.StringIO()):
        with watch("robot", stream) as progress:
            assert progress is unwatched


def test_a_terminal_that_does_not_know_its_size_shows_progress(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "0")
    monkeypatch.setenv("LINES", "0")
    with watch("robot", terminal) as progress:
        progress(1, 2)
        assert shown(terminal, "robot  50 % ")
