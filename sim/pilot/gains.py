"""Speeds and loop gains of the aircraft that the autopilot flies, one `Gains` an aircraft."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Gains:
    """Speeds and loop gains of one aircraft. Angles in rad, surfaces -1..1, throttle 0..1,
    airspeeds calibrated, m/s."""

    rotate_mps: float
    climb_mps: float
    """airspeed of the climb"""
    cruise_mps: float
    minimum_mps: float
    """airspeed below which the autopilot pitches down to regain speed"""
    climb_out_pitch_rad: float
    climb_out_mps: float | None = None
    """airspeed at which the climb-out changes from fixed pitch to airspeed; None is `climb_mps`"""
    take_off_flaps: float = 0.0
    clean_mps: float = 42.0
    """airspeed at which an approach is joined, and above which the flaps are in"""
    approach_mps: float = 34.0
    """airspeed over the threshold, with landing flaps"""
    landing_flaps: float = 1.0
    flare_s: float = 4.0
    """time constant with which the height above the runway decays in the flare"""
    flare_gain: float = 3.0
    """factor of the path's gains in the flare, which lasts seconds"""
    touchdown_mps: float = 0.4
    """sink rate at the end of the flare"""
    speedbrake: float = 0.0
    """range of the throttle below idle, which extends the speed brakes"""
    pitch_limits_rad: tuple[float, float] = (-0.21, 0.28)
    bank_limit_rad: float = 0.35
    roll_in_radps: float = math.inf
    """rate limit of the commanded bank"""
    full_surface_mps: float = math.inf
    """airspeed above which the surface deflections decrease with the dynamic pressure"""
    pitch_p: float = 3.0
    pitch_i: float = 1.5
    pitch_rate: float = 0.9
    bank_p: float = 0.9
    bank_i: float = 0.1
    roll_rate: float = 0.25
    heading_p: float = 1.0
    yaw_rate: float = 0.4
    ground_heading_p: float = 2.0
    ground_yaw_rate: float = 1.5
    nose_wheel: float = 0.0
    """nose-wheel steering as a share of the rudder"""
    take_off_nose_wheel: float = 0.0
    """the same share in the take-off run; 0 steers with the rudder alone"""
    airspeed_pitch_p: float = 0.015
    airspeed_pitch_i: float = 0.002
    path_p: float = 0.9
    path_i: float = 0.35
    altitude_p: float = 0.2
    """gain from altitude error to commanded vertical speed, 1/s; it also shapes a level-off"""
    throttle_p: float = 0.06
    throttle_i: float = 0.012
    airspeed_filter_s: float = 1.0
    climb_slew_mps2: float = 0.7
    """rate limit of the commanded vertical speed"""
    airspeed_slew_mps2: float = 0.7


GAINS = {
    "c172p": Gains(
        rotate_mps=28.0, climb_mps=38.0, cruise_mps=47.0, minimum_mps=29.0,
        climb_out_pitch_rad=0.14, nose_wheel=1.0,
    ),
    # An airliner of 49 t: stalls at 77 m/s clean, 58 with full flaps. 130 m/s are Mach 0.78 at 10.7
    # km.
    "737": Gains(
        rotate_mps=72.0, climb_mps=130.0, cruise_mps=130.0, minimum_mps=82.0,
        climb_out_pitch_rad=0.2, climb_out_mps=90.0, take_off_flaps=0.4, clean_mps=105.0,
        approach_mps=74.0, flare_s=5.0, touchdown_mps=0.8, speedbrake=1.0, bank_limit_rad=0.44,
        roll_in_radps=0.06, full_surface_mps=85.0, heading_p=1.3, yaw_rate=0.0, nose_wheel=0.3,
        take_off_nose_wheel=0.3, airspeed_pitch_p=0.006, airspeed_pitch_i=0.0006, altitude_p=0.08,
        path_p=0.8, path_i=0.25, throttle_p=0.06, throttle_i=0.003, climb_slew_mps2=1.0,
    ),
    # A fly-by-wire fighter of 9 t.
    "f16": Gains(
        rotate_mps=75.0, climb_mps=170.0, cruise_mps=180.0, minimum_mps=85.0,
        climb_out_pitch_rad=0.2, climb_out_mps=110.0, clean_mps=130.0, approach_mps=82.0,
        landing_flaps=0.0, touchdown_mps=0.8, speedbrake=0.5, pitch_limits_rad=(-0.5, 0.5),
        bank_limit_rad=0.8, roll_in_radps=0.4, full_surface_mps=150.0, heading_p=1.5, yaw_rate=0.0,
        nose_wheel=1.0, take_off_nose_wheel=0.3, airspeed_pitch_p=0.006, airspeed_pitch_i=0.0006,
        altitude_p=0.15, throttle_p=0.03, throttle_i=0.002, climb_slew_mps2=4.0,
        airspeed_slew_mps2=1.0,
    ),
    # A glider of 202 kg: glides best at 22 m/s, stalls at 14.
    "sgs126": Gains(
        rotate_mps=15.0, climb_mps=22.0, cruise_mps=22.0, minimum_mps=16.0, climb_out_pitch_rad=0.1,
        clean_mps=25.0, approach_mps=22.0, landing_flaps=0.0, speedbrake=1.0, bank_limit_rad=0.6,
        roll_in_radps=0.15, heading_p=0.35, bank_p=2.0, bank_i=0.4, yaw_rate=2.0,
    ),
}  # fmt: skip
