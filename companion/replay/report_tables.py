"""The tables and key figures of a flight report; each has its unit, and a tip that says what it
means."""

import math
from collections.abc import Mapping
from typing import Any

from companion.replay.curves import Curves

Table = dict[str, Any]
"""``title``, ``tip``, ``header`` (``name``, ``tip``, ``text``) and ``rows``"""
MOST_TEXTS = 100
MINUS = "\u2212"


def about(session: dict[str, Any]) -> str:
    """The line below the title."""
    start, own = session["start_utc"], session["start_vehicle_utc"]
    when = f"{(own or start)[:19].replace('T', ' ')} UTC" if own or start else "no date in the log"
    if own and start and own[:13] != start[:13]:
        when += f" by the vehicle ({start[:19].replace('T', ' ')} by the log)"
    vehicle = f"vehicle {session['vehicle']} ({session['autopilot']})"
    reboot = ", after a restart of the vehicle" if session["after_reboot"] else ""
    minutes, seconds = divmod(round(session["duration_s"]), 60)
    return f"{when} · {minutes} min {seconds:02d} s · {vehicle}{reboot} · {session['estimator']}"


def cards(session: dict[str, Any]) -> list[dict[str, str]]:
    """The figures that matter most."""
    altitude, barometer, gnss = session["altitude"], session["barometer"], session["gnss"]
    share = session["health"]["share"].get("OK")
    found = [
        ("Highest", _with_unit(altitude.get("max_m"), "m", 0),
         "Highest estimate above mean sea level."),
        ("Accuracy (95 %)", _with_unit(_times(altitude.get("median_sd_m"), 2.0), "m", 1, "\u00b1 "),
         "Two reported standard deviations of Kollsman's altitude, median over the session."),
        ("Protection level", _with_unit(altitude.get("median_level_m"), "m", 1, "\u00b1 "),
         "The error exceeds it only at the configured integrity risk; median over the session."),
        ("Barometer drift", _with_unit(barometer.get("drift_m"), "m", 1, sign=True),
         "Change of the barometer's error from the first to the last twentieth of the session."),
        ("QNH at the end", _with_unit(altitude.get("qnh_hpa"), "hPa", 1),
         "Altimeter setting with which an altimeter here would show the altitude."),
        ("GNSS with 3D fix", _with_unit(_times(gnss.get("share_3d"), 100.0), "%", 0),
         "Share of the receiver's messages that had a 3D fix."),
        ("Health OK", _with_unit(_times(share, 100.0), "%", 0),
         "Share of the samples at which barometer and GNSS were used and the spread was small."),
    ]  # fmt: skip
    return [{"name": name, "value": value, "tip": tip} for name, value, tip in found if value]


def tables(session: dict[str, Any], curves: Curves, damage: Mapping[str, int]) -> list[Table]:
    """The tables below the charts."""
    found = [
        _sources(session), _samples(session), _figures(session), _exclusions(session),
        _link(session, curves, damage), _texts(curves),
    ]  # fmt: skip
    return [each for each in found if each["rows"]]


def _head(name: str, tip: str = "", *, text: bool = False) -> dict[str, Any]:
    return {"name": name, "tip": tip, "text": text}


def _sources(session: dict[str, Any]) -> Table:
    reference = session["reference"]
    kind = reference["kind"]
    what = "Errors against the truth" if kind == "truth" else "Differences to the smoother"
    tip = (
        "Of each altitude, from the settling time on."
        if kind == "truth"
        else "The smoother combines barometer and GNSS after the fact; it is no truth, and where "
        "GNSS is wrong for minutes it is wrong too."
    )
    header = [
        _head("source"),
        _head("RMS (m)", "Root mean square."),
        _head("95 % (m)", "95 % of the values are smaller than this."),
        _head("max (m)", "The largest."),
        _head("mean (m)", "Positive: the source reads too high."),
        _head(
            "RMS without mean (m)",
            "Root mean square without the mean: a constant offset is left out.",
        ),
    ]
    keys = ("rmse_m", "p95_m", "max_m", "bias_m", "unbiased_rmse_m")
    rows = [
        [source["label"], *(_number(source[key], 2) for key in keys)]
        for source in session["sources"].values()
    ]
    return {"title": what, "tip": tip, "header": header, "rows": rows}


def _samples(session: dict[str, Any]) -> Table:
    header = [
        _head("samples"),
        _head("used", "Fused into the estimate."),
        _head("rejected", "Plausible alone, but inconsistent with the estimate (gate)."),
        _head("stale", "Older than the newest of its kind, or beyond the delay horizon."),
        _head("invalid", "No measurement: not finite, out of range, or without a fix."),
        _head("ignored", "A kind of sample that this estimator does not use."),
    ]
    verdicts = ("used", "gated", "stale", "invalid", "ignored")
    rows = [
        [kind, *(str(counts.get(verdict, 0)) for verdict in verdicts)]
        for kind, counts in session["samples"].items()
    ]
    return {"title": "Samples", "tip": "How many got each verdict.", "header": header, "rows": rows}


