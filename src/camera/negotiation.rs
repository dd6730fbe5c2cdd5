//! Selects the format and size requested from a camera.
//!
//! The user's requests must be met exactly, except for the rate;
//! [`Camera::info`](crate::camera::Camera::info) returns the rate that the camera has chosen. If no
//! size is requested: the largest up to 1920x1080 that the camera delivers at 25 frames/s or more,
//! or at the requested rate if that is lower; if there is none, the fastest. The default rate is 30
//! frames/s. Of the formats in this size, the first in this order that reaches the rate is used, or
//! the fastest one if none does: YUYV, UYVY, NV12, YU12, RGB3, MJPG, JPEG. Raw formats come first
//! because compression blurs the edges used for measuring positions; if a camera is fast only with
//! MJPG, MJPG is used. GREY is used only if it is requested or the only one, because a grey frame
//! has no hue.

use imgproc::Size;

use crate::camera::error::CameraError;
use crate::camera::request::CameraRequest;
use crate::camera::v4l2::{Device, FourCc, Fraction, Intervals, Sizes};
use crate::image::frame::PixelFormat;

/// The supported formats, in order of preference.
const READABLE: [(FourCc, PixelFormat); 8] = [
    (*b"YUYV", PixelFormat::Yuyv),
    (*b"UYVY", PixelFormat::Uyvy),
    (*b"NV12", PixelFormat::Nv12),
    (*b"YU12", PixelFormat::I420),
    (*b"RGB3", PixelFormat::Rgb),
    (*b"MJPG", PixelFormat::Jpeg),
    (*b"JPEG", PixelFormat::Jpeg),
    (*b"GREY", PixelFormat::Grey),
];

/// Maximum default size.
const DEFAULT_SIZE_MAX: Size = Size {
    width: 1920,
    height: 1080,
};
/// Minimum frames per second for the default size.
const DEFAULT_SIZE_RATE_HZ: f64 = 25.0;
/// Sizes considered if a camera offers a continuous range.
const COMMON_SIZES: [Size; 3] = [
    DEFAULT_SIZE_MAX,
    Size {
        width: 1280,
        height: 720,
    },
    Size {
        width: 640,
        height: 480,
    },
];
/// Tolerance: many cameras mean 29.97 by 30.
const RATE_SHARE: f64 = 0.99;
/// Default frames per second.
pub(crate) const DEFAULT_RATE_HZ: f64 = 30.0;

/// The frame interval for a rate, in a form that drivers compare well: 1/30, 100/2997.
pub(crate) fn interval(rate_hz: f64) -> Fraction {
    let numerator = if rate_hz.fract() == 0.0 { 1 } else { 100 };
    Fraction {
        numerator,
        denominator: (rate_hz * f64::from(numerator)).round().max(1.0) as u32,
    }
}

/// A format offered by a camera, with its sizes; no sizes if the camera does not state them.
#[derive(Debug)]
struct Offer {
    fourcc: FourCc,
    sizes: Vec<Sizes>,
}

/// Mode requested from a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Choice {
    pub(crate) fourcc: FourCc,
    pub(crate) format: PixelFormat,
    pub(crate) size: Size,
}

/// A possible mode, and its maximum rate as stated by the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Mode {
    choice: Choice,
    /// `None` if not stated.
    fastest_hz: Option<f64>,
}

impl Mode {
    fn reaches(&self, rate_hz: f64) -> bool {
        self.fastest_hz
            .is_none_or(|fastest_hz| fastest_hz >= RATE_SHARE * rate_hz)
    }
}

/// The mode to request and the alternatives in other sizes, or the reason why nothing offered is
/// suitable.
pub(crate) fn negotiate(
    device: &Device,
    name: &str,
    request: &CameraRequest,
) -> Result<(Choice, Vec<Mode>), CameraError> {
    let offers: Vec<Offer> = device
        .formats()
        .into_iter()
        .map(|fourcc| Offer {
            fourcc,
            sizes: device.sizes(fourcc),
        })
        .collect();
    let fastest_hz = |fourcc, size| {
        let intervals = device.intervals(fourcc, size);
        let shortest = intervals.iter().map(|interval| match interval {
            Intervals::One(interval) => interval,
            Intervals::Range { shortest, .. } => shortest,
        });
        shortest.map(|interval| interval.rate_hz()).reduce(f64::max)
    };
    let Some(choice) = choose(&modes(&offers, request, fastest_hz), request) else {
        return Err(refusal(&offers, name, request));
    };
    let any_size = CameraRequest {
        size: None,
        ..*request
    };
    Ok((choice, modes(&offers, &any_size, fastest_hz)))
}

