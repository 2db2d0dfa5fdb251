"""Section ``real``: real flights with truth, real GNSS errors, injected faults, and what the
companion would publish."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from companion.estimators import DEFAULT_ESTIMATOR
from companion.jobs import Row, results
from sim.studies.goals import Context
from sim.studies.goals.goals import Measured
from sim.studies.goals.real_goals import matrix_goals, mean, own_rows, ratio, rtk_goals, worst_of
from sim.studies.goals.section import SectionPage
from sim.studies.page import Value
from sim.studies.real import found
from sim.studies.real.faults import try_all, windows
from sim.studies.real.gnss_errors import logs
from sim.studies.real.low_rates import Slow, fly_slow, preset_flights, slow_flights
from sim.studies.real.matrix import Cell, cells, fly, group, traces_in

SCENARIO_SEEDS = 4
"""seeds from which on the simulator's scenarios are flown too"""


def evaluate(context: Context) -> SectionPage:
    """Fly the matrix and the faults on a process pool, then fill the page."""
    page = SectionPage("real", context)
    paths = found(context.data) if context.data is not None else []
    if context.data is None or not paths:
        page.text("Not run: `--data` names no folder with real flights.")
        return page
    searched = context.run(traces_in, logs(context.data))
    traces = [trace for found_traces in results(searched) for trace in found_traces]
    jobs = list(cells(paths, traces, context.seeds))
    jobs += [_with_elevation(cell) for cell in jobs if _asks_elevation(cell)]
    flown = context.run(fly, jobs, lambda cell: cell.plan.imu_hz)
    tried = context.run(
        try_all, list(windows(paths, _onsets(context))), lambda window: window.imu_hz
    )
    scenarios = slow_flights() if context.seeds >= SCENARIO_SEEDS else []
    slow = context.run(fly_slow, scenarios, by_length)
    like_real = context.run(fly_slow, preset_flights(context.seeds), by_length)
    rows = [row for found_rows in results(flown) for row in found_rows]
    faults = [row for found_rows in results(tried) for row in found_rows]
    page.measured(*matrix_goals(rows), *rtk_goals(rows), *_fault_goals(faults))
    page.text(_ABOUT.format(flights=", ".join(sorted({row["flight"] for row in rows}))))
    _matrix_part(page, rows)
    _fault_part(page, faults)
    _scenario_part(page, [row for found_rows in results(slow) for row in found_rows])
    page.measured(*_preset_goals(rows, [row for found in results(like_real) for row in found]))
    page.failures([*searched, *flown, *tried, *slow, *like_real])
    return page


def by_length(job: Slow) -> float:
    """How long a job takes, in proportion."""
    return job.scenario.planned_s


def _preset_goals(rows: Sequence[Row], simulated: Sequence[Row]) -> list[Measured]:
    """Ratio to raw GNSS of flights with the presets, less that of the real flights, without IMU."""
    real = mean([row for row in own_rows(rows) if row["imu_hz"] == 0], ratio)
    measured = []
    for (name,), each in group(
        [row for row in simulated if row["imu_hz"] == 0], "scenario"
    ).items():
        found = mean(each, ratio)
        note = f"{found:.2f} simulated, {real:.2f} real; {len(each)} flights"
        measured.append(Measured("real-presets", name, abs(found - real), 0.1, note=note))
    return measured


def _onsets(context: Context) -> int:
    """Fault windows a flight and IMU rate: 3 for 8 seeds, 6 for 20."""
    return context.seeds // 4 + 1


def _asks_elevation(cell: Cell) -> bool:
    return not cell.own_gnss and cell.trace is None and cell.plan.imu_hz in (0, 50)


def _with_elevation(cell: Cell) -> Cell:
    return replace(cell, plan=replace(cell.plan, field_elevation=True), others=False)


