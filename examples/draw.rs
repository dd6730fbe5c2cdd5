//! Draws what overcam finds in one frame into a picture: outlines, headings and forecasts.
//!
//! ```text
//! cargo run --release --example draw -- OUTPUT [SOURCE [SEQUENCE]]
//! ```
//!
//! `OUTPUT` is a PNG or JPEG file. `SOURCE` is anything that `--device` accepts except a camera, by
//! default the demo. Frames before `SEQUENCE` are processed too, so tracks and forecasts are those
//! of a run. Marked objects are green and obstacles orange. Blue shows where an object will be
//! during the next second, with the 95 % ellipse half a second ahead.

use std::error::Error;

use image::{Rgb, RgbImage, imageops};
use overcam::camera::CameraRequest;
use overcam::image::frame::{Picture, decode};
use overcam::marker::{Family, built_in_files};
use overcam::pipeline::{Outcome, Pipeline};
use overcam::run::slot::{Next, Slot};
use overcam::settings::Settings;
use overcam::source::Source;
use scene::{KIND_MARKER, Object, Scene};

/// Pixels of the drawing per pixel of the frame.
const SCALE: u32 = 2;
const MARKED: Rgb<u8> = Rgb([0, 200, 60]);
const OBSTACLE: Rgb<u8> = Rgb([255, 120, 0]);
const FORECAST: Rgb<u8> = Rgb([40, 110, 255]);
/// Radius of a 95 % ellipse in two dimensions, in standard deviations.
const SIGMA_95: f64 = 2.447;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let output = arguments
        .next()
        .ok_or("usage: draw OUTPUT [SOURCE [SEQUENCE]]")?;
    let device = arguments.next().unwrap_or("demo".to_owned());
    let sequence: u64 = arguments.next().map_or(Ok(100), |n| n.parse())?;

    let mut source = Source::open(&device, &CameraRequest::default())?;
    let info = source.info();
    let family = Family::from_files(&built_in_files())?;
    let mut pipeline = Pipeline::new(info.size, info.rate_hz, Settings::default(), family, None);
    let mut slot = Slot::empty();
    let mut has_scene = false;
    while source.next(&mut slot)? != Next::End {
        has_scene = pipeline.process(&mut slot)? == Outcome::Scene;
        if slot.frame.sequence >= sequence {
            break;
        }
    }
    if !has_scene {
        return Err("no results: all frames went into learning the background".into());
    }
    let mut picture = Picture::new(info.size);
    decode(&slot.frame, &mut picture)?;
    let mut drawing = enlarged(&picture);
    draw_scene(&mut drawing, &slot.scene);
    drawing.save(output)?;
    Ok(())
}

fn enlarged(picture: &Picture) -> RgbImage {
    let (width, height) = (picture.size.width as u32, picture.size.height as u32);
    let frame = RgbImage::from_fn(width, height, |x, y| {
        let i = (y * width + x) as usize;
        Rgb([picture.red[i], picture.green[i], picture.blue[i]])
    });
    let filter = imageops::FilterType::Triangle;
    imageops::resize(&frame, SCALE * width, SCALE * height, filter)
}

fn draw_scene(drawing: &mut RgbImage, scene: &Scene) {
    for object in scene.objects() {
        let colour = match object.kind {
            KIND_MARKER => MARKED,
            _ => OBSTACLE,
        };
        let outline = object.outline();
        for (i, &from) in outline.iter().enumerate() {
            line(drawing, from, outline[(i + 1) % outline.len()], colour);
        }
        if let Some(heading) = object.heading() {
            draw_arrow(drawing, object, heading, colour);
        }
        draw_forecast(drawing, object);
    }
}

/// An arrow from the centre of the plate in the direction of the marker.
fn draw_arrow(drawing: &mut RgbImage, object: &Object, heading: f64, colour: Rgb<u8>) {
    let from = [object.x, object.y];
    let ahead = |angle: f64, length: f64, start: [f64; 2]| {
        [
            start[0] + length * angle.cos(),
            start[1] + length * angle.sin(),
        ]
    };
    let tip = ahead(heading, 1.2 * object.size, from);
    line(drawing, from, tip, colour);
    for side in [-2.6, 2.6] {
        line(
            drawing,
            tip,
            ahead(heading + side, 0.3 * object.size, tip),
            colour,
        );
    }
}

/// The path of the next second, and the ellipse half-way.
fn draw_forecast(drawing: &mut RgbImage, object: &Object) {
    let mut last = [object.x, object.y];
    for point in object.forecast().iter().filter(|point| point.dt_s < 1.05) {
        let here = [point.x, point.y];
        line(drawing, last, here, FORECAST);
        last = here;
        if (point.dt_s - 0.5).abs() > 0.05 {
            continue;
        }
        // Cholesky: maps the unit circle to the ellipse.
        let [[xx, xy], [_, yy]] = point.covariance;
        let a = xx.max(0.0).sqrt();
        let b = if a > 0.0 { xy / a } else { 0.0 };
        let c = (yy - b * b).max(0.0).sqrt();
        let on_ellipse = |step: u32| {
            let (sin, cos) = (f64::from(step) * std::f64::consts::TAU / 48.0).sin_cos();
            [
                here[0] + SIGMA_95 * a * cos,
                here[1] + SIGMA_95 * (b * cos + c * sin),
            ]
        };
        for step in 0..48 {
            line(drawing, on_ellipse(step), on_ellipse(step + 1), FORECAST);
        }
    }
}

/// A line two pixels wide, in coordinates of the frame.
fn line(drawing: &mut RgbImage, from: [f64; 2], to: [f64; 2], colour: Rgb<u8>) {
    let scaled = |[x, y]: [f64; 2]| [x, y].map(|v| (v + 0.5) * f64::from(SCALE) - 0.5);
    let (from, to) = (scaled(from), scaled(to));
    let steps = (to[0] - from[0])
        .abs()
        .max((to[1] - from[1]).abs())
        .ceil()
        .clamp(1.0, 10_000.0);
    for step in 0..=steps as u32 {
        let part = f64::from(step) / steps;
        let [x, y] = [0, 1].map(|i| from[i] + part * (to[i] - from[i]));
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let (x, y) = (x as i64 + dx, y as i64 + dy);
            if (0..i64::from(drawing.width())).contains(&x)
                && (0..i64::from(drawing.height())).contains(&y)
            {
                drawing.put_pixel(x as u32, y as u32, colour);
            }
        }
    }
}
