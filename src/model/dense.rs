//! Dense products of the pre-computed part: dot, scaled sum, and a symmetric matrix by panels.

/// Rows a panel.
const WIDE: usize = 4;

#[cfg(target_arch = "x86_64")]
fn has_avx2() -> bool {
    std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma")
}

/// a . b
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    #[cfg(target_arch = "x86_64")]
    if has_avx2() {
        // SAFETY: the features are there, the lengths are equal.
        return unsafe { avx2::dot(a, b) };
    }
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// y += alpha x
pub fn add_scaled(y: &mut [f64], alpha: f64, x: &[f64]) {
    assert_eq!(y.len(), x.len());
    #[cfg(target_arch = "x86_64")]
    if has_avx2() {
        // SAFETY: the features are there, the lengths are equal.
        return unsafe { avx2::add_scaled(y, alpha, x) };
    }
    y.iter_mut().zip(x).for_each(|(y, x)| *y += alpha * x);
}

/// Cholesky factor of a small positive definite matrix that grows and shrinks at its end: rows of the
/// lower triangle one after the other. A row only depends on those before it, so that the factor is a
/// function of the list of rows, to the bit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Packed(Vec<f64>);

impl Packed {
    pub fn reserve(&mut self, rows: usize) {
        self.0.reserve(rows * (rows + 1) / 2);
    }

    pub fn copy_from(&mut self, other: &Packed) {
        self.0.clone_from(&other.0);
    }

    /// Keeps the first rows.
    pub fn truncate(&mut self, rows: usize) {
        self.0.truncate(rows * (rows + 1) / 2);
    }

    /// Row number `row` comes next; `at` gives its entries up to the diagonal.
    pub fn push(&mut self, row: usize, at: impl Fn(usize) -> f64) {
        let start = row * (row + 1) / 2;
        for k in 0..row {
            let above = k * (k + 1) / 2;
            let (done, own) = self.0.split_at(start);
            let known = dot(&done[above..above + k], &own[..k]);
            let value = (at(k) - known) / done[above + k];
            self.0.push(value);
        }
        let own = &self.0[start..];
        // Positive but for round-off: what others hold completely feels nothing.
        let pivot = (at(row) - dot(own, own)).max(1e-14 * at(row));
        self.0.push(pivot.sqrt());
    }

    /// Solves in place.
    pub fn solve(&self, x: &mut [f64]) {
        for row in 0..x.len() {
            let start = row * (row + 1) / 2;
            let known = dot(&self.0[start..start + row], &x[..row]);
            x[row] = (x[row] - known) / self.0[start + row];
        }
        for row in (0..x.len()).rev() {
            let start = row * (row + 1) / 2;
            let value = x[row] / self.0[start + row];
            x[row] = value;
            add_scaled(&mut x[..row], -value, &self.0[start..start + row]);
        }
    }
}

/// Upper half of a symmetric matrix, four rows a panel: panel p holds columns 4p to the end, each
/// column's four entries together, so that one pass over the memory serves both triangles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Symmetric {
    size: usize,
    panels: Vec<f64>,
}

impl Symmetric {
    /// Of the mean of `full` and its transpose, row by row.
    pub fn new(size: usize, full: &[f64]) -> Symmetric {
        let padded = size.next_multiple_of(WIDE);
        let mut panels = Vec::with_capacity(padded * (padded + WIDE) / 2);
        let at = |row: usize, column: usize| {
            if row < size && column < size {
                0.5 * (full[row * size + column] + full[column * size + row])
            } else {
                0.0
            }
        };
        for first in (0..padded).step_by(WIDE) {
            for column in first..padded {
                panels.extend((first..first + WIDE).map(|row| at(row, column)));
            }
        }
        Symmetric { size, panels }
    }

    pub fn size(&self) -> usize {
        self.size
    }

    pub fn at(&self, row: usize, column: usize) -> f64 {
        let (row, column) = (row.min(column), row.max(column));
        let padded = self.size.next_multiple_of(WIDE);
        let panel = row / WIDE;
        // Panels before it: WIDE (padded - WIDE k) numbers each.
        let start = WIDE * (panel * padded - WIDE * panel * panel.saturating_sub(1) / 2);
        self.panels[start + WIDE * (column - panel * WIDE) + row % WIDE]
    }

