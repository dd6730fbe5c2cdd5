//! `overcam markers`: checks drawings, designs new ones, learns one from an image, prints them.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, bail};

use crate::cli::{MarkersCommand, SourceArgs};
use crate::command::background::learn_view;
use crate::geometry::calibration::{self, Calibration};
use crate::marker::{MarkerFile, built_in_files, read_folder};
use crate::marker_design::check::{check, table};
use crate::marker_design::design::design;
use crate::marker_design::sheet::{Layout, pdf, svg_pages};
use crate::marker_design::trace::trace;

/// Executes one of the subcommands. Text output goes to `out`.
pub(super) fn markers(
    command: &MarkersCommand,
    stop: &Arc<AtomicBool>,
    out: &mut impl Write,
) -> anyhow::Result<()> {
    match command {
        MarkersCommand::Check {
            folder,
            calibration,
        } => check_all(folder.as_deref(), calibration.as_deref(), out),
        MarkersCommand::Design {
            count,
            output,
            beside,
            seed,
        } => design_new(*count as usize, *seed, beside.as_deref(), output, out),
        MarkersCommand::Learn {
            source,
            output,
            beside,
            learn,
        } => learn_one(source, *learn, beside.as_deref(), output, stop, out),
        MarkersCommand::Sheet {
            folder,
            output,
            plate,
            copies,
        } => {
            let layout = Layout {
                plate_mm: *plate,
                copies: *copies,
            };
            draw_sheet(folder.as_deref(), &layout, output, out)
        }
    }
}

fn check_all(
    folder: Option<&Path>,
    calibration: Option<&Path>,
    out: &mut impl Write,
) -> anyhow::Result<()> {
    let files = marker_files(folder)?;
    let cm_per_px = calibration.map(centimetres_per_px).transpose()?;
    let checks = check(&files);
    out.write_all(table(&checks, cm_per_px).as_bytes())
        .context("standard output")?;
    let refused = checks.iter().filter(|c| c.quality.is_err()).count();
    if refused > 0 {
        bail!(
            "markers: {refused} of {} cannot be used; change or remove those that the table names",
            checks.len()
        );
    }
    Ok(())
}

fn design_new(
    count: usize,
    seed: u64,
    beside: Option<&Path>,
    output: &Path,
    out: &mut impl Write,
) -> anyhow::Result<()> {
    let others = beside.map(read_folder).transpose()?;
    let designed = design(count, seed, &others.unwrap_or_default())?;
    fs::create_dir_all(output).with_context(|| not_written(output))?;
    for file in &designed {
        let path = output.join(&file.name).with_extension("svg");
        write_new(&path, &file.svg)?;
        writeln!(out, "{}", path.display()).context("standard output")?;
    }
    if designed.len() < count {
        bail!(
            "markers: only {} sufficiently different shapes were found; ask for fewer, or try another --seed",
            designed.len()
        );
    }
    Ok(())
}

fn learn_one(
    source: &SourceArgs,
    n_frames: u32,
    beside: Option<&Path>,
    output: &Path,
    stop: &Arc<AtomicBool>,
    out: &mut impl Write,
) -> anyhow::Result<()> {
    let others = beside.map(read_folder).transpose()?;
    let Some(((), view)) = learn_view(source, n_frames, "a marker", stop, || Ok(()))? else {
        return Ok(());
    };
    let name = output.file_stem().unwrap_or_default().to_string_lossy();
    let traced = trace(&view.floor.picture, &name).with_context(|| view.source)?;
    let mut files = others.unwrap_or_default();
    files.push(traced);
    let checks = check(&files);
    let (Some(file), Some(new)) = (files.last(), checks.last()) else {
        bail!("markers: nothing was learned");
    };
    if let Err(error) = &new.quality {
        bail!("{error}");
    }
    write_new(output, &file.svg)?;
    let quality = table(std::slice::from_ref(new), None);
    out.write_all(quality.as_bytes()).context("standard output")
}

fn draw_sheet(
    folder: Option<&Path>,
    layout: &Layout,
    output: &Path,
    out: &mut impl Write,
) -> anyhow::Result<()> {
    let files = marker_files(folder)?;
    let is_pdf = output
        .extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("pdf"));
    if is_pdf {
        fs::write(output, pdf(&files, layout)?).with_context(|| not_written(output))?;
        return writeln!(out, "{}", output.display()).context("standard output");
    }
    for (page, svg) in svg_pages(&files, layout)?.iter().enumerate() {
        let path = page_path(output, page);
        fs::write(&path, svg).with_context(|| not_written(&path))?;
        writeln!(out, "{}", path.display()).context("standard output")?;
    }
    Ok(())
}

/// Writes a drawing, but never overwrites a file, which may be the user's own drawing.
fn write_new(path: &Path, svg: &str) -> anyhow::Result<()> {
    File::create_new(path)
        .and_then(|mut new| new.write_all(svg.as_bytes()))
        .with_context(|| not_written(path))
}

fn not_written(path: &Path) -> String {
    format!(
        "{} cannot be written; name another, in a folder that exists",
        path.display()
    )
}

fn marker_files(folder: Option<&Path>) -> anyhow::Result<Vec<MarkerFile>> {
    Ok(match folder {
        Some(folder) => read_folder(folder)?,
        None => built_in_files(),
    })
}

fn centimetres_per_px(path: &Path) -> anyhow::Result<f64> {
    let text = calibration::read_text(path)?;
    let calibration = Calibration::from_toml(&text).with_context(|| path.display().to_string())?;
    let metres = calibration
        .metres_per_px()
        .with_context(|| format!("{}: it maps its points to infinity", path.display()))?;
    Ok(100.0 * metres)
}

/// `sheet.svg`, `sheet-2.svg` and so on.
fn page_path(output: &Path, page: usize) -> PathBuf {
    if page == 0 {
        return output.to_owned();
    }
    let stem = output.file_stem().unwrap_or_default().to_string_lossy();
    let extension = output.extension().map_or(String::new(), |extension| {
        format!(".{}", extension.to_string_lossy())
    });
    output.with_file_name(format!("{stem}-{}{extension}", page + 1))
}
