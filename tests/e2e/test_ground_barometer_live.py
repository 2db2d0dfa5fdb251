"""`kollsman run` with a ground barometer on a link of its own: real sockets, a simulated flight at
forty times real time that loses GNSS, and a station that fails."""

from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from companion.links import open_link
from companion.mavlink.texts import SPACING_US
from sim.flight import Flight, Progress
from sim.scenario import Scenario
from tests.live import Companion, free_port

SPEED = 40.0
TELLING_S = SPEED * 2.0
"""two seconds of the host's clock, in which a text is sent"""
SPACING_S = SPEED * SPACING_US * 1e-6
"""a text about the station is followed by the next one after this time at the earliest"""
OUTAGE_S, WORST_S = 200.0, 600.0
FALL_HPA = 31.0 * 12.0 * WORST_S / 3600.0 * 0.01
"""the largest change of the sea-level pressure in a year"""
JUMP_S, BACK_S, DEATH_S = 800.0, 850.0, 900.0
END_S = JUMP_S + 10.0 + SPACING_S + 2.0 * TELLING_S
SCENARIO = Scenario.model_validate(
    {
        "name": "falling",
        "summary": "Sea-level pressure falls by 5 m of air in ten minutes, without GNSS.",
        "aloft": {"altitude_amsl_m": 800},
        "ground_station": {"elevation_m": 320.0},
        "weather": {
            "pressure": [
                {"time_s": OUTAGE_S, "sea_level_hpa": 1004.0},
                {"time_s": OUTAGE_S + WORST_S, "sea_level_hpa": 1004.0 - FALL_HPA},
            ]
        },
        "faults": [{"fault": "outage", "start_s": OUTAGE_S, "duration_s": 9999.0}],
        "streams_hz": {"RAW_IMU": 10.0, "SCALED_PRESSURE": 5.0, "SIM_STATE": 0.0, "ATTITUDE": 0.0},
        "profile": [{"leg": "hold", "duration_s": END_S, "bank_deg": 5.0}],
    }
)


class Events:
    """What happens to the station, once each, and what is heard of the companion meanwhile."""

    def __init__(self, flight: Flight) -> None:
        assert flight.station is not None
        self.flight, self.station = flight, flight.station
        self.truth: list[tuple[int, float]] = []
        self.sent: dict[int, float] = {}
        """ALTITUDE by the time of its estimate: AMSL, m"""
        self._waiting = [(JUMP_S, self.jump), (BACK_S, self.back), (DEATH_S, self.die)]

    def __call__(self, progress: Progress) -> None:
        self.truth.append((progress.truth.time_us, progress.truth.altitude_amsl_m))
        altitude = self.flight.vehicle.heard.altitude
        if altitude is not None and altitude.time_usec > 0:
            self.sent[altitude.time_usec] = altitude.altitude_amsl
        while self._waiting and progress.time_s >= self._waiting[0][0]:
            self._waiting.pop(0)[1]()

    def jump(self) -> None:
        """Somebody moves it down 25 m, it boots again, and its radio sends junk."""
        self.station.barometer.bias_pa += 300.0
        self.station.reboot(self.flight.time_us)
        assert self.station.link is not None
        for size in range(1, 200):
            self.station.link.send(bytes((7 * n * n + size) % 251 for n in range(size)))

    def back(self) -> None:
        self.station.barometer.bias_pa -= 300.0

    def die(self) -> None:
        self.station.is_sending = False

    def errors_m(self, start_s: float, end_s: float) -> np.ndarray:
        """Errors of the ALTITUDE sent between two times."""
        times = [time_us for time_us, _ in self.truth]
        heights = [height_m for _, height_m in self.truth]
        sent = [(t, h) for t, h in sorted(self.sent.items()) if start_s <= t * 1e-6 < end_s]
        assert sent, "no ALTITUDE"
        return np.array([h - np.interp(t, times, heights) for t, h in sent])

    def told_s(self, text: str, since_s: float) -> float:
        """When a STATUSTEXT with this text came first after a time, s after it."""
        times = [
            time_us * 1e-6 - since_s
            for time_us, said in self.flight.vehicle.heard.texts
            if text in said and time_us * 1e-6 >= since_s
        ]
        assert times, (text, list(self.flight.vehicle.heard.texts))
        return times[0]


@pytest.mark.long
def test_a_station_on_a_link_of_its_own_and_its_failures(tmp_path: Path) -> None:
    """Expected Result: ten minutes without GNSS leave the height where it was, within a metre or
    so; a jump of the station is told in one line after 10 s, its death after 30 s or when the next
    text may go, and no ALTITUDE becomes wrong by them."""
    vehicle_port, station_port = free_port(), free_port()
    config = tmp_path / "companion.yaml"
    config.write_text(
        f"air: {{reference: 'udpin:127.0.0.1:{station_port}', reference_elevation_m: 320}}\n"
        "checkpoint: {period_s: 0}\nstreams: {request: false}\n"
    )
    with ExitStack() as stack:
        companion = stack.enter_context(
            Companion(f"udpin:127.0.0.1:{vehicle_port}", "--config", str(config))
        )
        links = [open_link(f"udpout:127.0.0.1:{port}") for port in (vehicle_port, station_port)]
        for link in links:
            stack.callback(link.close)
        flight = Flight(
            SCENARIO, links=links[:1], station_link=links[1], speed=SPEED, all_streams=True, seed=3
        )
        events = Events(flight)
        flight.run(events)
    shown = "\n".join(companion.lines)
    before_m = events.errors_m(OUTAGE_S - 60.0, OUTAGE_S).mean()
    drift_m = events.errors_m(OUTAGE_S, JUMP_S) - before_m
    assert drift_m.size > 0.9 * WORST_S, shown
    assert np.sqrt(np.mean(drift_m**2)) < 1.2
    assert np.abs(events.errors_m(JUMP_S, DEATH_S + 60.0) - before_m).max() < 3.0
    assert events.told_s("reference stepped: not used", JUMP_S) < 10.0 + TELLING_S
    assert events.told_s("reference barometer silent", DEATH_S + 30.0) < END_S - DEATH_S - 30.0
    assert "reference barometer: 9/190" in shown
