//! Drawings as written by various programs: each shows a plain arrow or another shape, or is
//! rejected with a reason.

use super::*;

const ARROW: &str = r#"<path d="M50 9L80 50H61V91H39V50H20Z"/>"#;

const ROOT: &str = r#"xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" viewBox="0 0 100 100""#;

fn read(content: &str) -> Result<Vec<[f32; 2]>, String> {
    let svg = format!("<svg {ROOT}>{content}</svg>");
    let drawing = read_drawing("test", &svg).map_err(|e| e.reason.to_string())?;
    Ok(drawing.outline)
}

fn area(outline: &[[f32; 2]]) -> f32 {
    fourier::contour::region(outline).area
}

/// All of these are the plain arrow.
#[test]
fn what_is_not_seen_changes_nothing() {
    let plain = read(ARROW).expect("a plain arrow");
    for extra in [
        r##"<rect width="100" height="100" fill="#fff"/>"##,
        r#"<path opacity="0" d="M10 10h30v30h-30z"/>"#,
        r#"<path fill-opacity="0" d="M10 10h30v30h-30z"/>"#,
        r#"<g opacity="0.5"><g opacity="0.1"><path d="M10 10h30v30h-30z"/></g></g>"#,
        r#"<path fill="rgba(0,0,0,0.05)" d="M0 0h100v100H0z"/>"#,
        r#"<path display="none" d="M10 10h30v30h-30z"/>"#,
        r#"<path style="display:none" d="M10 10h30v30h-30z"/>"#,
        r#"<g visibility="hidden"><path d="M10 10h30v30h-30z"/></g>"#,
        r#"<path d="M10 10L90 90"/>"#,
        r#"<path d="M10 10h30"/>"#,
        r#"<path d="M10 10"/>"#,
        r#"<rect x="3" y="3" width="0" height="40"/>"#,
        r#"<path fill="none" d="M0 0h24v24H0z"/>"#,
        r#"<path fill="none" stroke="none" d="M0 0h24v24H0z"/>"#,
        r##"<rect width="100" height="100" fill="none" stroke="#eee"/>"##,
        r#"<path fill="none" stroke="red" stroke-opacity="0" d="M0 0h24v24H0z"/>"#,
        r#"<path fill="none" stroke="red" stroke-width="0" d="M0 0h24v24H0z"/>"#,
        r##"<defs><path id="unused" d="M10 10h30v30h-30z"/><text>label</text></defs>"##,
        r#"<symbol id="s"><path d="M10 10h30v30h-30z"/></symbol>"#,
        r#"<clipPath id="c"><text>clip</text></clipPath>"#,
        r#"<g display="none"><text x="10" y="20">hidden layer</text></g>"#,
        r#"<g style="visibility:hidden"><text x="10" y="20">hidden</text></g>"#,
        r#"<text fill-opacity="0" x="10" y="20">transparent</text>"#,
        r#"<text x="10" y="20"> </text>"#,
        r#"<style>.off{display:none}</style><text class="off" x="1" y="9">off</text>"#,
        r#"<title>arrow</title><desc>text</desc><metadata><text>no</text></metadata>"#,
        r#"<image display="none" href="a.png" width="50" height="50"/>"#,
        r#"<image href="a.png" x="200" y="200" width="50" height="50"/>"#,
        r#"<path d="M200 10h30v30h-30z"/>"#,
        r#"<path d="M50 9L80 50H61V91H39V50H20Z"/>"#,
        r#"<filter id="f"><feGaussianBlur stdDeviation="5"/></filter>"#,
        r#"<linearGradient id="g"><stop stop-color="red"/></linearGradient>"#,
        r#"<style>@font-face{font-family:x} path:hover{fill:red} @media (prefers-color-scheme:dark){path{fill:#fff}}</style>"#,
        r#"<style>/* path:nth-child(2){} */ @charset "utf-8"; .a>path{fill:red}</style>"#,
        r#"<switch><foreignObject requiredExtensions="http://ns.adobe.com/AdobeIllustrator/10.0/" width="1" height="1"/><g/></switch>"#,
    ] {
        // Before the arrow and after it, except that white covers what is below it.
        for content in [format!("{extra}{ARROW}"), format!("{ARROW}{extra}")] {
            if !(extra.contains("fill=\"#fff\"") && content.starts_with(ARROW)) {
                assert_eq!(read(&content).as_ref(), Ok(&plain), "{content}");
            }
        }
    }
}

