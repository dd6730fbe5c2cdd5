//! The command line.

use std::fmt;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::str::FromStr;

use clap::builder::{PathBufValueParser, TypedValueParser};
use clap::{Args, Parser, Subcommand, ValueHint};
use clap_complete::Shell;
use imgproc::Size;

use crate::camera::CameraRequest;
use crate::camera::controls::ControlRequest;
use crate::image::frame::PixelFormat;
use crate::output::foxglove::image_message::ImageMode;
use crate::output::mcap::series::Limits;
use crate::output::shared_memory::service_name;
use crate::settings::{self, Settings};

/// One camera on the ceiling becomes a positioning service for everything on the floor.
///
/// Without arguments, a built-in demo runs; no camera is needed. Robots and targets with a printed
/// marker get a pose, everything else is an obstacle with an outline, and everything that moves
/// gets a forecast.
#[derive(Debug, Parser)]
#[command(version, args_conflicts_with_subcommands = true)]
#[command(
    after_help = "The signal USR1 makes a running overcam learn the empty floor again from the next --learn frames; the old one is \
                  used meanwhile: kill -USR1 PID\n\n\
                  Exit status: 0 done or stopped by Ctrl-C, 1 failed, 2 wrong arguments, 3 finished but frames were \
                        lost from the recording."
)]
pub struct Cli {
    /// The subcommand, if any.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// Arguments of a run.
    #[command(flatten)]
    pub run: RunArgs,
}

/// All commands except the main one.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// List the cameras with their formats, sizes, rates and controls
    Devices,
    /// Learn the empty floor and write it to a file for --background; objects may move over it
    /// meanwhile
    Background(BackgroundArgs),
    /// Check marker drawings, print them, design new ones, or learn one from a view
    #[command(subcommand)]
    Markers(MarkersCommand),
    /// Show what a running overcam publishes: a table on a terminal, otherwise JSON lines as with
    /// --json
    Watch {
        /// Name of the service
        #[arg(long, default_value = scene::DEFAULT_SERVICE, value_parser = parse_service)]
        service: String,
        /// The group for which it is published (overcam --group)
        #[arg(long, value_name = "NAME")]
        group: Option<String>,
        /// Stop after this many scenes
        #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
        frames: Option<u64>,
        /// Print JSON lines on a terminal, too
        #[arg(long)]
        json: bool,
    },
    /// Print a systemd unit that runs overcam with these arguments: overcam service ARGUMENTS >
    /// overcam.service
    ///
    /// Paths are made absolute, and the stable name of the camera is used (/dev/v4l/by-id). Each
    /// start records to a new file. The first lines of the unit say how to install it.
    Service(Box<RunArgs>),
    /// Repair a truncated recording: copy everything readable to a new file
    Recover {
        /// The recording
        file: PathBuf,
        /// The new file
        #[arg(short, long, value_parser = ending_in(&["mcap"]))]
        output: PathBuf,
    },
    /// Print the man page: overcam man > overcam.1
    Man,
    /// Print a completion script for a shell
    ///
    /// bash: overcam completions bash > ~/.local/share/bash-completion/completions/overcam. zsh:
    /// into a file _overcam of a folder in $fpath. fish: > ~/.config/fish/completions/overcam.fish.
    /// elvish and powershell: read it in at the start.
    Completions {
        /// The shell
        shell: Shell,
    },
}

/// Commands for marker drawings.
#[derive(Debug, Subcommand)]
pub enum MarkersCommand {
    /// Show the accuracy, the most similar other marker and the smallest readable size of each
    /// marker
    ///
    /// Exits with status 1 and the reason if one cannot be used.
    Check {
        /// Folder of marker drawings (SVG); without it the built-in ones
        folder: Option<PathBuf>,
        /// Calibration points (TOML); sizes are then also given in centimetres on the floor
        #[arg(long, value_name = "FILE")]
        calibration: Option<PathBuf>,
    },
    /// Design new markers that differ from each other and from existing ones
    Design {
        /// How many
        #[arg(long, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u32).range(1..=100))]
        count: u32,
        /// Folder for the drawings (SVG); created if missing
        #[arg(short, long, value_name = "DIR")]
        output: PathBuf,
        /// Folder of marker drawings that will be used with the new ones
        #[arg(long, value_name = "DIR")]
        beside: Option<PathBuf>,
        /// Seed; another number gives other shapes
        #[arg(long, value_name = "N", default_value_t = 1)]
        seed: u64,
    },
    /// Make a marker drawing from a shape that was cut by hand
    ///
    /// The dark shape lies on a light, square plate on a darker floor and points up in the picture.
    /// The larger it appears, the better. Exits with status 1 and writes nothing if it cannot be
    /// used as a marker.
    Learn {
        /// Arguments of the source.
        #[command(flatten)]
        source: SourceArgs,
        /// The new drawing (SVG); the file name is the marker's name
        #[arg(short, long, value_name = "FILE", value_parser = ending_in(&["svg"]))]
        output: PathBuf,
        /// Folder of marker drawings that will be used with the new one
        #[arg(long, value_name = "DIR")]
        beside: Option<PathBuf>,
        /// Learn from N frames, or from all of a file that has fewer
        #[arg(long, value_name = "N", default_value_t = 30, value_parser = number(settings::LEARN))]
        learn: u32,
    },
    /// Draw the markers at true size on A4 pages, with names and cut lines
    Sheet {
        /// Folder of marker drawings (SVG); without it the built-in ones
        folder: Option<PathBuf>,
        /// PDF or SVG file; further SVG pages are FILE-2.svg and so on
        #[arg(short, long, value_name = "FILE", value_parser = ending_in(&["pdf", "svg"]))]
        output: PathBuf,
        /// Side of a plate, millimetres
        #[arg(long, value_name = "MM", default_value_t = 80, value_parser = clap::value_parser!(u32).range(10..=180))]
        plate: u32,
        /// How often each marker is drawn
        #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100))]
        copies: u32,
    },
}

