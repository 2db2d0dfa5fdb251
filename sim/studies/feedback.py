"""The study of the feedback: the vehicle flies by its own altitude, with feedback and without.

Each case is flown twice in lockstep, the companion's pipeline on a memory link as `kollsman run`
would have it. On the flight without feedback, two simple corrections are computed from what the
same link carried. `kollsman-sim feedback` writes the tables of errors of the *autopilot's own*
altitude, and a figure of each case.
"""

import math
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from companion.clock import ManualClock
from companion.errors import SimulationError
from companion.feedback import Feedback, FeedbackSettings, Mark
from companion.jobs import Row, results
from companion.links.memory import pair
from companion.mavlink.codec import Decoder, Encoder, mavlink
from companion.pipeline import Pipeline
from companion.samples import Packet
from companion.settings import CompanionSettings
from sim import BOOT_UNIX_US
from sim.flight import Flight
from sim.scenario import Scenario, load_scenario
from sim.studies.feedback_page import draw, page_of, slug
from sim.studies.runs import run

DRIFT_M_PER_PA = 1.0 / 11.3
"""metres of altitude for a pascal at 600 m of the standard atmosphere"""
START_S = 210.0
"""start of the drift: take-off and climb are over"""
RATES_HZ = {"RAW_IMU": 10.0, "SIM_STATE": 0.0, "ATTITUDE": 4.0, "GLOBAL_POSITION_INT": 4.0}
HOLDS = (
    "weather-change",
    "warm-front-cruise",
    "hour-long-cruise",
    "low-level-qnh-drift",
    "metar-day",
)
Mode = Literal["none", "baro-alt-offset"]
SITL = "ArduPilot SITL"
"""preset of barometer and receiver; its simulation tells its true state"""
SECOND_PA = 40.0
"""error of a second barometer"""


@dataclass(frozen=True)
class Case:
    """One flight: a drifting barometer, faults, and what happens to the two programs."""

    name: str
    drift: tuple[tuple[float, float], ...] = ()
    """(rate in m/s, duration in s) one after the other, from `START_S` on"""
    duration_s: float = 660.0
    faults: tuple[Mapping[str, float | str], ...] = ()
    kill_s: float = math.inf
    """the companion is killed, and started again 5 s later"""
    reboot_s: float = math.inf
    """the autopilot restarts"""
    hold_of: str = ""
    """weather of a scenario, instead of the drift"""
    receiver: str = SITL
    """preset of receiver and barometer; empty: the simulator's defaults, a receiver that wanders by
    3 m and reports 4.2 m, or those of the scenario"""
    second_barometer: bool = False
    """a second one is heard (SCALED_PRESSURE2), which has no fault"""

    @property
    def title(self) -> str:
        return f"{self.name}, {'as SITL' if self.receiver else 'wandering receiver'}"

    def scenario(self) -> Scenario:
        """The flight: a hold at 600 m, or 500 m above the field in a scenario's weather."""
        if self.hold_of:
            return self._hold(load_scenario(self.hold_of))
        pressure = [{"time_s": START_S, "sea_level_hpa": 1013.25}]
        for rate_mps, duration_s in self.drift:
            last = pressure[-1]
            fall_hpa = rate_mps * duration_s / DRIFT_M_PER_PA * 0.01
            pressure.append(
                {
                    "time_s": last["time_s"] + duration_s,
                    "sea_level_hpa": last["sea_level_hpa"] - fall_hpa,
                }
            )
        sensors = {name: {"preset": self.receiver} for name in ("gnss", "barometer")}
        return Scenario.model_validate(
            {
                "name": "feedback",
                "summary": self.name,
                "flown_by": "estimate",
                "endless_fuel": True,
                "weather": {"pressure": pressure if self.drift else []},
                "sensors": sensors if self.receiver else {},
                "streams_hz": RATES_HZ | ({"SIM_STATE": 1.0} if self.receiver else {}),
                "faults": self.faults,
                "profile": self._profile(600.0),
            }
        )

    def _profile(self, altitude_m: float) -> list[dict[str, float | str]]:
        return [
            {"leg": "wait", "duration_s": 50.0},
            {"leg": "take_off"},
            {"leg": "climb", "altitude_amsl_m": altitude_m},
            {"leg": "hold", "duration_s": self.duration_s, "bank_deg": 5.0},
        ]

    def _hold(self, weather: Scenario) -> Scenario:
        values = weather.model_dump(mode="json", exclude_unset=True)
        values.pop("aloft", None)
        values |= {
            "flown_by": "estimate",
            "endless_fuel": True,
            "aircraft": "c172p",
            "streams_hz": RATES_HZ,
            "faults": [],
            "profile": self._profile(weather.runway.elevation_m + 500.0),
        }
        return Scenario.model_validate(values)


def _fault(name: str, duration_s: float, **values: float | str) -> tuple[Mapping[str, float | str]]:
    return ({"fault": name, "start_s": 390.0, "duration_s": duration_s, **values},)


RISE = ((0.05, 600.0),)
DRIFTS = (
    Case("drift +.05 m/s", RISE),
    Case("drift -.05 m/s", ((-0.05, 600.0),)),
    Case("drift +.12, then -.2 m/s", ((0.12, 300.0), (-0.2, 300.0))),
    Case("calm"),
)
FAULTS = (
    Case(
        "GNSS +60 m for 180 s",
        RISE,
        faults=_fault("step", 180.0, quantity="gnss_height", size=60.0),
    ),
    Case("GNSS off for 90 s", RISE, faults=_fault("outage", 90.0)),
    Case(
        "one of two barometers frozen for 120 s",
        RISE,
        faults=_fault("freeze", 120.0),
        second_barometer=True,
    ),
    Case("companion killed", RISE, kill_s=420.0),
    Case("autopilot restarts", RISE, faults=_fault("reboot", 3.0), reboot_s=390.0),
)
CASES = (*DRIFTS, *FAULTS, *(replace(case, receiver="") for case in (*DRIFTS, *FAULTS[:3])))
HOURS = tuple(
    Case(f"an hour of {name}", duration_s=3600.0, hold_of=name, receiver="") for name in HOLDS
)


