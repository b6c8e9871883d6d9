//! One substep in one sweep over the tensors: force, velocity, position and the sums of the energy
//! account, in place.
//!
//! Sweeping rows upward, (K u)_i is complete when row i is done and u_i is not read again, so
//! velocity and position are updated there. Symplectic Euler with velocities at half steps:
//!
//! r_n = f_ext - K u_n - c M v_{n-1/2};  v_{n+1/2} = v_{n-1/2} + h M^-1 r_n;  u_{n+1} = u_n + h v_{n+1/2}
//!
//! Central difference is the same with damping at the mean velocity, which only scales the gain:
//! M (v_{n+1/2} - v_{n-1/2})/h = f_ext - K u_n - c M (v_{n-1/2} + v_{n+1/2})/2 gives
//! v_{n+1/2} = v_{n-1/2} + h/(1 + c h/2) M^-1 r_n.
//!
//! A degree of freedom whose inverse mass is given as 0 keeps its velocity.

use super::tensor_mass::{Lane, Pattern, Tensors};
use crate::element::listed::Listed;
use crate::element::tetrahedra::Extent;

/// What moves. All slices have one entry a node.
pub struct Motion<'a> {
    /// u \[m\]
    pub displacement: &'a mut [Lane],
    /// v \[m/s\], half a substep behind.
    pub velocity: &'a mut [Lane],
    /// r_n \[N\], written; the fourth lane is undefined.
    pub residual: &'a mut [Lane],
    /// Scratch \[N\], zero before and after.
    pub partial: &'a mut [Lane],
    /// f_ext \[N\]
    pub external: &'a [Lane],
    /// \[1/kg\] an axis, 0 where held.
    pub inverse_mass: &'a [Lane],
    /// \[kg\]
    pub mass: &'a [f64],
    /// What has to be looked at of tissue that is adaptive or guarded; all of it where not given.
    pub listed: Option<&'a Listed>,
}

impl Motion<'_> {
    /// Whether all slices have n entries.
    pub(super) fn is_of(&self, n: usize) -> bool {
        let lengths = [
            self.displacement.len(),
            self.velocity.len(),
            self.residual.len(),
            self.partial.len(),
            self.external.len(),
            self.inverse_mass.len(),
            self.mass.len(),
        ];
        lengths.iter().all(|l| *l == n)
    }
}

/// One substep's numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Advance {
    /// Length h \[s\].
    pub substep: f64,
    /// What M^-1 r_n is multiplied by \[s\]: k, or k/(1 + c k/2) for central difference, where the kick
    /// k goes from the middle of the substep before to the middle of this one.
    pub gain: f64,
    /// k \[s\]
    pub kick: f64,
    /// c \[1/s\], mass-proportional.
    pub damping: f64,
}

impl Advance {
    /// `before`: length of the substep before \[s\].
    pub fn symplectic_euler(before: f64, substep: f64, damping: f64) -> Advance {
        let kick = 0.5 * (before + substep);
        Advance {
            substep,
            gain: kick,
            kick,
            damping,
        }
    }

    pub fn central_difference(before: f64, substep: f64, damping: f64) -> Advance {
        let kick = 0.5 * (before + substep);
        Advance {
            substep,
            gain: kick / (1.0 + 0.5 * damping * kick),
            kick,
            damping,
        }
    }
}

/// Sums over all nodes at the substep's start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sums {
    /// u_n . K u_n = twice the elastic energy \[J\]
    pub elastic: f64,
    /// v_{n-1/2} . M v_{n+1/2} = twice the kinetic energy \[J\]
    pub kinetic: f64,
    /// v_{n+1/2} . M (v_{n-1/2} + v_{n+1/2}); times c h/2 the energy damping takes in this substep \[J\]
    pub damping: f64,
    /// v_{n-1/2} . M v_{n-1/2} \[J\]
    pub lagging: f64,
    /// f_ext . u_n \[J\]
    pub external: f64,
    /// Of what has a non-linear law.
    pub extent: Extent,
}

impl std::ops::AddAssign for Sums {
    fn add_assign(&mut self, other: Sums) {
        self.elastic += other.elastic;
        self.kinetic += other.kinetic;
        self.damping += other.damping;
        self.lagging += other.lagging;
        self.external += other.external;
        self.extent.join(&other.extent);
    }
}

