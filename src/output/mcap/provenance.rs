//! The provenance stored in a recording, which allows a replay to repeat the run.
//!
//! A recording starts with one MCAP metadata record named `overcam` and a few attachments. The
//! metadata record holds short facts as text: the source of the frames, their size and format, the
//! locked values of the camera's controls, the offset between exposure times and log times, and the
//! settings of the run as TOML. The attachments hold the files of the run: `markers/NAME.svg`,
//! `calibration.toml` and `region.png`. Numbers are written in the shortest form that reads back to
//! the same value.
//!
//! Deliberately absent: anything known only later (counts, durations). MCAP's own summary has it.

use std::collections::BTreeMap;
use std::str::FromStr;

use imgproc::Size;

use crate::image::frame::PixelFormat;
use crate::image::limits::{AREA_MAX, MAX_SIDE, size_is_possible};
use crate::marker::MarkerFile;
use crate::output::foxglove::image_message::ImageMode;
use crate::run::slot::SourceInfo;

/// Name of the metadata record that identifies an MCAP file as a recording of overcam.
pub(crate) const METADATA_NAME: &str = "overcam";
/// Attachment with the background. There may be several; each applies from the next frame on.
pub(crate) const BACKGROUND_NAME: &str = "background.png";
const CALIBRATION_NAME: &str = "calibration.toml";
const REGION_NAME: &str = "region.png";
const MARKER_FOLDER: &str = "markers/";
const MARKER_SUFFIX: &str = ".svg";

const FORMAT_NAMES: [(PixelFormat, &str); 9] = [
    (PixelFormat::Grey, "grey"),
    (PixelFormat::Rgb, "rgb"),
    (PixelFormat::Yuyv, "yuyv"),
    (PixelFormat::Uyvy, "uyvy"),
    (PixelFormat::Nv12, "nv12"),
    (PixelFormat::I420, "i420"),
    (PixelFormat::I422, "i422"),
    (PixelFormat::I444, "i444"),
    (PixelFormat::Jpeg, "jpeg"),
];

/// How a recording was made: the data besides the frames that a replay needs for the same results.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Provenance {
    /// Version of overcam that made the recording.
    pub version: String,
    /// Name of the source, from [`SourceInfo::name`].
    pub source: String,
    /// Settings of the run, as TOML text.
    pub settings: String,
    /// The marker family, in the order in which it was loaded.
    pub markers: Vec<MarkerFile>,
    /// The calibration file, as TOML text.
    pub calibration: Option<String>,
    /// The region as a PNG file.
    pub region: Option<Vec<u8>>,
    /// Homography from pixels to metres on the floor, row by row, if the results are in metres.
    pub floor_from_image: Option<[[f64; 3]; 3]>,
}

/// Facts about the frames in the metadata record.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Frames {
    /// Size of every frame.
    pub(crate) size: Size,
    /// Layout of the stored frames.
    pub(crate) stored_format: PixelFormat,
    /// Frames per second, if the source stated it.
    pub(crate) rate_hz: Option<f64>,
    /// Offset from exposure times to log times.
    pub(crate) wall_offset_ns: u64,
    /// The camera's controls, from [`SourceInfo::controls`].
    pub(crate) controls: Option<String>,
}

/// Errors in a metadata record or an attachment.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ProvenanceError {
    /// A key is missing in the metadata record.
    #[error("its metadata lacks the key `{0}`")]
    MissingKey(&'static str),
    /// The value of a key is invalid.
    #[error("its metadata has the unreadable value {value:?} for the key `{key}`")]
    BadValue {
        /// The key.
        key: &'static str,
        /// Its value.
        value: String,
    },
    /// The frame size is above the limit.
    #[error(
        "its metadata claims frames of {}x{} pixels; sides must be 1 to {MAX_SIDE}, and no more than {AREA_MAX} in all",
        .0.width, .0.height
    )]
    Size(Size),
    /// A text attachment is not valid UTF-8.
    #[error("its attachment `{0}` is not UTF-8 text")]
    NotText(String),
}

/// A file of the run as stored in the recording.
pub(crate) struct AttachedFile<'a> {
    pub(crate) name: String,
    pub(crate) media_type: &'static str,
    pub(crate) data: &'a [u8],
}

