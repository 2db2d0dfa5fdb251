"""The estimators: `ESTIMATORS` is the table that the command line, the tests and the benchmark
read.

Adding one is a module or package with a `Method`, and a line here.
"""

from companion.estimators import (
    adaptive_fusion,
    air_data_gnss,
    baro_gnss_ins,
    robust_altimeter,
    vertical_bank,
)
from companion.estimators.baro_inertial import BARO_INS_KF, DAMPING_LOOP
from companion.estimators.method import Filter, Method, run_log

ESTIMATORS: dict[str, Method] = {
    method.name: method
    for method in (
        adaptive_fusion.METHOD,
        air_data_gnss.METHOD,
        robust_altimeter.METHOD,
        baro_gnss_ins.METHOD,
        DAMPING_LOOP,
        BARO_INS_KF,
        vertical_bank.METHOD,
    )
}

DEFAULT_ESTIMATOR = vertical_bank.METHOD.name

__all__ = ["DEFAULT_ESTIMATOR", "ESTIMATORS", "Filter", "Method", "run_log"]