_FAULT_LIMITS: dict[str, tuple[str, float | None, float | None, float | None]] = {
    "GNSS +30 m": ("real-gnss-step", 1.0, 15.0, 2.0),
    "GNSS -30 m": ("real-gnss-step", 1.0, 15.0, 2.0),
    "GNSS +100 m": ("real-gnss-step", 1.0, 15.0, 2.0),
    "GNSS +100 m, claims 1 mm": ("real-gnss-step", 1.0, 15.0, 2.0),
    "GNSS +300 m, claims 0.5 m": ("real-gnss-step", 1.0, 15.0, 2.0),
    "GNSS +500 m, claims 1.5 m": ("real-gnss-step", 1.0, 15.0, 2.0),
    "GNSS +30 m for 10 min": ("real-gnss-step", 1.0, 15.0, None),
    "GNSS +2 m/s": ("real-gnss-ramp", 12.0, 12.0, None),
    "GNSS +1 m/s": ("real-gnss-ramp", 40.0, 25.0, None),
    "GNSS +0.5 m/s": ("real-gnss-ramp", None, 50.0, None),
    "GNSS +0.3 m/s": ("real-gnss-ramp", None, 50.0, None),
    "barometer +15 m": ("real-baro-step", 0.5, 10.0, None),
    "barometer -15 m": ("real-baro-step", 0.5, 10.0, None),
    "barometer frozen": ("real-baro-step", 0.5, 10.0, None),
    "barometer +50 m in 2 s, no GNSS": ("real-baro-blind", None, 15.0, None),
    "barometer +50 m in 20 s, no GNSS": ("real-baro-blind", None, 15.0, None),
    "barometer +300 m in 20 s, no GNSS": ("real-baro-blind", None, 15.0, None),
}
"""Case -> goal, and at most: named within (s), published error (m), back after the end (s)."""
_RETURNS = ("outage of 60 s", "outage of 300 s", "outage of 600 s", "gap of 60 s",
            "5 s of contact, then silence", "restart")  # fmt: skip


def _late(row: Row, name: str) -> float:
    """A time that never came is late without end."""
    value = float(row[name])
    return math.inf if math.isnan(value) else value


def _fault_goals(rows: Sequence[Row]) -> list[Measured]:
    found_goals = []
    cases = {case: each for (case,), each in group(rows, "case").items()}
    for case, (goal, named_s, error_m, back_s) in _FAULT_LIMITS.items():
        for name, limit, unit, what in (
            ("named_s", named_s, "s", "named, worst"),
            ("sent_max_m", error_m, "m", "published error, worst"),
            ("back_s", back_s, "s", "back, worst"),
        ):
            if limit is not None and case in cases:
                found_goals.append(
                    _worst_of(goal, f"{case}: {what}", cases[case], name, limit, unit)
                )
    for case in _RETURNS:
        if case in cases:
            found_goals.append(
                _worst_of("real-return", case, cases[case], "first_sent_s", 5.0, "s")
            )
    outages = [row for case in _RETURNS[:3] for row in cases.get(case, [])]
    if outages:
        nees = mean(outages, lambda row: row["nees"])
        found_goals.append(Measured("real-outage", "mean", nees, 1.5))
    return found_goals


def _worst_of(
    goal: str, what: str, rows: Sequence[Row], name: str, limit: float, unit: str
) -> Measured:
    values = [_late(row, name) for row in rows]
    worst = rows[int(np.argmax(values))]
    met = sum(value <= limit for value in values)
    note = f"{met} of {len(rows)} within; worst {worst['flight']}, IMU {worst['imu_hz']} Hz"
    value = max(values)
    shown = "never" if math.isinf(value) else ""
    return Measured(
        goal, what, math.nan if math.isinf(value) else value, limit, None, unit, shown, note
    )


# Tables


def _matrix_part(page: SectionPage, rows: Sequence[Row]) -> None:
    own = own_rows(rows)
    lines: list[list[Value]] = []
    for (flight, error, imu_hz), each in group(own, "flight", "error", "imu_hz").items():
        lines.append(
            [
                flight, error, imu_hz, len(each), *_cells(each),
            ]
        )  # fmt: skip
    page.text("## Without a fault")
    page.grid(
        f"{DEFAULT_ESTIMATOR}, means over the runs (the last five: worst, sums)",
        ["flight", "GNSS error", "IMU Hz", "runs", "RMSE m", "raw GNSS m", "ratio", "NEES",
         "level m", "climb m/s", "max m", "sent % (least)", "sent > 50 m", "above level",
         "OK wrong s"],
        lines,
    )  # fmt: skip
    compared = [row for row in rows if row["error"] != "own" and row["seed"] == 1]
    table: list[list[Value]] = [
        [estimator, f"{mean(each, ratio):.2f}", f"{worst_of(each, ratio)[0]:.2f}",
         f"{mean(each, lambda row: row['nees']):.2f}", sum(row["sent_wrong"] for row in each)]
        for (estimator,), each in group(compared, "estimator").items()
    ]  # fmt: skip
    page.grid(
        "Every estimator, seed 1, all IMU rates",
        ["estimator", "RMSE / raw GNSS", "worst", "NEES", "sent > 50 m wrong"],
        table,
    )
    receivers = [row for row in rows if row["error"] == "own"]
    page.grid(
        "Recorded RTK receiver",
        ["flight", "IMU Hz", "attitude", "RMSE m", "receiver's m", "spread m", "level m", "max m"],
        [
            [row["flight"], row["imu_hz"], "yes" if row["attitude"] else "no",
             *(f"{row[name]:.3f}" for name in ("rmse_m", "raw_rmse_m", "median_sd_m",
                                               "median_level_m", "max_m"))]
            for row in receivers
        ],
    )  # fmt: skip


