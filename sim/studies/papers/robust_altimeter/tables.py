"""The tables of paper C's page."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim.studies.page import spread
from sim.studies.papers.page import Row, below, both, compare, holds
from sim.studies.papers.robust_altimeter.altimeter_errors import (
    ALTIMETERS,
    T_D_S,
    Result,
    open_loop_m,
    simulate,
)
from sim.studies.papers.robust_altimeter.models import FITTED, READING, TABLE_1, WITHIN, Outcome

Array = NDArray[np.float64]
DEVIATIONS = (
    (0.0418, 0.0588, 0.0165),
    (0.4376, 0.2392, 0.2009),
    (0.2734, 0.0920, 0.1849),
    (0.3587, 0.3577, 0.3473),
    (0.3687, 0.0279, 0.3437),
    (0.2370, 0.3075, 0.1979),
)
"""Printed standard deviations, m."""


def mean_rows(results: Sequence[Result], printed: Sequence[float]) -> list[Row]:
    made = []
    for altimeter in range(3):
        values = tuple(spread(result.mean_m(altimeter)) for result in results)
        row = compare(
            ALTIMETERS[altimeter],
            printed[altimeter],
            values[-1],
            WITHIN * printed[altimeter],
            reading=READING,
            unit="m",
        )
        made.append(
            replace(
                row, ours=values, note=f"{100 * (values[-1].mean / printed[altimeter] - 1):+.0f} %"
            )
        )
    return made


def deviation_rows(outcome: Outcome) -> list[Row]:
    made = []
    for (title, results), printed in zip(outcome.items(), DEVIATIONS, strict=True):
        for altimeter in range(3):
            ours = spread(results[-1].standard_error_m(altimeter))
            value = printed[altimeter]
            made.append(
                compare(
                    f"{title.split(':')[0]}, {ALTIMETERS[altimeter]}",
                    value,
                    ours,
                    WITHIN * value,
                    reading=READING,
                )
            )
    return made


def claim_rows(outcome: Outcome, index: int) -> list[Row]:
    """The text's conclusions, from the results of one of `MODELS`."""
    mean = {
        title: tuple(spread(results[index].mean_m(a)).mean for a in range(4))
        for title, results in outcome.items()
    }
    free, both_noisy, ibi_biased, both_biased, ibi_noisy, mixed = mean.values()

    def best(claim: str, values: Sequence[float], where: str) -> Row:
        return holds(claim, below(values[2], min(values[:2])), _words(values), where=where)

    return [
        holds(
            "without a fault IIG is worst, IBIG best",
            below(free[2], free[0], free[1]),
            _words(free),
            where="Table 2",
            note=f"IBIG is best in {100 * _share_best(outcome, index):.0f} % of the seeds",
        ),
        best("both noisy: IBIG is better than each", both_noisy, "4.4"),
        holds(
            "IBI biased: IBIG lies between, worse than IIG",
            below(ibi_biased[1], ibi_biased[2], ibi_biased[0]),
            _words(ibi_biased),
            where="4.5",
        ),
        best("both biased: IBIG is better than each", both_biased, "4.6"),
        holds(
            "IBI noisy: IBIG is worse than IIG",
            below(ibi_noisy[1], ibi_noisy[2]),
            _words(ibi_noisy),
            where="4.7",
        ),
        best("IBI noisy, IIG biased: IBIG is better than each", mixed, "4.8"),
        _isolation_row(ibi_biased, ibi_noisy),
    ]


def _isolation_row(biased: Sequence[float], noisy: Sequence[float]) -> Row:
    """With one faulty sensor: mean error of the recommended altimeter (last) against IBIG's."""
    return holds(
        "one faulty: the other altimeter, as the estimator recommends it, is better than IBIG",
        both(below(biased[3], biased[2]), below(noisy[3], noisy[2])),
        f"IBI biased {biased[3]:.2f} against {biased[2]:.2f}, noisy "
        f"{noisy[3]:.2f} against {noisy[2]:.2f}",
        where="sec. 5",
        note="isolated by prob(1/i) and disagreement, not by knowing the fault",
    )


def _words(values: Sequence[float]) -> str:
    return " / ".join(f"{value:.2f}" for value in values[:3])


def _share_best(outcome: Outcome, index: int) -> float:
    """Share of the seeds in which IBIG has the smallest mean error without a fault."""
    free = next(iter(outcome.values()))[index]
    means = np.array([free.mean_m(altimeter) for altimeter in range(3)])
    return float(np.mean(means[2] < means[:2].min(axis=0)))


def property_rows(outcome: Outcome, draws: Array) -> list[Row]:
    free, _, ibi_biased, *_ = outcome.values()
    open_loop = open_loop_m(FITTED.sigma_a, draws)
    literal = simulate(TABLE_1.having(sigma_ub=1.0), draws)
    fed_back = spread(np.abs(free[-1].errors_m[:, :, 1]).max(axis=1))
    return [
        holds(
            "the variances that weigh the altimeters see a fault: largest change with a bias",
            below(0.0, float(np.abs(free[-1].variance_m2 - ibi_biased[-1].variance_m2).max())),
            float(np.abs(free[-1].variance_m2 - ibi_biased[-1].variance_m2).max()),
            unit="m²",
            where="(19), (26)",
        ),
        compare(
            "sigma_B as a spread of the bias, driven by U_B of that sigma",
            1.0,
            1.0 * T_D_S / math.sqrt(1.0 - (1.0 - 0.01 * T_D_S) ** 2),
            0.01,
            unit="m",
            where="(2), Table 1",
            note="1 m needs 0.1997",
        ),
        compare(
            "mean error of IBI without a fault, U_B of sigma 1",
            1.87,
            spread(literal.mean_m(0)),
            WITHIN * 1.87,
            unit="m",
            where="Table 2",
            note=f"with 0.1: {spread(free[0].mean_m(0))} m",
        ),
        Row(
            "INS error after 300 s, open loop, sigma 0.6 m/s² (fitted)",
            None,
            spread(np.abs(open_loop[:, -1])),
            "m",
            "(21)",
            f"fed back it stays below {fed_back} m",
        ),
    ]
