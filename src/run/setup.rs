//! Setup of a run from arguments, the replayed recording, and defaults, in this order of
//! precedence.

use anyhow::{Context, bail};
use imgproc::Size;

use crate::background::model::BackgroundModel;
use crate::background::region::Region;
use crate::cli::{RunArgs, WrongArguments};
use crate::geometry::calibration::{self, Calibration};
use crate::marker::{Family, built_in_files, read_folder};
use crate::output::mcap::provenance::Provenance;
use crate::output::mcap::series::size_estimate;
use crate::pipeline::Pipeline;
use crate::run::slot::{Slot, SourceInfo};
use crate::run::status::{counted, log};
use crate::settings::{self, Settings};
use crate::source::Source;

/// A pipeline, and the inputs it was made from.
#[derive(Debug)]
pub(crate) struct Setup {
    pub(crate) pipeline: Pipeline,
    /// For the recording.
    pub(crate) provenance: Provenance,
    pub(crate) settings: Settings,
    /// Remarks about the calibration.
    remarks: Vec<String>,
    region_share: Option<f64>,
    background: Background,
}

/// Origin of the background.
#[derive(Debug)]
enum Background {
    /// From the source, if it has one; otherwise learned.
    Source,
    /// Learned, even if the source has one.
    Learned,
    /// Given, but not yet passed to the pipeline.
    Given(BackgroundModel),
    /// Given, and passed on.
    InUse,
}

impl Setup {
    /// Reads and checks everything named by the arguments and the source.
    pub(crate) fn new(args: &RunArgs, source: &Source) -> anyhow::Result<Self> {
        let info = source.info();
        let recorded = source.provenance();
        let settings = settings_in_force(args, source)?;
        let markers = match (&args.markers, recorded) {
            (Some(folder), _) => read_folder(folder)?,
            (None, Some(provenance)) if !provenance.markers.is_empty() => {
                provenance.markers.clone()
            }
            _ => built_in_files(),
        };
        let calibration_text = match &args.calibration {
            Some(path) => Some(calibration::read_text(path)?),
            None => recorded.and_then(|provenance| provenance.calibration.clone()),
        };
        let calibration = calibration_text
            .as_deref()
            .map(Calibration::from_toml)
            .transpose()
            .with_context(|| match &args.calibration {
                Some(path) => path.display().to_string(),
                None => args.source.device.clone(),
            })?;
        if let Some(plate_mm) = settings.plate_mm {
            check_plate(plate_mm, &settings, calibration.as_ref(), info.size)?;
        }
        let region = match (&args.region, recorded.and_then(|p| p.region.as_deref())) {
            (Some(path), _) => Some(Region::read(path, info.size)?),
            (None, Some(png)) => Some(Region::from_png(png, &args.source.device, info.size)?),
            (None, None) => None,
        };
        let provenance = Provenance {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            source: info.name.clone(),
            settings: toml::to_string(&settings).context("settings")?,
            calibration: calibration_text,
            region: region.as_ref().map(Region::to_png),
            floor_from_image: calibration.as_ref().map(Calibration::floor_from_image),
            markers,
        };
        let family = Family::from_files(&provenance.markers)?;
        let remarks = calibration
            .as_ref()
            .map_or(Vec::new(), |calibration| calibration.remarks(info.size));
        let region_share = region.as_ref().map(Region::share);
        let mut pipeline = Pipeline::new(info.size, info.rate_hz, settings, family, calibration);
        pipeline.set_region(region);
        Ok(Self {
            pipeline,
            provenance,
            settings,
            remarks,
            region_share,
            background: Background::new(args, source)?,
        })
    }

    /// Coordinate frame of the scenes ([`scene::Scene::frame`]).
    pub(crate) fn frame(&self) -> u32 {
        match self.provenance.floor_from_image {
            Some(_) => scene::FRAME_FLOOR,
            None => scene::FRAME_IMAGE,
        }
    }

    /// Decides which background a slot passes to the pipeline.
    pub(crate) fn choose_background(&mut self, slot: &mut Slot) {
        self.background = match std::mem::replace(&mut self.background, Background::InUse) {
            Background::Source => Background::Source,
            Background::Learned => {
                slot.background = None;
                Background::Learned
            }
            Background::Given(floor) => {
                slot.background = Some(floor);
                Background::InUse
            }
            Background::InUse => {
                slot.background = None;
                Background::InUse
            }
        };
    }

