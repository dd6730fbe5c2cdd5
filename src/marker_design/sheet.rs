//! Marker sheets for printing: A4 pages with plates in true size, names and cut lines.

use std::fmt::Write as _;

use pdf_writer::{Content, Finish, Name, Pdf, Rect, Ref, Str};

use crate::marker::MarkerFile;
use crate::marker::drawing::{Drawing, DrawingError, read_drawing};

/// A4, and the unprintable border, millimetres.
const PAGE_MM: [u32; 2] = [210, 297];
const BORDER_MM: u32 = 10;

/// Space between plates, for cut lines and the name.
const GAP_MM: u32 = 8;

/// Height of the letters.
const CAPTION_MM: f32 = 2.5;

/// PDF points: 72 per inch.
const POINTS_PER_MM: f32 = 72.0 / 25.4;

/// Layout of a sheet.
#[derive(Debug, Clone, Copy)]
pub struct Layout {
    /// Side of a plate, millimetres.
    pub plate_mm: u32,
    /// Number of copies of each marker.
    pub copies: u32,
}

/// A plate on a page: its drawing, and its upper left corner in millimetres from that of the page.
struct Spot {
    drawing: Drawing,
    at: [u32; 2],
}

/// The pages, each an SVG file.
///
/// # Errors
///
/// [`DrawingError`] if a drawing is not a marker.
pub fn svg_pages(files: &[MarkerFile], layout: &Layout) -> Result<Vec<String>, DrawingError> {
    let pages = pages(files, layout)?;
    Ok(pages.iter().map(|page| svg_page(page, layout)).collect())
}

/// The pages as one PDF file.
///
/// # Errors
///
/// [`DrawingError`] if a drawing is not a marker.
pub fn pdf(files: &[MarkerFile], layout: &Layout) -> Result<Vec<u8>, DrawingError> {
    const FONT: Name<'_> = Name(b"F1");
    let pages = pages(files, layout)?;
    let [catalog, tree, font] = [1, 2, 3].map(Ref::new);
    let id = |page: usize, part: usize| Ref::new((4 + 2 * page + part) as i32);
    let mut pdf = Pdf::new();
    pdf.catalog(catalog).pages(tree);
    pdf.pages(tree)
        .kids((0..pages.len()).map(|page| id(page, 0)))
        .count(pages.len() as i32);
    pdf.type1_font(font)
        .base_font(Name(b"Helvetica"))
        .encoding_predefined(Name(b"WinAnsiEncoding"));
    let [width, height] = PAGE_MM.map(|mm| mm as f32 * POINTS_PER_MM);
    for (i, spots) in pages.iter().enumerate() {
        let mut page = pdf.page(id(i, 0));
        page.parent(tree)
            .media_box(Rect::new(0.0, 0.0, width, height))
            .contents(id(i, 1));
        page.resources().fonts().pair(FONT, font);
        page.finish();
        let mut content = Content::new();
        for spot in spots {
            pdf_plate(&mut content, spot, layout.plate_mm, FONT);
        }
        pdf.stream(id(i, 1), &content.finish());
    }
    Ok(pdf.finish())
}

/// Position of each plate.
fn pages(files: &[MarkerFile], layout: &Layout) -> Result<Vec<Vec<Spot>>, DrawingError> {
    let pitch = layout.plate_mm + GAP_MM;
    let [columns, rows] = PAGE_MM.map(|side| ((side - 2 * BORDER_MM) / pitch).max(1) as usize);
    let mut pages: Vec<Vec<Spot>> = Vec::new();
    for file in files {
        let drawing = read_drawing(&file.name, &file.svg)?;
        for _ in 0..layout.copies {
            if pages.last().is_none_or(|page| page.len() == columns * rows) {
                pages.push(Vec::new());
            }
            let Some(page) = pages.last_mut() else {
                continue;
            };
            let place = [page.len() % columns, page.len() / columns];
            page.push(Spot {
                drawing: drawing.clone(),
                at: place.map(|i| BORDER_MM + GAP_MM / 2 + i as u32 * pitch),
            });
        }
    }
    Ok(pages)
}

impl Spot {
    /// Corners of the marker on the page, millimetres.
    fn outline(&self, side: u32) -> impl Iterator<Item = [f32; 2]> {
        let corner = move |corner: &[f32; 2]| {
            [0, 1].map(|i| (corner[i] + 0.5) * side as f32 + self.at[i] as f32)
        };
        self.drawing.outline.iter().map(corner)
    }

