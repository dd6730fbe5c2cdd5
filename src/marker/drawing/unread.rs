//! Parts of an SVG file that a browser or a drawing program shows, but `usvg` ignores.
//!
//! Most are rejected wherever they occur: animations, scripts, external files, and style sheet
//! rules that `usvg` does not support. Text and foreign objects are common in files that do not
//! show them: on a hidden layer, in a definition, in an unselected branch of a `switch`. They are
//! therefore replaced by stand-in elements that `usvg` reads, and the visible ones are found in
//! its tree ([`is_text`], [`is_foreign`]).

use std::borrow::Cow;

use simplecss::{DeclarationTokenizer, StyleSheet};
use usvg::roxmltree::{Document, Node, NodeType};
use usvg::tiny_skia_path::Point;

use crate::marker::drawing::Reason;

const SVG: &str = "http://www.w3.org/2000/svg";

/// The stand-in path for text: a triangle that does not occur in drawings.
const TEXT_PATH: &str = "M0.25 0.125L1.75 0.375L1.125 1.625Z";
const TEXT_POINTS: [[f32; 2]; 3] = [[0.25, 0.125], [1.75, 0.375], [1.125, 1.625]];

/// The stand-in image for a foreign object, and its side.
const FOREIGN_HREF: &str = "overcam:foreignObject";
const FOREIGN_SIDE: f32 = 3.0;

/// Functions in attribute and property values that `usvg` evaluates, or that do not change the
/// image.
const FUNCTIONS: [&str; 25] = [
    "url",
    "rgb",
    "rgba",
    "hsl",
    "hsla",
    "matrix",
    "translate",
    "translatex",
    "translatey",
    "scale",
    "scalex",
    "scaley",
    "rotate",
    "skewx",
    "skewy",
    "blur",
    "brightness",
    "contrast",
    "drop-shadow",
    "grayscale",
    "hue-rotate",
    "invert",
    "opacity",
    "saturate",
    "sepia",
];

/// Attributes and properties whose values affect the image.
const DRAWN: [&str; 26] = [
    "clip-path",
    "clip-rule",
    "color",
    "d",
    "display",
    "fill",
    "fill-opacity",
    "fill-rule",
    "filter",
    "flood-color",
    "flood-opacity",
    "marker",
    "marker-end",
    "marker-mid",
    "marker-start",
    "mask",
    "mix-blend-mode",
    "opacity",
    "points",
    "stop-color",
    "stop-opacity",
    "stroke",
    "stroke-opacity",
    "stroke-width",
    "transform",
    "visibility",
];

/// Style sheet properties that `usvg` does not read, although they move or reshape elements.
const UNREAD_PROPERTIES: [&str; 16] = [
    "cx",
    "cy",
    "d",
    "offset-path",
    "r",
    "rotate",
    "rx",
    "ry",
    "scale",
    "translate",
    "x",
    "y",
    "zoom",
    "mask-image",
    "transform-box",
    "background-image",
];

/// Pseudo-classes that `simplecss` reads, or that apply only during user interaction.
const PSEUDO_CLASSES: [&str; 11] = [
    "first-child",
    "link",
    "visited",
    "hover",
    "active",
    "focus",
    "focus-visible",
    "focus-within",
    "target",
    "lang",
    "selection",
];

/// Maximum nesting depth of elements: deeper files are a mistake or an attack, because parsers
/// recurse for each level.
const DEPTH_MAX: usize = 256;

