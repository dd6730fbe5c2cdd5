//! Shadows on the floor.

use crate::body::{Body, Shape, to_local};

/// Light that does not arrive.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shadow {
    pub(crate) shape: Shape,
    /// Centre, pixels.
    pub(crate) at: [f32; 2],
    pub(crate) heading_rad: f32,
    /// Share of the light that is left, red, green and blue.
    pub(crate) left: [f32; 3],
    /// Width of the edge over which the light fades.
    pub(crate) penumbra_px: f32,
}

/// Same colour as the light.
pub(crate) fn neutral(left: f32) -> [f32; 3] {
    [left; 3]
}

/// What the sky leaves where the sun is covered: blue is 7 % stronger against red than in the
/// light.
pub(crate) fn bluish(left: f32) -> [f32; 3] {
    [0.975 * left, left, 1.043 * left]
}

impl Shadow {
    /// The shadow that a body throws, shifted by an offset.
    pub(crate) fn of(body: &Body, offset: [f32; 2], left: [f32; 3], penumbra_px: f32) -> Self {
        Self {
            shape: body.shape,
            at: [body.at[0] + offset[0], body.at[1] + offset[1]],
            heading_rad: body.heading_rad,
            left,
            penumbra_px,
        }
    }

    /// How much of the source is covered, seen from points of the picture: 0 to 1.
    pub(crate) fn covered(self) -> impl Fn([f32; 2]) -> f32 {
        let local = to_local(self.at, self.heading_rad);
        move |point| {
            let distance = self.shape.distance(local(point));
            if self.penumbra_px > 0.0 {
                (0.5 - distance / self.penumbra_px).clamp(0.0, 1.0)
            } else {
                f32::from(u8::from(distance <= 0.0))
            }
        }
    }

    /// Greatest distance from the centre at which light is missing.
    pub(crate) fn reach(&self) -> f32 {
        self.shape.reach() + self.penumbra_px / 2.0
    }
}
