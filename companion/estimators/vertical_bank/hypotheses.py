"""How hypotheses about faults begin and end.

===================  ========================================  ===========  ======================
mode (slots)         begins                                    rate         ends
===================  ========================================  ===========  ======================
weather (3)          from the start                            1 in 20 min  never
GNSS wrong (4)       a fix surprises: g unknown (jump);        .1 /h        a jump by a jump only,
                     every 10 s: g slides                      .03 /h       a slide in minutes
barometer wrong (3)  a height surprises: o unknown (jump);     .1 /h        in 20 s, o is kept
                     every 10 s: o slides;                     .03 /h
                     after an outage of GNSS:
                     o and h unknown, their sum known          .03 or .003
IMU wrong (1)        either surprises;                         .1 /h        in 30 s
                     between fixes far apart                   60 /h        5 s
                     o and h unknown, their sum known
both wrong (2)       the other sensor surprises                as each      as each
returned (2)         from GNSS wrong: g as of a good receiver  see ends     in 20 s, to weather
                     from barometer wrong: o as before it      30 /h
===================  ========================================  ===========  ======================

A fault is supposed before the measurement that surprises is fused, from the most probable
hypothesis, with the rate times the time since the last measurement of that sensor as its prior. The
measurements decide from then on. Nothing is latched: an excluded sensor is one whose faulty modes
are probable.
"""

from companion.estimators.vertical_bank.channel import (
    CLIMB,
    GNSS_BIAS,
    GNSS_RATE,
    HEIGHT,
    OFFSET,
    RATE,
    dot,
    duplicate,
    gather,
    replace,
)
from companion.estimators.vertical_bank.mixture import (
    BA,
    BO,
    GN,
    MO,
    RE,
    N,
    baro_is_wrong,
    gnss_is_wrong,
    heaviest,
    heaviest_accuser,
    heaviest_of_wrong_baro,
    imu_is_wrong,
    is_unseen,
    normalise,
    rate_sd_mps,
)
from companion.jit import step
from companion.samples import Record

PER_H = 1.0 / 3600.0
SURPRISE_SIGMA = 3.0
SEARCH_US = 10_000_000
UNSEEN_M = 1.0
"""What a vehicle has moved by when a motion that the IMU did not tell is first supposed."""
DEFENDED_SD_M = 30.0
"""A height without GNSS that is worse is of no use."""
LEARNED = 1.0 + 1e-6
"""A hypothesis that is more probable than its prior by this factor has learned since it was
supposed. Where nothing was learned both are equal, but for rounding."""
ELSEWHERE = 0.1
"""Share of the further jumps of a faulty receiver that do not end its fault. Evidence counts by its
tempered likelihood, which forgives most of what a jump of any size has against one home: a spread
of 200 m where 6 m would do."""
AWAY_SIGMA = 2.0
"""An offset nearer to where it was has nothing to return from: a jump would be taken for the return
of a fault that nothing spoke for."""
LONGEST_ONSET_S = 10.0
"""A fault that shows after a longer silence may have begun at any time within it."""


@step
def suppose(
    bank: Record, parent: int, first: int, end: int, prior: float, is_surprise: bool
) -> int:
    """A copy of hypothesis `parent` in the least probable slot of [first, end), with the share
    `prior` of its probability; its slot.

    What explains a surprise needs a slot at once. A search gets none (-1) while all slots hold what
    is more probable: what began earlier knows more of a slow fault."""
    slot = -1
    for i in range(first, end):
        if i != parent and (slot < 0 or bank.weight[i] < bank.weight[slot]):
            slot = i
    weight = bank.weight[parent] * prior
    if slot < 0 or (not is_surprise and bank.weight[slot] > 10.0 * weight):
        return -1
    duplicate(bank.x[slot], bank.P[slot], bank.x[parent], bank.P[parent])
    bank.weight[slot], bank.weather[slot] = weight, bank.weather[parent]
    bank.jumped[slot] = bank.jumped[parent]
    if baro_is_wrong(parent):
        bank.home_m[slot], bank.home_m2[slot] = bank.home_m[parent], bank.home_m2[parent]
    else:  # the same slow error of the receiver is behind the height and the offset
        bank.home_m[slot] = bank.x[parent, OFFSET]
        bank.home_m2[slot] = bank.P[parent, OFFSET, OFFSET] + bank.slow_m2
    return slot


