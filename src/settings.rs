//! All settings that affect the results, apart from markers, calibration and background.
//!
//! A recording contains these settings as TOML, and a replay uses them.

use std::fmt;
use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use crate::marker::RecognitionSettings;
use crate::segmentation::SegmentationSettings;

/// A plate on a robot is closer to the camera than the floor and looks larger: by a third, if the
/// camera is four times as high as the robot.
pub(crate) const PRINTED_SIZE_TOLERANCE: f32 = 1.35;

/// Number of frames used for learning: at most an hour at 30 frames per second.
pub(crate) const LEARN: RangeInclusive<u32> = 1..=108_000;
/// See [`Settings::threshold`]: below, everything is an object; above, nothing is.
pub(crate) const THRESHOLD: RangeInclusive<f32> = 0.1..=1000.0;
/// See [`Settings::area_min`].
pub(crate) const AREA_MIN: RangeInclusive<u32> = 1..=100_000_000;
/// See [`Settings::plate_mm`].
pub(crate) const PLATE_MM: RangeInclusive<f32> = 1.0..=10_000.0;
/// See [`Settings::plate_min`] and [`Settings::plate_max`].
pub(crate) const PLATE_PX: RangeInclusive<f32> = 1.0..=16_384.0;
/// See [`Settings::shadow`].
pub(crate) const SHADOW: RangeInclusive<f32> = 0.0..=1.0;
/// See [`Settings::marker_residual_max`].
pub(crate) const RESIDUAL: RangeInclusive<f32> = 0.0..=1.0;
/// See [`Settings::top_speed`].
pub(crate) const TOP_SPEED: RangeInclusive<f64> = 1e-3..=1e3;
/// See [`Settings::lost_after_s`].
pub(crate) const LOST_AFTER_S: RangeInclusive<f64> = 0.0..=3600.0;
/// See [`Settings::confirm`].
pub(crate) const CONFIRM: RangeInclusive<u32> = 0..=100_000;

/// Minimum contrast between plate and marker, grey levels, if a shape is the only evidence.
const CONTRAST_MIN: f32 = 25.0;

/// Names of current settings in recordings of earlier versions.
const FORMER: [&str; 2] = ["plate_mm", "marker_misfit_max"];

/// A setting is out of range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("the setting {key} is {value}, but must be from {min} to {max}")]
pub struct OutOfRange {
    /// Name of the setting.
    pub key: &'static str,
    value: String,
    min: String,
    max: String,
}

/// Settings of the pipeline. Lengths are in image pixels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Settings {
    /// Number of frames for learning the empty floor if no picture of it is given.
    pub learn: u32,
    /// Minimum peak difference of an object from the background: mean over a 3x3 window, in units
    /// of the noise.
    pub threshold: f32,
    /// A pixel this much darker than the floor may be shadow: share of the floor's lightness, 0 to
    /// 1.
    pub shadow: f32,
    /// Minimum area of a shape, in square pixels.
    pub area_min: u32,
    /// Smallest marker plate.
    pub plate_min: f32,
    /// Largest marker plate.
    pub plate_max: f32,
    /// Side of the printed plates, millimetres: shapes of another size on the calibrated floor are
    /// not markers.
    #[serde(
        rename = "plate",
        alias = "plate_mm",
        skip_serializing_if = "Option::is_none"
    )]
    pub plate_mm: Option<f32>,
    /// Maximum residual of a marker besides noise: RMS over its plate, as a share of the contrast.
    #[serde(alias = "marker_misfit_max")]
    pub marker_residual_max: f32,
    /// Speed of the fastest object, in picture widths per second.
    pub top_speed: f64,
    /// How long a missing object is replaced by its forecast, seconds.
    #[serde(rename = "lost_after")]
    pub lost_after_s: f64,
    /// Number of sightings before an object is reported.
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
            marker_residual_max: 0.05,
            top_speed: 0.75,
            lost_after_s: 0.27,
            confirm: 1,
        }
    }
}

impl Settings {
    /// Settings from the TOML of a recording, and the names in it that this version does not know:
    /// the recording may be from another version, and the settings known to both are used.
    ///
    /// # Errors
    ///
    /// If the text is not TOML, or a value has the wrong type.
    pub fn from_recording(text: &str) -> Result<(Self, Vec<String>), toml::de::Error> {
        let table: toml::Table = toml::from_str(text)?;
        let all = Self {
            plate_mm: Some(0.0),
            ..Self::default()
        };
        let known = toml::Table::try_from(all).unwrap_or_default();
        let unknown = |key: &&String| !known.contains_key(*key) && !FORMER.contains(&key.as_str());
        let unknown = table.keys().filter(unknown).cloned().collect();
        Ok((table.try_into()?, unknown))
    }

