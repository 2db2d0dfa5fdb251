"""Section ``faults``: which sensor is named after how long, and how far off the height is
meanwhile."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from companion.jobs import results
from companion.settings import CompanionSettings
from sim.scenario import load_scenario
from sim.studies.goals import Context
from sim.studies.goals.attribution import CASES, DOUBT_RATIO, try_faults
from sim.studies.goals.fault_flights import ESTIMATOR, FLIGHTS
from sim.studies.goals.fault_flights import fly as fly_faults
from sim.studies.goals.goals import Measured
from sim.studies.goals.section import SectionPage
from sim.studies.page import Value
from sim.studies.runs import flown

Row = dict[str, Any]
RECORDED = ("jsbsim_A", "jsbsim_B", "ardupilot_nominal", "ardupilot_weather")
SCENARIOS = (
    "calm-circuit",
    "weather-change",
    "cold-front-descent",
    "inversion-approach",
    "hot-and-high",
    "gusty-shake",
)
ONSETS = 6
FASTEST_S = 1.0
INTERVALS = 11
"""a frozen barometer is to be named within so many of its own intervals, and no less than a
second"""
SHOWN = 12


class Job(NamedTuple):
    """A recorded flight, a scenario and seed to be flown, or a seed of the fault flights."""

    log: Path | None = None
    scenario: str = ""
    seed: int = 0


class Found(NamedTuple):
    """Result of one job: rows of the faults and of the flight without one, or rows of fault
    flights."""

    tried: list[Row]
    flown: list[Row]


def work(job: Job) -> Found:
    """Do one job; runs in a worker."""
    settings = CompanionSettings.model_validate({"estimator": ESTIMATOR})
    if job.log is not None:
        return _named(job.log.stem, "recorded", *try_faults(job.log, settings, ONSETS))
    if not job.scenario:
        return Found([], fly_faults(job.seed))
    with flown(load_scenario(job.scenario), job.seed) as (log, _):
        return _named(f"{job.scenario} {job.seed}", "simulated", *try_faults(log, settings, ONSETS))


def _named(flight: str, origin: str, rows: list[Row], healthy: Row) -> Found:
    return Found(
        [
            {"flight": flight, "origin": origin, "interval_s": healthy["interval_s"]} | row
            for row in rows
        ],
        [],
    )


def evaluate(context: Context) -> SectionPage:
    """Try every fault on recorded and simulated flights, and fly whole flights with faults."""
    seeds = range(1, context.seeds + 1)
    jobs = [Job(log=log) for log in context.recorded(RECORDED).values()]
    jobs += [Job(seed=seed) for seed in seeds]
    jobs += [Job(scenario=name, seed=seed) for name in SCENARIOS for seed in seeds]
    done = context.run(work, jobs)
    page = SectionPage("faults", context)
    _attribution(page, [row for each in results(done) for row in each.tried])
    _flights(page, [row for each in results(done) for row in each.flown])
    page.failures(done)
    return page


# Attribution


def _attribution(page: SectionPage, tried: list[Row]) -> None:
    page.text(
        "## Attribution\n\nEach fault begins on packets (`sim.faults`) at up to "
        f"{ONSETS} instants of a healthy flight; the estimator runs on from where it is then. "
        "Delays are from the first faulty packet on the vehicle's clock. *Named*: the output "
        "`faulty` is the right sensor. *Wrong*: another one was named meanwhile. *Detected*: "
        f"named, or the estimated spread is {DOUBT_RATIO:g} times that of the same flight without "
        "the fault. *Used*: cases in which a wrong fix was taken in after its receiver had been "
        "named. *Misleading*: how long the error was beyond the protection level, at worst. A "
        "frozen barometer is tried in climbs and descents of more than 1 m/s only."
    )
    for origin in ("recorded", "simulated"):
        members = [row for row in tried if row["origin"] == origin]
        page.measured(*_goals(origin, members))
        if members:
            flights = sorted({row["flight"] for row in members})
            page.grid(
                f"{origin.capitalize()} flights: {', '.join(flights)}", _HEAD, [*_table(members)]
            )
    worst = sorted((row for row in tried if _fails(row)), key=lambda row: -row["max_error_m"])
    if worst:
        page.grid(
            f"What fell short of its goal ({len(worst)} of {len(tried)}), the largest errors first",
            ["fault", "flight", "onset (s since boot)", "named after (s)", "wrong (%)", "used",
             "error (m)"],
            [
                [row["case"], row["flight"], f"{row['onset_s']:.2f}", _s(row["delay_s"]),
                 100 * row["wrong_share"],
                 row["used_while_wrong"], f"{row['max_error_m']:.1f}"]
                for row in worst[:SHOWN]
            ],
        )  # fmt: skip


_HEAD = ["fault", "n", "named (%)", "delay mean, worst (s)", "wrong", "detected (%)", "worst (s)",
         "used",
         "error during, after (m)", "misleading (s)"]  # fmt: skip


def _table(members: Sequence[Row]) -> Iterable[list[Value]]:
    for case in CASES:
        rows = [row for row in members if row["case"] == case.name]
        if not rows:
            continue
        delays, detected = _values(rows, "delay_s"), _values(rows, "detected_s")
        known = delays[np.isfinite(delays)]
        yield [
            case.name,
            len(rows),
            f"{100 * known.size / len(rows):.0f}",
            f"{np.mean(known):.2f}, {np.max(known):.2f}" if known.size else "",
            sum(row["wrong_share"] > 0.0 for row in rows),
            f"{100 * np.mean(np.isfinite(detected)):.0f}",
            f"{np.nanmax(detected):.1f}" if np.isfinite(detected).any() else "",
            sum(row["used_while_wrong"] > 0 for row in rows) if "GNSS" in case.name else "",
            f"{max(row['max_error_m'] for row in rows):.1f}, "
            f"{max(row['max_error_after_m'] for row in rows):.1f}",
            f"{max(row['misleading_s'] for row in rows):.1f}",
        ]


def _right_within(limit_s: float) -> Callable[[Row], bool]:
    return lambda row: row["delay_s"] <= limit_s and row["wrong_share"] == 0.0


def _is_frozen_named(row: Row) -> bool:
    return bool(
        row["delay_s"] <= max(FASTEST_S, INTERVALS * row["interval_s"])
        and row["wrong_share"] == 0.0
    )


def _stays_out(row: Row) -> bool:
    return bool(row["used_while_wrong"] == 0 and row["delay_s"] <= 1.5)


def _in_time(row: Row) -> bool:
    return bool(row["detected_s"] <= 45.0 and row["delay_s"] <= 60.0)


_WANTED: dict[str, tuple[str, str, Callable[[Row], bool], float]] = {
    "barometer +15 m": ("baro-step", "+15 m, named within 1 s", _right_within(1.0), 100.0),
    "barometer -15 m": ("baro-step", "-15 m, named within 1 s", _right_within(1.0), 100.0),
    "barometer +1 m/s": ("baro-step", "+1 m/s, named within 3 s", _right_within(3.0), 100.0),
    "barometer -1 m/s": ("baro-step", "-1 m/s, named within 3 s", _right_within(3.0), 100.0),
    "barometer frozen": ("frozen", "named in time", _is_frozen_named, 100.0),
    "GNSS +30 m": (
        "gnss-step",
        "+30 m for 100 s, out within 1.5 s and until the end",
        _stays_out,
        100.0,
    ),
    "GNSS -30 m": (
        "gnss-step",
        "-30 m for 100 s, out within 1.5 s and until the end",
        _stays_out,
        100.0,
    ),
    "GNSS +30 m for 10 min": ("gnss-step", "+30 m for 10 min, likewise", _stays_out, 100.0),
    "GNSS -30 m for 10 min": ("gnss-step", "-30 m for 10 min, likewise", _stays_out, 100.0),
    "GNSS +2 m/s": ("gnss-ramp", "+2 m/s, detected in 45 s and named in 60 s", _in_time, 100.0),
    "GNSS -2 m/s": ("gnss-ramp", "-2 m/s, detected in 45 s and named in 60 s", _in_time, 100.0),
    "GNSS +0.5 m/s": (
        "gnss-ramp",
        "+0.5 m/s, detected in 100 s",
        lambda row: row["detected_s"] <= 100.0,
        70.0,
    ),
    "GNSS -0.5 m/s": (
        "gnss-ramp",
        "-0.5 m/s, detected in 100 s",
        lambda row: row["detected_s"] <= 100.0,
        70.0,
    ),
}
"""case -> its goal, what is counted, whether a row is counted, and the share (%) that is wanted"""


def _fails(row: Row) -> bool:
    return not _WANTED[row["case"]][2](row)


def _goals(origin: str, members: Sequence[Row]) -> Iterable[Measured]:
    for case, (goal, what, counts, share) in _WANTED.items():
        rows = [row for row in members if row["case"] == case]
        good = sum(map(counts, rows))
        value = 100.0 * good / len(rows) if rows else None
        delays = [row["delay_s"] for row in rows if math.isfinite(row["delay_s"])]
        note = f"worst {max(delays):.2f} s" if delays else ""
        shown = f"{good} of {len(rows)}, {value:.0f}" if value is not None else ""
        yield Measured(
            goal, f"{origin}: {what}", value, at_least=share, unit="%", shown=shown, note=note
        )


# Whole flights


def _flights(page: SectionPage, flown: list[Row]) -> None:
    page.text(
        "## Flights with a fault\n\nArduPilot-like flights of `calm-circuit` whose log is "
        "corrupted as `kollsman-sim corrupt` does; the receiver errs by two slow swings (1 m, 3 "
        "m) and reports 0.3 m. RMSE (mean over the seeds) and largest error (of all seeds) in "
        "metres from one minute on. The simulated autopilot follows the faulty barometer from an "
        "origin of one early fix, as EKF3 by default. Height above take-off counts from arming; "
        "beside it what the raw barometer has changed by since then."
    )
    groups: dict[tuple[str, str], list[Row]] = defaultdict(list)
    for row in flown:
        groups[row["flight"], row["source"]].append(row)
    lines: list[list[Value]] = []
    for flight in FLIGHTS:
        ours = groups[flight.name, ESTIMATOR]
        if not ours:
            continue
        named = sorted({name for row in ours for name in row["named"]})
        others = (
            groups[flight.name, label]
            for label in ("simulated autopilot", "raw GNSS", "raw barometer")
        )
        names = ", ".join(("barometer", "GNSS", "IMU")[number - 1] for number in named)
        lines.append(
            [
                flight.name,
                *map(_short, (ours, *others)),
                _short(ours, "takeoff_"),
                _short(groups[flight.name, "raw barometer"], "takeoff_"),
                names or "none",
            ]
        )
        page.measured(*_flight_goals(flight.name, flight.sensor, ours))
    page.grid(
        "RMSE, largest error (m)",
        [
            "flight",
            ESTIMATOR,
            "simulated autopilot",
            "raw GNSS",
            "raw barometer",
            "height above take-off",
            "barometer's",
            "named",
        ],
        lines,
    )


def _flight_goals(name: str, sensor: str, ours: Sequence[Row]) -> Iterable[Measured]:
    rmse_m, max_m = float(np.mean(_values(ours, "rmse_m"))), float(np.max(_values(ours, "max_m")))
    if sensor != "none":
        goal, rmse_limit_m, max_limit_m = {
            "barometer": ("baro-faults", 2.4, 5.5),
            "gnss": ("gnss-faults", 2.6, 9.0),
        }[sensor]
        yield Measured(goal, f"{name}: RMSE", rmse_m, at_most=rmse_limit_m, unit="m")
        yield Measured(goal, f"{name}: largest", max_m, at_most=max_limit_m, unit="m")
    if sensor != "barometer":
        takeoff_m = float(np.mean(_values(ours, "takeoff_rmse_m")))
        yield Measured(
            "takeoff", f"{name}: height above take-off", takeoff_m, at_most=0.5, unit="m"
        )


def _short(rows: Sequence[Row], prefix: str = "") -> str:
    rmse_m, max_m = _values(rows, f"{prefix}rmse_m"), _values(rows, f"{prefix}max_m")
    return (
        f"{np.mean(rmse_m):.2f}, {np.max(max_m):.1f}"
        if rmse_m.size and np.isfinite(rmse_m).all()
        else ""
    )


def _values(rows: Sequence[Row], name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([row[name] for row in rows], np.float64)


def _s(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "never"
