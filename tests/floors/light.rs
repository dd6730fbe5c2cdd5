//! The light on everything, and the camera's gain, which looks the same.

/// Factors by which grey values differ from those under full, even light.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Light {
    /// Red, green and blue.
    pub(crate) gain: [f32; 3],
    /// Change across the picture from left to right and from top to bottom, as a share of the middle.
    pub(crate) slope: [f32; 2],
    /// Strength of a second lamp near the top left corner: share added beneath it.
    pub(crate) lamp: f32,
}

impl Light {
    pub(crate) const EVEN: Self = Self {
        gain: [1.0; 3],
        slope: [0.0; 2],
        lamp: 0.0,
    };

    /// Everything brighter or darker.
    pub(crate) fn exposure(factor: f32) -> Self {
        Self {
            gain: [factor; 3],
            ..Self::EVEN
        }
    }

    /// Factor, the same for all colours, at a place given in shares of the width and height.
    pub(crate) fn field(&self, x: f32, y: f32) -> f32 {
        let slope = 1.0 + self.slope[0] * (x - 0.5) + self.slope[1] * (y - 0.5);
        if self.lamp == 0.0 {
            return slope;
        }
        let distance2 = (x - 0.2).powi(2) + (y - 0.3).powi(2);
        slope * (1.0 + self.lamp * (-distance2 / 0.18).exp())
    }
}
