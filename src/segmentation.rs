//! From an image to the mask of all objects on the floor (section 2.1.1 of the paper).
//!
//! As in the paper: median, difference from the background, threshold on the 3x3 sum, opening,
//! closing. Then each shape is checked: those that are too small, too thin or too faint are
//! dropped, and so are ghosts, the places that an object has left. Meanwhile the background is kept
//! up to date ([`update`](crate::background::update)) and the illumination is estimated
//! ([`illumination`](crate::background::illumination)).

mod mask;
mod open;
pub(crate) mod shapes;
mod texture;

use imgproc::contour::fill_contour;
use imgproc::difference::{Colour, DifferenceMut, Gains, difference};
use imgproc::labels::{Difference, FLOOR, LabelSettings, WindowsMut, label_pixels};
use imgproc::morphology::{dilate_3x3, open_3x3};
use imgproc::noise::frame_noise;
use imgproc::{Bounds, Point, Size};

use crate::background::ghosts::{Ghosts, looks_left};
use crate::background::illumination::Illumination;
pub(crate) use crate::background::illumination::Light;
use crate::background::model::{BackgroundModel, denoise};
use crate::background::region::Region;
use crate::background::update::BackgroundUpdate;
use crate::image::frame::Picture;
use crate::settings::frames_in;
use mask::make_mask;
use open::OpenAreas;
use shapes::{Found, Shapes};
use texture::{Evidence, TextureJudge};

/// Pixels this close to an object are not used to update the background: an object is blurred and
/// casts light on its surroundings.
const MARGIN_PX: usize = 3;

/// Maximum movement of an object between two frames, in pixels, while new objects are ignored.
const KNOWN_WITHIN_PX: u16 = 10;

/// After this time under constant illumination, the background is remembered when the illumination
/// changes.
const STEADY_S: f64 = 1.0;

/// Maximum share of the picture where objects keep the floor below them when it is relearned.
const KEPT_SHARE_MAX: f32 = 0.25;

/// Radius of the area that is left open around a robot that was learned as floor, in sides of its
/// plate.
const OPEN_PLATES: f64 = 1.0;

/// After this time without the robot, the open area is learned as floor.
const LEFT_S: f64 = 0.5;

/// A plate is part of the learned floor if no more than this share of it differs from the floor.
const AS_FLOOR_MAX: f32 = 0.2;

/// Thresholds for objects.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SegmentationSettings {
    /// Minimum peak difference of an object: mean over a 3x3 window, in units of the noise.
    pub(crate) threshold: f32,
    /// Minimum share of the light that remains in a shadow.
    pub(crate) shadow_min: f32,
    /// Minimum area of a shape, px².
    pub(crate) area_min: usize,
}

/// Pixels outside of objects are floor if they differ by less than this share of the threshold.
const WEAK: f32 = 0.5;

/// Maximum change of colour in a shadow, as a share of its change of lightness.
const SHADOW_TINT: f32 = 0.07;

/// Minimum share of an object's area that is clearly interior and not faint.
const CORE_SHARE_MIN: f32 = 0.05;

/// Finds objects in front of a background. Allocates only when it is created.
#[derive(Debug)]
pub(crate) struct Segmenter {
    size: Size,
    denoised: Picture,
    update: BackgroundUpdate,
    illumination: Illumination,
    ghosts: Ghosts,
    textures: TextureJudge,
    planes: Planes,
    labels: Vec<u8>,
    own: Vec<u8>,
    mask: Vec<u8>,
    scratch: Vec<u8>,
    /// The mask of the previous frame.
    previous: Vec<u8>,
    /// The mask of the last frame before the illumination changed.
    before: Vec<u8>,
    /// Consecutive frames without a change of illumination.
    steady: u32,
    /// See [`STEADY_S`].
    steady_min: u32,
    rate_hz: f64,
    /// All pixels of the previous frame that were not floor, with a margin.
    covered: Vec<u8>,
    shapes: Shapes,
    open: OpenAreas,
}

/// A plate that was read.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SeenPlate {
    pub(crate) centre: [f64; 2],
    pub(crate) side_px: f64,
    /// It was read on a shape, or on the obstacle around it.
    pub(crate) has_shape: bool,
}

/// Result of the segmentation of one image.
#[derive(Debug)]
pub(crate) struct Segmented<'a> {
    /// All objects on the floor, within the region.
    pub(crate) shapes: &'a Shapes,
    /// State of the illumination.
    pub(crate) light: Light,
    /// Brightness of the frame relative to the background.
    pub(crate) gains: Gains,
    /// Standard deviation of the brightness of a pixel, grey levels; 0 in the dark.
    pub(crate) noise: f32,
}