/// The arrow itself, expressed in other ways.
#[test]
fn a_shape_may_be_written_in_many_ways() {
    let plain = area(&read(ARROW).expect("a plain arrow"));
    let d = "M50 9L80 50H61V91H39V50H20Z";
    for content in [
        format!(r#"<path d="{d} M50 9"/>"#),
        format!(r#"<path d="{d} M50 9 z M3 3 L 4 4"/>"#),
        format!(r#"<path d="{d}{d}"/>"#),
        format!(r#"<path fill-rule="evenodd" d="{d}"/>"#),
        format!(r#"<path color="red" fill="currentColor" style="color:navy" d="{d}"/>"#),
        format!(r##"<style>.a{{fill:#231F20}} svg{{fill:#fff}}</style><path class="a" d="{d}"/>"##),
        format!(r#"<path style="fill:#000;stroke:#000;stroke-opacity:0;stroke-width:9" d="{d}"/>"#),
        format!(r#"<g opacity="0.9"><path fill-opacity="0.9" d="{d}"/></g>"#),
        format!(r#"<svg x="0" y="0" width="100" height="100" viewBox="0 0 50 50"><path transform="scale(.5)" d="{d}"/></svg>"#),
        format!(r##"<defs><path id="a" d="{d}"/></defs><use xlink:href="#a"/>"##),
        format!(r##"<symbol id="a" viewBox="0 0 100 100"><path d="{d}"/></symbol><use href="#a" width="100" height="100"/>"##),
        format!(r#"<switch><g systemLanguage="xx"><text>no</text></g><path d="{d}"/></switch>"#),
        format!(r#"<switch><foreignObject requiredExtensions="x"><p>no</p></foreignObject><g><path d="{d}"/></g></switch>"#),
        format!(r#"<a href="http://nowhere"><path d="{d}"/></a>"#),
        format!(r##"<clipPath id="c"><rect width="100" height="100"/></clipPath><g clip-path="url(#c)"><path d="{d}"/></g>"##),
        format!(r##"<mask id="m"><rect width="100" height="100" fill="#fff"/></mask><path mask="url(#m)" d="{d}"/>"##),
        format!(r##"<linearGradient id="g"><stop stop-color="#000"/><stop offset="1" stop-color="#111"/></linearGradient><path fill="url(#g)" d="{d}"/>"##),
        format!(r##"<filter id="f"><feOffset/></filter><path filter="url(#f)" d="{d}"/>"##),
        r#"<polygon points="50,9 80,50 61,50 61,91 39,91 39,50 20,50"/>"#.to_owned(),
        // In two adjoining parts, and with an end covered by white.
        r#"<path d="M50 9L80 50H20Z"/><rect x="39" y="50" width="22" height="41"/>"#.to_owned(),
        r##"<path d="M50 9L80 50H61V99H39V50H20Z"/><rect y="91" width="100" height="9" fill="#fff"/>"##.to_owned(),
    ] {
        let outline = read(&content).unwrap_or_else(|e| panic!("{content}: {e}"));
        assert!((area(&outline) - plain).abs() < 2e-4, "{content}: {}", area(&outline));
    }
}

/// A traced outline is as exact as one in the file.
#[test]
fn a_shape_that_is_cut_out_is_exact() {
    let ring = |cut: &str| format!(r##"<circle cx="50" cy="50" r="30"/>{cut}"##);
    let outline = read(&ring(
        r##"<rect x="50" width="50" height="100" fill="#fff"/>"##,
    ));
    let outline = outline.expect("half a disc");
    for [x, y] in &outline {
        let off = (x.hypot(*y) - 0.3).abs().min(x.abs());
        assert!(off < 1.5e-4, "{x} {y}");
    }
    assert!((area(&outline) - 0.045 * std::f32::consts::PI).abs() < 1e-4);
    assert!(outline.len() < 160, "{}", outline.len());

    let clipped = read(
        r##"<clipPath id="c"><rect width="100" height="100"/></clipPath><g clip-path="url(#c)"><path d="M50 9L80 50H61V115H39V50H20Z"/></g>"##,
    );
    let lowest = clipped
        .expect("it ends at the edge")
        .iter()
        .fold(0.0, |low: f32, p| low.max(p[1]));
    assert!((lowest - 0.5).abs() < 1e-4, "{lowest}");
}

/// Each is rejected, and the message says what to change.
#[test]
fn unsupported_content_that_changes_the_picture_is_rejected() {
    for (content, reason) in [
        (
            r#"<path fill-opacity="0.08" d="M50 9L80 50H20Z"/>"#,
            "opacity of 8 %",
        ),
        (
            r#"<g opacity="0.5"><g opacity="0.5"><path d="M50 9L80 50H20Z"/></g></g>"#,
            "opacity of 25 %",
        ),
        (
            r#"<path opacity="0" d="M50 9L80 50H20Z"/>"#,
            "no dark shape",
        ),
        (
            r##"<rect width="100" height="100"/><path fill="#fff" d="M50 9L80 50H20Z"/>"##,
            "border of the plate is dark",
        ),
        (
            r##"<path d="M50 9L80 90H20Z"/><circle cx="50" cy="65" r="9" fill="#fff"/>"##,
            "2 outlines",
        ),
        (
            r##"<path d="M50 9L80 90H20Z"/><rect y="50" width="100" height="9" fill="#fff"/>"##,
            "2 dark shapes",
        ),
        (
            r#"<path d="M50 9L80 90H20Z"/><text id="label" x="2" y="98">R1</text>"#,
            "contains text, id \"label\"; convert text to a path",
        ),
        (
            r##"<defs><text id="t" x="9" y="9">R1</text></defs><use href="#t"/><path d="M50 9L80 90H20Z"/>"##,
            "contains text",
        ),
        (
            r#"<path d="M50 9L80 90H20Z"/><text fill="none" stroke="red" x="2" y="98">R1</text>"#,
            "contains text",
        ),
        (
            r#"<path d="M50 9L80 90H20Z"/><foreignObject width="50" height="20" fill="none"><p>R1</p></foreignObject>"#,
            "embedded HTML",
        ),
        (
            r#"<path d="M50 9L80 90H20Z"/><image id="photo" href="photo.png" width="50" height="20"/>"#,
            "a picture, id \"photo\"; trace it",
        ),
        (
            r#"<path d="M50 9L80 90H20Z"/><image xlink:href="data:image/png;base64,AAAA" width="50" height="20"/>"#,
            "a picture",
        ),
        (
            r##"<path d="M50 9L80 90H20Z" stroke="#000" stroke-width="0.1"/>"##,
            "a stroke; convert it into a filled path",
        ),
        (
            r##"<path d="M50 9L80 90H20Z" stroke="#fff" stroke-width="2"/>"##,
            "a stroke",
        ),
        (
            r##"<path id="frame" fill="none" stroke="#000" d="M1 1H99V99H1Z"/><path d="M50 9L80 90H20Z"/>"##,
            "a stroke, id \"frame\"",
        ),
        (
            r##"<marker id="m" markerWidth="9" markerHeight="9"><path d="M0 0h9v9z"/></marker><path d="M50 9L80 90H20Z"/><path marker-end="url(#m)" fill="none" d="M5 5L20 20"/>"##,
            "2 dark shapes",
        ),
        (
            r##"<filter id="f"><feGaussianBlur stdDeviation="4"/></filter><path filter="url(#f)" d="M50 9L80 90H20Z"/>"##,
            "a filter",
        ),
        (
            r##"<path style="filter:drop-shadow(4px 4px 2px #000)" d="M50 9L80 90H20Z"/>"##,
            "a filter",
        ),
        (
            r##"<linearGradient id="g"><stop stop-color="#000"/><stop offset="1" stop-color="#fff"/></linearGradient><path id="p" fill="url(#g)" d="M50 9L80 90H20Z"/>"##,
            "a gradient, id \"p\"",
        ),
        (
            r##"<pattern id="h" width="4" height="4" patternUnits="userSpaceOnUse"><rect width="2" height="4"/></pattern><path fill="url(#h)" d="M50 9L80 90H20Z"/>"##,
            "dark shapes",
        ),
        (
            r##"<linearGradient id="g"><stop stop-color="#000"/><stop offset="1" stop-color="#fff"/></linearGradient><mask id="m"><rect width="100" height="100" fill="url(#g)"/></mask><path mask="url(#m)" d="M50 9L80 90H20Z"/>"##,
            "a mask",
        ),
        (
            r##"<mask id="m"><rect width="100" height="100" fill="#000"/></mask><path mask="url(#m)" d="M50 9L80 90H20Z"/>"##,
            "a mask",
        ),
        (
            r##"<path d="M50 9L80 90H20Z"/><rect width="18" height="18" fill="#888"/>"##,
            "half-tones",
        ),
        (
            r#"<path d="M50 9L80 90H20Z"><animate attributeName="opacity" to="0" dur="1s"/></path>"#,
            "an animation (animate)",
        ),
        (
            r#"<script>document.title=1</script><path d="M50 9L80 90H20Z"/>"#,
            "a script",
        ),
        (
            r##"<path d="M50 9L80 90H20Z"/><use href="other.svg#eye"/>"##,
            "a reference to another file (use)",
        ),
        (
            r#"<style>@import url(a.css);</style><path d="M50 9L80 90H20Z"/>"#,
            "@import",
        ),
        (
            r#"<style>@media print{path{display:none}}</style><path d="M50 9L80 90H20Z"/>"#,
            "@media",
        ),
        (
            r#"<style>path:nth-child(2){fill:#fff}</style><path d="M50 9L80 90H20Z"/>"#,
            ":nth-child",
        ),
        (
            r#"<style>:root{--c:#fff} path{fill:var(--c)}</style><path d="M50 9L80 90H20Z"/>"#,
            ":root",
        ),
        (
            r#"<path fill="var(--c, white)" d="M50 9L80 90H20Z"/>"#,
            "fill: var(...)",
        ),
        (
            r#"<path style="clip-path:circle(20px)" d="M50 9L80 90H20Z"/>"#,
            "clip-path: circle(...)",
        ),
        (
            r#"<path style="transform:rotate(45deg)" d="M50 9L80 90H20Z"/>"#,
            "transform: rotate(45deg)",
        ),
        (
            r#"<path style="animation:spin 2s" d="M50 9L80 90H20Z"/>"#,
            "an animation",
        ),
        (
            r#"<style>svg{background:#000}</style><path d="M50 9L80 90H20Z"/>"#,
            "background",
        ),
        (
            r#"<path d="M50 9L80 120H20Z"/>"#,
            "reaches out of the view box",
        ),
    ] {
        let refused = read(content)
            .map(|outline| outline.len())
            .expect_err(content);
        assert!(refused.contains(reason), "{content}: {refused}");
        assert!(!refused.contains('\n'));
    }
}

/// Small files that would keep a renderer busy for hours.
#[test]
fn drawings_without_an_end_are_refused() {
    let nested: String = (1..5)
        .map(|i| {
            format!(
                "<g id=\"g{i}\">{}</g>",
                format!("<use href=\"#g{}\"/>", i - 1).repeat(8)
            )
        })
        .collect();
    let many = format!("<defs><path id=\"g0\" d=\"M0 0h9v9z\"/></defs>{nested}");
    let filter = |primitive: &str| {
        format!(
            "<filter id=\"f\">{primitive}</filter><path filter=\"url(#f)\" d=\"M50 9L80 90H20Z\"/>"
        )
    };
    for (content, reason) in [
        (many, "more than 2000 shapes"),
        (ARROW.repeat(3000), "more than 2000 shapes"),
        (
            format!("<g opacity=\"0.5\"><path d=\"M0 0h1e9v1e9\"/></g>{ARROW}"),
            "times as large as the plate",
        ),
        (
            filter("<feTurbulence baseFrequency=\"0.1\" numOctaves=\"999999999\"/>"),
            "a filter, id \"f\"",
        ),
        (
            filter("<feMorphology operator=\"dilate\" radius=\"9999\"/>"),
            "a filter",
        ),
    ] {
        let refused = read(&content)
            .map(|outline| outline.len())
            .expect_err(reason);
        assert!(refused.contains(reason), "{refused}");
    }
    for depth in [100, 5000, 500_000] {
        let deep = "<g opacity=\"0.999\">".repeat(depth) + ARROW + &"</g>".repeat(depth);
        assert!(read(&deep).is_err(), "{depth}");
    } // Text outside of tags does not count.
    let flat = format!(
        "{}{}",
        "<!-- <g><g> --><g id='/>'/><g id='>'></g>".repeat(300),
        ARROW
    );
    assert!(read(&flat).is_ok());
    let uses: String = (1..900)
        .map(|i| format!("<g id=\"g{i}\"><use href=\"#g{}\"/></g>", i - 1))
        .collect();
    let chain = format!("<g id=\"g0\">{ARROW}</g>{uses}");
    // Whatever it shows, the reader must terminate.
    let _ = read(&chain);
}