@step
def suppose_gnss_fault(
    bank: Record, jump_m: float, slide_mps: float, prior: float, is_surprise: bool
) -> None:
    """The most probable hypothesis, but its receiver is wrong since now, or in another way: it has
    jumped and stays there when `slide_mps` is 0, else it slides."""
    top = heaviest(bank, 0, N)
    both = baro_is_wrong(top)
    slot = suppose(bank, top, BO if both else GN, RE if both else BA, prior, is_surprise)
    if slot >= 0:
        bank.P[slot, GNSS_BIAS, GNSS_BIAS] += jump_m * jump_m
        replace(bank.x[slot], bank.P[slot], GNSS_RATE, 0.0, slide_mps * slide_mps)
        bank.jumped[slot] = 1 if slide_mps == 0.0 else 0


@step
def end_of_seen(bank: Record) -> int:
    """End of the slots of barometer faults that a reading shows."""
    return MO - 1 if is_unseen(bank, MO - 1) else MO


@step
def suppose_baro_fault(
    bank: Record, jump_m: float, slide_mps: float, prior: float, is_surprise: bool
) -> None:
    """The most probable hypothesis, but its barometer is wrong since now."""
    top = heaviest(bank, 0, N)
    both = gnss_is_wrong(top)
    first, end = (BO, RE) if both else (BA, end_of_seen(bank))
    slot = suppose(bank, top, first, end, prior, is_surprise)
    if slot >= 0:
        bank.P[slot, OFFSET, OFFSET] += jump_m * jump_m
        if not baro_is_wrong(top):
            bank.P[slot, RATE, RATE] += slide_mps * slide_mps


@step
def suppose_motion(bank: Record, p: Record, is_blind: bool, elapsed_s: float) -> None:
    """The most probable hypothesis, but the vehicle has moved otherwise than the IMU tells, or than
    is usual without one. While no fix watches the barometer, the barometer alone says so against
    the IMU: either may be wrong, and the height is unknown until GNSS returns."""
    top = heaviest(bank, 0, N)
    if imu_is_wrong(top) or gnss_is_wrong(top) or baro_is_wrong(top):
        return
    rate_per_h = p.manoeuvre_rate_per_h if is_blind else p.fault_rate_per_h
    prior = rate_per_h * PER_H * elapsed_s
    slot = MO
    if bank.weight[MO] < LEARNED * bank.weight[top] * prior:
        slot = suppose(bank, top, MO, BO, prior, True)
        if slot >= 0:
            bank.P[slot, CLIMB, CLIMB] += p.manoeuvre_mps * p.manoeuvre_mps
            bank.P[slot, HEIGHT, HEIGHT] += UNSEEN_M * UNSEEN_M
    m2 = p.outage_fault_m * p.outage_fault_m
    if slot >= 0 and bank.unwatched == 1 and not is_blind and bank.P[slot, OFFSET, OFFSET] < m2:
        divide_anew(bank, slot, m2)


@step
def suppose_return(bank: Record, parent: int, prior: float, is_surprise: bool) -> None:
    """Hypothesis `parent`, but its receiver is well again since now; that much less of the parent
    remains. Where the barometer was wrong too, it still is."""
    still = baro_is_wrong(parent)
    slot = suppose(bank, parent, BA if still else RE, MO if still else N, prior, is_surprise)
    bank.weight[parent] *= 1.0 - min(1.0, prior)
    if slot >= 0:
        replace(bank.x[slot], bank.P[slot], GNSS_BIAS, 0.0, bank.slow_m2)
        replace(bank.x[slot], bank.P[slot], GNSS_RATE, 0.0, 0.0)
        bank.jumped[slot] = 0


@step
def drift_as_weather(bank: Record, p: Record, i: int) -> None:
    """The barometer of hypothesis i drifts as its weather does."""
    rate_sd = rate_sd_mps(bank, p, i)
    replace(bank.x[i], bank.P[i], RATE, 0.0, rate_sd * rate_sd)