/// Differences and their window means.
#[derive(Debug)]
struct Planes {
    light: Vec<i16>,
    red: Vec<i16>,
    blue: Vec<i16>,
    level: Vec<u16>,
    light_window: Vec<i16>,
    red_window: Vec<i16>,
    blue_window: Vec<i16>,
}

impl Segmenter {
    /// A segmenter for a background and a frame rate.
    ///
    /// # Panics
    ///
    /// If the planes of the picture do not match its size.
    pub(crate) fn new(floor: &BackgroundModel, rate_hz: f64) -> Self {
        let size = floor.picture.size;
        let bytes = || vec![0u8; size.area()];
        let words = || vec![0i16; size.area()];
        let steady_min = frames_in(STEADY_S, rate_hz);
        Self {
            size,
            denoised: Picture::new(size),
            update: BackgroundUpdate::new(floor, rate_hz),
            illumination: Illumination::new(rate_hz),
            ghosts: Ghosts::new(rate_hz),
            textures: TextureJudge::new(size),
            planes: Planes {
                light: words(),
                red: words(),
                blue: words(),
                level: vec![0; size.area()],
                light_window: words(),
                red_window: words(),
                blue_window: words(),
            },
            labels: bytes(),
            own: bytes(),
            mask: bytes(),
            scratch: bytes(),
            previous: bytes(),
            before: bytes(),
            steady: steady_min,
            steady_min,
            rate_hz,
            covered: bytes(),
            shapes: Shapes::new(size),
            open: OpenAreas::new(size),
        }
    }

    /// Replaces the background; the illumination is that of its picture.
    ///
    /// # Panics
    ///
    /// If its size differs.
    pub(crate) fn set_background(&mut self, floor: &BackgroundModel) {
        self.update.set(floor);
        self.illumination = Illumination::new(self.rate_hz);
        self.ghosts = Ghosts::new(self.rate_hz);
        self.previous.fill(0);
        self.before.fill(0);
        self.steady = self.steady_min;
        self.covered.fill(0);
        self.open.clear();
    }

    /// The background with all updates so far.
    pub(crate) fn floor(&self) -> BackgroundModel {
        self.update.floor()
    }

    /// Puts the current background into a relearned one wherever an object was in the previous
    /// frame: objects that did not move while the floor was relearned must not become part of it.
    /// If they cover more than [`KEPT_SHARE_MAX`] of the picture, the camera has been moved, and
    /// nothing is kept.
    pub(crate) fn keep_floor_under_objects(&mut self, learned: &mut BackgroundModel) {
        let n_covered = self.previous.iter().filter(|&&mask| mask != 0).count();
        if n_covered == 0 || n_covered as f32 > KEPT_SHARE_MAX * self.size.area() as f32 {
            return;
        }
        let near = &mut self.scratch;
        dilate_3x3(&self.previous, self.size, &mut self.covered);
        for _ in 1..MARGIN_PX {
            dilate_3x3(&self.covered, self.size, near);
            std::mem::swap(&mut self.covered, near);
        }
        let gains = self.illumination.gains;
        self.update.copy_floor(gains, &self.covered, learned);
    }

    /// Updates the open areas with the markers of the last frame. A marker without a shape, where
    /// the frame equals the background, is part of the learned floor; the floor there is unknown
    /// until the robot has left.
    pub(crate) fn note_markers(&mut self, markers: impl Iterator<Item = SeenPlate> + Clone) {
        for plate in markers.clone().filter(|plate| !plate.has_shape) {
            if !self.open.contains(plate.centre) && self.is_as_floor(&plate) {
                self.open.add(plate.centre, OPEN_PLATES * plate.side_px);
            }
        }
        let (size, gains) = (self.size, self.illumination.gains);
        let (scratch, update, denoised) = (&mut self.scratch, &mut self.update, &self.denoised);
        self.open.update(
            frames_in(LEFT_S, self.rate_hz),
            |area| {
                markers
                    .clone()
                    .any(|plate| area.is_near(plate.centre, plate.side_px))
            },
            |area| {
                let bounds = area.bounds(size);
                let shape = &mut scratch[..bounds.size().area()];
                area.mask(size, shape);
                update.take(denoised, gains, bounds, shape);
            },
        );
    }

