"""Frictionless indentation of an elastic half-space: forces, and the displacement everywhere inside.

The half-space is z <= 0. A flat round punch of radius a at depth d presses with F/(2 pi a sqrt(a^2 - r^2)), F = 2 E a d/(1 -
nu^2) (Boussinesq 1885; Johnson, Contact Mechanics, 1985, section 3.4). With the potentials V = int p/rho and chi =
int p ln(rho + h) of that pressure, h = -z the depth of a point and G = E/(2 (1 + nu)),

    u_r = -[(1 - 2 nu) dchi/dr + h dV/dr] / (4 pi G),   -u_z = [2 (1 - nu) V - h dV/dh] / (4 pi G),

and as the pressure is that of point forces spread evenly over the imaginary depths h + i t, |t| < a, with R = sqrt(r^2 + (h + i a)^2)

    V = F/a Im ln(R + h + i a),   dchi/dr = F/(a r) (a - Im R).

A ball is the sum of such punches (Hertz, as a paraboloid): while its contact grows from radius s to s + ds it goes down
by 2 s ds/R, all of it as a punch of radius s.
"""

import numpy as np


def punch_force(young, poisson, radius, depth):
    """F = 2 E a d / (1 - nu^2) [N]."""
    return 2 * young * radius * depth / (1 - poisson**2)


def bonded_force(young, poisson, radius, depth):
    """Of a flat punch that nothing slips on: F = 4 G a d ln(3 - 4 nu)/(1 - 2 nu) [N] (Mossakovskii 1954; Spence 1968)."""
    shear = young / (2 * (1 + poisson))
    return 4 * shear * radius * depth * np.log(3 - 4 * poisson) / (1 - 2 * poisson)


def ball_force(young, poisson, radius, depth):
    """F = 4/3 E/(1 - nu^2) sqrt(R) d^1.5 [N], the contact's radius being sqrt(R d)."""
    return 4 / 3 * young / (1 - poisson**2) * np.sqrt(radius) * depth**1.5


def below_punch(points, poisson, radius, depth):
    """Displacement [m], n x 3, of points of the half-space."""
    r, h = np.hypot(points[:, 0], points[:, 1]), np.maximum(-points[:, 2], 0)
    far = h + 1j * radius
    root = np.sqrt(r**2 + far**2 + 0j)
    share = depth / (np.pi * (1 - poisson))
    apart = np.maximum(r, 1e-12 * radius)
    slide = (1 - 2 * poisson) * (radius - root.imag) / apart + h * (r / (root * (root + far))).imag
    sink = 2 * (1 - poisson) * np.log(root + far).imag - h * (1 / root).imag
    way = points[:, :2] / apart[:, None]
    return share * np.column_stack([-slide[:, None] * way, -sink])


def below_ball(points, poisson, radius, depth, parts=24):
    """Displacement [m], n x 3; points well away from the contact, over which the sum is taken by Gauss's rule."""
    contact = np.sqrt(radius * depth)
    place, weight = np.polynomial.legendre.leggauss(parts)
    s, ds = contact * (place + 1) / 2, contact * weight / 2
    return sum(below_punch(points, poisson, a, 2 * a * w / radius) for a, w in zip(s, ds))
