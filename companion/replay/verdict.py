"""A session in words: how well the altitude is known, what was wrong, and what to do.

One sentence a finding. The words follow from the figures of `companion.replay.summary` alone, so
that every page says the same. Where the altitude is LOST none is sent, and none is wrong. An
altitude is called wrong beyond `WRONG_M` plus three standard deviations of the reference.
"""

import math
from collections.abc import Iterator
from typing import Any

from companion.replay.advice import advice

WRONG_M = 10.0
DRIFT_M = 5.0
"""a drift of the barometer that is worth a sentence"""
WANDER_M = 5.0
LONG_EXCLUSION_S = 5.0
MOST_EXCLUSIONS = 4
"""exclusions of one sensor with a sentence each; more are told together"""
MOST_NOTES = 3
LARGER = 1.2
"""an error that is so many times as large as reported is told"""
SHORT_S = 60.0
"""a shorter session is too short to judge drift and accuracy"""
LATE_S, LATE_SHARE = 30.0, 0.2
"""an altitude that begins later than this, or this share of a session, is told"""
LOST_S = 1.0
"""a loss of the altitude that is shorter is not told"""
ORIGIN_S = 10.0
"""time in which the autopilot had no origin that is told"""
UNREADABLE = 0.01
"""share of a file that could not be read that is told"""
UNSENT = ("estimate", "smoothed")
"""sources that nobody received"""
LEVELS = ("good", "note", "warning", "bad")
SENSORS = {"barometer": "The barometer", "gnss": "GNSS", "imu": "The IMU"}

Finding = dict[str, str]
"""``text``: a sentence; ``level``: one of `LEVELS`"""


def verdict(found: dict[str, Any]) -> dict[str, Any]:
    """``wrong`` (names of sources), ``score_m`` (for sorting: the worst altitude), ``findings``,
    ``reason`` (the first of the gravest, without mere advice, and the cause of a wrong altitude)
    and ``verdict`` (all together) of a session's summary."""
    reference = found["reference"]
    sd_m = reference["sd_m"] if math.isfinite(reference["sd_m"]) else 0.0
    limit_m = WRONG_M + 3.0 * sd_m
    sources = found["sources"]
    wrong = [
        name for name in ("published", "autopilot") if _p95_without_datum(sources, name) > limit_m
    ]
    score_m = max(
        (_p95_without_datum(sources, name) for name in sources if name not in UNSENT), default=0.0
    )
    causes = [
        *_barometer(found),
        *_parting(found),
        *_suspicions(found),
        *_exclusions(found),
        *_gnss(found),
    ]
    doubt = found["parting"]["sensor"] or "unknown" if _has_parted(found) else ""
    told = [
        *_altitude(found),
        *_wrong(found, wrong),
        *_at_rest(found),
        *_origin(found),
        *causes,
        *_notes(found),
    ]
    advised = [_say(level, text) for level, text in advice(found, doubt)]
    findings = told + advised
    reasons = told + [each for each in advised if each["level"] not in ("good", "note")]
    return {
        "wrong": wrong,
        "score_m": score_m,
        "findings": findings,
        "reason": " ".join([_gravest(reasons), *([_gravest(causes)] if wrong and causes else [])]),
        "verdict": " ".join(each["text"] for each in findings),
    }


def _gravest(findings: list[Finding]) -> str:
    return max(findings, key=lambda each: LEVELS.index(each["level"]))["text"]


def badness(found: dict[str, Any]) -> tuple[bool, int, float]:
    """For sorting: wrong altitudes are worst, then by the gravest finding, each by size."""
    gravest = max(LEVELS.index(each["level"]) for each in found["findings"])
    return bool(found["wrong"]), gravest, float(found["score_m"] or 0.0)


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


# The altitude


def _altitude(found: dict[str, Any]) -> Iterator[Finding]:
    altitude, health = found["altitude"], found["health"]
    if not altitude["estimates"] or health["first_s"] is None:
        yield _say("bad", _no_altitude(found))
        yield from _short(found)
        return
    if math.isfinite(altitude["median_sd_m"]):
        yield _known_within(found, 2.0 * altitude["median_sd_m"])
    if health["first_s"] > min(LATE_S, LATE_SHARE * found["duration_s"]):
        yield _say("note", _late(found))
    yield from _lost(found)
    yield from _short(found)


