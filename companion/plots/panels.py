"""The panels of a flight, for report, PNG and live page: which columns, how drawn, what they mean.

A column is named by its table and name, as `companion.replay.curves.Curves` has them. A panel is
shown where at least one of its lines is known.
"""

from dataclasses import dataclass, replace

from companion.plots.style import BARO, BOUND, FUSED, GNSS, INERTIAL, OTHER, SOURCES, LineStyle


@dataclass(frozen=True)
class Line:
    """One column as a line."""

    table: str
    column: str
    style: LineStyle
    markers: bool = False
    """drawn as points, not as a line"""


@dataclass(frozen=True)
class Band:
    """Shaded: `middle` plus and minus `times` the column `half`; without a middle around zero."""

    table: str
    half: str
    middle: str = ""
    times: float = 1.0
    label: str = ""
    colour: str = FUSED


@dataclass(frozen=True)
class Panel:
    """One panel over time."""

    name: str
    title: str
    unit: str
    help: str
    """what it shows and how to read it, in one or two sentences"""
    lines: tuple[Line, ...]
    bands: tuple[Band, ...] = ()
    edges: tuple[Band, ...] = ()
    """lines at both ends of such a band"""
    at_least: float = 0.55
    """half of the smallest range of the vertical axis"""
    lowest: float | None = None
    """the axis begins here"""
    highest: float | None = None
    """the axis ends here"""
    robust: bool = False
    """lines that are much larger than the others may leave the axis, which then says so"""
    digits: int = 1
    shades: bool = False
    """flight modes and exclusions are shaded"""
    tall: bool = False


def _plain(label: str, colour: str, *dash: float, width: float = 1.3) -> LineStyle:
    return LineStyle(label, colour, width, dash)


def _sources(column: str, reference: str) -> tuple[Line, ...]:
    lines = [Line(name, column, SOURCES[name]) for name in ("gnss", "baro", "autopilot")]
    if column == "difference_m":
        label = "raw barometer without its median"
        lines[1] = Line("baro", "wander_m", replace(SOURCES["baro"], label=label))
    if column == "altitude_m" and reference in SOURCES:
        lines.append(Line("reference", column, SOURCES[reference]))
    return (*lines, Line("estimate", column, SOURCES["estimate"]))


def panels(reference: str) -> tuple[Panel, ...]:
    """The panels of a session whose heights are held against `reference`: "truth", "smoother" or
    "none"."""
    return (*_heights(reference), *AIR, *FAULTS, *RECEIVER, *LINK)


def _heights(reference: str) -> tuple[Panel, ...]:
    what = {"truth": "the truth", "smoother": "the smoother"}.get(reference, "the reference")
    error = "Errors against" if reference == "truth" else "Differences to"
    level = _plain("protection level", BOUND, 4, 2, width=1.0)
    sd = Band("estimate", "sd_m", "altitude_m", 2.0, "Kollsman ± 2 sd")
    return (
        Panel(
            "altitude", "Altitude above mean sea level", "m",
            "Altitude of each source. The band is Kollsman's altitude plus and minus two of its "
            "standard deviations; the grey lines are its protection level, which the error should "
            "exceed only at the configured integrity risk. The raw barometer is read by the "
            "standard atmosphere at 1013.25 hPa, so the weather shifts it.",
            _sources("altitude_m", reference), (sd,),
            (Band("estimate", "level_m", "altitude_m", 1.0, level.label, level.colour),),
            at_least=5.0, robust=True, tall=True,
        ),
        Panel(
            "difference", f"{error} {what}", "m",
            f"Each source minus {what}. Above zero the source reads too high. Backgrounds are "
            "flight modes; red is the time in which Kollsman excluded a sensor. The barometer is "
            "drawn without its median, which is the weather's."
            + (
                " The smoother combines barometer and GNSS after the fact; where GNSS is wrong "
                "for minutes it is wrong too."
                if reference == "smoother" else ""
            ),
            _sources("difference_m", reference), (replace(sd, middle="", label="± 2 sd"),),
            (Band("estimate", "level_m", "", 1.0, level.label, level.colour),),
            at_least=3.0, robust=True, shades=True, tall=True, digits=2,
        ),
    )  # fmt: skip


