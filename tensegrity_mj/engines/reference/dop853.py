"""One step of DOP853, compiled, with its dense output: an explicit method of Runge and Kutta of order 8(5,3).

E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed., Springer 1993, section II.5,
and its appendix for the coefficients; steps are chosen as SciPy's `DOP853` chooses them. Sums run over stages in their
order, for each number of the state by itself, and roots are square roots alone: the same bits on every processor.

A run under error control has a table, `Controlled`, which a method finds with the run's state and leaves with that at
the end of its step. So the loop that takes the steps (`controlled`) serves every method.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tensegrity_mj.basics.arrays import Array
from tensegrity_mj.dynamics.native.compiling import c_function
from tensegrity_mj.dynamics.native.law import NO_SOLUTION
from tensegrity_mj.dynamics.native.plant_view import PlantView
from tensegrity_mj.dynamics.native.pointers import TIMED, borrowing, inlined
from tensegrity_mj.dynamics.native.views import changing_view, fields_of
from tensegrity_mj.engines.reference.equations import SINGULAR, rates

STAGES, EXTRA, POWERS = 12, 3, 7  # stages of a step, more for its dense output, and powers of that
STAGES_IN_ALL = STAGES + 1 + EXTRA
# Parts of a step at which its stages are, of 30 digits.
_NODES = """
0 0.0526001519587677318785587544488 0.0789002279381515978178381316732 0.118350341907227396726757197510
0.281649658092772603273242802490 0.333333333333333333333333333333 0.25 0.307692307692307692307692307692
0.651282051282051282051282051282 0.6 0.857142857142857142857142857143 1 1 0.1 0.2 0.777777777777777777777777777778
"""
NODES = np.array(_NODES.split(), float)
# Rows of weights: of the stages 1 to 11; of the end of a step (12); of the dense output's stages 13 to 15; of the
# errors of order 3 and 5; of the dense output's powers 3 to 6. Each row: its number, then column and weight in turn.
NEW, ERROR_3, ERROR_5, DENSE = 12, 16, 17, 18
_WEIGHTS = """
1: 0 5.26001519587677318785587544488e-2
2: 0 1.97250569845378994544595329183e-2 1 5.91751709536136983633785987549e-2
3: 0 2.95875854768068491816892993775e-2 2 8.87627564304205475450678981324e-2
4: 0 2.41365134159266685502369798665e-1 2 -8.84549479328286085344864962717e-1 3 9.24834003261792003115737966543e-1
5: 0 3.7037037037037037037037037037e-2 3 1.70828608729473871279604482173e-1 4 1.25467687566822425016691814123e-1
6: 0 3.7109375e-2 3 1.70252211019544039314978060272e-1 4 6.02165389804559606850219397283e-2 5 -1.7578125e-2
7: 0 3.70920001185047927108779319836e-2 3 1.70383925712239993810214054705e-1 4 1.07262030446373284651809199168e-1
    5 -1.53194377486244017527936158236e-2 6 8.27378916381402288758473766002e-3
8: 0 6.24110958716075717114429577812e-1 3 -3.36089262944694129406857109825 4 -8.68219346841726006818189891453e-1
    5 2.75920996994467083049415600797e1 6 2.01540675504778934086186788979e1 7 -4.34898841810699588477366255144e1
9: 0 4.77662536438264365890433908527e-1 3 -2.48811461997166764192642586468 4 -5.90290826836842996371446475743e-1
    5 2.12300514481811942347288949897e1 6 1.52792336328824235832596922938e1 7 -3.32882109689848629194453265587e1
    8 -2.03312017085086261358222928593e-2
10: 0 -9.3714243008598732571704021658e-1 3 5.18637242884406370830023853209 4 1.09143734899672957818500254654
    5 -8.14978701074692612513997267357 6 -1.85200656599969598641566180701e1 7 2.27394870993505042818970056734e1
    8 2.49360555267965238987089396762 9 -3.0467644718982195003823669022
11: 0 2.27331014751653820792359768449 3 -1.05344954667372501984066689879e1 4 -2.00087205822486249909675718444
    5 -1.79589318631187989172765950534e1 6 2.79488845294199600508499808837e1 7 -2.85899827713502369474065508674
    8 -8.87285693353062954433549289258 9 1.23605671757943030647266201528e1 10 6.43392746015763530355970484046e-1
12: 0 5.42937341165687622380535766363e-2 5 4.45031289275240888144113950566 6 1.89151789931450038304281599044
    7 -5.8012039600105847814672114227 8 3.1116436695781989440891606237e-1 9 -1.52160949662516078556178806805e-1
    10 2.01365400804030348374776537501e-1 11 4.47106157277725905176885569043e-2
