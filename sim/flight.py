"""One simulated flight in lockstep, and its pace.

    flight = Flight(load_scenario("short-hop"), tlog=Path("hop.tlog"))
    summary = flight.run()

The order within a tick: weather, dynamics, truth, sensors, autopilot, received bytes, sent
messages. Only `run` reads the host's clock, and only to wait.
"""

import contextlib
import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from companion.clock import Clock, SystemClock
from companion.errors import SimulationError
from companion.links import Link
from companion.logs.tlog import TlogWriter
from companion.samples import Packet
from sim import BOOT_UNIX_US, STEPS_PER_TICK
from sim.aircraft import Aircraft
from sim.aircraft_state import Truth
from sim.faults.injector import FaultInjector
from sim.pilot.approach import LandingSite
from sim.pilot.autopilot import UPDATE_HZ, Autopilot, Mode, Target
from sim.pilot.profile import Hold, Profile
from sim.pilot.stall import StallWatch
from sim.scenario import Scenario
from sim.sensors.barometer import Barometer
from sim.sensors.gnss import Fix, GnssReceiver
from sim.sensors.imu import Imu
from sim.sensors.thermometer import Thermometer
from sim.vehicle.ardupilot import HYGROMETER_ID
from sim.vehicle.flavours import FLAVOURS, Flavour, FlavourName
from sim.vehicle.own_estimate import OwnEstimate
from sim.vehicle.ports import Port
from sim.vehicle.vehicle import Heard, Vehicle
from sim.weather import Weather

MOTION_US = 1_000_000 // UPDATE_HZ
"""interval of truth, autopilot and the fastest IMU: every second tick"""
_WEATHER_US = 100_000
_STRAYED_M = 200.0
"""largest distance from the altitude of a hold; gusts, waves and turns of the given scenarios reach
60 m"""
_LIFTED_M = 3.0
"""height of the centre of gravity that no parked aircraft has; on the wheels it is at most 1.7 m"""
_LATE_S = 0.5
"""Delay behind real time above which the flight does not catch up."""
_READS_PER_TICK = 32
"""Largest number of datagrams that a link reads in a tick, so that a flood does not stop the
flight."""
_REPORT_US = 1_000_000
_PARKED = Mode.PARKED  # looked up in its class, a member costs four times as much (Python 3.11)
_AIRBORNE = (Mode.AIRSPEED, Mode.ALTITUDE, Mode.APPROACH)
"""modes in which the aircraft must not touch the ground"""
_NEAR_THE_GROUND = (Mode.PARKED, Mode.FLARE, Mode.ROLL_OUT)
"""modes in which the wing may stall"""


@dataclass(frozen=True)
class Progress:
    """Progress of a flight, given to a callback once a simulated second."""

    time_s: float
    truth: Truth
    leg: str
    speed_ratio: float
    """simulated seconds per real second so far"""


@dataclass(frozen=True)
class Summary:
    """Result of a flight."""

    duration_s: float
    completed: bool
    """False when it was stopped"""
    elapsed_s: float
    sent: Counter[str]
    """messages by name, over all ports"""
    sent_bytes: int
    dropped: int
    forwarded: int
    """frames of other senders that were forwarded to another link"""
    received_bytes: int
    heard: Heard

    @property
    def speed_ratio(self) -> float:
        return self.duration_s / self.elapsed_s if self.elapsed_s > 0 else float("inf")


