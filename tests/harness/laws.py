"""Hyperelastic laws at a point: energy density psi(F) [Pa], P = dpsi/dF, and dP/dF.

F has shape (..., 3, 3), dP/dF is indexed [..., i, J, k, L]; parameters have the leading shape of F
or broadcast to it. Everything also takes complex F. E = (F^T F - I) / 2, I_C = |F|^2, J = det F.
"""

from typing import Callable, NamedTuple

import numpy as np

I3 = np.eye(3)
LEVI_CIVITA = np.array([[np.cross(I3[j], I3[k]) for k in range(3)] for j in range(3)])
TWICE = np.multiply.outer(LEVI_CIVITA, LEVI_CIVITA)


class Law(NamedTuple):
    """psi, P and dP/dF, each of (F, lam, mu)."""

    energy: Callable
    stress: Callable
    tangent: Callable


def lame(young, poisson):
    """Lame's lam and mu [Pa]."""
    young, poisson = np.asarray(young, float), np.asarray(poisson, float)
    return young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))


def kappa(lam, mu, along_lam, along_mu):
    """Stiffness of the fibre term [Pa] from Lame's constants along the fibre."""
    return (along_lam - lam) / 2 + along_mu - mu


def outer(a, b):
    """a_iJ b_kL."""
    return a[..., :, :, None, None] * b[..., None, None, :, :]


def blocks(a, b):
    """a_ik b_JL."""
    return a[..., :, None, :, None] * b[..., None, :, None, :]


def over(value, rank):
    """A number a point, ready to multiply a tensor of this rank."""
    value = np.asarray(value)
    return value.reshape(value.shape + (1,) * rank)


def transposed(a):
    return np.swapaxes(a, -1, -2)


def square(a):
    """Sum of the squares of the entries, without conjugation."""
    return np.einsum("...ij,...ij->...", a, a)


def trace(a):
    return np.einsum("...ii->...", a)


def cofactor(F):
    """dJ/dF."""
    a, b, c = F[..., 0, :], F[..., 1, :], F[..., 2, :]
    return np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], -2)


def determinant(F):
    return np.einsum("...i,...i->...", F[..., 0, :], cofactor(F)[..., 0, :])


def cofactor_rate(F):
    """d cof_iJ / dF_kL = e_ikm e_JLN F_mN."""
    return np.einsum("ikmJLN,...mN->...iJkL", TWICE, F, optimize=True)


def linear_energy(F, lam, mu):
    """lam/2 tr(e)^2 + mu e:e, e = sym(F - I)."""
    e = (F + transposed(F)) / 2 - I3
    return lam / 2 * trace(e) ** 2 + mu * square(e)


def linear_stress(F, lam, mu):
    e = (F + transposed(F)) / 2 - I3
    return over(lam * trace(e), 2) * I3 + over(2 * mu, 2) * e


def linear_tangent(F, lam, mu):
    shear = blocks(I3, I3) + np.einsum("iL,Jk->iJkL", I3, I3)
    return np.zeros(F.shape + (3, 3)) + over(lam, 4) * outer(I3, I3) + over(mu, 4) * shear


def green_strain(F):
    return (transposed(F) @ F - I3) / 2


def stvk_energy(F, lam, mu):
    """lam/2 tr(E)^2 + mu E:E."""
    E = green_strain(F)
    return lam / 2 * trace(E) ** 2 + mu * square(E)


def stvk_second(F, lam, mu):
    """S = lam tr(E) I + 2 mu E."""
    E = green_strain(F)
    return over(lam * trace(E), 2) * I3 + over(2 * mu, 2) * E


def stvk_stress(F, lam, mu):
    return F @ stvk_second(F, lam, mu)


