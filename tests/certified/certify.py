"""Certified fits: data files, and their least-squares solutions to at least 11 digits.

    python tests/certified/certify.py            # all cases; writes certified.json
    python tests/certified/certify.py CASE ...   # some of them
    python tests/certified/certify.py --data     # write the data files first

Shares no code with curlfit. README.md beside this file tells how and how well.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.integrate import DOP853
from scipy.special import ellipe, ellipkm1

HERE = Path(__file__).parent
EQ12 = HERE.parent.parent / "data" / "jensen_shegelski_2004.csv"
START = ("x0", "y0", "heading", "v0", "phi0", "omega0")
CHANNELS = ("x", "y", "phi")
TINY = 1e-60  # imaginary part of a complex step
V, BETA, OMEGA, X, Y, PHI = range(6)


GRAVITY = np.longdouble("9.81")  # m/s^2
PI = np.longdouble("3.14159265358979323846264338327950288")


def gauss(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre rule on (-1, 1) in extended precision, by Newton's method."""
    k = np.arange(1, n + 1, dtype=np.longdouble)
    x = np.cos(PI * (k - 0.25) / (n + 0.5))
    for _ in range(6):
        below = np.ones_like(x)
        value = x
        for m in range(2, n + 1):
            below, value = value, ((2 * m - 1) * x * value - (m - 1) * below) / m
        slope = n * (x * value - below) / (x**2 - 1)
        x = x - value / slope
    return x, 2 / ((1 - x**2) * slope**2)


PANEL = gauss(24)
CUBIC = gauss(300)