/// Notes for the user if the camera delivers less than requested, or less than it could, one per
/// line.
pub(crate) fn notes(
    modes: &[Mode],
    request: &CameraRequest,
    given: Size,
    given_hz: Option<f64>,
) -> Vec<String> {
    let text = |size: Size| format!("{}x{}", size.width, size.height);
    let rounded = |rate_hz: f64| (rate_hz * 100.0).round() / 100.0;
    let mut notes = Vec::new();
    if let (Some(asked_hz), Some(given_hz)) = (request.rate_hz, given_hz)
        && (given_hz - asked_hz).abs() > (1.0 - RATE_SHARE) * asked_hz
    {
        let at_rate = modes.iter().filter(|mode| {
            mode.fastest_hz.is_some() && mode.reaches(asked_hz) && mode.choice.size != given
        });
        let remedy = match at_rate.max_by_key(|mode| mode.choice.size.area()) {
            Some(mode) if asked_hz > given_hz => {
                format!("so fast it is with --size {}", text(mode.choice.size))
            }
            _ => "`overcam devices` lists its rates".to_owned(),
        };
        notes.push(format!(
            "{} frames/s were asked for, and it gives {} at {}; {remedy}",
            rounded(asked_hz),
            rounded(given_hz),
            text(given)
        ));
    }
    let larger = modes
        .iter()
        .filter(|mode| mode.choice.size.area() > given.area() && is_default(mode.choice.size));
    let fastest = larger.max_by(|a, b| {
        let key = |mode: &Mode| (mode.choice.size.area(), mode.fastest_hz.unwrap_or(0.0));
        key(a)
            .partial_cmp(&key(b))
            .unwrap_or(std::cmp::Ordering::Equal)
    });
    if let (None, Some(mode)) = (request.size, fastest)
        && let Some(rate_hz) = mode.fastest_hz
    {
        let size = text(mode.choice.size);
        notes.push(format!(
            "it has larger pictures, {size} at {} frames/s, which is slow; --size {size} takes them",
            rounded(rate_hz)
        ));
    }
    notes
}

/// The error if no mode is suitable: no such format, or not in the requested size.
fn refusal(offers: &[Offer], name: &str, request: &CameraRequest) -> CameraError {
    let fits = |offer: &&Offer| {
        let format = readable(offer.fourcc);
        format.is_some_and(|format| request.format.is_none_or(|requested| requested == format))
    };
    let mut sizes: Vec<String> = Vec::new();
    for size in offers.iter().filter(fits).flat_map(|offer| &offer.sizes) {
        let size = size.to_string();
        if !sizes.contains(&size) {
            sizes.push(size);
        }
    }
    if let Some(size) = request.size
        && !sizes.is_empty()
    {
        return CameraError::Size {
            path: name.to_owned(),
            size,
            offered: sizes.join(", "),
        };
    }
    let names = |fourccs: &mut dyn Iterator<Item = FourCc>| {
        let names: Vec<String> = fourccs.map(text).collect();
        names.join(", ")
    };
    let requested = READABLE
        .iter()
        .filter(|(_, format)| request.format.is_none_or(|requested| requested == *format))
        .map(|&(fourcc, _)| fourcc);
    CameraError::Format {
        path: name.to_owned(),
        requested: match request.format {
            Some(_) => names(&mut { requested }),
            None => format!("any of {}", names(&mut { requested })),
        },
        offered: match offers.is_empty() {
            true => "nothing".to_owned(),
            false => names(&mut offers.iter().map(|offer| offer.fourcc)),
        },
    }
}

/// All supported modes that match the request, in order of preference. `fastest_hz` returns the
/// maximum rate for a format and size, if the camera states it.
fn modes(
    offers: &[Offer],
    request: &CameraRequest,
    fastest_hz: impl Fn(FourCc, Size) -> Option<f64>,
) -> Vec<Mode> {
    let mut modes: Vec<Mode> = Vec::new();
    for (fourcc, format) in READABLE {
        let Some(offer) = offers.iter().find(|offer| offer.fourcc == fourcc) else {
            continue;
        };
        if request.format.is_some_and(|requested| requested != format) {
            continue;
        }
        let mut sizes: Vec<Size> = offer
            .sizes
            .iter()
            .flat_map(|s| sizes(s, request.size))
            .collect();
        if offer.sizes.is_empty() {
            sizes.push(request.size.unwrap_or(DEFAULT_SIZE_MAX));
        }
        sizes.retain(|&size| request.size.is_none_or(|requested| requested == size));
        modes.extend(sizes.into_iter().map(|size| Mode {
            choice: Choice {
                fourcc,
                format,
                size,
            },
            fastest_hz: fastest_hz(fourcc, size),
        }));
    }
    if modes
        .iter()
        .any(|mode| mode.choice.format != PixelFormat::Grey)
    {
        modes.retain(|mode| mode.choice.format != PixelFormat::Grey);
    }
    modes
}