    /// Logs what the run does and where its results go.
    pub(crate) fn announce(&self, args: &RunArgs, info: &SourceInfo) {
        let rate = info.rate_hz.map_or(String::new(), |rate| {
            format!(" at {} frames/s", (rate * 100.0).round() / 100.0)
        });
        let (width, height) = (info.size.width, info.size.height);
        log(format_args!(
            "overcam: {}, {width} x {height}, {:?}{rate}",
            info.name, info.format
        ));
        let names: Vec<&str> = self
            .provenance
            .markers
            .iter()
            .map(|marker| marker.name.as_str())
            .collect();
        log(format_args!(
            "overcam: looking for {}: {}",
            counted(names.len() as u64, "marker"),
            names.join(", ")
        ));
        for remark in &self.remarks {
            log(format_args!("overcam: {remark}"));
        }
        if let Some(share) = self.region_share {
            let percent = 100.0 * share;
            log(format_args!(
                "overcam: looking at {percent:.0} % of the picture, the light part of the region"
            ));
        }
        if matches!(self.background, Background::Learned) {
            log(format_args!(
                "overcam: learning the empty floor from the first {}; results come after that",
                counted(u64::from(self.settings.learn), "frame")
            ));
        }
        if !args.no_publish {
            let service = &args.service;
            let group = match &args.group {
                Some(group) => format!(" --group {group}"),
                None => String::new(),
            };
            log(format_args!(
                "overcam: publishing on {service}{}; see it with: overcam watch --service {service}{group}",
                scene::SERVICE_SUFFIX
            ));
        }
        if let Some(path) = &args.record {
            log(format_args!(
                "overcam: recording to {}: {}",
                path.display(),
                size_estimate(info, args.image_mode())
            ));
        }
    }
}

/// The settings from the arguments, the replayed recording and the defaults.
pub(crate) fn settings_in_force(args: &RunArgs, source: &Source) -> anyhow::Result<Settings> {
    let name = || format!("{}: its settings", args.source.device);
    let recorded = match source.provenance() {
        Some(provenance) if !provenance.settings.is_empty() => {
            let (settings, unknown) =
                Settings::from_recording(&provenance.settings).with_context(name)?;
            settings.check().with_context(name)?;
            for key in unknown {
                log(format_args!(
                    "overcam: {} has a setting {key}, which this version does not know; it is ignored",
                    args.source.device
                ));
            }
            settings
        }
        _ => Settings::default(),
    };
    let settings = args.settings(recorded);
    settings.check()?;
    Ok(settings)
}

/// Rejects a plate size that cannot be read anywhere on this floor.
fn check_plate(
    plate_mm: f32,
    settings: &Settings,
    calibration: Option<&Calibration>,
    size: Size,
) -> anyhow::Result<()> {
    let Some(calibration) = calibration else {
        bail!(WrongArguments(
            "--plate: how many pixels a millimetre has is not known; give the floor's --calibration as well"
                .to_owned()
        ));
    };
    let min = f64::from(settings.plate_min);
    let max = f64::from(settings.plate_max).min(size.width.min(size.height) as f64);
    // Robots are higher than the floor, so their plates look larger.
    let tolerance = f64::from(settings::PRINTED_SIZE_TOLERANCE);
    match calibration.plate_px(plate_mm, size) {
        Some((from, to)) if to * tolerance < min || from / tolerance > max => bail!(
            "--plate {plate_mm}: such plates would be {from:.2} to {to:.2} pixels wide in this picture, but those of {min} to {max} are read; \
             give the calibration's floor points in metres and the plate in millimetres"
        ),
        _ => Ok(()),
    }
}

impl Background {
    fn new(args: &RunArgs, source: &Source) -> anyhow::Result<Self> {
        let Some(path) = &args.background else {
            let comes_with_frames = match source {
                Source::Demo(_) => true,
                Source::Recording(recording) => !recording.provenance().version.is_empty(),
                _ => false,
            };
            return Ok(if comes_with_frames && args.learn.is_none() {
                Self::Source
            } else {
                Self::Learned
            });
        };
        let floor = BackgroundModel::read(path, source.n_bits())?;
        let (found, frames) = (floor.picture.size, source.info().size);
        if found != frames {
            bail!(
                "background {}: it is {} x {}, but the frames are {} x {}; take it with the same camera settings",
                path.display(),
                found.width,
                found.height,
                frames.width,
                frames.height
            );
        }
        Ok(Self::Given(floor))
    }
}
