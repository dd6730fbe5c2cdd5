//! Numbers that look random and are the same in every run.

use random::SplitMix64;

/// A well-mixed number from a counter.
pub(crate) fn mixed(counter: u64) -> u64 {
    SplitMix64(counter).bits()
}

/// Uniform in -1 to 1, fixed for a point of a lattice.
pub(crate) fn at_point(seed: u64, x: i64, y: i64) -> f32 {
    let key = mixed(seed) ^ (x as u64).wrapping_mul(0x8da6_b343) ^ ((y as u64) << 32);
    (mixed(key) >> 40) as f32 / (1u64 << 23) as f32 - 1.0
}

/// Values of a lattice with the given spacing, interpolated smoothly: -1 to 1.
pub(crate) fn smooth(seed: u64, x: f32, y: f32) -> f32 {
    let (x0, y0) = (x.floor(), y.floor());
    let ease = |t: f32| t * t * (3.0 - 2.0 * t);
    let (u, v) = (ease(x - x0), ease(y - y0));
    let value = |dx, dy| at_point(seed, x0 as i64 + dx, y0 as i64 + dy);
    let top = value(0, 0) * (1.0 - u) + value(1, 0) * u;
    let bottom = value(0, 1) * (1.0 - u) + value(1, 1) * u;
    top * (1.0 - v) + bottom * v
}

/// Normally distributed numbers of variance 1, by Box and Muller.
pub(crate) fn normal(n: usize) -> Vec<f32> {
    let uniform = |i: usize| ((mixed(i as u64) >> 40) as f32 + 0.5) / (1u64 << 24) as f32;
    (0..n)
        .map(|i| {
            let radius = (-2.0 * uniform(2 * i).ln()).sqrt();
            radius * (std::f32::consts::TAU * uniform(2 * i + 1)).cos()
        })
        .collect()
}