def _no_altitude(found: dict[str, Any]) -> str:
    if not found["altitude"]["estimates"]:
        return "No altitude: there is no usable barometer or GNSS height."
    if not found["gnss"].get("fixes"):
        why = "there was no GNSS receiver"
    elif found["gnss"]["share_3d"] == 0.0:
        why = "GNSS never had a 3D fix"
    else:
        why = _useless_receiver(found) or found["health"]["reason"]
    return f"No altitude in all of the session: {why}."


def _useless_receiver(found: dict[str, Any]) -> str | None:
    """What is wrong with the heights of a receiver of which none was used."""
    if found["samples"].get("gnss", {}).get("used"):
        return None
    return next((note for note in found["notes"] if note.startswith("GNSS receiver")), None)


def _late(found: dict[str, Any]) -> str:
    first_s, fix_s = found["health"]["first_s"], found["gnss"].get("first_3d_s", math.nan)
    why = f", as GNSS had no 3D fix for {fix_s:.0f} s" if fix_s >= 0.5 * first_s else ""
    return f"The altitude begins {first_s:.0f} s after the start of the session{why}."


def _lost(found: dict[str, Any]) -> Iterator[Finding]:
    spans = [each for each in found["health"]["lost"] if each["duration_s"] >= LOST_S]
    if not spans:
        return
    total_s, when = sum(each["duration_s"] for each in spans), _when(spans[0])
    why = " because no sensor data came" if all(each["silent"] for each in spans) else ""
    if len(spans) == 1:
        text = f"The altitude was lost for {total_s:.0f} s{why}, {when}."
    else:
        text = f"The altitude was lost {len(spans)} times for {total_s:.0f} s in all{why}, first "
        text += f"{when}."
    yield _say("bad" if total_s > 0.5 * found["duration_s"] else "warning", text)


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
    if within_m < WRONG_M:
        return _say("good", f"Altitude is known within {within_m:.1f} m (95 %).")
    sd_m = found["gnss"].get("median_sd_m", math.nan)
    why = f", as the accuracy of GNSS is {2.0 * sd_m:.0f} m (95 %)" if sd_m >= 0.5 * WRONG_M else ""
    return _say("warning", f"Altitude is known within {within_m:.1f} m (95 %) only{why}.")


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


def _at_rest(found: dict[str, Any]) -> Iterator[Finding]:
    """What moved though the vehicle did not."""
    moved = found["at_rest"] or {}
    for name, whose in (("published", "Kollsman's"), ("autopilot", "The autopilot's own")):
        range_m = moved.get(name)
        if range_m is not None and range_m >= DRIFT_M:
            text = f"{whose} altitude moved through {range_m:.0f} m while the vehicle stood still."
            yield _say("bad" if range_m > 2.0 * WRONG_M else "warning", text)


def _origin(found: dict[str, Any]) -> Iterator[Finding]:
    without_s = found["own_altitude"].get("without_origin_s", 0.0)
    if without_s >= ORIGIN_S:
        never = not found["own_altitude"]["span_s"]
        when = "In all of the session" if never else f"For the first {without_s:.0f} s"
        yield _say(
            "warning",
            f"{when} the autopilot sent its height above the start as its altitude above sea "
            f"level: it had no origin{'' if never else ' yet'}. Wait for its GNSS origin before "
            "take-off.",
        )


# Sensors


