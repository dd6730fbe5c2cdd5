//! Obstacles in which markers were searched for in vain. They are not searched in every way again in
//! every frame.

use fourier::contour::Region;

use super::MAX_DETECTIONS;
use super::attempt::Attempt;
use crate::settings::frames_in;

/// A shape is searched in every way for this long.
const PATIENCE_S: f64 = 0.5;

/// A shape is the same as one of the frame before if its centre moved by no more than this share of
/// its width and a number of pixels.
const MOVED: (f32, f32) = (0.25, 2.0);

/// The same for the width, since the first of the searches. Something else may be in the shape if it
/// changed.
const GROWN: (f32, f32) = (0.03, 1.0);

/// A shape that was searched in vain.
#[derive(Debug, Clone, Copy)]
pub(super) struct InVain {
    centre: [f32; 2],
    /// Square root of the area at the first search.
    width_px: f32,
    /// Number of frames since then.
    frames: u32,
}

/// Memory of the frame before, and of this one.
#[derive(Debug)]
pub(super) struct SearchedShapes {
    patience: u32,
    before: Vec<InVain>,
    now: Vec<InVain>,
}

impl SearchedShapes {
    pub(super) fn new(rate_hz: f64) -> Self {
        Self {
            patience: frames_in(PATIENCE_S, rate_hz),
            before: Vec::with_capacity(MAX_DETECTIONS),
            now: Vec::with_capacity(MAX_DETECTIONS),
        }
    }

    /// Begins a frame.
    pub(super) fn begin_frame(&mut self) {
        std::mem::swap(&mut self.before, &mut self.now);
        self.now.clear();
    }

    /// How long a shape was searched in vain, including this frame.
    pub(super) fn in_vain(&self, region: &Region) -> InVain {
        let width_px = width_px(region);
        let is_same = |before: &&InVain| {
            let [dx, dy] = [0, 1].map(|i| region.centre[i] - before.centre[i]);
            let limit = |(share, px): (f32, f32)| share * before.width_px + px;
            dx.hypot(dy) <= limit(MOVED) && (width_px - before.width_px).abs() <= limit(GROWN)
        };
        let before = self.before.iter().find(is_same);
        InVain {
            centre: region.centre,
            width_px: before.map_or(width_px, |before| before.width_px),
            frames: before.map_or(0, |before| before.frames.saturating_add(1)),
        }
    }

    /// The ways in which a shape is searched in this frame: all of them, or the first one and one of
    /// the others in turn.
    pub(super) fn attempts(&self, in_vain: &InVain) -> impl Iterator<Item = Attempt> + use<> {
        let [first, others @ ..] = Attempt::ALL;
        let in_turn = in_vain.frames as usize % others.len();
        let is_new = in_vain.frames < self.patience;
        let wanted = others.into_iter().enumerate();
        let wanted = wanted.filter(move |&(i, _)| is_new || i == in_turn);
        std::iter::once(first).chain(wanted.map(|(_, attempt)| attempt))
    }

    /// Adds a shape in which no marker was found.
    pub(super) fn add(&mut self, in_vain: InVain) {
        if self.now.len() < MAX_DETECTIONS {
            self.now.push(in_vain);
        }
    }
}

fn width_px(region: &Region) -> f32 {
    region.area.max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attempts(shapes: &mut SearchedShapes, centre: [f32; 2], width: f32) -> usize {
        shapes.begin_frame();
        let area = width * width;
        let in_vain = shapes.in_vain(&Region { centre, area });
        shapes.add(in_vain);
        shapes.attempts(&in_vain).count()
    }

    #[test]
    fn a_shape_is_searched_in_every_way_until_patience_ends_or_it_changes() {
        let mut shapes = SearchedShapes::new(10.0);
        for frame in 0..5 {
            assert_eq!(attempts(&mut shapes, [9.0, 9.0], 40.0), 4, "frame {frame}");
        }
        assert_eq!(attempts(&mut shapes, [12.0, 9.0], 41.0), 2, "moves");
        assert_eq!(attempts(&mut shapes, [12.0, 9.0], 42.0), 2);
        assert_eq!(attempts(&mut shapes, [12.0, 9.0], 43.0), 4, "grew slowly");
        assert_eq!(attempts(&mut shapes, [90.0, 9.0], 43.0), 4, "elsewhere");
    }

    #[test]
    fn three_frames_search_in_every_way() {
        let mut shapes = SearchedShapes::new(1.0);
        let region = Region {
            centre: [5.0; 2],
            area: 100.0,
        };
        let mut ways = Vec::new();
        for _ in 0..4 {
            shapes.begin_frame();
            let in_vain = shapes.in_vain(&region);
            shapes.add(in_vain);
            let attempts = shapes.attempts(&in_vain).skip(1);
            ways.push(attempts.map(|way| format!("{way:?}")).collect::<Vec<_>>());
        }
        let mut in_turn = ways[1..].concat();
        in_turn.sort();
        let mut all = ways[0].clone();
        all.sort();
        assert_eq!(in_turn, all);
    }
}
