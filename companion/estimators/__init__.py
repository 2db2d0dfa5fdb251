"""The estimators: `ESTIMATORS` is the table that the command line, the tests and the benchmark
read.

Adding one is a module or package with a `Method`, and a line here; or, from outside, a package with
an entry point of the group ``kollsman.estimators`` that names its `Method` (docs/estimators.md).
"""

import logging
from importlib.metadata import entry_points

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
GROUP = "kollsman.estimators"


def _add_outside() -> None:
    """Add the estimators of other packages; one that cannot be used is told and left out."""
    logger = logging.getLogger("kollsman.estimators")
    for point in entry_points(group=GROUP):
        try:
            method = point.load()
        except Exception as error:  # whatever another package does wrong
            logger.warning("estimator %s cannot be loaded: %s", point.value, error)
            continue
        if not isinstance(method, Method):
            logger.warning("estimator %s is no Method", point.value)
        elif method.name in ESTIMATORS:
            logger.warning("estimator %s: the name %s is taken", point.value, method.name)
        else:
            ESTIMATORS[method.name] = method


DEFAULT_ESTIMATOR = vertical_bank.METHOD.name

_add_outside()

__all__ = ["DEFAULT_ESTIMATOR", "ESTIMATORS", "Filter", "Method", "run_log"]
