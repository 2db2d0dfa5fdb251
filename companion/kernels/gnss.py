"""What a GNSS height can be, and how accurate its receiver reports it to be."""

from companion.jit import step
from companion.samples import Rows

LOWEST_GNSS_M, HIGHEST_GNSS_M = -1000.0, 50_000.0


@step
def gnss_sd_m(sample: Rows, floor_m: float, unknown_m: float) -> float:
    """Vertical spread of a GNSS height, not below `floor_m`.

    As the receiver reports, else 2.5 m a unit of VDOP, else 5 m a unit of HDOP (vertical is about
    twice as bad), else `unknown_m`.
    """
    sd_m = unknown_m
    if sample[0].vertical_sd_m > 0.0:
        sd_m = sample[0].vertical_sd_m
    elif sample[0].vdop > 0.0:
        sd_m = 2.5 * sample[0].vdop
    elif sample[0].hdop > 0.0:
        sd_m = 5.0 * sample[0].hdop
    return max(floor_m, sd_m)
