"""Fault-tolerant integrated baro-inertial-GPS altimeter.

A. Mañero Contreras, C. Hajiyev, "Robust Kalman Filter-Based Fault-Tolerant Integrated
Baro-Inertial-GPS Altimeter",
2019. Its equations are in `error_model`, its altimeters in `altimeters` and `isolation`. Letters:

==================  ======================  ========================================================
H_I                 ``height_m[k]``         height of altimeter k, mechanised: IBI 0, IIG 1
X                   ``x[k]``                height, climb, acceleration, gravity, baro errors (8)
P, K                ``P[k]``, ``K``         covariance, gain
Z                   ``Z_sum``, ``Z_count``  H_I - h_B or H_I - h_GPS (10), mean over an iteration
R                   `height_variance`              (13), (18)
prob(1/i)           ``prob[k]``             posterior probability of normal operation (32)
IBIG                `write_estimate`        both, weighted by each other's variance (19)-(21)
==================  ======================  ========================================================

Three integrated altimeters run side by side: IBI and IIG each mechanise the upward specific force
and estimate its errors from the barometer or from GNSS; IBIG weighs them. ``publish`` says which
one becomes the estimate. ``gain`` is optimal (22) or robust (28), where a measurement counts with
the probability that it is normal. ``trust`` in the state is what the paper's conclusions recommend:
IBIG while nothing is faulty, the healthy one of two, IBIG again when both are faulty; ``publish:
recommended`` obeys it, and the estimate names the sensor.

Errata
------
(14) has five elements for the four states of (15). sigma_w of Table 1 enters no equation. sigma_B =
1 m as the driving noise of (2) makes a bias of 5.0 m; 0.2 makes one of 1 m, and both presets use
that. (26) reduces P as if the measurement had counted in full, whatever prob(1/i): neither P nor
the weights of (19) see a fault.

Departures
----------
- Closed loop: the estimated errors of height and climb are taken out of the mechanisation after
  each iteration, those of acceleration and gravity while it integrates. Open loop, the errors of a
  small IMU grow to kilometres.
- An iteration takes T_d = 0.5 s as in the paper, or as long as no measurement comes; what arrives
  meanwhile is averaged, without what lies beyond 3 sigma as long as anything lies within (robust
  gain). A fix meets the height of its own time.
- Re-acquisition: the paper has none, and after a fault of 15 m its robust filter never listens
  again. When prob(1/i) has been below 0.5 for ``reacquire_s``, the altimeter takes its height from
  the measurement and its climb from the other altimeter. For so long the inertial channel alone is
  better than what it rejects: 10 s with a small IMU, 120 s with the paper's.
- Preset ``tuned`` is for small IMUs: sigma_Daz stands for an acceleration error of 0.1 m/s2 that
  changes within 30 s (attitude errors of 1-2 degrees in turns); the paper's 2e-5 is navigation
  grade (preset ``paper``). sigma_GPS is the reported accuracy, and the paper's 2.23 m at least.
- The paper's "central processing unit" aligns the datum of the barometer with that of the inertial
  channel. Here it is the running mean of barometer less IIG height over ``reference_s``, for as
  long as correlated GNSS errors last (300 s); a large difference moves it little. It stands still
  while one altimeter is in doubt, and begins anew when a difference outlasts the doubt, or grows
  beyond 2 sigma for 10 s as slowly as weather and climbs make it grow.
- When both altimeters refuse their measurements twice in the same direction, it is the IMU: both
  re-acquire. The paper's scenario 3, the same bias on both sensors at once, looks alike.
- Fault isolation: an altimeter is in doubt when prob(1/i), averaged over 3 s, is below 0.5, and
  then until the two agree again, for 60 s at most. When they part without that it is the one that
  has jumped, or the barometer if fast.
- Without an IMU that can be integrated (below about 10 Hz, silent for 0.5 s, attitude unknown; slow
  samples are IGNORED) the acceleration is unknown: 2 m/s2 for 2 s, R has no sigma_INS, and the
  robust gain refuses no more than one iteration. IBI then follows the barometer, IIG GNSS.
- ``altitude_sd_m`` is not sqrt(P): see `spread_m`. An altimeter whose own sqrt(P) exceeds 100 m
  starts anew.

- Without GNSS the datum is the setting of the altimeter (`companion.estimators.setting`), with its
  spread; with ``publish: ibi`` and no setting it is the standard atmosphere's, 83 m.

Breaks when
-----------
The air is warmer or colder than standard and the vehicle climbs, or weather changes: IBIG keeps its
share of the barometer's error until the datum has followed. GNSS that drifts, or is wrong by less
than 4 sigma, takes the datum along. A fault below about 20 m passes the robust gain in part, bends
the climb, and is worse than with the optimal gain. Preset ``paper`` on a small IMU: it uses an
accelerometer that is wrong by 0.1 m/s2, by tens of metres.

Other packages use its `METHOD` only.
"""

from companion.estimators.robust_altimeter.steps import METHOD

__all__ = ["METHOD"]
