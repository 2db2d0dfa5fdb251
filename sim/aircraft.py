"""A JSBSim aircraft in SI units. Only this file uses JSBSim's property names, feet, pounds and
degrees Rankine.

Height is JSBSim's geodetic height, which the simulator takes as height above mean sea level (the
geoid enters with the GNSS receiver's undulation). Pressure and temperature come from JSBSim's own
atmosphere, never from the companion's, so that an estimator is not tested against its own model of
the air.
"""

import math
from collections.abc import Callable
from math import isfinite
from typing import Any

from companion.errors import SimulationError
from sim import STEP_HZ
from sim.aircraft_state import Controls, Flow, Motion, Truth, Vector, new_motion, new_truth
from sim.airframes import MODELS, Model, load
from sim.constants import G0_MPS2

_FT = 0.3048
_LB = 0.45359237
_PSF = _LB * G0_MPS2 / _FT**2
_KT = 1852.0 / 3600.0
_RANKINE_PER_K = 1.8
_SLUGS_PER_FT3 = _LB * G0_MPS2 / _FT / _FT**3
"""kg/m3 in one"""

_NOTHING = (0.0,) * 6
_BURIED = 0.25
"""Share of the rest height below which the centre of gravity is in the ground: a hard landing does
not compress the wheels this far."""
_CRASH_MPS = 4.0
"""Sink rate that no landing gear survives; JSBSim's would bounce and fly on."""
_TIPPED, _TIPPED_M = math.cos(math.radians(24.0)), 0.5
"""Tilt (24 degrees) and height above the rest height (m) at which a wing tip, the nose or the tail
touches the ground; rotation and touchdown need 11 degrees."""
_ALOFT_ALPHA_DEG = 3.0
"""Initial angle of attack aloft. It is close to every aircraft's angle at cruise; the autopilot
trims the rest within seconds."""


