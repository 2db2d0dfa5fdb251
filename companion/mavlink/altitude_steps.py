"""The compiled rules of ALTITUDE (`companion.mavlink.outputs`): what they remember, when a message
is due, and the heights in it."""

import math

import numpy as np

from companion.jit import step
from companion.kernels.atmosphere import qnh_pa
from companion.mavlink.continuity import join, monotonic_at, withholds
from companion.samples import Kind, Rows, Verdict

FRESH_US = 1_000_000
VEHICLE_ALTITUDE_US = 5_000_000
OWN_HEIGHT_US = 2_000_000
OURS_MISSING_US = 1_000_000
VEHICLE_ALTITUDES = 3
"""number of ALTITUDE of the vehicle within five seconds that shows that it sends them itself"""
NEVER_US = -(1 << 62)
NEVER, ALWAYS, AUTO = 0, 1, 2
"""values of ``publish.altitude``"""
OF_NONE, OF_OURS, OF_VEHICLE = 0, 1, 2
"""source of the height in ALTITUDE"""
OUR_SLOT, OWN_SLOT, DEBUG_SLOT = 0, 1, 2
LOST = 2
USED, STALE = int(Verdict.USED), int(Verdict.STALE)
PRESSURE, HOME, STATUS = int(Kind.PRESSURE), int(Kind.HOME), int(Kind.STATUS)
RANGE, ATTITUDE = int(Kind.RANGE), int(Kind.ATTITUDE)

OUTPUTS = np.dtype(
    [
        ("source", "i8"),
        ("due_us", "i8", (3,)),  # the next slot of our heights, the vehicle's own, and DEBUG
        ("boots", "i8"),
        ("local_origin_m", "f8"),
        ("home_m", "f8"),
        ("arming_m", "f8"),
        ("armed", "i8"),  # -1 unknown: a vehicle may be met in the air
        ("range_us", "i8"),
        ("range_m", "f8"),
        ("tilt_us", "i8"),
        ("cos_tilt", "f8"),
        ("vehicle_us", "i8", (VEHICLE_ALTITUDES,)),  # the newest ALTITUDE of the vehicle
        ("vehicle_count", "i8"),
        ("own_us", "i8"),  # GLOBAL_POSITION_INT
        ("own_amsl_m", "f8"),
        ("own_home_m", "f8"),
        ("ours_us", "i8"),
        ("pressure_pa", "f8"),
    ],
    align=True,
)
OUTPUT_PARAMS = np.dtype([("mode", "i8"), ("period_us", "i8", (3,))], align=True)
ALTITUDE = np.dtype(
    [
        ("time_us", "i8"),
        ("monotonic_m", "f8"),
        ("amsl_m", "f8"),
        ("local_m", "f8"),
        ("relative_m", "f8"),
        ("clearance_m", "f8"),
    ],
    align=True,
)
"""The heights of a message, in the order of its fields."""


@step
def restart(o: Rows) -> None:
    """The vehicle booted."""
    s = o[0]
    s.boots += 1
    s.local_origin_m = s.home_m = s.arming_m = s.pressure_pa = math.nan
    s.armed, s.vehicle_count = -1, 0
    s.range_us = s.tilt_us = s.own_us = s.ours_us = NEVER_US


@step
def takes(o: Rows, p: Rows, slot: int, now_us: int) -> bool:
    """`companion.mavlink.schedule.Schedule.takes` of one of the slots."""
    due_us, period_us = o[0].due_us[slot], p[0].period_us[slot]
    early_us = period_us // 10
    if due_us == NEVER_US:
        o[0].due_us[slot] = now_us + period_us
        return True
    if due_us - 2 * period_us <= now_us < due_us - early_us:
        return False
    is_on_grid = -early_us <= now_us - due_us < period_us
    o[0].due_us[slot] = (due_us if is_on_grid else now_us) + period_us
    return True


@step
def vehicle_altitude(o: Rows, now_us: int) -> None:
    """The vehicle sent ALTITUDE itself; one alone may be forged."""
    s, kept = o[0], 0
    for i in range(s.vehicle_count):
        heard_us = s.vehicle_us[i]
        if abs(now_us - heard_us) < VEHICLE_ALTITUDE_US:
            s.vehicle_us[kept] = heard_us
            kept += 1
    if kept == VEHICLE_ALTITUDES:
        for i in range(1, VEHICLE_ALTITUDES):
            s.vehicle_us[i - 1] = s.vehicle_us[i]
        kept -= 1
    s.vehicle_us[kept] = now_us
    s.vehicle_count = kept + 1


@step
def may_send(o: Rows, p: Rows, now_us: int) -> bool:
    """Whether ALTITUDE may be sent: not while the vehicle sends it itself."""
    if p[0].mode != AUTO:
        return p[0].mode == ALWAYS
    enough = VEHICLE_ALTITUDES if o[0].ours_us != NEVER_US else 1
    count = o[0].vehicle_count
    return count < enough or abs(now_us - o[0].vehicle_us[count - 1]) >= VEHICLE_ALTITUDE_US


