//! `--config FILE`: command-line arguments in a TOML file, and `--print-config`, which writes such
//! a file.
//!
//! A key is the long name of an argument with `_` for `-`: `area_min = 80` is `--area-min 80`. The
//! command line has priority over the file, the file over the settings in a recording, and those
//! over the defaults. Relative paths in the file start at the file's folder, so that it can be
//! moved together with the files it names.
//!
//! The keys, their ranges and their comments come from the definition of the arguments
//! ([`cli`](crate::cli)), so both accept the same.

use std::collections::BTreeSet;
use std::ffi::{OsStr, OsString};
use std::fmt;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use clap::builder::ValueParser;
use clap::error::ErrorKind;
use clap::parser::ValueSource;
use clap::{Arg, ArgMatches, Command, CommandFactory, FromArgMatches, value_parser};
use toml::de::{DeTable, DeValue};

use crate::cli::Cli;
use crate::settings::Settings;

/// Arguments that are not allowed in a file.
const NOT_IN_FILES: [&str; 4] = ["help", "version", "config", "print_config"];

/// Arguments of the camera. Those in a file are ignored if the command line has another --device.
const OF_THE_CAMERA: [&str; 8] = [
    "size",
    "rate",
    "format",
    "camera_auto",
    "exposure",
    "gain",
    "white_balance",
    "focus",
];

/// Maximum width of printed comment lines.
const COMMENT_WIDTH: usize = 92;

/// The arguments of the program.
#[derive(Debug)]
pub struct Arguments {
    /// All arguments, including those of the file.
    pub cli: Cli,
    /// The same, as parse results.
    pub matches: ArgMatches,
    /// Names of the arguments that are given only in the file.
    pub from_file: BTreeSet<String>,
}

/// Reasons why there are no arguments.
#[derive(Debug, thiserror::Error)]
pub enum ArgumentsError {
    /// The command line is invalid, or requests help.
    #[error(transparent)]
    CommandLine(#[from] clap::Error),
    /// The file is invalid.
    #[error(transparent)]
    File(#[from] ConfigError),
}

/// An error in a file of arguments.
#[derive(Debug, thiserror::Error)]
#[error("--config {path}: {problem}", path = path.display())]
pub struct ConfigError {
    path: PathBuf,
    problem: Problem,
}

#[derive(Debug, thiserror::Error)]
enum Problem {
    #[error("{0}; overcam --print-config prints a file to start from")]
    Unreadable(io::Error),
    #[error("line {line}: {message}; write it as name = value, and text in quotation marks")]
    Syntax { line: usize, message: String },
    #[error("line {line}: there is no setting {key}{hint}")]
    Unknown {
        line: usize,
        key: String,
        hint: Hint,
    },
    #[error("line {line}: {key} must be {expected}")]
    Type {
        line: usize,
        key: String,
        expected: &'static str,
    },
    #[error("line {line}: {message}")]
    Value { line: usize, message: String },
}

/// The setting that was probably meant.
#[derive(Debug)]
struct Hint(Option<String>);

impl fmt::Display for Hint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.0 {
            Some(key) => write!(f, "; did you mean {key}?"),
            None => f.write_str("; overcam --print-config prints all of them"),
        }
    }
}

impl Arguments {
    /// Parses a command line, whose first word is the program's name, and the file that it names.
    ///
    /// # Errors
    ///
    /// [`ArgumentsError`] if the command line or the file is invalid, or help is requested.
    pub fn parse(words: impl IntoIterator<Item = OsString>) -> Result<Self, ArgumentsError> {
        let mut words: Vec<OsString> = words.into_iter().collect();
        let mut command = Cli::command();
        command.build();
        let mut from_file = BTreeSet::new();
        if let Some(path) = config_path(&words) {
            let asked = innermost(&command, &words);
            let given = Given::new(asked, &words);
            for (name, word) in file_words(Path::new(path), &command)? {
                let known = asked.get_arguments().any(|a| a.get_id() == name.as_str());
                if known && !given.excludes(&name) {
                    words.push(word);
                    from_file.insert(name);
                }
            }
        }
        let matches = command.try_get_matches_from(words)?;
        Ok(Self {
            cli: Cli::from_arg_matches(&matches)?,
            matches,
            from_file,
        })
    }

