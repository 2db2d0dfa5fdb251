"""The README's recipes, end to end: what arrives where a ground station sits, not what we send.

The simulated autopilot forwards as ArduPilot and PX4 do (nothing to a silent link, nothing back to
the sender); `Mavproxy` forwards as MAVProxy does.
"""

from collections import Counter

import pytest

from companion.clock import ManualClock
from companion.links.memory import MemoryLink, pair
from companion.mavlink.codec import Decoder, Encoder, mavlink
from companion.service import Service
from companion.settings import CompanionSettings
from tests.bench_vehicle import Bench

GCS_BEAT = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


class Mavproxy:
    """What the master brings goes to every output; what an output brings goes to the master only.
    It requests all streams at 4 Hz every 15 s unless told not to."""

    def __init__(
        self, master: MemoryLink, clock: ManualClock, outputs: int, streamrate: int
    ) -> None:
        self._master, self._clock, self._streamrate = master, clock, streamrate
        ends = [pair(clock) for _ in range(outputs)]
        self._near = [near for near, _ in ends]
        self.outputs = [far for _, far in ends]
        self._encoder = Encoder(255, 230)
        self._due_us = 0

    def pump(self) -> None:
        while data := self._master.receive(0.0):
            for output in self._near:
                output.send(data)
        for output in self._near:
            while data := output.receive(0.0):
                self._master.send(data)
        if self._clock.now_us() >= self._due_us:
            self._due_us = self._clock.now_us() + 15_000_000
            self._master.send(self._encoder.encode(GCS_BEAT))
            if self._streamrate > 0:
                request = mavlink.MAVLink_request_data_stream_message(1, 1, 0, self._streamrate, 1)
                self._master.send(self._encoder.encode(request))


class Station:
    """A ground station: what it hears, by sender and message."""

    def __init__(self, link: MemoryLink, clock: ManualClock) -> None:
        self._link, self._clock = link, clock
        self._decoder, self._encoder = Decoder(), Encoder(255, 190)
        self._due_us = 0
        self.heard: Counter[tuple[int, str]] = Counter()

    def pump(self) -> None:
        while data := self._link.receive(0.0):
            for frame in self._decoder.feed(data):
                message = self._decoder.decode(frame)
                assert message is not None
                self.heard[frame.component_id, message.get_type()] += 1
        if self._clock.now_us() >= self._due_us:
            self._due_us = self._clock.now_us() + 1_000_000
            self._link.send(self._encoder.encode(GCS_BEAT))


class Recipe:
    """A vehicle with two ports, and who is on them."""

    def __init__(self, flavour: str = "ardupilot") -> None:
        self.clock = ManualClock()
        self.bench = Bench(clients=2, flavour=flavour)
        self.ports = [client.link for client in self.bench.clients]
        self.proxy: Mavproxy | None = None
        self.service: Service | None = None
        self.station: Station | None = None

    def run(self, duration_s: float) -> None:
        assert self.station is not None
        assert self.service is not None
        for _ in range(round(duration_s * 100)):
            self.bench.flight.tick()
            self.clock.advance_s(0.01)
            if self.proxy is not None:
                self.proxy.pump()
            for _ in range(6):  # a memory link hands over one frame a turn
                self.service.turn(0.0)
            self.station.pump()

    def serve(self, link: MemoryLink) -> None:
        self.service = Service(link, CompanionSettings(), self.clock)

    def altitude_hz(self) -> float:
        """ALTITUDE of ours at the ground station, once all is settled."""
        self.run(50.0)
        assert self.station is not None
        before = self.station.heard[191, "ALTITUDE"]
        self.run(10.0)
        return (self.station.heard[191, "ALTITUDE"] - before) / 10.0


@pytest.mark.slow
@pytest.mark.parametrize("flavour", ["ardupilot", "copter", "generic"])
def test_on_a_second_port_of_the_autopilot(flavour: str) -> None:
    """`kollsman run tcp:127.0.0.1:5762`, the ground station on the first port."""
    recipe = Recipe(flavour)
    recipe.serve(recipe.ports[1])
    recipe.station = Station(recipe.ports[0], recipe.clock)
    assert recipe.altitude_hz() == pytest.approx(10.0, abs=0.5)
    assert recipe.service is not None
    assert recipe.service.status().reason.startswith("altitude good")
    assert "IMU" not in recipe.service.status().reason


@pytest.mark.slow
def test_on_a_second_port_beside_mavproxy() -> None:
    """SITL's first port is MAVProxy's, whose output the ground station hears."""
    recipe = Recipe()
    recipe.serve(recipe.ports[1])
    recipe.proxy = Mavproxy(recipe.ports[0], recipe.clock, 1, streamrate=4)
    recipe.station = Station(recipe.proxy.outputs[0], recipe.clock)
    assert recipe.altitude_hz() == pytest.approx(10.0, abs=0.5)


@pytest.mark.slow
def test_behind_an_output_of_mavproxy_only_the_autopilots_other_ports_hear_us() -> None:
    """The ground station on another output hears nothing of ours: the README says so."""
    recipe = Recipe()
    recipe.proxy = Mavproxy(recipe.ports[0], recipe.clock, 2, streamrate=-1)
    recipe.serve(recipe.proxy.outputs[0])
    recipe.station = Station(recipe.proxy.outputs[1], recipe.clock)
    assert recipe.altitude_hz() == 0.0
    recipe.station = Station(recipe.ports[1], recipe.clock)
    recipe.run(20.0)
    assert recipe.station.heard[191, "ALTITUDE"] > 150


@pytest.mark.slow
def test_px4_sends_altitude_itself_and_we_only_the_rest() -> None:
    recipe = Recipe("px4")
    recipe.serve(recipe.ports[1])
    recipe.station = Station(recipe.ports[0], recipe.clock)
    assert recipe.altitude_hz() == 0.0
    assert recipe.station.heard[1, "ALTITUDE"] > 500
    assert recipe.station.heard[191, "NAMED_VALUE_FLOAT"] > 100