@step
def suppose_baro_return(bank: Record, p: Record, prior: float) -> None:
    """The most probable hypothesis whose barometer is wrong, but its offset is since now what it
    was before; that much less of the parent remains. Where the receiver was wrong too, it still
    is."""
    parent = heaviest_of_wrong_baro(bank)
    home_m, home_m2 = bank.home_m[parent], bank.home_m2[parent]
    is_away = (bank.x[parent, OFFSET] - home_m) ** 2 > AWAY_SIGMA * AWAY_SIGMA * home_m2
    if bank.weight[parent] == 0.0 or not is_away:
        return
    still = gnss_is_wrong(parent)
    slot = suppose(bank, parent, GN if still else RE, BA if still else N, prior, True)
    bank.weight[parent] *= 1.0 - min(1.0, prior)
    if slot >= 0:
        replace(bank.x[slot], bank.P[slot], OFFSET, home_m, home_m2)
        drift_as_weather(bank, p, slot)


@step
def divide_anew(bank: Record, i: int, m2: float) -> None:
    """Hypothesis i knows the sum of height and barometer offset as before, but each only within the
    variance `m2`."""
    bank.P[i, HEIGHT, HEIGHT] += m2
    bank.P[i, OFFSET, OFFSET] += m2
    bank.P[i, HEIGHT, OFFSET] -= m2


@step
def suppose_after_outage(bank: Record, p: Record, prior: float) -> None:
    """The barometer has been wrong since some time of an outage of GNSS, and took the height with
    it."""
    slot = suppose(bank, heaviest(bank, 0, N), MO - 1, MO, prior, False)
    if slot >= 0:
        divide_anew(bank, slot, p.outage_fault_m * p.outage_fault_m)


@step
def suppose_unseen(bank: Record, p: Record) -> None:
    """The barometer has been wrong since some time of this outage of GNSS, in which the vehicle is
    blind: as probable as `bank.unseen`."""
    suppose_after_outage(bank, p, bank.unseen / bank.weight[heaviest(bank, 0, N)])


@step
def keep_unseen(bank: Record, p: Record) -> None:
    """No reading of the barometer speaks against a fault that nothing shows. Where readings have
    made it improbable, as a manoeuvre is supposed of other hypotheses alone, its prior counts
    again."""
    if is_unseen(bank, MO - 1) and bank.weight[MO - 1] < 0.5 * bank.unseen:
        suppose_unseen(bank, p)
        normalise(bank)


@step
def on_gnss_surprise(
    bank: Record, p: Record, is_blind: bool, elapsed_s: float, is_precise: bool
) -> None:
    """What may be behind a fix that the most probable hypothesis does not explain: a fault begins,
    or one that was less probable until now ends. A wrong receiver that surprises again does not
    stay where it jumped to: taken for steps, a ramp after a jump would carry the height away.
    Where a receiver is precise, a slide surprises when it begins."""
    top, accuser = heaviest(bank, 0, N), heaviest_accuser(bank)
    elapsed_s = min(elapsed_s, LONGEST_ONSET_S)
    again = p.rejump_rate_per_h * PER_H * elapsed_s
    if bank.weight[accuser] > 0.0:
        suppose_return(bank, accuser, again, True)
    if gnss_is_wrong(top):
        suppose_gnss_fault(bank, p.gnss_jump_m, p.slide_sd_mps, ELSEWHERE * again, True)
    else:
        suppose_gnss_fault(bank, p.gnss_jump_m, 0.0, p.fault_rate_per_h * PER_H * elapsed_s, True)
        if is_precise:
            slides = p.slide_rate_per_h * PER_H * elapsed_s
            suppose_gnss_fault(bank, UNSEEN_M, p.slide_sd_mps, slides, True)
    suppose_motion(bank, p, is_blind, elapsed_s)


@step
def explains(bank: Record, first: int, end: int, least: float, z: float, R: float) -> bool:
    """Whether a hypothesis of slots [first, end) of at least this probability expected z."""
    for i in range(first, end):
        if bank.weight[i] < least or bank.weight[i] == 0.0:
            continue
        innovation = z - dot(bank.H, bank.x[i])
        S = R + gather(bank.P[i], bank.H, bank.K)
        if innovation * innovation <= SURPRISE_SIGMA * SURPRISE_SIGMA * S:
            return True
    return False


