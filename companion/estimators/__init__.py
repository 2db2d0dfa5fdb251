"""The estimators: `ESTIMATORS` is the table that the command line, the tests and the benchmark read.

Adding one is a module with a `Method` at its end, and a line here.
"""

from companion.estimators import (
    adaptive_fusion,
    air_data_gnss,
    baro_gnss_ins,
    baro_ins_kf,
    damping_loop,
    robust_altimeter,
    vertical_bank,
)
from companion.estimators.method import Filter, Method, run_log

ESTIMATORS: dict[str, Method] = {
    method.name: method
    for method in (
        adaptive_fusion.METHOD,
        air_data_gnss.METHOD,
        robust_altimeter.METHOD,
        baro_gnss_ins.METHOD,
        damping_loop.METHOD,
        baro_ins_kf.METHOD,
        vertical_bank.METHOD,
    )
}

__all__ = ["ESTIMATORS", "Filter", "Method", "run_log"]