/// Implements the rule in the module documentation.
fn choose(modes: &[Mode], request: &CameraRequest) -> Option<Choice> {
    let fastest = |modes: &mut dyn Iterator<Item = &Mode>| {
        // The first of the fastest.
        modes.copied().reduce(|best, mode| {
            let hz = |mode: Mode| mode.fastest_hz.unwrap_or(f64::INFINITY);
            if hz(mode) > hz(best) { mode } else { best }
        })
    };
    let size = request.size.or_else(|| {
        let least_hz = request.rate_hz.map_or(DEFAULT_SIZE_RATE_HZ, |rate_hz| {
            rate_hz.min(DEFAULT_SIZE_RATE_HZ)
        });
        let mut usual = modes.iter().filter(|mode| is_default(mode.choice.size));
        let largest = usual
            .clone()
            .filter(|mode| mode.reaches(least_hz))
            .max_by_key(|mode| mode.choice.size.area());
        let chosen = largest.copied().or_else(|| fastest(&mut usual));
        // For cameras that offer only larger sizes.
        let chosen = chosen.or_else(|| modes.iter().min_by_key(|m| m.choice.size.area()).copied());
        chosen.map(|mode| mode.choice.size)
    })?;
    let rate_hz = request.rate_hz.unwrap_or(DEFAULT_RATE_HZ);
    let of_size = || modes.iter().filter(|mode| mode.choice.size == size);
    let first = of_size().find(|mode| mode.reaches(rate_hz)).copied();
    let mode = first.or_else(|| fastest(&mut of_size()))?;
    Some(mode.choice)
}

/// Whether a size may be used by default.
fn is_default(size: Size) -> bool {
    size.width <= DEFAULT_SIZE_MAX.width && size.height <= DEFAULT_SIZE_MAX.height
}

/// The sizes worth considering.
fn sizes(offered: &Sizes, requested: Option<Size>) -> Vec<Size> {
    match (offered, requested) {
        (&Sizes::One(size), _) => vec![size],
        (grid, Some(requested)) => vec![nearest(grid, requested)],
        (grid, None) => COMMON_SIZES.map(|size| nearest(grid, size)).to_vec(),
    }
}

/// The largest size offered that does not exceed `wanted`, or the smallest.
fn nearest(sizes: &Sizes, wanted: Size) -> Size {
    match *sizes {
        Sizes::One(size) => size,
        Sizes::Grid { min, max, step } => {
            let side = |min: usize, max: usize, step: usize, wanted: usize| {
                let (step, max) = (step.max(1), max.max(min));
                let n_steps = (wanted.clamp(min, max) - min) / step;
                min + step * n_steps.min((max - min) / step)
            };
            Size {
                width: side(min.width, max.width, step.width, wanted.width),
                height: side(min.height, max.height, step.height, wanted.height),
            }
        }
    }
}

/// The pixel format of a FourCC, if it is supported.
pub(crate) fn readable(fourcc: FourCc) -> Option<PixelFormat> {
    READABLE
        .iter()
        .find(|(readable, _)| *readable == fourcc)
        .map(|&(_, format)| format)
}