def _figures(session: dict[str, Any]) -> Table:
    altitude, barometer, gnss = session["altitude"], session["barometer"], session["gnss"]
    own = session["own_altitude"]
    rows = [
        ("altitude at the end", _with_unit(altitude.get("last_m"), "m", 1),
         "Above mean sea level."),
        ("above take-off at the end", _with_unit(altitude.get("above_takeoff_last_m"), "m", 1),
         "The estimator's height above its take-off point."),
        ("largest climb", _with_unit(altitude.get("max_climb_mps"), "m/s", 1), ""),
        ("largest sink", _with_unit(altitude.get("max_sink_mps"), "m/s", 1), ""),
        ("QNH at the end", _with_unit(altitude.get("qnh_hpa"), "hPa", 2), "And its standard "
         f"deviation: {_with_unit(altitude.get('qnh_sd_hpa'), 'hPa', 2) or 'unknown'}."),
        ("barometer offset at the end", _with_unit(altitude.get("baro_offset_m"), "m", 1),
         "Altitude minus the height of the standard atmosphere at 1013.25 hPa."),
        ("barometer drift", _with_unit(barometer.get("drift_m"), "m", 1, sign=True),
         "Change of the barometer's difference to the reference."),
        ("barometer drift rate", _with_unit(barometer.get("drift_m_per_h"), "m/h", 1, sign=True),
         "Of sessions of five minutes or more."),
        ("barometer range", _with_unit(barometer.get("range_m"), "m", 1),
         "95 % of its difference to the reference lie within this range."),
        ("GNSS reported accuracy", _with_unit(gnss.get("median_sd_m"), "m", 1),
         "Median vertical standard deviation as the receiver reports it."),
        ("GNSS wander", _with_unit(gnss.get("wander_m"), "m", 1),
         "Root mean square of its difference to the reference without its mean."),
        ("satellites", _with_unit(gnss.get("median_satellites"), "", 0), "Median."),
        ("autopilot above Kollsman at the end", _with_unit(own.get("above_m"), "m", 1, sign=True),
         "Median of the last minute."),
        ("autopilot's altitude follows", {"barometer": "the barometer", "gnss": "GNSS"}.get(
            own.get("follows") or "", ""), "The sensor to which it keeps its distance."),
    ]  # fmt: skip
    filled = [[_head(name, tip), value] for name, value, tip in rows if value]
    header = [_head("quantity"), _head("value")]
    return {"title": "Figures", "tip": "", "header": header, "rows": filled}


def _exclusions(session: dict[str, Any]) -> Table:
    header = [
        _head("excluded sensor"),
        _head(
            "since", "Onset of the fault as the estimator found it, in UTC where known.", text=True
        ),
        _head("lasted (s)", "How long the sensor was excluded."),
        _head("off by (m)", "Largest difference to Kollsman's altitude, less that before."),
        _head("at once (m)", "How much of it arose within five seconds."),
    ]
    rows = [
        [
            each["sensor"],
            (each["from_utc"] or "")[11:21] or f"{each['from_s']:.1f} s after the start",
            _number(each["duration_s"], 1),
            _number(each["off_m"], 1),
            _number(each["step_m"], 1),
        ]
        for each in session["exclusions"][:200]
    ]
    return {"title": "Exclusions", "tip": "", "header": header, "rows": rows}


def _link(session: dict[str, Any], curves: Curves, damage: Mapping[str, int]) -> Table:
    rows: list[list[Any]] = []
    link = curves.tables.get("link", {})
    if "lost_percent" in link:
        lost = float((link["frames"] * _odds(link["lost_percent"])).sum())
        share = 100.0 * lost / max(1.0, lost + float(link["frames"].sum()))
        rows.append([_head("lost frames", "Missing by sequence number."), f"{share:.1f} %"])
    rows += [
        [_head("left out"), f"{cause}: {count}"] for cause, count in session["left_out"].items()
    ]
    rows += [
        [_head("could not be read", "Junk in bytes, others in frames."), f"{cause}: {count}"]
        for cause, count in damage.items()
    ]
    rows += [[_head("note"), note] for note in session["notes"]]
    header = [_head("link"), _head("what was found", text=True)]
    return {"title": "Link", "tip": "", "header": header, "rows": rows}


def _odds(percent: Any) -> Any:
    return percent.clip(0.0, 99.9) / (100.0 - percent.clip(0.0, 99.9))


def _texts(curves: Curves) -> Table:
    rows = [[f"{max(0.0, t):.0f} s", text] for t, text in curves.texts[:MOST_TEXTS]]
    header = [_head("after the start"), _head("text", text=True)]
    more = len(curves.texts) - MOST_TEXTS
    tip = "STATUSTEXT, or the messages of an autopilot's own log."
    title = "What the vehicle said" + (f" (the first {MOST_TEXTS})" if more > 0 else "")
    return {"title": title, "tip": tip, "header": header, "rows": rows}


def _number(value: float | None, decimals: int) -> str:
    if value is None or not math.isfinite(value):
        return "\u2013"
    return f"{value:.{decimals}f}".replace("-", MINUS)


def _with_unit(
    value: float | None, unit: str, decimals: int, prefix: str = "", *, sign: bool = False
) -> str:
    """Empty for an unknown value."""
    if value is None or not math.isfinite(value):
        return ""
    text = f"{value:+.{decimals}f}" if sign else f"{value:.{decimals}f}"
    return f"{prefix}{text.replace('-', MINUS)} {unit}".rstrip()


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else factor * value
