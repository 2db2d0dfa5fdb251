"""The two baro-inertial filters of paper K. Other packages use their `METHOD`s only."""

from dataclasses import replace

from companion.estimators.baro_inertial import baro_ins_kf, damping_loop, tuning

DAMPING_LOOP = replace(damping_loop.METHOD, tune=tuning.tune)
BARO_INS_KF = baro_ins_kf.METHOD

__all__ = ["BARO_INS_KF", "DAMPING_LOOP"]
