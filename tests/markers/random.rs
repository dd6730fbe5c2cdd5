//! Pseudo-random numbers, the same in every run.

use random::SplitMix64;

/// A generator.
#[derive(Debug, Clone)]
pub(crate) struct Random(SplitMix64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(SplitMix64(seed))
    }

    /// Uniform from `from` to `to`.
    pub(crate) fn uniform(&mut self, from: f32, to: f32) -> f32 {
        from + (to - from) * self.0.unit_f32()
    }

    /// Approximately normal with variance 1: a sum of four 16-bit numbers.
    pub(crate) fn normal(&mut self) -> f32 {
        let bits = self.0.bits();
        let sum: u64 = (0..4).map(|i| (bits >> (16 * i)) & 0xffff).sum();
        (sum as f32 / 65535.0 - 2.0) * 3f32.sqrt()
    }
}