    /// Writes the arguments of a run and these settings as a file for `--config`. Default values
    /// are written as comments.
    ///
    /// # Errors
    ///
    /// If writing to `out` fails.
    pub fn print(&self, settings: &Settings, out: &mut impl Write) -> io::Result<()> {
        let mut command = Cli::command();
        command.build();
        let default = settings_by_name(&Settings::default());
        let in_force = settings_by_name(settings);
        writeln!(
            out,
            "# Settings of overcam {}, for overcam --config FILE\n#\n\
             # The command line has priority over this file, and this file over a recording that is replayed.\n\
             # A relative path starts at the folder of this file. A line after # is a comment: what is there\n\
             # is the default.",
            env!("CARGO_PKG_VERSION")
        )?;
        for argument in in_files(&command) {
            let name = argument.get_id().as_str();
            let help = argument.get_help().map(ToString::to_string);
            writeln!(out)?;
            for line in wrapped(&help.unwrap_or_default(), COMMENT_WIDTH) {
                writeln!(out, "# {line}")?;
            }
            let is_given = self.matches.value_source(name) == Some(ValueSource::CommandLine);
            if let Some(value) = in_force.get(name) {
                let off = if default.get(name) == Some(value) {
                    "# "
                } else {
                    ""
                };
                writeln!(out, "{off}{name} = {value}")?;
            } else if !takes_value(argument) {
                let off = if is_given { "" } else { "# " };
                writeln!(out, "{off}{name} = true")?;
            } else {
                let off = if is_given { "" } else { "# " };
                let value = self
                    .matches
                    .get_raw(name)
                    .and_then(|mut values| values.next());
                let value = value.map_or_else(|| stand_in(argument), as_toml);
                writeln!(out, "{off}{name} = {value}")?;
            }
        }
        Ok(())
    }
}

/// The arguments of a run that are allowed in a file.
fn in_files(command: &Command) -> impl Iterator<Item = &Arg> {
    command
        .get_arguments()
        .filter(|a| a.get_long().is_some() && !NOT_IN_FILES.contains(&a.get_id().as_str()))
}

fn takes_value(argument: &Arg) -> bool {
    argument
        .get_num_args()
        .is_some_and(|count| count.takes_values())
}

fn is_path(argument: &Arg) -> bool {
    let path: ValueParser = value_parser!(PathBuf);
    argument.get_value_parser().type_id() == path.type_id()
}

/// The value of `--config`.
fn config_path(words: &[OsString]) -> Option<&OsStr> {
    let mut words = words.iter().skip(1);
    while let Some(word) = words.next() {
        if word == "--config" {
            return words.next().map(OsString::as_os_str);
        }
        if let Some(path) = word
            .to_str()
            .and_then(|word| word.strip_prefix("--config="))
        {
            return Some(OsStr::new(path));
        }
    }
    None
}

/// The command selected by the words.
fn innermost<'a>(command: &'a Command, words: &[OsString]) -> &'a Command {
    let mut asked = command;
    for word in words.iter().skip(1) {
        match asked.find_subcommand(word) {
            Some(inner) => asked = inner,
            None => break,
        }
    }
    asked
}

/// The arguments on the command line.
struct Given<'a> {
    command: &'a Command,
    names: Vec<String>,
}

impl<'a> Given<'a> {
    fn new(command: &'a Command, words: &[OsString]) -> Self {
        let longs = words.iter().filter_map(|word| {
            let long = word.to_str()?.strip_prefix("--")?;
            long.split('=').next()
        });
        let names = longs.filter_map(|long| {
            let mut arguments = command.get_arguments();
            let argument = arguments.find(|argument| argument.get_long() == Some(long))?;
            Some(argument.get_id().to_string())
        });
        Self {
            command,
            names: names.collect(),
        }
    }