/// Arguments of the source.
#[derive(Debug, Args)]
pub struct SourceArgs {
    /// Read arguments from a TOML file, see --print-config; those given here have priority
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Camera, MCAP recording, Y4M file or pipe, - for Y4M on standard input, folder of PNG/JPEG
    /// files, or demo; detected by content, not by name
    #[arg(long, default_value = "demo", value_hint = ValueHint::AnyPath)]
    pub device: String,
    /// Frame size of the camera or the demo, e.g. 640x480 [default for a camera: the largest up to
    /// 1920x1080 at 25 frames/s or more]
    #[arg(long, value_parser = parse_size)]
    pub size: Option<Size>,
    /// Frames per second of the camera, or of a folder of pictures
    #[arg(long, value_parser = number(RATE_HZ))]
    pub rate: Option<f64>,
    /// Pixel format of the camera: yuyv, uyvy, nv12, grey, rgb or mjpg
    #[arg(long, value_parser = parse_format)]
    pub format: Option<PixelFormat>,
    /// Leave the camera's automatics on, except for values given here; otherwise exposure, gain,
    /// white balance and focus are locked one second after the start
    #[arg(long)]
    pub camera_auto: bool,
    /// Exposure time of the camera, in microseconds
    #[arg(long, value_name = "MICROSECONDS", value_parser = number(EXPOSURE_US))]
    pub exposure: Option<u32>,
    /// Gain of the camera, in its own unit
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub gain: Option<i32>,
    /// Colour temperature of the camera's white balance, in kelvins
    #[arg(long, value_name = "KELVIN", value_parser = number(WHITE_BALANCE_K))]
    pub white_balance: Option<u32>,
    /// Focus of the camera, in its own unit
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub focus: Option<i32>,
}

impl SourceArgs {
    /// The settings requested from a camera.
    #[must_use]
    pub fn request(&self) -> CameraRequest {
        CameraRequest {
            size: self.size,
            rate_hz: self.rate,
            format: self.format,
            controls: ControlRequest {
                camera_auto: self.camera_auto,
                exposure_us: self.exposure,
                gain: self.gain,
                white_balance_k: self.white_balance,
                focus: self.focus,
            },
        }
    }
}

/// Arguments of `overcam background`.
#[derive(Debug, Args)]
pub struct BackgroundArgs {
    /// Where frames come from.
    #[command(flatten)]
    pub source: SourceArgs,
    /// The PNG file; an existing one is replaced
    #[arg(short, long, value_name = "FILE", value_parser = ending_in(&["png"]))]
    pub output: PathBuf,
    /// Learn from N frames, or from all of a file that has fewer
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = number(settings::LEARN))]
    pub learn: u32,
}

