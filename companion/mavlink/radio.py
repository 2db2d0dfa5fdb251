"""Signal of a telemetry radio, from its RADIO_STATUS (or ArduPilot's older RADIO).

The scale of signal and noise is the radio's own. That of SiK radios is 1.9 steps a dB:
``dBm = value / 1.9 - 127``.
"""

from dataclasses import asdict, dataclass

from companion.mavlink.codec import Frame, decode, mavlink

RADIOS = frozenset({mavlink.MAVLINK_MSG_ID_RADIO_STATUS, mavlink.MAVLINK_MSG_ID_RADIO})
UNKNOWN = 255


@dataclass(frozen=True)
class Radio:
    """One report of a radio. Signal and noise in the radio's units; None where it does not know."""

    rssi: int | None
    """signal strength at the radio that reports"""
    remote_rssi: int | None
    """signal strength at the other radio"""
    noise: int | None
    remote_noise: int | None
    receive_errors: int
    """since the radio started"""
    corrected: int
    """packets repaired since the radio started"""
    free_buffer_percent: int

    def as_dict(self) -> dict[str, int | None]:
        """For reports."""
        return asdict(self)


def radio_of(frame: Frame) -> Radio | None:
    """What a radio reports in `frame`; None when it is another message."""
    if frame.message_id not in RADIOS:
        return None
    message = frame.message or decode(frame)
    if message is None:
        return None

    def level(name: str) -> int | None:
        value = int(getattr(message, name))
        return None if value == UNKNOWN else value

    return Radio(
        level("rssi"),
        level("remrssi"),
        level("noise"),
        level("remnoise"),
        int(message.rxerrors),
        int(message.fixed),
        int(message.txbuf),
    )
