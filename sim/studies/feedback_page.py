"""The page of the study of the feedback: tables of errors, and a figure of each case."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.jobs import Row
from companion.plots.drawing import figure, legend_outside, write_png
from companion.plots.style import FUSED, INERTIAL, OTHER, TRUTH
from sim.studies.page import markdown_table
from sim.vehicle.flavours import ARDUPILOT

Array = NDArray[np.float64]
GOALS = {"amsl": (1.9, 3.5), "relative": (2.0, 4.5)}
"""RMSE and largest error at a drift of .05 m/s, m"""
SIMPLE = {"gnss_m": 60.0, "ours_m": 10.0}
"""the heights that the simple corrections follow, with the time constant of their low-pass, s"""
Flown = tuple[str, list[Row], list[Row]]
"""title, flight without feedback, flight with it"""


def column(rows: Sequence[Row], name: str) -> Array:
    return np.array([row[name] for row in rows], np.float64)


def simple_correction_m(rows: Sequence[Row], source: str) -> Array:
    """A correction without any condition: the low-passed difference of a height and the
    autopilot's, written every second and followed as ArduPilot follows BARO_ALT_OFFSET, m."""
    wanted_m = column(rows, source) - column(rows, "own_m")
    written_m = effect_m = 0.0
    effects = np.empty(len(rows))
    for k, wanted in enumerate(wanted_m):
        if math.isfinite(wanted):
            written_m += (wanted - written_m) / SIMPLE[source]
        effect_m += (written_m - effect_m) * -math.expm1(-1.0 / ARDUPILOT.raise_time_s)
        effects[k] = effect_m
    return effects


def errors(rows: Sequence[Row], start_s: float, correction_m: Array | float = 0.0) -> Row:
    """Errors of the autopilot's own altitude from `start_s` on, with a correction that was not
    flown, and the largest step that a write makes in it."""
    shown = column(rows, "time_s") >= start_s
    own = column(rows, "own_m") - column(rows, "true_m")
    corrected = own + correction_m
    at_home = corrected - own + column(rows, "relative_error_m")
    # Height above home counts from the start: a correction of the datum is in both.
    at_home -= at_home[np.argmax(shown)] - column(rows, "relative_error_m")[np.argmax(shown)]
    steps = np.abs(np.diff(column(rows, "raised_m")))[np.diff(column(rows, "boots")) == 0.0]
    return {
        "amsl_rmse_m": _rmse(corrected[shown]),
        "amsl_max_m": float(np.max(np.abs(corrected[shown]))),
        "relative_rmse_m": _rmse(at_home[shown]),
        "relative_max_m": float(np.max(np.abs(at_home[shown]))),
        "step_m": float(np.max(steps, initial=0.0)),
        "writes": float(np.max(column(rows, "writes"), initial=0.0)),
    }


def _rmse(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))


def page_of(flights: Sequence[Flown], start_s: float) -> str:
    """The page, in Markdown."""
    figures = "\n\n".join(f"![{title}]({slug(title)}.png)" for title, *_ in flights)
    amsl, relative = GOALS["amsl"], GOALS["relative"]
    return (
        "# Feedback to the autopilot\n\n"
        "Written by `kollsman-sim feedback`. The simulated ArduPilot flies by its own altitude. "
        f"Errors of that altitude from {start_s:.0f} s on, RMSE / largest, in metres, one seed "
        "each. The drift is real: the sea-level pressure changes. *As SITL*: sensors with the "
        "errors of ArduPilot's SITL, no GNSS error and a reported accuracy of 0.3 m. *Wandering "
        "receiver*: a GNSS height that wanders by 3 m and reports 4.2 m.\n\n"
        "- Nothing: the flight without feedback.\n"
        "- GNSS low-passed: on the same flight, the raw GNSS height less the autopilot's altitude, "
        f"low-passed over {SIMPLE['gnss_m']:.0f} s and written without any condition.\n"
        f"- ALTITUDE low-passed: the same with our estimate, {SIMPLE['ours_m']:.0f} s.\n"
        "- Feedback: a second flight with `feedback.mode: baro-alt-offset`, all other keys at "
        "their defaults.\n\n"
        f"## Altitude above mean sea level\n\n{_table(flights, start_s, 'amsl')}\n\n"
        f"## Height above home\n\n{_table(flights, start_s, 'relative')}\n\n"
        f"Goals at a drift of .05 m/s, as SITL: AMSL {amsl[0]} / {amsl[1]}, above home "
        f"{relative[0]} / {relative[1]}; in every case at most 1.1 times the RMSE without "
        f"feedback; no change above .15 m by a write.\n\n{_limits(flights, start_s)}\n\n"
        f"{figures}\n"
    )


def _table(flights: Sequence[Flown], start_s: float, kind: str) -> str:
    lines = []
    for title, before, after in flights:
        simple = [errors(before, start_s, simple_correction_m(before, each)) for each in SIMPLE]
        nothing, flown = errors(before, start_s), errors(after, start_s)
        cells = [
            f"{found[f'{kind}_rmse_m']:.2f} / {found[f'{kind}_max_m']:.2f}"
            for found in (nothing, *simple, flown)
        ]
        ratio = flown[f"{kind}_rmse_m"] / nothing[f"{kind}_rmse_m"]
        more = [f"{flown['step_m']:.2f}", f"{flown['writes']:.0f}"]
        lines.append([title, *cells, f"{ratio:.2f}", *more])
    head = ["case", "nothing", "GNSS low-passed", "ALTITUDE low-passed", "feedback"]
    return markdown_table([*head, "feedback : nothing", "largest step", "writes"], lines)


def _limits(flights: Sequence[Flown], start_s: float) -> str:
    worse = [
        f"{title} ({where})"
        for title, before, after in flights
        for kind, where in (("amsl_rmse_m", "AMSL"), ("relative_rmse_m", "above home"))
        if errors(after, start_s)[kind] > 1.1 * errors(before, start_s)[kind]
    ]
    told = "; ".join(worse) if worse else "none"
    return f"Cases in which feedback is worse than 1.1 times nothing: {told}."


def slug(name: str) -> str:
    """A file's name."""
    told = name.lower().replace("+", "plus ").replace("-.", "minus .")
    words = "".join(letter if letter.isalnum() else " " for letter in told).split()
    return "-".join(words)


def draw(title: str, before: Sequence[Row], after: Sequence[Row], path: Path) -> None:
    """Error of the autopilot's own altitude, and the correction, over time."""
    with figure(1, panel_in=3.2) as (canvas, (axes,)):
        for rows, colour, label in ((before, INERTIAL, "without"), (after, FUSED, "with feedback")):
            errors_m = column(rows, "own_m") - column(rows, "true_m")
            axes.plot(column(rows, "time_s") / 60.0, errors_m, color=colour, label=label)
        axes.plot(
            column(after, "time_s") / 60.0,
            column(after, "raised_m"),
            color=OTHER,
            linestyle=":",
            label="BARO_ALT_OFFSET",
        )
        axes.axhline(0.0, color=TRUTH, linewidth=0.8, zorder=0)
        axes.set_title(title)
        axes.set_ylabel("error of the autopilot's own altitude (m)")
        axes.set_xlabel("time (min)")
        legend_outside(axes)
        write_png(canvas, path)
