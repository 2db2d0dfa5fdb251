"""A real day from its METARs: pressure, temperature and wind over time, as the reports of one station tell them.

Read with the package ``metar`` (python-metar, BSD; pure Python, kept since 2004), part of the extra ``sim``.
"""

import warnings
from typing import Annotated, NamedTuple

from pydantic import Field, field_validator

from companion.config import Settings
from companion.errors import SimulationError
from sim.weather.column import Column
from sim.weather.fields import Wind

_DAY_S = 86_400.0


class Report(NamedTuple):
    """What one METAR says; None where it is silent."""

    time_s: float
    """since the first"""
    qnh_hpa: float | None
    temperature_k: float | None
    wind_mps: tuple[float, float] | None


class Metar(Settings):
    """Reports of one station, in the order of their times; the first is the boot."""

    reports: Annotated[tuple[str, ...], Field(min_length=1, max_length=1000)]
    """METAR lines; pressure, temperature and mean wind count, gusts and dew point do not"""
    hurry: Annotated[float, Field(ge=1.0, le=1000.0)] = 1.0
    """how many times as fast as in reality the day goes by"""

    @field_validator("reports")
    @classmethod
    def _can_be_read(cls, reports: tuple[str, ...]) -> tuple[str, ...]:
        try:
            read = parse(reports)
        except SimulationError as error:
            raise ValueError(str(error)) from None
        if all(report.qnh_hpa is None for report in read):
            raise ValueError("no report tells the pressure (Q1013 or A2992)")
        return reports

    def ramps(self, elevation_m: float) -> tuple[list[tuple[float, float]], ...]:
        """Over time: sea-level pressure (hPa), offset (K), wind north and east (m/s), for a station at that height.

        A QNH is the station's pressure reduced to sea level through the standard column; the real column's pressure at
        sea level is found by going down through the air of the report.
        """
        column = Column()
        standard = column.at(elevation_m, 1.0)
        offsets: list[tuple[float, float]] = []
        pressures: list[tuple[float, float]] = []
        winds: tuple[list[tuple[float, float]], list[tuple[float, float]]] = ([], [])
        offset_k = 0.0
        for report in parse(self.reports):
            time_s = report.time_s / self.hurry
            if report.temperature_k is not None:
                offset_k = report.temperature_k - standard.temperature_k
                offsets.append((time_s, offset_k))
            if report.qnh_hpa is not None:
                column.solve(offset_k)
                station_hpa = report.qnh_hpa * standard.pressure_pa
                pressures.append((time_s, station_hpa / column.at(elevation_m, 1.0).pressure_pa))
            if report.wind_mps is not None:
                for ramp, value in zip(winds, report.wind_mps, strict=True):
                    ramp.append((time_s, value))
        return pressures, offsets, *winds


def parse(lines: tuple[str, ...]) -> list[Report]:
    """The reports, timed from the first. Raises SimulationError for what is no METAR, or out of order."""
    try:
        from metar.Metar import Metar as Parser  # noqa: PLC0415  a tenth of a second that other scenarios need not pay
        from metar.Metar import ParserError  # noqa: PLC0415
    except ImportError as error:
        raise SimulationError("METARs need the package metar: pip install 'kollsman[sim]'") from error
    found: list[Report] = []
    first_s = day_s = 0.0
    last_day = 0
    for line in lines:
        try:
            with warnings.catch_warnings(
                action="ignore"
            ):  # groups it does not know; those that count are looked at here
                # The month is not in a METAR; a fixed one keeps the clock of the host out.
                report = Parser(line, month=1, year=2026, strict=False)
        except (ParserError, ValueError) as error:
            raise SimulationError(f"'{line}' is no METAR: {' '.join(str(error).split())}") from None
        if report.time is None:
            raise SimulationError(f"'{line}' is no METAR: it has no time such as 121020Z")
        day = report.time.day
        if found:  # 31 is followed by 1, whatever the month
            day_s += _DAY_S * (day - last_day if day >= last_day else 1)
        last_day = day
        time_s = day_s + report.time.hour * 3600.0 + report.time.minute * 60.0
        first_s = first_s if found else time_s
        time_s -= first_s
        if found and time_s <= found[-1].time_s:
            raise SimulationError(f"'{line}' is not later than the report before it")
        found.append(
            Report(
                time_s,
                None if report.press is None else report.press.value("HPA"),
                None if report.temp is None else report.temp.value("C") + 273.15,
                _wind(
                    None if report.wind_speed is None else float(report.wind_speed.value("MPS")),
                    None if report.wind_dir is None else float(report.wind_dir.value()),
                ),
            )
        )
    return found


def _wind(speed_mps: float | None, from_deg: float | None) -> tuple[float, float] | None:
    """None when it was not measured, or is variable and strong; variable and weak is calm."""
    if speed_mps is None:
        return None
    if from_deg is None:
        return (0.0, 0.0) if speed_mps < 3.0 else None
    return Wind(speed_mps=min(speed_mps, 60.0), from_deg=from_deg % 360.0).vector_mps
