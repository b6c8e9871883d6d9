//! One substep in one sweep over the springs: [`sweep`](super::sweep) for a non-linear law.
//!
//! The same order serves: when row i is done all springs on node i have been looked at, and u_i is not
//! read again. `Sums::elastic` is twice the springs' energy at the substep's start. A substep costs twice
//! that of tensors, for the root and the quotient of each spring; in plain code 1.6 times.

use super::spring_mass::Springs;
use super::sweep::{Advance, Motion, Sums, advance_node};

/// Runs one substep.
pub fn sweep(springs: &Springs, m: &mut Motion, by: &Advance) -> Sums {
    assert!(m.is_of(springs.row_start.len() - 1));
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        // SAFETY: the features are there; lengths are checked above, nodes are below their number by
        // construction of Springs.
        return unsafe { avx2(springs, m, by) };
    }
    plain(springs, m, by)
}

/// The same in plain code, for machines without AVX2 and as the fast form's oracle.
pub fn plain(springs: &Springs, m: &mut Motion, by: &Advance) -> Sums {
    let mut sums = Sums::default();
    for i in springs.first..m.mass.len() {
        let u_i = m.displacement[i].xyz();
        for four in springs.row(i) {
            for lane in 0..4 {
                let j = four.node[lane] as usize;
                let (force, twice_energy) = four.pull(lane, &(m.displacement[j].xyz() - u_i));
                sums.elastic += twice_energy;
                for axis in 0..3 {
                    m.partial[i].0[axis] -= force[axis];
                    m.partial[j].0[axis] += force[axis];
                }
            }
        }
        let internal = std::mem::take(&mut m.partial[i]);
        advance_node(m, i, &internal.0, by, &mut sums);
    }
    sums
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn avx2(springs: &Springs, m: &mut Motion, by: &Advance) -> Sums {
    use super::spring_mass::COLLAPSED;
    use std::arch::x86_64::*;

    let u = m.displacement.as_mut_ptr().cast::<f64>();
    let velocity = m.velocity.as_mut_ptr().cast::<f64>();
    let residual = m.residual.as_mut_ptr().cast::<f64>();
    let partial = m.partial.as_mut_ptr().cast::<f64>();
    let external = m.external.as_ptr().cast::<f64>();
    let inverse_mass = m.inverse_mass.as_ptr().cast::<f64>();
    let mass = m.mass.as_ptr();
    let zero = _mm256_setzero_pd();
    let (h4, gain4) = (_mm256_set1_pd(by.substep), _mm256_set1_pd(by.gain));
    let minus_c = _mm256_set1_pd(-by.damping);
    let collapsed = _mm256_set1_pd(COLLAPSED);
    let mut lagging = zero;
    let (mut elastic, mut kinetic, mut leading, mut work) = (zero, zero, zero, zero);
    for i in springs.first..m.mass.len() {
        // SAFETY: i and all nodes j are below the common length of the slices.
        unsafe {
            let u_i = _mm256_load_pd(u.add(4 * i));
            let x_i = _mm256_broadcast_sd(&*u.add(4 * i));
            let y_i = _mm256_broadcast_sd(&*u.add(4 * i + 1));
            let z_i = _mm256_broadcast_sd(&*u.add(4 * i + 2));
            let (mut own_x, mut own_y, mut own_z) = (zero, zero, zero);
            let row = *springs.row_start.get_unchecked(i) as usize
                ..*springs.row_start.get_unchecked(i + 1) as usize;
            for four in springs.four.get_unchecked(row) {
                let j = four.node.map(|j| 4 * j as usize);
                // Four nodes with three axes to three axes of four nodes.
                let [a, b, c, d] = j.map(|j| _mm256_load_pd(u.add(j)));
                let (xz_ab, y_ab) = (_mm256_unpacklo_pd(a, b), _mm256_unpackhi_pd(a, b));
                let (xz_cd, y_cd) = (_mm256_unpacklo_pd(c, d), _mm256_unpackhi_pd(c, d));
                let w_x = _mm256_sub_pd(_mm256_permute2f128_pd::<0x20>(xz_ab, xz_cd), x_i);
                let w_y = _mm256_sub_pd(_mm256_permute2f128_pd::<0x20>(y_ab, y_cd), y_i);
                let w_z = _mm256_sub_pd(_mm256_permute2f128_pd::<0x31>(xz_ab, xz_cd), z_i);
                let [r_x, r_y, r_z] =
                    [0, 1, 2].map(|axis| _mm256_load_pd(four.rest[axis].as_ptr()));
                let (d_x, d_y, d_z) = (
                    _mm256_add_pd(r_x, w_x),
                    _mm256_add_pd(r_y, w_y),
                    _mm256_add_pd(r_z, w_z),
                );
                let q = _mm256_mul_pd(w_x, _mm256_add_pd(r_x, d_x));
                let q = _mm256_fmadd_pd(w_y, _mm256_add_pd(r_y, d_y), q);
                let q = _mm256_fmadd_pd(w_z, _mm256_add_pd(r_z, d_z), q);
                let length = _mm256_load_pd(four.length.as_ptr());
                let square = _mm256_mul_pd(length, length);
                let l_square =
                    _mm256_max_pd(_mm256_mul_pd(collapsed, square), _mm256_add_pd(square, q));
                let l = _mm256_sqrt_pd(l_square);
                let x = _mm256_div_pd(q, _mm256_fmadd_pd(l, length, l_square));
                let s = _mm256_mul_pd(_mm256_load_pd(four.stiffness.as_ptr()), x);
                elastic = _mm256_fmadd_pd(_mm256_mul_pd(s, x), l_square, elastic);
                let f_x = _mm256_mul_pd(s, d_x);
                let f_y = _mm256_mul_pd(s, d_y);
                let f_z = _mm256_mul_pd(s, d_z);
                own_x = _mm256_add_pd(own_x, f_x);
                own_y = _mm256_add_pd(own_y, f_y);
                own_z = _mm256_add_pd(own_z, f_z);
                // And back, one node after the other: places past the row's end share one.
                let (xy_02, xy_13) = (_mm256_unpacklo_pd(f_x, f_y), _mm256_unpackhi_pd(f_x, f_y));
                let (z_02, z_13) = (_mm256_unpacklo_pd(f_z, zero), _mm256_unpackhi_pd(f_z, zero));
                let forces = [
                    _mm256_permute2f128_pd::<0x20>(xy_02, z_02),
                    _mm256_permute2f128_pd::<0x20>(xy_13, z_13),
                    _mm256_permute2f128_pd::<0x31>(xy_02, z_02),
                    _mm256_permute2f128_pd::<0x31>(xy_13, z_13),
                ];
                for (j, force) in j.into_iter().zip(forces) {
                    let sum = _mm256_add_pd(_mm256_load_pd(partial.add(j)), force);
                    _mm256_store_pd(partial.add(j), sum);
                }
            }
            let low = _mm256_hadd_pd(own_x, own_y);
            let high = _mm256_hadd_pd(own_z, zero);
            let own = _mm256_add_pd(
                _mm256_permute2f128_pd::<0x21>(low, high),
                _mm256_blend_pd::<0b1100>(low, high),
            );
            let internal = _mm256_sub_pd(_mm256_load_pd(partial.add(4 * i)), own);
            _mm256_store_pd(partial.add(4 * i), zero);

            let v = _mm256_load_pd(velocity.add(4 * i));
            let m_i = _mm256_broadcast_sd(&*mass.add(i));
            let f = _mm256_load_pd(external.add(4 * i));
            let mv = _mm256_mul_pd(m_i, v);
            let r = _mm256_fmadd_pd(minus_c, mv, _mm256_sub_pd(f, internal));
            let gain = _mm256_mul_pd(gain4, _mm256_load_pd(inverse_mass.add(4 * i)));
            let v_new = _mm256_fmadd_pd(gain, r, v);
            kinetic = _mm256_fmadd_pd(mv, v_new, kinetic);
            leading = _mm256_fmadd_pd(_mm256_mul_pd(m_i, v_new), v_new, leading);
            lagging = _mm256_fmadd_pd(mv, v, lagging);
            work = _mm256_fmadd_pd(f, u_i, work);
            _mm256_store_pd(residual.add(4 * i), r);
            _mm256_store_pd(velocity.add(4 * i), v_new);
            _mm256_store_pd(u.add(4 * i), _mm256_fmadd_pd(h4, v_new, u_i));
        }
    }
    let lanes = |x: __m256d| {
        let mut lanes = [0.0; 4];
        // SAFETY: four numbers of room.
        unsafe { _mm256_storeu_pd(lanes.as_mut_ptr(), x) };
        lanes
    };
    let total = |x: __m256d| {
        let [x, y, z, _] = lanes(x);
        (x + y) + z
    };
    let [a, b, c, d] = lanes(elastic);
    Sums {
        elastic: (a + b) + (c + d),
        kinetic: total(kinetic),
        damping: total(_mm256_add_pd(leading, kinetic)),
        lagging: total(lagging),
        external: total(work),
        ..Sums::default()
    }
}
