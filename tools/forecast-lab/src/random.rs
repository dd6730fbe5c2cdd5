//! Pseudo-random numbers, the same on every machine.

use random::SplitMix64;

/// A generator, with the distributions that motions need.
#[derive(Debug, Clone)]
pub struct Random(SplitMix64);

impl Random {
    /// An independent sequence for every seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        let mut random = Self(SplitMix64(seed.wrapping_mul(0xd134_2543_de82_ef95)));
        random.uniform();
        random
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        self.0.unit_f64()
    }

    /// Uniform in [min, max).
    pub fn between(&mut self, min: f64, max: f64) -> f64 {
        min + (max - min) * self.uniform()
    }

    /// Log-uniform in [min, max).
    pub fn ratio(&mut self, min: f64, max: f64) -> f64 {
        self.between(min.ln(), max.ln()).exp()
    }

    /// True with a probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.uniform() < probability
    }

    /// +1 or -1.
    pub fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }

    /// Uniform integer below `n`.
    pub fn below(&mut self, n: usize) -> usize {
        ((self.uniform() * n as f64) as usize).min(n - 1)
    }

    /// Exponentially distributed.
    pub fn exponential(&mut self, mean: f64) -> f64 {
        -mean * (1.0 - self.uniform()).ln()
    }

    /// Standard normal (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        self.0.normal()
    }
}
