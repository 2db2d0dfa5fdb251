"""The study of the feedback: the vehicle flies by its own altitude, with feedback and without.

Each case is flown twice in lockstep, the companion's pipeline on a memory link as `kollsman run`
would have it. `kollsman-sim feedback` writes the table of errors of the *autopilot's own* altitude,
and a figure of each case.
"""

import math
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.clock import ManualClock
from companion.errors import SimulationError
from companion.feedback import Feedback, FeedbackSettings, Mark
from companion.jobs import Row, results
from companion.links.memory import pair
from companion.pipeline import Pipeline
from companion.plots.drawing import figure, legend_outside, write_png
from companion.plots.style import FUSED, INERTIAL, OTHER, TRUTH
from companion.samples import Packet
from companion.settings import CompanionSettings
from sim import BOOT_UNIX_US
from sim.flight import Flight
from sim.scenario import Scenario, load_scenario
from sim.studies.page import markdown_table
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
GOALS = {"amsl_rmse_m": 1.9, "amsl_max_m": 3.5, "relative_rmse_m": 2.0, "relative_max_m": 4.5}


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
        return Scenario.model_validate(
            {
                "name": "feedback",
                "summary": self.name,
                "flown_by": "estimate",
                "endless_fuel": True,
                "weather": {"pressure": pressure if self.drift else []},
                "streams_hz": RATES_HZ,
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
CASES = (
    Case("drift +.05 m/s", RISE),
    Case("drift -.05 m/s", ((-0.05, 600.0),)),
    Case("drift +.12, then -.2 m/s", ((0.12, 300.0), (-0.2, 300.0))),
    Case("calm"),
    Case(
        "GNSS +60 m for 180 s",
        RISE,
        faults=_fault("step", 180.0, quantity="gnss_height", size=60.0),
    ),
    Case("GNSS off for 90 s", RISE, faults=_fault("outage", 90.0)),
    Case("telemetry's barometer frozen for 120 s", RISE, faults=_fault("freeze", 120.0)),
    Case("companion killed", RISE, kill_s=420.0),
    Case("autopilot restarts", RISE, faults=_fault("reboot", 3.0), reboot_s=390.0),
)
HOURS = tuple(Case(f"an hour of {name}", duration_s=3600.0, hold_of=name) for name in HOLDS)


@dataclass(frozen=True)
class Job:
    """One flight of a case."""

    case: Case
    feedback: bool
    seed: int = 1


def fly(job: Job) -> list[Row]:
    """Fly it: a row a second with the time, the true altitude and height above home, the
    autopilot's own, and the correction."""
    case = job.case
    near, far = pair(ManualClock())
    flight = Flight(case.scenario(), links=[near], all_streams=True, seed=job.seed)
    marks: list[Mark | None] = [None]
    rows: list[Row] = []
    pipeline = _start(marks) if job.feedback else None
    rebooted = False
    home: tuple[float, float] | None = None
    while not flight.profile.done:
        flight.tick()
        time_s = flight.time_us * 1e-6
        if time_s >= case.reboot_s and not rebooted:
            rebooted, home = True, None
            flight.vehicle.reboot()
        if pipeline is not None and 0.0 <= time_s - case.kill_s < 5.0:
            pipeline = None
        elif pipeline is None and job.feedback and time_s >= case.kill_s + 5.0:
            pipeline = _start(marks)
        while data := far.receive(0.0):
            frames = pipeline.feed(Packet(BOOT_UNIX_US + flight.time_us, data)) if pipeline else []
            for frame in frames:
                far.send(frame)
        state = flight.vehicle.state
        if flight.time_us % 1_000_000 or state.truth is None or state.position is None:
            continue
        true_m, own_m = state.truth.altitude_amsl_m, state.position.altitude_amsl_m
        home = home or (true_m, own_m)
        raised_m = flight.vehicle.flavour.raised_m(state.parameters, 101_325.0)
        rows.append(
            {
                "time_s": time_s,
                "true_m": true_m,
                "own_m": own_m,
                "relative_error_m": own_m - home[1] - true_m + home[0],
                "raised_m": raised_m,
            }
        )
    near.close()
    far.close()
    return rows


def _start(marks: list[Mark | None]) -> Pipeline:
    """Start a companion that keeps its mark in `marks`."""

    def keep(mark: Mark | None) -> bool:
        marks[0] = mark
        return True

    settings = CompanionSettings(feedback=FeedbackSettings(mode="baro-alt-offset"))
    feedback = Feedback(settings.feedback, keep=keep, mark=marks[0])
    return Pipeline(settings, feedback=feedback)


def errors(rows: list[Row]) -> dict[str, float]:
    """Errors of the autopilot's own altitude from `START_S` on, and the largest step that a write
    makes in it."""
    shown = [row for row in rows if row["time_s"] >= START_S]
    amsl = np.array([row["own_m"] - row["true_m"] for row in shown])
    relative = np.array([row["relative_error_m"] for row in shown])
    raised = np.array([row["raised_m"] for row in shown])
    return {
        "amsl_rmse_m": _rmse(amsl),
        "amsl_max_m": float(np.max(np.abs(amsl))),
        "relative_rmse_m": _rmse(relative),
        "relative_max_m": float(np.max(np.abs(relative))),
        "step_m": float(np.max(np.abs(np.diff(raised)), initial=0.0)),
    }


def _rmse(values: NDArray[np.float64]) -> float:
    return math.sqrt(float(np.mean(values**2)))


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
    lines = []
    for case, before, after in zip(cases, flown[::2], flown[1::2], strict=True):
        _draw(case, before, after, out / f"{_slug(case.name)}.png")
        lines.append((case, errors(before), errors(after)))
    page = out / "README.md"
    page.write_text(_page(lines), encoding="utf-8")
    return page


def _page(lines: list[tuple[Case, dict[str, float], dict[str, float]]]) -> str:
    table = []
    for case, before, after in lines:
        cells = [case.name]
        for kind in ("amsl", "relative"):
            for found in (before, after):
                cells.append(f"{found[f'{kind}_rmse_m']:.2f} / {found[f'{kind}_max_m']:.2f}")
        ratio = after["amsl_rmse_m"] / before["amsl_rmse_m"]
        table.append([*cells, f"{ratio:.2f}", f"{after['step_m']:.2f}"])
    head = [
        "case",
        "AMSL without",
        "AMSL with",
        "above home without",
        "above home with",
        "AMSL with : without",
        "largest change in a second",
    ]
    figures = "\n\n".join(f"![{case.name}]({_slug(case.name)}.png)" for case, *_ in lines)
    return (
        "# Feedback to the autopilot\n\n"
        "Written by `kollsman-sim feedback`. The simulated ArduPilot flies by its own altitude. "
        "Errors of that altitude from 210 s on, RMSE / largest, in metres, without and with "
        "feedback (`feedback.mode: baro-alt-offset`, all other keys at their defaults), one seed "
        "each. The drift is real: the sea-level pressure changes.\n\n"
        f"{markdown_table(head, table)}\n\n"
        f"Goals at a drift of .05 m/s: AMSL {GOALS['amsl_rmse_m']} / {GOALS['amsl_max_m']}, above "
        f"home {GOALS['relative_rmse_m']} / {GOALS['relative_max_m']}; in every case at most 1.1 "
        "times the RMSE without feedback; no change above .15 m by a write.\n\n"
        f"{figures}\n"
    )


def _slug(name: str) -> str:
    told = name.lower().replace("+", "plus ").replace("-.", "minus .")
    words = "".join(letter if letter.isalnum() else " " for letter in told).split()
    return "-".join(words)


def _draw(case: Case, before: list[Row], after: list[Row], path: Path) -> None:
    """Error of the autopilot's own altitude, and the correction, over time."""
    title = f"{case.name}: error of the autopilot's own altitude (m)"
    with figure(1, panel_in=3.2) as (canvas, (axes,)):
        for rows, colour, label in ((before, INERTIAL, "without"), (after, FUSED, "with feedback")):
            times = [row["time_s"] / 60.0 for row in rows]
            errors_m = [row["own_m"] - row["true_m"] for row in rows]
            axes.plot(times, errors_m, color=colour, label=label)
        axes.plot(
            [row["time_s"] / 60.0 for row in after],
            [row["raised_m"] for row in after],
            color=OTHER,
            linestyle=":",
            label="BARO_ALT_OFFSET",
        )
        axes.axhline(0.0, color=TRUTH, linewidth=0.8, zorder=0)
        axes.set_title(title)
        axes.set_xlabel("time (min)")
        legend_outside(axes)
        write_png(canvas, path)