class Aircraft:
    """One aircraft with its engines running, on a runway or `aloft`, stepped at `STEP_HZ`.

    Raises `SimulationError` when the model is unknown, a state is not finite, the centre of gravity
    is below the ground, or the aircraft crashes.
    """

    def __init__(
        self,
        model: str = "c172p",
        *,
        latitude_deg: float = 47.0,
        longitude_deg: float = 8.0,
        field_elevation_m: float = 0.0,
        heading_deg: float = 0.0,
        aloft: tuple[float, float] | None = None,
        seed: int = 0,
    ) -> None:
        """`aloft` is the altitude AMSL (m) and the calibrated airspeed (m/s) at which a flight
        begins above the runway; None begins on the runway."""
        if model not in MODELS:
            raise SimulationError(f"no aircraft '{model}': there are {', '.join(sorted(MODELS))}")
        self._ground_m = field_elevation_m
        self._column: Callable[[float], tuple[float, float, float]] | None = None
        self._rest_height_m = MODELS[model].rest_height_m
        self.stall_rad = MODELS[model].stall_rad
        """angle of attack of the greatest lift, rad"""
        self._aloft = aloft
        self._wind_mps: Vector = (0.0, 0.0, 0.0)
        self._blown_mps: Vector = (math.nan, math.nan, math.nan)
        """the wind that JSBSim was given last"""
        self.time_us = 0
        self._step_us = 1_000_000 // STEP_HZ
        self._fdm = load(MODELS[model].jsbsim_name)
        self._start(MODELS[model], latitude_deg, longitude_deg, heading_deg, seed)
        self._bind(MODELS[model].engines)
        self._sums = _NOTHING
        """sums of Nx, Ny, Nz and the inertial rates p, q, r over the last ``_summed`` steps"""
        self._summed = 0

    def _start(
        self, model: Model, latitude_deg: float, longitude_deg: float, heading_deg: float, seed: int
    ) -> None:
        fdm = self._fdm
        fdm.set_dt(1.0 / STEP_HZ)
        fdm["simulation/randomseed"] = seed % 2**31
        fdm["ic/lat-geod-deg"] = latitude_deg
        fdm["ic/long-gc-deg"] = longitude_deg
        fdm["ic/terrain-elevation-ft"] = self._ground_m / _FT
        fdm["ic/h-agl-ft"] = model.rest_height_m / _FT
        fdm["ic/psi-true-deg"] = heading_deg
        if self._aloft is not None:
            fdm["ic/h-sl-ft"] = self._aloft[0] / _FT
            fdm["ic/vc-kts"] = self._aloft[1] / _KT
            fdm["ic/alpha-deg"] = _ALOFT_ALPHA_DEG
        if not fdm.run_ic():
            raise SimulationError(f"JSBSim refused the initial condition of {model.jsbsim_name}")
        if model.engines:
            fdm["propulsion/set-running"] = -1

    def _bind(self, engines: int) -> None:
        """Look every property up once: a cached node costs 0.05 us a read, a name 0.13 us."""
        reader = self._reader
        self._run: Callable[[], bool] = self._fdm.run
        self._load_factors = tuple(reader(f"accelerations/N{axis}") for axis in "xyz")
        self._inertial_rates = tuple(reader(f"velocities/{axis}i-rad_sec") for axis in "pqr")
        self._position = tuple(
            reader(f"position/{n}") for n in ("lat-geod-deg", "long-gc-deg", "geod-alt-ft")
        )
        self._velocity = tuple(reader(f"velocities/v-{n}-fps") for n in ("north", "east", "down"))
        self._attitude = tuple(reader(f"attitude/{n}-rad") for n in ("phi", "theta", "psi"))
        # The height that JSBSim's atmosphere uses: 3 cm from geodetic at 5 km.
        self._column_height = reader("position/h-sl-ft")
        self._air = tuple(reader(f"atmosphere/{n}") for n in ("P-psf", "T-R"))
        self._flow = tuple(
            reader(n) for n in ("aero/qbar-psf", "aero/beta-rad", "position/geod-alt-ft")
        )
        self.angle_of_attack_rad = reader("aero/alpha-rad")
        self._fuel_lb = reader("propulsion/total-fuel-lbs") if engines else lambda: math.inf
        self._weight_on_wheels = reader("gear/wow")
        rates = (reader(f"velocities/{axis}-rad_sec") for axis in "pqr")
        self._state = (
            *self._position,
            *self._velocity,
            *self._attitude,
            *rates,
            reader("velocities/vc-kts"),
            self._weight_on_wheels,
        )
        """what `truth` reads, in its order"""
        self._bind_controls(engines)

    def _reader(self, name: str) -> Callable[[], float]:
        node: Any = self._fdm.get_property_manager().get_node(name)
        return node.get_double_value  # type: ignore[no-any-return]

    def _writer(self, name: str) -> Callable[[float], None]:
        node: Any = self._fdm.get_property_manager().get_node(name)
        return node.set_double_value  # type: ignore[no-any-return]

    def _bind_controls(self, engines: int) -> None:
        writer = self._writer
        self._stick = tuple(writer(f"fcs/{n}-cmd-norm") for n in ("elevator", "aileron", "rudder"))
        self._throttles = tuple(
            writer(f"fcs/throttle-cmd-norm[{number}]") for number in range(engines)
        )
        self._throttle = 0.0
        rarely = ("left-brake", "speedbrake", "right-brake", "steer", "flap", "gear", "spoiler")
        self._rarely = tuple(
            writer(f"{'gear' if n == 'gear' else 'fcs'}/{n}-cmd-norm") for n in rarely
        )
        self._rare: tuple[float, ...] = ()
        """values last written there"""
        for number in range(engines):
            self._fdm[f"fcs/mixture-cmd-norm[{number}]"] = 1.0
        self._set_air = tuple(writer(f"atmosphere/{n}") for n in ("P-sl-psf", "delta-T"))
        self._set_wind = tuple(
            writer(f"atmosphere/wind-{n}-fps") for n in ("north", "east", "down")
        )

    def control(self, controls: Controls) -> None:
        """Set the controls; those that change rarely only on a change: a write costs 0.1 us."""
        elevator, aileron, rudder, throttle, brake, steering, flaps, gear, lift_dump = controls
        write_elevator, write_aileron, write_rudder = self._stick
        write_elevator(-elevator)  # JSBSim's elevator is positive trailing edge down
        write_aileron(aileron)
        write_rudder(-rudder)  # and its rudder positive trailing edge left
        speedbrake = 0.0
        if throttle < 0.0:
            throttle, speedbrake = 0.0, -throttle
        for write in self._throttles:
            self._throttle = throttle
            write(throttle)
        rare = (brake, speedbrake, brake, steering, flaps, gear, lift_dump)
        if rare != self._rare:
            self._rare = rare
            for write, value in zip(self._rarely, rare, strict=True):
                write(value)

    # Weather. It acts on the next step.

    def set_air(self, sea_level_pressure_pa: float, temperature_offset_k: float) -> None:
        """Sea-level pressure, and the deviation of the whole column from the standard
        temperature."""
        self._set_air[0](sea_level_pressure_pa / _PSF)
        self._set_air[1](temperature_offset_k * _RANKINE_PER_K)

    def set_column(self, column: Callable[[float], tuple[float, float, float]]) -> None:
        """Replace JSBSim's atmosphere by `column`: altitude AMSL (m) -> Pa, K, kg/m3.

        JSBSim cannot return to its own atmosphere.
        """
        if self._column is None:
            for name in ("pressure", "temperature", "density"):
                self._fdm[f"atmosphere/override/{name}"] = 0.0
            self._override = tuple(
                self._writer(f"atmosphere/override/{name}")
                for name in ("pressure", "temperature", "density")
            )
        self._column = column
        self._write_column()

    def _write_column(self) -> None:
        """Give JSBSim the column's air at the aircraft's height; needed before every step."""
        if self._column is None:
            return
        pressure_pa, temperature_k, density_kgpm3 = self._column(self._column_height() * _FT)
        self._override[0](pressure_pa / _PSF)
        self._override[1](temperature_k * _RANKINE_PER_K)
        self._override[2](density_kgpm3 / _SLUGS_PER_FT3)

    def set_wind(self, north_mps: float, east_mps: float, down_mps: float = 0.0) -> None:
        """Set the velocity of the air: the direction towards which the wind blows."""
        self._wind_mps = (north_mps, east_mps, down_mps)
        self._blow()

    def _blow(self) -> None:
        """Give JSBSim the wind, limited while the aircraft is on its wheels.

        The models describe air from ahead. Air from the side or from behind gives an aircraft on
        the ground a meaningless angle of attack: a parked trainer would be blown over by a side
        wind of 5 m/s. On the wheels the tail wind is therefore limited to half the ground speed,
        and the side wind to the airspeed from ahead.
        """
        wind_mps = self._wind_mps
        if any(wind_mps) and self._weight_on_wheels() > 0.5:
            wind_mps = self._sheltered(*wind_mps)
        if wind_mps != self._blown_mps:
            self._blown_mps = wind_mps
            for write, value in zip(self._set_wind, wind_mps, strict=True):
                write(value / _FT)

    def _sheltered(self, north_mps: float, east_mps: float, down_mps: float) -> Vector:
        heading = self._attitude[2]()
        ahead, beside = math.cos(heading), math.sin(heading)
        speed_mps = max(0.0, (self._velocity[0]() * ahead + self._velocity[1]() * beside) * _FT)
        along_mps = min(north_mps * ahead + east_mps * beside, 0.5 * speed_mps)
        airspeed_mps = speed_mps - along_mps
        across_mps = max(-airspeed_mps, min(airspeed_mps, east_mps * ahead - north_mps * beside))
        return (
            along_mps * ahead - across_mps * beside,
            along_mps * beside + across_mps * ahead,
            down_mps,
        )

    def set_turbulence(self, severity: int, wind_at_6m_mps: float) -> None:
        """Dryden turbulence of MIL-F-8785C: severity 0 (none) to 7, 4 is moderate; low down the
        wind counts instead."""
        self._fdm["atmosphere/turb-type"] = 3 if severity else 0
        self._fdm["atmosphere/turbulence/milspec/severity"] = severity
        self._fdm["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = wind_at_6m_mps / _FT

    # Time

    def settle(self, duration_s: float = 10.0) -> None:
        """Run the dynamics with brakes on until wheels and idling engine are at rest, then set the
        time to zero. A flight that begins aloft needs no settling."""
        if self._aloft is not None:
            return
        self.control(Controls(brake=1.0))
        self.advance(round(duration_s * STEP_HZ))
        self.mean_motion()
        self.time_us = 0

    def advance(self, steps: int, times: int = 1) -> None:
        """Step the dynamics, summing for `mean_motion`; the wind is limited before each of
        `times`."""
        run = self._run
        sum_nx, sum_ny, sum_nz, sum_p, sum_q, sum_r = self._sums
        nx, ny, nz = self._load_factors
        p, q, r = self._inertial_rates
        layered = self._column is not None
        for _ in range(times):
            self._blow()
            for _ in range(steps):
                if layered:
                    self._write_column()
                run()
                sum_nx += nx()
                sum_ny += ny()
                sum_nz += nz()
                sum_p += p()
                sum_q += q()
                sum_r += r()
        self._sums = (sum_nx, sum_ny, sum_nz, sum_p, sum_q, sum_r)
        self._summed += steps * times
        self.time_us += steps * times * self._step_us

    def mean_motion(self) -> Motion:
        """Mean specific force and rates over the steps since the last call."""
        count = self._summed
        if count == 0:
            raise SimulationError("mean_motion needs a step of the dynamics since its last call")
        nx, ny, nz, p, q, r = self._sums
        scale = G0_MPS2 / count
        # JSBSim's Nz is positive upwards, one at rest; the body's z axis points down.
        self._sums, self._summed = _NOTHING, 0
        return new_motion(
            ((nx * scale, ny * scale, -nz * scale), (p / count, q / count, r / count))
        )

    @property
    def powered(self) -> bool:
        return bool(self._throttles)

    def fuel_kg(self) -> float:
        """Fuel in all tanks, kg; infinite for an aircraft without an engine."""
        return self._fuel_lb() * _LB

    def freeze_fuel(self) -> None:
        """Stop the fuel burn: the engines run on and the weight stays constant."""
        self._fdm["propulsion/fuel_freeze"] = 1.0

    @property
    def rest_height_m(self) -> float:
        """Height of the centre of gravity above the ground, on the wheels, m."""
        return self._rest_height_m

    @property
    def ground_m(self) -> float:
        """Height of the field above mean sea level, m."""
        return self._ground_m

    def position(self) -> tuple[float, float, float]:
        """Latitude, longitude (degrees) and altitude above mean sea level (m)."""
        latitude_deg, longitude_deg, altitude_ft = self._position
        return latitude_deg(), longitude_deg(), altitude_ft() * _FT

    def air(self) -> tuple[float, float]:
        """Static pressure (Pa) and air temperature (K) at the aircraft."""
        if self._column is not None:  # JSBSim holds the values before its last step
            return self._column(self._column_height() * _FT)[:2]
        return self._air[0]() * _PSF, self._air[1]() / _RANKINE_PER_K

    def flow(self) -> Flow:
        """Air flow at the aircraft."""
        dynamic_psf, sideslip_rad, altitude_ft = self._flow
        height_m = altitude_ft() * _FT - self._ground_m
        load = self._load_factors[2]()
        return Flow(dynamic_psf() * _PSF, sideslip_rad(), height_m, load, self._throttle)

    def truth(self) -> Truth:
        """The present state. Raises `SimulationError` if it is not plausible."""
        lat, lon, alt, north, east, down, roll, pitch, yaw, p, q, r, airspeed, wow = self._state
        pressure_pa, temperature_k = self.air()
        altitude_m = alt() * _FT
        truth = new_truth(
            (
                self.time_us,
                lat(),
                lon(),
                altitude_m,
                north() * _FT,
                east() * _FT,
                down() * _FT,
                roll(),
                pitch(),
                yaw(),
                p(),
                q(),
                r(),
                pressure_pa,
                temperature_k,
                airspeed() * _KT,
                wow() > 0.5,
            )
        )
        is_flying = altitude_m - self._ground_m > self._rest_height_m + 1.0
        if not (is_flying and isfinite(sum(truth))):
            self._check(truth)
        return truth

    def _check(self, truth: Truth) -> None:
        """Raise `SimulationError` for a state that is not finite, or a crash."""
        if not isfinite(sum(truth)):
            bad = ", ".join(name for name, value in truth._asdict().items() if not isfinite(value))
            raise SimulationError(
                f"at {truth.time_us / 1e6:.2f} s the flight dynamics diverged: {bad} not finite"
            )
        height_m = truth.altitude_amsl_m - self._ground_m
        if height_m > self._rest_height_m + 1.0:
            return
        if height_m < _BURIED * self._rest_height_m:
            fate = "is below the ground"
        elif truth.down_mps > _CRASH_MPS:
            fate = "hit the ground"
        elif (
            height_m < self._rest_height_m + _TIPPED_M
            and math.cos(truth.roll_rad) * math.cos(truth.pitch_rad) < _TIPPED
        ):
            fate = "hit the ground with more than its wheels"
        else:
            return
        raise SimulationError(
            f"at {truth.time_us / 1e6:.2f} s the aircraft {fate}: {height_m:.1f} m above a field "
            f"at {self._ground_m:.1f} m, sinking at {truth.down_mps:.1f} m/s, bank "
            f"{math.degrees(truth.roll_rad):.0f}, pitch {math.degrees(truth.pitch_rad):.0f} degrees"
        )
