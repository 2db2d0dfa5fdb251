"""The vehicle's side of a flight: its sensors measure, it takes their samples, and it sends.

A flight makes a `Moment` at every tick: what the sensors can feel, and what the autopilot did.
`Onboard.tick` takes one. Nothing here acts on the aircraft, so moments may be taken later than they
were flown, in their order (`Flight` says when).
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from companion.links import Link
from companion.logs.tlog import TlogWriter, record
from companion.samples import Packet
from sim import BOOT_UNIX_US, TICK_US
from sim.aircraft_state import Flow, Motion, Truth
from sim.faults.injector import FaultInjector
from sim.ground_station import GroundStation
from sim.pilot.autopilot import UPDATE_HZ
from sim.scenario import Scenario
from sim.sensors.barometer import Barometer
from sim.sensors.gnss import Fix, GnssReceiver
from sim.sensors.imu import Imu
from sim.sensors.thermometer import Thermometer
from sim.vehicle.ardupilot import HYGROMETER_ID
from sim.vehicle.flavours import Flavour
from sim.vehicle.own_estimate import OwnEstimate
from sim.vehicle.ports import Port
from sim.vehicle.truth import TRUE_AIR
from sim.vehicle.vehicle import Vehicle

MOTION_US = 1_000_000 // UPDATE_HZ
"""interval of truth, autopilot and the fastest IMU: every second tick"""
_READS_PER_TICK = 32
"""Largest number of datagrams that a link reads in a tick, so that a flood does not stop the
flight."""


class Moment(NamedTuple):
    """What the sensors feel at the end of one tick, and what happened in it; None where nothing is
    due."""

    time_us: int
    truth: Truth | None = None
    motion: Motion | None = None
    """mean motion since the last IMU sample"""
    throttle: float = 0.0
    """commanded throttle, 0 to 1"""
    events: Sequence[Callable[[], None]] = ()
    """calls of the vehicle's methods: armed, a new leg"""
    air: tuple[float, float] | None = None
    """static pressure (Pa) and air temperature (K)"""
    flow: Flow | None = None
    """air flow, for a barometer that feels it"""


new_moment: Callable[[tuple[Any, ...]], Moment] = partial(tuple.__new__, Moment)
"""`Moment` of a tuple, without the Python code of its constructor"""


