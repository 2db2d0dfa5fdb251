"""Parameters of compiled steps, derived from pydantic settings."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from companion.estimators.params import EstimatorSettings, params_dtype


class Example(EstimatorSettings):
    """One field of each form."""

    switch: bool = True
    count: int = 3
    sd_m: float = Field(1.5, gt=0)
    limit_m: float | None = None
    rates_mps: tuple[Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)]] = (0.1, 0.2)
    choice: Literal["a", "b"] = "b"
    variance_m2: Annotated[float, Field(gt=0)] | Literal["reported"] = "reported"

    def derived(self) -> Mapping[str, Any]:
        return {
            "choice": ["a", "b"].index(self.choice),
            "R_m2": math.nan if self.variance_m2 == "reported" else self.variance_m2,
            "count": float(self.count),
        }


def test_names_and_formats_come_from_the_model() -> None:
    row = Example().params()
    assert row.shape == (1,)
    assert {name: str(row.dtype[name].base) for name in row.dtype.names or ()} == {
        "switch": "int64",
        "sd_m": "float64",
        "limit_m": "float64",
        "rates_mps": "float64",
        "choice": "int64",
        "R_m2": "float64",
        "count": "float64",
    }
    assert row["rates_mps"].tolist() == [[0.1, 0.2]]
    assert (row["switch"][0], row["choice"][0], row["count"][0]) == (1, 1, 3.0)
    assert np.isnan(row["limit_m"][0])
    assert np.isnan(row["R_m2"][0])


def test_values_reach_the_record() -> None:
    row = Example(variance_m2=4.0, limit_m=2.0, switch=False).params()
    assert (row["R_m2"][0], row["limit_m"][0], row["switch"][0]) == (4.0, 2.0, 0)


def test_a_field_of_no_number_is_left_out() -> None:
    assert "choice" not in (params_dtype(Example).names or ())
