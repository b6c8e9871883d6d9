//! One substep of elements with a law that is right under rotation: their forces, then the nodes in turn.
//!
//! `Sums::elastic` is twice their energy at the substep's start, and the virial u . f of what force there is on
//! connection nodes before, as a sweep over tensors has it.

use std::ops::Range;

use super::sweep::{Advance, Motion, Sums, advance_node};
use crate::element::Elements;
use crate::lanes::{self, Four};

/// Runs one substep of the nodes from `used.start` on; connection nodes begin at its end. `points` is scratch.
pub fn sweep(
    elements: &Elements,
    used: Range<usize>,
    m: &mut Motion,
    points: &mut [f64],
    by: &Advance,
) -> Sums {
    let n = m.mass.len();
    assert!(m.is_of(n));
    let connected = used.end..n;
    let virial: f64 = (m.displacement[connected.clone()].iter())
        .zip(&m.partial[connected])
        .map(|(u, f)| u.xyz().dot(&f.xyz()))
        .sum();
    let (energy, extent) = elements.add_forces(m.listed, m.displacement, m.partial, points, m.mass);
    let mut sums = advance(used.start, m, by);
    sums.elastic = 2.0 * energy + virial;
    sums.extent = extent;
    sums
}

fn advance(first: usize, m: &mut Motion, by: &Advance) -> Sums {
    #[cfg(target_arch = "x86_64")]
    if lanes::has_avx2() {
        // SAFETY: it is there.
        return unsafe { avx2(first, m, by) };
    }
    let mut sums = Sums::default();
    for i in first..m.mass.len() {
        let internal = std::mem::take(&mut m.partial[i]);
        advance_node(m, i, &internal.0, by, &mut sums);
    }
    sums
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn avx2(first: usize, m: &mut Motion, by: &Advance) -> Sums {
    // SAFETY: the caller's.
    unsafe { kernel::<lanes::Avx2>(first, m, by) }
}

#[inline(always)]
unsafe fn kernel<V: Four>(first: usize, m: &mut Motion, by: &Advance) -> Sums {
    // SAFETY: the caller's.
    unsafe {
        let (h, gain) = (V::splat(by.substep), V::splat(by.gain));
        let damping = V::splat(-by.damping);
        let zero = V::splat(0.0);
        let (mut kinetic, mut leading, mut lagging, mut work) = (zero, zero, zero, zero);
        for i in first..m.mass.len() {
            let internal = V::load(&m.partial[i].0);
            m.partial[i].0 = [0.0; 4];
            let (u, v) = (V::load(&m.displacement[i].0), V::load(&m.velocity[i].0));
            let (f, mass) = (V::load(&m.external[i].0), V::splat(m.mass[i]));
            let mv = mass.mul(v);
            let r = damping.mul_add(mv, f.sub(internal));
            let v_new = gain.mul(V::load(&m.inverse_mass[i].0)).mul_add(r, v);
            kinetic = mv.mul_add(v_new, kinetic);
            leading = mass.mul(v_new).mul_add(v_new, leading);
            lagging = mv.mul_add(v, lagging);
            work = f.mul_add(u, work);
            m.residual[i].0 = r.store();
            m.velocity[i].0 = v_new.store();
            m.displacement[i].0 = h.mul_add(v_new, u).store();
        }
        Sums {
            kinetic: total(kinetic),
            damping: total(leading.add(kinetic)),
            lagging: total(lagging),
            external: total(work),
            ..Sums::default()
        }
    }
}

#[inline(always)]
unsafe fn total<V: Four>(x: V) -> f64 {
    // SAFETY: the caller's.
    let [x, y, z, _] = unsafe { x.store() };
    (x + y) + z
}
