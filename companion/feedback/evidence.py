"""How much of a measured change is proven, and what follows for the correction.

The change of the barometer's error since arming is a difference of two estimates, and has the
spread of both: with a poor receiver it is metres in calm air. A correction that followed it would
make an altitude worse that was right. So only what exceeds the spread is written:

    proven = change (1 - (limit / change)^2) beyond the limit, otherwise 0

This is the positive-part estimator of James and Stein (1961) in one dimension: nothing of a small
change, three quarters of one of twice the limit, and almost all of a large one.
"""


def proven_m(change_m: float, limit_m: float) -> float:
    """The part of a change that exceeds what its spread explains, m.

    Parameters
    ----------
    limit_m : the change that the spread explains.
    """
    if abs(change_m) <= limit_m or change_m == 0.0:
        return 0.0
    return change_m * (1.0 - (limit_m / change_m) ** 2)


def target_m(written_m: float, change_m: float, limit_m: float) -> float:
    """The correction to move to, m: `written_m` itself while nothing speaks against it.

    A correction between the proven part and the whole of the change is left alone. So one that was
    proven by a good receiver stays when the receiver becomes poor. One that lies beyond the change,
    or on the other side of zero, is moved by the proven part of the difference.
    """
    least_m = proven_m(change_m, limit_m)
    if min(0.0, change_m) <= written_m <= max(0.0, change_m):
        return least_m if abs(written_m) < abs(least_m) else written_m
    return written_m + proven_m(change_m - written_m, limit_m)
