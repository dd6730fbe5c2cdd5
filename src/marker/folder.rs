//! The SVG files of a folder, in any encoding.

use std::io::Read;
use std::path::Path;

use encoding_rs::{Encoding, UTF_8, UTF_16BE, UTF_16LE, WINDOWS_1252};
use flate2::read::MultiGzDecoder;

use crate::marker::name::{NameError, check_name, check_unlike};
use crate::marker::{FamilyError, MarkerFile};

/// Maximum file size in bytes: a marker has some hundred corners, not millions.
const BYTES_MAX: u64 = 4 << 20;

/// Reads the SVG files of a folder, in the order of their names. Hidden files are skipped, because
/// some systems create one for each other file.
///
/// # Errors
///
/// [`FamilyError`] if the folder or a file cannot be read, there is no file, or two names look
/// alike.
pub fn read_folder(folder: &Path) -> Result<Vec<MarkerFile>, FamilyError> {
    let unreadable = |path: &Path, error: std::io::Error| FamilyError::Unreadable {
        folder: path.display().to_string(),
        reason: error.to_string(),
    };
    let mut files: Vec<MarkerFile> = Vec::new();
    let mut file_names: Vec<String> = Vec::new();
    let entries = std::fs::read_dir(folder).map_err(|e| unreadable(folder, e))?;
    let paths: Result<Vec<_>, _> = entries.map(|entry| entry.map(|e| e.path())).collect();
    let mut paths = paths.map_err(|e| unreadable(folder, e))?;
    paths.sort();
    for path in paths {
        let is_hidden = path
            .file_name()
            .is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
        let (Some(stem), Some(extension)) = (path.file_stem(), path.extension()) else {
            continue;
        };
        if is_hidden || path.is_dir() {
            continue;
        }
        if extension.eq_ignore_ascii_case("svgz") {
            let file = path.display().to_string();
            return Err(FamilyError::Compressed { file });
        }
        if !extension.eq_ignore_ascii_case("svg") {
            continue;
        }
        let name = stem.to_string_lossy().into_owned();
        check_name(&name)?;
        let file_name = path.file_name().unwrap_or_default().to_string_lossy();
        for (file, read) in files.iter().zip(&file_names) {
            check_unlike(&name, [file.name.as_str()]).map_err(|_| NameError::Alike {
                first: String::clone(read),
                second: file_name.to_string(),
            })?;
        }
        let bytes = std::fs::read(&path).map_err(|e| unreadable(&path, e))?;
        let svg = decode(&bytes).map_err(|reason| FamilyError::Undecodable {
            file: path.display().to_string(),
            reason,
        })?;
        file_names.push(file_name.into_owned());
        files.push(MarkerFile { name, svg });
    }
    if files.is_empty() {
        return Err(FamilyError::Empty {
            folder: folder.display().to_string(),
        });
    }
    files.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(files)
}

/// Decodes a file according to the XML rules for encodings. Gzip is detected too, because drawing
/// programs write it under either extension.
fn decode(bytes: &[u8]) -> Result<String, String> {
    let too_large = || format!("it has more than {} MiB", BYTES_MAX >> 20);
    if bytes.starts_with(&[0x1f, 0x8b]) {
        let mut unpacked = Vec::new();
        MultiGzDecoder::new(bytes)
            .take(BYTES_MAX + 1)
            .read_to_end(&mut unpacked)
            .map_err(|error| format!("it is compressed, and damaged ({error})"))?;
        if unpacked.starts_with(&[0x1f, 0x8b]) {
            return Err("it is compressed twice".to_owned());
        }
        return decode(&unpacked);
    }
    if bytes.len() as u64 > BYTES_MAX {
        return Err(too_large());
    }
    let declared = declared_encoding(bytes);
    let (encoding, mark) = match (Encoding::for_bom(bytes), bytes) {
        (Some(found), _) => found,
        (None, [0, b'<', 0, ..]) => (UTF_16BE, 0),
        (None, [b'<', 0, ..]) => (UTF_16LE, 0),
        (None, _) => match declared.as_deref() {
            None => (UTF_8, 0),
            // windows-1252 is a superset of ISO-8859-1.
            Some(label) if label.eq_ignore_ascii_case("iso-8859-1") => (WINDOWS_1252, 0),
            Some(label) => {
                let known = Encoding::for_label(label.as_bytes());
                let known = known.ok_or_else(|| format!("its encoding {label:?} is not known"))?;
                // The declaration itself was readable as ASCII, so the text is not UTF-16.
                (known.output_encoding(), 0)
            }
        },
    };
    let (text, is_faulty) = encoding.decode_without_bom_handling(&bytes[mark..]);
    if is_faulty || text.contains('\0') {
        return Err(format!("it is not valid {}", encoding.name()));
    }
    if encoding == UTF_8 {
        return Ok(text.into_owned());
    }
    // The text is now UTF-8, and its declaration must match.
    let Some(range) = declaration(&text) else {
        return Ok(text.into_owned());
    };
    Ok(format!("<?xml version=\"1.0\"?>{}", &text[range..]))
}