/// Whether elements are nested too deeply for a parser's stack. Examines only the text.
pub(super) fn is_too_deep(svg: &str) -> bool {
    let bytes = svg.as_bytes();
    let skip = |from: usize, end: &str| svg[from..].find(end).map_or(bytes.len(), |at| from + at);
    let (mut at, mut depth) = (0, 0usize);
    while let Some(start) = svg[at..].find('<').map(|found| at + found) {
        at = start + 1;
        match bytes.get(at) {
            Some(b'!') if svg[at..].starts_with("!--") => at = skip(at, "-->"),
            Some(b'!') if svg[at..].starts_with("![CDATA[") => at = skip(at, "]]>"),
            Some(b'!' | b'?') | None => {}
            Some(b'/') => depth = depth.saturating_sub(1),
            Some(_) => {
                depth += 1;
                if depth > DEPTH_MAX {
                    return true;
                }
                // Skip to the end of the tag; `>` may also occur in a quoted value.
                let mut quote = None;
                while let Some(&byte) = bytes.get(at) {
                    match quote {
                        Some(open) if open == byte => quote = None,
                        None if matches!(byte, b'"' | b'\'') => quote = Some(byte),
                        None if byte == b'>' => {
                            depth -= usize::from(bytes[at - 1] == b'/');
                            break;
                        }
                        _ => {}
                    }
                    at += 1;
                }
            }
        }
    }
    false
}

/// Rejects content that changes the image and is not supported.
pub(super) fn refuse(document: &Document) -> Result<(), Reason> {
    for node in document.descendants() {
        match node.node_type() {
            NodeType::PI if node.pi().is_some_and(|pi| pi.target == "xml-stylesheet") => {
                return Err(not_read("a style sheet in another file", "", INLINE));
            }
            NodeType::Element if is_svg(node) => refuse_element(node)?,
            _ => {}
        }
    }
    Ok(())
}

pub(super) const CONVERT_TEXT: &str =
    "convert text to a path and unite it with the shape, or remove it";
const INLINE: &str = "put what it refers to into this file";
const PLAIN_STYLE: &str = "set plain attributes of the elements instead";

fn not_read(what: impl Into<String>, id: &str, remedy: &'static str) -> Reason {
    Reason::NotRead {
        what: what.into(),
        id: id.to_owned(),
        remedy,
    }
}

/// `usvg` also treats elements without a namespace as SVG.
fn is_svg(node: Node) -> bool {
    node.is_element() && matches!(node.tag_name().namespace(), None | Some(SVG))
}

fn refuse_element(node: Node) -> Result<(), Reason> {
    let id = node.attribute("id").unwrap_or_default();
    let name = node.tag_name().name();
    match name {
        "animate" | "animateTransform" | "animateMotion" | "animateColor" | "set" => {
            return Err(not_read(
                format!("an animation ({name})"),
                id,
                "remove it, and draw what is to be printed",
            ));
        }
        "script" => {
            return Err(not_read(
                "a script",
                id,
                "remove it, and draw what is to be printed",
            ));
        }
        "style" => {
            let text: String = node
                .descendants()
                .filter(|node| node.is_text())
                .filter_map(|node| node.text())
                .collect();
            return refuse_sheet(&text);
        }
        _ => {}
    }
    for attribute in node.attributes() {
        let (key, value) = (attribute.name(), attribute.value().trim());
        // An `a` only links elsewhere, and images are found in the tree.
        let refers = key == "href" && !matches!(name, "a" | "image" | "feImage");
        if refers && !value.is_empty() && !value.starts_with('#') {
            return Err(not_read(
                format!("a reference to another file ({name})"),
                id,
                INLINE,
            ));
        }
        if key == "style" {
            let is_root = node.parent().is_some_and(|parent| parent.is_root());
            for declaration in DeclarationTokenizer::from(value) {
                refuse_declaration(declaration.name, declaration.value, is_root, id)?;
            }
        } else if attribute.namespace().is_none() {
            refuse_value(key, value, id)?;
        }
    }
    Ok(())
}

