"""Paper C: the assumptions that are compared, the scenarios and the printed errors."""

import numpy as np
from numpy.typing import NDArray

from sim.studies.papers.robust_altimeter.altimeter_errors import (
    BIASED,
    NOISY,
    NORMAL,
    Model,
    Result,
)

Array = NDArray[np.float64]
TABLE_1 = Model()
TABLE_1_ROBUST = TABLE_1.having(robust=True)
FITTED = Model(sigma_a=0.6, sigma_ub=0.2)
ONE_INS = FITTED.having(shared=True)
COLUMNS = ("Table 1, optimal", "Table 1, robust", "fitted, one INS", "fitted, two INS")
MODELS = (TABLE_1, TABLE_1_ROBUST, ONE_INS, FITTED)
READING = "fitted, optimal filter, two INS"
SCENARIOS: dict[str, tuple[int, int]] = {
    "Table 2: no fault": (NORMAL, NORMAL),
    "Table 3: scenario 1, both noisy": (NOISY, NOISY),
    "Table 4: scenario 2, IBI biased": (BIASED, NORMAL),
    "Table 5: scenario 3, both biased": (BIASED, BIASED),
    "Table 6: scenario 4, IBI noisy": (NOISY, NORMAL),
    "Table 7: scenario 5, IBI noisy, IIG biased": (NOISY, BIASED),
}
MEANS = (
    (1.87, 2.17, 1.43),
    (9.37, 6.27, 4.45),
    (7.54, 1.25, 4.61),
    (7.57, 7.54, 7.28),
    (6.72, 1.27, 6.15),
    (6.59, 7.54, 5.62),
)
"""Printed mean errors of IBI, IIG, IBIG in Tables 2-7, m."""
WITHIN = 0.2
Outcome = dict[str, tuple[Result, ...]]
"""Scenario -> a result for each of `MODELS`."""