/// Runs one substep.
pub fn sweep(pattern: &Pattern, tensors: &Tensors, m: &mut Motion, by: &Advance) -> Sums {
    assert!(m.is_of(pattern.nodes()) && tensors.0.len() == 9 * pattern.column.len() + 3);
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        // SAFETY: the features are there; lengths are checked above, columns are below n by
        // construction of Pattern.
        return unsafe { avx2(pattern, tensors, m, by) };
    }
    plain(pattern, tensors, m, by)
}

/// The same in plain code, for machines without AVX2 and as the fast form's oracle.
pub fn plain(pattern: &Pattern, tensors: &Tensors, m: &mut Motion, by: &Advance) -> Sums {
    let mut sums = Sums::default();
    for i in pattern.first..pattern.nodes() {
        let u_i = m.displacement[i].0;
        let mut internal = m.partial[i].0;
        m.partial[i] = Lane::default();
        for place in pattern.row_start[i] as usize..pattern.row_start[i + 1] as usize {
            let j = pattern.column[place] as usize;
            let k = &tensors.0[9 * place..9 * place + 9];
            let u_j = m.displacement[j].0;
            for row in 0..3 {
                internal[row] +=
                    k[3 * row] * u_j[0] + k[3 * row + 1] * u_j[1] + k[3 * row + 2] * u_j[2];
            }
            if j != i {
                let f_j = &mut m.partial[j].0;
                for column in 0..3 {
                    f_j[column] +=
                        k[column] * u_i[0] + k[3 + column] * u_i[1] + k[6 + column] * u_i[2];
                }
            }
        }
        for axis in 0..3 {
            sums.elastic += u_i[axis] * internal[axis];
        }
        advance_node(m, i, &internal, by, &mut sums);
    }
    sums
}