AIR = (
    Panel(
        "climb", "Climb", "m/s", "Vertical speed, positive upwards.",
        (Line("autopilot", "climb_mps", SOURCES["autopilot"]),
         Line("estimate", "climb_mps", SOURCES["estimate"])),
        at_least=1.0,
    ),
    Panel(
        "qnh", "QNH", "hPa",
        "Altimeter setting with which an altimeter at this place would show the altitude; the "
        "band is two standard deviations. 1 hPa is about 8 m.",
        (Line("estimate", "qnh_hpa", _plain("QNH", FUSED, width=1.8)),),
        (Band("estimate", "qnh_sd_hpa", "qnh_hpa", 2.0, "± 2 sd"),),
        at_least=0.5, robust=True, digits=2,
    ),
    Panel(
        "offsets", "Offsets that the estimator found", "m",
        "Barometer: altitude minus the height of the standard atmosphere, so a falling line is "
        "a barometer that reads ever higher. GNSS: slow error of the GNSS height.",
        (Line("estimate", "baro_offset_m", _plain("barometer offset", BARO, 6, 1.5, 1.5, 1.5)),
         Line("estimate", "gnss_offset_m", _plain("GNSS offset", GNSS))),
        at_least=2.0,
    ),
    Panel(
        "drift", "Drift of the barometer", "m/h",
        "How fast the barometer's error changes at constant height. Fair weather stays below "
        "10 m/h; a front makes 30 m/h.",
        (Line("estimate", "drift_m_per_h", _plain("drift rate", BARO)),), at_least=2.0,
    ),
    Panel(
        "scale", "Scale error of the barometer", "%",
        "Change of the barometer's error with height: 1 % is 1 m for each 100 m of climb. Air "
        "that is 3 K warmer than the standard atmosphere makes about 1 %.",
        (Line("estimate", "scale_percent", _plain("scale error", BARO)),), at_least=0.5,
        digits=2,
    ),
    Panel(
        "weather", "Probabilities of the drift", "",
        "How likely calm, fair and stormy weather are as the cause of the barometer's drift.",
        (Line("estimate", "calm", _plain("calm", FUSED)),
         Line("estimate", "fair", _plain("fair", OTHER, 5, 2)),
         Line("estimate", "stormy", _plain("stormy", INERTIAL, 1.5, 1.5))),
        digits=2, lowest=0.0, highest=1.0,
    ),
)  # fmt: skip
FAULTS = (
    Panel(
        "faults", "Probabilities of a fault", "",
        "How likely it is that each sensor is wrong.",
        (Line("estimate", "baro_fault", _plain("barometer", BARO, 6, 1.5, 1.5, 1.5)),
         Line("estimate", "gnss_fault", _plain("GNSS", GNSS)),
         Line("estimate", "imu_fault", _plain("IMU", INERTIAL, 5, 2))),
        digits=2, lowest=0.0, highest=1.0,
    ),
    Panel(
        "innovation", "Innovations of the GNSS height", "m",
        "GNSS height minus the altitude expected of it. The band is three standard deviations "
        "of both together. A point is a fix that the gate rejected.",
        (Line("gnss", "innovation_m", _plain("innovation", GNSS, width=1.0)),
         Line("gnss", "refused_m", _plain("rejected", BARO), markers=True)),
        (Band("gnss", "bound_m", "", 1.0, "± 3 sd", BOUND),),
        at_least=2.0, robust=True, digits=2,
    ),
)  # fmt: skip
RECEIVER = (
    Panel(
        "accuracy", "Reported accuracy of GNSS", "m",
        "Standard deviation of the GNSS height as the receiver reports it, or as its dilution "
        "of precision suggests.",
        (Line("gnss", "sd_m", _plain("vertical accuracy", GNSS)),), at_least=1.0, lowest=0.0,
        robust=True,
    ),
    Panel(
        "fix", "GNSS fix and satellites", "",
        "Number of satellites used; fix type: 0 and 1 none, 2 is 2D, 3 is 3D, 4 DGPS, 5 and 6 "
        "RTK.",
        (Line("gnss", "satellites", _plain("satellites", GNSS)),
         Line("gnss", "fix", _plain("fix type", INERTIAL, 5, 2))),
        digits=0, lowest=0.0,
    ),
)  # fmt: skip
LINK = (
    Panel(
        "rates", "Sampled rates", "Hz",
        "Samples of the first sensor of each kind that arrived in each second.",
        (Line("rates", "imu", _plain("IMU", INERTIAL, 5, 2)),
         Line("rates", "attitude", _plain("attitude", OTHER)),
         Line("rates", "baro", _plain("barometer", BARO, 6, 1.5, 1.5, 1.5)),
         Line("rates", "gnss", _plain("GNSS", GNSS))),
        digits=0, lowest=0.0,
    ),
    Panel(
        "link", "Lost frames", "%",
        "Frames of the vehicle that are missing by sequence number, in each second.",
        (Line("link", "lost_percent", _plain("lost frames", BARO)),), at_least=2.0, lowest=0.0,
    ),
    Panel(
        "radio", "Signal of the telemetry radio", "",
        "Signal and noise at both radios as RADIO_STATUS reports them, in units of the radio. For "
        "SiK radios 1.9 units are 1 dB. A signal less than 20 units above the noise loses frames.",
        (Line("radio", "noise", _plain("noise", GNSS, 1.5, 1.5)),
         Line("radio", "remote_noise", _plain("noise at the other radio", INERTIAL, 1.5, 1.5)),
         Line("radio", "remote_rssi", _plain("signal at the other radio", OTHER, 6, 2)),
         Line("radio", "rssi", _plain("signal", BARO))),
        digits=0, lowest=0.0,
    ),
)  # fmt: skip
