"""What to do after a session: what would have given an altitude, and what to change of the
autopilot's."""

import math
from collections.abc import Iterator
from typing import Any

from companion.feedback.knobs import KNOBS

CHANGE_M = 3.0
"""a smaller difference of the autopilot's altitude needs no change"""
MOST_CHANGE_M = 100.0
"""a larger difference is no matter of a barometer's offset"""
LEAST_S = 60.0
"""a session that is shorter tells nothing about a change"""
LEAST_OWN_S = 20.0
"""of the autopilot's altitude beside ours, at the end"""
STANDARD_HPA = 1013.25
LOOK = {
    "gnss": "Look for interference (jamming, spoofing) or a covered antenna at that time.",
    "unknown": "Find out which: GNSS (interference, a covered antenna) or the barometer (wind or "
    "propellers over its port, light on it).",
}
"""what to look for where a sensor was wrong"""


def advice(found: dict[str, Any], doubt: str) -> Iterator[tuple[str, str]]:
    """(level, sentence) of a session's summary.

    `doubt`: GNSS and barometer disagreed without an exclusion: "gnss" or "barometer" was wrong, or
    it is "unknown" which; empty if they did not.
    """
    own, health = found["own_altitude"], found["health"]
    if health["first_s"] is None:
        used = found["gnss"].get("share_3d") and found["samples"].get("gnss", {}).get("used")
        if found["altitude"]["estimates"] and not used:
            yield (
                "note",
                "To get an altitude, fly with a GNSS 3D fix, or give air.qnh_hpa or "
                "air.field_elevation_m.",
            )
        return
    if not own:
        yield "note", "No advice for the autopilot: the log holds no altitude of its own."
        return
    if not own["span_s"] and own["without_origin_s"]:
        return  # told already
    if doubt in LOOK:
        yield "note", f"{LOOK[doubt]} Change nothing because of this session alone."
        return
    if own["span_s"] < LEAST_OWN_S or found["duration_s"] < LEAST_S:
        yield (
            "note",
            "Too short to say whether the autopilot needs a change: a minute of its altitude "
            "beside Kollsman's is needed.",
        )
        return
    yield _compared(found)


def _compared(found: dict[str, Any]) -> tuple[str, str]:
    """How the autopilot's altitude was beside ours in the last minute of both."""
    own = found["own_altitude"]
    above_m, sd_m = own["above_m"], found["altitude"]["median_sd_m"]
    within_m = max(CHANGE_M, 2.0 * sd_m) if math.isfinite(sd_m) else CHANGE_M
    side = "above" if above_m > 0.0 else "below"
    where = f"At the end the autopilot's altitude was {abs(above_m):.1f} m {side} Kollsman's"
    if abs(above_m) <= within_m:
        return "good", f"{where}, which is within what is known: nothing to change."
    change = _change(found["autopilot"], own["follows"], -above_m)
    return "warning", f"{where}. {change}"


def _change(autopilot: str, follows: str | None, raise_m: float) -> str:
    """What raises the autopilot's altitude by so many metres."""
    if abs(raise_m) > MOST_CHANGE_M:
        return (
            "That is more than weather: check its origin (home), and the heights of its receiver."
        )
    if follows == "gnss":
        return (
            "It follows GNSS: check the receiver's height; a barometer parameter changes nothing."
        )
    if autopilot == "ArduPilot":
        change, mode = f"BARO_ALT_OFFSET by {raise_m:+.1f} m", "baro-alt-offset"
    elif autopilot == "PX4":
        raised_hpa = KNOBS["qnh"].raised(STANDARD_HPA, raise_m) - STANDARD_HPA
        change, mode = f"SENS_BARO_QNH by {raised_hpa:+.1f} hPa", "qnh"
    else:
        return "Set the altitude of its barometer anew."
    condition = "" if follows == "barometer" else "If its height is the barometer's: "
    return (
        f"{condition}{'C' if not condition else 'c'}hange {change} for this flight, and back "
        f"before the next; feedback.mode {mode} does both."
    )