    /// Rejects values out of range, as the arguments do, because settings also come from files.
    ///
    /// # Errors
    ///
    /// [`OutOfRange`] with the first such setting.
    pub fn check(&self) -> Result<(), OutOfRange> {
        within("learn", self.learn, LEARN)?;
        within("threshold", self.threshold, THRESHOLD)?;
        within("shadow", self.shadow, SHADOW)?;
        within("area_min", self.area_min, AREA_MIN)?;
        within("plate_min", self.plate_min, PLATE_PX)?;
        within(
            "plate_max",
            self.plate_max,
            self.plate_min..=*PLATE_PX.end(),
        )?;
        if let Some(plate_mm) = self.plate_mm {
            within("plate", plate_mm, PLATE_MM)?;
        }
        within("marker_residual_max", self.marker_residual_max, RESIDUAL)?;
        within("top_speed", self.top_speed, TOP_SPEED)?;
        within("lost_after", self.lost_after_s, LOST_AFTER_S)?;
        within("confirm", self.confirm, CONFIRM)
    }

    /// The settings for segmentation.
    pub(crate) fn segmentation(&self) -> SegmentationSettings {
        SegmentationSettings {
            threshold: self.threshold,
            shadow_min: 1.0 - self.shadow,
            area_min: self.area_min as usize,
        }
    }

    /// The settings for recognition. `metres_per_px` is the width of a pixel on the floor, if
    /// known.
    pub(crate) fn recognition(&self, metres_per_px: Option<f64>) -> RecognitionSettings {
        let printed_px = self
            .plate_mm
            .zip(metres_per_px)
            .map(|(mm, metres)| mm / 1000.0 / metres as f32);
        let [min, max] = match printed_px {
            Some(px) => [px / PRINTED_SIZE_TOLERANCE, px * PRINTED_SIZE_TOLERANCE],
            None => [0.0, f32::INFINITY],
        };
        RecognitionSettings {
            plate_min_px: self.plate_min.max(min),
            plate_max_px: self.plate_max.min(max),
            residual_ratio_max: self.marker_residual_max,
            contrast_min: CONTRAST_MIN,
        }
    }
}

/// The number of frames closest to a duration, at least one.
pub(crate) fn frames_in(time_s: f64, rate_hz: f64) -> u32 {
    (time_s * rate_hz).round().max(1.0) as u32
}

/// NaN is out of every range.
fn within<T: PartialOrd + fmt::Display>(
    key: &'static str,
    value: T,
    range: RangeInclusive<T>,
) -> Result<(), OutOfRange> {
    if range.contains(&value) {
        return Ok(());
    }
    let (min, max) = range.into_inner();
    Err(OutOfRange {
        key,
        value: value.to_string(),
        min: min.to_string(),
        max: max.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recordings_of_other_versions_are_understood_as_far_as_possible() {
        let text = "threshold = 7.0\nmarker_misfit_max = 0.07\nplate_mm = 80.0\nmisses_max = 8\n";
        let (settings, unknown) = Settings::from_recording(text).expect("they are right");
        let expected = Settings {
            threshold: 7.0,
            marker_residual_max: 0.07,
            plate_mm: Some(80.0),
            ..Settings::default()
        };
        assert_eq!(settings, expected);
        assert_eq!(unknown, ["misses_max"]);
        let text = toml::to_string(&expected).expect("text");
        let same = Settings::from_recording(&text).expect("they are right");
        assert_eq!(same, (expected, Vec::new()));
        assert!(Settings::from_recording("threshold = \"high\"").is_err());
    }

    #[test]
    fn every_setting_has_its_range() {
        assert_eq!(Settings::default().check(), Ok(()));
        for text in [
            "learn = 0",
            "threshold = nan",
            "threshold = inf",
            "threshold = 0.0",
            "shadow = 1.5",
            "area_min = 0",
            "plate_min = -1.0",
            "plate_max = 7.0",
            "plate = nan",
            "marker_residual_max = inf",
            "top_speed = 0.0",
            "lost_after = -1.0",
            "confirm = 1000000",
        ] {
            let settings: Settings = toml::from_str(text).expect("settings");
            let error = settings.check().expect_err(text);
            assert!(text.starts_with(error.key), "{text}: {error}");
            assert!(error.to_string().contains("must be from"), "{error}");
        }
    }
}
