//! `overcam service`: prints a systemd unit that runs the program with the given arguments.
//!
//! The arguments are read through their definition: paths are made absolute, so that the unit does
//! not depend on the current folder.

use std::collections::BTreeSet;
use std::ffi::{OsStr, OsString};
use std::fs;
use std::io::Write;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::builder::ValueParser;
use clap::parser::ValueSource;
use clap::{ArgMatches, Command, CommandFactory, value_parser};

use crate::cli::{Cli, RunArgs};
use crate::config::Arguments;
use crate::output::shared_memory::user_name;
use crate::source::SourceError;

/// Folders of the kernel's stable camera names, preferred ones first.
const STABLE_NAMES: [&str; 2] = ["/dev/v4l/by-id", "/dev/v4l/by-path"];

/// Prints the unit for the arguments of this process, which are `args`.
///
/// # Errors
///
/// If the source is not suitable for a service, or `out` cannot be written.
pub(super) fn print(
    args: &RunArgs,
    arguments: &Arguments,
    out: &mut impl Write,
) -> anyhow::Result<()> {
    if args.source.device == "-" {
        Err(SourceError::Argument {
            device: "-".to_owned(),
            flag: "service",
            kind: "standard input, which a service does not have",
        })?;
    }
    let mut command = Cli::command();
    command.build();
    let (Some(definition), Some(("service", given))) = (
        command.find_subcommand("service"),
        arguments.matches.subcommand(),
    ) else {
        anyhow::bail!("service: its own arguments are not found; please report it");
    };
    let program = std::env::current_exe().context("the path of this program")?;
    let folder = std::env::current_dir().context("the current folder")?;
    let user = user_name(rustix::process::geteuid().as_raw());
    let unit = unit(
        args,
        &command_line(definition, given, &arguments.from_file, &folder),
        &Surroundings {
            program: &program,
            folder: &folder,
            user: &user,
        },
    );
    out.write_all(unit.as_bytes()).context("standard output")
}

/// Folder, program and user for which the unit is printed.
struct Surroundings<'a> {
    program: &'a Path,
    folder: &'a Path,
    user: &'a str,
}

/// The given arguments, in the order of their definition, with absolute paths.
///
/// Arguments in a `--config` file are left there, except for the name of a recording, which must
/// differ from start to start.
fn command_line(
    definition: &Command,
    given: &ArgMatches,
    from_file: &BTreeSet<String>,
    folder: &Path,
) -> Vec<OsString> {
    let is_path = |parser: &ValueParser| {
        let path: ValueParser = value_parser!(PathBuf);
        parser.type_id() == path.type_id()
    };
    let mut words = Vec::new();
    for argument in definition.get_arguments() {
        let id = argument.get_id().as_str();
        let Some(name) = argument.get_long() else {
            continue;
        };
        if given.value_source(id) != Some(ValueSource::CommandLine)
            || (from_file.contains(id) && id != "record")
        {
            continue;
        }
        let takes_value = argument
            .get_num_args()
            .is_some_and(|count| count.takes_values());
        if !takes_value {
            words.push(format!("--{name}").into());
            continue;
        }
        for value in given.get_raw(id).into_iter().flatten() {
            let value = match id {
                "device" => device(value, folder),
                "record" => a_file_a_start(&folder.join(value)),
                _ if is_path(argument.get_value_parser()) => folder.join(value).into(),
                _ => value.to_owned(),
            };
            // As a single word if the value could be mistaken for another argument.
            if value.as_bytes().starts_with(b"-") {
                words.push(
                    [OsStr::new(&format!("--{name}=")), &value]
                        .into_iter()
                        .collect(),
                );
            } else {
                words.extend([format!("--{name}").into(), value]);
            }
        }
    }
    words
}

/// An absolute path; for a camera, the name that does not change when others are plugged in.
fn device(value: &OsStr, folder: &Path) -> OsString {
    if value == "demo" {
        return value.to_owned();
    }
    let path = folder.join(value);
    stable_name(&path, STABLE_NAMES.map(Path::new))
        .unwrap_or(path)
        .into()
}

/// The link to `/dev/videoN`.
fn stable_name(node: &Path, folders: [&Path; 2]) -> Option<PathBuf> {
    let name = node.file_name()?.to_str()?;
    let number = name.strip_prefix("video")?;
    if number.is_empty() || !number.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let node = node.canonicalize().ok()?;
    folders.iter().find_map(|folder| {
        let mut links: Vec<PathBuf> = fs::read_dir(folder)
            .into_iter()
            .flatten()
            .filter_map(|link| Some(link.ok()?.path()))
            .filter(|link| link.canonicalize().is_ok_and(|target| target == node))
            .collect();
        links.sort();
        links.into_iter().next()
    })
}