13: 0 5.61675022830479523392909219681e-2 6 2.53500210216624811088794765333e-1 7 -2.46239037470802489917441475441e-1
    8 -1.24191423263816360469010140626e-1 9 1.5329179827876569731206322685e-1 10 8.20105229563468988491666602057e-3
    11 7.56789766054569976138603589584e-3 12 -8.298e-3
14: 0 3.18346481635021405060768473261e-2 5 2.83009096723667755288322961402e-2 6 5.35419883074385676223797384372e-2
    7 -5.49237485713909884646569340306e-2 10 -1.08347328697249322858509316994e-4 11 3.82571090835658412954920192323e-4
    12 -3.40465008687404560802977114492e-4 13 1.41312443674632500278074618366e-1
15: 0 -4.28896301583791923408573538692e-1 5 -4.69762141536116384314449447206 6 7.68342119606259904184240953878
    7 4.06898981839711007970213554331 8 3.56727187455281109270669543021e-1 12 -1.39902416515901462129418009734e-3
    13 2.9475147891527723389556272149 14 -9.15095847217987001081870187138
17: 0 0.1312004499419488073250102996e-1 5 -0.1225156446376204440720569753e+1 6 -0.4957589496572501915214079952
    7 0.1664377182454986536961530415e+1 8 -0.3503288487499736816886487290 9 0.3341791187130174790297318841
    10 0.8192320648511571246570742613e-1 11 -0.2235530786388629525884427845e-1
18: 0 -0.84289382761090128651353491142e+1 5 0.56671495351937776962531783590 6 -0.30689499459498916912797304727e+1
    7 0.23846676565120698287728149680e+1 8 0.21170345824450282767155149946e+1 9 -0.87139158377797299206789907490
    10 0.22404374302607882758541771650e+1 11 0.63157877876946881815570249290 12 -0.88990336451333310820698117400e-1
    13 0.18148505520854727256656404962e+2 14 -0.91946323924783554000451984436e+1
    15 -0.44360363875948939664310572000e+1
19: 0 0.10427508642579134603413151009e+2 5 0.24228349177525818288430175319e+3 6 0.16520045171727028198505394887e+3
    7 -0.37454675472269020279518312152e+3 8 -0.22113666853125306036270938578e+2 9 0.77334326684722638389603898808e+1
    10 -0.30674084731089398182061213626e+2 11 -0.93321305264302278729567221706e+1
    12 0.15697238121770843886131091075e+2 13 -0.31139403219565177677282850411e+2
    14 -0.93529243588444783865713862664e+1 15 0.35816841486394083752465898540e+2
20: 0 0.19985053242002433820987653617e+2 5 -0.38703730874935176555105901742e+3 6 -0.18917813819516756882830838328e+3
    7 0.52780815920542364900561016686e+3 8 -0.11573902539959630126141871134e+2 9 0.68812326946963000169666922661e+1
    10 -0.10006050966910838403183860980e+1 11 0.77771377980534432092869265740 12 -0.27782057523535084065932004339e+1
    13 -0.60196695231264120758267380846e+2 14 0.84320405506677161018159903784e+2 15 0.11992291136182789328035130030e+2
21: 0 -0.25693933462703749003312586129e+2 5 -0.15418974869023643374053993627e+3 6 -0.23152937917604549567536039109e+3
    7 0.35763911791061412378285349910e+3 8 0.93405324183624310003907691704e+2 9 -0.37458323136451633156875139351e+2
    10 0.10409964950896230045147246184e+3 11 0.29840293426660503123344363579e+2 12 -0.43533456590011143754432175058e+2
    13 0.96324553959188282948394950600e+2 14 -0.39177261675615439165231486172e+2
    15 -0.14972683625798562581422125276e+3
