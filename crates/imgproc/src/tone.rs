//! Tone curves: from light to grey levels.
//!
//! A lens mixes light. Cameras store about the square root of it, so half of the light between black
//! and white is not the grey level half-way between theirs. An edge that is taken to be where the
//! grey level is half-way is then displaced towards the dark side, by a fifth of a pixel at a gamma
//! of 2.2.

/// Below this grey level a curve is a straight line, as in sRGB: the slope of a power would become
/// infinite.
const STRAIGHT_BELOW: f32 = 5.0;

/// Largest grey level, and the light that it shows.
const WHITE: f32 = 255.0;

/// A tone curve: grey levels are a power of the light. Both have a range of 0 to 255; values outside
/// are extrapolated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToneCurve {
    exponent: f32,
    /// The end of the straight part: light, and grey levels per light.
    straight_light: f32,
    straight_slope: f32,
}

/// What a camera shows of some light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Shown {
    pub(crate) grey: f32,
    /// Derivatives with respect to light and exponent.
    pub(crate) per_light: f32,
    pub(crate) per_exponent: f32,
}

/// The light that a grey level shows.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Lit {
    pub(crate) light: f32,
    /// Derivatives with respect to grey level and exponent.
    pub(crate) per_grey: f32,
    pub(crate) per_exponent: f32,
}

impl ToneCurve {
    /// The curve with an exponent; 1 is linear, 1 / 2.2 that of most cameras.
    ///
    /// # Panics
    ///
    /// If the exponent is not positive.
    #[must_use]
    pub fn new(exponent: f32) -> Self {
        assert!(exponent > 0.0, "an exponent must be positive");
        let straight_light = WHITE * libm::powf(STRAIGHT_BELOW / WHITE, 1.0 / exponent);
        Self {
            exponent,
            straight_light,
            straight_slope: exponent * STRAIGHT_BELOW / straight_light,
        }
    }

    /// The light that a grey level shows.
    #[must_use]
    pub fn light(&self, grey: f32) -> f32 {
        self.lit(grey).light
    }

    /// The grey level of some light.
    #[must_use]
    pub fn grey(&self, light: f32) -> f32 {
        self.shown(light).grey
    }

    /// The grey level of light half-way between that of two grey levels.
    #[must_use]
    pub fn half_way(&self, dark: f32, light: f32) -> f32 {
        self.grey(0.5 * (self.light(dark) + self.light(light)))
    }

    #[inline]
    pub(crate) fn lit(&self, grey: f32) -> Lit {
        let power = grey.max(STRAIGHT_BELOW);
        let ln = libm::logf(power / WHITE);
        let light = WHITE * libm::expf(ln / self.exponent);
        let per_grey = light / (self.exponent * power);
        Lit {
            light: light + per_grey * (grey - power),
            per_grey,
            per_exponent: -light * ln / (self.exponent * self.exponent),
        }
    }

    #[inline(always)]
    pub(crate) fn shown(&self, light: f32) -> Shown {
        let is_power = light > self.straight_light;
        let power = if is_power { light } else { self.straight_light };
        let ln = libm::logf(power / WHITE);
        let grey = WHITE * libm::expf(self.exponent * ln);
        let per_light = if is_power {
            self.exponent * grey / light
        } else {
            self.straight_slope
        };
        Shown {
            grey: grey + per_light * (light - power),
            per_light,
            per_exponent: grey * ln,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exponent_of_one_changes_nothing() {
        let linear = ToneCurve::new(1.0);
        for grey in [-20.0, 0.0, 3.0, 5.0, 40.0, 127.5, 255.0, 300.0] {
            assert!((linear.grey(grey) - grey).abs() < 1e-3);
            assert!((linear.light(grey) - grey).abs() < 1e-3);
        }
        assert!((linear.half_way(40.0, 220.0) - 130.0).abs() < 1e-3);
    }

    #[test]
    fn half_of_the_light_is_a_light_grey() {
        let camera = ToneCurve::new(1.0 / 2.2);
        // 255 · 0.5^(1 / 2.2).
        assert!((camera.half_way(0.0, 255.0) - 186.1).abs() < 0.5);
    }

    #[test]
    fn light_and_grey_are_inverse_and_have_these_slopes() {
        for exponent in [0.4, 0.7, 1.0, 1.2] {
            let curve = ToneCurve::new(exponent);
            let [less, more] = [-1e-3, 1e-3].map(|d| ToneCurve::new(exponent + d));
            for grey in [-10.0, 2.0, 6.0, 30.0, 127.0, 250.0] {
                let lit = curve.lit(grey);
                let shown = curve.shown(lit.light);
                assert!((shown.grey - grey).abs() < 2e-3, "{exponent}, {grey}");
                assert!((shown.per_light * lit.per_grey - 1.0).abs() < 1e-3);
                let step = 0.01 * lit.light.abs().max(0.01);
                let slope = (curve.grey(lit.light + step) - curve.grey(lit.light - step)) / step;
                assert!((0.5 * slope / shown.per_light - 1.0).abs() < 1e-2);
                if grey > STRAIGHT_BELOW {
                    let of_exponent = (more.grey(lit.light) - less.grey(lit.light)) / 2e-3;
                    assert!((of_exponent - shown.per_exponent).abs() < 0.1);
                    let of_exponent = (more.light(grey) - less.light(grey)) / 2e-3;
                    assert!((of_exponent - lit.per_exponent).abs() < 0.1 + 0.01 * lit.light);
                }
            }
        }
    }
}
