//! Markers to print: A4 pages with plates in their true size, names and cut lines.

use std::fmt::Write as _;

use crate::marker::MarkerFile;
use crate::marker::drawing::{Drawing, DrawingError, read_drawing};

/// A4, and the border that printers leave, millimetres.
const PAGE_MM: [u32; 2] = [210, 297];
const BORDER_MM: u32 = 10;

/// Between plates: room for cut lines and the name.
const GAP_MM: u32 = 8;

/// What a sheet looks like.
#[derive(Debug, Clone, Copy)]
pub struct Layout {
    /// Side of a plate, millimetres.
    pub plate_mm: u32,
    /// How often each marker is drawn.
    pub copies: u32,
}

/// The pages, each an SVG file.
///
/// # Errors
///
/// [`DrawingError`] when a drawing is no marker.
pub fn sheet(files: &[MarkerFile], layout: &Layout) -> Result<Vec<String>, DrawingError> {
    let drawings = files
        .iter()
        .map(|file| read_drawing(&file.name, &file.svg))
        .collect::<Result<Vec<_>, _>>()?;
    let pitch = layout.plate_mm + GAP_MM;
    let fit = PAGE_MM.map(|side| ((side - 2 * BORDER_MM) / pitch).max(1) as usize);
    let plates: Vec<&Drawing> = drawings
        .iter()
        .flat_map(|drawing| std::iter::repeat_n(drawing, layout.copies as usize))
        .collect();
    Ok(plates
        .chunks(fit[0] * fit[1])
        .map(|plates| page(plates, fit[0], layout))
        .collect())
}

fn page(plates: &[&Drawing], columns: usize, layout: &Layout) -> String {
    let [width, height] = PAGE_MM;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}mm\" height=\"{height}mm\" \
         viewBox=\"0 0 {width} {height}\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n"
    );
    for (i, drawing) in plates.iter().enumerate() {
        let at = |i: usize| BORDER_MM + GAP_MM / 2 + i as u32 * (layout.plate_mm + GAP_MM);
        plate(
            &mut svg,
            drawing,
            at(i % columns),
            at(i / columns),
            layout.plate_mm,
        );
    }
    svg.push_str("</svg>\n");
    svg
}

/// A marker, its cut lines just outside of the plate's corners, and its name below.
fn plate(svg: &mut String, drawing: &Drawing, left: u32, top: u32, side: u32) {
    // A `String` takes everything that is written to it.
    let mut lines = String::new();
    // From one millimetre beside a corner to three, away from the plate.
    let (right, bottom) = (left + side, top + side);
    for (y, outwards) in [(top, "v-2"), (bottom, "v2")] {
        for x in [left, right] {
            let from = if y == top { y - 1 } else { y + 1 };
            let _ = write!(lines, "M{x} {from}{outwards}");
        }
    }
    for (x, outwards) in [(left, "h-2"), (right, "h2")] {
        for y in [top, bottom] {
            let from = if x == left { x - 1 } else { x + 1 };
            let _ = write!(lines, "M{from} {y}{outwards}");
        }
    }
    let corners: Vec<String> = drawing
        .outline
        .iter()
        .map(|corner| {
            let [x, y] = corner.map(|c| (c + 0.5) * side as f32);
            format!("{:.3} {:.3}", x + left as f32, y + top as f32)
        })
        .collect();
    let _ = writeln!(
        svg,
        "<path d=\"M{}Z\"/>\n<path d=\"{lines}\" fill=\"none\" stroke=\"#888\" stroke-width=\"0.1\"/>\n\
         <text x=\"{}\" y=\"{}\" font-family=\"sans-serif\" font-size=\"2.5\" text-anchor=\"middle\" fill=\"#888\">\
         {} {side} mm</text>",
        corners.join("L"),
        left + side / 2,
        top + side + 3,
        escaped(&drawing.name),
    );
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marker::built_in_files;

    #[test]
    fn every_marker_is_drawn_so_often_and_in_its_size() {
        let files = built_in_files();
        let layout = Layout {
            plate_mm: 80,
            copies: 3,
        };
        let pages = sheet(&files, &layout).expect("the built-in markers");
        // Two by three plates of 80 mm fit on a page.
        assert_eq!(pages.len(), (3 * files.len()).div_ceil(6));
        for page in &pages {
            let tree = usvg::Tree::from_str(page, &usvg::Options::default()).expect("SVG");
            let mm = tree.size().width() / 210.0;
            assert!((tree.size().height() / mm - 297.0).abs() < 0.1);
        }
        let all = pages.concat();
        for file in &files {
            assert_eq!(all.matches(&format!(">{} 80 mm<", file.name)).count(), 3);
        }
    }

    #[test]
    fn a_plate_is_where_its_corners_say() {
        let file = MarkerFile {
            name: "a<b".to_owned(),
            svg: r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 100 100"><path d="M25 25H75V75H25Z"/></svg>"#
                .to_owned(),
        };
        let layout = Layout {
            plate_mm: 40,
            copies: 1,
        };
        let [page] = &sheet(&[file], &layout).expect("a drawing")[..] else {
            panic!("one page");
        };
        assert!(
            page.contains("M24.000 24.000L44.000 24.000L44.000 44.000L24.000 44.000Z"),
            "{page}"
        );
        assert!(page.contains(">a&lt;b 40 mm<"));
    }
}