@step
def own_height(o: Rows, p: Rows, monotonic: Rows, now_us: int, health: int, out: Rows) -> bool:
    """Whether ALTITUDE with the vehicle's own heights, which are in the record, is due; `out`, an
    `ALTITUDE` row, gets them then."""
    ours_us, own_us = o[0].ours_us, o[0].own_us
    is_ours = ours_us != NEVER_US and abs(now_us - ours_us) < OURS_MISSING_US
    if (health != LOST and is_ours) or not may_send(o, p, now_us):
        return False
    if not takes(o, p, OWN_SLOT, own_us):
        return False
    of_vehicle(o, monotonic, now_us, out)
    return True


@step
def of_vehicle(o: Rows, monotonic: Rows, now_us: int, out: Rows) -> None:
    """ALTITUDE carries the vehicle's own heights: `out` gets them."""
    o[0].source = OF_VEHICLE
    if math.isnan(o[0].local_origin_m):
        o[0].local_origin_m = o[0].own_amsl_m
    out[0].time_us, out[0].amsl_m = o[0].own_us, o[0].own_amsl_m
    out[0].monotonic_m = monotonic_at(monotonic, now_us)
    out[0].local_m = o[0].own_amsl_m - o[0].local_origin_m
    out[0].relative_m = o[0].own_home_m
    out[0].clearance_m = clearance_m(o, now_us)


@step
def follow_pressure(o: Rows, monotonic: Rows, row: Rows, verdict: int) -> None:
    """Follow a pressure and its verdict."""
    if verdict != USED:
        return
    if join(monotonic, o[0].boots, row[0].instance, row[0].time_us, row[0].pressure_pa):
        o[0].pressure_pa = row[0].pressure_pa


@step
def follow_home(o: Rows, row: Rows) -> None:
    """Follow HOME_POSITION."""
    if -1000.0 < row[0].altitude_amsl_m < 10_000.0:
        o[0].home_m = row[0].altitude_amsl_m


@step
def follow_status(o: Rows, row: Rows, estimate: Rows) -> None:
    """Follow arming: its altitude is the take-off's."""
    if row[0].armed == 1 and o[0].armed == 0:
        is_fresh = abs(row[0].time_us - estimate[0].time_us) <= 2 * FRESH_US
        o[0].arming_m = estimate[0].altitude_amsl_m if is_fresh else math.nan
    if row[0].armed >= 0:
        o[0].armed = 1 if row[0].armed == 1 else 0


@step
def follow_range(o: Rows, row: Rows) -> None:
    """Follow a downward range finder."""
    if row[0].downward == 1:
        o[0].range_us, o[0].range_m = row[0].time_us, row[0].distance_m


@step
def follow_attitude(o: Rows, row: Rows) -> None:
    """Follow the tilt."""
    cos_tilt = math.cos(row[0].roll_rad) * math.cos(row[0].pitch_rad)
    o[0].tilt_us = row[0].time_us
    o[0].cos_tilt = cos_tilt if cos_tilt > 0.0 else math.nan


@step
def altitude(
    o: Rows, p: Rows, monotonic: Rows, leap: Rows, now_us: int, health: int, estimate: Rows,
    out: Rows,
) -> bool:  # fmt: skip
    """Whether our ALTITUDE is due and may be sent; `out`, an `ALTITUDE` row, gets its heights."""
    altitude_m, time_us = estimate[0].altitude_amsl_m, estimate[0].time_us
    if health == LOST or not math.isfinite(altitude_m) or withholds(leap, time_us, altitude_m):
        return False
    if math.isnan(o[0].local_origin_m):
        o[0].local_origin_m = altitude_m
    if time_us < 0 or not may_send(o, p, now_us) or not takes(o, p, OUR_SLOT, time_us):
        return False
    o[0].source, o[0].ours_us = OF_OURS, now_us
    out[0].time_us, out[0].amsl_m = time_us, altitude_m
    out[0].monotonic_m = monotonic_at(monotonic, now_us)
    out[0].local_m = altitude_m - o[0].local_origin_m
    out[0].relative_m = _relative_m(o, estimate, now_us)
    out[0].clearance_m = clearance_m(o, now_us)
    return True


@step
def _relative_m(o: Rows, estimate: Rows, now_us: int) -> float:
    """Height above take-off, from the best source that is known."""
    height_m = estimate[0].height_above_takeoff_m
    if math.isfinite(height_m):
        return height_m
    if o[0].own_us != NEVER_US and abs(now_us - o[0].own_us) <= OWN_HEIGHT_US:
        return o[0].own_home_m
    reference_m = o[0].arming_m if math.isnan(o[0].home_m) else o[0].home_m
    return estimate[0].altitude_amsl_m - reference_m


@step
def clearance_m(o: Rows, now_us: int) -> float:
    """Height above the ground below, by the range finder; NaN where there is none."""
    s = o[0]
    if s.range_us == NEVER_US or abs(now_us - s.range_us) > FRESH_US:
        return math.nan
    tilted = s.tilt_us != NEVER_US and abs(now_us - s.tilt_us) <= FRESH_US
    return s.range_m * (s.cos_tilt if tilted else 1.0)


@step
def qnh_hpa(o: Rows, monotonic: Rows, estimate: Rows, now_us: int) -> float:
    """Altimeter setting that makes the barometer show the altitude; NaN where either is unknown."""
    altitude_m = estimate[0].altitude_amsl_m
    if not (math.isfinite(monotonic_at(monotonic, now_us)) and math.isfinite(altitude_m)):
        return math.nan
    return qnh_pa(o[0].pressure_pa, altitude_m) * 0.01
