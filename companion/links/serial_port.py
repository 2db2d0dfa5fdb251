"""Serial ports: a UART, a USB cable, a telemetry radio, a pseudo-terminal. Unplugged, it is
reopened under its path."""

import contextlib
import errno
import glob
import os
import stat

import serial
from serial.tools import list_ports

from companion.clock import Clock
from companion.errors import LinkError
from companion.links.stream import ByteStream, StreamLink
from companion.links.urls import Endpoint, is_usb

try:
    import termios
except ImportError as error:
    raise LinkError(
        "serial links need Linux or macOS; on Windows use udpin:, tcp: or WSL"
    ) from error


BITS_PER_BYTE = 10
"""with start and stop bit"""


class _Port:
    """pyserial sets the port up and locks it; reading and writing its file directly takes what is
    there at once."""

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
    """A port that must be there at the start; afterwards it may go and come. Prefer
    /dev/serial/by-id/...: a replugged /dev/ttyACM0 can come back as ttyACM1."""

    def __init__(self, endpoint: Endpoint, clock: Clock) -> None:
        super().__init__(str(endpoint), clock)
        self._endpoint = endpoint
        if not is_usb(endpoint.address):
            self.bytes_per_s = endpoint.number / BITS_PER_BYTE
        try:
            self._connected(self._dial(0.0), "opened")
        except OSError as error:
            raise LinkError(_explain(endpoint, error)) from error

    def _dial(self, timeout_s: float) -> ByteStream:
        return _Port(self._endpoint.address, self._endpoint.number)


def serial_ports() -> list[str]:
    """The serial ports of this computer, those with lasting names first."""
    lasting = sorted(glob.glob("/dev/serial/by-id/*"))
    return lasting + sorted(port.device for port in list_ports.comports())


def _explain(endpoint: Endpoint, error: OSError) -> str:
    device = endpoint.address
    with contextlib.suppress(OSError):
        mode = os.stat(device).st_mode
        if stat.S_ISDIR(mode):
            return f"{endpoint}: {device} is a directory; name a serial port in it"
        if not stat.S_ISCHR(mode):
            return f"{endpoint}: {device} is a file, not a serial port; to read a log use 'kollsman replay'"
    match error.errno:
        case errno.ENOENT | errno.ENODEV | errno.ENXIO:
            ports = ", ".join(serial_ports()) or "none, is the cable plugged in?"
            return f"{endpoint}: there is no {device}; serial ports here: {ports}"
        case errno.EACCES | errno.EPERM:
            return f"{endpoint}: permission denied; sudo usermod -aG dialout $USER (join group dialout), log in again"
        case errno.EAGAIN | errno.EBUSY:
            return f"{endpoint}: in use by another program (ModemManager, a console, a ground station?); stop it"
    return f"{endpoint}: cannot be used as a serial port ({error})"
