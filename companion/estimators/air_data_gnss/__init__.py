"""Barometer compensated for bias and scale factor from GNSS height and air temperature.

I-H. Whang, W-S. Ra, "Simple Altitude Estimator using Air-Data and GPS Measurements", IFAC World
Congress 2008. The paper's letters:

==================  =========================  =====================================================
h^B                 ``baro``                   standard-atmosphere height of the pressure (1)
h^GPS               ``fix_m``                  GNSS height
a, b                ``error``                  scale and bias error: h^B - h = a (h - H_0) + b (2)
P^a, P^b            ``error.P``                covariance; diagonal if ``covariance: marginal``
lambda              `scale_of_temperature`     pseudo measurement of a from temperature (6)
z, R                `z_innovation`             h^B - h^GPS (10), its variance R^B + R^GPS
x, P                ``motion.x``, ``motion.P``   height and climb, alpha-beta filter (33), (34)
h^c                 `compensate`               compensated barometer height (32)
Gamma               ``L0_KPM``                 lapse rate of the standard atmosphere
H_0, T_0            ``error.H_0``, ``.T_0``    reference height, and the standard temperature there
==================  =========================  =====================================================

A cycle is one barometer sample: predict height and climb (33), add Q^a and Q^b (17), (18),
lambda-update (20)-(22) with the predicted height, z-update (25)-(31) when a fix has come,
compensate (32), correct height and climb. The paper's Gaussian-approximation z-update is that of a
Kalman filter for [a, b] whose correlation is dropped afterwards (shown in
tests/oracles/test_air_data_gnss.py), so one `kalman.correct` serves both the paper's filter and the
joint one.

Errata
------
(2)-(4), (6): a = T_0/T_0' - 1, so lambda has a minus; as printed, +15 K puts 1600 m at 1450 m. (7)
divides by T_0^2, and the spread of the lapse rate is K/m. z^a and S^a of (23) divide by h^GPS and
are not formed. The regressor of (10) is the predicted height above H_0, not h^GPS. 1 + a is held at
.5 or above.

Departures
----------
- H_0 and T_0 are not latched at launch, since no first fix can be trusted. H_0 is that of the
  settings until the altimeter is set live (a QNH, or the elevation of the field:
  `companion.estimators.setting`), then the height of the field; T_0 is the standard's there. The
  temperature and the pressure of the field go to a (6) and b. h^B is the standard atmosphere's full
  column in geometric metres: for a constant lapse rate its error is exactly affine in height.
- Q^a, Q^b, Q^h grow with time, so that every sample rate means the same; the paper's are for steps
  of 0.2 s.
- A fix meets the barometer height of its own time; one that is newer than the barometer waits for
  the next sample.
- A temperature is trusted when it is a sample of AIR. That of SCALED_PRESSURE is the sensor die's,
  10-30 K above the air, and unused by default; ``temperature: die`` subtracts ``die_offset_k``,
  with a spread to match.
- Preset ``tuned``: slow walks (b by 3 m in 200 s), the joint covariance, lambda = T_0/T_0' - 1
  without linearising, temperatures that are news only once a minute (the lapse rate's error changes
  no sooner), and the height moves with a new correction instead of filtering it, since a new b is
  no climb. Innovations beyond 3 sigma (barometer: 5) lose weight. When they last (10 s; barometer:
  1/4 s) the barometer has jumped, or a and b are wrong, and are learned anew.
- Without a barometer for three seconds the alpha-beta filter follows GNSS heights.
- ``altitude_sd_m`` is not the paper's P, whose Q^b means 45 m a second. It is the covariance of the
  correction after the last fix, grown as the barometer's error can
  (`companion.estimators.outage`), plus the barometer's noise and the half
  of the GNSS variance that is correlated over minutes and does not average out.

It uses no IMU.

Breaks when
-----------
GNSS wanders for minutes: it is taken for white, so b follows it. A barometer freezes in a climb:
that looks like a = -1 until the fixes have contradicted it for long. Temperature above 11 km is not
used, (5) ends there. With the paper's Q^b the output is noisier than the barometer: 38 m rms from
70 m GPS, where the raw barometer has 6 m.

Other packages use its `METHOD` only.
"""

from companion.estimators.air_data_gnss.steps import METHOD

__all__ = ["METHOD"]
