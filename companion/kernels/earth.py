"""The WGS-84 ellipsoid: normal gravity, radii of curvature, rotation.

Gravity at the surface by Somigliana's closed formula, above it by the second-order expansion in
height (NIMA TR8350.2, third edition, equations 4-1 and 4-3). What is left out is the anomaly of the
real Earth, mostly under 50 mGal = 0.0005 m/s2.
"""

import math

from companion.jit import step

EQUATORIAL_RADIUS_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY2 = FLATTENING * (2.0 - FLATTENING)
EQUATOR_MPS2 = 9.7803253359
SOMIGLIANA = 0.00193185265241
"""k = b gamma_pole / (a gamma_equator) - 1"""
CENTRIFUGAL = 0.00344978650684
"""m = omega^2 a^2 b / GM"""
ROTATION_RADPS = 7.292115e-5


@step
def gravity_mps2(latitude_deg: float, height_m: float) -> float:
    """Normal gravity at a geodetic latitude and a height over the ellipsoid (AMSL will do: 50 m are
    0.00015 m/s2)."""
    sine = math.sin(math.radians(latitude_deg))
    sine2 = sine * sine
    surface = EQUATOR_MPS2 * (1.0 + SOMIGLIANA * sine2) / math.sqrt(1.0 - ECCENTRICITY2 * sine2)
    ratio = height_m / EQUATORIAL_RADIUS_M
    return surface * (
        1.0
        - 2.0 * (1.0 + FLATTENING + CENTRIFUGAL - 2.0 * FLATTENING * sine2) * ratio
        + 3.0 * ratio**2
    )


@step
def meridian_radius_m(latitude_rad: float) -> float:
    """Radius of curvature of the ellipsoid in the meridian plane: how far north a radian of
    latitude is."""
    sine = math.sin(latitude_rad)
    bulge = 1.0 - ECCENTRICITY2 * sine * sine
    return EQUATORIAL_RADIUS_M * (1.0 - ECCENTRICITY2) / (bulge * math.sqrt(bulge))


@step
def normal_radius_m(latitude_rad: float) -> float:
    """Radius of curvature of the ellipsoid in the prime vertical; times cos(latitude), how far east
    a radian is."""
    sine = math.sin(latitude_rad)
    return EQUATORIAL_RADIUS_M / math.sqrt(1.0 - ECCENTRICITY2 * sine * sine)
