"""A ground station beside the runway: it sends HEARTBEAT and SCALED_PRESSURE of its own barometer.

It stands at the beginning of the runway, in the same weather as the aircraft. Its system id, its
sensor and its noise are its own: the random streams are keyed by its name, so the vehicle's samples
are the same with and without it. Its frames go out on a link of its own, or else as the vehicle's
router forwards them: to every link from which something was heard. The log has them in any case.
"""

from typing import Annotated, Literal

from pydantic import Field

from companion.config import Settings
from companion.links import Link
from companion.mavlink.codec import Encoder, Message, mavlink
from sim.constants import ZERO_CELSIUS_K
from sim.sensors.barometer import Barometer, BarometerConfig
from sim.weather import Weather

BEAT_US = 1_000_000
GCS_COMPONENT_ID = 190
_READS_PER_TICK = 32


class GroundStationConfig(Settings):
    """Section ``ground_station`` of a scenario: leave it out for no station."""

    system_id: Annotated[int, Field(ge=2, le=255)] = 9
    """MAVLink system id of the station"""
    elevation_m: Annotated[float, Field(ge=-400.0, le=5000.0)] | None = None
    """true elevation of the station's barometer above mean sea level; left out, the runway's"""
    rate_hz: Literal[1, 2, 5, 10] = 1
    """pressures sent a second"""
    barometer: BarometerConfig = BarometerConfig(warming_k=5.0)
    """its sensor; a `rate_hz` of its own has no effect"""


class GroundStation:
    """Sends the messages that are due; `link` is its own, open, and closed by the caller."""

    def __init__(
        self,
        config: GroundStationConfig,
        weather: Weather,
        runway_m: float,
        seed: int,
        link: Link | None = None,
    ) -> None:
        self.config = config
        self.elevation_m = runway_m if config.elevation_m is None else config.elevation_m
        self.link = link
        self.is_sending = True
        """False while the station is dead"""
        self.barometer = Barometer(
            config.barometer.model_copy(update={"rate_hz": None}), seed, config.rate_hz, "station"
        )
        self._weather = weather
        self._booted_us = 0
        self._encoder = Encoder(config.system_id, GCS_COMPONENT_ID)

    def reboot(self, time_us: int) -> None:
        """Its boot clock and its sequence numbers start anew at `time_us`."""
        self._booted_us = time_us
        self._encoder = Encoder(self.config.system_id, GCS_COMPONENT_ID)

    def measures_after(self, time_us: int) -> int:
        """The time of its next reading after `time_us`."""
        period_us = self.barometer.period_us
        return (time_us // period_us + 1) * period_us

    def frames(self, time_us: int) -> list[bytes]:
        """What is due at this time; on a link of its own it is sent, too."""
        found: list[Message] = []
        if time_us % self.barometer.period_us == 0:
            pressure = self.barometer.measure(
                time_us, *self._weather.station_air(time_us * 1e-6, self.elevation_m)
            )
            die_cdegc = round((pressure.die_temperature_k - ZERO_CELSIUS_K) * 100.0)
            boot_ms = (time_us - self._booted_us) // 1000
            found.append(
                mavlink.MAVLink_scaled_pressure_message(
                    boot_ms, pressure.pressure_pa * 0.01, 0.0, die_cdegc
                )
            )
        if time_us % BEAT_US == 0:
            found.append(
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0,
                    mavlink.MAV_STATE_ACTIVE, 3,
                )
            )  # fmt: skip
        if not self.is_sending:
            return []
        frames = [self._encoder.encode(message) for message in found]
        if self.link is not None:
            self._serve(self.link, frames)
        return frames

    def _serve(self, link: Link, frames: list[bytes]) -> None:
        """Send; what its peer says needs no answer."""
        for frame in frames:
            link.send(frame)
        for _ in range(_READS_PER_TICK):
            if not link.receive(0.0):
                break