    /// Whether the command line has this argument, or one that conflicts with it.
    fn excludes(&self, name: &str) -> bool {
        let is_given = |argument: &Arg| self.names.iter().any(|name| argument.get_id() == name);
        if OF_THE_CAMERA.contains(&name) && self.names.iter().any(|name| name == "device") {
            return true;
        }
        let conflicts = |argument: &Arg, name: &str| {
            self.command
                .get_arg_conflicts_with(argument)
                .iter()
                .any(|other| other.get_id() == name)
        };
        let mut arguments = self.command.get_arguments().filter(|a| is_given(a));
        arguments.any(|given| {
            given.get_id() == name
                || conflicts(given, name)
                || self
                    .command
                    .get_arguments()
                    .filter(|argument| argument.get_id() == name)
                    .any(|argument| conflicts(argument, given.get_id().as_str()))
        })
    }
}

/// The file's arguments: the name of each, and its word on a command line.
fn file_words(path: &Path, command: &Command) -> Result<Vec<(String, OsString)>, ConfigError> {
    let error = |problem| ConfigError {
        path: path.to_owned(),
        problem,
    };
    let text = fs::read_to_string(path).map_err(|e| error(Problem::Unreadable(e)))?;
    let line_at = |at: usize| 1 + text[..at.min(text.len())].matches('\n').count();
    let table = DeTable::parse(&text).map_err(|e| {
        error(Problem::Syntax {
            line: line_at(e.span().map_or(0, |span| span.start)),
            message: e.message().replace('\n', " "),
        })
    })?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut words = Vec::new();
    for (key, value) in table.into_inner() {
        let line = line_at(key.span().start);
        let key = key.into_inner().into_owned();
        let Some(argument) = in_files(command).find(|a| a.get_id() == key.as_str()) else {
            let hint = Hint(nearest(&key, command));
            return Err(error(Problem::Unknown { line, key, hint }));
        };
        let wrong_type = |expected| {
            error(Problem::Type {
                line,
                key: key.clone(),
                expected,
            })
        };
        let long = argument.get_long().unwrap_or_default();
        let word: OsString = match (value.into_inner(), takes_value(argument)) {
            (DeValue::Boolean(true), false) => format!("--{long}").into(),
            (DeValue::Boolean(false), false) => continue,
            (_, false) => return Err(wrong_type("true or false")),
            (DeValue::String(text), true) => {
                let starts_in_folder = is_path(argument)
                    || (key == "device" && !["demo", "-"].contains(&text.as_ref()));
                let mut word = OsString::from(format!("--{long}="));
                if starts_in_folder {
                    word.push(folder.join(&*text));
                } else {
                    word.push(&*text);
                }
                word
            }
            (DeValue::Integer(number), true) if number.radix() == 10 => {
                format!("--{long}={}", number.as_str()).into()
            }
            (DeValue::Float(number), true) => format!("--{long}={}", number.as_str()).into(),
            (_, true) => return Err(wrong_type("a number, or text in quotation marks")),
        };
        if let Some(message) = refusal(command, &word) {
            return Err(error(Problem::Value { line, message }));
        }
        words.push((key, word));
    }
    Ok(words)
}

/// Why an argument's value is invalid, independently of the other arguments.
fn refusal(command: &Command, word: &OsStr) -> Option<String> {
    let words = [OsStr::new("overcam"), word];
    let error = command.clone().try_get_matches_from(words).err()?;
    match error.kind() {
        ErrorKind::ValueValidation | ErrorKind::InvalidValue => {
            let text = error.to_string();
            let line = text.lines().next().unwrap_or_default();
            Some(line.trim_start_matches("error: ").to_owned())
        }
        _ => None,
    }
}

/// The key most similar to an unknown one, if there is one.
fn nearest(wrong: &str, command: &Command) -> Option<String> {
    let wrong = wrong.to_lowercase().replace('-', "_");
    in_files(command)
        .map(|argument| argument.get_id().as_str())
        .map(|key| (strsim::normalized_damerau_levenshtein(&wrong, key), key))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .filter(|&(likeness, _)| likeness >= 0.5)
        .map(|(_, key)| key.to_owned())
}

