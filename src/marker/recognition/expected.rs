//! Markers that are known from the last frames, read where they must be now.

use fourier::wrapped;
use imgproc::fit::{PlateMap, Pose, Prior, fit_curved_shape, fit_shape};

use super::{Fitted, Recognised, RecognitionSettings, explains, likely, priors, read};
use crate::marker::Family;
use crate::marker::cutout::Cutout;
use crate::marker::optics::Optics;
use crate::marker::perspective::Seen;

/// Maximum share of an expected marker's plate that may be hidden. What covers it comes from
/// outside: inside, no more may be hidden than this share, and this multiple of the share at the
/// rim. Otherwise the plate carries another figure.
const EXPECTED_HIDDEN_MAX: f32 = 0.35;
const EXPECTED_HIDDEN_INSIDE: (f32, f32) = (0.03, 2.0);

/// Minimum R² for an expected marker. What covers its plate may be nearly as light.
const EXPECTED_R_SQUARED_MIN: f32 = 0.975;

/// Maximum difference of an expected marker's centre, relative to the plate and in pixels, of its
/// heading, and of the logarithm of its size.
const EXPECTED_OFF: (f32, f32) = (0.1, 1.5);
const EXPECTED_TURNED_RAD: f32 = 0.25;
const EXPECTED_LN_SIGMA: f32 = 0.01;
const EXPECTED_LN_OFF: f32 = 0.04;

/// A marker that must be near, because it was a frame ago. In the coordinates of the cut-out.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Expected {
    /// Index in the family.
    pub(crate) marker: usize,
    pub(crate) centre: [f32; 2],
    pub(crate) heading_rad: f32,
    pub(crate) plate_px: f32,
}

impl Expected {
    /// Where a fit starts.
    fn pose(&self, optics: &Optics) -> Pose {
        Pose {
            centre: self.centre,
            turn_rad: self.heading_rad + std::f32::consts::FRAC_PI_2,
            plate_px: self.plate_px,
            blur_px: optics.imaging.blur_px(),
        }
    }

    /// Whether a marker is where this one is expected.
    fn is_at(&self, read: &Recognised) -> bool {
        let [dx, dy] = [0, 1].map(|i| read.centre[i] - self.centre[i]);
        let (share, px) = EXPECTED_OFF;
        dx.hypot(dy) < share * self.plate_px + px
            && wrapped(read.heading_rad - self.heading_rad).abs() < EXPECTED_TURNED_RAD
            && (read.plate_px / self.plate_px).ln().abs() < EXPECTED_LN_OFF
    }
}

impl Family {
    /// Reads a marker where it is expected, although something may cover a part of its plate.
    pub(crate) fn recognise_covered(
        &self,
        expected: &Expected,
        cutout: Cutout<'_>,
        optics: &Optics,
        settings: &RecognitionSettings,
    ) -> Option<Recognised> {
        let pose = expected.pose(optics);
        let layers = self.markers[expected.marker].template.layers();
        let Cutout { grey, size, .. } = cutout;
        let (prior, stretch) = priors(optics, settings, pose.plate_px);
        let prior = Prior {
            plate_ln_sigma: EXPECTED_LN_SIGMA,
            may_be_covered: true,
            ..prior
        };
        let fit = if optics.stretch.seen() == Seen::Unknown {
            fit_shape(grey, size, None, layers, pose, &prior)?
        } else {
            let map = PlateMap::stretched(&pose, stretch.stretch);
            let curved = fit_curved_shape(grey, size, None, layers, map, &prior, &stretch)?;
            likely(curved, optics)?.fit
        };
        let read = read(expected.marker, &fit, settings)?;
        let [inside, rim] = fit.hidden;
        let (least, per_rim) = EXPECTED_HIDDEN_INSIDE;
        (expected.is_at(&read)
            && inside < EXPECTED_HIDDEN_MAX
            && inside < least + per_rim * rim
            && fit.r_squared >= EXPECTED_R_SQUARED_MIN
            && explains(&fit, optics.imaging.noise(), settings))
        .then_some(read)
    }

    /// Reads a marker where it is expected, without a look at other markers. `None` if its whole plate
    /// is not there, and while the perspective of the camera is unknown.
    pub(crate) fn recognise_again(
        &self,
        expected: &Expected,
        cutout: Cutout<'_>,
        optics: &Optics,
        settings: &RecognitionSettings,
    ) -> Option<Recognised> {
        if optics.stretch.seen() == Seen::Unknown {
            return None;
        }
        let layers = self.markers[expected.marker].template.layers();
        let Cutout { grey, size, .. } = cutout;
        let (prior, stretch) = priors(optics, settings, expected.plate_px);
        let start = PlateMap::stretched(&expected.pose(optics), stretch.stretch);
        let curved = fit_curved_shape(grey, size, None, layers, start, &prior, &stretch)?;
        let Fitted { fit, stretch } = likely(curved, optics)?;
        let read = read(expected.marker, &fit, settings)?;
        (expected.is_at(&read) && explains(&fit, optics.imaging.noise(), settings)).then(|| {
            Recognised {
                imaging: optics.imaging.reading(&fit),
                stretch,
                ..read
            }
        })
    }
}
