"""What `kollsman run` shows on a terminal of 80 columns, elsewhere, and on one that hangs."""

import contextlib
import logging
import os
import time
from collections.abc import Iterator

import pyte
import pytest

from companion.health import Health
from companion.output import LogHandler, Output
from companion.status import Status
from companion.status_lines import Display, Lines, Objects, Reporter, reporter
from tests.live import drained

COLUMNS, ROWS = 80, 24


class Terminal:
    """A pseudo-terminal with an emulator on its far side."""

    def __init__(self) -> None:
        self.far, self.near = os.openpty()
        self.text = b""
        self._screen = pyte.Screen(COLUMNS, ROWS)
        self._stream = pyte.ByteStream(self._screen)

    def rows(self) -> list[str]:
        """What its user sees, without empty rows at the end."""
        data = drained(self.far)
        self.text += data
        self._stream.feed(data)
        return "\n".join(line.rstrip() for line in self._screen.display).rstrip().split("\n")

    def close(self) -> None:
        os.close(self.far)
        os.close(self.near)


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[Terminal]:
    for name in ("NO_COLOR", "FORCE_COLOR", "JUPYTER_COLUMNS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", str(COLUMNS))
    monkeypatch.setenv("LINES", str(ROWS))
    made = Terminal()
    yield made
    made.close()


@contextlib.contextmanager
def displayed(terminal: Terminal) -> Iterator[Display]:
    """A display on the terminal, with log lines going there too."""
    root = logging.getLogger()
    handler = LogHandler(Output(terminal.near))
    root.addHandler(handler)
    display = Display(Output(terminal.near))
    try:
        yield display
    finally:
        display.close()
        root.removeHandler(handler)


def status(altitude_m: float = 2387.5, **changes: object) -> Status:
    fields = {
        "health": Health.OK,
        "reason": "altitude good to 3.7 m; rates lowered by a program that is not heard here",
        "vehicle": "1/1 ArduPilot",
        "altitude_amsl_m": altitude_m,
        "altitude_sd_m": 3.7,
        "protection_level_m": 19.0,
        "climb_mps": 0.1,
        "rates_hz": {"pressure": 20.0, "gnss": 5.0, "imu": 50.0, "altitude": 10.0},
        "link": "open",
        "traffic": {"udpin:127.0.0.1:14550": {"1/1": {"frames": 90, "lost": 10, "jitter_s": 0}}},
        "rejected": {},
    }
    return Status(**(fields | changes))  # type: ignore[arg-type]


def settle() -> None:
    """The thread that draws has drawn."""
    time.sleep(0.4)


def test_the_status_is_redrawn_and_log_lines_stand_above_it(terminal: Terminal) -> None:
    with displayed(terminal) as display:
        for number in range(5):
            display.show(status(2000.0 + number))
            logging.getLogger("kollsman.test").warning("line %d: %s", number, "word " * 25)
            settle()
        rows = terminal.rows()
    assert [row for row in rows if not row.startswith(("[", " "))] == [
        "OK       altitude good to 3.7 m; rates lowered by a program that is not heard h…",
        "altitude   2004.0 m  sd  3.7  level 19   +0.1 m/s",
        "Hz       pressure 20  gnss 5  imu 50  altitude 10",
        "vehicle  1/1 ArduPilot | open  lost 10.0 %",
    ]
    lines = [row for row in rows if "line " in row]
    assert [row.split("line ")[1][:2] for row in lines] == ["0:", "1:", "2:", "3:", "4:"]
    assert all(row.startswith(f"[{time.strftime('%Y-%m-%d ')}") for row in lines)


def test_events_stand_above_and_the_last_status_stays(terminal: Terminal) -> None:
    with displayed(terminal) as display:
        display.event("http", "live page: http://127.0.0.1:8080/")
        display.show(status())
        settle()
        display.stopped("90 frames heard", ["flight.tlog"])
    rows = terminal.rows()
    assert rows[0] == "live page: http://127.0.0.1:8080/"
    assert rows[-2:] == ["stopped: 90 frames heard", "recorded flight.tlog"]
    assert sum("2387.5 m" in row for row in rows) == 1


def test_before_the_first_status_the_progress_of_the_start_is_shown(terminal: Terminal) -> None:
    with displayed(terminal) as display:
        settle()
        assert "starting, 0 s" in terminal.rows()[0]
        assert display.starting is not None
        display.starting.compiled = lambda: 12
        settle()
        assert "12 functions" in terminal.rows()[0]
    assert terminal.rows() == [""]


def test_no_color_is_obeyed(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    with displayed(terminal) as display:
        display.show(status())
        settle()
    terminal.rows()
    assert b"32mOK" in terminal.text
    terminal.text = b""
    monkeypatch.setenv("NO_COLOR", "1")
    with displayed(terminal) as display:
        display.show(status())
        settle()
    terminal.rows()
    assert b"OK  " in terminal.text
    assert b"32mOK" not in terminal.text


def test_a_terminal_that_hangs_stops_nobody(terminal: Terminal) -> None:
    """Nobody reads its far side: what it does not take is dropped."""
    with displayed(terminal) as display:
        started_s = time.monotonic()
        for number in range(60):
            display.show(status(number))
            logging.getLogger("kollsman.test").warning("line %d %s", number, "x" * 2000)
        assert time.monotonic() - started_s < 10.0
        terminal.rows()


def test_elsewhere_a_line_at_each_change_and_one_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 1000.0
    monkeypatch.setattr("companion.status_lines.time.monotonic", lambda: now_s)
    read, write = os.pipe()
    lines = Lines(Output(write))
    for second in range(180):
        now_s += 1.0
        health = Health.DEGRADED if second >= 100 else Health.OK
        lines.show(status(1000.0 + second, health=health))
    told = drained(read).decode().splitlines()
    assert [float(line.split()[1]) for line in told] == [1000.0, 1060.0, 1100.0, 1160.0]
    os.close(read)
    os.close(write)


def test_which_reporter_suits_which_output(terminal: Terminal) -> None:
    read, write = os.pipe()
    pipe, tty = Output(write), Output(terminal.near)
    assert type(reporter(pipe, as_json=False, is_quiet=False)) is Lines
    assert type(reporter(pipe, as_json=True, is_quiet=False)) is Objects
    assert type(reporter(tty, as_json=True, is_quiet=False)) is Objects
    assert type(reporter(tty, as_json=False, is_quiet=True)) is Reporter
    display = reporter(tty, as_json=False, is_quiet=False)
    assert type(display) is Display
    display.close()
    os.close(read)
    os.close(write)
