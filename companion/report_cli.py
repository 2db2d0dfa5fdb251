"""The report of a replay, for people. Part of the command ``kollsman``."""

from typing import Any


def show(report: dict[str, Any]) -> None:
    """One log for people."""
    sessions = report["sessions"]
    more = f", {len(sessions)} sessions" if len(sessions) > 1 else ""
    print(f"{report['log']}: {report['format']}{more}, replayed in {report['elapsed_s']:.1f} s")
    if report["damage"]:
        print("damage: " + ", ".join(f"{cause} {n}" for cause, n in report["damage"].items()))
    for session in sessions:
        _show_session(session)


def _show_session(session: dict[str, Any]) -> None:
    from companion import tables

    start = session["start_utc"] or f"{session['start_boot_s']:.0f} s after boot"
    what = f"vehicle {session['vehicle'] or 'unknown'} ({session['autopilot']})"
    reboot = ", after a reboot" if session["after_reboot"] else ""
    print(
        f"\nsession {session['session']}: {what}, from {start}{reboot}, "
        f"{session['duration_s']:.0f} s, {session['estimator']}"
    )
    for note in session["notes"]:
        print(f"note: {note}")
    verdicts = ("used", "gated", "stale", "invalid", "ignored")
    counts = session["samples"]
    numbers = {each: [str(found.get(each, "")) for found in counts.values()] for each in verdicts}
    tables.show({"samples": list(counts)}, numbers)
    if session["left_out"]:
        print("left out: " + ", ".join(f"{cause} {n}" for cause, n in session["left_out"].items()))
    altitude = session["altitude"]
    if altitude["estimates"]:
        print(
            f"altitude: {altitude['first_m']:.1f} m at first, {altitude['min_m']:.1f} to "
            f"{altitude['max_m']:.1f} m, {altitude['last_m']:.1f} m at last; "
            f"{altitude['published']} ALTITUDE sent; health at the end "
            f"{session['health']['at_end']}"
        )
    _show_sources(session)
    print(session["verdict"])


def _show_sources(session: dict[str, Any]) -> None:
    from companion import tables

    if not session["sources"]:
        return
    reference = session["reference"]
    if reference["kind"] == "truth":
        title = "error against truth (m)"
    else:
        title = f"difference to smoother, sd {reference['sd_m']:.1f} (m)"
    keys = {"RMS": "rmse_m", "95 %": "p95_m", "max": "max_m", "mean": "bias_m"}
    keys["RMS without mean"] = "unbiased_rmse_m"
    found = list(session["sources"].values())
    numbers = {head: [f"{each[key]:.2f}" for each in found] for head, key in keys.items()}
    tables.show({title: [each["label"] for each in found]}, numbers)
