"""A session in words: how well the altitude is known, what was wrong, and what to do.

One sentence a finding. The words follow from the figures of `companion.replay.summary` alone, so
that every page says the same. Where the altitude is LOST none is sent, and none is wrong. An
altitude is called wrong beyond `WRONG_M` plus three standard deviations of the reference.
"""

import math
from collections.abc import Iterator
from typing import Any

from companion.feedback.knobs import KNOBS

WRONG_M = 10.0
DRIFT_M = 5.0
"""a drift of the barometer that is worth a sentence"""
WANDER_M = 5.0
LONG_EXCLUSION_S = 5.0
MOST_EXCLUSIONS = 4
"""exclusions of one sensor with a sentence each; more are told together"""
MOST_NOTES = 4
LARGER = 1.2
"""an error that is so many times as large as reported is told"""
SHORT_S = 60.0
"""a shorter session is too short to judge drift and accuracy"""
CHANGE_M = 3.0
"""a smaller difference of the autopilot's altitude needs no change"""
STANDARD_HPA = 1013.25
SENSORS = {"barometer": "The barometer", "gnss": "GNSS", "imu": "The IMU"}

Finding = dict[str, str]
"""``text``: a sentence; ``level``: "good", "note", "warning" or "bad\""""


def verdict(found: dict[str, Any]) -> dict[str, Any]:
    """``wrong`` (names of sources), ``score_m`` (for sorting: the worst altitude), ``findings``
    and ``verdict`` (the sentences, alone and together) of a session's summary."""
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
    findings = [
        *_altitude(found),
        *_wrong(found, wrong),
        *_barometer(found),
        *_parting(found),
        *_suspicions(found),
        *_exclusions(found),
        *_gnss(found),
        *(_say("note", f"{note}.") for note in found["notes"][:MOST_NOTES]),
        *_advice(found),
    ]
    text = " ".join(each["text"] for each in findings)
    return {"wrong": wrong, "score_m": score_m, "findings": findings, "verdict": text}


def _say(level: str, text: str) -> Finding:
    return {"level": level, "text": text}


def _p95_without_datum(sources: dict[str, Any], name: str) -> float:
    """95 % of the differences of a source; of a raw barometer without its constant offset, which is
    the weather's."""
    source = sources.get(name)
    if source is None:
        return 0.0
    key = "unbiased_rmse_m" if name == "baro" else "p95_m"
    value = source[key]
    return float(value) if value is not None and math.isfinite(value) else 0.0


def _altitude(found: dict[str, Any]) -> Iterator[Finding]:
    altitude, health = found["altitude"], found["health"]
    if not altitude["estimates"]:
        yield _say("bad", "No altitude: there is no usable barometer or GNSS height.")
        return
    lost = health["share"].get("LOST", 0.0)
    if lost > 0.5:
        reason = f": {health['reason']}" if health["at_end"] == "LOST" else ""
        yield _say("bad", f"The altitude was lost for {lost:.0%} of the session{reason}.")
        yield from _short(found)
        return
    sd_m = altitude["median_sd_m"]
    if lost >= 0.01:
        yield _say("warning", f"The altitude was lost for {lost:.0%} of the session.")
    if math.isfinite(sd_m):
        yield _known_within(found, 2.0 * sd_m)
    yield from _short(found)


def _known_within(found: dict[str, Any], within_m: float) -> Finding:
    """What the estimator says of its altitude; what the truth says, where that is worse."""
    if found["reference"]["kind"] == "truth" and "published" in found["sources"]:
        p95_m = found["sources"]["published"]["p95_m"]
        if p95_m > LARGER * within_m:
            return _say(
                "warning",
                f"Altitude was reported to be known within {within_m:.1f} m (95 %); "
                f"the error was {p95_m:.1f} m.",
            )
    level = "good" if within_m < WRONG_M else "warning"
    return _say(level, f"Altitude is known within {within_m:.1f} m (95 %).")


def _short(found: dict[str, Any]) -> Iterator[Finding]:
    if found["duration_s"] < SHORT_S:
        yield _say(
            "note",
            f"The session is {found['duration_s']:.0f} s long: the estimate had no time to settle, "
            "and the drift of the barometer cannot be judged.",
        )


def _wrong(found: dict[str, Any], wrong: list[str]) -> Iterator[Finding]:
    what = "truth" if found["reference"]["kind"] == "truth" else "the smoothed altitude"
    for name in wrong:
        whose = "Kollsman's altitude" if name == "published" else "The autopilot's own altitude"
        source = found["sources"][name]
        yield _say(
            "bad",
            f"{whose} differed from {what} by up to {source['max_m']:.0f} m "
            f"(95 % within {source['p95_m']:.0f} m).",
        )


def _barometer(found: dict[str, Any]) -> Iterator[Finding]:
    barometer = found["barometer"]
    drift_m = barometer.get("drift_m")
    minutes = found["duration_s"] / 60.0
    if drift_m is not None and found["duration_s"] >= SHORT_S:
        range_m = barometer["range_m"]
        if range_m >= 2.0 * max(abs(drift_m), DRIFT_M):
            text = (
                f"The barometer's error moved through {range_m:.0f} m in {minutes:.0f} minutes and "
                f"ended {drift_m:+.0f} m from where it began."
            )
            yield _say("warning", text)
        elif abs(drift_m) >= DRIFT_M:
            text = f"The barometer drifted {drift_m:+.0f} m in {minutes:.0f} minutes."
            yield _say("warning", text)