/// Arguments of a run. Values not given come from the replayed recording or are defaults.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// Arguments of the source.
    #[command(flatten)]
    pub source: SourceArgs,
    /// Print the settings in force as a file for --config, and exit
    #[arg(long)]
    pub print_config: bool,
    /// Record every frame and result into a new MCAP file
    #[arg(long, value_name = "FILE", value_parser = ending_in(&["mcap"]))]
    pub record: Option<PathBuf>,
    /// Record raw frames as JPEG of this quality (1 to 100) instead of losslessly
    #[arg(long, value_name = "QUALITY", requires = "record", value_parser = clap::value_parser!(u8).range(1..=100))]
    pub record_jpeg: Option<u8>,
    /// Continue in a new file (FILE-2, FILE-3, ...) before one exceeds this size, in gigabytes
    /// (10^9 bytes)
    #[arg(long, value_name = "GB", requires = "record", value_parser = number(GIGABYTES))]
    pub record_max: Option<f64>,
    /// Continue in a new file (FILE-2, FILE-3, ...) after this many minutes
    #[arg(long, value_name = "N", requires = "record", value_parser = number(MINUTES))]
    pub record_minutes: Option<f64>,
    /// Picture of the empty floor: PNG or JPEG, or a file of `overcam background`
    #[arg(long, value_name = "FILE", conflicts_with = "learn")]
    pub background: Option<PathBuf>,
    /// Learn the empty floor from the first N frames [default: 30]
    #[arg(long, value_name = "N", value_parser = number(settings::LEARN))]
    pub learn: Option<u32>,
    /// Mask image of the frames' size, PNG or JPEG; dark or transparent pixels are ignored
    #[arg(long, value_name = "FILE")]
    pub region: Option<PathBuf>,
    /// Folder of marker drawings (SVG) that replace the built-in ones
    #[arg(long, value_name = "DIR")]
    pub markers: Option<PathBuf>,
    /// Calibration points in pixels and metres (TOML); all results are then in metres on the floor
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// Side of the printed plates in millimetres, with --calibration; anything a third smaller or
    /// larger is not a marker
    #[arg(long, value_name = "MM", value_parser = number(settings::PLATE_MM))]
    pub plate: Option<f32>,
    /// Name of the shared-memory services
    #[arg(long, default_value = scene::DEFAULT_SERVICE, value_parser = parse_service)]
    pub service: String,
    /// Let members of this group subscribe; planners set OVERCAM_GROUP=NAME
    #[arg(long, value_name = "NAME", conflicts_with = "no_publish")]
    pub group: Option<String>,
    /// Do not publish in shared memory
    #[arg(long)]
    pub no_publish: bool,
    /// Print one JSON object per frame on standard output
    #[arg(long)]
    pub json: bool,
    /// Stop after N frames
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub frames: Option<u64>,
    /// Exit with status 1 if the camera is unplugged or stalls, instead of waiting for it
    #[arg(long)]
    pub no_wait: bool,
    /// Foreground threshold in multiples of the noise [default: 5]
    #[arg(long, value_name = "SUM", value_parser = number(settings::THRESHOLD))]
    pub threshold: Option<f32>,
    /// Smallest object, in square pixels [default: 80]
    #[arg(long, value_name = "PX2", value_parser = number(settings::AREA_MIN))]
    pub area_min: Option<u32>,
    /// Darkest shadow: the share of the floor's lightness that it takes away, 0 to 1 [default: 0.6]
    #[arg(long, value_name = "SHARE", value_parser = number(settings::SHADOW))]
    pub shadow: Option<f32>,
    /// Smallest marker plate, in pixels [default: 8]
    #[arg(long, value_name = "PX", value_parser = number(settings::PLATE_PX))]
    pub plate_min: Option<f32>,
    /// Largest marker plate, in pixels [default: 400]
    #[arg(long, value_name = "PX", value_parser = number(settings::PLATE_PX))]
    pub plate_max: Option<f32>,
    /// What a marker may differ from its drawing by, besides noise: root mean square over the
    /// plate, as a share of the contrast [default: 0.05]
    #[arg(long, value_name = "SHARE", value_parser = number(settings::RESIDUAL))]
    pub marker_residual_max: Option<f32>,
    /// Speed of the fastest object, in widths of the picture a second [default: 0.75]
    #[arg(long, value_name = "WIDTHS", value_parser = number(settings::TOP_SPEED))]
    pub top_speed: Option<f64>,
    /// How long an object that is not seen is reported where its forecast says, in seconds
    /// [default: 0.27]
    #[arg(long, value_name = "SECONDS", value_parser = number(settings::LOST_AFTER_S))]
    pub lost_after: Option<f64>,
    /// Frames in which an object must have been seen before it is reported [default: 1]
    #[arg(long, value_name = "N", value_parser = number(settings::CONFIRM))]
    pub confirm: Option<u32>,
}

impl RunArgs {
    /// How the recording stores frames.
    #[must_use]
    pub fn image_mode(&self) -> ImageMode {
        self.record_jpeg
            .map_or(ImageMode::Lossless, |quality| ImageMode::Jpeg { quality })
    }

    /// When the recording continues in a new file.
    #[must_use]
    pub fn record_limits(&self) -> Limits {
        Limits {
            bytes: self.record_max.map(|gigabytes| (gigabytes * 1e9) as u64),
            duration_ns: self.record_minutes.map(|minutes| (minutes * 60e9) as u64),
        }
    }