class Onboard:
    """Sensors, vehicle, ports, links and log of one flight.

    `links` are open; the caller closes them. `close` closes the log.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        face: Flavour,
        *,
        links: Sequence[Link] = (),
        tlog: Path | None = None,
        all_streams: bool = False,
        on_fix: Callable[[Fix], None] | None = None,
        station: GroundStation | None = None,
    ) -> None:
        sensors = scenario.sensors
        self.barometer = Barometer(sensors.barometer, seed, face.baro_hz)
        self.gnss = GnssReceiver(sensors.gnss, seed, scenario.runway.elevation_m)
        self.imu = Imu(sensors.imu, seed)
        self.thermometer = Thermometer(sensors.thermometer, seed)
        self.air_period_us = math.gcd(self.barometer.period_us, self.thermometer.period_us)
        """interval at which a sensor samples the air"""
        self.received_bytes = 0
        self._scenario, self._seed = scenario, seed
        self._on_fix, self._station = on_fix, station
        self._injectors: list[FaultInjector] = []
        self._writer = TlogWriter(tlog) if tlog is not None else None
        self._records: list[bytes] = []
        """records that wait for the log until the end of a call"""
        self.vehicle = Vehicle(
            OwnEstimate(sensors.estimate, seed, MOTION_US * 1e-6, face.raise_time_s),
            self._record if self._writer else None,
            face,
        )
        self._links = [
            (link, self._port(link.url, self._delivery(link), face, all_streams)) for link in links
        ]
        self._log_port: Port | None = None
        if self._writer is not None:
            self._log_port = self._port(str(tlog), self._delivery(None), face, full=True)

    def take(self, moments: Sequence[Moment]) -> None:
        """Take moments in order, and the ticks between them at which something is sent."""
        for moment in moments:
            between_us = self.vehicle.state.time_us + TICK_US
            while between_us < moment.time_us:
                if self._is_due(between_us):
                    self._tick(Moment(between_us))
                between_us += TICK_US
            self._tick(moment)
        self._write()

    @property
    def reads_weather_us(self) -> float:
        """When the truth of the air is sent next, or the ground station measures: both read the
        weather of that time."""
        due_us = [port.due_of(TRUE_AIR.message_id) for port in self.vehicle.ports]
        if self._station is not None:
            due_us.append(self._station.measures_after(self.vehicle.state.time_us))
        return min(due_us, default=math.inf)

    def _is_due(self, now_us: int) -> bool:
        """Whether a fix arrives, a message is due, or faults may hold packets."""
        if self._injectors or self.gnss.arrives_us <= now_us:
            return True
        return any(port.due_us <= now_us for port in self.vehicle.ports)

    def tick(self, moment: Moment) -> None:
        """Measure, receive and send at a moment; call it with every moment in order."""
        self._tick(moment)
        self._write()

    def _tick(self, moment: Moment) -> None:
        now_us, truth, motion, throttle, events, air, flow = moment
        vehicle = self.vehicle
        state = vehicle.state
        state.time_us = now_us
        if truth is not None:
            state.truth, state.throttle = truth, throttle
            for event in events:
                event()
            if motion is not None:
                state.motion, state.imu = motion, self.imu.measure(now_us, motion)
            if now_us % self.gnss.period_us == 0:
                self.gnss.measure(truth)
            state.attitude_rad = vehicle.estimate.attitude(truth)
            state.position = vehicle.estimate.position(now_us)
        if air is not None:
            self._feel(now_us, air, flow)
        if self.gnss.arrives_us <= now_us and (fix := self.gnss.deliver(now_us)) is not None:
            vehicle.on_fix(fix)
            if self._on_fix is not None:
                self._on_fix(fix)
        for link, port in self._links:
            self._receive(link, port)
        if self._station is not None:
            self._pass_on(self._station.frames(now_us))
        vehicle.stream()
        for injector in self._injectors:
            injector.due(BOOT_UNIX_US + now_us)

    def _feel(self, now_us: int, air: tuple[float, float], flow: Flow | None) -> None:
        if now_us % self.barometer.period_us == 0:
            self.vehicle.on_pressure(self.barometer.measure(now_us, *air, flow))
        if now_us % self.thermometer.period_us == 0:
            self.vehicle.state.air_temperature_k = self.thermometer.measure(air[1])

    def _pass_on(self, frames: Sequence[bytes]) -> None:
        """Forward frames of the ground station, to the log alone if it has a link of its own."""
        assert self._station is not None
        for port in self.vehicle.ports:
            if port is self._log_port or (port.heard and self._station.link is None):
                for frame in frames:
                    port.forward(frame)

    def _receive(self, link: Link, port: Port) -> None:
        for _ in range(_READS_PER_TICK):
            if not (data := link.receive(0.0)):
                break
            self.received_bytes += len(data)
            self.vehicle.receive(port, data)

    # Where telemetry goes

    def finish(self) -> None:
        """Deliver what faults still delay."""
        for injector in self._injectors:
            injector.due(math.inf)
        self._write()

    def close(self) -> None:
        """Close the log."""
        if self._writer is not None:
            self._write()
            self._writer.close()

    def _port(self, name: str, deliver: Callable[[bytes], bool], face: Flavour, full: bool) -> Port:
        """A port of the vehicle's, with the scenario's rates or the flavour's."""
        rates_hz = self._scenario.streams_hz if full else {}
        absent = () if self.thermometer.config.fitted else (HYGROMETER_ID,)
        port = Port(name, deliver, rates_hz, full=full, flavour=face, absent=absent)
        self.vehicle.add_port(port)
        return port

    def _delivery(self, link: Link | None) -> Callable[[bytes], bool]:
        """The delivery of a port's frames to `link`, or to the log, through the scenario's
        faults."""
        if not self._scenario.faults:
            return self._log() if link is None else link.send
        deliver = self._log_packet if link is None else lambda packet: link.send(packet.data)
        injector = FaultInjector(self._scenario.faults, self._seed, self._unix_us, deliver)
        self._injectors.append(injector)
        return injector

    def _unix_us(self) -> int:
        return BOOT_UNIX_US + self.vehicle.state.time_us

    def _log(self) -> Callable[[bytes], bool]:
        """The delivery of a frame to the log."""
        state, append = self.vehicle.state, self._records.append

        def log(frame: bytes) -> bool:
            append(record(BOOT_UNIX_US + state.time_us, frame))
            return True

        return log

    def _write(self) -> None:
        """Write what waits for the log."""
        if self._records and self._writer is not None:
            self._writer.write_records(b"".join(self._records), self._unix_us())
            self._records.clear()

    def _log_packet(self, packet: Packet) -> bool:
        self._records.append(record(packet.time_us, packet.data))
        return True

    def _record(self, time_us: int, frame: bytes) -> None:
        """Log a frame that was received."""
        self._records.append(record(BOOT_UNIX_US + time_us, frame))
