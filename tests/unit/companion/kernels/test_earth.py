"""Normal gravity against the values that geodesy publishes."""

import pytest

from companion.kernels.earth import gravity_mps2


@pytest.mark.parametrize(
    ("latitude_deg", "published"),
    [
        (0.0, 9.7803253359),  # NIMA TR8350.2, equatorial and polar normal gravity
        (90.0, 9.8321849378),
        (-90.0, 9.8321849378),
        (45.0, 9.8061977),  # the same, normal gravity at 45 degrees
    ],
)
def test_surface_gravity(latitude_deg: float, published: float) -> None:
    assert gravity_mps2(latitude_deg, 0.0) == pytest.approx(published, abs=2e-7)


@pytest.mark.parametrize("latitude_deg", [0.0, 30.0, 47.0, 90.0])
@pytest.mark.parametrize("height_m", [-400.0, 1000.0, 11_000.0])
def test_free_air_correction_in_the_form_of_geophysics(
    latitude_deg: float, height_m: float
) -> None:
    """Second-order free-air correction for GRS 80 as gravimetry tabulates it, in milligal (Hinze et
    al. 2005)."""
    from math import radians, sin

    sine2 = sin(radians(latitude_deg)) ** 2
    milligal = -(0.3087691 - 0.0004398 * sine2) * height_m + 7.2125e-8 * height_m**2
    change = gravity_mps2(latitude_deg, height_m) - gravity_mps2(latitude_deg, 0.0)
    assert change == pytest.approx(milligal * 1e-5, abs=2e-6)
