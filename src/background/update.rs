//! The background that frames are compared with, kept up to date.
//!
//! The background changes in four ways, none of which can absorb a parked robot:
//!
//! * Where the floor is visible, it follows the frames slowly ([`BackgroundUpdate::follow`]). Where
//!   it is covered, it is scaled like the floor next to it: light that moves across a room also
//!   moves across the floor under a robot.
//! * When the illumination has changed abruptly, a coarse field of ratios is fitted to all
//!   uncovered pixels ([`BackgroundUpdate::relight`]). The background before the change is
//!   remembered, and restored when its illumination returns ([`BackgroundUpdate::recall`]).
//! * A place that an object has left is copied from the frame ([`BackgroundUpdate::take`]).
//! * A new picture replaces everything ([`BackgroundUpdate::set`]).

use imgproc::difference::{Colour, Gains, NoiseSettings, Reference, ReferenceMut, prepare};
use imgproc::{Bounds, Size};

use crate::background::illumination::fit;
use crate::background::model::BackgroundModel;
use crate::image::frame::Picture;
use crate::settings::frames_in;

/// Every row is updated once in this time: 32 frames at 30 frames per second.
const ROUND_S: f64 = 32.0 / 30.0;

/// An update moves the background towards the frame by 1/`FOLLOW` of the difference.
const FOLLOW: i32 = 16;

/// Maximum step of an update, in 256ths of a level: a quarter of a level.
const FOLLOW_MAX: i32 = 64;

/// Side of the cells over which the illumination is treated as uniform, in pixels.
const CELL: usize = 32;

/// Maximum number of cells in a row or column; larger pictures have larger cells.
const CELLS_MAX: usize = 32;

/// A cell has a ratio of its own if at least one in this many of its pixels is visible.
const SEEN_MIN: usize = 4;

/// A remembered background must explain this much more of a frame, as a share of the picture.
const RECALL_MIN: f32 = 0.1;

/// A background explains a pixel if they differ by less than this many levels.
const SAME_WITHIN: f32 = 6.0;

/// One pixel in this many is tested for whether the background explains it; not a divisor of common
/// image widths.
const SAME_STRIDE: usize = 37;

/// Normal variation of floor pixels, see [`NoiseSettings`].
const NOISE: NoiseSettings = NoiseSettings {
    min: 1.5,
    light: 0.01,
    colour: 0.015,
    displacement_px: 0.5,
};

/// The background, with the derived data needed for comparison.
#[derive(Debug)]
pub(crate) struct BackgroundUpdate {
    size: Size,
    /// Red, green and blue in 256ths of a level.
    channels: [Vec<u16>; 3],
    /// The background before the last change of illumination, if `remembers`.
    remembered: [Vec<u16>; 3],
    remembers: bool,
    noise: Vec<u8>,
    level: Vec<u16>,
    red_share: Vec<u16>,
    blue_share: Vec<u16>,
    light_scale: Vec<i16>,
    colour_scale: Vec<i16>,
    /// Rows that are updated in a frame, and the first one of the next frame.
    band_rows: usize,
    next_row: usize,
}

impl BackgroundUpdate {
    pub(crate) fn new(floor: &BackgroundModel, rate_hz: f64) -> Self {
        let size = floor.picture.size;
        let fine = || vec![0u16; size.area()];
        let mut update = Self {
            size,
            channels: [fine(), fine(), fine()],
            remembered: [fine(), fine(), fine()],
            remembers: false,
            noise: vec![0; size.area()],
            level: fine(),
            red_share: fine(),
            blue_share: fine(),
            light_scale: vec![0; size.area()],
            colour_scale: vec![0; size.area()],
            band_rows: size.height.div_ceil(frames_in(ROUND_S, rate_hz) as usize),
            next_row: 0,
        };
        update.set(floor);
        update
    }

    /// Resets everything to this background.
    ///
    /// # Panics
    ///
    /// If its size differs.
    pub(crate) fn set(&mut self, floor: &BackgroundModel) {
        let picture = &floor.picture;
        assert_eq!(picture.size, self.size, "a floor has another size");
        let planes = [&picture.red, &picture.green, &picture.blue];
        for (channel, plane) in self.channels.iter_mut().zip(planes) {
            for (value, &level) in channel.iter_mut().zip(plane) {
                *value = u16::from(level) << 8;
            }
        }
        self.noise.copy_from_slice(&floor.noise);
        self.next_row = 0;
        self.remembers = false;
        self.prepare(0, self.size.height);
    }

