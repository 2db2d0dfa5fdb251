"""What is missing on a live link and what to check, in one line."""

from companion.links import Link
from companion.mavlink.codec import FrameReject, mavlink
from companion.pipeline import Pipeline
from companion.samples import Kind, Verdict

_NEEDED = (
    (Kind.PRESSURE, "barometer (SCALED_PRESSURE)"),
    (Kind.GNSS, "GNSS (GPS_RAW_INT)"),
)


def signing_problem(pipeline: Pipeline) -> tuple[str, str] | None:
    """What is wrong with signatures, and what to do; None when nothing is."""
    counters, identity = pipeline.decoder.counters, pipeline.identity
    if pipeline.signing is None:
        if identity.signed_us is None:
            return None
        return (
            "the vehicle signs its messages, and may refuse ours, which are unsigned",
            "set signing.key_file to a file with the vehicle's key (docs/install.md)",
        )
    if counters[FrameReject.SIGNATURE]:
        return (
            f"{counters[FrameReject.SIGNATURE]} messages refused: signed with another key",
            "give the vehicle and signing.key_file the same passphrase",
        )
    if identity.vehicle is not None:
        return None
    if counters[FrameReject.REPEATED]:
        return (
            f"{counters[FrameReject.REPEATED]} messages refused: signed with an old time stamp",
            "two programs may share ids and key (signing.link_id), or a recording is repeated",
        )
    if counters[FrameReject.UNSIGNED]:
        return (
            f"{counters[FrameReject.UNSIGNED]} messages refused: unsigned",
            "give the vehicle the key with a ground station (docs/install.md), or remove "
            "signing.key_file",
        )
    return None


def notice(pipeline: Pipeline, link: Link) -> str:
    """What is missing so far; empty when nothing is."""
    received = link.statistics.received_bytes
    if received == 0:
        check = "check cable, port, baud rate, and that the autopilot sends here"
        return f"nothing received on {link.url} in 5 s: {check}"
    if pipeline.decoder.frames == 0:
        junk = pipeline.decoder.counters[FrameReject.JUNK]
        check = "check the baud rate, and that the port is set to MAVLink 2"
        return f"{received} bytes on {link.url} but no MAVLink ({junk} junk): {check}"
    signatures = signing_problem(pipeline)
    if signatures is not None:
        return ": ".join(signatures)
    if pipeline.identity.vehicle is None:
        known = pipeline.identity.refusal or "; ".join(pipeline.identity.notes)
        if known:
            return known
        check = "check what is connected, or vehicle.system_id"
        return f"MAVLink on {link.url} but no heartbeat of an autopilot: {check}"
    for kind, name in _NEEDED:
        if kind not in pipeline.filter.method.uses or pipeline.verdicts[kind][Verdict.USED]:
            continue
        heard = sum(pipeline.verdicts[kind])
        if heard:
            return (
                f"{heard} messages of the {name} but none usable: "
                "wait for a 3D fix, or check the sensor"
            )
        names = ", ".join(
            sorted(mavlink.mavlink_map[message_id].msgname for message_id in pipeline.heard)[:8]
        )
        return (
            f"no {name} in 5 s, only {names}: check the stream rates of this port (README, recipes)"
        )
    return ""
