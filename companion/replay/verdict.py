"""A session in words: whose altitude was wrong, which sensor, and why. One sentence a finding.

The words follow from the figures of `companion.replay.summary` alone, so that every page says the
same. Where the altitude is LOST none is sent, and none is wrong. An altitude is called wrong beyond
`WRONG_M` plus three standard deviations of the reference.
"""

import math
from typing import Any

WRONG_M = 10.0
DRIFT_M = 5.0
"""a drift of the barometer that is worth a sentence"""
WANDER_M = 5.0
LONG_EXCLUSION_S = 5.0
NAMES = {"baro": "barometer", "gnss": "GNSS", "autopilot": "autopilot's altitude"}


def verdict(found: dict[str, Any]) -> dict[str, Any]:
    """``wrong`` (names of sources), ``score_m`` (for sorting: the worst altitude) and ``verdict``
    (sentences) of a session's summary."""
    reference = found["reference"]
    sd_m = reference["sd_m"] if math.isfinite(reference["sd_m"]) else 0.0
    limit_m = WRONG_M + 3.0 * sd_m
    sources = found["sources"]
    wrong = [
        name for name in ("published", "autopilot") if _p95_without_datum(sources, name) > limit_m
    ]
    score_m = max(
        (_p95_without_datum(sources, name) for name in sources if name != "estimate"), default=0.0
    )
    sentences = [*_altitude(found), *_wrong(found, wrong), *_barometer(found), *_gnss(found)]
    sentences += _exclusions(found)
    return {"wrong": wrong, "score_m": score_m, "verdict": " ".join(sentences)}


def _p95_without_datum(sources: dict[str, Any], name: str) -> float:
    """95 % of the differences of a source; of a raw barometer without its constant offset, which is
    the weather's."""
    source = sources.get(name)
    if source is None:
        return 0.0
    key = "unbiased_rmse_m" if name == "baro" else "p95_m"
    value = source[key]
    return float(value) if value is not None and math.isfinite(value) else 0.0


def _altitude(found: dict[str, Any]) -> list[str]:
    altitude, health = found["altitude"], found["health"]
    if not altitude["estimates"]:
        return ["No altitude: there is no usable barometer or GNSS height."]
    lost = health["share"].get("LOST", 0.0)
    if lost > 0.5:
        reason = f": {health['reason']}" if health["at_end"] == "LOST" else ""
        return [f"The altitude was lost for {lost:.0%} of the session{reason}."]
    sd_m = altitude["median_sd_m"]
    return [f"Altitude is known within {2.0 * sd_m:.1f} m (95 %)."] if math.isfinite(sd_m) else []


def _wrong(found: dict[str, Any], wrong: list[str]) -> list[str]:
    what = "truth" if found["reference"]["kind"] == "truth" else "the smoothed altitude"
    said = []
    for name in wrong:
        whose = "Kollsman's altitude" if name == "published" else "The autopilot's own altitude"
        source = found["sources"][name]
        said.append(
            f"{whose} differed from {what} by up to {source['max_m']:.0f} m "
            f"(95 % within {source['p95_m']:.0f} m)."
        )
    return said


def _barometer(found: dict[str, Any]) -> list[str]:
    drift_m = found["barometer"].get("drift_m")
    said = []
    if drift_m is not None and abs(drift_m) >= DRIFT_M:
        minutes = found["duration_s"] / 60.0
        said.append(f"The barometer drifted {drift_m:+.0f} m in {minutes:.0f} minutes.")
    if found["suspect"].get("pressure"):
        said.append("The barometer contradicted GNSS beyond any weather and was not used then.")
    return said


def _gnss(found: dict[str, Any]) -> list[str]:
    gnss = found["gnss"]
    if not gnss.get("fixes"):
        return ["There was no GNSS receiver."]
    said = []
    if gnss["share_3d"] < 0.5:
        said.append(f"GNSS had a 3D fix for only {gnss['share_3d']:.0%} of the time.")
    wander_m = gnss.get("wander_m", math.nan)
    if math.isfinite(wander_m) and wander_m >= WANDER_M:
        claimed_m = gnss["median_sd_m"]
        said.append(
            f"GNSS height wandered by {wander_m:.0f} m (1 sigma); it reported {claimed_m:.0f} m."
        )
    if found["suspect"].get("gnss"):
        said.append("GNSS jumped against the barometer and was not used then.")
    return said


def _exclusions(found: dict[str, Any]) -> list[str]:
    names = {"barometer": "The barometer", "gnss": "GNSS", "imu": "The IMU"}
    said = []
    for sensor, name in names.items():
        spans = [each for each in found["exclusions"] if each["sensor"] == sensor]
        total_s = sum(each["duration_s"] for each in spans)
        if total_s >= LONG_EXCLUSION_S:
            first_s = spans[0]["from_s"]
            said.append(
                f"{name} was excluded for {total_s:.0f} s, first {first_s:.0f} s after the start."
            )
    return said
