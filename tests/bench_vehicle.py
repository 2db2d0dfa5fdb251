"""A simulated vehicle that stands on the runway, and clients at the other ends of its memory
links."""

from pathlib import Path
from typing import Any

from companion.clock import ManualClock
from companion.config import validate
from companion.links.memory import MemoryLink, pair
from companion.mavlink.codec import Decoder, Encoder, mavlink
from sim.flight import Flight
from sim.scenario import Scenario

STANDING = {"name": "test", "summary": "of a test", "profile": [{"leg": "wait", "duration_s": 600}]}


class Client:
    """A ground station, or a companion, at the other end of a memory link."""

    def __init__(self, link: MemoryLink, system_id: int = 255, component_id: int = 190) -> None:
        self.link = link
        self._decoder = Decoder()
        self._encoder = Encoder(system_id, component_id)

    def send(self, message: Any) -> None:
        assert self.link.send(self._encoder.encode(message))

    def command(
        self,
        command: int,
        *parameters: float,
        target: tuple[int, int] = (1, 1),
        as_int: bool = False,
    ) -> None:
        values = [*parameters, *[0.0] * (7 - len(parameters))]
        if as_int:
            self.send(
                mavlink.MAVLink_command_int_message(
                    *target, 0, command, 0, 0, *values[:4], 0, 0, 0.0
                )
            )
        else:
            self.send(mavlink.MAVLink_command_long_message(*target, command, 0, *values))

    def messages(self, name: str | None = None) -> list[Any]:
        found: list[Any] = []
        while data := self.link.receive(0.0):
            found += [self._decoder.decode(frame) for frame in self._decoder.feed(data)]
        return [message for message in found if name is None or message.get_type() == name]


class Bench:
    """A flight that stands on the runway, and its clients. Time is simulated, nothing waits."""

    def __init__(self, clients: int = 1, tlog: Path | None = None, **options: Any) -> None:
        clock = ManualClock()
        ends = [pair(clock) for _ in range(clients)]
        self.clients = [Client(far) for _, far in ends]
        scenario = validate(STANDING | options.pop("scenario", {}), Scenario, "a test")
        self.flight = Flight(
            scenario, links=[near for near, _ in ends], tlog=tlog, clock=clock, **options
        )

    @property
    def client(self) -> Client:
        return self.clients[0]

    def fly(self, duration_s: float) -> None:
        end_us = self.flight.time_us + round(duration_s * 1e6)
        while self.flight.time_us < end_us:
            self.flight.tick()

    def answer(self, command: int, *parameters: float, **options: Any) -> Any:
        """The acknowledgement of a command, and the other messages that came with it."""
        self.client.messages()
        self.client.command(command, *parameters, **options)
        self.fly(0.01)
        messages = self.client.messages()
        acks = [message for message in messages if message.get_type() == "COMMAND_ACK"]
        assert len(acks) == 1
        return acks[0], [message for message in messages if message is not acks[0]]
