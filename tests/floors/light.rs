//! The light on everything, and the camera's gain, which looks the same.

/// Factors by which grey values differ from those under full, even light.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Light {
    /// Red, green and blue.
    pub(crate) gain: [f32; 3],
    /// Change across the picture from left to right and from top to bottom, as a share of the
    /// middle.
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

    /// Lights a row of pixels at a height given as a share of the picture's.
    pub(crate) fn fall_on(&self, row: &[[f32; 3]], y: f32, lit: &mut [[f32; 3]]) {
        let middle = 1.0 + self.slope[1] * (y - 0.5) - 0.5 * self.slope[0];
        let step = self.slope[0] / row.len() as f32;
        for (x, (lit, colour)) in lit.iter_mut().zip(row).enumerate() {
            let field = middle + step * x as f32;
            *lit = [
                colour[0] * self.gain[0] * field,
                colour[1] * self.gain[1] * field,
                colour[2] * self.gain[2] * field,
            ];
        }
        if self.lamp > 0.0 {
            for (x, lit) in lit.iter_mut().enumerate() {
                let distance2 = (x as f32 / row.len() as f32 - 0.2).powi(2) + (y - 0.3).powi(2);
                let more = 1.0 + self.lamp * (-distance2 / 0.18).exp();
                *lit = lit.map(|value| value * more);
            }
        }
    }
}