    /// Whether the frame hardly differs from the learned floor on a plate.
    fn is_as_floor(&self, plate: &SeenPlate) -> bool {
        let bounds = Bounds::around(plate.centre, 0.5 * plate.side_px, self.size);
        let rows = usize::from(bounds.top)..=usize::from(bounds.bottom);
        let n_changed = rows
            .flat_map(|y| {
                let row = y * self.size.width;
                &self.labels[row + usize::from(bounds.left)..=row + usize::from(bounds.right)]
            })
            .filter(|&&label| label != FLOOR)
            .count();
        (n_changed as f32) < AS_FLOOR_MAX * bounds.size().area() as f32
    }

    /// The objects in a picture, clipped to the region.
    ///
    /// # Panics
    ///
    /// If the size of the picture or of the region differs from that of the background.
    pub(crate) fn segment(
        &mut self,
        picture: &Picture,
        region: Option<&Region>,
        settings: &SegmentationSettings,
    ) -> Segmented<'_> {
        denoise(picture, &mut self.denoised);
        let light =
            self.illumination
                .observe(&self.denoised, self.update.channels(), &self.covered);
        let gains = self.illumination.gains;
        if light == Light::Dark {
            self.shapes.clear();
            return Segmented {
                shapes: &self.shapes,
                light,
                gains,
                noise: 0.0,
            };
        }
        let light = self.follow_light(light);
        let gains = self.illumination.gains;
        self.write_labels(gains, settings);
        let evidence = Evidence {
            level: &self.planes.level,
            floor_level: self.update.reference().level,
            own: &self.own,
            previous: &self.previous,
            strong: (2.0 * settings.threshold) as u8,
        };
        self.textures.judge(&mut self.labels, &evidence);
        self.open.take_out(&mut self.labels);
        make_mask(
            &self.labels,
            &self.own,
            self.size,
            &mut self.mask,
            [&mut self.scratch, &mut self.covered],
        );
        self.choose_shapes(light, settings);
        self.previous.copy_from_slice(&self.mask);
        self.cover();
        if let Some(region) = region {
            self.cut_at(region, settings);
        }
        if light == Light::Steady {
            self.update.follow(&self.denoised, gains, &self.covered);
        }
        let [red, green, blue] = self.update.channels();
        let noise = frame_noise(
            [&picture.red, &picture.green, &picture.blue],
            [red, green, blue],
            [gains.red, gains.green, gains.blue],
            self.size,
        );
        Segmented {
            shapes: &self.shapes,
            light,
            gains,
            noise,
        }
    }

    /// Adapts the background to the illumination of the frame if it has just changed.
    fn follow_light(&mut self, mut light: Light) -> Light {
        let Light::Changed { frames_left } = light else {
            self.steady = match light {
                Light::Steady => self.steady.saturating_add(1),
                _ => self.steady,
            };
            return light;
        };
        if frames_left + 1 == self.illumination.settle_frames {
            // The illumination has returned to an earlier state, or what covered half of the
            // picture is gone.
            if self.update.recall(&self.denoised, &self.covered) {
                let floor = self.update.channels();
                light = self
                    .illumination
                    .return_to(&self.denoised, floor, &self.covered);
            } else if self.steady >= self.steady_min {
                self.update.remember();
            }
            if self.steady > 0 {
                self.before.copy_from_slice(&self.previous);
            }
        }
        self.steady = 0;
        if frames_left.is_multiple_of(4) || frames_left + 1 == self.illumination.settle_frames {
            let gains = self.illumination.gains;
            self.update.relight(&self.denoised, gains, &self.before);
        }
        light
    }

    /// Writes the label of each pixel.
    fn write_labels(&mut self, gains: Gains, settings: &SegmentationSettings) {
        let Planes {
            light,
            red,
            blue,
            level,
            light_window,
            red_window,
            blue_window,
        } = &mut self.planes;
        let reference = self.update.reference();
        let out = DifferenceMut {
            light,
            red,
            blue,
            level,
        };
        difference(colour(&self.denoised), gains, reference, self.size, out);
        // In dim light the frame is amplified, and its noise with it.
        let dimmest = gains.red.min(gains.green).min(gains.blue).min(1.0);
        let strong = settings.threshold / dimmest;
        label_pixels(
            Difference {
                light,
                red,
                blue,
                level,
            },
            reference.level,
            self.size,
            &mut self.labels,
            &mut self.own,
            WindowsMut {
                light: light_window,
                red: red_window,
                blue: blue_window,
            },
            &LabelSettings {
                weak: strong * WEAK,
                strong,
                shadow_min: settings.shadow_min,
                shadow_tint: SHADOW_TINT,
            },
        );
    }

    /// Keeps the shapes that are objects and removes all others from the mask.
    fn choose_shapes(&mut self, light: Light, settings: &SegmentationSettings) {
        self.scratch.copy_from_slice(&self.mask);
        let mut search = self.shapes.search();
        while let Some(found) = self.shapes.next(&mut search, &mut self.scratch) {
            if self.is_object(&found, light, settings) {
                let is_cut = self
                    .shapes
                    .contour(&found)
                    .is_some_and(|c| self.open.cuts(c));
                self.shapes.keep(found, is_cut);
            } else {
                self.shapes.remove(&found, &mut self.mask);
            }
        }
        self.ghosts.end_frame();
    }

    /// Whether a shape is an object. Floor that merely differs is learned as background.
    fn is_object(&mut self, found: &Found, light: Light, settings: &SegmentationSettings) -> bool {
        let removed = found.removed;
        let cores_min = (removed.area as f32 * CORE_SHARE_MIN).max(1.0) as usize;
        if removed.area < settings.area_min || removed.cores < cores_min {
            return false;
        }
        let Some(contour) = self.shapes.contour(found) else {
            return true;
        };
        let size = self.size;
        let ghost = light == Light::Steady
            && looks_left(contour, &self.denoised, self.update.channels(), size)
            && self.ghosts.sighted(removed.bounds);
        let new = match light {
            Light::Changed { .. } => ![&self.previous, &self.before]
                .into_iter()
                .any(|mask| known(mask, size, removed.bounds)),
            _ => false,
        };
        if ghost || light == (Light::Changed { frames_left: 0 }) && new {
            take(
                contour,
                removed.bounds,
                size,
                [&mut self.covered, &mut self.own],
                |bounds, shape| {
                    self.update
                        .take(&self.denoised, self.illumination.gains, bounds, shape);
                },
            );
        }
        !ghost && !new
    }

    /// Clips the shapes to the region.
    fn cut_at(&mut self, region: &Region, settings: &SegmentationSettings) {
        region.clear_outside(&mut self.mask);
        let mut search = self.shapes.search();
        while let Some(found) = self.shapes.next(&mut search, &mut self.mask) {
            if found.removed.area >= settings.area_min {
                self.shapes.keep(found, false);
            }
        }
    }

    /// Marks the pixels where the frame does not show the plain floor.
    fn cover(&mut self) {
        for ((covered, &label), &mask) in self.covered.iter_mut().zip(&self.labels).zip(&self.mask)
        {
            *covered = u8::from(label != FLOOR || mask != 0);
        }
        if let Some(open) = self.open.plane() {
            for (covered, &open) in self.covered.iter_mut().zip(open) {
                *covered |= open;
            }
        }
        // Single pixels are noise and must not stop the update of the background.
        open_3x3(&mut self.covered, self.size, &mut self.scratch);
        for _ in 0..MARGIN_PX {
            dilate_3x3(&self.covered, self.size, &mut self.scratch);
            std::mem::swap(&mut self.covered, &mut self.scratch);
        }
    }
}

/// Whether there was an object near `bounds` in the previous frame.
fn known(previous: &[u8], size: Size, bounds: Bounds) -> bool {
    let near = bounds.grown(KNOWN_WITHIN_PX, size);
    (near.top..=near.bottom).any(|y| {
        let row = usize::from(y) * size.width;
        previous[row + usize::from(near.left)..=row + usize::from(near.right)]
            .iter()
            .any(|&mask| mask != 0)
    })
}

/// Calls `work` with the mask of a shape, dilated by two pixels. `scratch` holds two planes of
/// picture size.
fn take(
    contour: &[Point],
    bounds: Bounds,
    size: Size,
    scratch: [&mut [u8]; 2],
    work: impl FnOnce(Bounds, &[u8]),
) {
    let around = bounds.grown(2, size);
    let area = around.size().area();
    let [shape, grown] = scratch.map(|plane| &mut plane[..area]);
    fill_contour(contour, around, shape);
    dilate_3x3(shape, around.size(), grown);
    dilate_3x3(grown, around.size(), shape);
    work(around, shape);
}

fn colour(picture: &Picture) -> Colour<'_> {
    Colour {
        red: &picture.red,
        green: &picture.green,
        blue: &picture.blue,
    }
}