    /// The cut lines, from one to three millimetres outside of each corner.
    fn cut_lines(&self, side: u32) -> Vec<[[f32; 2]; 2]> {
        let [left, top] = self.at.map(|c| c as f32);
        let (right, bottom) = (left + side as f32, top + side as f32);
        let mut lines = Vec::with_capacity(8);
        for (x, right_of) in [(left, -1.0), (right, 1.0)] {
            for (y, below) in [(top, -1.0), (bottom, 1.0)] {
                lines.push([[x, y + below], [x, y + 3.0 * below]]);
                lines.push([[x + right_of, y], [x + 3.0 * right_of, y]]);
            }
        }
        lines
    }

    /// The caption below the plate, and the middle of its baseline, millimetres.
    fn caption(&self, side: u32) -> (String, [u32; 2]) {
        let [left, top] = self.at;
        let text = format!("{} {side} mm", self.drawing.name);
        (text, [left + side / 2, top + side + 3])
    }
}

fn svg_page(spots: &[Spot], layout: &Layout) -> String {
    let [width, height] = PAGE_MM;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}mm\" height=\"{height}mm\" \
         viewBox=\"0 0 {width} {height}\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n"
    );
    let side = layout.plate_mm;
    for spot in spots {
        let corners: Vec<String> = spot
            .outline(side)
            .map(|[x, y]| format!("{x:.3} {y:.3}"))
            .collect();
        let lines: Vec<String> = spot
            .cut_lines(side)
            .iter()
            .map(|[from, to]| format!("M{} {}L{} {}", from[0], from[1], to[0], to[1]))
            .collect();
        let (caption, [x, y]) = spot.caption(side);
        // Writing to a `String` cannot fail.
        let _ = writeln!(
            svg,
            "<path d=\"M{}Z\"/>\n<path d=\"{}\" fill=\"none\" stroke=\"#888\" stroke-width=\"0.1\"/>\n\
             <text x=\"{x}\" y=\"{y}\" font-family=\"sans-serif\" font-size=\"{CAPTION_MM}\" text-anchor=\"middle\" \
             fill=\"#888\">{}</text>",
            corners.join("L"),
            lines.concat(),
            escaped(&caption),
        );
    }
    svg.push_str("</svg>\n");
    svg
}

/// The origin of a PDF page is its lower left corner.
fn pdf_plate(content: &mut Content, spot: &Spot, side: u32, font: Name<'_>) {
    let point = |[x, y]: [f32; 2]| [x * POINTS_PER_MM, (PAGE_MM[1] as f32 - y) * POINTS_PER_MM];
    for (i, corner) in spot.outline(side).map(point).enumerate() {
        match i {
            0 => content.move_to(corner[0], corner[1]),
            _ => content.line_to(corner[0], corner[1]),
        };
    }
    content.close_path();
    content.fill_nonzero();
    content.save_state();
    content.set_stroke_gray(0.53).set_fill_gray(0.53);
    content.set_line_width(0.1 * POINTS_PER_MM);
    for line in spot.cut_lines(side) {
        let [from, to] = line.map(point);
        content.move_to(from[0], from[1]);
        content.line_to(to[0], to[1]);
    }
    content.stroke();
    let (caption, at) = spot.caption(side);
    // The encoding has one byte for each letter of western Europe.
    let bytes: Vec<u8> = caption
        .chars()
        .map(|letter| u8::try_from(u32::from(letter)).unwrap_or(b'?'))
        .collect();
    let [x, y] = point(at.map(|c| c as f32));
    let size = CAPTION_MM * POINTS_PER_MM;
    // A letter of this font is about half as wide as high.
    let left = x - 0.25 * size * bytes.len() as f32;
    content.begin_text();
    content.set_font(font, size);
    content.next_line(left, y);
    content.show(Str(&bytes));
    content.end_text();
    content.restore_state();
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
        let pages = svg_pages(&files, &layout).expect("the built-in markers");
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
    fn a_pdf_has_the_same_pages() {
        let files = built_in_files();
        let layout = Layout {
            plate_mm: 80,
            copies: 2,
        };
        let pdf = pdf(&files, &layout).expect("the built-in markers");
        let text = String::from_utf8_lossy(&pdf);
        assert!(text.starts_with("%PDF-") && text.trim_end().ends_with("%%EOF"));
        let pages = svg_pages(&files, &layout).expect("the built-in markers");
        assert_eq!(text.matches("/Type /Page\n").count(), pages.len());
        assert!(text.contains("/MediaBox [0 0 595.27"), "A4");
        for file in &files {
            assert_eq!(text.matches(&format!("({} 80 mm)", file.name)).count(), 2);
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
        let [page] = &svg_pages(&[file], &layout).expect("a drawing")[..] else {
            panic!("one page");
        };
        assert!(
            page.contains("M24.000 24.000L44.000 24.000L44.000 44.000L24.000 44.000Z"),
            "{page}"
        );
        assert!(page.contains(">a&lt;b 40 mm<"));
    }
}