def panels(swing: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights for b in (0, pi/2), b = swing sinh(tau), in panels of tau.

    Sliding turns round within b ~ swing; in tau that is as wide for every swing, and
    the nearest singularity lies pi/2 off the axis.
    """
    width = np.longdouble(max(swing, 1e-17))
    reach = np.arcsinh(PI / 2 / width)
    count = int(np.ceil(reach / 2.5))
    half = reach / (2 * count)
    s, w = PANEL
    tau = ((2 * np.arange(count)[:, None] + 1 + s) * half).ravel()
    return width * np.sinh(tau), np.tile(w, count) * half * width * np.cosh(tau)


def cubic(_: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights for b in (0, pi/2), b = pi/2 s^3."""
    s = (CUBIC[0] + 1) / 2
    w = CUBIC[1] / 2
    return PI / 2 * s**3, w * 3 * PI / 2 * s**2


Ring = Callable[[float], tuple[np.ndarray, np.ndarray]]


# Traction per unit load on one half of the ring, from unit vector and
# magnitude of sliding.


def front_back(c: np.ndarray, front: bool, e: tuple, _: np.ndarray) -> tuple:
    return -c[0 if front else 1] * e[0], -c[2 if front else 3] * e[1]


def coulomb(c: np.ndarray, front: bool, e: tuple, _: np.ndarray) -> tuple:
    return -c[0] * e[0], -c[0] * e[1]


def power(c: np.ndarray, front: bool, e: tuple, speed: np.ndarray) -> tuple:
    mu = c[0] * np.exp(c[1] / 2 * np.log(speed**2 + 1e-3**2))  # finite below 1 mm/s
    return -mu * e[0], -mu * e[1]


def force(
    traction: Callable,
    c: np.ndarray,
    v: np.ndarray,
    u: np.ndarray,
    lift: np.ndarray | None,
    ring: Ring,
) -> np.ndarray:
    """Force over m g to the right and forward, and moment over m g R, by lanes.

    `b` is half the angle from the slowest point of the ring; `lift` is 2 h/R under the
    consistent load 1 + p xi + q eta, (p, q) = -lift T (eq. 8-9 on a thin ring), None
    under the uniform one.
    """
    side = 1 if u[0].real >= 0 else -1
    au = side * u
    slow = v - au
    fast = v + au
    b, w = ring(float(abs(slow[0].real) / fast[0].real))
    b, w = b.astype(v.real.dtype)[:, None], (w / PI).astype(v.real.dtype)
    sin2 = np.sin(b) ** 2
    cos2 = np.cos(b) ** 2
    speed = np.sqrt(slow**2 * cos2 + fast**2 * sin2)
    xi = side * (sin2 - cos2)
    eta = np.sin(2 * b)
    e = -u * eta / speed, (slow * cos2 + fast * sin2) / speed
    c = c[:, None]

    def net(load: Callable) -> np.ndarray:
        total = np.zeros((3, *v.shape), v.dtype)
        for front in (True, False):
            ahead = 1 if front else -1
            t_xi, t_eta = traction(c, front, (ahead * e[0], e[1]), speed)
            n = load(xi, ahead * eta)
            total += [
                w @ (n * t) for t in (t_xi, t_eta, xi * t_eta - ahead * eta * t_xi)
            ]
        return total

    even = net(lambda xi, eta: 1)
    if lift is None:
        return even
    by_p = net(lambda xi, eta: xi)
    by_q = net(lambda xi, eta: eta)
    # (1 + lift by_p) p + lift by_q q = -lift even, and so on
    a = 1 + lift * by_p[0]
    b_ = lift * by_q[0]
    c_ = lift * by_p[1]
    d = 1 + lift * by_q[1]
    f = -lift * even[0]
    g = -lift * even[1]
    p = (d * f - b_ * g) / (a * d - b_ * c_)
    q = (a * g - c_ * f) / (a * d - b_ * c_)
    return even + p * by_p + q * by_q


@dataclass(frozen=True)
class Case:
    """A fit. Coefficients and start are those the data were made of, and where
    the fit begins.

    `sums` are pairs of coefficients of which only the sum matters; the first is what
    is fitted, with the second zero. `until`, `every`: time of the last row, and
    between rows, s.
    """

    law: str
    coefficients: dict[str, float]
    start: tuple[float, ...]
    until: float
    every: float
    sigma: dict[str, float]
    load: str = "uniform"
    stone: dict[str, float] = field(
        default_factory=lambda: {"R": 0.065, "rho": 0.1, "h": 0.057}
    )
    fix: tuple[str, ...] = ()
    sums: tuple[tuple[str, str], ...] = ()
    seed: int = 0
    file: Path | None = None

    @property
    def names(self) -> list[str]:
        return [*self.coefficients, *START]

    @property
    def values(self) -> list[float]:
        """Where the fit begins."""
        values = dict(
            zip(self.names, [*self.coefficients.values(), *self.start], strict=True)
        )
        for first, second in self.sums:
            values[first], values[second] = values[first] + values[second], 0.0
        return list(values.values())

    @property
    def free(self) -> list[int]:
        held = {*self.fix, *(second for _, second in self.sums)}
        return [index for index, name in enumerate(self.names) if name not in held]

    def label(self, place: int) -> str:
        """Name of a fitted quantity."""
        pairs = {first: f"{first} + {second}" for first, second in self.sums}
        return pairs.get(self.names[place], self.names[place])


TRACTIONS = {"front-back": front_back, "coulomb": coulomb, "power": power}


def rates(case: Case, p: np.ndarray, y: np.ndarray, ring: Ring) -> np.ndarray:
    """Time derivative of the states, shape (6, lanes), for parameters of
    shape (k, lanes)."""
    v, beta, omega = y[:3]
    if case.law == "semi-empirical":
        a, c, p_, q, r = p[:5]
        sense = 1 if omega[0].real > 0 else -1
        log = np.log(v)
        a_xi = -a * sense
        a_eta = -c * np.exp(p_ * log)
        angular = -q * np.exp(r * log) * sense
    else:
        R, rho, h = (np.longdouble(str(case.stone[name])) for name in ("R", "rho", "h"))
        R, rho, h = (value.astype(v.real.dtype) for value in (R, rho, h))
        g = GRAVITY.astype(v.real.dtype)
        lift = 2 * h / R if case.load == "consistent" else None
        t = force(TRACTIONS[case.law], p[:-6], v, R * omega, lift, ring)
        a_xi = g * t[0]
        a_eta = g * t[1]
        angular = g * R * t[2] / rho**2
    return np.stack(
        [a_eta, a_xi / v, angular, v * np.sin(beta), v * np.cos(beta), omega]
    )


def begin(p: np.ndarray) -> np.ndarray:
    x0, y0, heading, v0, phi0, omega0 = p[-6:]
    return np.stack([v0, heading, omega0, x0, y0, phi0])


def time_to_rest(case: Case, y: np.ndarray, f: np.ndarray) -> np.ndarray:
    """From the loss of energy at the present rate, s, by lanes."""
    inertia = 0.0 if case.law == "semi-empirical" else case.stone["rho"] ** 2
    v = y[V]
    omega = y[OMEGA]
    return -(v**2 + inertia * omega**2) / (v * f[V] + inertia * omega * f[OMEGA])


# Two integrations of the same equations, which share neither method, nor precision, nor
# places of the ring. Both step to each row, so nothing is interpolated.


def by_extrapolation(
    case: Case, p: np.ndarray, times: np.ndarray, **precision: float
) -> np.ndarray:
    """x, y, phi at the times, shape (3, n, lanes), see `extrapolated`."""
    return extrapolated(case, p, times, **precision)[0]


def extrapolated(
    case: Case,
    p: np.ndarray,
    times: np.ndarray,
    *,
    columns: int = 8,
    least: float = 1e-15,
    share: float = 0.3,
) -> tuple[np.ndarray, np.ndarray]:
    """x, y, phi at the times, shape (3, n, lanes), and the time of rest, or zero where
    that is later, by the extrapolated midpoint rule (Gragg 1965, Bulirsch and
    Stoer 1966) of order 2 `columns` in extended precision.

    Steps are a `share` of the time to rest and of that to |epsilon| = 1, where
    friction has a logarithmic kink; what is shorter than `least` (s) is stepped over,
    or is the rest.
    """
    R = np.longdouble(str(case.stone["R"]))
    rungs = 2 * np.arange(1, columns + 1)

    def f(y: np.ndarray) -> np.ndarray:
        return rates(case, p, y, panels)

    def step(y: np.ndarray, first: np.ndarray, length: np.longdouble) -> np.ndarray:
        table: list[np.ndarray] = []
        for row, n in enumerate(rungs):
            h = length / n
            before = y
            now = y + h * first
            for _ in range(n - 1):
                before, now = now, before + 2 * h * f(now)
            new = [(now + before + h * f(now)) / 2]
            for back in range(1, row + 1):
                ratio = (np.longdouble(n) / rungs[row - back]) ** 2
                new.append(new[-1] + (new[-1] - table[back - 1]) / (ratio - 1))
            table = new
        return table[-1]

    y = begin(p)
    t = np.longdouble(0)
    path = []
    rest = np.zeros_like(p[0])
    resting = False
    for time in times:
        while t < time and not resting:
            slope = f(y)
            left = time_to_rest(case, y, slope)
            to_rest = left[0].real
            if to_rest < least:
                resting = True
                rest = t + left
                break
            length = min(time - t, share * to_rest)
            if case.law != "semi-empirical":
                side = 1 if y[OMEGA, 0].real >= 0 else -1
                gap = y[V, 0].real - side * R * y[OMEGA, 0].real
                change = slope[V, 0].real - side * R * slope[OMEGA, 0].real
                away = abs(gap / change)
                length = min(length, share * away if away > least else 4 * least)
            y = step(y, slope, length)
            t += length
            if time - t < 1e-17:
                t = time
        path.append(y[[X, Y, PHI]])
    return np.stack(path, 1), rest


def by_runge_kutta(case: Case, p: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The same by scipy's DOP853 in double precision, on a ring crowded by
    a cubic map."""
    lanes = p.shape[1]
    p = p.astype(complex)

    def f(_: float, flat: np.ndarray) -> np.ndarray:
        return rates(case, p, flat.reshape(6, lanes), cubic).ravel()

    y = begin(p)
    t = 0.0
    path = []
    first = 0.05
    resting = False
    for time in times.astype(float):
        if time > t and not resting:
            run = DOP853(
                f,
                t,
                y.ravel(),
                time,
                rtol=1e-13,
                atol=1e-15,
                first_step=min(first, time - t),
            )
            while run.status == "running":
                run.step()
                y = run.y.reshape(6, lanes)
                slope = run.f.reshape(6, lanes)
                to_rest = time_to_rest(case, y, slope)
                if to_rest[0].real < 1e-6:  # the rest at an even loss of speed and spin
                    y[[X, Y, PHI]] += to_rest / 2 * slope[[X, Y, PHI]]
                    resting = True
                    break
                first = run.h_abs
            t = time
        path.append(y[[X, Y, PHI]])
    return np.stack(path, 1)


Method = Callable[[Case, np.ndarray, np.ndarray], np.ndarray]


def solve(
    case: Case, data: np.ndarray, values: np.ndarray, method: Method, precise: type
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parameters at the optimum, residuals (3, n), and their Jacobian (3, n,
    free), unweighted.

    Gauss and Newton's method with the Jacobian by complex steps, which have
    no rounding.
    """
    free = case.free
    times = data[0]
    observed = data[1:]
    sigma = np.array([case.sigma[name] for name in CHANNELS])[:, None]
    lanes = 1 + len(free)
    values = values.astype(precise(0).real.dtype)
    smallest = np.inf
    for _ in range(40):
        p = np.tile(values[:, None], lanes).astype(precise)
        p[free, np.arange(1, lanes)] += precise(1j * TINY)
        path = method(case, p, times)
        residual = path[..., 0].real - observed
        jacobian = path[..., 1:].imag / TINY
        r = (residual / sigma).ravel()
        j = (jacobian / sigma[..., None]).reshape(r.size, -1)
        scale = np.sqrt((j**2).sum(0))
        # The step need not be exact: it goes to zero. The slope is in full precision.
        triangle = np.linalg.qr((j / scale).astype(float), mode="r")
        along = np.linalg.solve(triangle.T, ((j / scale).T @ r).astype(float))
        step = np.linalg.solve(triangle, along)
        size = np.linalg.norm(along)  # standard errors
        if size > 0.5 * smallest and size < 1e-7:
            return values, residual, jacobian
        smallest = min(size, smallest)
        values[free] -= step / scale
    raise ArithmeticError(f"no convergence: {smallest}")


def errors(case: Case, jacobian: np.ndarray) -> np.ndarray:
    """Standard errors: square roots of the diagonal of (J^T J)^-1, by Gram and
    Schmidt's method in extended precision, done twice."""
    sigma = np.array([case.sigma[name] for name in CHANNELS])[:, None, None]
    q = (jacobian / sigma).reshape(-1, jacobian.shape[-1])
    size = q.shape[1]
    inverse = np.eye(size, dtype=np.longdouble)  # of the triangle so far
    for k in range(size):
        for _ in range(2):
            for i in range(k):
                part = q[:, i] @ q[:, k]
                q[:, k] -= part * q[:, i]
                inverse[:, k] -= part * inverse[:, i]
        norm = np.sqrt(q[:, k] @ q[:, k])
        q[:, k] /= norm
        inverse[:, k] /= norm
    return np.sqrt((inverse**2).sum(1))


def certify(name: str, case: Case) -> dict:
    data = read(case.file or HERE / f"{name}.csv")
    data = data[:, data[0] <= case.until]
    begun = np.array(case.values)
    other, _, _ = solve(case, data, begun, by_runge_kutta, np.complex128)

    def coarser(case: Case, p: np.ndarray, times: np.ndarray) -> np.ndarray:
        return by_extrapolation(case, p, times, columns=6, least=1e-13, share=0.2)

    coarse, _, _ = solve(case, data, other, coarser, np.clongdouble)
    values, residual, jacobian = solve(
        case, data, coarse, by_extrapolation, np.clongdouble
    )
    stderr = errors(case, jacobian)
    squares = (residual**2).sum(1)
    free = case.free

    def digits(found: np.ndarray) -> float:
        gap = np.abs((found[free].astype(np.longdouble) - values[free]) / values[free])
        return round(float(-np.log10(max(gap.max(), 1e-19))), 1)

    def shown(value: np.floating | float) -> float:
        return float(np.format_float_scientific(value, 14))

    fixed = {coefficient: case.coefficients[coefficient] for coefficient in case.fix}
    return {
        "file": "../../data/" + case.file.name if case.file else f"{name}.csv",
        "law": case.law,
        "load": case.load,
        "stone": case.stone,
        "sigma": case.sigma,
        "fix": fixed,
        "rows": data.shape[1],
        "values": {case.label(k): shown(values[k]) for k in free},
        "stderr": {case.label(k): shown(s) for k, s in zip(free, stderr, strict=True)},
        "sum_of_squares": {c: shown(s) for c, s in zip(CHANNELS, squares, strict=True)},
        "rms": {
            c: shown(np.sqrt(s / data.shape[1]))
            for c, s in zip(CHANNELS, squares, strict=True)
        },
        "digits": {"coarser": digits(coarse), "runge_kutta": digits(other)},
    }


def read(file: Path) -> np.ndarray:
    """t, x, y, phi from the first row on, shape (4, n), each the number nearest
    to the print."""
    rows = [
        line.split(",")
        for line in file.read_text().splitlines()
        if not line.startswith("#")
    ]
    table = np.array([[np.longdouble(cell) for cell in row[:4]] for row in rows[1:]]).T
    table[0] -= table[0, 0]
    return table


def write(name: str, case: Case) -> None:
    """Make a data file: the path of known coefficients, with noise, to
    1e-6 m and rad."""
    count = round(case.until / case.every) + 1
    times = np.round(np.arange(count) * case.every, 6)
    p = np.array([*case.coefficients.values(), *case.start]).astype(np.clongdouble)[
        :, None
    ]
    path = by_extrapolation(case, p, times.astype(np.longdouble), columns=5)[
        ..., 0
    ].real
    random = np.random.default_rng(case.seed)
    noise = np.array([case.sigma[c] for c in CHANNELS])[:, None]
    path = path.astype(float) + noise * random.standard_normal(path.shape)
    lines = [
        f"# {name}: {case.law} law, {case.load} load, "
        "made by certify.py; see README.md",
        # more than stones turn
        *(["# as_given = true"] if abs(case.start[-1]) > 20 else []),
        f'# load = "{case.load}"',
        *(f"# stone.{key} = {value}" for key, value in case.stone.items()),
        *(f"# sigma.{key} = {value}" for key, value in case.sigma.items()),
        "t,x,y,phi",
        *(
            f"{t:.6g},{x:.6f},{y:.6f},{phi:.6f}"
            for t, x, y, phi in zip(times, *path, strict=True)
        ),
    ]
    (HERE / f"{name}.csv").write_text("\n".join(lines) + "\n")


def check_forces() -> float:
    """Greatest error of the ring sums of Coulomb's law against complete
    elliptic integrals."""
    worst = 0.0
    for e in (0.03, 0.5, 0.98, 0.999999, 1.000001, 1.3, 40.0):
        K = ellipkm1(((1 - e) / (1 + e)) ** 2)
        E = ellipe(4 * e / (1 + e) ** 2)
        forward = -((1 - e) * K + (1 + e) * E) / np.pi
        turning = -((1 + e) * E - (1 - e) * K) / (np.pi * e)
        unit = np.ones(1, np.clongdouble)
        t = force(coulomb, unit[None], unit, unit * e, None, panels)[:, 0].real
        worst = max(worst, abs(float(t[1]) - forward), abs(float(t[2]) - turning))
    return worst


ETA = (("mu1_eta", "mu2_eta"),)
FRONT_BACK = {"mu1_xi": 0.005, "mu2_xi": 0.05, "mu1_eta": 0.009, "mu2_eta": 0.008}
CAMERA = {"x": 0.002, "y": 0.002, "phi": 0.004}
PLACE = (0.3, 1.2, 0.1)  # x0, y0, heading

CASES = {
    "front_back": Case(
        "front-back",
        FRONT_BACK,
        (*PLACE, 2.1, 0.5, 1.2),
        20,
        0.2,
        CAMERA,
        sums=ETA,
        seed=1,
    ),
    "front_back_rest": Case(
        "front-back",
        FRONT_BACK,
        (*PLACE, 2.1, 0.5, -1.5),
        40,
        0.4,
        CAMERA,
        sums=ETA,
        seed=2,
    ),
    "front_back_low_spin": Case(
        "front-back",
        FRONT_BACK,
        (*PLACE, 2.0, 0.5, 0.06),
        20,
        0.2,
        CAMERA,
        sums=ETA,
        seed=3,
    ),
    "front_back_high_spin": Case(
        "front-back",
        FRONT_BACK,
        (*PLACE, 1.2, 0.5, 30.0),
        20,
        0.2,
        CAMERA,
        sums=ETA,
        seed=4,
    ),
    "front_back_clip": Case(
        "front-back",
        FRONT_BACK,
        (*PLACE, 1.1, 0.5, 3.0),
        2,
        0.02,
        {"x": 0.0002, "y": 0.0002, "phi": 0.0004},
        sums=ETA,
        seed=5,
    ),
    "front_back_consistent": Case(
        "front-back",
        FRONT_BACK,
        (*PLACE, 2.1, 0.5, 1.2),
        20,
        0.2,
        CAMERA,
        load="consistent",
        fix=("mu1_eta",),
        seed=6,
    ),
    "front_back_consistent_split": Case(
        "front-back",
        FRONT_BACK,
        (*PLACE, 1.5, 0.5, 25.0),
        18,
        0.18,
        {"x": 0.00005, "y": 0.00005, "phi": 0.0001},
        load="consistent",
        stone={"R": 0.065, "rho": 0.1, "h": 0.114},
        seed=7,
    ),
    "coulomb": Case(
        "coulomb", {"mu": 0.0113}, (*PLACE, 1.9, 0.5, 1.6), 24, 0.24, CAMERA, seed=8
    ),
    "power": Case(
        "power",
        {"c": 0.008, "k": -0.5},
        (*PLACE, 2.0, 0.5, 1.4),
        18,
        0.18,
        CAMERA,
        seed=9,
    ),
    "semi_empirical": Case(
        "semi-empirical",
        {"a": 0.005, "c": 0.085, "p": -0.2, "q": 0.025, "r": -0.3},
        (*PLACE, 2.0, 0.5, 1.3),
        18,
        0.18,
        CAMERA,
        seed=10,
    ),
    "eq12": Case(
        "front-back",
        {"mu1_xi": 0.000415, "mu2_xi": 0.055542, "mu1_eta": 0.0173, "mu2_eta": 0.0},
        (0.0, 0.0, 0.0, 2.06, 0.0, 1.005),
        20,
        0.1,
        {"x": 0.01, "y": 0.01, "phi": 0.01},
        stone={"R": 0.054, "rho": 0.1, "h": 0.057},
        sums=ETA,
        file=EQ12,
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "case", nargs="*", help=f"of {', '.join(CASES)}; all, if none is named"
    )
    parser.add_argument(
        "--data", action="store_true", help="write the data files first"
    )
    asked = parser.parse_args()
    unknown = set(asked.case) - set(CASES)
    if unknown:
        parser.error(
            f"unknown case {', '.join(sorted(unknown))}; expected {', '.join(CASES)}"
        )
    target = HERE / "certified.json"
    certified = json.loads(target.read_text())["cases"] if target.exists() else {}
    gap = check_forces()
    print(f"ring sums against elliptic integrals: {gap:.1g}")
    for name in asked.case or CASES:
        case = CASES[name]
        if asked.data and not case.file:
            write(name, case)
        certified[name] = certify(name, case)
        print(name, json.dumps(certified[name]["digits"]), flush=True)
        ordered = {key: certified[key] for key in CASES if key in certified}
        target.write_text(
            json.dumps({"force_error": gap, "cases": ordered}, indent=1) + "\n"
        )


if __name__ == "__main__":
    main()
