"""The live page of a log: options ``--http`` and ``--speed`` of ``kollsman replay``."""

import math
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.common_cli import read_speed
from companion.output import Output

if TYPE_CHECKING:
    from companion.replay.merged import Writer
    from companion.settings import CompanionSettings
    from companion.web.board import Board
    from companion.web.player import Player

LogHttpOption = Annotated[
    str | None,
    typer.Option(
        "--http",
        help="Show the log on the live page there, such as 127.0.0.1:8080, and stay until Ctrl-C.",
        metavar="HOST:PORT",
    ),
]
LogSpeedOption = Annotated[
    str,
    typer.Option("--speed", help="With --http: seconds of the log a real second, or max.",
                 metavar="X|max"),
]  # fmt: skip


class LogPage:
    """A live page that shows a log."""

    def __init__(self, board: "Board", speed: float, settings: "CompanionSettings") -> None:
        self._board, self._speed, self._settings = board, speed, settings
        self._player: Player | None = None

    def player(self, log: Path, onward: "Writer | None") -> "Player":
        """What shows `log`; it takes the frames of a replay, and hands them to `onward` too."""
        from companion.web.player import LogClock, Player

        clock = LogClock(self._speed)
        self._player = Player(log, self._board, self._settings, clock, onward)
        return self._player

    def stay(self) -> None:
        """Show the end of the log until Ctrl-C."""
        if self._player is not None:
            self._player.end()
        Output(2).line("the log has ended, and the page shows its end; Ctrl-C stops")
        try:
            while True:
                threading.Event().wait(3600.0)
        except KeyboardInterrupt:
            pass


@contextmanager
def log_page(
    http: str | None, speed: str, settings: "CompanionSettings"
) -> "Iterator[LogPage | None]":
    """The live page of a log until the end of the block; None where none is wanted.

    Raises `ConfigError` when it cannot be served, and `typer.BadParameter` for a wrong speed.
    """
    if http is None:
        yield None
        return
    try:
        pace = read_speed(speed)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--speed") from None
    from companion.web.server import serve

    with ExitStack() as stack:
        board, server = serve(http, settings.http, stack)
        Output(2).line(server.told)
        yield LogPage(board, math.inf if pace is None else pace, settings)