    /// y = A x; both have room for `size` rounded up to a multiple of four, zeros behind the end of x.
    pub fn product(&self, x: &[f64], y: &mut [f64]) {
        let padded = self.size.next_multiple_of(WIDE);
        assert!(x.len() >= padded && y.len() >= padded);
        y.fill(0.0);
        #[cfg(target_arch = "x86_64")]
        if has_avx2() {
            // SAFETY: the features are there; x and y hold `padded` numbers, panels what new() made.
            return unsafe { avx2::symmetric(&self.panels, padded, x, y) };
        }
        self.plain(padded, x, y);
    }

    fn plain(&self, padded: usize, x: &[f64], y: &mut [f64]) {
        let mut at = 0;
        for first in (0..padded).step_by(WIDE) {
            for column in first..padded {
                let entries = &self.panels[at..at + WIDE];
                at += WIDE;
                let mut below = 0.0;
                for row in 0..WIDE {
                    y[first + row] += entries[row] * x[column];
                    below += entries[row] * x[first + row];
                }
                if column >= first + WIDE {
                    y[column] += below;
                }
            }
        }
    }

    pub fn bytes(&self) -> usize {
        8 * self.panels.len()
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::WIDE;
    use std::arch::x86_64::*;

    #[target_feature(enable = "avx2,fma")]
    fn total(x: __m256d) -> f64 {
        let pair = _mm_add_pd(_mm256_castpd256_pd128(x), _mm256_extractf128_pd::<1>(x));
        _mm_cvtsd_f64(_mm_add_sd(pair, _mm_unpackhi_pd(pair, pair)))
    }

    #[target_feature(enable = "avx2,fma")]
    pub unsafe fn dot(a: &[f64], b: &[f64]) -> f64 {
        let (n, p, q) = (a.len(), a.as_ptr(), b.as_ptr());
        let mut sums = [_mm256_setzero_pd(); 4];
        let mut k = 0;
        // SAFETY: k + 16 <= n.
        while k + 16 <= n {
            for (lane, sum) in sums.iter_mut().enumerate() {
                let at = k + 4 * lane;
                *sum = unsafe {
                    _mm256_fmadd_pd(_mm256_loadu_pd(p.add(at)), _mm256_loadu_pd(q.add(at)), *sum)
                };
            }
            k += 16;
        }
        while k + 4 <= n {
            sums[0] = unsafe {
                _mm256_fmadd_pd(
                    _mm256_loadu_pd(p.add(k)),
                    _mm256_loadu_pd(q.add(k)),
                    sums[0],
                )
            };
            k += 4;
        }
        let tail: f64 = a[k..].iter().zip(&b[k..]).map(|(a, b)| a * b).sum();
        let left = _mm256_add_pd(sums[0], sums[1]);
        total(_mm256_add_pd(left, _mm256_add_pd(sums[2], sums[3]))) + tail
    }

    #[target_feature(enable = "avx2,fma")]
    pub unsafe fn add_scaled(y: &mut [f64], alpha: f64, x: &[f64]) {
        let n = y.len();
        let (p, q) = (y.as_mut_ptr(), x.as_ptr());
        let alpha4 = _mm256_set1_pd(alpha);
        let mut k = 0;
        while k + 4 <= n {
            // SAFETY: k + 4 <= n.
            unsafe {
                let sum =
                    _mm256_fmadd_pd(alpha4, _mm256_loadu_pd(q.add(k)), _mm256_loadu_pd(p.add(k)));
                _mm256_storeu_pd(p.add(k), sum);
            }
            k += 4;
        }
        y[k..]
            .iter_mut()
            .zip(&x[k..])
            .for_each(|(y, x)| *y += alpha * x);
    }

    #[target_feature(enable = "avx2,fma")]
    pub unsafe fn symmetric(panels: &[f64], padded: usize, x: &[f64], y: &mut [f64]) {
        let (x, y) = (x.as_ptr(), y.as_mut_ptr());
        let mut a = panels.as_ptr();
        for first in (0..padded).step_by(WIDE) {
            // SAFETY: a walks over WIDE numbers a column; x and y hold `padded` numbers.
            unsafe {
                let x_own = _mm256_loadu_pd(x.add(first));
                let mut own = _mm256_loadu_pd(y.add(first));
                for column in first..first + WIDE {
                    let entries = _mm256_loadu_pd(a);
                    own = _mm256_fmadd_pd(entries, _mm256_broadcast_sd(&*x.add(column)), own);
                    a = a.add(WIDE);
                }
                let (mut own1, mut own2, mut own3) = (
                    _mm256_setzero_pd(),
                    _mm256_setzero_pd(),
                    _mm256_setzero_pd(),
                );
                for column in (first + WIDE..padded).step_by(WIDE) {
                    let (k0, k1) = (_mm256_loadu_pd(a), _mm256_loadu_pd(a.add(4)));
                    let (k2, k3) = (_mm256_loadu_pd(a.add(8)), _mm256_loadu_pd(a.add(12)));
                    // Two lines of the panel, sixteen iterations ahead. A hint; any address will do.
                    _mm_prefetch::<_MM_HINT_T0>(a.wrapping_add(256).cast());
                    _mm_prefetch::<_MM_HINT_T0>(a.wrapping_add(264).cast());
                    a = a.add(WIDE * WIDE);
                    let x = x.add(column);
                    own = _mm256_fmadd_pd(k0, _mm256_broadcast_sd(&*x), own);
                    own1 = _mm256_fmadd_pd(k1, _mm256_broadcast_sd(&*x.add(1)), own1);
                    own2 = _mm256_fmadd_pd(k2, _mm256_broadcast_sd(&*x.add(2)), own2);
                    own3 = _mm256_fmadd_pd(k3, _mm256_broadcast_sd(&*x.add(3)), own3);
                    let (b0, b1) = (_mm256_mul_pd(k0, x_own), _mm256_mul_pd(k1, x_own));
                    let (b2, b3) = (_mm256_mul_pd(k2, x_own), _mm256_mul_pd(k3, x_own));
                    // Four horizontal sums at once.
                    let low = _mm256_hadd_pd(b0, b1);
                    let high = _mm256_hadd_pd(b2, b3);
                    let sums = _mm256_add_pd(
                        _mm256_permute2f128_pd::<0x21>(low, high),
                        _mm256_blend_pd::<0b1100>(low, high),
                    );
                    let below = y.add(column);
                    _mm256_storeu_pd(below, _mm256_add_pd(_mm256_loadu_pd(below), sums));
                }
                let own = _mm256_add_pd(_mm256_add_pd(own, own1), _mm256_add_pd(own2, own3));
                _mm256_storeu_pd(y.add(first), own);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(count: usize) -> Vec<f64> {
        (0..count).map(|k| (0.7 * k as f64).sin()).collect()
    }

    #[test]
    fn products_equal_the_plain_ones() {
        for size in [1, 3, 4, 7, 18, 45] {
            let full = numbers(size * size);
            let matrix = Symmetric::new(size, &full);
            let padded = size.next_multiple_of(4);
            let mut x = numbers(size);
            x.resize(padded, 0.0);
            let (mut fast, mut plain) = (vec![0.0; padded], vec![0.0; padded]);
            matrix.product(&x, &mut fast);
            matrix.plain(padded, &x, &mut plain);
            for row in 0..size {
                let mean = |c: usize| 0.5 * (full[row * size + c] + full[c * size + row]);
                let truth: f64 = (0..size).map(|c| mean(c) * x[c]).sum();
                assert!((fast[row] - truth).abs() < 1e-13);
                assert!((plain[row] - truth).abs() < 1e-13);
                assert!((0..size).all(|c| (matrix.at(row, c) - mean(c)).abs() < 1e-15));
            }
        }
    }

    #[test]
    fn a_packed_factor_solves_and_forgets() {
        let at = |i: usize, j: usize| {
            if i == j {
                4.0
            } else {
                1.0 / (i + j + 1) as f64
            }
        };
        let mut factor = Packed::default();
        (0..9).for_each(|row| factor.push(row, |k| at(row, k)));
        let whole = factor.clone();
        factor.truncate(4);
        (4..9).for_each(|row| factor.push(row, |k| at(row, k)));
        assert_eq!(factor, whole);
        let truth = numbers(9);
        let mut x: Vec<f64> = (0..9)
            .map(|i| (0..9).map(|j| at(i, j) * truth[j]).sum())
            .collect();
        factor.solve(&mut x);
        assert!(x.iter().zip(&truth).all(|(a, b)| (a - b).abs() < 1e-13));
    }

    #[test]
    fn vectors_of_any_length() {
        for n in 0..40 {
            let (a, b) = (numbers(n), numbers(n + 3));
            let truth: f64 = (0..n).map(|k| a[k] * b[k + 3]).sum();
            assert!((dot(&a, &b[3..]) - truth).abs() < 1e-13);
            let mut y = a.clone();
            add_scaled(&mut y, 0.3, &b[3..]);
            assert!((0..n).all(|k| (y[k] - (a[k] + 0.3 * b[k + 3])).abs() < 1e-15));
        }
    }
}
