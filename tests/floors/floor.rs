//! Floors without anything on them: their colour under full, even light.

use imgproc::Size;

use crate::canvas::blur;
use crate::random::{at_point, smooth};

/// What a floor is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Floor {
    /// One grey.
    Grey,
    /// One colour.
    Lino,
    /// Planks of several tones with grain, gaps and knots.
    Wood,
    /// Two tones of tiles, slightly mottled, with joints.
    Tiles,
    /// Strong fine grain.
    Carpet,
    /// Strong fine grain in a strong colour.
    RedCarpet,
    /// Weak texture at several scales.
    Concrete,
}

impl Floor {
    pub(crate) const ALL: [Self; 7] = [
        Self::Grey,
        Self::Lino,
        Self::Wood,
        Self::Tiles,
        Self::Carpet,
        Self::RedCarpet,
        Self::Concrete,
    ];

    /// Its pixels as a lens shows them.
    pub(crate) fn pixels(self, size: Size) -> Vec<[f32; 3]> {
        let mut pixels: Vec<_> = (0..size.area())
            .map(|i| {
                let [r, g, b] = self.colour((i % size.width) as i64, (i / size.width) as i64);
                [r, g, b, 0.0]
            })
            .collect();
        blur(&mut pixels, size.width);
        pixels.into_iter().map(|[r, g, b, _]| [r, g, b]).collect()
    }

    fn colour(self, x: i64, y: i64) -> [f32; 3] {
        let (fx, fy) = (x as f32, y as f32);
        match self {
            Self::Grey => [120.0; 3],
            Self::Lino => [92.0, 128.0, 108.0],
            Self::Wood => wood(x, y),
            Self::Tiles => tiles(x, y),
            Self::Carpet => {
                let grain = 0.32 * at_point(20, x, y) + 0.10 * smooth(21, fx / 3.0, fy / 3.0);
                [118.0, 114.0, 108.0].map(|c| c * (1.0 + grain))
            }
            Self::RedCarpet => {
                let grain = 0.28 * at_point(22, x, y) + 0.10 * smooth(23, fx / 3.0, fy / 3.0);
                let tint = 0.08 * at_point(24, x, y);
                [
                    146.0 * (1.0 + grain),
                    62.0 * (1.0 + grain + tint),
                    58.0 * (1.0 + grain - tint),
                ]
            }
            Self::Concrete => {
                let mottled = 0.05 * smooth(30, fx / 60.0, fy / 60.0)
                    + 0.05 * smooth(31, fx / 11.0, fy / 11.0)
                    + 0.06 * smooth(32, fx / 3.0, fy / 3.0)
                    + 0.06 * at_point(33, x, y);
                [134.0, 132.0, 126.0].map(|c| c * (1.0 + mottled))
            }
        }
    }
}

/// Planks of 46 by about 210 px.
fn wood(x: i64, y: i64) -> [f32; 3] {
    let (row, across) = (y.div_euclid(46), y.rem_euclid(46));
    let along = x + (150.0 * at_point(1, row, 0)) as i64;
    let (plank, end) = (along.div_euclid(210), along.rem_euclid(210));
    if across == 0 || end == 0 {
        return [58.0, 42.0, 28.0];
    }
    let tone = 0.16 * at_point(2, row, plank);
    let (fx, fy) = (along as f32, y as f32);
    let grain = 0.12 * smooth(3 + row as u64, fx / 40.0, fy / 2.2)
        + 0.08 * smooth(4, fx / 9.0, fy / 1.3)
        + 0.04 * at_point(5, x, y);
    let knot = [
        plank as f32 * 210.0 + 105.0 + 80.0 * at_point(6, row, plank),
        row as f32 * 46.0 + 23.0 + 12.0 * at_point(7, row, plank),
    ];
    let distance = (fx - knot[0]).hypot(1.6 * (fy - knot[1]));
    let knotty = at_point(8, row, plank) > 0.2;
    let dark = if knotty {
        0.45 * (-(distance / 6.0).powi(2)).exp()
    } else {
        0.0
    };
    [168.0, 126.0, 82.0].map(|c| c * (1.0 + tone + grain - dark))
}

/// Tiles of 54 px with joints of 3 px.
fn tiles(x: i64, y: i64) -> [f32; 3] {
    let (column, row) = (x.div_euclid(54), y.div_euclid(54));
    let joint = x.rem_euclid(54) < 3 || y.rem_euclid(54) < 3;
    let mottled = 0.06 * smooth(10, x as f32 / 7.0, y as f32 / 7.0)
        + 0.05 * smooth(12, x as f32 / 2.0, y as f32 / 2.0)
        + 0.05 * at_point(11, x, y);
    let colour = match (joint, (column + row).rem_euclid(2)) {
        (true, _) => [92.0, 88.0, 84.0],
        (false, 0) => [172.0, 168.0, 156.0],
        (false, _) => [138.0, 122.0, 108.0],
    };
    colour.map(|c: f32| c * (1.0 + mottled))
}