def _cells(rows: Sequence[Row]) -> list[Value]:
    means = [
        mean(rows, lambda row: row["rmse_m"]),
        mean(rows, lambda row: row["raw_rmse_m"]),
        mean(rows, ratio),
        mean(rows, lambda row: row["nees"]),
        mean(rows, lambda row: row["median_level_m"]),
        mean(rows, lambda row: row["climb_rmse_mps"]),
        max(row["max_m"] for row in rows),
        100.0 * min(row["sent_share"] for row in rows),
    ]
    counts = [sum(row[name] for row in rows) for name in ("sent_wrong", "sent_above_level")]
    return [*(f"{value:.2f}" for value in means), *counts,
            f"{max(row['ok_wrong_s'] for row in rows):.1f}"]  # fmt: skip


def _fault_part(page: SectionPage, rows: Sequence[Row]) -> None:
    page.text(
        "## Faults injected into real flights\n\n" + _FAULTS.format(onsets=_onsets(page.context))
    )
    lines: list[list[Value]] = []
    for (case, imu_hz), each in group(rows, "case", "imu_hz").items():
        lines.append(
            [
                case, imu_hz, len(each),
                *(_never(max(_late(row, name) for row in each)) for name in
                  ("named_s",)),
                f"{max(row['sent_max_m'] for row in each):.1f}",
                sum(row["sent_wrong"] for row in each),
                f"{100.0 * mean(each, lambda row: row['sent_share']):.0f}",
                f"{max(row['ok_max_m'] for row in each):.1f}",
                *(_never(max(_late(row, name) for row in each)) for name in
                  ("back_s", "first_sent_s", "ok_after_s")),
            ]
        )  # fmt: skip
    page.grid(
        "Worst over flights and onsets",
        ["case", "IMU Hz", "runs", "named s", "published error m", "sent > 50 m", "sent % during",
         "error while OK m", "back s", "first ALTITUDE s", "OK after s"],
        lines,
    )  # fmt: skip


def _scenario_part(page: SectionPage, rows: Sequence[Row]) -> None:
    if not rows:
        return
    page.measured(
        *(
            Measured(
                "real-scenarios",
                f"IMU {imu_hz} Hz, ALTITUDE > 50 m wrong",
                sum(row["sent_wrong"] for row in each),
                0.0,
                note=f"of {sum(row['sent'] for row in each)}; "
                + ", ".join(row["scenario"] for row in each if row["sent_wrong"]),
            )
            for (imu_hz,), each in group(rows, "imu_hz").items()
        )
    )
    rates = list(group(rows, "imu_hz"))
    page.grid(
        "The simulator's scenarios at low IMU rates: RMSE / raw GNSS (ALTITUDE > 50 m wrong)",
        ["scenario", *(f"{imu_hz} Hz" for (imu_hz,) in rates)],
        [
            [name, *(f"{ratio(row):.2f} ({row['sent_wrong']})" for row in each)]
            for (name,), each in group(rows, "scenario").items()
        ],
    )


def _never(value: float) -> str:
    return "never" if math.isinf(value) else f"{value:.1f}"


_ABOUT = """Flights: {flights}. What is real in each is said by its loader (`sim/studies/real`). A
cell is one flight with one IMU rate, with or without the autopilot's attitude, with 0 or 1 s of
the recorded barometer's lag taken out, and one error of a cheap receiver laid on: `Gauss-Markov`
is 4 m over 250 s and .15 m white; `recorded` is what a receiver that stood still did, with the
accuracy that it reported. Errors count after the first minute. Raw GNSS is the same receiver.
"Sent" is what `companion.evaluation.published` says of ALTITUDE: the pipeline's own health and
output rules over the estimator's output. "OK wrong" is the longest time for which health was OK
with an error beyond 4 times its estimated spread. Ratios leave out flights under half an hour."""

_FAULTS = """{onsets} onsets a flight, evenly spread, at IMU rates of 0, 2 and 50 Hz, Gauss-Markov
error, barometer as recorded. `named` counts from the onset; `back` from the end of the fault until
the estimate stays within 5 m of that of the healthy flight; `first ALTITUDE` and `OK after` from
the end of the fault. The published error counts from the onset to two minutes after the end."""
