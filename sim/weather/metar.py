"""Weather from METAR reports of one station: pressure, temperature, humidity and wind over time.

The package ``metar`` (python-metar, BSD; pure Python, maintained since 2004) of the extra ``sim``
reads the reports.
"""

import warnings
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field, field_validator

from companion.config import Settings
from companion.errors import SimulationError
from sim.constants import ZERO_CELSIUS_K
from sim.weather.column import Column, saturation_pa
from sim.weather.fields import Wind
from sim.weather.ramp import Ramp

_DAY_S = 86_400.0


class Report(NamedTuple):
    """Values of one METAR; None for a value that it does not report."""

    time_s: float
    """time since the first report, s"""
    qnh_hpa: float | None
    temperature_k: float | None
    dew_point_k: float | None
    wind_mps: tuple[float, float] | None
    gust_mps: float | None
    """gust speed above the mean wind, m/s; 0 for a wind without reported gusts"""


Points = list[tuple[float, float]]


class Day(NamedTuple):
    """Weather over time: (time since boot in s, value) of each reported quantity."""

    sea_level_hpa: Points
    offset_k: Points
    relative_humidity: Points
    north_mps: Points
    east_mps: Points
    gust_mps: Points


class Metar(Settings):
    """METAR reports of one station in the order of their times; the first report is at boot."""

    reports: Annotated[tuple[str, ...], Field(min_length=1, max_length=1000)]
    """METAR lines; pressure, temperature, dew point, mean wind and gusts (one a minute) are used"""
    hurry: Annotated[float, Field(ge=1.0, le=1000.0)] = 1.0
    """factor by which the reported weather changes faster than in reality"""

    @field_validator("reports")
    @classmethod
    def _can_be_read(cls, reports: tuple[str, ...]) -> tuple[str, ...]:
        try:
            read = parse(reports)
        except SimulationError as error:
            raise ValueError(str(error)) from None
        if all(report.qnh_hpa is None for report in read):
            raise ValueError(
                "no report has a pressure: give at least one report with Q1013 or A2992"
            )
        return reports

    def day(self, elevation_m: float, column: Column) -> Day:
        """The day above a station at that height, with `column`'s own layers in it.

        A QNH is the station's pressure reduced to sea level through the standard column; the real
        column's pressure at sea level is found by going down through the air of the report. The dew
        point's humidity is that of all heights.
        """
        column.solve(0.0, 0.0)
        usual_k, standard_pa = (
            column.at(elevation_m, 1.0).temperature_k,
            Column().at(elevation_m, 1.0).pressure_pa,
        )
        day = Day([], [], [], [], [], [])
        reports = [(report.time_s / self.hurry, report) for report in parse(self.reports)]
        for time_s, report in reports:
            if report.temperature_k is not None:
                day.offset_k.append((time_s, report.temperature_k - usual_k))
                if report.dew_point_k is not None:
                    moist = _relative_humidity(report.temperature_k, report.dew_point_k)
                    day.relative_humidity.append((time_s, moist))
            if report.wind_mps is not None:
                day.north_mps.append((time_s, report.wind_mps[0]))
                day.east_mps.append((time_s, report.wind_mps[1]))
            if report.gust_mps is not None:
                day.gust_mps.append((time_s, report.gust_mps))
        offset_k, humidity = Ramp(day.offset_k, 0.0), Ramp(day.relative_humidity, 0.0)
        for time_s, report in reports:
            # The column is that of the flight, whose temperature may come from another report.
            if report.qnh_hpa is not None:
                column.solve(offset_k(time_s), humidity(time_s))
                station_hpa = report.qnh_hpa * standard_pa
                day.sea_level_hpa.append(
                    (time_s, station_hpa / column.at(elevation_m, 1.0).pressure_pa)
                )
        return day


def _relative_humidity(temperature_k: float, dew_point_k: float) -> float:
    """Vapour pressure divided by saturation vapour pressure, at most 1."""
    there_pa, could_pa = map(float, saturation_pa(np.array([dew_point_k, temperature_k])))
    return min(1.0, there_pa / could_pa)


def _read(line: str) -> Any:
    """One report, with a time. Raises SimulationError for what is no METAR."""
    try:
        from metar.Metar import Metar as Parser
        from metar.Metar import ParserError
    except ImportError as error:
        raise SimulationError(
            "METARs need the package metar: pip install 'kollsman[sim]'"
        ) from error
    try:
        # The parser warns of groups that it does not know; the groups that count are read here.
        with warnings.catch_warnings(action="ignore"):
            # The month is not in a METAR; a fixed one keeps the clock of the host out.
            report = Parser(line, month=1, year=2026, strict=False)
    except (ParserError, ValueError) as error:
        raise SimulationError(f"'{line}' is no METAR: {' '.join(str(error).split())}") from None
    if report.time is None:
        raise SimulationError(f"'{line}' is no METAR: give it a time such as 121020Z")
    return report


def parse(lines: tuple[str, ...]) -> list[Report]:
    """The reports, timed from the first. Raises SimulationError for what is no METAR, or out of
    order."""
    found: list[Report] = []
    first_s = day_s = 0.0
    last_day = 0
    for line in lines:
        report = _read(line)
        day = report.time.day
        if found:  # 31 is followed by 1, whatever the month
            day_s += _DAY_S * (day - last_day if day >= last_day else 1)
        last_day = day
        time_s = day_s + report.time.hour * 3600.0 + report.time.minute * 60.0
        first_s = first_s if found else time_s
        time_s -= first_s
        if found and time_s <= found[-1].time_s:
            raise SimulationError(
                f"'{line}' is not later than the report before it: sort the reports by time"
            )
        speed_mps, gust_mps = (
            None if s is None else float(s.value("MPS"))
            for s in (report.wind_speed, report.wind_gust)
        )
        found.append(
            Report(
                time_s,
                None if report.press is None else report.press.value("HPA"),
                None if report.temp is None else report.temp.value("C") + ZERO_CELSIUS_K,
                None if report.dewpt is None else report.dewpt.value("C") + ZERO_CELSIUS_K,
                _wind(
                    speed_mps, None if report.wind_dir is None else float(report.wind_dir.value())
                ),
                None if speed_mps is None else max(0.0, min(gust_mps or 0.0, 60.0) - speed_mps),
            )
        )
    return found


def _wind(speed_mps: float | None, from_deg: float | None) -> tuple[float, float] | None:
    """Wind towards north and east, m/s. None if it was not measured, or is variable and above 3
    m/s; a weaker variable wind is calm."""
    if speed_mps is None:
        return None
    if from_deg is None:
        return (0.0, 0.0) if speed_mps < 3.0 else None
    return Wind(speed_mps=min(speed_mps, 60.0), from_deg=from_deg % 360.0).vector_mps