/// The range of the XML declaration, if there is one.
fn declaration(text: &str) -> Option<usize> {
    let end = text.starts_with("<?xml").then(|| text.find("?>"))??;
    Some(end + 2)
}

/// The encoding given in the XML declaration.
fn declared_encoding(bytes: &[u8]) -> Option<String> {
    let head: String = bytes.iter().take(256).map(|&b| char::from(b)).collect();
    let declaration = &head[..declaration(&head)?];
    let after = declaration.split("encoding").nth(1)?;
    let value = after.trim_start().strip_prefix('=')?.trim_start();
    let quote = value.chars().next().filter(|c| matches!(c, '"' | '\''))?;
    value[1..].split(quote).next().map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marker::drawing::read_drawing;
    use std::fs;
    use std::io::Write;

    const ARROW: &str = r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 100 100"><title>Pfeil für</title><path d="M50 9L80 50H61V91H39V50H20Z"/></svg>"#;

    fn declared(encoding: &str) -> String {
        format!("<?xml version=\"1.0\" encoding='{encoding}' standalone=\"no\"?>{ARROW}")
    }

    fn outline(bytes: &[u8]) -> Result<Vec<[f32; 2]>, String> {
        let drawing = read_drawing("test", &decode(bytes)?).map_err(|e| e.to_string())?;
        Ok(drawing.outline)
    }

    fn latin1(text: &str) -> Vec<u8> {
        text.chars().map(|c| c as u8).collect()
    }

    fn utf16(text: &str, mark: bool, to_bytes: fn(u16) -> [u8; 2]) -> Vec<u8> {
        let mark = mark.then_some(0xfeff);
        mark.into_iter()
            .chain(text.encode_utf16())
            .flat_map(to_bytes)
            .collect()
    }

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(bytes).expect("memory takes everything");
        encoder.finish().expect("memory takes everything")
    }

    #[test]
    fn a_drawing_is_read_in_every_encoding_of_xml() {
        let plain = outline(ARROW.as_bytes()).expect("plain");
        for (what, bytes) in [
            ("UTF-8", declared("UTF-8").into_bytes()),
            (
                "mark",
                [b"\xef\xbb\xbf", declared("utf-8").as_bytes()].concat(),
            ),
            ("Latin 1", latin1(&declared("ISO-8859-1"))),
            ("Latin 9", latin1(&declared("iso-8859-15"))),
            ("Windows", latin1(&declared("Windows-1252"))),
            ("little", utf16(&declared("UTF-16"), true, u16::to_le_bytes)),
            ("big", utf16(&declared("UTF-16"), true, u16::to_be_bytes)),
            (
                "no mark",
                utf16(&declared("UTF-16LE"), false, u16::to_le_bytes),
            ),
            ("undeclared", utf16(ARROW, true, u16::to_be_bytes)),
            ("not in UTF-16", declared("UTF-16").into_bytes()),
            ("gzip", gzip(declared("UTF-8").as_bytes())),
            ("gzip of Latin 1", gzip(&latin1(&declared("latin1")))),
        ] {
            assert_eq!(outline(&bytes), Ok(plain.clone()), "{what}");
        }
    }

    #[test]
    fn what_cannot_be_decoded_is_reported() {
        let large = gzip(&vec![b' '; BYTES_MAX as usize + 1]);
        let cut = gzip(ARROW.as_bytes());
        for (bytes, reason) in [
            (latin1(ARROW), "not valid UTF-8"),
            (declared("klingon").into_bytes(), "\"klingon\" is not known"),
            (large, "more than 4 MiB"),
            (cut[..cut.len() - 9].to_vec(), "compressed, and damaged"),
            (gzip(&gzip(b"x")), "compressed twice"),
            (b"<\0\0\0s\0\0\0".to_vec(), "not valid UTF-16LE"),
        ] {
            let error = decode(&bytes).expect_err(reason);
            assert!(error.contains(reason), "{error}");
        }
    }

    #[test]
    fn folders_are_read_without_hidden_files() {
        let folder = tempfile::tempdir().expect("a folder");
        let write = |name: &str| fs::write(folder.path().join(name), ARROW).expect("written");
        let names = || {
            read_folder(folder.path())
                .map(|files| files.into_iter().map(|f| f.name).collect::<Vec<_>>())
        };
        write("._a.svg");
        write(".svg");
        write("a.svg~");
        fs::create_dir(folder.path().join("drafts.svg")).expect("a folder");
        assert!(matches!(names(), Err(FamilyError::Empty { .. })));
        write("b.SVG");
        write("a.svg");
        assert_eq!(names(), Ok(vec!["a".to_owned(), "b".to_owned()]));
        write("A.svg");
        let error = names().expect_err("alike").to_string();
        assert!(
            error.starts_with("markers \"A.svg\" and \"a.svg\": nobody can tell"),
            "{error}"
        );
        fs::remove_file(folder.path().join("A.svg")).expect("it is there");
        write("c.svgz");
        let error = names().expect_err("compressed").to_string();
        assert!(
            error.contains("c.svgz: a compressed drawing is not read; unpack it into a .svg"),
            "{error}"
        );
    }
}
