//! Four numbers side by side, with one text for kernels of any machine: AVX2 with FMA where that is found at
//! run time, plain code elsewhere and as its oracle.

use crate::model::tensor_mass::Lane;

/// Four f64. What it offers is what kernels need.
///
/// # Safety
/// An implementation may use instructions of a machine; who calls its methods has made sure that it is there. Nodes given
/// to `gather` and `scatter` must be below the slices' lengths.
#[allow(clippy::missing_safety_doc)]
pub(crate) trait Four: Copy {
    unsafe fn splat(x: f64) -> Self;
    unsafe fn load(x: &[f64; 4]) -> Self;
    unsafe fn store(self) -> [f64; 4];
    unsafe fn add(self, other: Self) -> Self;
    unsafe fn sub(self, other: Self) -> Self;
    unsafe fn mul(self, other: Self) -> Self;
    unsafe fn div(self, other: Self) -> Self;
    unsafe fn min(self, other: Self) -> Self;
    unsafe fn max(self, other: Self) -> Self;
    /// 1 where it is above the other, else 0.
    unsafe fn above(self, other: Self) -> Self;
    /// Whether all four are above the other's.
    unsafe fn is_above(self, other: Self) -> bool;
    /// self * b + c
    unsafe fn mul_add(self, b: Self, c: Self) -> Self;
    /// Natural logarithm of positive normal numbers.
    unsafe fn ln(self) -> Self;
    /// Rows become columns.
    unsafe fn transpose(rows: [Self; 4]) -> [Self; 4];
    /// Components x, y, z of four nodes.
    unsafe fn gather(from: &[Lane], nodes: [u32; 4]) -> [Self; 3];
    /// Rows x, y, z and zeros become columns.
    unsafe fn lanes(what: [Self; 3]) -> [Self; 4];
    /// Adds x, y, z to those of four nodes, one after the other.
    unsafe fn scatter(what: [Self; 3], to: &mut [Lane], nodes: [u32; 4]);
}

/// A hint that an item is wanted soon; any number will do.
#[inline(always)]
pub(crate) fn prefetch<T>(from: &[T], at: usize) {
    #[cfg(target_arch = "x86_64")]
    for line in (0..size_of::<T>()).step_by(64) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let what = from.as_ptr().wrapping_add(at).cast::<i8>();
        // SAFETY: every x86-64 machine has it, and it reads nothing.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(what.wrapping_add(line)) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (from, at);
}

/// Plain code.
#[derive(Clone, Copy)]
pub(crate) struct Plain([f64; 4]);

impl Plain {
    fn both(self, other: Plain, f: impl Fn(f64, f64) -> f64) -> Plain {
        Plain(std::array::from_fn(|k| f(self.0[k], other.0[k])))
    }
}

impl Four for Plain {
    #[inline(always)]
    unsafe fn splat(x: f64) -> Plain {
        Plain([x; 4])
    }

    #[inline(always)]
    unsafe fn load(x: &[f64; 4]) -> Plain {
        Plain(*x)
    }

    #[inline(always)]
    unsafe fn store(self) -> [f64; 4] {
        self.0
    }

    #[inline(always)]
    unsafe fn add(self, other: Plain) -> Plain {
        self.both(other, |a, b| a + b)
    }

    #[inline(always)]
    unsafe fn sub(self, other: Plain) -> Plain {
        self.both(other, |a, b| a - b)
    }

    #[inline(always)]
    unsafe fn mul(self, other: Plain) -> Plain {
        self.both(other, |a, b| a * b)
    }

    #[inline(always)]
    unsafe fn div(self, other: Plain) -> Plain {
        self.both(other, |a, b| a / b)
    }

    #[inline(always)]
    unsafe fn min(self, other: Plain) -> Plain {
        self.both(other, f64::min)
    }

    #[inline(always)]
    unsafe fn max(self, other: Plain) -> Plain {
        self.both(other, f64::max)
    }

    #[inline(always)]
    unsafe fn above(self, other: Plain) -> Plain {
        self.both(other, |a, b| f64::from(u8::from(a > b)))
    }

    #[inline(always)]
    unsafe fn is_above(self, other: Plain) -> bool {
        (0..4).all(|k| self.0[k] > other.0[k])
    }

    #[inline(always)]
    unsafe fn mul_add(self, b: Plain, c: Plain) -> Plain {
        self.both(b, |a, b| a * b).both(c, |ab, c| ab + c)
    }

    #[inline(always)]
    unsafe fn ln(self) -> Plain {
        Plain(self.0.map(f64::ln))
    }

