//! Everything that decides what is found, apart from markers, calibration and background.
//!
//! A recording carries these settings as TOML, and a replay uses them.

use serde::{Deserialize, Serialize};

use crate::marker::RecognitionSettings;
use crate::segmentation::SegmentationSettings;

/// A plate on a robot is nearer to the camera than the floor and looks larger: by a third, where the camera hangs four times as
/// high as the robot is.
const PRINTED_SIZE_TOLERANCE: f32 = 1.35;

/// Settings of the pipeline. Lengths are pixels of the image.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Frames from which the empty floor is learned when no picture of it is given.
    pub learn: u32,
    /// Least difference from the floor that an object has somewhere: mean over a 3x3 window, in units of the noise.
    pub threshold: f32,
    /// A pixel this much darker than the floor may be shadow: share of the floor's lightness, 0 to 1.
    pub shadow: f32,
    /// Smallest shape that counts, in square pixels.
    pub area_min: u32,
    /// Smallest plate of a marker.
    pub plate_min: f32,
    /// Largest plate of a marker.
    pub plate_max: f32,
    /// Side of the printed plates, millimetres: what has another size on the calibrated floor is no marker.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plate_mm: Option<f32>,
    /// What a marker may leave unexplained besides noise: root mean square over its plate, share of the contrast.
    pub marker_misfit_max: f32,
    /// Speed of the fastest object, in widths of the picture a second.
    pub top_speed: f64,
    /// Frames for which a missing object is replaced by its forecast.
    pub misses_max: u32,
    /// Sightings before an object is reported.
    pub confirm: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            learn: 30,
            threshold: 5.0,
            shadow: 0.6,
            area_min: 80,
            plate_min: 8.0,
            plate_max: 400.0,
            plate_mm: None,
            marker_misfit_max: 0.05,
            top_speed: 0.75,
            misses_max: 8,
            confirm: 1,
        }
    }
}

impl Settings {
    /// The part that segmentation needs.
    pub(crate) fn segmentation(&self) -> SegmentationSettings {
        SegmentationSettings {
            threshold: self.threshold,
            shadow_least: 1.0 - self.shadow,
            area_min: self.area_min as usize,
        }
    }

    /// The part that recognition needs. `metres_per_px` is the width of a pixel on the floor, where it is known.
    pub(crate) fn recognition(&self, metres_per_px: Option<f64>) -> RecognitionSettings {
        let printed_px = self
            .plate_mm
            .zip(metres_per_px)
            .map(|(mm, metres)| mm / 1000.0 / metres as f32);
        let [least, most] = match printed_px {
            Some(px) => [px / PRINTED_SIZE_TOLERANCE, px * PRINTED_SIZE_TOLERANCE],
            None => [0.0, f32::INFINITY],
        };
        RecognitionSettings {
            plate_min_px: self.plate_min.max(least),
            plate_max_px: self.plate_max.min(most),
            misfit_max: self.marker_misfit_max,
        }
    }
}
