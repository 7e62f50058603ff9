"""The friction laws in plain numpy, from their formulas, beside those of curlfit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from independent_motion import EXACT, G, Reference, front_back, integrated


def against(mu):
    """Friction against sliding, its coefficient a function of the ring and the load."""

    def traction(ring, load):
        over = mu(ring, load) / ring.speed
        return -over * ring.v_xi, -over * ring.v_eta

    return traction


def debris(mu_clean, mu_dirty, tau=0.0):
    def mu(ring, _):
        # Turned back to where the front half was at release, then round with the stone.
        angle = ring.alpha if ring.turned >= 0 else np.pi - ring.alpha
        fouled = np.mod(angle, 2 * np.pi) < np.pi + abs(ring.turned)
        share = 1 - np.exp(-ring.time / tau) if tau > 0 else 1.0
        return np.where(fouled, mu_clean + share * (mu_dirty - mu_clean), mu_clean)

    return against(mu)


def radial(mu1, mu2, mu3, mu4):
    def traction(ring, _):
        # v = a n + b tau, n = (cos, sin), tau = (-sin, cos)
        c = ring.xi
        s = ring.eta
        a = np.where(s > 0, mu1, mu2) * (ring.v_xi * c + ring.v_eta * s)
        b = np.where(s > 0, mu3, mu4) * (ring.v_eta * c - ring.v_xi * s)
        return -(a * c - b * s) / ring.speed, -(a * s + b * c) / ring.speed

    return traction


def tensor(b11, b22, b12):
    def traction(ring, _):
        b = np.array([[b11, b12], [b12, b22]])
        return -b @ np.stack([ring.v_xi, ring.v_eta]) / ring.speed

    return traction


def motion(ring):
    """Speed of the centre, and R omega, of a ring in motion."""
    u = -ring.v_xi[0] / ring.eta[0]
    return ring.v_eta[0] - u * ring.xi[0], u


def sutor(f_min, r, v_b, alpha, u0):
    v_a = v_b * (r - np.sqrt(r**2 - 1))

    def mu(ring, _):
        s = ring.speed + v_a
        _, u = motion(ring)
        lean = 1 - np.exp(-alpha * np.sin(ring.alpha))
        asymmetry = lean * np.exp(1 - abs(u) / u0)
        return f_min / (2 * v_b) * (s + v_b**2 / s) * (1 - asymmetry)

    return against(mu)


def pushed(law, push, torque=0.0):
    """A law with a force over the weight, a function of v and u, and with a torque R
    times it."""

    def traction(ring, load):
        right, forward = law(ring, load)
        force = push(*motion(ring))
        # spread over the ring otherwise than in the program: round it, of mean 1
        along = torque * force
        return right + force - along * ring.eta, forward + along * ring.xi

    return traction


def slow_side(u, exponent=0.0, slowest=1e-3):
    return -u * (u**2 + slowest**2) ** ((exponent - 1) / 2)


def falling(ring, c, k):
    """The coefficient of friction of `power`."""
    return c * (ring.speed**2 + 1e-6) ** (k / 2)


def power(c, k):
    return against(lambda ring, load: falling(ring, c, k))


def power_angular(c, k, f0):
    def mu(ring, _):
        return falling(ring, c, k) * (1 - f0 * np.sin(ring.alpha))

    return against(mu)


def sideways(law, a, n):
    def push(v, u):
        return a / G * v * np.hypot(v, 1e-2) ** (n - 1) * slow_side(u)

    return pushed(law, push)


def transverse(law, b):
    def push(v, u):
        speed = np.hypot(v, 1e-2)
        return -2 * b / G * np.arctan(u / speed) * v / speed

    return pushed(law, push)


def deflection(law, a, m):
    def push(v, u):
        return a / G * v / np.hypot(v, 1e-2) * slow_side(u / 0.065, m, 1e-3 / 0.065)

    return pushed(law, push)


def pivot(law, q):
    return pushed(law, lambda v, u: q * slow_side(u, -0.5, 1e-2), torque=1.0)


def angular(mu0, f0):
    return against(lambda ring, load: mu0 * (1 - f0 * np.sin(ring.alpha)))


def stribeck(mu0, mu1):
    return against(lambda ring, load: mu0 + mu1 * ring.speed / load)


FORMULAS = {
    "coulomb": lambda mu: against(lambda ring, load: mu),
    "power": power,
    "power-angular": power_angular,
    "sutor": sutor,
    "power+sideways": lambda c, k, a, n: sideways(power(c, k), a, n),
    "power+transverse": lambda c, k, b: transverse(power(c, k), b),
    "power+deflection": lambda c, k, a, m: deflection(power(c, k), a, m),
    "power+pivot": lambda c, k, q: pivot(power(c, k), q),
    "front-back+sideways": lambda *c: sideways(front_back(*c[:4]), *c[4:]),
    "pressure": lambda mu0, k: against(lambda ring, load: mu0 / load**k),
    "angular": angular,
    "stribeck": stribeck,
    "debris": debris,
    "radial": radial,
    "tensor": tensor,
    "front-back": front_back,
}
"""Of laws at the points of the ring: the traction, from the coefficients."""


def semi_empirical(stone, a, c, p, q, r):
    def accelerations(sense, v, *_):
        return -a * sense, -c * abs(v) ** p, -q * abs(v) ** r * sense

    return accelerations


def denny(stone, mu, b, e):
    braking = mu * G

    def accelerations(sense, v, omega, _, time):
        turning = b * braking * time / (2 * e * stone.R)
        return -sense * turning * v, -braking, -omega * braking / (e * abs(v))

    return accelerations


def digital_curling(stone, f, d, c, w, n, q):
    def accelerations(sense, v, *_):
        speed = abs(v)
        right = -sense * w * speed ** (1 + n)
        forward = -G * (f + d / (speed + c))
        return right, forward, -sense * q / np.hypot(speed, 1e-3)

    return accelerations


def front_back_first_order(stone, mu1_xi, mu2_xi, mu1_eta, mu2_eta):
    def accelerations(_, v, omega, *__):
        epsilon = stone.R * omega / abs(v)
        right = epsilon * G * (mu1_xi - mu2_xi) / np.pi
        forward = -G * (mu1_eta + mu2_eta) / 2
        angular = -epsilon * G * stone.R * (mu1_xi + mu2_xi) / (4 * stone.rho**2)
        return right, forward, angular

    return accelerations


FORMULAS_OF_THE_WHOLE = {
    "semi-empirical": semi_empirical,
    "denny-1998": denny,
    "fcv1": digital_curling,
    "front-back-first-order": front_back_first_order,
}
"""Of laws for the whole stone, from its constants and the coefficients: accelerations
(right, forward, angular) from the sense of the spin, speed, spin, angle turned and
time."""


def edges_of_debris(turned):
    """Polar angle of the edge of the fouled part, until half a turn is done."""
    if abs(turned) >= np.pi:
        return ()
    return (turned - np.pi if turned >= 0 else turned,)


def reference(name, values, load, stone, nodes=200, accuracy=EXACT):
    """A law at the points of the ring."""
    traction = FORMULAS[name](*values)
    h = stone.h if load == "consistent" else None
    ring = Reference(traction, stone.R, stone.rho, h, nodes=nodes, accuracy=accuracy)
    if name == "debris":
        return replace(ring, edges=edges_of_debris, corner=np.pi)
    return ring


def motion_of_the_whole(name, values, stone, start, until, accuracy=EXACT):
    """The motion under a law for the whole stone: while it spins in the sense of the
    start, and without spin."""
    accelerations = FORMULAS_OF_THE_WHOLE[name](stone, *values)
    sense = float(np.sign(start.omega))

    def spinning(*state):
        return accelerations(sense, *state)

    def sliding(*state):
        return accelerations(0.0, *state)

    phases = [(spinning, lambda omega, _: omega * sense), (sliding, None)]
    return integrated(start, until, phases, None, accuracy)