/// Rejects rules and declarations that are skipped when the style sheet is read.
fn refuse_sheet(text: &str) -> Result<(), Reason> {
    let text = without_comments(text);
    for prelude in preludes(&text) {
        let lower = prelude.to_lowercase();
        if let Some(rule) = lower.strip_prefix('@') {
            let name: String = rule
                .chars()
                .take_while(|c| c.is_alphanumeric() || *c == '-')
                .collect();
            // Keyframes have no effect without an animation; a drawing is printed on white.
            let is_harmless = matches!(
                name.as_str(),
                "charset" | "namespace" | "font-face" | "keyframes" | "-webkit-keyframes"
            ) || name == "media" && rule.contains("dark");
            if !is_harmless {
                return Err(not_read(format!("the style rule @{name}"), "", PLAIN_STYLE));
            }
            continue;
        }
        let pseudo = lower.split(':').skip(1).map(|rest| {
            rest.chars()
                .take_while(|c| c.is_alphanumeric() || *c == '-')
                .collect::<String>()
        });
        let unread = pseudo
            .filter(|name| !PSEUDO_CLASSES.contains(&name.as_str()))
            .find(|name| !name.is_empty());
        if let Some(name) = unread {
            return Err(not_read(
                format!("the style selector :{name}"),
                "",
                PLAIN_STYLE,
            ));
        }
        if lower.replace("~=", "").contains('~') {
            return Err(not_read("the style selector ~", "", PLAIN_STYLE));
        }
    }
    for rule in StyleSheet::parse(&text).rules {
        for declaration in &rule.declarations {
            refuse_declaration(declaration.name, declaration.value, true, "")?;
        }
    }
    Ok(())
}

fn without_comments(text: &str) -> Cow<'_, str> {
    if !text.contains("/*") {
        return Cow::Borrowed(text);
    }
    let mut out = String::new();
    let mut rest = text;
    while let Some(start) = rest.find("/*") {
        out += &rest[..start];
        out.push(' ');
        rest = rest[start..]
            .find("*/")
            .map_or("", |end| &rest[start + end + 2..]);
    }
    out += rest;
    Cow::Owned(out)
}

/// The preludes of a style sheet's blocks, and rules without a block.
fn preludes(text: &str) -> Vec<&str> {
    let (mut found, mut depth, mut start) = (Vec::new(), 0usize, 0);
    for (i, c) in text.char_indices() {
        match c {
            '{' | ';' if depth == 0 => found.push(text[start..i].trim()),
            _ => {}
        }
        match c {
            '{' => depth += 1,
            '}' => depth = depth.saturating_sub(1),
            _ => {}
        }
        if depth == 0 && matches!(c, '}' | ';') {
            start = i + 1;
        }
    }
    found.retain(|prelude| !prelude.is_empty());
    found
}

/// `may_be_root`: the declaration may apply to the root element, the only one with a background.
fn refuse_declaration(name: &str, value: &str, may_be_root: bool, id: &str) -> Result<(), Reason> {
    let name = name.to_lowercase();
    let value = value.trim().to_lowercase();
    let style = |what: String| not_read(what, id, PLAIN_STYLE);
    let is_none = matches!(value.as_str(), "none" | "initial" | "unset" | "normal" | "");
    if name.starts_with("animation") && !is_none {
        return Err(not_read(
            format!("an animation (style property {name})"),
            id,
            "remove it, and draw what is to be printed",
        ));
    }
    let is_white = matches!(
        value.as_str(),
        "white" | "#fff" | "#ffffff" | "transparent" | "inherit"
    );
    let is_background = matches!(name.as_str(), "background" | "background-color");
    if is_background && may_be_root && !is_none && !is_white {
        return Err(not_read(
            format!("the style property {name}"),
            id,
            "draw a rectangle instead",
        ));
    }
    let is_default = matches!(value.as_str(), "view-box" | "auto" | "0" | "1");
    if UNREAD_PROPERTIES.contains(&name.as_str()) && !is_none && !is_default {
        return Err(style(format!("the style property {name}")));
    }
    // Only numbers without a unit are supported.
    let has_unit = ["deg", "rad", "turn", "px", "mm", "em", "%"]
        .iter()
        .any(|unit| value.contains(unit));
    if name == "transform" && has_unit {
        return Err(not_read(
            format!("the style property transform: {value}"),
            id,
            "write it as an attribute, without units",
        ));
    }
    refuse_value(&name, &value, id)
}

