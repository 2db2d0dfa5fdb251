"""Rules about the ground barometer (section ``air``, ``reference...``)."""

import math

from companion.doctor.case import Case, Finding, Grade
from companion.mavlink.codec import mavlink
from companion.reference import WINDOW_US

PRESSURE = mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE
OLD_S = 5.0
"""a station that sends once a second is late"""


def reference(case: Case) -> Finding | None:
    """Whether the configured ground barometer is heard, how old its pressure is, and its QNH."""
    station = case.service.pipeline.air.reference
    if station is None:
        return None
    pipeline = case.service.pipeline
    age_s = station.age_s(pipeline.now_us)
    if not math.isfinite(age_s):
        return _unheard(case)
    if station.problem:
        return Finding(
            Grade.WRONG,
            f"the ground barometer is not used: {station.problem}",
            "check air.reference_elevation_m, and that the station stands still; it is used again "
            "when its QNH agrees with that of the flight",
        )
    if age_s > OLD_S:
        return Finding(
            Grade.WRONG,
            f"the newest pressure of the ground barometer is {age_s:.0f} s old",
            "send SCALED_PRESSURE once a second or more; check the station's power and its link",
        )
    if math.isnan(station.qnh_pa):
        wait_s = WINDOW_US * 1e-6
        return Finding(
            Grade.NOTE,
            f"ground barometer heard {age_s:.1f} s ago, no QNH yet",
            f"listen longer than {wait_s:.0f} s (--seconds): a QNH is the median of so long",
        )
    return Finding(
        Grade.GOOD,
        f"ground barometer {age_s:.1f} s old, QNH {station.qnh_pa * 0.01:.1f} hPa at "
        f"{station.elevation_m:.0f} m",
    )


def _unheard(case: Case) -> Finding:
    """No pressure of the station came: why, as far as what is heard tells."""
    air = case.service.settings.air
    if case.service.pipeline.now_us < 0:
        return Finding(
            Grade.NOTE,
            "no pressure of the ground barometer is taken before the vehicle's clock is known",
            "first make the vehicle heard",
        )
    senders = sorted(
        {speaker[0] for speaker in case.hearing.senders if case.hearing.last(speaker, PRESSURE)}
        - {case.vehicle[0] if case.vehicle else 0}
    )
    heard = f"; SCALED_PRESSURE comes from system {', '.join(map(str, senders))}" if senders else ""
    where = f"on {air.reference}" if air.reference else "on the vehicle's links"
    who = f"of system {air.reference_system_id} " if air.reference_system_id is not None else ""
    return Finding(
        Grade.WRONG,
        f"no SCALED_PRESSURE {who}{where}: the ground barometer is not heard{heard}",
        "check its system id (air.reference_system_id), the address (air.reference) and that the "
        "station sends SCALED_PRESSURE (ArduPilot: SRn_RAW_SENS)",
    )
