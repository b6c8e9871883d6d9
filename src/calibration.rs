//! How fast this machine is: a fixed number of multiplications, to put beside times measured in the same run.

use std::hint::black_box;
use std::time::Instant;

/// Lanes that are worked on, four numbers each: 16 kB, within any first cache.
const LANES: usize = 512;
/// Passes over them.
const PASSES: usize = 20;

/// 40 960 multiply-adds, x <- x b + b, in place.
pub struct Calibration {
    numbers: Vec<[f64; 4]>,
}

impl Default for Calibration {
    fn default() -> Calibration {
        Calibration {
            numbers: vec![[1.0; 4]; LANES],
        }
    }
}

impl Calibration {
    /// The work itself.
    #[inline(never)]
    pub fn work(&mut self) {
        let b = [1.000_000_1f64; 4];
        for _ in 0..PASSES {
            for x in &mut self.numbers {
                for (x, b) in x.iter_mut().zip(b) {
                    *x = x.mul_add(b, b);
                }
            }
        }
        black_box(&self.numbers);
    }

    /// Seconds it takes now: the middle one of `rounds` runs.
    pub fn seconds(&mut self, rounds: usize) -> f64 {
        let mut times: Vec<f64> = (0..rounds.max(1))
            .map(|_| {
                // Numbers that overflow would be slower on some machines.
                self.numbers.fill([1.0; 4]);
                let start = Instant::now();
                self.work();
                start.elapsed().as_secs_f64()
            })
            .collect();
        times.sort_by(f64::total_cmp);
        times[times.len() / 2]
    }
}
