//! Tests whether the floor's texture is visible where the brightness differs: then it is floor
//! under different illumination.

use imgproc::Size;
use imgproc::labels::{BLACK, BRIGHT, COLOURED, SHADE, STRONG};
use imgproc::texture::{Textures, TexturesMut, Visibility, textures, visibility};

/// Approximate maximum number of places per frame where the texture is tested.
const PROBES_MAX: usize = 1500;

/// Maximum side of the square that one probe decides, pixels.
const CELL_MAX: usize = 32;

/// From this share of the floor's texture on, the floor is visible, at any brightness.
const FLOOR_SHOWS: f32 = 0.4;

/// Minimum significance of visible texture, in standard deviations; higher where there was an
/// object in the previous frame.
const SEEN_MIN: f32 = 3.5;
const SEEN_LEAST_AFTER_OBJECT: f32 = 6.0;

/// Below this share of the floor's texture, something covers it. Compression removes texture too.
const FLOOR_HIDDEN: f32 = 0.2;

/// In a shadow, the minimum visible share, and its minimum significance in standard deviations.
const SHADOW_SHOWS: (f32, f32) = (0.7, 4.0);

/// Texture planes.
#[derive(Debug)]
pub(super) struct TextureJudge {
    size: Size,
    ratio: Vec<u16>,
    frame: Vec<i16>,
    floor: Vec<i16>,
}

/// Additional data about a frame, besides its labels.
pub(super) struct Evidence<'a> {
    /// Sums of the channels: of the frame, and of the background under the frame's illumination.
    pub(super) level: &'a [u16],
    pub(super) floor_level: &'a [u16],
    /// Difference of each pixel, see [`imgproc::labels::label_pixels`].
    pub(super) own: &'a [u8],
    /// The mask of the previous frame.
    pub(super) previous: &'a [u8],
    /// Minimum of `own` for a strong difference.
    pub(super) strong: u8,
}

impl TextureJudge {
    pub(super) fn new(size: Size) -> Self {
        Self {
            size,
            ratio: vec![0; size.area()],
            frame: vec![0; size.area()],
            floor: vec![0; size.area()],
        }
    }

    /// Relabels brighter and darker pixels as floor where the floor's texture is visible, at any
    /// brightness. A shadow without visible texture is an object, and so is a pixel that differs
    /// only a little.
    pub(super) fn judge(&mut self, labels: &mut [u8], evidence: &Evidence<'_>) {
        let Size { width, height } = self.size;
        let candidates = labels.iter().filter(|&&label| open(label)).count();
        if candidates == 0 {
            return;
        }
        let side = (4..=CELL_MAX)
            .step_by(2)
            .find(|side| candidates / (side * side) <= PROBES_MAX)
            .unwrap_or(CELL_MAX);
        let mut out = TexturesMut {
            ratio: &mut self.ratio,
            frame: &mut self.frame,
            floor: &mut self.floor,
        };
        textures(
            evidence.level,
            evidence.floor_level,
            self.size,
            &mut out,
            |i| open(labels[i]),
        );
        for top in (0..height).step_by(side) {
            for left in (0..width).step_by(side) {
                let cell = Cell {
                    left,
                    top,
                    right: (left + side).min(width),
                    bottom: (top + side).min(height),
                    middle: (left + side / 2, top + side / 2),
                };
                let [darker, brighter] = self.probe(labels, &cell);
                if darker.is_none() && brighter.is_none() {
                    continue; // most of the floor
                }
                for y in cell.top..cell.bottom {
                    let row = y * width + cell.left..y * width + cell.right;
                    for (label, i) in labels[row.clone()].iter_mut().zip(row) {
                        *label = relabel(i, *label, [darker, brighter], evidence);
                    }
                }
            }
        }
    }

    /// Visible share of the floor's texture in a cell, separately for pixels darker and brighter
    /// than the background. Each is tested at the candidate nearest to the middle of the cell.
    fn probe(&self, labels: &[u8], cell: &Cell) -> [Option<Visibility>; 2] {
        let mut nearest = [None::<(usize, (usize, usize))>; 2];
        for y in cell.top..cell.bottom {
            let row = y * self.size.width;
            if self.ratio[row + cell.left..row + cell.right]
                == [0; CELL_MAX][..cell.right - cell.left]
            {
                continue;
            }
            for x in cell.left..cell.right {
                let i = row + x;
                if self.ratio[i] == 0 {
                    continue;
                }
                let distance = x.abs_diff(cell.middle.0) + y.abs_diff(cell.middle.1);
                let nearest = &mut nearest[usize::from(labels[i] & !STRONG == BRIGHT)];
                if nearest.is_none_or(|(min, _)| distance < min) {
                    *nearest = Some((distance, (x, y)));
                }
            }
        }
        let textures = Textures {
            ratio: &self.ratio,
            frame: &self.frame,
            floor: &self.floor,
        };
        nearest.map(|nearest| visibility(textures, self.size, nearest?.1))
    }
}

/// A square of the picture.
struct Cell {
    left: usize,
    top: usize,
    right: usize,
    bottom: usize,
    middle: (usize, usize),
}

/// Whether a label may change because of texture.
fn open(label: u8) -> bool {
    matches!(label & !STRONG, BRIGHT | BLACK | SHADE) || label == COLOURED
}

/// The label of pixel `i` after the texture test.
fn relabel(
    i: usize,
    label: u8,
    [darker, brighter]: [Option<Visibility>; 2],
    evidence: &Evidence<'_>,
) -> u8 {
    let seen_min = match evidence.previous[i] {
        0 => SEEN_MIN,
        _ => SEEN_LEAST_AFTER_OBJECT,
    };
    match label & !STRONG {
        // A brighter pixel may be white with a texture of its own.
        BRIGHT if brighter.is_some_and(|seen| shows(seen, 2.0 * seen_min)) => SHADE,
        BLACK if darker.is_some_and(|seen| shows(seen, seen_min)) => SHADE,
        SHADE if darker.is_some_and(hides) && evidence.own[i] >= evidence.strong => BLACK | STRONG,
        SHADE if darker.is_some_and(hides) => BLACK,
        COLOURED if label & STRONG == 0 && darker.is_some_and(hides) => COLOURED | STRONG,
        _ => label,
    }
}

/// Whether the floor is visible.
fn shows(texture: Visibility, seen_min: f32) -> bool {
    texture.share > FLOOR_SHOWS && texture.seen > seen_min
}

/// Whether something covers the floor.
fn hides(texture: Visibility) -> bool {
    let (shadow, deviations) = SHADOW_SHOWS;
    texture.share < FLOOR_HIDDEN && (shadow - texture.share) * texture.visible > deviations
}
