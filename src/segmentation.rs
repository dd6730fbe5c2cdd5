//! From a picture to the mask of everything that stands on the floor (section 2.1.1 of the paper).
//!
//! Median, difference from the empty floor, threshold on the 3x3 sum, opening, closing, as in the paper; then the shapes are
//! looked at one by one: too small, too thin or too faint ones are none, and neither are the places that an object has left. The
//! floor is kept true meanwhile ([`update`](crate::background::update)), the light is measured ([`illumination`](crate::background::illumination)).

mod texture;

use imgproc::classes::{BRIGHT, ClassSettings, Difference, FLOOR, STRONG, WindowsMut, classes};
use imgproc::contour::{
    Span, fill_contour, follow_contour, next_shape, remove_shape, span_capacity,
};
use imgproc::difference::{Colour, DifferenceMut, Gains, difference};
use imgproc::morphology::{dilate_3x3, erode_3x3, open_3x3};
use imgproc::noise::frame_noise;
use imgproc::{Bounds, Point, Size};

use crate::background::ghosts::{Ghosts, looks_left};
pub(crate) use crate::background::illumination::Light;
use crate::background::illumination::{Illumination, SETTLE_FRAMES};
use crate::background::model::{BackgroundModel, denoise};
use crate::background::update::BackgroundUpdate;
use crate::image::frame::Picture;
use crate::marker::cutout::contour_capacity;
use texture::{Evidence, TextureJudge};

/// Pixels around objects that do not tell how the floor looks: an object blurs, and lights up what is beside it.
const MARGIN_PX: usize = 3;

/// How far an object may have moved since the frame before, in pixels, while nothing new counts.
const KNOWN_WITHIN_PX: u16 = 10;

/// After so many frames in one light the floor is worth remembering when that changes.
const STEADY_LEAST: u32 = 30;

/// What decides what an object is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SegmentationSettings {
    /// Least difference that an object has somewhere, mean over a 3x3 window, in units of the noise.
    pub(crate) threshold: f32,
    /// Least share of the light that a shadow leaves.
    pub(crate) shadow_least: f32,
    /// Smallest shape, px².
    pub(crate) area_min: usize,
}

/// Pixels outside of an object are floor where they differ by less than this share of the threshold.
const WEAK: f32 = 0.5;

/// What a shadow may change in colour, as a share of what it changes in lightness.
const SHADOW_TINT: f32 = 0.07;

/// Share of an object's area that is clearly inside, and not faint.
const CORE_LEAST: f32 = 0.05;

/// Finds objects before one floor. All memory is taken when it is made.
#[derive(Debug)]
pub(crate) struct Segmenter {
    size: Size,
    denoised: Picture,
    upkeep: BackgroundUpdate,
    lighting: Illumination,
    ghosts: Ghosts,
    textures: TextureJudge,
    planes: Planes,
    class: Vec<u8>,
    own: Vec<u8>,
    mask: Vec<u8>,
    scratch: Vec<u8>,
    /// The mask of the frame before.
    previous: Vec<u8>,
    /// The mask of the last frame before the light changed.
    before: Vec<u8>,
    /// Frames in a row without a change of the light.
    steady: u32,
    /// Everything in the frame before that was no floor, and what is beside it.
    covered: Vec<u8>,
    contour: Vec<Point>,
    spans: Vec<Span>,
}

/// What a picture shows.
#[derive(Debug)]
pub(crate) struct Segmented<'a> {
    /// Not 0 where something stands. The caller may use it up.
    pub(crate) mask: &'a mut [u8],
    /// What the light does.
    pub(crate) light: Light,
    /// How bright the frame is, over the floor.
    pub(crate) gains: Gains,
    /// Standard deviation of a pixel's brightness, grey levels; 0 in the dark.
    pub(crate) noise: f32,
}