    /// The current background, rounded to whole levels.
    pub(crate) fn floor(&self) -> BackgroundModel {
        let [red, green, blue] = [0, 1, 2].map(|i: usize| {
            let levels = self.channels[i].iter();
            levels.map(|&value| rounded(value)).collect()
        });
        BackgroundModel {
            picture: Picture {
                size: self.size,
                red,
                green,
                blue,
            },
            noise: self.noise.clone(),
        }
    }

    /// Copies the current background, in the light of `gains`, to wherever a mask is set.
    pub(crate) fn copy_floor(&self, gains: Gains, mask: &[u8], to: &mut BackgroundModel) {
        let Picture {
            red, green, blue, ..
        } = &mut to.picture;
        let gains = [gains.red, gains.green, gains.blue];
        for ((to, current), gain) in [red, green, blue]
            .into_iter()
            .zip(&self.channels)
            .zip(gains)
        {
            for ((to, &value), &mask) in to.iter_mut().zip(current).zip(mask) {
                if mask != 0 {
                    let lit = f32::from(rounded(value)) * gain;
                    *to = lit.round().clamp(0.0, 255.0) as u8;
                }
            }
        }
        for ((to, &noise), &mask) in to.noise.iter_mut().zip(&self.noise).zip(mask) {
            if mask != 0 {
                *to = noise;
            }
        }
    }

