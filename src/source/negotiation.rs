//! Which of a camera's formats and sizes is asked for.
//!
//! What the user wishes must be given exactly, except for the rate, of which [`Camera::info`](crate::source::camera::Camera::info) says what the camera has chosen.
//! Where nothing is wished: 640x480 pixels or the nearest size, and 30 frames/s. Of the formats that come nearest to the size,
//! the first in this order that reaches the rate is taken, or the fastest one if none does: YUYV, UYVY, NV12, YU12, RGB3,
//! MJPG, JPEG. Raw formats come first because compression blurs the edges that positions are measured on; a camera that is fast
//! only with MJPG gets MJPG. GREY is taken only if it is wished or the only one, because a grey frame has no hue.

use imgproc::Size;

use crate::frame::PixelFormat;
use crate::source::camera::{CameraError, Wish};
use crate::source::v4l2::{Device, FourCc, Fraction, Intervals, Sizes};

/// The formats read here, in order of preference.
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

/// Size taken if none is wished.
const DEFAULT_SIZE: Size = Size {
    width: 640,
    height: 480,
};
/// Frames per second asked for if none are wished.
pub(crate) const DEFAULT_RATE_HZ: f64 = 30.0;

/// One frame in so many seconds, in a form that drivers compare well: 1/30, 100/2997.
pub(crate) fn interval(rate_hz: f64) -> Fraction {
    let numerator = if rate_hz.fract() == 0.0 { 1 } else { 100 };
    Fraction {
        numerator,
        denominator: (rate_hz * f64::from(numerator)).round().max(1.0) as u32,
    }
}

/// A layout that a camera offers, and the sizes in which it does; no sizes if it does not say.
#[derive(Debug)]
struct Offer {
    fourcc: FourCc,
    sizes: Vec<Sizes>,
}

/// What a camera is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Choice {
    pub(crate) fourcc: FourCc,
    pub(crate) format: PixelFormat,
    pub(crate) size: Size,
}

/// What to ask the camera for, or why nothing that it offers will do.
pub(crate) fn negotiate(device: &Device, name: &str, wish: &Wish) -> Result<Choice, CameraError> {
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
    choose(&offers, wish, fastest_hz).ok_or_else(|| refusal(&offers, name, wish))
}

/// Says why nothing could be chosen: no such format, or not in the wished size.
fn refusal(offers: &[Offer], name: &str, wish: &Wish) -> CameraError {
    let fits = |offer: &&Offer| {
        let format = readable(offer.fourcc);
        format.is_some_and(|format| wish.format.is_none_or(|wished| wished == format))
    };
    let mut sizes: Vec<String> = Vec::new();
    for size in offers.iter().filter(fits).flat_map(|offer| &offer.sizes) {
        let size = size.to_string();
        if !sizes.contains(&size) {
            sizes.push(size);
        }
    }
    if let Some(size) = wish.size
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
    let wished = READABLE
        .iter()
        .filter(|(_, format)| wish.format.is_none_or(|wished| wished == *format))
        .map(|&(fourcc, _)| fourcc);
    CameraError::Format {
        path: name.to_owned(),
        wished: match wish.format {
            Some(_) => names(&mut { wished }),
            None => format!("any of {}", names(&mut { wished })),
        },
        offered: match offers.is_empty() {
            true => "nothing".to_owned(),
            false => names(&mut offers.iter().map(|offer| offer.fourcc)),
        },
    }
}

/// The rule at the top of this file. `fastest_hz` is the highest rate in a layout and size, if the camera says.
fn choose(
    offers: &[Offer],
    wish: &Wish,
    fastest_hz: impl Fn(FourCc, Size) -> Option<f64>,
) -> Option<Choice> {
    let wanted = wish.size.unwrap_or(DEFAULT_SIZE);
    let mut choices: Vec<Choice> = Vec::new();
    for (fourcc, format) in READABLE {
        let Some(offer) = offers.iter().find(|offer| offer.fourcc == fourcc) else {
            continue;
        };
        let size = match offer.sizes.is_empty() {
            true => Some(wanted),
            false => offer
                .sizes
                .iter()
                .map(|sizes| nearest(sizes, wanted))
                .min_by_key(|&size| distance(size, wanted)),
        };
        let size = size.filter(|&size| wish.size.is_none_or(|wished| wished == size));
        if let Some(size) = size
            && wish.format.is_none_or(|wished| wished == format)
        {
            choices.push(Choice {
                fourcc,
                format,
                size,
            });
        }
    }
    if choices
        .iter()
        .any(|choice| choice.format != PixelFormat::Grey)
    {
        choices.retain(|choice| choice.format != PixelFormat::Grey);
    }
    let least = choices
        .iter()
        .map(|choice| distance(choice.size, wanted))
        .min()?;
    choices.retain(|choice| distance(choice.size, wanted) == least);
    // A hundredth less will do: 29.97 is what many cameras mean by 30.
    let enough_hz = 0.99 * wish.rate_hz.unwrap_or(DEFAULT_RATE_HZ);
    let mut best: Option<(f64, Choice)> = None;
    for choice in choices {
        let rate_hz = fastest_hz(choice.fourcc, choice.size).unwrap_or(enough_hz);
        if rate_hz >= enough_hz {
            return Some(choice);
        }
        if best.is_none_or(|(best_hz, _)| rate_hz > best_hz) {
            best = Some((rate_hz, choice));
        }
    }
    best.map(|(_, choice)| choice)
}