@dataclass(frozen=True)
class Job:
    """One flight of a case."""

    case: Case
    feedback: bool
    seed: int = 1


class Heard:
    """What a companion hears of the link that a simple correction would use: the raw fix."""

    def __init__(self) -> None:
        self.gnss_m = math.nan
        self._decoder = Decoder()

    def feed(self, data: bytes) -> None:
        for frame in self._decoder.feed(data):
            if frame.message_id == mavlink.MAVLINK_MSG_ID_GPS_RAW_INT:
                message = self._decoder.decode(frame)
                if message is not None and message.fix_type >= 3:
                    self.gnss_m = message.alt * 1e-3


def fly(job: Job) -> list[Row]:
    """Fly it: a row a second with the time, the true altitude and height above home, the
    autopilot's own, the raw fix, ours, and the correction."""
    case = job.case
    near, far = pair(ManualClock())
    flight = Flight(case.scenario(), links=[near], all_streams=True, seed=job.seed)
    marks: list[Mark | None] = [None]
    mode: Mode = "baro-alt-offset" if job.feedback else "none"
    rows: list[Row] = []
    pipeline: Pipeline | None = _start(marks, mode)
    heard, second = Heard(), Encoder(1, 1)
    boots, home = 0, (math.nan, math.nan)
    while not flight.profile.done:
        flight.tick()
        time_s = flight.time_us * 1e-6
        if time_s >= case.reboot_s and not boots:
            boots, home = 1, (math.nan, math.nan)
            flight.vehicle.reboot()
        if pipeline is not None and 0.0 <= time_s - case.kill_s < 5.0:
            pipeline = None
        elif pipeline is None and time_s >= case.kill_s + 5.0:
            pipeline = _start(marks, mode)
        packets = []
        while data := far.receive(0.0):
            heard.feed(data)
            packets.append(Packet(BOOT_UNIX_US + flight.time_us, data))
        if case.second_barometer and not flight.time_us % 200_000:
            packets.append(_second_pressure(flight, second))
        for packet in packets:
            for frame in pipeline.feed(packet) if pipeline else ():
                far.send(frame)
        state = flight.vehicle.state
        if flight.time_us % 1_000_000 or state.truth is None or state.position is None:
            continue
        true_m, own_m = state.truth.altitude_amsl_m, state.position.altitude_amsl_m
        home = home if math.isfinite(home[0]) else (true_m, own_m)
        found = {"time_s": time_s, "boots": boots, "true_m": true_m, "own_m": own_m}
        found["relative_error_m"] = own_m - home[1] - true_m + home[0]
        found["gnss_m"] = heard.gnss_m
        rows.append(found | _written(flight, pipeline))
    near.close()
    far.close()
    return rows


def _written(flight: Flight, pipeline: Pipeline | None) -> Row:
    """Our altitude, the correction, and the number of writes."""
    values = flight.vehicle.state.parameters
    return {
        "raised_m": flight.vehicle.flavour.raised_m(values, 101_325.0),
        "ours_m": float(pipeline.filter.estimate[0]["altitude_amsl_m"]) if pipeline else math.nan,
        "writes": pipeline.feedback.writes if pipeline else 0,
    }


def _second_pressure(flight: Flight, sender: Encoder) -> Packet:
    """SCALED_PRESSURE2 of a second barometer on the same port."""
    sample = flight.vehicle.state.pressure
    pressure_hpa = (sample.pressure_pa + SECOND_PA) * 0.01 if sample else math.nan
    message = mavlink.MAVLink_scaled_pressure2_message(
        flight.time_us // 1000, pressure_hpa, 0.0, 3000
    )
    return Packet(BOOT_UNIX_US + flight.time_us, sender.encode(message))


def _start(marks: list[Mark | None], mode: Mode) -> Pipeline:
    """Start a companion that keeps its mark in `marks`."""

    def keep(mark: Mark | None) -> bool:
        marks[0] = mark
        return True

    settings = CompanionSettings(feedback=FeedbackSettings(mode=mode))
    feedback = Feedback(settings.feedback, keep=keep, mark=marks[0])
    return Pipeline(settings, feedback=feedback)


def study(
    cases: tuple[Case, ...],
    executor: Executor,
    out: Path,
    *,
    parts: Path | None = None,
    on_done: Callable[[int], None] = lambda done: None,
) -> Path:
    """Fly all cases with and without feedback; write the page and its figures to `out`.

    Raises `SimulationError` when a flight fails.
    """
    jobs = [Job(case, feedback) for case in cases for feedback in (False, True)]
    done = run(fly, jobs, executor, parts=parts, on_done=lambda count, _: on_done(count))
    failed = next((each for each in done if each.error is not None), None)
    if failed is not None:
        raise SimulationError(f"{failed.job.case.name}: {failed.error}")
    flown = results(done)
    out.mkdir(parents=True, exist_ok=True)
    flights = []
    for case, before, after in zip(cases, flown[::2], flown[1::2], strict=True):
        draw(case.title, before, after, out / f"{slug(case.title)}.png")
        flights.append((case.title, before, after))
    page = out / "README.md"
    page.write_text(page_of(flights, START_S), encoding="utf-8")
    return page
