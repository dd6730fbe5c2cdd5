//! Learns the empty floor from frames in which objects may move.
//!
//! For each pixel, the median over the frames is the background, and the spread about it is the
//! noise ([`imgproc::background`] and [`imgproc::noise`]). An object that covers a pixel in less
//! than half of the frames changes neither.
//!
//! # No long step at the end
//!
//! Computing a background takes as long as several frames, and frames must not queue up meanwhile.
//! So only the first five sixths of the frames are collected, and each frame of the last sixth
//! computes its share. For this, pixels are stored in tiles: the values of a tile in all frames are
//! contiguous, and a tile is computed independently of the others in memory that fits the L1 cache.
//! The result of a tile depends only on its frames, so the background does not depend on how the
//! work is divided.
//!
//! With fewer than six frames everything is computed with the last one.

use imgproc::Size;
use imgproc::background::median_of_frames;
use imgproc::median::median_3x3;
use imgproc::noise::{add_variance, mean_3x3};

use crate::background::model::{BackgroundModel, NOISE_STEPS};
use crate::image::frame::Picture;

/// Maximum number of frames kept; of more frames, every second, third, ... is kept. More would use
/// memory without adding information.
const KEPT_MAX: u32 = 64;

/// Minimum number of frames for an estimate of the noise; with fewer it stays unknown.
const KEPT_MIN_FOR_NOISE: usize = 8;

/// Number of pixels in a tile.
const TILE: usize = 256;

/// Learns a background. Allocates only when it is created: three bytes per pixel and kept frame, of
/// which there are at most 64.
#[derive(Debug)]
pub struct Learner {
    /// Total number of frames, at least one.
    frames: u32,
    /// Number of frames at the start that are collected; during the others the tiles are computed.
    collected: u32,
    seen: u32,
    /// One in `stride` frames is kept, starting with the first.
    stride: u32,
    capacity: usize,
    kept: usize,
    /// Red, green and blue, denoised: tile after tile, each with space for `capacity` frames in
    /// sequence.
    channels: [Vec<u8>; 3],
    tiles_done: usize,
    floor: BackgroundModel,
    /// Noise before smoothing.
    rough_noise: Vec<u8>,
    /// One plane of a frame.
    denoised: Vec<u8>,
}

impl Learner {
    /// A learner for `frames` frames, at least one.
    #[must_use]
    pub fn new(size: Size, frames: u32) -> Self {
        let frames = frames.max(1);
        let collected = frames - frames / 6;
        let stride = collected.div_ceil(KEPT_MAX);
        let capacity = collected.div_ceil(stride) as usize;
        let plane = || vec![0; size.area()];
        Self {
            frames,
            collected,
            seen: 0,
            stride,
            capacity,
            kept: 0,
            channels: [(); 3].map(|()| vec![0; capacity * size.area()]),
            tiles_done: 0,
            floor: BackgroundModel {
                picture: Picture::new(size),
                noise: plane(),
            },
            rough_noise: plane(),
            denoised: plane(),
        }
    }

    /// Number of frames added so far.
    #[must_use]
    pub fn seen(&self) -> u32 {
        self.seen
    }

    /// Number of frames needed.
    #[must_use]
    pub fn frames(&self) -> u32 {
        self.frames
    }

    /// Adds a frame. Returns true if it was the last one; then [`Learner::finish`] returns the
    /// background.
    ///
    /// # Panics
    ///
    /// If the size of the picture differs.
    pub fn add(&mut self, picture: &Picture) -> bool {
        assert_eq!(
            picture.size, self.floor.picture.size,
            "a frame to learn from has another size"
        );
        if self.seen < self.collected {
            if self.seen.is_multiple_of(self.stride) {
                self.keep(picture);
            }
            self.seen += 1;
        } else if self.seen < self.frames {
            self.seen += 1;
            let (step, steps) = (self.seen - self.collected, self.frames - self.collected);
            let share = u64::from(step) * self.n_tiles() as u64 / u64::from(steps);
            self.compute(share as usize);
        }
        self.seen == self.frames
    }

    /// The background from the frames added so far; `None` if there were none.
    #[must_use]
    pub fn finish(mut self) -> Option<BackgroundModel> {
        if self.kept == 0 {
            return None;
        }
        self.compute(self.n_tiles());
        mean_3x3(
            &self.rough_noise,
            self.floor.picture.size,
            &mut self.floor.noise,
        );
        Some(self.floor)
    }

    fn n_tiles(&self) -> usize {
        self.denoised.len().div_ceil(TILE)
    }