    /// The reference that frames are compared with.
    pub(crate) fn reference(&self) -> Reference<'_> {
        Reference {
            level: &self.level,
            red_share: &self.red_share,
            blue_share: &self.blue_share,
            light_scale: &self.light_scale,
            colour_scale: &self.colour_scale,
        }
    }

    /// Red, green and blue in 256ths of a level.
    pub(crate) fn channels(&self) -> &[Vec<u16>; 3] {
        &self.channels
    }

    /// Keeps a copy of the background for when its illumination returns.
    pub(crate) fn remember(&mut self) {
        for (kept, channel) in self.remembered.iter_mut().zip(&self.channels) {
            kept.copy_from_slice(channel);
        }
        self.remembers = true;
    }

    /// Swaps the background with the remembered one if that explains more of the frame. Returns
    /// whether it did.
    pub(crate) fn recall(&mut self, frame: &Picture, covered: &[u8]) -> bool {
        let better = self.remembers
            && share_alike(frame, &self.remembered, covered)
                > share_alike(frame, &self.channels, covered) + RECALL_MIN;
        if better {
            std::mem::swap(&mut self.channels, &mut self.remembered);
            self.prepare(0, self.size.height);
        }
        better
    }

    /// Updates a band of rows from the frame where `covered` is 0; covered pixels are scaled like
    /// their neighbours.
    pub(crate) fn follow(&mut self, frame: &Picture, gains: Gains, covered: &[u8]) {
        let Size { width, height } = self.size;
        let first = self.next_row;
        let end = (first + self.band_rows).min(height);
        self.next_row = if end == height { 0 } else { end };
        let to_floor = [gains.red, gains.green, gains.blue].map(|gain| 256.0 / gain.max(0.05));
        let planes = [&frame.red, &frame.green, &frame.blue];
        for ((channel, plane), to_floor) in self.channels.iter_mut().zip(planes).zip(to_floor) {
            let mut band = (0u64, 0u64);
            // The ratio of the band is complete only after its last cell; fully covered cells use
            // the ratio so far.
            for start in (0..width).step_by(CELL) {
                let columns = start..(start + CELL).min(width);
                let (mut before, mut after, mut seen) = (0u64, 0u64, 0usize);
                for y in first..end {
                    for i in y * width + columns.start..y * width + columns.end {
                        if covered[i] == 0 && plane[i] < 250 {
                            let old = i32::from(channel[i]);
                            let new = (f32::from(plane[i]) * to_floor).min(65280.0) as i32;
                            let step = ((new - old) / FOLLOW).clamp(-FOLLOW_MAX, FOLLOW_MAX);
                            channel[i] = (old + step) as u16;
                            before += old as u64;
                            after += (old + step) as u64;
                            seen += 1;
                        }
                    }
                }
                band = (band.0 + before, band.1 + after);
                if seen * SEEN_MIN < columns.len() * (end - first) {
                    (before, after) = band;
                }
                if before == 0 || before == after {
                    continue;
                }
                for y in first..end {
                    for i in y * width + columns.start..y * width + columns.end {
                        if covered[i] != 0 {
                            let scaled = (u64::from(channel[i]) * after + before / 2) / before;
                            channel[i] = scaled.min(65280) as u16;
                        }
                    }
                }
            }
        }
        self.prepare(first, end);
    }

    /// Fits the background to a changed spatial distribution of light: a smooth field of ratios per
    /// channel, estimated from all uncovered pixels.
    pub(crate) fn relight(&mut self, frame: &Picture, gains: Gains, covered: &[u8]) {
        let Size { width, height } = self.size;
        let cell = CELL.max(width.max(height).div_ceil(CELLS_MAX));
        let (columns, rows) = (width.div_ceil(cell), height.div_ceil(cell));
        let inverse = [gains.red, gains.green, gains.blue].map(|gain| 256.0 / gain.max(0.05));
        let planes = [&frame.red, &frame.green, &frame.blue];
        for ((channel, plane), inverse) in self.channels.iter_mut().zip(planes).zip(inverse) {
            let mut ratios = [[None; CELLS_MAX]; CELLS_MAX];
            for (row, ratios) in ratios[..rows].iter_mut().enumerate() {
                for (column, ratio) in ratios[..columns].iter_mut().enumerate() {
                    let (mut floor, mut seen, mut n, mut all) = (0u64, 0f32, 0, 0);
                    for y in row * cell..((row + 1) * cell).min(height) {
                        for x in column * cell..((column + 1) * cell).min(width) {
                            let i = y * width + x;
                            all += 1;
                            if covered[i] == 0 && plane[i] < 250 {
                                floor += u64::from(channel[i]);
                                seen += f32::from(plane[i]) * inverse;
                                n += 1;
                            }
                        }
                    }
                    *ratio =
                        (n * 2 >= all && floor > 0).then(|| (seen / floor as f32).clamp(0.25, 4.0));
                }
            }
            let smooth = smoothed(&ratios, columns, rows);
            for y in 0..height {
                for x in 0..width {
                    let at = |v: usize, n: usize| {
                        ((v as f32 + 0.5) / cell as f32 - 0.5).clamp(0.0, (n - 1) as f32)
                    };
                    let (cx, cy) = (at(x, columns), at(y, rows));
                    let (x0, y0) = (cx as usize, cy as usize);
                    let (x1, y1) = ((x0 + 1).min(columns - 1), (y0 + 1).min(rows - 1));
                    let (fx, fy) = (cx - x0 as f32, cy - y0 as f32);
                    let upper = smooth[y0][x0] * (1.0 - fx) + smooth[y0][x1] * fx;
                    let lower = smooth[y1][x0] * (1.0 - fx) + smooth[y1][x1] * fx;
                    let value = &mut channel[y * width + x];
                    let scaled = f32::from(*value) * (upper * (1.0 - fy) + lower * fy);
                    *value = scaled.min(65280.0) as u16;
                }
            }
        }
        self.prepare(0, height);
    }

    /// Copies the frame into the background within `bounds` where `shape`, a plane of the size of
    /// `bounds`, is not 0.
    pub(crate) fn take(&mut self, frame: &Picture, gains: Gains, bounds: Bounds, shape: &[u8]) {
        let inverse = [gains.red, gains.green, gains.blue].map(|gain| 256.0 / gain.max(0.05));
        let planes = [&frame.red, &frame.green, &frame.blue];
        let width = bounds.size().width;
        for ((channel, plane), inverse) in self.channels.iter_mut().zip(planes).zip(inverse) {
            for (y, row) in shape.chunks_exact(width).enumerate() {
                let start =
                    (usize::from(bounds.top) + y) * self.size.width + usize::from(bounds.left);
                for (i, _) in row.iter().enumerate().filter(|(_, set)| **set != 0) {
                    let level = f32::from(plane[start + i]) * inverse;
                    channel[start + i] = level.min(65280.0) as u16;
                }
            }
        }
        let first = usize::from(bounds.top).saturating_sub(1);
        self.prepare(
            first,
            (usize::from(bounds.bottom) + 2).min(self.size.height),
        );
    }

    fn prepare(&mut self, first: usize, end: usize) {
        let [red, green, blue] = &self.channels;
        let floor = Colour { red, green, blue };
        let mut reference = ReferenceMut {
            level: &mut self.level,
            red_share: &mut self.red_share,
            blue_share: &mut self.blue_share,
            light_scale: &mut self.light_scale,
            colour_scale: &mut self.colour_scale,
        };
        prepare(
            floor,
            &self.noise,
            self.size,
            first..end,
            &mut reference,
            &NOISE,
        );
    }
}