def _barometer(found: dict[str, Any]) -> Iterator[Finding]:
    if not found["samples"].get("pressure") and found["health"]["first_s"] is not None:
        yield _say("warning", "There was no barometer.")
    barometer = found["barometer"]
    drift_m, range_m = barometer["drift_m"], barometer["range_m"]
    suspect_s = sum(e["duration_s"] for e in found["suspicions"] if e["sensor"] == "barometer")
    if drift_m is None or found["duration_s"] < SHORT_S or suspect_s > 0.5 * found["duration_s"]:
        return
    minutes = found["duration_s"] / 60.0
    by_gnss = barometer["compared_with"] == "gnss"
    whose = "The barometer's difference to GNSS" if by_gnss else "The barometer's error"
    if range_m >= 2.0 * max(abs(drift_m), DRIFT_M):
        text = (
            f"{whose} moved through {range_m:.0f} m in {minutes:.0f} minutes and "
            f"ended {drift_m:+.0f} m from where it began."
        )
        yield _say("warning", text)
    elif abs(drift_m) >= DRIFT_M:
        against = " against GNSS" if by_gnss else ""
        still = " while the vehicle stood still" if found["at_rest"] else ""
        text = f"The barometer drifted {drift_m:+.0f} m{against} in {minutes:.0f} minutes{still}."
        yield _say("warning", text)


def _gnss(found: dict[str, Any]) -> Iterator[Finding]:
    gnss, has_altitude = found["gnss"], found["health"]["first_s"] is not None
    if not gnss.get("fixes"):
        if has_altitude:
            yield _say("warning", "There was no GNSS receiver.")
        return
    if gnss["share_3d"] == 0.0 and has_altitude:
        yield _say("warning", "GNSS never had a 3D fix.")
    elif 0.0 < gnss["share_3d"] < 0.5:
        text = f"GNSS had a 3D fix for only {gnss['share_3d']:.0%} of the time."
        yield _say("warning", text)
    wander_m = gnss["wander_m"]
    if math.isfinite(wander_m) and wander_m >= WANDER_M:
        claimed_m = gnss["median_sd_m"]
        still = " while the vehicle stood still" if found["at_rest"] else ""
        yield _say(
            "warning",
            f"GNSS height wandered by {wander_m:.0f} m (1 sigma){still}; it reported "
            f"{claimed_m:.0f} m.",
        )


def _has_parted(found: dict[str, Any]) -> bool:
    """Whether GNSS and barometer parted, and no exclusion tells it."""
    parted = found["parting"]
    return bool(parted) and not any(
        each["from_s"] <= parted["to_s"] and each["from_s"] + each["duration_s"] >= parted["from_s"]
        for each in found["exclusions"]
    )


def _parting(found: dict[str, Any]) -> Iterator[Finding]:
    if not _has_parted(found):
        return
    parted = found["parting"]
    seconds = parted["to_s"] - parted["from_s"]
    text = (
        f"GNSS and barometer parted by {parted['off_m']:+.0f} m in {seconds:.0f} s, "
        f"{_when(parted)}, faster than weather usually does"
    )
    still = ", as the vehicle stood still" if found["at_rest"] else ""
    who = {"gnss": f"GNSS was wrong{still}", "barometer": f"the barometer was wrong{still}"}
    yield _say("bad", f"{text}: {who.get(parted['sensor'] or '', 'one of them was wrong')}.")


def _suspicions(found: dict[str, Any]) -> Iterator[Finding]:
    for each in found["suspicions"]:
        name, other = SENSORS[each["sensor"]], {"gnss": "the barometer"}.get(each["sensor"], "GNSS")
        sign = -1.0 if each["sensor"] == "gnss" else 1.0
        off_m = sign * each["off_m"]
        size = f" by {off_m:+.0f} m," if abs(off_m) >= WANDER_M else ""
        yield _say(
            "bad",
            f"{name} contradicted {other}{size} beyond any weather, first {_when(each)}, and was "
            f"not used for {each['duration_s']:.0f} s.",
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


def _notes(found: dict[str, Any]) -> Iterator[Finding]:
    if found["unreadable"] >= UNREADABLE:
        yield _say("note", f"{found['unreadable']:.0%} of the file is zeros or junk.")
    told = _useless_receiver(found) if found["health"]["first_s"] is None else None
    notes = [note for note in found["notes"] if note != told]
    for note in notes[:MOST_NOTES]:
        yield _say("note", f"{note[:1].upper()}{note[1:]}.")
    if len(notes) > MOST_NOTES:
        yield _say("note", f"Further notes in the tables: {len(notes) - MOST_NOTES}.")


def _when(span: dict[str, Any]) -> str:
    if span["from_utc"] is not None:
        return f"at {span['from_utc'][11:19]} UTC"
    return f"{span['from_s']:.0f} s after the start"
