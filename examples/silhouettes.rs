//! How well the descriptor alone distinguishes shapes: each picture of a folder gets the class of
//! its nearest neighbour.
//!
//! ```text
//! cargo run --release --example silhouettes -- DIR
//! ```
//!
//! The folder holds PNG pictures of light silhouettes on black, named CLASS-NUMBER.png. Two
//! distances are tried. The first, used for recognition, is that of the contours' points after
//! aligning their orientation ([`compare_both_ways`]). The second is its lower bound from the
//! magnitudes of the coefficients ([`min_distance`]), the paper's descriptor.

use std::path::Path;
use std::{env, fs};

use anyhow::{Context, bail};
use fourier::contour::resample;
use fourier::descriptor::{Descriptor, describe};
use fourier::matching::{compare_both_ways, min_distance};
use imgproc::contour::{Span, follow_contour, next_shape, remove_shape, span_capacity};
use imgproc::{Point, Size};

/// The class and the descriptor of a picture.
struct Silhouette {
    class: String,
    descriptor: Descriptor,
}

fn main() -> anyhow::Result<()> {
    let Some(folder) = env::args().nth(1) else {
        bail!("usage: silhouettes DIR, a folder of PNG pictures named CLASS-NUMBER.png");
    };
    let mut files: Vec<_> = fs::read_dir(&folder)
        .with_context(|| folder.clone())?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|extension| extension == "png"))
        .collect();
    files.sort();
    let silhouettes = files
        .iter()
        .map(|path| read(path).with_context(|| path.display().to_string()))
        .collect::<anyhow::Result<Vec<_>>>()?;
    if silhouettes.len() < 2 {
        bail!("{folder}: two or more PNG pictures are needed");
    }
    let mut classes: Vec<&str> = silhouettes.iter().map(|s| s.class.as_str()).collect();
    classes.sort_unstable();
    classes.dedup();
    println!(
        "{} silhouettes of {} classes; share of those whose nearest neighbour is of their class:",
        silhouettes.len(),
        classes.len()
    );
    let by_points = |a: &Descriptor, b: &Descriptor| {
        let [upright, turned] = compare_both_ways(a, b);
        upright.distance.min(turned.distance)
    };
    let by_magnitudes =
        |a: &Descriptor, b: &Descriptor| min_distance(&a.magnitudes(), &b.magnitudes());
    println!("points      {:.4}", share_right(&silhouettes, by_points));
    println!(
        "magnitudes  {:.4}",
        share_right(&silhouettes, by_magnitudes)
    );
    Ok(())
}

/// Share of silhouettes whose nearest neighbour has the same class.
fn share_right(
    silhouettes: &[Silhouette],
    distance: impl Fn(&Descriptor, &Descriptor) -> f32,
) -> f64 {
    let right = silhouettes.iter().enumerate().filter(|(i, one)| {
        silhouettes
            .iter()
            .enumerate()
            .filter(|(k, _)| k != i)
            .map(|(_, other)| (distance(&one.descriptor, &other.descriptor), other))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .is_some_and(|(_, nearest)| nearest.class == one.class)
    });
    right.count() as f64 / silhouettes.len() as f64
}

fn read(path: &Path) -> anyhow::Result<Silhouette> {
    let picture = image::open(path)?.into_luma8();
    let size = Size {
        width: picture.width() as usize,
        height: picture.height() as usize,
    };
    let mut mask: Vec<u8> = picture.into_raw().iter().map(|&grey| grey >> 7).collect();
    let mut points = vec![Point::default(); 4 * size.area()];
    let mut spans = vec![Span::default(); span_capacity(size)];
    let (mut largest, mut contour) = (0, Vec::new());
    let mut from = 0;
    while let Some(start) = next_shape(&mask, size, from) {
        from = usize::from(start.y) * size.width + usize::from(start.x);
        let followed = follow_contour(&mask, size, start, &mut points);
        let at = |p: &Point| [f32::from(p.x), f32::from(p.y)];
        let followed: Vec<[f32; 2]> = followed.map_or(Vec::new(), |c| c.iter().map(at).collect());
        let area = remove_shape(&mut mask, size, start, &mut spans).area;
        if area > largest {
            (largest, contour) = (area, followed);
        }
    }
    let Ok(descriptor) = describe(&resample(&contour), 0.0) else {
        bail!("no light silhouette on black");
    };
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let class = stem
        .trim_end_matches(|c: char| c.is_ascii_digit())
        .trim_end_matches('-')
        .to_owned();
    Ok(Silhouette { class, descriptor })
}
