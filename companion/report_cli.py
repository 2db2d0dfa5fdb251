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
    from rich.console import Console
    from rich.table import Table

    console = Console(width=100)
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
    table = Table("samples", *verdicts, box=None, pad_edge=False)
    for kind, counts in session["samples"].items():
        table.add_row(kind, *(str(counts.get(verdict, "")) for verdict in verdicts))
    console.print(table)
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
    _show_sources(session, console)
    print(session["verdict"])


def _show_sources(session: dict[str, Any], console: Any) -> None:
    from rich.table import Table

    if not session["sources"]:
        return
    reference = session["reference"]
    if reference["kind"] == "truth":
        title = "error against truth (m)"
    else:
        title = f"difference to smoother, sd {reference['sd_m']:.1f} (m)"
    keys = {"RMS": "rmse_m", "95 %": "p95_m", "max": "max_m", "mean": "bias_m"}
    table = Table(title, *keys, "RMS without mean", box=None, pad_edge=False)
    for found in session["sources"].values():
        values = [found[key] for key in (*keys.values(), "unbiased_rmse_m")]
        table.add_row(found["label"], *(f"{value:.2f}" for value in values))
    console.print(table)
