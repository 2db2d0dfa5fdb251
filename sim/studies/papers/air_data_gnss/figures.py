"""The figures of paper W's page."""

import numpy as np

from companion.kernels.atmosphere import L0_KPM, T0_K
from companion.plots.style import BARO, BOUND, FUSED, GNSS, INERTIAL, OTHER, TRUTH
from sim.studies.papers.air_data_gnss.simulation import (
    GPS_SD_M,
    HEIGHT_M,
    TIME_S,
    WEATHER,
    Figures,
    Law,
    baro_height_m,
    pressure_ratio,
    temperature_alone_m,
)
from sim.studies.papers.page import Page

CURVES = {
    "barometer": ("barometer", BARO),
    "GPS": ("GPS", GNSS),
    "compensated": ("compensated h^c", INERTIAL),
    "paper": ("final height, paper", FUSED),
    "tuned": ("final height, tuned", OTHER),
}


def draw_temperature(page: Page) -> None:
    warmer = np.arange(-30.0, 31.0, 5.0)
    caption = (
        "Height error at 1600 m against the air's temperature: barometer alone, lambda as "
        "printed, and corrected."
    )
    with page.figure("temperature", caption) as (axes,):
        ratio = pressure_ratio(1600.0, T0_K + warmer, L0_KPM)
        axes.plot(warmer, baro_height_m(ratio) - 1600.0, color=BARO, label="barometer")
        laws: tuple[tuple[Law, str, str], ...] = (
            ("printed", OTHER, "lambda as printed"),
            ("linear", FUSED, "lambda with a minus"),
            ("exact", INERTIAL, "lambda = T_0/T_0' - 1"),
        )
        for law, colour, label in laws:
            axes.plot(
                warmer,
                [temperature_alone_m(law, kelvin) for kelvin in warmer.tolist()],
                color=colour,
                label=label,
            )
        axes.set(title="error (m)", xlabel="warmer than standard (K)")
        axes.legend()


def draw_curves(page: Page, found: dict[str, Figures]) -> None:
    caption = (
        "RMS error over the seeds (the paper's Fig. 3) under three readings of what moves "
        "the air; our trajectory."
    )
    with page.figure("rms", caption, rows=4, sharex=True, panel_in=1.9) as axes:
        axes[0].plot(TIME_S, HEIGHT_M, color=TRUTH, label="true height")
        axes[0].set(title="height (m)")
        for panel, (reading, figures) in zip(axes[1:], found.items(), strict=True):
            for name, (label, colour) in CURVES.items():
                if name != "tuned" or reading == WEATHER:
                    panel.plot(
                        TIME_S, figures.curve(name), color=colour, label=label, linewidth=0.9
                    )
            panel.axhline(GPS_SD_M, color=BOUND, linewidth=0.8, linestyle=":", label="70 m")
            highest = max(80.0, float(np.max(figures.curve("barometer"))))
            panel.set(title=f"RMS error (m): {reading}", ylim=(0, 1.1 * highest))
            if reading != WEATHER:
                panel.set(yscale="log", ylim=(10, 1.3 * highest))
        handles, names = axes[1].get_legend_handles_labels()
        first, labels = axes[0].get_legend_handles_labels()
        axes[0].figure.legend(
            first + handles, labels + names, ncols=4, loc="outside upper center", fontsize=8
        )
        axes[3].set(xlabel="time (s)")