@step
def on_baro_surprise(
    bank: Record, p: Record, is_blind: bool, elapsed_s: float, z: float, R: float
) -> None:
    """What may be behind a barometer height z = H x + white of variance R, NaN for a repeat, that
    the most probable hypothesis does not explain. A fault that was supposed before and does is not
    given up for one that begins now."""
    top = heaviest(bank, 0, N)
    elapsed_s = min(elapsed_s, LONGEST_ONSET_S)
    suppose_baro_return(bank, p, p.rejump_rate_per_h * PER_H * elapsed_s)
    rate_per_h = p.rejump_rate_per_h if baro_is_wrong(top) else p.fault_rate_per_h
    prior = rate_per_h * PER_H * elapsed_s
    first, end = (BO, RE) if gnss_is_wrong(top) else (BA, end_of_seen(bank))
    if not explains(bank, first, end, prior * bank.weight[top], z, R):
        suppose_baro_fault(bank, p.baro_jump_m, 3.0 * p.baro_fault_rate_mps, prior, True)
    suppose_motion(bank, p, is_blind, elapsed_s)


@step
def doubt_repeat(bank: Record, repeat_probability: float) -> None:
    """The barometer repeated a value: sure of one that is stuck, else this probable."""
    for i in range(N):
        if not baro_is_wrong(i):
            bank.weight[i] *= repeat_probability
    normalise(bank)


@step
def trust_again(bank: Record, doubt: float) -> None:
    """A new value after repeats of this probability: they were chance, which takes back
    `doubt_repeat`."""
    for i in range(N):
        if baro_is_wrong(i):
            bank.weight[i] *= doubt
    normalise(bank)


@step
def lasts_s(bank: Record, p: Record, i: int) -> float:
    """Duration of the receiver's fault in hypothesis i. A jump ends by a jump, but where the height
    without GNSS has become of no use, better a GNSS that may be wrong. The most probable slide is
    none any more when it stands still where a good receiver may be."""
    if bank.P[i, HEIGHT, HEIGHT] > DEFENDED_SD_M * DEFENDED_SD_M:
        return float(p.baro_fault_time_s)
    if bank.jumped[i] == 1:
        return float(p.jump_time_s)
    if i != heaviest(bank, 0, N):
        return float(p.slide_end_s)
    moves_m = bank.x[i, GNSS_RATE] * SEARCH_US * 1e-6
    is_usual = bank.x[i, GNSS_BIAS] ** 2 < 4.0 * bank.slow_m2 and moves_m**2 < bank.slow_m2
    return float(p.baro_fault_time_s if is_usual else p.slide_end_s)


@step
def suppose_baro_is_well(bank: Record, p: Record, elapsed_s: float) -> None:
    """Of the two that are wrong, the barometer is well again, with the offset that it has."""
    both = heaviest(bank, BO, RE)
    if bank.weight[both] == 0.0:
        return
    slot = suppose(bank, both, GN, BA, elapsed_s / p.baro_fault_time_s, False)
    bank.weight[both] *= 1.0 - min(1.0, elapsed_s / p.baro_fault_time_s)
    if slot >= 0:
        drift_as_weather(bank, p, slot)


@step
def search(bank: Record, p: Record) -> None:
    """Every ten seconds: a slow fault may have begun, a slide of the receiver may have ended, or
    begun after a jump. A barometer that is alone may have gone wrong unseen."""
    if bank.now_us - bank.searched_us < SEARCH_US:
        return
    elapsed_s = min((bank.now_us - bank.searched_us) * 1e-6, LONGEST_ONSET_S)
    bank.searched_us = bank.now_us
    if not is_unseen(bank, MO - 1):
        bank.unseen = 0.0
    top = heaviest(bank, 0, N)
    prior = p.slide_rate_per_h * PER_H * elapsed_s
    if not gnss_is_wrong(top):
        suppose_gnss_fault(bank, p.slide_onset_m, p.slide_sd_mps, prior, False)
    elif bank.jumped[top] == 1:  # what is known to be wrong need not stay where it jumped to
        again = p.rejump_rate_per_h * PER_H * elapsed_s
        suppose_gnss_fault(bank, p.slide_onset_m, p.slide_sd_mps, again, False)
    if is_unseen(bank, MO - 1):
        bank.unseen += (p.fault_rate_per_h + p.slide_rate_per_h) * PER_H * elapsed_s
        suppose_unseen(bank, p)
    elif not baro_is_wrong(top):
        suppose_baro_fault(bank, p.slide_onset_m, p.baro_fault_rate_mps, prior, False)
    for i in range(GN, RE):
        if bank.weight[i] > 0.0 and gnss_is_wrong(i):
            suppose_return(bank, i, elapsed_s / lasts_s(bank, p, i), False)
    suppose_baro_is_well(bank, p, elapsed_s)
    normalise(bank)
