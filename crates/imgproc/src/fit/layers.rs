//! Pictures of a shape at several blurs, with interpolation between them.

/// A shape's picture at several blurs. Each layer is a square grid of samples over the plate and
/// its surroundings.
#[derive(Debug, Clone, Copy)]
pub struct Layers<'a> {
    /// Layer by layer, row by row: coverage by the shape, 0 to 1.
    pub samples: &'a [f32],
    /// Samples per row, and rows per layer.
    pub side: usize,
    /// Samples per side of the plate, whose centre is in the middle of the grid.
    pub per_plate: f32,
    /// Standard deviation of the first layer's blur, in units of the plate's side.
    pub first_blur: f32,
    /// Ratio of a layer's blur to that of the layer before.
    pub blur_ratio: f32,
}

impl Layers<'_> {
    /// Number of layers.
    ///
    /// # Panics
    ///
    /// If there are fewer than two, or not a whole number of them.
    fn count(&self) -> usize {
        let n = self.samples.len() / (self.side * self.side);
        assert!(
            n >= 2 && self.samples.len() == n * self.side * self.side,
            "the layers hold {} samples, not two or more times {} x {1}",
            self.samples.len(),
            self.side
        );
        n
    }

    /// The layers on both sides of a blur, given as standard deviation in units of the plate's
    /// side.
    pub(super) fn at_blur(&self, blur: f32) -> Blend<'_> {
        let Layers { samples, side, .. } = *self;
        let n = self.count();
        let layers_per_ln = 1.0 / libm::logf(self.blur_ratio);
        let layer = libm::logf(blur / self.first_blur) * layers_per_ln;
        let layer = layer.clamp(0.0, (n - 1) as f32);
        let below = (layer as usize).min(n - 2);
        let area = side * side;
        let (sharp, softer) = samples[below * area..(below + 2) * area].split_at(area);
        Blend {
            sharp,
            softer,
            share: layer - below as f32,
            layers_per_ln,
            side,
            per_plate: self.per_plate,
            middle: (side - 1) as f32 / 2.0,
        }
    }
}

/// Two neighbouring layers.
pub(super) struct Blend<'a> {
    sharp: &'a [f32],
    softer: &'a [f32],
    /// Weight of the softer layer.
    share: f32,
    layers_per_ln: f32,
    side: usize,
    per_plate: f32,
    middle: f32,
}

impl Blend<'_> {
    /// Coverage at a point of the plate, and its derivatives with respect to u, v and the logarithm
    /// of the blur. `None` outside the grid. Bilinear between samples; the derivatives are those of
    /// the interpolation.
    #[inline(always)]
    pub(super) fn coverage(&self, u: f32, v: f32) -> Option<[f32; 4]> {
        let (first, x, y) = self.cell(u, v)?;
        let taps = |layer: &[f32]| {
            let [above, below] = [first, first + self.side].map(|i| &layer[i..i + 2]);
            [above[0], above[1], below[0], below[1]]
        };
        let (sharp, softer) = (taps(self.sharp), taps(self.softer));
        let more: [f32; 4] = core::array::from_fn(|i| softer[i] - sharp[i]);
        let mixed: [f32; 4] = core::array::from_fn(|i| sharp[i] + self.share * more[i]);
        let [t, tu, tv] = between(mixed, x, y);
        let [tblur, ..] = between(more, x, y);
        let (tu, tv) = (tu * self.per_plate, tv * self.per_plate);
        Some([t, tu, tv, tblur * self.layers_per_ln])
    }
}

impl Blend<'_> {
    /// Second derivatives of the coverage with respect to u twice, u and v, and v twice, from
    /// differences over `apart`. Zero near the border of the grid.
    pub(super) fn bends(&self, u: f32, v: f32, apart: f32) -> [f32; 3] {
        let at = |du: f32, dv: f32| self.value(u + du * apart, v + dv * apart);
        let all = || {
            let here = at(0.0, 0.0)?;
            let uu = at(-1.0, 0.0)? + at(1.0, 0.0)? - 2.0 * here;
            let vv = at(0.0, -1.0)? + at(0.0, 1.0)? - 2.0 * here;
            let rising = at(-1.0, -1.0)? + at(1.0, 1.0)?;
            let falling = at(-1.0, 1.0)? + at(1.0, -1.0)?;
            Some([uu, (rising - falling) / 4.0, vv])
        };
        all().map_or([0.0; 3], |bends| bends.map(|b| b / (apart * apart)))
    }

    /// Index of the sample above and to the left of a point of the plate, and how far the point is
    /// from it, 0 to 1. `None` outside the grid.
    #[inline(always)]
    fn cell(&self, u: f32, v: f32) -> Option<(usize, f32, f32)> {
        let (x, y) = (
            u * self.per_plate + self.middle,
            v * self.per_plate + self.middle,
        );
        // The cast rounds towards zero, so points left of the first column must be rejected before.
        if !(x >= 0.0 && y >= 0.0) {
            return None;
        }
        let (column, row) = (x as u32 as usize, y as u32 as usize);
        if column + 1 >= self.side || row + 1 >= self.side {
            return None;
        }
        let first = row * self.side + column;
        Some((first, x - column as u32 as f32, y - row as u32 as f32))
    }

    /// Coverage at a point of the plate; `None` outside the grid.
    #[inline(always)]
    fn value(&self, u: f32, v: f32) -> Option<f32> {
        let (first, x, y) = self.cell(u, v)?;
        let of = |layer: &[f32]| {
            let (a, b) = (layer[first], layer[first + 1]);
            let (c, d) = (layer[first + self.side], layer[first + self.side + 1]);
            let (above, below) = (a + x * (b - a), c + x * (d - c));
            above + y * (below - above)
        };
        let sharp = of(self.sharp);
        Some(sharp + self.share * (of(self.softer) - sharp))
    }
}

/// Bilinear interpolation between four samples, and its slopes in x and y.
#[inline(always)]
fn between([a, b, c, d]: [f32; 4], x: f32, y: f32) -> [f32; 3] {
    let (above, below) = (a + x * (b - a), c + x * (d - c));
    let across = (b - a) + y * ((d - c) - (b - a));
    [above + y * (below - above), across, below - above]
}
