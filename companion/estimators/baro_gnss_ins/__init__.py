"""Barometer in a GNSS/INS extended Kalman filter.

P. F. Roysdon, J. A. Farrell, "Technical Note: Summary of Baro Pressure for GPS-INS Vertical Channel
Stability". The paper's letters:

==================  ========================  ======================================================
h_p                 ``h_p``                   barometric altitude (12), here closed-form
p, v, q             ``position_radm`` ...     position, velocity, attitude quaternion of (14)
b_a, b_g            ``force_bias_mps2`` ...   accelerometer and gyroscope bias of (14)
b_bb, b_bsf         ``b_m, s``                barometer bias and scale factor: h = h_p + b + s h_p
dP_d, dv_d          ``dx[2], dx[5]``          errors of the vertical channel, north-east-down
dt_b                ``dt_b``                  barometer's time less the state's
z, H                ``z, H``                  baro residual (15) and its row (16)
sigma_b^2           ``baro_sd_m``             1.0 m2 (the paper prints "1.0 m")
==================  ========================  ======================================================

State: seventeen errors, true minus estimated; the first fifteen are those of
`companion.estimators.baro_gnss_ins.strapdown`, then b and s. The paper's n_s = 20 counts four
numbers of the quaternion (three errors here) and the receiver's clock bias and drift. Those two
need pseudoranges: GPS_RAW_INT has none, so this filter is loosely coupled and has no clock states.
"Fewer than four satellites" is then a time without fixes.

How it runs: RAW_IMU drives the mechanisation; each pressure and each fix corrects it. Attitude is
aligned in motion by `companion.kernels.attitude`: roll and pitch from specific force less the
acceleration that GNSS shows, yaw from the course once the vehicle moves, before that with a spread
of half a turn, which leaves the vertical channel as good as it is at rest. Before alignment, below
10 Hz of IMU (verdict IGNORED), in gaps of it, or a minute without GNSS velocity, the same state
runs as height, climb and barometer errors under white acceleration
(`companion.estimators.baro_gnss_ins.filter`). ATTITUDE is not used unless the settings say so.

Errata
------
- (12) is off by -251.6 m at sea level and by kilometres at the ends of its range: kept as
  `altimetry.cubic_altitude_m`, not used.
- (11): an inch of mercury has 3386.389 Pa. (13): its derivative is positive, and is taken at the
  measured pressure.
- (8) gives the height above ground the wrong sign: it should read (p_ground - p) / (rho g).
- (15) and (16) agree, and b is what is added to the barometer, not its error.
- h_m in (16) must not follow the measured altitude. Its noise is also in z, and the product drives
  s steadily down (a minute of 5 m noise at 20 Hz: s = -0.6); and a row that changes from sample to
  sample makes b and s look separable in level flight. Here h_m is held until the altitude has
  changed by 10 m.

Departures
----------
- The 5 Pa gate between samples is replaced by one against the trend
  (`companion.estimators.baro_gnss_ins.spikes`), which neither forbids climbs nor latches. Its 8 Pa
  grow with the sensor's noise and with the sample interval. Where it had to learn a jump, b's
  variance grows by the square of it.
- b and s cannot be told apart in level flight, so s has a prior: temperatures that are 4 % from
  standard (11 K), as in recorded flights (-7 to +1 %). b has one of 100 m, 12 hPa. b walks 0.3
  m/sqrt(s), 18 m an hour: a fast front.
- sigma_b is the least: a sensor that is noisier than that, as its trend shows, gets its own noise.
- A pressure equal to the last one is no news (autopilots repeat their newest value) and corrects
  nothing.
- Innovations of the barometer beyond 3 sigma count as if they were at 3 sigma; fifteen of them in a
  row on one side are a step, which b takes; three seconds of them are a wrong IMU, which then rests
  for 30 s (verdict GATED).
- GNSS heights beyond 3 sigma of the reported accuracy are GATED until they have lasted
  (`fixes.fuse_height`), never for good.
- A fix is late: it meets the state of its own time (`companion.estimators.baro_gnss_ins.track`),
  with its age in H as dt_b in (16).
- GNSS errors are correlated in time: fixes within 2 s count as one (R grows by 2 s / interval), and
  three quarters of the reported variance are added to that of the state in ``altitude_sd_m``, since
  no averaging removes them.

- ``barometer: gnss_unreliable`` is the paper's second use of the barometer: while fixes are fresh
  and accepted, a pressure calibrates b and s only, and moves neither height nor climb.
- A setting of the altimeter (`companion.estimators.setting`) takes the place of the Kollsman
  correction (13): it measures b + s h_p once, where it tells more than is known.

Breaks when
-----------
The receiver's slow error exceeds its reported accuracy: the height follows it within a minute. The
air's scale error changes with height (an inversion): s is one number. The vehicle moves across its
nose (multirotors): the course is no heading; when the velocities contradict for 5 s the IMU rests
and is aligned again.

Other packages use its `METHOD` only.
"""

from companion.estimators.baro_gnss_ins.steps import METHOD

__all__ = ["METHOD"]