/// `run-${INVOCATION_ID}.mcap` for `run.mcap`: systemd sets a different id for each start, because
/// a recording is never overwritten. The dollar sign is left to systemd; see [`quoted`].
fn a_file_a_start(path: &Path) -> OsString {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(STARTS);
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    path.with_file_name(name).into()
}

/// systemd replaces it by the id of the start.
const STARTS: &str = "-${INVOCATION_ID}";

fn unit(args: &RunArgs, words: &[OsString], around: &Surroundings<'_>) -> String {
    let mut exec = quoted(around.program.as_os_str(), Dollar::Plain);
    for word in words {
        exec.push(' ');
        exec += &quoted(word, Dollar::Doubled);
    }
    let description = plain(&args.service);
    let (user, whose) = match around.user {
        "root" => ("overcam", user_of_its_own(around.program)),
        user => (user, String::new()),
    };
    let (groups, readers) = groups_and_readers(args, user);
    let files = access_to_files(args, around.folder);
    // The directories of a group pass on its number to new files through the setgid bit.
    let sgid = if args.group.is_none() {
        "RestrictSUIDSGID=yes\n"
    } else {
        ""
    };
    let unit_name = unit_name(&args.service);
    format!(
        "# Install: sudo cp {unit_name}.service /etc/systemd/system/ && sudo systemctl daemon-reload && sudo systemctl enable --now {unit_name}\n\
         # See:     systemctl status {unit_name}; journalctl -u {unit_name} -f\n\
         [Unit]\n\
         Description=overcam, positions of all on the floor ({description})\n\
         # Tried for ever: the camera may come later.\n\
         StartLimitIntervalSec=0\n\
         \n\
         [Service]\n\
         Type=notify\n\
         ExecStart={exec}\n\
         WatchdogSec=30\n\
         Restart=on-failure\n\
         RestartSec=2\n\
         # Wrong arguments stay wrong.\n\
         RestartPreventExitStatus=2\n\
         # Stopped in order, but frames are missing from the recording.\n\
         SuccessExitStatus=3\n\
         \n\
         {whose}{readers}\
         User={user}\n\
         SupplementaryGroups={groups}\n\
         UMask=0027\n\
         RuntimeDirectory=overcam\n\
         RuntimeDirectoryPreserve=yes\n\
         StateDirectory=overcam\n\
         Environment=XDG_STATE_HOME=%S\n\
         # Of a user who logs in and out, systemd removes the shared memory at logout all the same, unless /etc/systemd/logind.conf has\n\
         # RemoveIPC=no. overcam notices it and publishes anew.\n\
         RemoveIPC=no\n\
         \n\
         ProtectSystem=strict\n\
         ProtectHome=read-only\n\
         {files}\
         DevicePolicy=closed\n\
         DeviceAllow=char-video4linux rw\n\
         NoNewPrivileges=yes\n\
         CapabilityBoundingSet=\n\
         ProtectClock=yes\n\
         ProtectHostname=yes\n\
         ProtectControlGroups=yes\n\
         ProtectKernelLogs=yes\n\
         ProtectKernelModules=yes\n\
         ProtectKernelTunables=yes\n\
         RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6\n\
         RestrictNamespaces=yes\n\
         RestrictRealtime=yes\n\
         {sgid}\
         LockPersonality=yes\n\
         MemoryDenyWriteExecute=yes\n\
         SystemCallArchitectures=native\n\
         SystemCallFilter=@system-service\n\
         \n\
         [Install]\n\
         WantedBy=multi-user.target\n"
    )
}

/// The groups of the service, and a comment on who can subscribe.
fn groups_and_readers(args: &RunArgs, user: &str) -> (String, String) {
    match &args.group {
        Some(group) => (
            format!("video {}", plain(group)),
            format!("# Members of the group {} can subscribe.\n", plain(group)),
        ),
        None => (
            "video".to_owned(),
            format!(
                "# Only programs of the user {user} and of root can subscribe; with --group NAME the members of a group can.\n"
            ),
        ),
    }
}

