"""Section ``flights``: accuracy and honesty of every estimator on simulated and on recorded
flights."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from sim.scenario import scenario_paths
from sim.studies.goals import Context
from sim.studies.goals.flight_jobs import (
    ABLATIONS,
    BANK,
    OUTAGE_S,
    OUTAGES_S,
    PREFIX,
    Recorded,
    Row,
    Simulated,
    cost,
    work,
)
from sim.studies.goals.goals import Measured
from sim.studies.goals.section import SectionPage
from sim.studies.goals.sensor_level import Array
from sim.studies.page import Value

SCENARIOS = {
    "calm-circuit": (2.9, 2.5),
    "weather-change": (3.1, 2.65),
    "airliner-descent": (3.1, 2.5),
    "airliner-front": (3.4, 3.0),
}
"""Name -> goal (RMSE, m) without and with GNSS vertical velocity."""
RECORDED = ("jsbsim_A", "jsbsim_B", "ardupilot_nominal", "ardupilot_weather")
TAKE_OFF = ("calm-circuit",)
"""scenarios that take off with a healthy barometer in weather that stays as it is; the airliners
start aloft"""
COLUMNS = {
    "RMSE": "rmse_m", "95 %": "p95_m", "max": "max_m", "bias": "bias_m",
    "no bias": "unbiased_rmse_m", "take-off": "takeoff_rmse_m", "climb": "climb_rmse_mps",
    "NEES": "nees", "sd": "median_sd_m",
}  # fmt: skip

Flight = dict[str, dict[str, Row]]
Flights = dict[str, list[Flight]]


def evaluate(context: Context) -> SectionPage:
    """Fly and read on a process pool, then fill the page."""
    known = [name for name in SCENARIOS if name in scenario_paths()]
    paths = context.recorded(RECORDED)
    jobs: list[Recorded | Simulated] = [Recorded(path) for path in paths.values()]
    jobs += [Simulated(name, seed) for name in known for seed in range(1, context.seeds + 1)]
    done = context.run(work, jobs)
    logs = {
        each.job.path.stem: each.result
        for each in done
        if isinstance(each.job, Recorded) and each.result is not None
    }
    ordered: Flights = {name: [] for name in known}
    for each in done:
        if isinstance(each.job, Simulated) and each.result is not None:
            ordered[each.job.scenario].append(each.result)
    page = SectionPage("flights", context)
    page.measured(*_recorded_rows(logs), *_simulated_rows(ordered), *_cost_rows(paths))
    _simulated_part(page, ordered)
    recordings = {name: logs[name] for name in RECORDED if name in logs}
    _recorded_part(page, recordings)
    _ablation_part(page, ordered, recordings)
    page.failures(done)
    return page


def values_of(flights: list[Flight], source: str, measure: str) -> Array:
    """One value a flight; unknown is NaN."""
    return np.array(
        [flight["results"].get(source, {}).get(measure, math.nan) for flight in flights], np.float64
    )


def mean_interval(values: Array) -> str:
    """Mean over the flights and its 95 % interval (normal)."""
    half = (
        1.96 * float(np.std(values, ddof=1)) / math.sqrt(values.size)
        if values.size > 1
        else math.nan
    )
    mean = float(np.mean(values))
    return f"{mean:.2f} [{mean - half:.2f}, {mean + half:.2f}]"


def _over_seeds(
    goal: str,
    what: str,
    values: Array,
    at_most: float | None,
    at_least: float | None,
    unit: str,
    note: str = "",
) -> Measured:
    shown, note = mean_interval(values), f"{values.size} seeds" + (f"; {note}" if note else "")
    return Measured(goal, what, float(np.mean(values)), at_most, at_least, unit, shown, note)


def _simulated_rows(flights: Flights) -> list[Measured]:
    rows = []
    for name, limits in SCENARIOS.items():
        for goal, label, limit in (
            ("simulated", BANK, limits[0]),
            ("simulated-climb", f"{BANK}, GNSS climb", limits[1]),
        ):
            if name not in flights:
                rows.append(Measured(goal, name, note="no such scenario"))
                continue
            rows.append(
                _over_seeds(goal, name, values_of(flights[name], label, "rmse_m"), limit, None, "m")
            )
        if name in flights:
            rows.append(
                _over_seeds("nees", name, values_of(flights[name], BANK, "nees"), 1.4, 0.7, "")
            )
            if name in TAKE_OFF:
                values = values_of(flights[name], BANK, "takeoff_rmse_m")
                sensor_m = float(
                    np.mean(values_of(flights[name], "raw barometer", "takeoff_rmse_m"))
                )
                note = f"the barometer itself has moved by {sensor_m:.2f} m"
                rows.append(_over_seeds("takeoff", name, values, 0.5, None, "m", note))
    return rows


def _recorded_rows(logs: dict[str, dict[str, Any]]) -> list[Measured]:
    limits: dict[str, list[tuple[str, str, float, str]]] = {
        "jsbsim_A": [
            ("jsbsim", "rmse_m", 2.6, "m"),
            ("jsbsim", "climb_rmse_mps", 0.08, "m/s"),
            ("takeoff", "takeoff_rmse_m", 0.5, "m"),
        ],
        "jsbsim_B": [("jsbsim", "rmse_m", 2.6, "m"), ("jsbsim", "climb_rmse_mps", 0.10, "m/s")],
        "ardupilot_nominal": [
            ("ardupilot", "rmse_m", 0.15, "m"),
            ("takeoff", "takeoff_rmse_m", 0.5, "m"),
        ],
        "ardupilot_weather": [("ardupilot", "rmse_m", 2.4, "m"), ("ardupilot", "max_m", 5.5, "m")],
    }
    words = {
        "rmse_m": "RMSE",
        "climb_rmse_mps": "climb",
        "takeoff_rmse_m": "height above take-off",
        "max_m": "max",
    }
    rows = []
    for name, each in limits.items():
        own = logs.get(name, {}).get("results", {}).get(BANK, {})
        rows += [
            Measured(goal, f"{name}, {words[key]}", own.get(key), limit, None, unit)
            for goal, key, limit, unit in each
        ]
    for name in ("jsbsim_A", "ardupilot_nominal"):
        rows.append(Measured("qnh", name, logs.get(name, {}).get("qnh_m"), 0.1, None, "m"))
    for name in ("jsbsim_A", "jsbsim_B"):
        found = logs.get(name)
        ratio = found["thinned"]["rmse_m"] / found["whole"]["rmse_m"] if found else None
        note = (
            f"{found['thinned']['rmse_m']:.2f} m, whole {found['whole']['rmse_m']:.2f} m"
            if found
            else ""
        )
        rows.append(Measured("thinned", f"{name}, ratio", ratio, 1.10, note=note))
    return rows + _outage_rows(logs["jsbsim_B"]["outages"] if "jsbsim_B" in logs else {})


def _outage_rows(outages: dict[float, tuple[float, float]]) -> list[Measured]:
    middle_s = OUTAGES_S[1]
    rmse_m, max_m = outages.get(middle_s, (None, None))
    others = "; ".join(
        f"from {start_s:g} s {rmse:.1f}, max {top:.1f} m"
        for start_s, (rmse, top) in outages.items()
        if start_s != middle_s
    )
    note = f"{middle_s:g} to {middle_s + OUTAGE_S:g} s"
    return [
        Measured(
            "outage", "RMSE", rmse_m, 20.0, unit="m", note=f"{note}; {others}" if others else note
        ),
        Measured("outage", "max", max_m, 33.0, unit="m", note=note),
    ]


def _cost_rows(paths: dict[str, Path]) -> list[Measured]:
    if "jsbsim_A" not in paths:
        return []
    imu_us, sample_us, size = cost(paths["jsbsim_A"])
    note = (
        f"whole loop over its IMU samples; {sample_us:.2f} us a sample of any kind; depends on "
        "the machine"
    )
    return [
        Measured("cost", "IMU sample", imu_us, 2.5, unit="us", note=note),
        Measured(
            "cost", "checkpoint", size / 1024.0, 64.0, unit="KiB", shown=f"{size / 1024.0:.1f}"
        ),
    ]


def _simulated_part(page: SectionPage, flights: Flights) -> None:
    page.text(_SIMULATED.format(seeds=page.context.seeds))
    for name, each in flights.items():
        rows: list[list[Value]] = []
        for label in each[0]["results"]:
            cells: list[Value] = [label]
            for measure in COLUMNS.values():
                values = values_of(each, label, measure)
                values = values[np.isfinite(values)]
                cells.append(
                    ""
                    if not values.size
                    else f"{values.max() if measure == 'max_m' else values.mean():.2f}"
                )
            rows.append(cells)
        page.grid(f"{name}, {len(each)} seeds (m, m/s)", ["source", *COLUMNS], rows)


def _recorded_part(page: SectionPage, logs: dict[str, dict[str, Any]]) -> None:
    if not logs:
        page.text("## Recorded flights\n\nNot run: `--data` names no folder with them.")
        return
    page.text(
        "## Recorded flights\n\nNo parameter of any estimator was fitted to them, but for the "
        "drift threshold of `robust-altimeter`'s re-acquisition, chosen among three values with "
        "jsbsim_B in view. jsbsim_A and ardupilot_nominal fly in exactly standard air, where "
        "whoever trusts 1013.25 hPa looks brilliant."
    )
    for name, found in logs.items():
        rows: list[list[Value]] = [
            [label, *(_cell(result[measure]) for measure in COLUMNS.values())]
            for label, result in found["results"].items()
        ]
        page.grid(f"{name} (m, m/s)", ["source", *COLUMNS], rows)


def _ablation_part(page: SectionPage, flights: Flights, logs: dict[str, dict[str, Any]]) -> None:
    page.text(_ABLATIONS.format(prefix=PREFIX))
    columns = {
        name: [flight["ablations"] for flight in each if flight["ablations"]]
        for name, each in flights.items()
    }
    columns |= {name: [found["ablations"]] for name, found in logs.items()}
    rows: list[list[Value]] = []
    for name, changes in ABLATIONS.items():
        texts = ", ".join(f"`{change}`" for change in changes)
        rows.append(
            [name, texts, *(_pair([each[name] for each in column]) for column in columns.values())]
        )
    heads = [
        f"{name}, {len(column)}" if len(column) > 1 else name for name, column in columns.items()
    ]
    page.grid("RMSE (NEES)", ["ablation", f"--set {PREFIX}", *heads], rows)


def _pair(rows: list[Row]) -> str:
    rmse_m, nees = (float(np.mean([row[name] for row in rows])) for name in ("rmse_m", "nees"))
    return f"{rmse_m:.2f} ({nees:.2f})"


def _cell(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else ""


_SIMULATED = """## Simulated flights

Seeds 1 to {seeds} of each scenario; `GNSS climb` is the receiver's own vertical velocity
(GPS_RAW_INT has none; the autopilot's own logs have). Mean over the seeds; `max` is the worst of
all; `take-off` is the error of the height above take-off, for sources that tell none that of their
altitude since arming; NEES 1 is an honest spread, more is overconfident."""

_ABLATIONS = """## Ablations

One state, or the bank, switched off: `kollsman compare LOG --set {prefix}KEY=VALUE`. RMSE (m) and
NEES; simulated ones are means over the first seeds."""