/// Velocity and displacement of node i once its internal force is complete, and its share of the sums
/// but the elastic one.
pub(crate) fn advance_node(
    m: &mut Motion,
    i: usize,
    internal: &[f64],
    by: &Advance,
    sums: &mut Sums,
) {
    let mass = m.mass[i];
    for axis in 0..3 {
        let u = m.displacement[i].0[axis];
        let v = m.velocity[i].0[axis];
        let r = m.external[i].0[axis] - internal[axis] - by.damping * mass * v;
        let v_new = v + by.gain * m.inverse_mass[i].0[axis] * r;
        sums.kinetic += mass * v * v_new;
        sums.damping += mass * v_new * (v + v_new);
        sums.lagging += mass * v * v;
        sums.external += m.external[i].0[axis] * u;
        m.residual[i].0[axis] = r;
        m.velocity[i].0[axis] = v_new;
        m.displacement[i].0[axis] = u + by.substep * v_new;
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn avx2(pattern: &Pattern, tensors: &Tensors, m: &mut Motion, by: &Advance) -> Sums {
    use std::arch::x86_64::*;

    let u = m.displacement.as_mut_ptr().cast::<f64>();
    let velocity = m.velocity.as_mut_ptr().cast::<f64>();
    let residual = m.residual.as_mut_ptr().cast::<f64>();
    let partial = m.partial.as_mut_ptr().cast::<f64>();
    let external = m.external.as_ptr().cast::<f64>();
    let inverse_mass = m.inverse_mass.as_ptr().cast::<f64>();
    let mass = m.mass.as_ptr();
    let blocks = tensors.0.as_ptr();
    let column = pattern.column.as_ptr();
    let zero = _mm256_setzero_pd();
    let (h4, gain4) = (_mm256_set1_pd(by.substep), _mm256_set1_pd(by.gain));
    let minus_c = _mm256_set1_pd(-by.damping);
    let mut lagging = zero;
    let (mut elastic, mut kinetic, mut leading, mut work) = (zero, zero, zero, zero);
    let mut place = pattern.row_start[pattern.first] as usize;
    for i in pattern.first..pattern.nodes() {
        // SAFETY: i < n; place and column[place] stay inside by Pattern's construction; a block's
        // last four-wide load reaches one number past it, which the padding covers.
        unsafe {
            let end = *pattern.row_start.get_unchecked(i + 1) as usize;
            let u_i = _mm256_load_pd(u.add(4 * i));
            let x = _mm256_broadcast_sd(&*u.add(4 * i));
            let y = _mm256_broadcast_sd(&*u.add(4 * i + 1));
            let z = _mm256_broadcast_sd(&*u.add(4 * i + 2));
            let block = blocks.add(9 * place);
            let mut row0 = _mm256_mul_pd(_mm256_loadu_pd(block), u_i);
            let mut row1 = _mm256_mul_pd(_mm256_loadu_pd(block.add(3)), u_i);
            let mut row2 = _mm256_mul_pd(_mm256_loadu_pd(block.add(6)), u_i);
            place += 1;
            // Both products of the edge tensor at a place.
            macro_rules! edge {
                ($place:expr) => {
                    let j = *column.add($place) as usize;
                    let block = blocks.add(9 * $place);
                    let k0 = _mm256_loadu_pd(block);
                    let k1 = _mm256_loadu_pd(block.add(3));
                    let k2 = _mm256_loadu_pd(block.add(6));
                    // Twenty tensors ahead: 8 % on tensors that live in L2. A hint; any address will do.
                    _mm_prefetch::<_MM_HINT_T0>(block.wrapping_add(9 * 20).cast());
                    let u_j = _mm256_load_pd(u.add(4 * j));
                    row0 = _mm256_fmadd_pd(k0, u_j, row0);
                    row1 = _mm256_fmadd_pd(k1, u_j, row1);
                    row2 = _mm256_fmadd_pd(k2, u_j, row2);
                    let f_j = _mm256_fmadd_pd(k0, x, _mm256_load_pd(partial.add(4 * j)));
                    let f_j = _mm256_fmadd_pd(k2, z, _mm256_fmadd_pd(k1, y, f_j));
                    _mm256_store_pd(partial.add(4 * j), f_j);
                };
            }
            // By two: 3 % on short rows.
            while place + 1 < end {
                edge!(place);
                edge!(place + 1);
                place += 2;
            }
            if place < end {
                edge!(place);
                place += 1;
            }
            let low = _mm256_hadd_pd(row0, row1);
            let high = _mm256_hadd_pd(row2, row2);
            let own = _mm256_add_pd(
                _mm256_permute2f128_pd::<0x21>(low, high),
                _mm256_blend_pd::<0b1100>(low, high),
            );
            let internal = _mm256_add_pd(own, _mm256_load_pd(partial.add(4 * i)));
            _mm256_store_pd(partial.add(4 * i), zero);

            let v = _mm256_load_pd(velocity.add(4 * i));
            let m_i = _mm256_broadcast_sd(&*mass.add(i));
            let f = _mm256_load_pd(external.add(4 * i));
            let mv = _mm256_mul_pd(m_i, v);
            let r = _mm256_fmadd_pd(minus_c, mv, _mm256_sub_pd(f, internal));
            let gain = _mm256_mul_pd(gain4, _mm256_load_pd(inverse_mass.add(4 * i)));
            let v_new = _mm256_fmadd_pd(gain, r, v);
            elastic = _mm256_fmadd_pd(u_i, internal, elastic);
            kinetic = _mm256_fmadd_pd(mv, v_new, kinetic);
            leading = _mm256_fmadd_pd(_mm256_mul_pd(m_i, v_new), v_new, leading);
            lagging = _mm256_fmadd_pd(mv, v, lagging);
            work = _mm256_fmadd_pd(f, u_i, work);
            _mm256_store_pd(residual.add(4 * i), r);
            _mm256_store_pd(velocity.add(4 * i), v_new);
            _mm256_store_pd(u.add(4 * i), _mm256_fmadd_pd(h4, v_new, u_i));
        }
    }
    let total = |x: __m256d| {
        let mut lanes = [0.0; 4];
        // SAFETY: four numbers of room.
        unsafe { _mm256_storeu_pd(lanes.as_mut_ptr(), x) };
        (lanes[0] + lanes[1]) + lanes[2]
    };
    Sums {
        elastic: total(elastic),
        kinetic: total(kinetic),
        damping: total(_mm256_add_pd(leading, kinetic)),
        lagging: total(lagging),
        external: total(work),
        extent: Extent::default(),
    }
}
