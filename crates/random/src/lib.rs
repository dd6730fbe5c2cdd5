//! Random numbers that are the same in every run and on every machine: for the demo, the search for
//! marker designs, generated motions, and tests.
//!
//! Not for secrets.
#![forbid(unsafe_code)]

/// SplitMix64 (Steele, Lea and Flood 2014). Equal states give equal numbers.
#[derive(Debug, Clone)]
pub struct SplitMix64(pub u64);

impl SplitMix64 {
    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Eight random bits.
    pub fn byte(&mut self) -> u8 {
        (self.bits() >> 56) as u8
    }

    /// Uniform in [0, 1), in steps of 2^-24.
    pub fn unit_f32(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / (1u64 << 24) as f32
    }

    /// Uniform in [0, 1), in steps of 2^-53.
    pub fn unit_f64(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Standard normal, by the transform of Box and Muller.
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit_f64()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit_f64()).cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_numbers_are_those_of_the_published_generator() {
        let mut random = SplitMix64(1_234_567);
        let expected = [
            6_457_827_717_110_365_317,
            3_203_168_211_198_807_973,
            9_817_491_932_198_370_423,
            4_593_380_528_125_082_431,
            16_408_922_859_458_223_821,
        ];
        for expected in expected {
            assert_eq!(random.bits(), expected);
        }
    }

    #[test]
    fn mean_and_variance() {
        let mut random = SplitMix64(5);
        let moments = |mut next: Box<dyn FnMut() -> f64 + '_>| {
            let values: Vec<f64> = (0..20_000).map(|_| next()).collect();
            let mean = values.iter().sum::<f64>() / 20_000.0;
            let squares = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>();
            (mean, squares / 20_000.0)
        };
        let (mean, variance) = moments(Box::new(|| random.unit_f64()));
        assert!((mean - 0.5).abs() < 0.01 && (variance - 1.0 / 12.0).abs() < 0.002);
        let (mean, variance) = moments(Box::new(|| f64::from(random.unit_f32())));
        assert!((mean - 0.5).abs() < 0.01 && (variance - 1.0 / 12.0).abs() < 0.002);
        let (mean, variance) = moments(Box::new(|| random.normal()));
        assert!(mean.abs() < 0.03 && (variance - 1.0).abs() < 0.04);
    }
}
