"""Serial ports: a UART, a USB cable, a telemetry radio, a pseudo-terminal. A port that was
unplugged is reopened under its path."""

import contextlib
import errno
import glob
import os
import stat

import serial
from serial.tools import list_ports

from companion.clock import Clock
from companion.errors import LinkError
from companion.links.base import Backoff, log
from companion.links.stream import ByteStream, StreamLink
from companion.links.urls import AUTO_BAUD, Endpoint, is_usb
from companion.mavlink.codec import Decoder

try:
    import termios
except ImportError as error:
    raise LinkError(
        "serial links need Linux or macOS; on Windows use udpin:, tcp: or WSL"
    ) from error


BY_ID = "/dev/serial/by-id"
BAUDS = (57600, 115200, 921600, 460800, 230400, 500000, 1500000, 38400)
BAUD_TRIAL_US = 700_000
BAUD_TRIAL_BYTES = 60
BAUD_FRAMES = 2
WATCH_S = 0.1
"""Period at which the path of an absent device is checked."""
HANG_UP_S = 1.0
ABSENT = frozenset({errno.ENOENT, errno.ENODEV, errno.ENXIO})
BITS_PER_BYTE = 10
"""bits of a byte on the line, with start and stop bit"""


class _Port:
    """A port that pyserial configures and locks. Its file is read and written directly, which
    returns at once."""

    def __init__(self, device: str, baud: int) -> None:
        try:
            self._serial = serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True)
        except termios.error as error:  # not an OSError; seen when unplugged while opening
            raise OSError(*error.args) from error
        except ValueError as error:  # a baud rate that this hardware cannot do
            raise OSError(errno.EINVAL, str(error)) from error
        with contextlib.suppress(OSError, ValueError, NotImplementedError):
            self._serial.set_low_latency_mode(
                True
            )  # FTDI chips hold bytes back for 16 ms otherwise

    def fileno(self) -> int:
        return self._serial.fileno()

    def recv(self, size: int, /) -> bytes:
        return os.read(self._serial.fileno(), size)

    def send(self, data: bytes, /) -> int:
        return os.write(self._serial.fileno(), data)

    def close(self) -> None:
        self._serial.close()


class SerialLink(StreamLink):
    """A port that may disappear and return, also under another number: a USB device that was
    plugged in again is found by its name in /dev/serial/by-id. A missing port is waited for.

    With `AUTO_BAUD` the rates of `BAUDS` are tried in turn until whole MAVLink frames arrive.
    """

    def __init__(self, endpoint: Endpoint, clock: Clock) -> None:
        watching = Backoff(clock, first_s=WATCH_S, longest_s=HANG_UP_S)
        super().__init__(str(endpoint), clock, watching)
        self._endpoint = endpoint
        self._lasting: str | None = None
        self._bauds = _BaudSearch() if endpoint.number == AUTO_BAUD else None
        if endpoint.number != AUTO_BAUD and not is_usb(endpoint.address):
            self.bytes_per_s = endpoint.number / BITS_PER_BYTE
        try:
            self._connected(self._dial(0.0), "opened")
        except OSError as error:
            if error.errno not in ABSENT:
                raise LinkError(_explain(endpoint, error)) from error
            log.warning("%s; waiting for it", _explain(endpoint, error))

    def _dial(self, timeout_s: float) -> ByteStream:
        baud = self._bauds.baud if self._bauds else self._endpoint.number
        device = self._endpoint.address
        if self._lasting is not None and not os.path.exists(device):
            device = self._lasting
        try:
            port = _Port(device, baud)
        except OSError as error:
            if error.errno in ABSENT:
                self._retry.succeeded()  # looking for a path costs nothing: look often
            raise
        self._lasting = _lasting_name(device)
        return port

    def _read(self, stream: ByteStream, timeout_s: float) -> bytes:
        data = super()._read(stream, timeout_s)
        if self._bauds is not None and self._bauds.wrong(data, self._clock.now_us()):
            log.info("%s: no MAVLink yet, trying %d baud", self.url, self._bauds.baud)
            with contextlib.suppress(OSError):
                stream.close()
            self._stream = None
            self._retry.succeeded()
        return data


class _BaudSearch:
    """Search for the baud rate at which whole frames arrive."""

    def __init__(self) -> None:
        self._index = 0
        self._decoder = Decoder()
        self._since_us: int | None = None
        self._bytes = 0

    @property
    def baud(self) -> int:
        return BAUDS[self._index]

    def wrong(self, data: bytes, now_us: int) -> bool:
        """Whether bytes came for `BAUD_TRIAL_US` without two frames: the next rate is then due."""
        if not data:
            return False
        if self._since_us is None:
            self._since_us = now_us
        self._bytes += len(data)
        self._decoder.feed(data)
        if self._decoder.frames >= BAUD_FRAMES:  # and so from now on, until nothing fits any more
            self._restart(now_us)
            return False
        if now_us - self._since_us < BAUD_TRIAL_US or self._bytes < BAUD_TRIAL_BYTES:
            return False
        self._index = (self._index + 1) % len(BAUDS)
        self._restart(None)
        return True

    def _restart(self, since_us: int | None) -> None:
        self._decoder, self._since_us, self._bytes = Decoder(), since_us, 0


def serial_ports() -> list[str]:
    """The serial ports of this computer, those with permanent names first."""
    lasting = sorted(glob.glob(f"{BY_ID}/*"))
    return lasting + sorted(port.device for port in list_ports.comports())


def _lasting_name(device: str) -> str | None:
    """The permanent name of a device, which does not change with its number; None if it has
    none."""
    real = os.path.realpath(device)
    names = sorted(glob.glob(f"{BY_ID}/*"))
    return next((name for name in names if os.path.realpath(name) == real), None)


def _explain(endpoint: Endpoint, error: OSError) -> str:
    device = endpoint.address
    with contextlib.suppress(OSError):
        mode = os.stat(device).st_mode
        if stat.S_ISDIR(mode):
            return f"{endpoint}: {device} is a directory; name a serial port in it"
        if not stat.S_ISCHR(mode):
            return (
                f"{endpoint}: {device} is a file, not a serial port; to read a log use "
                "'kollsman replay'"
            )
    match error.errno:
        case errno.ENOENT | errno.ENODEV | errno.ENXIO:
            ports = ", ".join(serial_ports()) or "none, is the cable plugged in?"
            return f"{endpoint}: there is no {device}; serial ports here: {ports}"
        case errno.EACCES | errno.EPERM:
            return (
                f"{endpoint}: permission denied; sudo usermod -aG dialout $USER (join group "
                "dialout), log in again"
            )
        case errno.EAGAIN | errno.EBUSY:
            return (
                f"{endpoint}: in use by another program (ModemManager, a console, a ground "
                "station?); stop it"
            )
    return f"{endpoint}: cannot be used as a serial port ({error})"