    #[inline(always)]
    unsafe fn transpose(rows: [Plain; 4]) -> [Plain; 4] {
        std::array::from_fn(|k| Plain(rows.map(|row| row.0[k])))
    }

    #[inline(always)]
    unsafe fn gather(from: &[Lane], nodes: [u32; 4]) -> [Plain; 3] {
        let lanes = nodes.map(|v| from[v as usize].0);
        std::array::from_fn(|axis| Plain(lanes.map(|lane| lane[axis])))
    }

    #[inline(always)]
    unsafe fn lanes(what: [Plain; 3]) -> [Plain; 4] {
        let [x, y, z] = what.map(|row| row.0);
        std::array::from_fn(|k| Plain([x[k], y[k], z[k], 0.0]))
    }

    #[inline(always)]
    unsafe fn scatter(what: [Plain; 3], to: &mut [Lane], nodes: [u32; 4]) {
        for (k, v) in nodes.iter().enumerate() {
            for (axis, what) in what.iter().enumerate() {
                to[*v as usize].0[axis] += what.0[k];
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) use avx2::Avx2;

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    use super::{Four, Lane};

    /// AVX2 with FMA.
    #[derive(Clone, Copy)]
    pub(crate) struct Avx2(__m256d);

    impl Four for Avx2 {
        #[inline(always)]
        unsafe fn splat(x: f64) -> Avx2 {
            // SAFETY: as the trait says; so in all of them.
            Avx2(unsafe { _mm256_set1_pd(x) })
        }

        #[inline(always)]
        unsafe fn load(x: &[f64; 4]) -> Avx2 {
            Avx2(unsafe { _mm256_loadu_pd(x.as_ptr()) })
        }

        #[inline(always)]
        unsafe fn store(self) -> [f64; 4] {
            let mut x = [0.0; 4];
            unsafe { _mm256_storeu_pd(x.as_mut_ptr(), self.0) };
            x
        }

        #[inline(always)]
        unsafe fn add(self, other: Avx2) -> Avx2 {
            Avx2(unsafe { _mm256_add_pd(self.0, other.0) })
        }

        #[inline(always)]
        unsafe fn sub(self, other: Avx2) -> Avx2 {
            Avx2(unsafe { _mm256_sub_pd(self.0, other.0) })
        }

        #[inline(always)]
        unsafe fn mul(self, other: Avx2) -> Avx2 {
            Avx2(unsafe { _mm256_mul_pd(self.0, other.0) })
        }

        #[inline(always)]
        unsafe fn div(self, other: Avx2) -> Avx2 {
            Avx2(unsafe { _mm256_div_pd(self.0, other.0) })
        }

        #[inline(always)]
        unsafe fn min(self, other: Avx2) -> Avx2 {
            Avx2(unsafe { _mm256_min_pd(self.0, other.0) })
        }

        #[inline(always)]
        unsafe fn max(self, other: Avx2) -> Avx2 {
            Avx2(unsafe { _mm256_max_pd(self.0, other.0) })
        }

        #[inline(always)]
        unsafe fn above(self, other: Avx2) -> Avx2 {
            unsafe {
                let is = _mm256_cmp_pd::<_CMP_GT_OQ>(self.0, other.0);
                Avx2(_mm256_and_pd(is, _mm256_set1_pd(1.0)))
            }
        }

        #[inline(always)]
        unsafe fn is_above(self, other: Avx2) -> bool {
            unsafe { _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_GT_OQ>(self.0, other.0)) == 0b1111 }
        }

        #[inline(always)]
        unsafe fn mul_add(self, b: Avx2, c: Avx2) -> Avx2 {
            Avx2(unsafe { _mm256_fmadd_pd(self.0, b.0, c.0) })
        }

        /// ln x = k ln 2 + 2 artanh((m - 1)/(m + 1)), m = x/2^k in [sqrt 1/2, sqrt 2]: nine terms reach round-off.
        #[inline(always)]
        unsafe fn ln(self) -> Avx2 {
            unsafe {
                let bits = _mm256_castpd_si256(self.0);
                let half_root = _mm256_set1_epi64x(0x3fe6_a09e_667f_3bcd);
                let from = _mm256_sub_epi64(bits, half_root);
                // Exponent k, made a number by way of the mantissa of 2^52 + 2^51.
                let shifted = _mm256_srli_epi64::<52>(_mm256_add_epi64(
                    from,
                    _mm256_set1_epi64x(0x3ff0_0000_0000_0000),
                ));
                let magic = 4_503_599_627_370_496.0;
                let k = _mm256_sub_pd(
                    _mm256_castsi256_pd(_mm256_or_si256(
                        shifted,
                        _mm256_castpd_si256(_mm256_set1_pd(magic)),
                    )),
                    _mm256_set1_pd(magic + 1023.0),
                );
                let mantissa = _mm256_and_si256(from, _mm256_set1_epi64x(0x000f_ffff_ffff_ffff));
                let m = _mm256_castsi256_pd(_mm256_add_epi64(mantissa, half_root));
                let one = _mm256_set1_pd(1.0);
                let z = _mm256_div_pd(_mm256_sub_pd(m, one), _mm256_add_pd(m, one));
                let square = _mm256_mul_pd(z, z);
                let mut sum = _mm256_set1_pd(1.0 / 19.0);
                for n in [17.0, 15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0] {
                    sum = _mm256_fmadd_pd(sum, square, _mm256_set1_pd(1.0 / n));
                }
                let tail = _mm256_mul_pd(_mm256_mul_pd(sum, square), z);
                let whole = _mm256_mul_pd(_mm256_set1_pd(2.0), _mm256_add_pd(tail, z));
                Avx2(_mm256_fmadd_pd(
                    k,
                    _mm256_set1_pd(std::f64::consts::LN_2),
                    whole,
                ))
            }
        }

        #[inline(always)]
        unsafe fn transpose(rows: [Avx2; 4]) -> [Avx2; 4] {
            unsafe {
                let (a, b, c, d) = (rows[0].0, rows[1].0, rows[2].0, rows[3].0);
                let (xz_ab, yw_ab) = (_mm256_unpacklo_pd(a, b), _mm256_unpackhi_pd(a, b));
                let (xz_cd, yw_cd) = (_mm256_unpacklo_pd(c, d), _mm256_unpackhi_pd(c, d));
                [
                    Avx2(_mm256_permute2f128_pd::<0x20>(xz_ab, xz_cd)),
                    Avx2(_mm256_permute2f128_pd::<0x20>(yw_ab, yw_cd)),
                    Avx2(_mm256_permute2f128_pd::<0x31>(xz_ab, xz_cd)),
                    Avx2(_mm256_permute2f128_pd::<0x31>(yw_ab, yw_cd)),
                ]
            }
        }

        #[inline(always)]
        unsafe fn gather(from: &[Lane], nodes: [u32; 4]) -> [Avx2; 3] {
            unsafe {
                let at = from.as_ptr().cast::<f64>();
                // Two halves at a time, which loads do without a shuffle.
                let (a, c) = (at.add(4 * nodes[0] as usize), at.add(4 * nodes[2] as usize));
                let (b, d) = (at.add(4 * nodes[1] as usize), at.add(4 * nodes[3] as usize));
                let low = _mm256_loadu2_m128d(c, a);
                let high = _mm256_loadu2_m128d(d, b);
                let third = _mm256_loadu2_m128d(c.add(2), a.add(2));
                let fourth = _mm256_loadu2_m128d(d.add(2), b.add(2));
                [
                    Avx2(_mm256_unpacklo_pd(low, high)),
                    Avx2(_mm256_unpackhi_pd(low, high)),
                    Avx2(_mm256_unpacklo_pd(third, fourth)),
                ]
            }
        }

        #[inline(always)]
        unsafe fn lanes(what: [Avx2; 3]) -> [Avx2; 4] {
            unsafe {
                let (x, y, z) = (what[0].0, what[1].0, what[2].0);
                // x0 y0 x2 y2 and x1 y1 x3 y3; with its halves swapped z becomes z2 0 z0 0 and z3 0 z1 0, so that half of the
                // columns are blends, which one of few ports need not do as it must shuffles.
                let zero = _mm256_setzero_pd();
                let (xy_02, xy_13) = (_mm256_unpacklo_pd(x, y), _mm256_unpackhi_pd(x, y));
                let swapped = _mm256_permute2f128_pd::<0x01>(z, z);
                let z_20 = _mm256_blend_pd::<0b1010>(swapped, zero);
                let z_31 = _mm256_unpackhi_pd(swapped, zero);
                [
                    Avx2(_mm256_blend_pd::<0b1100>(xy_02, z_20)),
                    Avx2(_mm256_blend_pd::<0b1100>(xy_13, z_31)),
                    Avx2(_mm256_permute2f128_pd::<0x21>(xy_02, z_20)),
                    Avx2(_mm256_permute2f128_pd::<0x21>(xy_13, z_31)),
                ]
            }
        }

        #[inline(always)]
        unsafe fn scatter(what: [Avx2; 3], to: &mut [Lane], nodes: [u32; 4]) {
            unsafe {
                let lanes = Avx2::lanes(what);
                let at = to.as_mut_ptr().cast::<f64>();
                for k in 0..4 {
                    let place = at.add(4 * nodes[k] as usize);
                    _mm256_store_pd(place, _mm256_add_pd(_mm256_load_pd(place), lanes[k].0));
                }
            }
        }
    }
}

/// Whether this machine has what [`Avx2`] needs.
pub(crate) fn has_avx2() -> bool {
    #[cfg(target_arch = "x86_64")]
    return std::arch::is_x86_feature_detected!("avx2")
        && std::arch::is_x86_feature_detected!("fma");
    #[cfg(not(target_arch = "x86_64"))]
    false
}

/// Three numbers; a 3x3 matrix, by rows. What is done with them is written out, and without closures, so that all of it
/// becomes one piece of code that may use the machine's instructions.
pub(crate) type Three<V> = [V; 3];
pub(crate) type Square<V> = [[V; 3]; 3];

#[inline(always)]
pub(crate) unsafe fn load3<V: Four>(x: &[[f64; 4]; 3]) -> Three<V> {
    // SAFETY: the caller's; so in all of these.
    unsafe { [V::load(&x[0]), V::load(&x[1]), V::load(&x[2])] }
}

#[inline(always)]
pub(crate) unsafe fn sub3<V: Four>(a: Three<V>, b: Three<V>) -> Three<V> {
    unsafe { [a[0].sub(b[0]), a[1].sub(b[1]), a[2].sub(b[2])] }
}

/// a b
#[inline(always)]
pub(crate) unsafe fn scale<V: Four>(a: Three<V>, b: V) -> Three<V> {
    unsafe { [a[0].mul(b), a[1].mul(b), a[2].mul(b)] }
}

/// a . b
#[inline(always)]
pub(crate) unsafe fn dot<V: Four>(a: Three<V>, b: Three<V>) -> V {
    unsafe { a[0].mul_add(b[0], a[1].mul_add(b[1], a[2].mul(b[2]))) }
}

/// a x b
#[inline(always)]
pub(crate) unsafe fn cross<V: Four>(a: Three<V>, b: Three<V>) -> Three<V> {
    unsafe {
        [
            a[1].mul(b[2]).sub(a[2].mul(b[1])),
            a[2].mul(b[0]).sub(a[0].mul(b[2])),
            a[0].mul(b[1]).sub(a[1].mul(b[0])),
        ]
    }
}

/// m a
#[inline(always)]
pub(crate) unsafe fn product<V: Four>(m: &Square<V>, a: Three<V>) -> Three<V> {
    unsafe { [dot(m[0], a), dot(m[1], a), dot(m[2], a)] }
}

/// Cofactors: rows are the cross products of the other two rows.
#[inline(always)]
pub(crate) unsafe fn cofactors<V: Four>(f: &Square<V>) -> Square<V> {
    unsafe { [cross(f[1], f[2]), cross(f[2], f[0]), cross(f[0], f[1])] }
}

/// How far any node has moved at most from where it was seen \[m\]: of the largest difference of each component.
pub(crate) fn most_moved(seen: &[Lane], u: &[Lane]) -> f64 {
    #[cfg(target_arch = "x86_64")]
    if has_avx2() {
        // SAFETY: it is there.
        return unsafe { moved_avx2(seen, u) };
    }
    // SAFETY: plain code needs no machine.
    unsafe { moved::<Plain>(seen, u) }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn moved_avx2(seen: &[Lane], u: &[Lane]) -> f64 {
    // SAFETY: the caller's.
    unsafe { moved::<Avx2>(seen, u) }
}

#[inline(always)]
unsafe fn moved<V: Four>(seen: &[Lane], u: &[Lane]) -> f64 {
    // SAFETY: the caller's.
    unsafe {
        // Several at a time, as each waits for the last of its own.
        let zero = V::splat(0.0);
        let (mut least, mut most) = ([zero; 4], [zero; 4]);
        let (u, rest) = u.as_chunks::<4>();
        let (seen, others) = seen.as_chunks::<4>();
        for (u, seen) in u.iter().zip(seen) {
            for k in 0..4 {
                let d = V::load(&u[k].0).sub(V::load(&seen[k].0));
                least[k] = d.min(least[k]);
                most[k] = d.max(most[k]);
            }
        }
        for (u, seen) in rest.iter().zip(others) {
            let d = V::load(&u.0).sub(V::load(&seen.0));
            least[0] = d.min(least[0]);
            most[0] = d.max(most[0]);
        }
        let least = least[0].min(least[1]).min(least[2].min(least[3]));
        let most = most[0].max(most[1]).max(most[2].max(most[3]));
        let [x, y, z, _] = most.max(V::splat(0.0).sub(least)).store();
        (x * x + y * y + z * z).sqrt()
    }
}
