"""One simulated flight in lockstep, and its pace.

    flight = Flight(load_scenario("short-hop"), tlog=Path("hop.tlog"))
    summary = flight.run()

The order within a tick: weather, dynamics, truth, autopilot; then sensors, received bytes, sent
messages (`sim.onboard`). Where nothing of the second half acts on the first (no link, and the
autopilot flies by the truth), `run` takes a second of the first before the second: the same bytes,
and each half keeps the processor's cache. Only `run` reads the host's clock, and only to wait.
"""

import contextlib
import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from companion.clock import Clock, SystemClock
from companion.errors import SimulationError
from companion.links import Link
from sim import STEPS_PER_TICK, TICK_US
from sim.aircraft import Aircraft
from sim.aircraft_state import Truth
from sim.ground_station import GroundStation
from sim.onboard import MOTION_US, Moment, Onboard, new_moment
from sim.pilot.approach import LandingSite
from sim.pilot.autopilot import Autopilot, Mode, Target
from sim.pilot.profile import Hold, Profile
from sim.pilot.stall import StallWatch
from sim.scenario import Scenario
from sim.sensors.gnss import Fix
from sim.vehicle.flavours import FLAVOURS, FlavourName
from sim.vehicle.vehicle import Heard
from sim.weather import Weather

_WEATHER_US = 100_000
_STRAYED_M = 200.0
"""largest distance from the altitude of a hold; gusts, waves and turns of the given scenarios reach
60 m"""
_LIFTED_M = 3.0
"""height of the centre of gravity that no parked aircraft has; on the wheels it is at most 1.7 m"""
_LATE_S = 0.5
"""Delay behind real time above which the flight does not catch up."""
_REPORT_US = 1_000_000
_PARKED = Mode.PARKED  # looked up in its class, a member costs four times as much (Python 3.11)
_AIRBORNE = (Mode.AIRSPEED, Mode.ALTITUDE, Mode.APPROACH)
"""modes in which the aircraft must not touch the ground"""
_NEAR_THE_GROUND = (Mode.PARKED, Mode.FLARE, Mode.ROLL_OUT)
"""modes in which the wing may stall"""
_NO_EVENTS: tuple[Callable[[], None], ...] = ()


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
    station_link
        A link of its own for the scenario's ground station, open; the caller closes it.
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
        station_link: Link | None = None,
    ) -> None:
        self.scenario = scenario
        self.time_us = 0
        self._clock = clock or SystemClock()
        self._speed = speed
        self._stopped = False
        self._armed = False
        seed = scenario.seed if seed is None else seed
        self._start_aircraft(seed)
        self.station: GroundStation | None = None
        if scenario.ground_station is not None:
            runway_m = scenario.runway.elevation_m
            self.station = GroundStation(
                scenario.ground_station, self.weather, runway_m, seed, station_link
            )
        self._onboard = Onboard(
            scenario,
            seed,
            FLAVOURS[flavour or scenario.flavour],
            links=links,
            tlog=tlog,
            all_streams=all_streams,
            on_fix=on_fix,
            station=self.station,
        )
        self.vehicle = self._onboard.vehicle
        self.vehicle.state.true_air = self.weather.truth
        self._by_truth = scenario.flown_by == "truth"
        self._in_blocks = not links and station_link is None and speed is None and self._by_truth

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

    # The loop

    def run(self, progress: Callable[[Progress], None] | None = None) -> Summary:
        """Fly to the end of the profile, or until `stop`. The log is closed whatever happens.

        Raises `SimulationError` when the flight leaves reality or outlasts its ``limit_s``.
        """
        started_s = time.perf_counter()
        with contextlib.ExitStack() as stack:
            stack.callback(self._onboard.close)
            self._loop(progress, started_s)
            self._onboard.finish()
        return self._summary(time.perf_counter() - started_s)

    def stop(self) -> None:
        """End `run` after the present tick or block; may be called from a signal handler."""
        self._stopped = True

    def _loop(self, progress: Callable[[Progress], None] | None, started_s: float) -> None:
        limit_us = self.scenario.limit_s * 1e6
        origin_us, flown_us = self._clock.now_us(), 0
        while not self._stopped and not self.profile.done:
            if self._in_blocks:
                self._block(limit_us)
            else:
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
        self._onboard.tick(self._fly_ticks())

    def _block(self, limit_us: float) -> None:
        """Fly to the next second, to the end, or to where something on board reads the weather
        itself, and take the moments then."""
        moments, air_us = [], self._onboard.air_period_us
        second_us = (self.time_us // _REPORT_US + 1) * _REPORT_US
        until_us = min(second_us, self._onboard.reads_weather_us)
        try:
            while True:
                idle = self.time_us % MOTION_US == 0 and (self.time_us + TICK_US) % air_us
                moments.append(self._fly_ticks(2 if idle else 1))
                now_us = self.time_us
                is_over = now_us % _WEATHER_US == 0 and now_us >= until_us
                if is_over or self.profile.done or now_us > limit_us:
                    break
        finally:
            self._onboard.take(moments)

    def _fly_ticks(self, ticks: int = 1) -> Moment:
        """Weather, dynamics and autopilot of one tick, or of two if nothing else is due at the
        first."""
        aircraft, onboard = self.aircraft, self._onboard
        if self.time_us % _WEATHER_US == 0:
            self.weather.update(self.time_us * 1e-6)
            self._check_fuel()
        aircraft.advance(STEPS_PER_TICK, ticks)
        self.time_us = now_us = aircraft.time_us
        truth = motion = air = flow = None
        throttle, events = 0.0, _NO_EVENTS
        if now_us % MOTION_US == 0:
            truth = aircraft.truth()
            throttle, events = self._fly(truth)
            if now_us % onboard.imu.period_us == 0:
                motion = aircraft.mean_motion()
        if now_us % onboard.air_period_us == 0:
            air = aircraft.air()
            if onboard.barometer.feels_flow:
                flow = aircraft.flow()
        return new_moment((now_us, truth, motion, throttle, events, air, flow))

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

    def _fly(self, truth: Truth) -> tuple[float, tuple[Callable[[], None], ...]]:
        """The autopilot's step at 50 Hz; the commanded throttle, and what the vehicle tells of
        it."""
        profile, vehicle = self.profile, self.vehicle
        if not self._by_truth:
            truth = profile.seen(truth, vehicle.state.position)
        before = profile.leg
        target = profile.update(truth)
        controls = self.autopilot.update(truth, target)
        self.aircraft.control(controls)
        leg, mode, events = profile.leg, target.mode, _NO_EVENTS
        if (mode is not _PARKED) != self._armed:
            self._armed = mode is not _PARKED
            events = (partial(vehicle.arm, self._armed),)
        if leg is not before:
            events = (*events, partial(vehicle.say, f"Mission: {profile.describe()}"))
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
        return max(controls.throttle, 0.0), events

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
            received_bytes=self._onboard.received_bytes,
            heard=self.vehicle.heard,
        )