/// A FourCC as text, with unprintable characters replaced.
pub(crate) fn text(fourcc: FourCc) -> String {
    fourcc
        .iter()
        .map(|&byte| match byte {
            b' '..=b'~' => char::from(byte),
            _ => '?',
        })
        .collect::<String>()
        .trim_end()
        .to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn size(width: usize, height: usize) -> Size {
        Size { width, height }
    }

    fn offer(fourcc: &FourCc, sizes: &[(usize, usize)]) -> Offer {
        Offer {
            fourcc: *fourcc,
            sizes: sizes.iter().map(|&(w, h)| Sizes::One(size(w, h))).collect(),
        }
    }

    /// A typical webcam: raw formats are slow at large sizes.
    fn webcam() -> Vec<Offer> {
        vec![
            offer(b"H264", &[(1920, 1080)]),
            offer(b"MJPG", &[(1280, 720), (640, 480), (320, 240)]),
            offer(b"YUYV", &[(1280, 720), (640, 480), (320, 240)]),
            offer(b"GREY", &[(640, 480)]),
        ]
    }

    fn webcam_hz(fourcc: FourCc, size: Size) -> Option<f64> {
        match (&fourcc, size.width) {
            (b"YUYV", 1280) => Some(10.0),
            (b"YUYV", 640) => Some(29.97),
            (b"MJPG" | b"GREY", _) => Some(60.0),
            _ => Some(30.0),
        }
    }

    fn chosen(offers: &[Offer], request: &CameraRequest) -> Option<(FourCc, (usize, usize))> {
        choose(&modes(offers, request, webcam_hz), request)
            .map(|choice| (choice.fourcc, (choice.size.width, choice.size.height)))
    }

    #[test]
    fn the_largest_size_that_is_fast_enough_is_taken_and_raw_if_that_is_fast_enough_too() {
        let nothing = CameraRequest::default();
        assert_eq!(chosen(&webcam(), &nothing), Some((*b"MJPG", (1280, 720))));
        let of_size = |width, height| CameraRequest {
            size: Some(size(width, height)),
            ..nothing
        };
        assert_eq!(
            chosen(&webcam(), &of_size(640, 480)),
            Some((*b"YUYV", (640, 480)))
        );
        let large = of_size(1280, 720);
        assert_eq!(chosen(&webcam(), &large), Some((*b"MJPG", (1280, 720))));
        let at = |rate_hz, request| CameraRequest {
            rate_hz: Some(rate_hz),
            ..request
        };
        assert_eq!(
            chosen(&webcam(), &at(10.0, nothing)),
            Some((*b"YUYV", (1280, 720)))
        );
        assert_eq!(
            chosen(&webcam(), &at(1000.0, nothing)),
            Some((*b"MJPG", (1280, 720)))
        );
    }

    /// Sizes of a camera without compression, and the rate of each.
    const RAW_HZ: [((usize, usize), f64); 4] = [
        ((320, 180), 60.0),
        ((640, 480), 25.0),
        ((1920, 1080), 5.0),
        ((3840, 2160), 2.0),
    ];

    fn raw_modes(request: &CameraRequest, n: usize, of: usize) -> Vec<Mode> {
        let sizes: Vec<(usize, usize)> = RAW_HZ[n..of].iter().map(|&(size, _)| size).collect();
        modes(&[offer(b"YUYV", &sizes)], request, |_, size| {
            let found = RAW_HZ.iter().find(|(s, _)| *s == (size.width, size.height));
            found.map(|&(_, rate_hz)| rate_hz)
        })
    }

    #[test]
    fn sizes_that_are_slow_or_very_large_are_a_last_resort() {
        let request = CameraRequest::default();
        let size_of =
            |n, of| choose(&raw_modes(&request, n, of), &request).map(|choice| choice.size);
        assert_eq!(size_of(0, 4), Some(size(640, 480)));
        assert_eq!(size_of(2, 4), Some(size(1920, 1080)));
        assert_eq!(size_of(3, 4), Some(size(3840, 2160)));
        let slow = CameraRequest {
            rate_hz: Some(5.0),
            ..request
        };
        let chosen = choose(&raw_modes(&slow, 0, 4), &slow).map(|choice| choice.size);
        assert_eq!(chosen, Some(size(1920, 1080)));
    }

    #[test]
    fn what_a_camera_gives_instead_is_reported() {
        let notes_for = |rate_hz, requested, given_hz| {
            let request = CameraRequest {
                rate_hz,
                size: requested,
                ..CameraRequest::default()
            };
            let given = size(640, 480);
            notes(
                &raw_modes(
                    &CameraRequest {
                        size: None,
                        ..request
                    },
                    0,
                    4,
                ),
                &request,
                given,
                Some(given_hz),
            )
        };
        let vga = Some(size(640, 480));
        assert_eq!(
            notes_for(Some(60.0), vga, 25.0),
            [
                "60 frames/s were asked for, and it gives 25 at 640x480; so fast it is with --size 320x180"
            ]
        );
        assert_eq!(
            notes_for(Some(100.0), vga, 25.0),
            [
                "100 frames/s were asked for, and it gives 25 at 640x480; `overcam devices` lists its rates"
            ]
        );
        assert!(notes_for(Some(25.0), vga, 25.0).is_empty());
        assert!(notes_for(Some(29.97), vga, 30.0).is_empty());
        assert!(notes_for(None, vga, 25.0).is_empty());
        assert_eq!(
            notes_for(None, None, 25.0),
            [
                "it has larger pictures, 1920x1080 at 5 frames/s, which is slow; --size 1920x1080 takes them"
            ]
        );
    }

    #[test]
    fn requests_are_met_exactly_or_not_at_all() {
        let request = |format, size| CameraRequest {
            format,
            size,
            ..CameraRequest::default()
        };
        let grey = Some(PixelFormat::Grey);
        assert_eq!(
            chosen(&webcam(), &request(grey, None)),
            Some((*b"GREY", (640, 480)))
        );
        assert_eq!(
            chosen(&webcam(), &request(grey, Some(size(320, 240)))),
            None
        );
        assert_eq!(
            chosen(&webcam(), &request(Some(PixelFormat::Nv12), None)),
            None
        );
        assert_eq!(
            chosen(&webcam(), &request(None, Some(size(1920, 1080)))),
            None
        );
    }

    #[test]
    fn a_refusal_says_what_there_is() {
        let refusal = |offers: &[Offer], format, size| {
            let request = CameraRequest {
                format,
                size,
                ..CameraRequest::default()
            };
            assert_eq!(choose(&modes(offers, &request, webcam_hz), &request), None);
            refusal(offers, "cam", &request).to_string()
        };
        let (yuyv, nv12) = (Some(PixelFormat::Yuyv), Some(PixelFormat::Nv12));
        let small = Some(size(8, 8));
        assert_eq!(
            refusal(&webcam(), yuyv, small),
            "cam: does not offer 8x8 pixels: it offers 1280x720, 640x480, 320x240"
        );
        assert_eq!(
            refusal(&webcam(), nv12, small),
            "cam: does not offer NV12: it offers H264, MJPG, YUYV, GREY"
        );
        assert_eq!(
            refusal(&webcam()[..1], None, small),
            "cam: does not offer any of YUYV, UYVY, NV12, YU12, RGB3, MJPG, JPEG, GREY: it offers H264"
        );
        assert_eq!(
            refusal(&[], yuyv, None),
            "cam: does not offer YUYV: it offers nothing"
        );
    }

    #[test]
    fn grey_is_the_last_resort_and_sizes_come_before_rates() {
        let grey_only = [offer(b"GREY", &[(752, 480)])];
        assert_eq!(
            chosen(&grey_only, &CameraRequest::default()),
            Some((*b"GREY", (752, 480)))
        );
        let small_raw = [
            offer(b"YUYV", &[(160, 120)]),
            offer(b"MJPG", &[(800, 600)]),
            offer(b"GREY", &[(640, 480)]),
        ];
        assert_eq!(
            chosen(&small_raw, &CameraRequest::default()),
            Some((*b"MJPG", (800, 600)))
        );
        assert_eq!(
            chosen(&[offer(b"NV12", &[])], &CameraRequest::default()),
            Some((*b"NV12", (1920, 1080)))
        );
        assert_eq!(chosen(&[], &CameraRequest::default()), None);
    }

    #[test]
    fn grids_are_snapped_to() {
        let grid = |step| Sizes::Grid {
            min: size(48, 48),
            max: size(1000, 500),
            step,
        };
        assert_eq!(nearest(&grid(size(1, 1)), size(640, 480)), size(640, 480));
        assert_eq!(nearest(&grid(size(0, 0)), size(641, 481)), size(641, 481));
        assert_eq!(nearest(&grid(size(16, 10)), size(650, 480)), size(640, 478));
        assert_eq!(
            nearest(&grid(size(16, 10)), size(9999, 9999)),
            size(992, 498)
        );
        assert_eq!(nearest(&grid(size(16, 10)), size(1, 1)), size(48, 48));
    }

    #[test]
    fn intervals_are_simple_fractions() {
        let fraction = |numerator, denominator| Fraction {
            numerator,
            denominator,
        };
        assert_eq!(interval(30.0), fraction(1, 30));
        assert_eq!(interval(29.97), fraction(100, 2997));
        assert_eq!(interval(0.0), fraction(1, 1));
        assert_eq!(interval(f64::NAN).denominator, 1);
    }
}