def stvk_tangent(F, lam, mu):
    """d_ik S_JL + lam F_iJ F_kL + mu (F_iL F_kJ + (F F^T)_ik d_JL)."""
    crossed = F[..., :, None, None, :] * transposed(F)[..., None, :, :, None]
    shear = crossed + blocks(F @ transposed(F), I3)
    return blocks(I3, stvk_second(F, lam, mu)) + over(lam, 4) * outer(F, F) + over(mu, 4) * shear


def smith(lam, mu):
    """mu', lam' and alpha: no stress at F = I, and Hooke's law with lam and mu round it.

    There P = 3/4 mu' I + lam' (1 - alpha) I = 0 and
    dP = 3/4 mu' (dF + dF^T) + (lam' - 5/8 mu') tr(dF) I.
    """
    mu = 4 / 3 * np.asarray(mu)
    lam = lam + 5 / 8 * mu
    return mu, lam, 1 + 3 / 4 * mu / lam


def neo_hookean_energy(F, lam, mu):
    """mu'/2 (I_C - 3 - log((I_C + 1)/4)) + lam'/2 (J - alpha)^2, less its value at F = I.

    Smith, de Goes and Kim 2018.
    """
    mu, lam, alpha = smith(lam, mu)
    square_sum, J = square(F), determinant(F)
    shape = square_sum - 3 - np.log((square_sum + 1) / 4)
    return mu / 2 * shape + lam / 2 * (J - 1) * (J + 1 - 2 * alpha)


def neo_hookean_stress(F, lam, mu):
    """mu' (1 - 1/(I_C + 1)) F + lam' (J - alpha) dJ/dF."""
    mu, lam, alpha = smith(lam, mu)
    shape = mu * (1 - 1 / (square(F) + 1))
    return over(shape, 2) * F + over(lam * (determinant(F) - alpha), 2) * cofactor(F)


def neo_hookean_tangent(F, lam, mu):
    mu, lam, alpha = smith(lam, mu)
    inverse, volume = 1 / (square(F) + 1), cofactor(F)
    shape = over(mu * (1 - inverse), 4) * blocks(I3, I3)
    shape = shape + over(2 * mu * inverse**2, 4) * outer(F, F)
    bent = over(lam * (determinant(F) - alpha), 4) * cofactor_rate(F)
    return shape + over(lam, 4) * outer(volume, volume) + bent


def fibre_energy(F, kap, a0):
    """kap (a0.E a0)^2."""
    along = (F @ a0[..., None])[..., 0]
    return kap * ((np.einsum("...i,...i->...", along, along) - 1) / 2) ** 2


def fibre_stress(F, kap, a0):
    along = (F @ a0[..., None])[..., 0]
    strain = (np.einsum("...i,...i->...", along, along) - 1) / 2
    return over(2 * kap * strain, 2) * along[..., :, None] * a0[..., None, :]


def fibre_tangent(F, kap, a0):
    along = (F @ a0[..., None])[..., 0]
    strain = (np.einsum("...i,...i->...", along, along) - 1) / 2
    dyad = along[..., :, None] * a0[..., None, :]
    turned = over(strain, 4) * blocks(I3, a0[..., :, None] * a0[..., None, :])
    return over(2 * np.asarray(kap), 4) * (outer(dyad, dyad) + turned)


def volume_energy(F, k):
    """k/2 (J - 1)^2; with constant strain J = V/V0."""
    return k / 2 * (determinant(F) - 1) ** 2


def volume_stress(F, k):
    return over(k * (determinant(F) - 1), 2) * cofactor(F)


def volume_tangent(F, k):
    volume = cofactor(F)
    bent = over(determinant(F) - 1, 4) * cofactor_rate(F)
    return over(k, 4) * (outer(volume, volume) + bent)


LAWS = {
    "linear": Law(linear_energy, linear_stress, linear_tangent),
    "stVenantKirchhoff": Law(stvk_energy, stvk_stress, stvk_tangent),
    "stableNeoHookean": Law(neo_hookean_energy, neo_hookean_stress, neo_hookean_tangent),
}