    fn keep(&mut self, picture: &Picture) {
        let planes = [&picture.red, &picture.green, &picture.blue];
        for (plane, kept) in planes.into_iter().zip(&mut self.channels) {
            median_3x3(plane, picture.size, &mut self.denoised);
            let tiles = kept.chunks_mut(self.capacity * TILE);
            for (values, tile) in self.denoised.chunks(TILE).zip(tiles) {
                let start = self.kept * values.len();
                tile[start..start + values.len()].copy_from_slice(values);
            }
        }
        self.kept += 1;
    }

    /// Computes the remaining tiles before index `end`.
    fn compute(&mut self, end: usize) {
        let Picture {
            red, green, blue, ..
        } = &mut self.floor.picture;
        for tile in self.tiles_done..end {
            let start = tile * TILE;
            let noise = &mut self.rough_noise[start..];
            let n = noise.len().min(TILE);
            let mut variance = [0.0; TILE];
            let variance = &mut variance[..n];
            for (median, frames) in [&mut *red, green, blue].into_iter().zip(&self.channels) {
                let median = &mut median[start..start + n];
                let frames = &frames[start * self.capacity..][..self.kept * n];
                median_of_frames(frames, median);
                add_variance(frames, median, variance);
            }
            if self.kept < KEPT_MIN_FOR_NOISE {
                continue;
            }
            for (noise, variance) in noise.iter_mut().zip(variance) {
                // A pixel that never changed has low noise, which differs from unknown noise.
                *noise = (NOISE_STEPS * (*variance / 3.0).sqrt()).round().max(1.0) as u8;
            }
        }
        self.tiles_done = end;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use random::SplitMix64;

    const SIZE: Size = Size {
        width: 40,
        height: 30,
    };

    fn grey(level: u8) -> Picture {
        let plane = vec![level; SIZE.area()];
        Picture {
            size: SIZE,
            red: plane.clone(),
            green: plane.clone(),
            blue: plane,
        }
    }

    /// A floor with a gradient, so that the noise is sampled at every fraction of a grey level.
    fn noisy_floor(random: &mut SplitMix64, sigma: f64) -> Picture {
        let mut picture = grey(0);
        for plane in [&mut picture.red, &mut picture.green, &mut picture.blue] {
            for (i, value) in plane.iter_mut().enumerate() {
                let level = 120.0 + 0.1 * (i % SIZE.width + i / SIZE.width) as f64;
                *value = (level + sigma * random.normal()).round() as u8;
            }
        }
        picture
    }

    /// Standard deviation of a denoised pixel, from many frames.
    fn denoised_sigma(sigma: f64) -> f64 {
        const FRAMES: usize = 300;
        let mut random = SplitMix64(99);
        let (mut sum, mut squares) = (vec![0.0; SIZE.area()], vec![0.0; SIZE.area()]);
        let mut denoised = vec![0; SIZE.area()];
        for _ in 0..FRAMES {
            median_3x3(&noisy_floor(&mut random, sigma).red, SIZE, &mut denoised);
            for (i, &value) in denoised.iter().enumerate() {
                sum[i] += f64::from(value);
                squares[i] += f64::from(value).powi(2);
            }
        }
        let n = FRAMES as f64;
        let variances = inner().map(|i| (squares[i] - sum[i] * sum[i] / n) / (n - 1.0));
        (variances.sum::<f64>() / inner().count() as f64).sqrt()
    }

    /// Pixels whose median and mean windows lie inside the picture.
    fn inner() -> impl Iterator<Item = usize> + Clone {
        (2..SIZE.height - 2).flat_map(|y| (2..SIZE.width - 2).map(move |x| y * SIZE.width + x))
    }

    fn learn(pictures: &[Picture], frames: u32) -> BackgroundModel {
        let mut learner = Learner::new(SIZE, frames);
        for picture in pictures {
            learner.add(picture);
        }
        learner.finish().expect("there were frames")
    }

    #[test]
    fn what_passes_leaves_no_trace_and_the_number_of_kept_frames_is_bounded() {
        let mut learner = Learner::new(SIZE, 200);
        for i in 0..200 {
            let picture = grey(if i % 5 < 2 { 250 } else { 90 });
            assert_eq!(learner.add(&picture), i == 199);
        }
        assert!(learner.kept <= KEPT_MAX as usize);
        let floor = learner.finish().expect("there were frames");
        assert_eq!(floor.picture, grey(90));
        // Known to have low noise.
        assert_eq!(floor.noise, [1; SIZE.area()]);
    }

    #[test]
    fn it_is_done_after_the_announced_number_of_frames() {
        for frames in 0..12 {
            let mut learner = Learner::new(SIZE, frames);
            let last = frames.max(1);
            for i in 1..=last {
                assert_eq!(learner.add(&grey(70)), i == last, "{i} of {frames}");
            }
            let floor = learner.finish().expect("there were frames");
            assert_eq!(floor.picture, grey(70));
            let kept = last - last / 6;
            let is_known = floor.median_noise().is_some();
            assert_eq!(is_known, kept as usize >= KEPT_MIN_FOR_NOISE, "{frames}");
        }
        assert_eq!(Learner::new(SIZE, 5).finish(), None);
    }

    #[test]
    fn the_floor_does_not_depend_on_how_the_work_is_shared_out() {
        let mut random = SplitMix64(1);
        let pictures: Vec<Picture> = (0..25).map(|_| noisy_floor(&mut random, 9.0)).collect();
        // All at the end, in 5 shares, and in more shares than there are tiles.
        let at_once = learn(&pictures, 30);
        let mut shared = pictures.clone();
        shared.extend((0..5).map(|_| grey(0)));
        assert!(learn(&shared, 30) == at_once);
        let learner = Learner::new(SIZE, 30);
        assert!(learner.n_tiles() > 3 && !SIZE.area().is_multiple_of(TILE));
        let mut learner = Learner {
            frames: 34,
            ..learner
        };
        shared.extend((0..4).map(|_| grey(0)));
        assert!(shared.iter().filter(|picture| learner.add(picture)).count() == 1);
        assert!(learner.finish() == Some(at_once));
    }

    /// Mean of the learned noise and RMS of its errors, relative to the true noise.
    fn noise_against(
        real: f64,
        floor: &BackgroundModel,
        pixels: impl Iterator<Item = usize> + Clone,
    ) -> (f64, f64) {
        let ratio = |i: usize| f64::from(floor.noise[i]) / f64::from(NOISE_STEPS) / real;
        let n = pixels.clone().count() as f64;
        let mean = pixels.clone().map(ratio).sum::<f64>() / n;
        let squares: f64 = pixels.map(|i| (ratio(i) - 1.0).powi(2)).sum();
        (mean, (squares / n).sqrt())
    }

    #[test]
    fn gaussian_noise_is_measured() {
        // Denoising leaves 0.41 of it.
        for sigma in [1.6, 2.5, 4.0, 8.0, 16.0, 32.0, 46.0] {
            let mut random = SplitMix64(7);
            let pictures: Vec<Picture> = (0..30).map(|_| noisy_floor(&mut random, sigma)).collect();
            let real = denoised_sigma(sigma);
            let (mean, error) = noise_against(real, &learn(&pictures, 30), inner());
            println!("{real:.2} grey levels: mean {mean:.3}, error {error:.3}");
            assert!((mean - 1.0).abs() < 0.07, "{real:.2}: {mean:.3}");
            assert!(error < 0.12, "{real:.2}: {error:.3}");
        }
    }

    #[test]
    fn objects_are_not_noise() {
        for (sigma, object, covered) in [
            (1.6, 150, 2),
            (4.0, 190, 2),
            (4.0, 60, 2),
            (16.0, 250, 2),
            (16.0, 3, 2),
            (4.0, 145, 1),
            (16.0, 185, 1),
        ] {
            let mut random = SplitMix64(7);
            let mut pictures: Vec<Picture> =
                (0..30).map(|_| noisy_floor(&mut random, sigma)).collect();
            // Each pixel is covered in 10 or 5 of the 25 collected frames by something of uniform
            // colour.
            for (i, picture) in pictures.iter_mut().enumerate() {
                for plane in [&mut picture.red, &mut picture.green, &mut picture.blue] {
                    for (at, value) in plane.iter_mut().enumerate() {
                        if (at / SIZE.width / 5 + i) % 5 < covered {
                            *value = object;
                        }
                    }
                }
            }
            let real = denoised_sigma(sigma);
            // Next to an object the 3x3 median changes the floor; this is not an error of the
            // learner. Hence the rows away from its edges.
            let rows = inner().filter(|i| i / SIZE.width % 5 == 2);
            let (mean, error) = noise_against(real, &learn(&pictures, 30), rows);
            println!("{real:.2}, object {object}: mean {mean:.3}, error {error:.3}");
            assert!((mean - 1.0).abs() < 0.05, "{real:.2}, {object}: {mean:.3}");
            assert!(error < 0.12, "{real:.2}, {object}: {error:.3}");
        }
    }
}