/// The folders that the service writes to, and whether it has a /tmp of its own. `folder` is where
/// relative paths start.
fn access_to_files(args: &RunArgs, folder: &Path) -> String {
    let mut writable = Vec::new();
    if let Some(record) = &args.record {
        let path = folder.join(record);
        let folder = path.parent().unwrap_or(Path::new("/"));
        writable.push(quoted(folder.as_os_str(), Dollar::Plain));
    }
    let tmp = if args.group.is_some() || args.no_publish {
        "PrivateTmp=yes\n"
    } else {
        // iceoryx2 programs find each other through files in /tmp/iceoryx2.
        writable.push("/tmp".to_owned());
        ""
    };
    if writable.is_empty() {
        tmp.to_owned()
    } else {
        format!("ReadWritePaths={}\n{tmp}", writable.join(" "))
    }
}

/// Name of the unit for a service.
fn unit_name(service: &str) -> String {
    if service == scene::DEFAULT_SERVICE {
        service.to_owned()
    } else {
        let name = service.replace(|c: char| !c.is_ascii_alphanumeric() && c != '-', "_");
        format!("overcam-{name}")
    }
}

/// Instructions for running the service as a user of its own.
fn user_of_its_own(program: &Path) -> String {
    let mut text =
        "# A user of its own: sudo useradd --system --no-create-home --groups video overcam\n"
            .to_owned();
    if ["/root", "/home"]
        .iter()
        .any(|home| program.starts_with(home))
    {
        text += "# It may not be able to read the program there; put it elsewhere, as into /usr/local/bin, and print the unit with that.\n";
    }
    text
}

/// How to write a dollar sign.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Dollar {
    /// Unchanged, where nothing is expanded.
    Plain,
    /// Escaped, in an argument, where systemd expands variables; but not in [`STARTS`].
    Doubled,
}

/// A word quoted for a systemd unit.
fn quoted(word: &OsStr, dollar: Dollar) -> String {
    let bytes = word.as_bytes();
    let mut text = String::new();
    let mut rest = bytes;
    while let Some((&byte, after)) = rest.split_first() {
        if dollar == Dollar::Doubled && rest.starts_with(STARTS.as_bytes()) {
            text += STARTS;
            rest = &rest[STARTS.len()..];
            continue;
        }
        rest = after;
        match byte {
            b'%' => text += "%%",
            b'$' if dollar == Dollar::Doubled => text += "$$",
            b'"' => text += "\\\"",
            b'\\' => text += "\\\\",
            b' '..=b'~' => text.push(char::from(byte)),
            // All others byte by byte, so that names need not be UTF-8.
            byte => text += &format!("\\x{byte:02x}"),
        }
    }
    let simple = |byte: &u8| byte.is_ascii_alphanumeric() || b"/._-:=,@+%$".contains(byte);
    // The braces in STARTS.
    if !bytes.is_empty()
        && bytes
            .iter()
            .all(|byte| simple(byte) || b"{}".contains(byte))
    {
        text
    } else {
        format!("\"{text}\"")
    }
}

