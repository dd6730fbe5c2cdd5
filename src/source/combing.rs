//! Detects interlaced frames without a tag: both fields of an interlaced source in one frame, half
//! a frame period apart.
//!
//! Static parts look right. At the left and right edges of moving objects, every other row shows
//! the object half a frame period later, so rows alternate: a comb. Its teeth are pixels that are
//! much brighter than their neighbours above and below, or much darker than both, while these two
//! are similar, and so is the next pixel but one below. They count only where the picture has
//! changed since the previous frame, since a floor may have a grating just as fine. Noise, textures
//! and JPEG blocks cause few of these pixels; a combed moving edge consists mostly of them.

use imgproc::Size;

/// Minimum difference of a row from its neighbours, and maximum difference between these, in grey
/// levels.
const TOOTH: i32 = 24;
const ALIKE: i32 = 12;
/// Minimum change since the previous frame.
const CHANGE: i32 = 16;
/// Minimum number of changed pixels for a frame to be judged.
const CHANGED_MIN: u32 = 60;
/// If there are combs, at least one in this many changed pixels is a tooth: a quarter to a half of
/// the rows of one field.
const TEETH_SHARE: u32 = 8;
/// Number of frames with combs required as proof. A single one may come from a scratch on a tape,
/// or from a cut.
const PROOF: u32 = 3;
/// Number of judged frames after which the search ends.
const JUDGED_MAX: u32 = 300;

/// Searches for combs, frame by frame.
#[derive(Debug)]
pub(crate) struct Combing {
    size: Size,
    before: Vec<u8>,
    n_judged: u32,
    n_combed: u32,
}

impl Combing {
    pub(crate) fn new(size: Size) -> Self {
        Self {
            size,
            before: Vec::new(),
            n_judged: 0,
            n_combed: 0,
        }
    }

    /// Adds the luma of a frame; returns true if the frames are proven to be combed.
    ///
    /// # Panics
    ///
    /// If the luma does not match the frame size.
    pub(crate) fn add(&mut self, luma: &[u8]) -> bool {
        assert_eq!(luma.len(), self.size.area(), "a frame has another size");
        if self.before.len() == luma.len() {
            let (changed, teeth) = count(&self.before, luma, self.size.width);
            if changed >= CHANGED_MIN {
                self.n_judged += 1;
                self.n_combed += u32::from(teeth * TEETH_SHARE >= changed);
            }
        }
        self.before.clear();
        self.before.extend_from_slice(luma);
        // Also the majority of the judged frames: a few odd frames of a long stream prove nothing.
        self.n_combed >= PROOF && 2 * self.n_combed > self.n_judged
    }

    /// Whether the search can stop.
    pub(crate) fn is_done(&self) -> bool {
        self.n_judged >= JUDGED_MAX
    }
}

/// Number of changed pixels, and number of teeth among them.
fn count(before: &[u8], luma: &[u8], width: usize) -> (u32, u32) {
    let (mut changed, mut teeth) = (0, 0);
    let n_rows = luma.len() / width;
    for y in 1..n_rows.saturating_sub(2) {
        let rows = |plane| -> [&[u8]; 4] { [0, 1, 2, 3].map(|i| row(plane, y - 1 + i, width)) };
        let ([above, here, below, next], [old_above, old, old_below, _]) =
            (rows(luma), rows(before));
        for x in 0..width {
            let (pixel, old) = (i32::from(here[x]), i32::from(old[x]));
            if (pixel - old).abs() < CHANGE {
                continue;
            }
            changed += 1;
            let [above, below, next, old_above, old_below] =
                [above, below, next, old_above, old_below].map(|row| i32::from(row[x]));
            let is_tooth = stands_out(pixel, above, below)
                && (above - below).abs() <= ALIKE
                && (pixel - next).abs() <= ALIKE
                // A grating of the floor was there before; the teeth of a comb move.
                && !stands_out(old, old_above, old_below);
            teeth += u32::from(is_tooth);
        }
    }
    (changed, teeth)
}

fn row(plane: &[u8], y: usize, width: usize) -> &[u8] {
    &plane[y * width..][..width]
}

fn stands_out(pixel: i32, above: i32, below: i32) -> bool {
    let (up, down) = (pixel - above, pixel - below);
    up.min(down) >= TOOTH || up.max(down) <= -TOOTH
}

#[cfg(test)]
mod tests {
    use super::*;
    use random::SplitMix64;

    const SIZE: Size = Size {
        width: 160,
        height: 120,
    };

    /// A floor with a fine grating and noise, and a moving bright square with a dark bar. If the
    /// picture is interlaced, every other row shows it half a frame period later.
    fn frame(number: i32, speed: f64, interlaced: bool) -> Vec<u8> {
        let mut random = SplitMix64(number as u64);
        (0..SIZE.area())
            .map(|i| {
                let (x, y) = (i % SIZE.width, i / SIZE.width);
                let noise = random.byte() % 9;
                let moment = f64::from(number) + if interlaced && y % 2 == 1 { 0.5 } else { 0.0 };
                let left = 20.0 + speed * moment;
                let (across, down) = (x as f64 - left, y as f64 - 40.0);
                let grating = if y > 100 && y % 2 == 0 { 60 } else { 0 };
                let value = if (0.0..32.0).contains(&across) && (0.0..32.0).contains(&down) {
                    if (10.0..22.0).contains(&across) {
                        30
                    } else {
                        220
                    }
                } else {
                    100 + grating
                };
                value + noise
            })
            .collect()
    }

    fn is_found(speed: f64, interlaced: bool) -> bool {
        let mut combing = Combing::new(SIZE);
        (0..30).any(|number| combing.add(&frame(number, speed, interlaced)))
    }

    #[test]
    fn what_moves_is_combed_in_interlaced_frames() {
        for speed in [2.0, 3.0, -3.0, 5.0] {
            assert!(is_found(speed, true), "{speed} px a frame");
            assert!(!is_found(speed, false), "{speed} px a frame");
        }
        assert!(!is_found(0.0, true));
    }

    #[test]
    fn noise_is_no_comb() {
        let mut combing = Combing::new(SIZE);
        let mut random = SplitMix64(1);
        for number in 0..30 {
            let noise = (0..SIZE.area()).map(|_| {
                let uniform = [(); 4].map(|()| u16::from(random.byte() % 64));
                (64 + uniform.iter().sum::<u16>() / 2) as u8
            });
            assert!(!combing.add(&noise.collect::<Vec<u8>>()), "frame {number}");
        }
    }

    #[test]
    fn light_that_changes_over_a_grating_is_no_comb() {
        let mut combing = Combing::new(SIZE);
        for number in 0..30 {
            let lamp = if number % 2 == 0 { 20 } else { 0 };
            let luma: Vec<u8> = frame(0, 0.0, false)
                .iter()
                .map(|value| value.saturating_add(lamp))
                .collect();
            assert!(!combing.add(&luma), "frame {number}");
        }
    }
}