class Flight:
    """A scenario, an aircraft in it, and where its telemetry goes.

    Parameters
    ----------
    links
        Already open; the caller closes them.
    tlog
        A log of everything sent at full rate, and of everything the links brought.
    seed
        In place of the scenario's.
    all_streams
        Links get the log's rates instead of the flavour's own (ArduPlane's 1 Hz).
    flavour
        Whose autopilot the vehicle looks like, in place of the scenario's.
    on_fix
        Called with every fix as it reaches the autopilot.
    speed
        Simulated seconds a real one; None is as fast as possible.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        links: Sequence[Link] = (),
        tlog: Path | None = None,
        seed: int | None = None,
        all_streams: bool = False,
        speed: float | None = None,
        clock: Clock | None = None,
        flavour: FlavourName | None = None,
        on_fix: Callable[[Fix], None] | None = None,
    ) -> None:
        self.scenario = scenario
        self.time_us = 0
        self._clock = clock or SystemClock()
        self._speed = speed
        self._stopped = False
        self._on_fix = on_fix
        self._received_bytes = 0
        self._injectors: list[FaultInjector] = []
        seed = self._seed = scenario.seed if seed is None else seed
        self._start_aircraft(seed)
        face = FLAVOURS[flavour or scenario.flavour]
        self._start_sensors(seed, face.baro_hz)
        self._writer = TlogWriter(tlog) if tlog is not None else None
        self.vehicle = Vehicle(
            OwnEstimate(scenario.sensors.estimate, seed, MOTION_US * 1e-6, face.raise_time_s),
            self._record if self._writer else None,
            face,
        )
        self.vehicle.state.true_air = self.weather.truth
        self._links = [
            (link, self._port(link.url, self._delivery(link), face, all_streams)) for link in links
        ]
        if self._writer is not None:
            self._port(str(tlog), self._delivery(None), face, full=True)

    def _port(self, name: str, deliver: Callable[[bytes], bool], face: Flavour, full: bool) -> Port:
        """A port of the vehicle's, with the scenario's rates or the flavour's."""
        rates_hz = self.scenario.streams_hz if full else {}
        absent = () if self.thermometer.config.fitted else (HYGROMETER_ID,)
        port = Port(name, deliver, rates_hz, full=full, flavour=face, absent=absent)
        self.vehicle.add_port(port)
        return port

    def _start_aircraft(self, seed: int) -> None:
        scenario, runway = self.scenario, self.scenario.runway
        self.autopilot = Autopilot(scenario.aircraft)
        aloft = scenario.aloft
        cruise_mps = self.autopilot.gains.cruise_mps
        self.aircraft = Aircraft(
            scenario.aircraft,
            latitude_deg=runway.latitude_deg,
            longitude_deg=runway.longitude_deg,
            field_elevation_m=runway.elevation_m,
            heading_deg=runway.heading_deg,
            aloft=None
            if aloft is None
            else (aloft.altitude_amsl_m, aloft.airspeed_mps or cruise_mps),
            seed=seed,
        )
        site = LandingSite(
            runway.latitude_deg, runway.longitude_deg, runway.heading_deg, runway.elevation_m,
            self.aircraft.rest_height_m,
            self.aircraft.powered,
        )  # fmt: skip
        self.profile = Profile(
            scenario.profile,
            self.autopilot.gains,
            site,
            None if aloft is None else aloft.altitude_amsl_m,
        )
        self._stall = StallWatch(self.aircraft)
        self.weather = Weather(scenario.weather, self.aircraft, seed)
        if scenario.endless_fuel:
            self.aircraft.freeze_fuel()
        self.aircraft.settle()

    def _start_sensors(self, seed: int, baro_hz: int) -> None:
        sensors = self.scenario.sensors
        self.barometer = Barometer(sensors.barometer, seed, baro_hz)
        self.gnss = GnssReceiver(sensors.gnss, seed, self.scenario.runway.elevation_m)
        self.imu = Imu(sensors.imu, seed)
        self.thermometer = Thermometer(sensors.thermometer, seed)

    # The loop

    def run(self, progress: Callable[[Progress], None] | None = None) -> Summary:
        """Fly to the end of the profile, or until `stop`. The log is closed whatever happens.

        Raises `SimulationError` when the flight leaves reality or outlasts its ``limit_s``.
        """
        started_s = time.perf_counter()
        with contextlib.ExitStack() as stack:
            if self._writer is not None:
                stack.callback(self._writer.close)
            self._loop(progress, started_s)
            for injector in self._injectors:
                injector.due(math.inf)
        return self._summary(time.perf_counter() - started_s)

    def stop(self) -> None:
        """End `run` after the present tick; may be called from a signal handler."""
        self._stopped = True

    def _loop(self, progress: Callable[[Progress], None] | None, started_s: float) -> None:
        limit_us = self.scenario.limit_s * 1e6
        origin_us, flown_us = self._clock.now_us(), 0
        while not self._stopped and not self.profile.done:
            self.tick()
            if self.time_us > limit_us:
                raise SimulationError(
                    f"'{self.scenario.name}' has not ended after limit_s = {limit_us * 1e-6:g} s, "
                    f"in '{self.profile.describe()}': shorten the profile, or raise limit_s"
                )
            if self._speed is not None:
                ahead_s = (self.time_us - flown_us) * 1e-6 / self._speed - (
                    self._clock.now_us() - origin_us
                ) * 1e-6
                if ahead_s > 0.0:
                    self._clock.sleep_s(ahead_s)
                elif ahead_s < -_LATE_S:
                    origin_us, flown_us = self._clock.now_us(), self.time_us
            if progress is None or self.time_us % _REPORT_US:
                continue
            truth = self.vehicle.state.truth
            if truth is not None:
                elapsed_s = time.perf_counter() - started_s
                progress(
                    Progress(
                        self.time_us * 1e-6,
                        truth,
                        self.profile.describe(),
                        self.time_us * 1e-6 / elapsed_s,
                    )
                )

    def tick(self) -> None:
        """Advance by one tick of `sim.TICK_US`."""
        aircraft, vehicle = self.aircraft, self.vehicle
        if self.time_us % _WEATHER_US == 0:
            self.weather.update(self.time_us * 1e-6)
            self._check_fuel()
        aircraft.advance(STEPS_PER_TICK)
        self.time_us = vehicle.state.time_us = now_us = aircraft.time_us
        if now_us % MOTION_US == 0:
            self._motion(now_us)
        if now_us % self.barometer.period_us == 0:
            flow = aircraft.flow() if self.barometer.feels_flow else None
            vehicle.on_pressure(self.barometer.measure(now_us, *aircraft.air(), flow))
        if now_us % self.thermometer.period_us == 0:
            vehicle.state.air_temperature_k = self.thermometer.measure(aircraft.air()[1])
        if self.gnss.arrives_us <= now_us and (fix := self.gnss.deliver(now_us)) is not None:
            vehicle.on_fix(fix)
            if self._on_fix is not None:
                self._on_fix(fix)
        for link, port in self._links:
            for _ in range(_READS_PER_TICK):
                if not (data := link.receive(0.0)):
                    break
                self._received_bytes += len(data)
                vehicle.receive(port, data)
        vehicle.stream()
        for injector in self._injectors:
            injector.due(BOOT_UNIX_US + now_us)

    def _check_fuel(self) -> None:
        """Raise `SimulationError` when the fuel is used up."""
        if self.aircraft.fuel_kg() <= 0.0:
            raise SimulationError(
                f"at {self.time_us / 1e6:.2f} s the fuel is used up during "
                f"'{self.profile.describe()}': make the profile shorter, or set endless_fuel"
            )

    def _check_altitude(self, truth: Truth, target: Target) -> None:
        """Raise `SimulationError` if a hold loses its altitude: fly-by-wire sinks instead of
        stalling."""
        if abs(truth.altitude_amsl_m - target.altitude_amsl_m) > _STRAYED_M:
            bank_deg = abs(math.degrees(truth.roll_rad))
            raise SimulationError(
                f"at {truth.time_us / 1e6:.2f} s, during '{self.profile.describe()}' at "
                f"{truth.altitude_amsl_m:.0f} m, {truth.airspeed_mps:.1f} m/s and a bank of "
                f"{bank_deg:.0f} degrees, the aircraft cannot hold its altitude; give the leg less "
                "bank_deg or another airspeed_mps"
            )

    def _motion(self, now_us: int) -> None:
        """The steps at 50 Hz: truth, autopilot, IMU, GNSS, the vehicle's own estimate."""
        state, estimate = self.vehicle.state, self.vehicle.estimate
        state.truth = truth = self.aircraft.truth()
        self._fly(self.profile.seen(truth, state.position, self.scenario.flown_by))
        if now_us % self.imu.period_us == 0:
            state.motion = motion = self.aircraft.mean_motion()
            state.imu = self.imu.measure(now_us, motion)
        if now_us % self.gnss.period_us == 0:
            self.gnss.measure(truth)
        state.attitude_rad = estimate.attitude(truth)
        state.position = estimate.position(now_us)

    def _fly(self, truth: Truth) -> None:
        profile, state = self.profile, self.vehicle.state
        before = profile.leg
        target = profile.update(truth)
        controls = self.autopilot.update(truth, target)
        self.aircraft.control(controls)
        state.throttle = max(controls.throttle, 0.0)
        leg, mode = profile.leg, target.mode
        if (mode is not _PARKED) != state.armed:
            self.vehicle.arm(mode is not _PARKED)
        if leg is not before:
            self.vehicle.say(f"Mission: {profile.describe()}")
        if mode not in _NEAR_THE_GROUND:
            self._stall.check(truth, leg, profile.describe)
        if isinstance(leg, Hold):
            self._check_altitude(truth, target)
        if mode is _PARKED and truth.altitude_amsl_m > self.aircraft.ground_m + _LIFTED_M:
            raise SimulationError(
                f"at {truth.time_us / 1e6:.2f} s the wind lifted the aircraft off the ground "
                f"during '{self.profile.describe()}': reduce the wind of the scenario"
            )
        if truth.on_ground and mode in _AIRBORNE:
            raise SimulationError(
                f"at {truth.time_us / 1e6:.2f} s the aircraft hit the ground during "
                f"'{self.profile.describe()}', sinking at {truth.down_mps:.1f} m/s"
            )

    # Where telemetry goes

    def _delivery(self, link: Link | None) -> Callable[[bytes], bool]:
        """The delivery of a port's frames to `link`, or to the log, through the scenario's
        faults."""
        if not self.scenario.faults:
            return self._log if link is None else link.send
        deliver = self._log_packet if link is None else lambda packet: link.send(packet.data)
        injector = FaultInjector(self.scenario.faults, self._seed, self._log_time_us, deliver)
        self._injectors.append(injector)
        return injector

    def _log(self, frame: bytes) -> bool:
        self._writer.write(BOOT_UNIX_US + self.time_us, frame)  # type: ignore[union-attr]
        return True

    def _log_packet(self, packet: Packet) -> bool:
        self._record(packet.time_us - BOOT_UNIX_US, packet.data)
        return True

    def _log_time_us(self) -> int:
        return BOOT_UNIX_US + self.time_us

    def _record(self, time_us: int, frame: bytes) -> None:
        if self._writer is not None:
            self._writer.write(BOOT_UNIX_US + time_us, frame)

    def _summary(self, elapsed_s: float) -> Summary:
        ports = self.vehicle.ports
        sent: Counter[str] = Counter()
        for port in ports:
            sent += port.sent
        return Summary(
            duration_s=self.time_us * 1e-6,
            completed=self.profile.done,
            elapsed_s=elapsed_s,
            sent=sent,
            sent_bytes=sum(port.sent_bytes for port in ports),
            dropped=sum(port.dropped for port in ports),
            forwarded=sum(port.forwarded for port in ports),
            received_bytes=self._received_bytes,
            heard=self.vehicle.heard,
        )