    /// `settings`, overridden by the arguments that are given.
    #[must_use]
    pub fn settings(&self, settings: Settings) -> Settings {
        Settings {
            learn: self.learn.unwrap_or(settings.learn),
            threshold: self.threshold.unwrap_or(settings.threshold),
            shadow: self.shadow.unwrap_or(settings.shadow),
            area_min: self.area_min.unwrap_or(settings.area_min),
            plate_min: self.plate_min.unwrap_or(settings.plate_min),
            plate_max: self.plate_max.unwrap_or(settings.plate_max),
            plate_mm: self.plate.or(settings.plate_mm),
            marker_residual_max: self
                .marker_residual_max
                .unwrap_or(settings.marker_residual_max),
            top_speed: self.top_speed.unwrap_or(settings.top_speed),
            lost_after_s: self.lost_after.unwrap_or(settings.lost_after_s),
            confirm: self.confirm.unwrap_or(settings.confirm),
        }
    }
}

fn parse_size(text: &str) -> Result<Size, String> {
    let (width, height) = text.split_once(['x', 'X']).ok_or("write it as 640x480")?;
    let side = |text: &str| match text.parse::<usize>() {
        Ok(side @ 16..=16_384) => Ok(side),
        _ => Err("sides are whole numbers from 16 to 16384"),
    };
    Ok(Size {
        width: side(width)?,
        height: side(height)?,
    })
}

/// Sizes and times after which a recording continues in a new file.
const GIGABYTES: RangeInclusive<f64> = 0.001..=1_000_000.0;
const MINUTES: RangeInclusive<f64> = 0.01..=1_000_000.0;

/// Frames per second.
const RATE_HZ: RangeInclusive<f64> = 0.001..=1000.0;

/// The unit of cameras for exposure times is a tenth of a millisecond.
const EXPOSURE_US: RangeInclusive<u32> = 1..=60_000_000;

/// From candles to the sky; cameras support 2000 to 10000.
const WHITE_BALANCE_K: RangeInclusive<u32> = 1_000..=40_000;

/// Parses a number in a range; errors state the range.
fn number<T>(range: RangeInclusive<T>) -> impl Fn(&str) -> Result<T, String> + Clone
where
    T: FromStr + PartialOrd + fmt::Display + Clone,
{
    move |text| {
        let value = text.parse::<T>().ok();
        value
            .filter(|value| range.contains(value))
            .ok_or_else(|| format!("give a number from {} to {}", range.start(), range.end()))
    }
}

/// A file name with one of these extensions.
fn ending_in(endings: &'static [&'static str]) -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(move |path| {
        let found = path.extension().unwrap_or_default();
        if endings
            .iter()
            .any(|ending| found.eq_ignore_ascii_case(ending))
        {
            return Ok(path);
        }
        let names: Vec<String> = endings.iter().map(|ending| format!(".{ending}")).collect();
        Err(format!(
            "the file's name must end in {}",
            names.join(" or ")
        ))
    })
}

fn parse_service(text: &str) -> Result<String, String> {
    match service_name(text) {
        Ok(_) => Ok(text.to_owned()),
        Err(error) => Err(error.to_string()),
    }
}

/// Arguments that conflict with each other or with the source, which is known only when it is open.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct WrongArguments(pub String);

fn parse_format(text: &str) -> Result<PixelFormat, &'static str> {
    match text.to_lowercase().as_str() {
        "yuyv" => Ok(PixelFormat::Yuyv),
        "uyvy" => Ok(PixelFormat::Uyvy),
        "nv12" => Ok(PixelFormat::Nv12),
        "grey" | "gray" => Ok(PixelFormat::Grey),
        "rgb" => Ok(PixelFormat::Rgb),
        "mjpg" | "mjpeg" | "jpeg" => Ok(PixelFormat::Jpeg),
        _ => Err("choose yuyv, uyvy, nv12, grey, rgb or mjpg"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_definition_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn defaults_are_those_that_help_states() {
        let command = Cli::command();
        let defaults = toml::Table::try_from(Settings::default()).expect("a table");
        for (name, value) in defaults {
            let argument = command
                .get_arguments()
                .find(|a| a.get_id() == name.as_str());
            let argument = argument.unwrap_or_else(|| panic!("no argument for {name}"));
            let help = argument.get_help().map(ToString::to_string);
            let stated = help.as_deref().and_then(|help| {
                let (_, rest) = help.split_once("[default: ")?;
                rest.split_once(']')?.0.parse::<f64>().ok()
            });
            let value = value.as_float().or(value.as_integer().map(|n| n as f64));
            let error = stated
                .zip(value)
                .map(|(stated, value)| (stated - value).abs());
            assert!(error.is_some_and(|error| error < 1e-6), "{name}: {help:?}");
        }
    }

    #[test]
    fn sizes_are_read_and_checked() {
        assert_eq!(
            parse_size("640x480"),
            Ok(Size {
                width: 640,
                height: 480
            })
        );
        assert!(parse_size("640").is_err());
        assert!(parse_size("0x480").is_err());
        assert!(parse_size("640x99999").is_err());
    }
}