/// Settings keyed by the names of their arguments.
fn settings_by_name(settings: &Settings) -> toml::Table {
    toml::Table::try_from(settings).unwrap_or_default()
}

/// A value in TOML: numbers unchanged, everything else in quotation marks.
fn as_toml(value: &OsStr) -> String {
    let text = value.to_string_lossy();
    let is_number = format!("x = {text}")
        .parse::<toml::Table>()
        .is_ok_and(|table| matches!(table["x"], toml::Value::Integer(_) | toml::Value::Float(_)));
    if is_number {
        text.into_owned()
    } else {
        toml::Value::String(text.into_owned()).to_string()
    }
}

/// What a comment shows for an argument without a default.
fn stand_in(argument: &Arg) -> String {
    let names = argument.get_value_names().unwrap_or_default();
    format!("<{}>", names.first().map_or("VALUE", |name| name.as_str()))
}

/// Wraps text to lines of at most `width` characters, at word boundaries.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Parses a command line with a file `lab.toml` of this text; `LAB` stands for its path.
    fn parse(text: &str, words: &[&str]) -> Result<Arguments, ArgumentsError> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("lab.toml");
        fs::write(&path, text).expect("written");
        let words = words.iter().map(|&word| match word {
            "LAB" => path.clone().into_os_string(),
            word => word.into(),
        });
        Arguments::parse(std::iter::once("overcam".into()).chain(words))
    }

    fn problem(text: &str) -> String {
        let error = parse(text, &["--config", "LAB"]).expect_err(text);
        assert!(matches!(error, ArgumentsError::File(_)), "{error}");
        let message = error.to_string();
        assert_eq!(message.lines().count(), 1, "{message}");
        message
    }

    fn printed(arguments: &Arguments) -> String {
        let mut out = Vec::new();
        let settings = arguments.cli.run.settings(Settings::default());
        arguments.print(&settings, &mut out).expect("written");
        String::from_utf8(out).expect("text")
    }

    #[test]
    fn the_file_is_read_and_the_command_line_has_priority() {
        let text =
            "threshold = 7.5\narea_min = 200\njson = true\nno_wait = false\nservice = \"lab\"\n";
        let arguments = parse(text, &["--config", "LAB", "--area-min", "90"]).expect("right");
        let run = &arguments.cli.run;
        assert_eq!((run.threshold, run.area_min), (Some(7.5), Some(90)));
        assert!(run.json && !run.no_wait);
        assert_eq!(run.service, "lab");
        let from_file: Vec<_> = arguments.from_file.iter().map(String::as_str).collect();
        assert_eq!(from_file, ["json", "service", "threshold"]);
    }

    #[test]
    fn an_argument_that_excludes_one_of_the_file_replaces_it() {
        let background = parse("learn = 60", &["--config=LAB"]).map(|a| a.cli.run.learn);
        assert!(background.is_err(), "LAB is only replaced as a word");
        let run = |text, words: &[&str]| parse(text, words).expect("right").cli.run;
        let args = run("learn = 60", &["--config", "LAB", "--background", "f.png"]);
        assert_eq!(args.learn, None);
        let args = run(
            "background = \"f.png\"",
            &["--learn", "60", "--config", "LAB"],
        );
        assert_eq!(args.background, None);
    }

    #[test]
    fn an_argument_may_need_one_of_the_file() {
        let words = ["--config", "LAB", "--record-jpeg", "90"];
        let arguments = parse("record = \"a.mcap\"", &words).expect("right");
        assert_eq!(arguments.cli.run.record_jpeg, Some(90));
    }

    #[test]
    fn paths_start_at_the_folder_of_the_file() {
        let text = "region = \"r.png\"\ncalibration = \"/abs.toml\"\ndevice = \"run.mcap\"\n";
        let run = parse(text, &["--config", "LAB"]).expect("right").cli.run;
        let region = run.region.expect("given");
        assert!(region.is_absolute() && region.ends_with("r.png"));
        assert_eq!(run.calibration, Some("/abs.toml".into()));
        assert!(Path::new(&run.source.device).is_absolute());
        let run = parse("device = \"demo\"", &["--config", "LAB"])
            .expect("right")
            .cli
            .run;
        assert_eq!(run.source.device, "demo");
    }

    #[test]
    fn values_of_the_camera_are_not_used_for_another_device() {
        let text = "device = \"/dev/video0\"\nrate = 60\nexposure = 2000\nthreshold = 7\n";
        let words = ["--config", "LAB", "--device", "run.mcap"];
        let run = parse(text, &words).expect("right").cli.run;
        assert_eq!(run.source.device, "run.mcap");
        assert_eq!((run.source.rate, run.source.exposure), (None, None));
        assert_eq!(run.threshold, Some(7.0));
    }

    #[test]
    fn a_subcommand_takes_what_it_knows() {
        let text = "device = \"/dev/video3\"\nexposure = 2000\nthreshold = 7\n";
        let words = ["background", "--config", "LAB", "-o", "floor.png"];
        let arguments = parse(text, &words).expect("right");
        let Some(crate::cli::Command::Background(args)) = arguments.cli.command else {
            panic!("another command");
        };
        assert_eq!(args.source.device, "/dev/video3");
        assert_eq!(args.source.exposure, Some(2000));
    }

    #[test]
    fn problems_are_named_with_their_line() {
        for (text, line, words) in [
            ("\n\ntreshold = 5\n", 3, "did you mean threshold?"),
            ("area-min = 5", 1, "did you mean area_min?"),
            ("qqqq = 5", 1, "--print-config"),
            ("learn = 30\nthreshold = 0.0", 2, "give a number from"),
            ("threshold = \"five\"", 1, "give a number from"),
            ("threshold = [5]", 1, "must be a number"),
            ("json = 1", 1, "true or false"),
            ("# a lab\nthreshold 5", 2, "name = value"),
            ("device = demo", 1, "quotation marks"),
            ("learn = 30\nlearn = 31", 2, "duplicate key"),
            ("[camera]\nexposure = 3", 1, "no setting camera"),
            ("config = \"x.toml\"", 1, "no setting config"),
        ] {
            let message = problem(text);
            assert!(message.contains(&format!("line {line}: ")), "{message}");
            assert!(message.contains(words), "{message}");
        }
        let missing = Arguments::parse(["overcam", "--config", "/no/lab.toml"].map(Into::into));
        let message = missing.expect_err("missing").to_string();
        assert!(
            message.starts_with("--config /no/lab.toml: No such file"),
            "{message}"
        );
    }

    #[test]
    fn what_is_printed_is_read_back() {
        let words = [
            "--threshold",
            "7.25",
            "--region",
            "/r \"1\".png",
            "--json",
            "--size",
            "640x480",
            "--gain=-3",
            "--lost-after",
            "1.5",
            "--plate",
            "80",
        ];
        let words = words.map(OsString::from);
        let arguments = Arguments::parse(std::iter::once("overcam".into()).chain(words));
        let first = printed(&arguments.expect("right"));
        for line in [
            "threshold = 7.25",
            "region = '/r \"1\".png'",
            "json = true",
            "size = \"640x480\"",
            "gain = -3",
            "plate = 80.0",
            "# area_min = 80",
            "# device = \"demo\"",
        ] {
            assert!(
                first.lines().any(|l| l == line),
                "no line {line} in\n{first}"
            );
        }
        let again = parse(&first, &["--config", "LAB"]).expect("it is right");
        assert_eq!(printed(&again), first);
        // The values in comments are valid and equal the defaults.
        let uncommented: String = first
            .lines()
            .filter(|line| !line.contains('<') && line.contains(" = "))
            .filter(|line| {
                ["camera_auto", "no_", "learn"]
                    .iter()
                    .all(|name| !line.contains(name))
            })
            .map(|line| format!("{}\n", line.trim_start_matches("# ")))
            .collect();
        let all = parse(&uncommented, &["--config", "LAB"]).expect("it is right");
        let settings = |arguments: &Arguments| arguments.cli.run.settings(Settings::default());
        assert_eq!(settings(&all), settings(&again));
    }
}
