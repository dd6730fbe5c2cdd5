//! Marker names: they are printed, shown and published, and must distinguish the markers.

use unicode_security::confusable_detection::skeleton;

/// Maximum length in bytes.
const NAME_MAX: usize = scene::NAME_BYTES;

/// Reasons to reject a name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    /// The name is empty.
    #[error("marker: the name is empty; rename the file")]
    Empty,
    /// The name does not fit into a scene.
    #[error("marker {}: the name has {} bytes, at most {NAME_MAX} fit; rename the file", printable(.0), .0.len())]
    TooLong(String),
    /// The name has an invisible character.
    #[error(
        "marker {}: the name contains {character:?}, which cannot be seen; rename the file", printable(.name)
    )]
    Unprintable {
        /// The name.
        name: String,
        /// The first such character.
        character: char,
    },
    /// The name begins or ends with a space.
    #[error("marker {:?}: the name begins or ends with a space; rename the file", .0)]
    Space(String),
    /// Two names are equal, or look alike.
    #[error(
        "markers {first:?} and {second:?}: nobody can tell these names apart; rename one of the files"
    )]
    Alike {
        /// One name.
        first: String,
        /// The other.
        second: String,
    },
}

/// Rejects a name that cannot be displayed or does not fit into a scene. Spaces between words are
/// allowed.
///
/// # Errors
///
/// [`NameError`] with the reason.
pub fn check_name(name: &str) -> Result<(), NameError> {
    if name.is_empty() {
        return Err(NameError::Empty);
    }
    if let Some(character) = name.chars().find(|&c| !is_printable(c)) {
        let name = name.to_owned();
        return Err(NameError::Unprintable { name, character });
    }
    if name.trim() != name {
        return Err(NameError::Space(name.to_owned()));
    }
    if name.len() > NAME_MAX {
        return Err(NameError::TooLong(name.to_owned()));
    }
    Ok(())
}

/// Rejects a name that equals one of `others`, or differs only in case or invisible characters.
///
/// # Errors
///
/// [`NameError::Alike`].
pub fn check_unlike<'a>(
    name: &str,
    others: impl IntoIterator<Item = &'a str>,
) -> Result<(), NameError> {
    match others.into_iter().find(|other| are_alike(other, name)) {
        Some(other) => Err(NameError::Alike {
            first: other.to_owned(),
            second: name.to_owned(),
        }),
        None => Ok(()),
    }
}

/// Whether two names look alike. In ASCII only case is ignored: a family may have the markers O and
/// 0.
fn are_alike(a: &str, b: &str) -> bool {
    let [a, b] = [a, b].map(str::to_lowercase);
    a == b || !(a.is_ascii() && b.is_ascii()) && skeleton(&a).eq(skeleton(&b))
}

/// Whether a character is visible. A combining mark is, on the preceding character.
fn is_printable(character: char) -> bool {
    let shown: String = ['x', character].iter().collect();
    matches!(character, '"' | '\'' | '\\') || !shown.escape_debug().any(|c| c == '\\')
}

/// A name in a form that prints on one line.
fn printable(name: &str) -> String {
    name.chars()
        .map(|c| {
            if is_printable(c) {
                c.to_string()
            } else {
                c.escape_default().to_string()
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_are_seen_and_fit_are_good() {
        let longest = "n".repeat(NAME_MAX);
        for name in [
            "arrow",
            "kitchen robot 2",
            "Pfeil-ü",
            "u\u{308}ber",
            "矢印",
            "🤖",
            "it's",
            &longest,
        ] {
            assert_eq!(check_name(name), Ok(()), "{name}");
        }
    }

    #[test]
    fn names_that_are_not_seen_or_do_not_fit_are_refused() {
        for (name, reason) in [
            ("", "is empty"),
            (" arrow", "begins or ends with a space"),
            ("arrow\n", "marker arrow\\n: the name contains '\\n'"),
            ("a\u{7}b", "contains '\\u{7}'"),
            ("a\tb", "contains '\\t'"),
            ("zero\u{200b}width", "contains '\\u{200b}'"),
            ("\u{202e}worra", "contains '\\u{202e}'"),
            ("no\u{a0}break", "contains '\\u{a0}'"),
            ("lossy\u{fffe}", "cannot be seen"),
            (&"n".repeat(33), "has 33 bytes, at most 32 fit"),
            (&"ü".repeat(17), "has 34 bytes"),
        ] {
            let error = check_name(name).expect_err(name).to_string();
            assert!(error.contains(reason), "{error}");
            assert!(
                !error.contains(['\n', '\t', '\u{200b}', '\u{202e}']),
                "{error:?}"
            );
        }
    }

    #[test]
    fn names_that_look_alike_are_refused() {
        let alike = |a: &str, b: &str| check_unlike(b, [a]).is_err();
        assert!(alike("a", "a") && alike("a", "A") && alike("Über", "über"));
        // Composed and decomposed; a Cyrillic letter.
        assert!(alike("\u{fc}ber", "u\u{308}ber") && alike("arrow", "\u{430}rrow"));
        assert!(!alike("arrow", "arrow2") && !alike("O", "0") && !alike("I", "l"));
        let error = check_unlike("A", ["b", "a"])
            .expect_err("alike")
            .to_string();
        assert_eq!(
            error,
            "markers \"a\" and \"A\": nobody can tell these names apart; rename one of the files"
        );
    }
}