/// Rejects functions that are not evaluated.
fn refuse_value(name: &str, value: &str, id: &str) -> Result<(), Reason> {
    if !DRAWN.contains(&name) {
        return Ok(());
    }
    for (at, _) in value.match_indices('(') {
        let word = |c: char| !(c.is_alphanumeric() || c == '-' || c == '_');
        let function = value[..at].trim_end().rsplit(word).next().unwrap_or("");
        let function = function.to_lowercase();
        // A quoted file name may contain anything.
        if value[..at].contains("url(") {
            break;
        }
        let takes_url_only = matches!(name, "clip-path" | "mask") && function != "url";
        if !FUNCTIONS.contains(&function.as_str()) || takes_url_only {
            return Err(not_read(
                format!("{name}: {function}(...)"),
                id,
                "write the value itself, or convert the shape into a plain path",
            ));
        }
    }
    Ok(())
}

/// The file with text and foreign objects replaced by stand-ins; `None` if there are none.
pub(super) fn with_stand_ins(svg: &str, document: &Document) -> Result<Option<String>, Reason> {
    let mut out = String::new();
    let (mut copied, mut replaced) = (0, 0..0);
    for node in document.descendants().filter(|node| is_svg(*node)) {
        let is_text = match node.tag_name().name() {
            "text" => node
                .descendants()
                .filter_map(|node| node.text().filter(|_| node.is_text()))
                .any(|text| !text.trim().is_empty()),
            "foreignObject" => false,
            _ => continue,
        };
        if !is_text && node.tag_name().name() == "text" {
            continue;
        }
        let range = node.range();
        if replaced.contains(&range.start) {
            continue;
        }
        if range.start < copied || !svg[range.clone()].starts_with('<') {
            let id = node.attribute("id").unwrap_or_default();
            return Err(not_read("text in an entity", id, CONVERT_TEXT));
        }
        let name_end = svg[range.clone()]
            .find(|c: char| c.is_whitespace() || c == '/' || c == '>')
            .map_or(range.end, |length| range.start + length);
        let qualified = &svg[range.start + 1..name_end];
        let prefix = qualified
            .rfind(':')
            .map_or("", |colon| &qualified[..=colon]);
        out += &svg[copied..range.start];
        out += &if is_text {
            format!("<{prefix}path d=\"{TEXT_PATH}\"")
        } else {
            format!("<{prefix}image href=\"{FOREIGN_HREF}\"")
        };
        for attribute in node.attributes() {
            if !matches!(attribute.name(), "d" | "href") {
                out.push(' ');
                out += &svg[attribute.range()];
            }
        }
        out += "/>";
        copied = range.end;
        replaced = range;
    }
    if copied == 0 {
        return Ok(None);
    }
    out += &svg[copied..];
    Ok(Some(out))
}

/// Image resolver that keeps all images, whatever their content and location, so that they are
/// found in the tree.
pub(super) fn image_resolver() -> usvg::ImageHrefResolver<'static> {
    let blank = |side: f32| {
        let svg = format!(r#"<svg xmlns="{SVG}" width="{side}" height="{side}"/>"#);
        usvg::Tree::from_str(&svg, &usvg::Options::default())
            .ok()
            .map(usvg::ImageKind::SVG)
    };
    usvg::ImageHrefResolver {
        resolve_data: Box::new(move |_, _, _| blank(1.0)),
        resolve_string: Box::new(move |href, _| {
            blank(if href == FOREIGN_HREF {
                FOREIGN_SIDE
            } else {
                1.0
            })
        }),
    }
}

/// Whether a path is the stand-in for text.
pub(super) fn is_text(path: &usvg::Path) -> bool {
    let same = |(a, b): (&Point, [f32; 2])| [a.x, a.y] == b;
    let points = path.data().points();
    points.len() == TEXT_POINTS.len() && points.iter().zip(TEXT_POINTS).all(same)
}

/// Whether an image is the stand-in for a foreign object.
pub(super) fn is_foreign(image: &usvg::Image) -> bool {
    image.size().width() == FOREIGN_SIDE
}