"""
_EMBEDDED = {
    0: 0.244094488188976377952755905512,
    8: 0.733846688281611857341361741547,
    11: 0.220588235294117647058823529412e-1,
}


def _weights() -> Array:
    """Rows of weights (22, 16) over the stages."""
    rows = np.zeros((DENSE + POWERS - 3, STAGES_IN_ALL))
    for text in _WEIGHTS.replace("\n    ", " ").split("\n")[1:-1]:
        row, _, entries = text.partition(":")
        column_and_weight = entries.split()
        rows[int(row), np.array(column_and_weight[::2], int)] = np.array(column_and_weight[1::2], float)
    rows[ERROR_3] = rows[NEW]
    for column, weight in _EMBEDDED.items():
        rows[ERROR_3, column] -= weight
    return rows


WEIGHTS = _weights()
SAFETY, LEAST_FACTOR, MOST_FACTOR = 0.9, 0.2, 10.0  # of the next step
FIRST, QUIET = 1e-6, 1e-5  # [s] a first step where the state or its rates are no larger than a part of the tolerance
LEAST_TIME = 1e-300  # [s], below which no two instants are told apart

# Answers of a step of a method, and of a run that goes on for some steps; all but GOING end both.
GOING, ENDED, PAUSED, UNSOLVED, UNHELD, FAILED, TOO_SHORT, BEYOND_FLOATS, SLIDES, RAISED, PULLED = range(11)

CONTROLLED = fields_of(
    table="size",  # addresses: of the plant, of the method (`TIMED`: the time not to pass, and the address of this)
    method="size",
    sampled="size",
    continuous="size",  # whether the law is evaluated at every stage
    least_searched="real",  # [s] shorter steps are not searched for short pulls
    rtol="real",
    atol="real",
    # The run: its time and that at the end of the step; the step to take next, the one of a new beginning (0: to be
    # found), the longest one, and until when that is short.
    t="real",
    end="real",
    h="real",
    first_step="real",
    longest_step="real",
    widest_step="real",  # to which it returns
    careful_until="real",
    started="state",
    begun="state",  # whether the method goes on from its own last step
    fresh="state",  # whether the plant is as `rates` left it at `end`
    dense="state",  # whether the dense output is known
    mark="state",  # the next of the marks
    next="state",  # row to be recorded
    steps="state",
    evaluations="state",
    switches="state",
    answer="state",  # of the last evaluation
    failed_at="real",  # [s]
    trouble="state",  # what an evaluation came to while an instant was searched
    marks=("f8", "mark_count"),  # [s] to step onto, and whether something jumps there (1), by a sample of the law (2)
    kinds=("i8", "mark_count"),
    times=("f8", "time_count"),  # [s] of the rows
    rows=("f8", "row_count", "row_size"),
    y=("f8", "size"),  # state at t, at the end of the step, and scratch: a state, two derivatives
    new=("f8", "size"),
    x=("f8", "size"),
    dy=("f8", "size"),
    error=("f8", "size"),
    stages=("f8", STAGES_IN_ALL, "size"),
    powers=("f8", POWERS, "size"),
    near=("i8", "string_count"),  # scratch of the search for pulls, and for strings that turn
    longest=("i8", "string_count"),
    gaps=("f8", "string_count"),
)
Controlled = changing_view("Controlled", CONTROLLED)


@borrowing
def evaluate(own: Any, t: float, y: Any, dy: Any) -> int:
    """dy/dt at a state: GOING, UNHELD or FAILED."""
    own.evaluations += 1
    own.fresh = 0
    own.answer = rates(t, y, dy, own.table)
    if own.answer == SINGULAR:
        return UNHELD
    if own.answer > NO_SOLUTION or PlantView(own.table).status != 0:
        own.failed_at = t
        return FAILED
    return GOING


@inlined
def spacing(t: float) -> float:
    """The distance [s] to the next float behind t >= 0, at least LEAST_TIME."""
    return max((t + 1.5 * 2.0**-53 * t) - t, LEAST_TIME)


@inlined
def _least(a: float, b: float) -> float:
    """a unless b is less: NaN stays where it comes first."""
    return b if b < a else a


@inlined
def _eighth_root(x: float) -> float:
    return np.sqrt(np.sqrt(np.sqrt(x)))


@borrowing
def _sum(row: int, count: int, stages: Any, out: Any) -> None:
    """out = the weighted sum of so many stages."""
    for i in range(len(out)):
        out[i] = 0.0
    for j in range(count):
        weight = WEIGHTS[row, j]
        if weight != 0.0:
            for i in range(len(out)):
                out[i] += weight * stages[j, i]


@borrowing
def _stage(own: Any, stage: int, h: float) -> int:
    """Evaluate a stage of a step h from y."""
    y, x = own.y, own.x
    _sum(stage, stage, own.stages, x)
    for i in range(len(x)):
        x[i] = y[i] + x[i] * h
    return evaluate(own, own.t + NODES[stage] * h, x, own.stages[stage])


@borrowing
def _begin(own: Any, bound: float) -> int:
    """Evaluate the first stage at a new beginning, and choose the step to try."""
    y, f, x, dy = own.y, own.stages[0], own.x, own.dy
    answer = evaluate(own, own.t, y, f)
    if answer:
        return answer
    left, size = bound - own.t, float(len(y))
    if own.first_step > 0.0:
        own.h = min(own.first_step, left, own.longest_step)
        own.begun = 1
        return GOING
    d0 = d1 = d2 = 0.0
    for i in range(len(y)):
        scale = own.atol + abs(y[i]) * own.rtol
        d0 += (y[i] / scale) ** 2
        d1 += (f[i] / scale) ** 2
    d0, d1 = np.sqrt(d0 / size), np.sqrt(d1 / size)
    h0 = _least(FIRST if d0 < QUIET or d1 < QUIET else 0.01 * d0 / d1, left)
    for i in range(len(y)):
        x[i] = y[i] + h0 * f[i]
    answer = evaluate(own, own.t + h0, x, dy)
    if answer:
        return answer
    for i in range(len(y)):
        d2 += ((dy[i] - f[i]) / (own.atol + abs(y[i]) * own.rtol)) ** 2
    d2 = np.sqrt(d2 / size) / h0
    still = d1 <= 1e-15 and d2 <= 1e-15
    h1 = max(1e-6, h0 * 1e-3) if still else _eighth_root(0.01 / (d2 if d2 > d1 else d1))
    own.h = _least(_least(_least(100.0 * h0, h1), left), own.longest_step)
    own.begun = 1
    return GOING


@borrowing
def _error(own: Any, h: float) -> float:
    """The error of a step in parts of the tolerance, from its errors of order 5 and 3."""
    y, new, error_5, error_3 = own.y, own.new, own.error, own.x
    _sum(ERROR_5, STAGES, own.stages, error_5)
    _sum(ERROR_3, STAGES, own.stages, error_3)
    five = three = 0.0
    for i in range(len(y)):
        scale = own.atol + max(abs(y[i]), abs(new[i])) * own.rtol
        five += (error_5[i] / scale) ** 2
        three += (error_3[i] / scale) ** 2
    if five == 0.0 and three == 0.0:
        return 0.0
    return h * five / np.sqrt((five + 0.01 * three) * len(y))


@borrowing
def _step(own: Any, bound: float) -> int:
    if not own.begun:
        answer = _begin(own, bound)
        if answer:
            return answer
    if not np.isfinite(own.h):  # such a step would be tried for ever
        return BEYOND_FLOATS
    y, new, x, stages, t = own.y, own.new, own.x, own.stages, own.t
    shortest, h, rejected = 10.0 * spacing(t), own.h, False
    h = own.longest_step if h > own.longest_step else max(h, shortest)
    while h >= shortest:
        end = min(t + h, bound)
        h = end - t
        for stage in range(1, STAGES):
            answer = _stage(own, stage, h)
            if answer:
                return answer
        _sum(NEW, STAGES, stages, x)
        for i in range(len(y)):
            new[i] = y[i] + h * x[i]
        answer = evaluate(own, end, new, stages[STAGES])
        if answer:
            return answer
        error = _error(own, h)
        factor = MOST_FACTOR if error == 0.0 else SAFETY / _eighth_root(error)
        if error < 1.0:
            own.h = h * min(MOST_FACTOR if not rejected else 1.0, factor)
            own.end, own.fresh, own.dense = end, 1, 0
            return GOING
        rejected = True
        h *= factor if factor > LEAST_FACTOR else LEAST_FACTOR
    return TOO_SHORT


@c_function(TIMED, "steps of DOP853")
def dop853_step(bound, own_at, unused, none):  # type: ignore[no-untyped-def]
    """Take a step from t to `end` <= bound that keeps the tolerance; shorter ones are tried until it does."""
    return _step(Controlled(own_at), bound)


@borrowing
def make_dense(own: Any) -> int:
    """Make the states within the step known, unless they are: three more evaluations."""
    if own.dense:
        return GOING
    y, new, stages, powers, h = own.y, own.new, own.stages, own.powers, own.end - own.t
    for stage in range(STAGES + 1, STAGES_IN_ALL):
        answer = _stage(own, stage, h)
        if answer:
            return answer
    for i in range(len(y)):
        change = new[i] - y[i]
        powers[0, i] = change
        powers[1, i] = h * stages[0, i] - change
        powers[2, i] = 2.0 * change - h * (stages[STAGES, i] + stages[0, i])
    for power in range(3, POWERS):
        _sum(DENSE + power - 3, STAGES_IN_ALL, stages, powers[power])
        for i in range(len(y)):
            powers[power, i] *= h
    own.dense = 1
    return GOING


@borrowing
def interpolate(own: Any, t: float, out: Any) -> int:
    """The state at a time within the step; the answer of `make_dense`."""
    answer = make_dense(own)
    if answer:
        return answer
    y, powers, part = own.y, own.powers, (t - own.t) / (own.end - own.t)
    for i in range(len(out)):
        value = 0.0
        for k in range(POWERS - 1, -1, -1):
            value = (value + powers[k, i]) * (part if k % 2 == 0 else 1.0 - part)
        out[i] = y[i] + value
    return GOING