impl Provenance {
    /// The files to attach, in writing order.
    pub(crate) fn attached_files(&self) -> Vec<AttachedFile<'_>> {
        let markers = self.markers.iter().map(|marker| AttachedFile {
            name: format!("{MARKER_FOLDER}{}{MARKER_SUFFIX}", marker.name),
            media_type: "image/svg+xml",
            data: marker.svg.as_bytes(),
        });
        let calibration = self.calibration.iter().map(|text| AttachedFile {
            name: CALIBRATION_NAME.to_owned(),
            media_type: "application/toml",
            data: text.as_bytes(),
        });
        let region = self.region.iter().map(|png| AttachedFile {
            name: REGION_NAME.to_owned(),
            media_type: "image/png",
            data: png,
        });
        markers.chain(calibration).chain(region).collect()
    }

    /// Adds an attachment of a recording; unknown attachments are ignored.
    pub(crate) fn add_attachment(
        &mut self,
        name: &str,
        data: &[u8],
    ) -> Result<(), ProvenanceError> {
        let text = || {
            String::from_utf8(data.to_vec()).map_err(|_| ProvenanceError::NotText(name.to_owned()))
        };
        if name == CALIBRATION_NAME {
            self.calibration = Some(text()?);
        } else if name == REGION_NAME {
            self.region = Some(data.to_vec());
        } else if let Some(marker) = name
            .strip_prefix(MARKER_FOLDER)
            .and_then(|file| file.strip_suffix(MARKER_SUFFIX))
        {
            self.markers.push(MarkerFile {
                name: marker.to_owned(),
                svg: text()?,
            });
        }
        Ok(())
    }
}

/// The metadata record of a new recording.
pub(crate) fn to_metadata(
    info: &SourceInfo,
    provenance: &Provenance,
    mode: ImageMode,
    wall_offset_ns: u64,
) -> BTreeMap<String, String> {
    let images = match mode {
        ImageMode::Lossless => "lossless".to_owned(),
        ImageMode::Jpeg { quality } => format!("jpeg, quality {quality}"),
    };
    let mut metadata = BTreeMap::from(
        [
            ("version", provenance.version.clone()),
            ("source", provenance.source.clone()),
            ("settings", provenance.settings.clone()),
            ("width", info.size.width.to_string()),
            ("height", info.size.height.to_string()),
            ("source_format", format_name(info.format).to_owned()),
            (
                "stored_format",
                format_name(mode.stored_format(info.format, info.size)).to_owned(),
            ),
            ("images", images),
            ("live", info.live.to_string()),
            ("wall_offset_ns", wall_offset_ns.to_string()),
        ]
        .map(|(key, value)| (key.to_owned(), value)),
    );
    if let Some(rate_hz) = info.rate_hz {
        metadata.insert("rate_hz".to_owned(), rate_hz.to_string());
    }
    if let Some(controls) = &info.controls {
        metadata.insert("controls".to_owned(), controls.clone());
    }
    if let Some(rows) = provenance.floor_from_image {
        let numbers: Vec<String> = rows.as_flattened().iter().map(f64::to_string).collect();
        metadata.insert("floor_from_image".to_owned(), numbers.join(" "));
    }
    metadata
}

/// Reads the metadata record of a recording. Markers, calibration and region are attachments and
/// still missing.
pub(crate) fn from_metadata(
    metadata: &BTreeMap<String, String>,
) -> Result<(Frames, Provenance), ProvenanceError> {
    let text = |key| {
        metadata
            .get(key)
            .cloned()
            .ok_or(ProvenanceError::MissingKey(key))
    };
    let size = Size {
        width: number(metadata, "width")?,
        height: number(metadata, "height")?,
    };
    // Memory is allocated according to these.
    if !size_is_possible(size) {
        return Err(ProvenanceError::Size(size));
    }
    let rate_hz: Option<f64> = match metadata.get("rate_hz") {
        Some(_) => Some(number(metadata, "rate_hz")?),
        None => None,
    };
    if let Some(rate) = rate_hz.filter(|rate| !(rate.is_finite() && *rate > 0.0)) {
        return Err(ProvenanceError::BadValue {
            key: "rate_hz",
            value: rate.to_string(),
        });
    }
    let frames = Frames {
        size,
        stored_format: stored_format(&text("stored_format")?)?,
        rate_hz,
        wall_offset_ns: number(metadata, "wall_offset_ns")?,
        controls: metadata.get("controls").cloned(),
    };
    let provenance = Provenance {
        version: text("version")?,
        source: text("source")?,
        settings: text("settings")?,
        markers: Vec::new(),
        calibration: None,
        region: None,
        floor_from_image: floor_from_image(metadata)?,
    };
    Ok((frames, provenance))
}

fn number<T: FromStr>(
    metadata: &BTreeMap<String, String>,
    key: &'static str,
) -> Result<T, ProvenanceError> {
    let value = metadata
        .get(key)
        .ok_or(ProvenanceError::MissingKey(key))?
        .clone();
    value
        .parse()
        .map_err(|_| ProvenanceError::BadValue { key, value })
}

fn floor_from_image(
    metadata: &BTreeMap<String, String>,
) -> Result<Option<[[f64; 3]; 3]>, ProvenanceError> {
    let key = "floor_from_image";
    let Some(value) = metadata.get(key) else {
        return Ok(None);
    };
    let bad_value = || ProvenanceError::BadValue {
        key,
        value: value.clone(),
    };
    let numbers: Vec<f64> = value
        .split(' ')
        .map(|number| number.parse().map_err(|_| bad_value()))
        .collect::<Result<_, _>>()?;
    match numbers[..] {
        [a, b, c, d, e, f, g, h, i] => Ok(Some([[a, b, c], [d, e, f], [g, h, i]])),
        _ => Err(bad_value()),
    }
}