/// A name for a comment or a list: on one line, and without anything that systemd expands.
fn plain(name: &str) -> String {
    name.chars()
        .filter(|c| !c.is_control())
        .collect::<String>()
        .replace('%', "%%")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn printed(arguments: &[&str], user: &str) -> String {
        let words = [&["overcam", "service"], arguments].concat();
        let arguments = Arguments::parse(words.into_iter().map(OsString::from));
        let arguments = arguments.expect("they are right");
        let Some(crate::cli::Command::Service(args)) = &arguments.cli.command else {
            panic!("another command");
        };
        let mut command = Cli::command();
        command.build();
        let (_, given) = arguments.matches.subcommand().expect("a command");
        let definition = command.find_subcommand("service").expect("it is there");
        let folder = Path::new("/home/ann");
        let around = Surroundings {
            program: Path::new("/opt/over cam/100%/overcam"),
            folder,
            user,
        };
        let words = command_line(definition, given, &arguments.from_file, folder);
        unit(args, &words, &around)
    }

    fn line<'a>(unit: &'a str, key: &str) -> &'a str {
        let found = unit.lines().find_map(|line| line.strip_prefix(key));
        found.unwrap_or_else(|| panic!("no {key} in {unit}"))
    }

    #[test]
    fn arguments_are_those_of_the_call_with_absolute_paths() {
        let unit = printed(
            &[
                "--device=clips/a.y4m",
                "--record",
                "out/run.mcap",
                "--gain=-3",
                "--calibration",
                "my floor.toml",
                "--json",
                "--service",
                "50%$x",
                "--markers",
                "/m/\"quoted\"\\",
            ],
            "ann",
        );
        assert_eq!(
            line(&unit, "ExecStart="),
            "\"/opt/over cam/100%%/overcam\" --device /home/ann/clips/a.y4m --gain=-3 \
             --record /home/ann/out/run-${INVOCATION_ID}.mcap --markers \"/m/\\\"quoted\\\"\\\\\" \
             --calibration \"/home/ann/my floor.toml\" --service 50%%$$x --json"
        );
        assert_eq!(line(&unit, "User="), "ann");
        assert_eq!(line(&unit, "ReadWritePaths="), "/home/ann/out /tmp");
        assert!(unit.contains("(50%%$x)"));
    }

    #[test]
    fn a_file_of_arguments_stays_one() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("lab.toml");
        fs::write(
            &file,
            "threshold = 7\nrecord = \"run.mcap\"\nservice = \"lab\"\n",
        )
        .expect("written");
        let file = file.to_str().expect("text");
        let unit = printed(&["--config", file, "--json"], "ann");
        let folder = folder.path().display();
        assert_eq!(
            line(&unit, "ExecStart="),
            format!(
                "\"/opt/over cam/100%%/overcam\" --config {file} --record {folder}/run-${{INVOCATION_ID}}.mcap --json"
            )
        );
        assert_eq!(line(&unit, "ReadWritePaths="), format!("{folder} /tmp"));
        assert_eq!(
            line(&unit, "Description="),
            "overcam, positions of all on the floor (lab)"
        );
    }

    #[test]
    fn what_is_not_given_is_not_there() {
        let unit = printed(&[], "root");
        assert_eq!(line(&unit, "ExecStart="), "\"/opt/over cam/100%%/overcam\"");
        assert_eq!(line(&unit, "User="), "overcam");
        assert_eq!(line(&unit, "ReadWritePaths="), "/tmp");
        assert!(!unit.contains("PrivateTmp"));
        assert_eq!(line(&unit, "RestrictSUIDSGID="), "yes");
    }

    #[test]
    fn members_of_a_group_meet_outside_of_tmp() {
        let unit = printed(&["--group", "robots", "--device", "demo"], "ann");
        assert_eq!(line(&unit, "SupplementaryGroups="), "video robots");
        assert_eq!(line(&unit, "PrivateTmp="), "yes");
        assert!(!unit.contains("ReadWritePaths"));
        assert!(
            !unit.contains("RestrictSUIDSGID"),
            "it makes directories with that bit"
        );
        assert!(line(&unit, "ExecStart=").ends_with("--device demo --group robots"));
    }

    #[test]
    fn words_survive_systemd() {
        let doubled = |text: &str| quoted(OsStr::new(text), Dollar::Doubled);
        assert_eq!(doubled("/a/b-c_1.mcap"), "/a/b-c_1.mcap");
        assert_eq!(doubled(""), "\"\"");
        assert_eq!(doubled(";"), "\";\"");
        assert_eq!(doubled("a'b"), "\"a'b\"");
        assert_eq!(doubled("${HOME} 5 %"), "\"$${HOME} 5 %%\"");
        assert_eq!(doubled("caf\u{e9}\n"), "\"caf\\xc3\\xa9\\x0a\"");
        assert_eq!(quoted(OsStr::new("/a$b"), Dollar::Plain), "/a$b");
    }

    #[test]
    fn a_camera_is_called_by_the_name_that_it_keeps() {
        let folder = tempfile::tempdir().expect("a folder");
        let (by_id, by_path) = (folder.path().join("by-id"), folder.path().join("by-path"));
        let node = folder.path().join("video3");
        for file in ["video3", "video4", "videofile"] {
            fs::write(folder.path().join(file), b"").expect("written");
        }
        let folders = [by_id.as_path(), by_path.as_path()];
        assert_eq!(stable_name(&node, folders), None);
        for folder in folders {
            fs::create_dir(folder).expect("made");
        }
        let link = |target: &str, link: &Path| {
            std::os::unix::fs::symlink(format!("../{target}"), link).expect("linked");
        };
        link(
            "video3",
            &by_path.join("pci-0000:00:14.0-usb-0:1:1.0-video-index0"),
        );
        assert_eq!(
            stable_name(&node, folders),
            Some(by_path.join("pci-0000:00:14.0-usb-0:1:1.0-video-index0"))
        );
        link("video4", &by_id.join("a-other"));
        link("video3", &by_id.join("usb-Cam_Co_X-video-index0"));
        assert_eq!(
            stable_name(&node, folders),
            Some(by_id.join("usb-Cam_Co_X-video-index0"))
        );
        assert_eq!(stable_name(&folder.path().join("videofile"), folders), None);
    }
}
