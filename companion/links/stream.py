"""Links over a byte stream that can end (serial, TCP): connect, read, detect the end, reconnect."""

import contextlib
from abc import abstractmethod
from typing import Protocol

from companion.clock import Clock
from companion.links.base import Backoff, BaseLink, HasFileno, log, readable

READ_SIZE = 4096
REDIAL_S = 1.0
"""Longest time until a peer that is back is connected, after failed attempts."""


class ByteStream(Protocol):
    """A connected, non-blocking byte stream. A `socket.socket` is one."""

    def fileno(self) -> int: ...
    def recv(self, size: int, /) -> bytes: ...
    def send(self, data: bytes, /) -> int: ...
    def close(self) -> None: ...


class StreamLink(BaseLink):
    """A link over one `ByteStream` at a time: connects, reads, detects the end, connects again. A
    transport defines `_dial`."""

    def __init__(self, url: str, clock: Clock, backoff: Backoff | None = None) -> None:
        super().__init__(url, clock)
        self._stream: ByteStream | None = None
        self._unsent = b""
        self._retry = backoff or Backoff(clock)

    @abstractmethod
    def _dial(self, timeout_s: float) -> ByteStream | None:
        """A connected stream; None when there is none after `timeout_s`. Raises OSError when this
        attempt failed."""

    def descriptors(self) -> list[HasFileno]:
        return [self._stream] if self._stream is not None else []

    def _connected(self, stream: ByteStream, who: str) -> None:
        self._stream = stream
        self._unsent = b""
        self._found(who)

    def _hang_up(self, why: object) -> None:
        if self._stream is not None:
            with contextlib.suppress(OSError):
                self._stream.close()
            self._stream = None
            self._retry.failed()  # also for a peer that accepts and hangs up, again and again
        self._lost(why)

    def _close(self) -> None:
        self._hang_up("closed")

    def _receive(self, timeout_s: float) -> bytes:
        deadline_us = self._clock.now_us() + round(timeout_s * 1e6)
        while self._stream is None:
            left_s = max(0.0, (deadline_us - self._clock.now_us()) / 1e6)
            wait_s = self._retry.wait_s()
            if wait_s <= 0.0:
                try:
                    stream = self._dial(left_s)
                except OSError as error:
                    log.debug("%s: %s", self.url, error)
                    self._retry.failed(REDIAL_S)
                    continue
                if stream is None:
                    return b""
                self._connected(stream, "connected")
            elif left_s <= 0.0:
                return b""
            else:
                self._clock.sleep_s(min(wait_s, left_s))
        return self._read(self._stream, max(0.0, (deadline_us - self._clock.now_us()) / 1e6))

    def _read(self, stream: ByteStream, timeout_s: float) -> bytes:
        try:
            if not readable(stream, timeout_s):
                return b""
            data = stream.recv(READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError as error:
            self._hang_up(error)
            return b""
        if data:
            self._retry.succeeded()
        else:
            self._hang_up("closed by the other end")
        return data

    def _send(self, data: bytes) -> bool:
        """Send all of `data` or none of it. Half a frame would also damage the next one, so a
        remainder that does not fit into the kernel's buffer is sent first at the next call."""
        if self._stream is None:
            return False
        try:
            if self._unsent:
                self._unsent = self._unsent[self._stream.send(self._unsent) :]
                if self._unsent:
                    return False
            self._unsent = data[self._stream.send(data) :]
        except BlockingIOError:
            return False
        except OSError as error:
            self._hang_up(error)
            return False
        return True