fn format_name(format: PixelFormat) -> &'static str {
    FORMAT_NAMES
        .iter()
        .find(|(known, _)| *known == format)
        .map_or("unknown", |(_, name)| name)
}

fn stored_format(value: &str) -> Result<PixelFormat, ProvenanceError> {
    FORMAT_NAMES
        .iter()
        .find(|(_, name)| *name == value)
        .map(|(format, _)| *format)
        .ok_or_else(|| ProvenanceError::BadValue {
            key: "stored_format",
            value: value.to_owned(),
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> (SourceInfo, Provenance) {
        let info = SourceInfo {
            name: "Integrated Camera (/dev/video0)".to_owned(),
            size: Size {
                width: 640,
                height: 480,
            },
            format: PixelFormat::I420,
            rate_hz: Some(30000.0 / 1001.0),
            live: true,
            controls: Some("locked exposure 15600 us; no control of focus".to_owned()),
        };
        let provenance = Provenance {
            version: "0.1.0".to_owned(),
            source: info.name.clone(),
            settings: "[detection]\nthreshold = 24\n".to_owned(),
            markers: Vec::new(),
            calibration: None,
            region: None,
            floor_from_image: Some([
                [0.1 + 0.2, -1e-17, 3.0],
                [1.0 / 3.0, 5e300, 0.0],
                [0.0, -0.0, 1.0],
            ]),
        };
        (info, provenance)
    }

    #[test]
    fn metadata_reads_back_to_the_same_values() {
        let (info, provenance) = example();
        let metadata = to_metadata(&info, &provenance, ImageMode::Lossless, 1_790_000_000_123);
        let (frames, read) = from_metadata(&metadata).expect("own metadata is readable");
        assert_eq!(read, provenance);
        let expected = Frames {
            size: info.size,
            // Foxglove does not support I420.
            stored_format: PixelFormat::Rgb,
            rate_hz: info.rate_hz,
            wall_offset_ns: 1_790_000_000_123,
            controls: info.controls,
        };
        assert_eq!(frames, expected);
    }

    #[test]
    fn every_format_has_a_name_of_its_own() {
        for (format, name) in FORMAT_NAMES {
            assert_eq!(format_name(format), name);
            assert_eq!(stored_format(name), Ok(format));
        }
    }

    #[test]
    fn errors_name_the_key_and_the_value() {
        let (info, provenance) = example();
        let good = to_metadata(&info, &provenance, ImageMode::Lossless, 0);

        let mut metadata = good.clone();
        metadata.remove("width");
        assert_eq!(
            from_metadata(&metadata),
            Err(ProvenanceError::MissingKey("width"))
        );

        for (key, value) in [
            ("height", "-3"),
            ("stored_format", "bayer"),
            ("floor_from_image", "1 2 3"),
            ("floor_from_image", "1 2 3 4 5 6 7 8 nine"),
            ("rate_hz", "0"),
            ("rate_hz", "NaN"),
        ] {
            let mut metadata = good.clone();
            metadata.insert(key.to_owned(), value.to_owned());
            let value = value.to_owned();
            assert_eq!(
                from_metadata(&metadata),
                Err(ProvenanceError::BadValue { key, value })
            );
        }
    }

    #[test]
    fn no_more_pixels_are_believed_than_a_picture_may_have() {
        let (info, provenance) = example();
        let good = to_metadata(&info, &provenance, ImageMode::Lossless, 0);
        for side in ["0", "16384", "100000", "18446744073709551615"] {
            let mut metadata = good.clone();
            for key in ["width", "height"] {
                metadata.insert(key.to_owned(), side.to_owned());
            }
            let error = from_metadata(&metadata).expect_err(side);
            assert!(matches!(error, ProvenanceError::Size(_)), "{error}");
        }
    }

    #[test]
    fn attached_files_read_back() {
        let provenance = Provenance {
            markers: vec![
                MarkerFile {
                    name: "drop".to_owned(),
                    svg: "<svg/>".to_owned(),
                },
                MarkerFile {
                    name: "arrow.left".to_owned(),
                    svg: "<svg></svg>".to_owned(),
                },
            ],
            calibration: Some("points = []".to_owned()),
            region: Some(vec![0x89, 0, 0xff]),
            ..Provenance::default()
        };
        let mut read = Provenance::default();
        for file in provenance.attached_files() {
            read.add_attachment(&file.name, file.data)
                .expect("own attachment is readable");
        }
        read.add_attachment("notes.txt", b"\xff")
            .expect("a stranger's attachment is ignored");
        assert_eq!(read, provenance);
        assert_eq!(
            read.add_attachment("markers/x.svg", b"\xff"),
            Err(ProvenanceError::NotText("markers/x.svg".to_owned()))
        );
    }
}