/// The size offered that is nearest to the wanted one.
fn nearest(sizes: &Sizes, wanted: Size) -> Size {
    match *sizes {
        Sizes::One(size) => size,
        Sizes::Grid { least, most, step } => {
            let side = |least: usize, most: usize, step: usize, wanted: usize| {
                let (step, most) = (step.max(1), most.max(least));
                let n_steps = (wanted.clamp(least, most) - least + step / 2) / step;
                least + step * n_steps.min((most - least) / step)
            };
            Size {
                width: side(least.width, most.width, step.width, wanted.width),
                height: side(least.height, most.height, step.height, wanted.height),
            }
        }
    }
}

fn distance(a: Size, b: Size) -> usize {
    a.width.abs_diff(b.width) + a.height.abs_diff(b.height)
}

/// The format that a camera's four characters stand for, if it is read here.
pub(crate) fn readable(fourcc: FourCc) -> Option<PixelFormat> {
    READABLE
        .iter()
        .find(|(readable, _)| *readable == fourcc)
        .map(|&(_, format)| format)
}

/// A layout's four characters, those that cannot be printed replaced.
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

    /// A webcam as they are sold: raw frames are slow where they are large.
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

    fn chosen(offers: &[Offer], wish: &Wish) -> Option<(FourCc, (usize, usize))> {
        choose(offers, wish, webcam_hz)
            .map(|choice| (choice.fourcc, (choice.size.width, choice.size.height)))
    }

    #[test]
    fn raw_is_taken_where_it_is_fast_enough() {
        let nothing = Wish::default();
        assert_eq!(chosen(&webcam(), &nothing), Some((*b"YUYV", (640, 480))));
        let large = Wish {
            size: Some(size(1280, 720)),
            ..nothing
        };
        assert_eq!(chosen(&webcam(), &large), Some((*b"MJPG", (1280, 720))));
        let slow = Wish {
            rate_hz: Some(10.0),
            ..large
        };
        assert_eq!(chosen(&webcam(), &slow), Some((*b"YUYV", (1280, 720))));
        let impossibly_fast = Wish {
            rate_hz: Some(1000.0),
            ..nothing
        };
        assert_eq!(
            chosen(&webcam(), &impossibly_fast),
            Some((*b"MJPG", (640, 480)))
        );
    }

    #[test]
    fn wishes_are_met_exactly_or_not_at_all() {
        let wish = |format, size| Wish {
            format,
            size,
            ..Wish::default()
        };
        let grey = Some(PixelFormat::Grey);
        assert_eq!(
            chosen(&webcam(), &wish(grey, None)),
            Some((*b"GREY", (640, 480)))
        );
        assert_eq!(chosen(&webcam(), &wish(grey, Some(size(320, 240)))), None);
        assert_eq!(
            chosen(&webcam(), &wish(Some(PixelFormat::Nv12), None)),
            None
        );
        assert_eq!(chosen(&webcam(), &wish(None, Some(size(1920, 1080)))), None);
    }

    #[test]
    fn a_refusal_says_what_there_is() {
        let refusal = |offers: &[Offer], format, size| {
            let wish = Wish {
                format,
                size,
                ..Wish::default()
            };
            assert_eq!(choose(offers, &wish, webcam_hz), None);
            refusal(offers, "cam", &wish).to_string()
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
            chosen(&grey_only, &Wish::default()),
            Some((*b"GREY", (752, 480)))
        );
        let small_raw = [
            offer(b"YUYV", &[(160, 120)]),
            offer(b"MJPG", &[(800, 600)]),
            offer(b"GREY", &[(640, 480)]),
        ];
        assert_eq!(
            chosen(&small_raw, &Wish::default()),
            Some((*b"MJPG", (800, 600)))
        );
        assert_eq!(
            chosen(&[offer(b"NV12", &[])], &Wish::default()),
            Some((*b"NV12", (640, 480)))
        );
        assert_eq!(chosen(&[], &Wish::default()), None);
    }

    #[test]
    fn grids_are_snapped_to() {
        let grid = |step| Sizes::Grid {
            least: size(48, 48),
            most: size(1000, 500),
            step,
        };
        assert_eq!(nearest(&grid(size(1, 1)), size(640, 480)), size(640, 480));
        assert_eq!(nearest(&grid(size(0, 0)), size(641, 481)), size(641, 481));
        assert_eq!(nearest(&grid(size(16, 10)), size(650, 480)), size(656, 478));
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