/// Share of the pixels with `covered` 0 that a background explains, at any exposure.
fn share_alike(frame: &Picture, floor: &[Vec<u16>; 3], covered: &[u8]) -> f32 {
    let gains = fit(frame, floor, covered, Gains::NONE);
    let factors = [gains.red, gains.green, gains.blue].map(|gain| gain / 256.0);
    let planes = [&frame.red, &frame.green, &frame.blue];
    let alike = |i: usize| {
        planes
            .iter()
            .zip(floor)
            .zip(factors)
            .all(|((plane, floor), factor)| {
                let expected = f32::from(floor[i]) * factor;
                (f32::from(plane[i]) - expected.min(255.0)).abs() < SAME_WITHIN.max(0.06 * expected)
            })
    };
    let seen = (0..covered.len())
        .step_by(SAME_STRIDE)
        .filter(|&i| covered[i] == 0);
    let (n, n_alike) = seen.fold((0, 0), |(n, n_alike), i| {
        (n + 1, n_alike + u32::from(alike(i)))
    });
    n_alike as f32 / (n as f32).max(1.0)
}

/// The median of each cell and its neighbours, so that an object in one of them has no effect; 1
/// where unknown.
fn smoothed(
    ratios: &[[Option<f32>; CELLS_MAX]; CELLS_MAX],
    columns: usize,
    rows: usize,
) -> [[f32; CELLS_MAX]; CELLS_MAX] {
    let mut smooth = [[1.0; CELLS_MAX]; CELLS_MAX];
    for y in 0..rows {
        for x in 0..columns {
            let mut known = [0.0f32; 9];
            let mut n = 0;
            for row in &ratios[y.saturating_sub(1)..(y + 2).min(rows)] {
                for ratio in row[x.saturating_sub(1)..(x + 2).min(columns)]
                    .iter()
                    .flatten()
                {
                    known[n] = *ratio;
                    n += 1;
                }
            }
            known[..n].sort_unstable_by(f32::total_cmp);
            if n > 0 {
                smooth[y][x] = known[n / 2];
            }
        }
    }
    smooth
}

/// A level of 256ths, rounded to whole levels.
fn rounded(value: u16) -> u8 {
    ((u32::from(value) + 128) >> 8).min(255) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(level: u8) -> Picture {
        let size = Size {
            width: 8,
            height: 480,
        };
        let plane = vec![level; size.area()];
        Picture {
            size,
            red: plane.clone(),
            green: plane.clone(),
            blue: plane,
        }
    }

    #[test]
    fn a_floor_is_followed_for_as_long_at_every_frame_rate() {
        let floor = BackgroundModel {
            noise: vec![8; grey(0).size.area()],
            picture: grey(100),
        };
        let brighter = grey(104);
        let after = |rate_hz: f64, time_s: f64| {
            let mut update = BackgroundUpdate::new(&floor, rate_hz);
            for _ in 0..(rate_hz * time_s).round() as usize {
                update.follow(&brighter, Gains::NONE, &vec![0; floor.picture.size.area()]);
            }
            let sum: f64 = update.channels[0].iter().map(|&c| f64::from(c)).sum();
            sum / 256.0 / floor.picture.size.area() as f64
        };
        for time_s in [3.2, 10.7] {
            let usual = after(30.0, time_s);
            assert!(usual > 100.4, "{usual}");
            for rate_hz in [5.0, 12.0, 60.0] {
                let other = after(rate_hz, time_s);
                assert!(
                    (other - usual).abs() < 0.15,
                    "{rate_hz}/s: {other}, not {usual}"
                );
            }
        }
    }
}