def _gnss(found: dict[str, Any]) -> Iterator[Finding]:
    gnss = found["gnss"]
    if not gnss.get("fixes"):
        yield _say("warning", "There was no GNSS receiver.")
        return
    if gnss["share_3d"] == 0.0:
        yield _say("warning", "GNSS never had a 3D fix.")
    elif gnss["share_3d"] < 0.5:
        text = f"GNSS had a 3D fix for only {gnss['share_3d']:.0%} of the time."
        yield _say("warning", text)
    wander_m = gnss.get("wander_m", math.nan)
    if math.isfinite(wander_m) and wander_m >= WANDER_M:
        claimed_m = gnss["median_sd_m"]
        yield _say(
            "warning",
            f"GNSS height wandered by {wander_m:.0f} m (1 sigma); it reported {claimed_m:.0f} m.",
        )


def _parting(found: dict[str, Any]) -> Iterator[Finding]:
    """GNSS and barometer that parted, where no exclusion tells it."""
    parted = found["parting"]
    if not parted:
        return
    end_s = parted["to_s"]
    for each in found["exclusions"]:
        if each["from_s"] <= end_s and each["from_s"] + each["duration_s"] >= parted["from_s"]:
            return
    seconds = end_s - parted["from_s"]
    text = (
        f"GNSS and barometer parted by {parted['off_m']:+.0f} m in {seconds:.0f} s, "
        f"{_when(parted)}, faster than weather usually does"
    )
    who = {"gnss": "GNSS was wrong", "barometer": "the barometer was wrong"}
    yield _say("bad", f"{text}: {who.get(parted['sensor'] or '', 'one of them was wrong')}.")


def _suspicions(found: dict[str, Any]) -> Iterator[Finding]:
    for each in found["suspicions"]:
        name, other = SENSORS[each["sensor"]], {"gnss": "the barometer"}.get(each["sensor"], "GNSS")
        yield _say(
            "bad",
            f"{name} contradicted {other} beyond any weather, first {_when(each)}, and was not "
            f"used for {each['duration_s']:.0f} s.",
        )


def _exclusions(found: dict[str, Any]) -> Iterator[Finding]:
    for sensor, name in SENSORS.items():
        spans = [each for each in found["exclusions"] if each["sensor"] == sensor]
        spans = [each for each in spans if each["duration_s"] >= LONG_EXCLUSION_S]
        if len(spans) <= MOST_EXCLUSIONS:
            yield from (_say("warning", _excluded(name, span)) for span in spans)
            continue
        total_s = sum(each["duration_s"] for each in spans)
        when = _when(spans[0])
        text = f"{name} was excluded {len(spans)} times for {total_s:.0f} s in all, first {when}."
        yield _say("warning", text)


def _excluded(name: str, span: dict[str, Any]) -> str:
    when, lasted = _when(span), f"was excluded for {span['duration_s']:.0f} s"
    off_m, step_m = span["off_m"], span["step_m"]
    if not (math.isfinite(off_m) and abs(off_m) >= DRIFT_M):
        return f"{name} {lasted}, {when}."
    if math.isfinite(step_m) and abs(step_m) >= 0.5 * abs(off_m):
        return f"{name} jumped {step_m:+.0f} m {when} and {lasted}."
    return f"{name} moved away by up to {off_m:+.0f} m {when} and {lasted}."


def _when(span: dict[str, Any]) -> str:
    if span["from_utc"] is not None:
        return f"at {span['from_utc'][11:19]} UTC"
    return f"{span['from_s']:.0f} s after the start"


# What to do


def _advice(found: dict[str, Any]) -> Iterator[Finding]:
    own, altitude = found["own_altitude"], found["altitude"]
    if not own:
        if altitude["estimates"]:
            text = "No advice for the autopilot: the log holds no altitude of its own to compare."
            yield _say("note", text)
        return
    if found["health"]["at_end"] == "LOST":
        text = "The altitude was lost at the end: no advice for the autopilot."
        yield _say("note", text)
        return
    if own["span_s"] < 20.0 or found["duration_s"] < SHORT_S:
        yield _say("note", "Not enough data to say whether the autopilot needs a change.")
        return
    above_m, sd_m = own["above_m"], altitude["median_sd_m"]
    side = "above" if above_m > 0.0 else "below"
    where = f"At the end the autopilot's altitude was {abs(above_m):.1f} m {side} Kollsman's"
    if abs(above_m) <= max(CHANGE_M, 2.0 * sd_m):
        yield _say("good", f"{where}, which is within what is known: nothing to change.")
        return
    yield _say("warning", f"{where}. {_change(found['autopilot'], own['follows'], -above_m)}")


def _change(autopilot: str, follows: str | None, raise_m: float) -> str:
    """What raises the autopilot's altitude by so many metres."""
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