/// Differences and their windows.
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
    /// A segmenter for one floor.
    ///
    /// # Panics
    ///
    /// When the planes of the picture do not have its size.
    pub(crate) fn new(floor: &BackgroundModel) -> Self {
        let size = floor.picture.size;
        let bytes = || vec![0u8; size.area()];
        let words = || vec![0i16; size.area()];
        Self {
            size,
            denoised: Picture::new(size),
            upkeep: BackgroundUpdate::new(floor),
            lighting: Illumination::new(),
            ghosts: Ghosts::new(),
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
            class: bytes(),
            own: bytes(),
            mask: bytes(),
            scratch: bytes(),
            previous: bytes(),
            before: bytes(),
            steady: STEADY_LEAST,
            covered: bytes(),
            contour: vec![Point::default(); contour_capacity(size)],
            spans: vec![Span::default(); span_capacity(size)],
        }
    }

    /// Compares with another floor from now on, in the light of its picture.
    ///
    /// # Panics
    ///
    /// When it has another size.
    pub(crate) fn set_background(&mut self, floor: &BackgroundModel) {
        self.upkeep.set(floor);
        self.lighting = Illumination::new();
        self.ghosts = Ghosts::new();
        self.previous.fill(0);
        self.before.fill(0);
        self.steady = STEADY_LEAST;
        self.covered.fill(0);
    }

    /// The floor as it was kept true so far.
    pub(crate) fn floor(&self) -> BackgroundModel {
        self.upkeep.floor()
    }

    /// What stands in a picture.
    ///
    /// # Panics
    ///
    /// When the picture has another size than the floor.
    pub(crate) fn segment(
        &mut self,
        picture: &Picture,
        settings: &SegmentationSettings,
    ) -> Segmented<'_> {
        denoise(picture, &mut self.denoised);
        let light = self
            .lighting
            .observe(&self.denoised, self.upkeep.channels(), &self.covered);
        let gains = self.lighting.gains;
        if light == Light::Dark {
            self.mask.fill(0);
            return Segmented {
                mask: &mut self.mask,
                light,
                gains,
                noise: 0.0,
            };
        }
        let light = self.follow_light(light);
        let gains = self.lighting.gains;
        self.classify(gains, settings);
        let evidence = Evidence {
            level: &self.planes.level,
            floor_level: self.upkeep.reference().level,
            own: &self.own,
            previous: &self.previous,
            strong: (2.0 * settings.threshold) as u8,
        };
        self.textures.judge(&mut self.class, &evidence);
        self.make_mask();
        self.choose_shapes(light, settings);
        self.previous.copy_from_slice(&self.mask);
        self.cover();
        if light == Light::Steady {
            self.upkeep.follow(&self.denoised, gains, &self.covered);
        }
        let [red, green, blue] = self.upkeep.channels();
        let noise = frame_noise(
            [&picture.red, &picture.green, &picture.blue],
            [red, green, blue],
            [gains.red, gains.green, gains.blue],
            self.size,
        );
        Segmented {
            mask: &mut self.mask,
            light,
            gains,
            noise,
        }
    }

    /// Brings the floor into the light of the frame, if that has just changed.
    fn follow_light(&mut self, mut light: Light) -> Light {
        let Light::Changed { frames_left } = light else {
            self.steady = match light {
                Light::Steady => self.steady.saturating_add(1),
                _ => self.steady,
            };
            return light;
        };
        if frames_left + 1 == SETTLE_FRAMES {
            // The light has been this way before, or what covered half of the picture is gone.
            if self.upkeep.recall(&self.denoised, &self.covered) {
                let floor = self.upkeep.channels();
                light = self
                    .lighting
                    .return_to(&self.denoised, floor, &self.covered);
            } else if self.steady >= STEADY_LEAST {
                self.upkeep.remember();
            }
            if self.steady > 0 {
                self.before.copy_from_slice(&self.previous);
            }
        }
        self.steady = 0;
        if frames_left.is_multiple_of(4) || frames_left + 1 == SETTLE_FRAMES {
            let gains = self.lighting.gains;
            self.upkeep.relight(&self.denoised, gains, &self.before);
        }
        light
    }

    /// Writes the class of each pixel.
    fn classify(&mut self, gains: Gains, settings: &SegmentationSettings) {
        let Planes {
            light,
            red,
            blue,
            level,
            light_window,
            red_window,
            blue_window,
        } = &mut self.planes;
        let reference = self.upkeep.reference();
        let out = DifferenceMut {
            light,
            red,
            blue,
            level,
        };
        difference(colour(&self.denoised), gains, reference, self.size, out);
        // In dim light the frame is magnified, and its noise with it.
        let dimmest = gains.red.min(gains.green).min(gains.blue).min(1.0);
        let strong = settings.threshold / dimmest;
        classes(
            Difference {
                light,
                red,
                blue,
                level,
            },
            reference.level,
            self.size,
            &mut self.class,
            &mut self.own,
            WindowsMut {
                light: light_window,
                red: red_window,
                blue: blue_window,
            },
            &ClassSettings {
                weak: strong * WEAK,
                strong,
                shadow_least: settings.shadow_least,
                shadow_tint: SHADOW_TINT,
            },
        );
    }

    /// From classes to the mask: 1 for object, 2 for the core of one.
    fn make_mask(&mut self) {
        for (mask, &class) in self.mask.iter_mut().zip(&self.class) {
            *mask = u8::from(class & !STRONG >= BRIGHT);
        }
        // What is certain may be thinner than the opening leaves it: the rim of a small plate, between which and the white there is
        // a line as grey as the floor.
        open_3x3(&mut self.mask, self.size, &mut self.scratch);
        for (mask, &class) in self.mask.iter_mut().zip(&self.class) {
            *mask |= u8::from(class & STRONG != 0);
        }
        self.close_gaps();
        open_3x3(&mut self.mask, self.size, &mut self.scratch);
        self.strip_blur();
        // A core is strong and has a 5x5 square of object around it.
        erode_3x3(&self.mask, self.size, &mut self.scratch);
        erode_3x3(&self.scratch, self.size, &mut self.covered);
        for ((mask, &inside), &class) in self.mask.iter_mut().zip(&self.covered).zip(&self.class) {
            *mask |= (inside & u8::from(class & STRONG != 0)) << 1;
        }
    }

    /// Closing by a 5x5 window: a robot in two colours has a line between them that is neither.
    fn close_gaps(&mut self) {
        for step in [dilate_3x3, dilate_3x3, erode_3x3, erode_3x3] {
            step(&self.mask, self.size, &mut self.scratch);
            std::mem::swap(&mut self.mask, &mut self.scratch);
        }
    }

    /// Takes away pixels at the border of the mask that differ by less than half of what their surroundings do: the lens blurs an
    /// object into the floor, and half-way is where its border is.
    fn strip_blur(&mut self) {
        let Size { width, height } = self.size;
        self.scratch.copy_from_slice(&self.mask);
        let mask = &self.scratch;
        for y in 2..height.saturating_sub(2) {
            for x in 2..width.saturating_sub(2) {
                let i = y * width + x;
                let border = mask[i] != 0
                    && (mask[i - 1] & mask[i + 1] & mask[i - width] & mask[i + width]) == 0;
                if !border {
                    continue;
                }
                let most = (y - 2..=y + 2)
                    .flat_map(|y| y * width + x - 2..=y * width + x + 2)
                    .filter(|&i| mask[i] != 0)
                    .map(|i| self.own[i])
                    .max();
                if most.is_some_and(|most| self.own[i] < most / 2) {
                    self.mask[i] = 0;
                }
            }
        }
    }

    /// Keeps the shapes that are objects.
    fn choose_shapes(&mut self, light: Light, settings: &SegmentationSettings) {
        let size = self.size;
        self.scratch.copy_from_slice(&self.mask);
        let mut from = 0;
        while let Some(start) = next_shape(&self.scratch, size, from) {
            from = usize::from(start.y) * size.width + usize::from(start.x);
            let contour = follow_contour(&self.scratch, size, start, &mut self.contour)
                .map(<[Point]>::len)
                .unwrap_or(0);
            let removed = remove_shape(&mut self.scratch, size, start, &mut self.spans);
            let cores = (removed.area as f32 * CORE_LEAST).max(1.0) as usize;
            let mut counts = removed.area >= settings.area_min && removed.cores >= cores;
            if counts && contour > 0 {
                let contour = &self.contour[..contour];
                let ghost = light == Light::Steady
                    && looks_left(contour, &self.denoised, self.upkeep.channels(), size)
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
                            self.upkeep
                                .take(&self.denoised, self.lighting.gains, bounds, shape);
                        },
                    );
                }
                counts = !ghost && !new;
            }
            if !counts {
                remove_shape(&mut self.mask, size, start, &mut self.spans);
            }
        }
        self.ghosts.end_frame();
    }

    /// Notes where the frame does not show the floor as it is.
    fn cover(&mut self) {
        for ((covered, &class), &mask) in self.covered.iter_mut().zip(&self.class).zip(&self.mask) {
            *covered = u8::from(class != FLOOR || mask != 0);
        }
        // Single pixels are noise, and must not keep the floor from following.
        open_3x3(&mut self.covered, self.size, &mut self.scratch);
        for _ in 0..MARGIN_PX {
            dilate_3x3(&self.covered, self.size, &mut self.scratch);
            std::mem::swap(&mut self.covered, &mut self.scratch);
        }
    }
}

/// Whether an object was near `bounds` in the frame before.
fn known(previous: &[u8], size: Size, bounds: Bounds) -> bool {
    let near = bounds.grown(KNOWN_WITHIN_PX, size);
    (near.top..=near.bottom).any(|y| {
        let row = usize::from(y) * size.width;
        previous[row + usize::from(near.left)..=row + usize::from(near.right)]
            .iter()
            .any(|&mask| mask != 0)
    })
}

/// Calls `work` with the plane of a shape and two pixels around it. `scratch` are planes of the picture.
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
