//! Feeds mutated files to everything that reads files, for some seconds each.
//!
//! usage: `fuzz-loop [--seconds N] [--seed N] [FORMAT...]`, `fuzz-loop --input FORMAT FILE` to
//! repeat a failure, or `fuzz-loop --write-seeds FOLDER` for libFuzzer.
//!
//! The inputs of a seed are always the same. A child reads them, so that the parent sees it panic,
//! abort, hang, or ask for more memory than there is; then the parent makes the input once more,
//! writes it to a file, and fails.

use std::fs::{self, File};
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::process::{Command, ExitCode, ExitStatus, Stdio};
use std::time::{Duration, Instant};
use std::{env, thread};

use fuzz_loop::folder::Folder;
use fuzz_loop::{FORMATS, Format, format, mutation};
use rustix::process::{Resource, Rlimit, setrlimit};

/// Longest time for one input.
const HANG: Duration = Duration::from_secs(10);

/// Most memory of a child, with what the program itself and its threads reserve.
const MEMORY_BYTES: u64 = (1 << 30) + (256 << 20);

/// Where inputs that failed are written.
const FOLDER: &str = "target/fuzz";

struct Wishes {
    seconds: u64,
    seed: u64,
    formats: Vec<&'static Format>,
}

fn main() -> ExitCode {
    let args: Vec<String> = env::args().skip(1).collect();
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let done = match args[..] {
        ["--child", name, seed, seconds, progress] => child(name, seed, seconds, progress),
        ["--input", name, file] => repeat(name, Path::new(file)),
        ["--write-seeds", folder] => write_seeds(Path::new(folder)),
        _ => wishes(&args).map(|wishes| parent(&wishes)),
    };
    match done {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("fuzz-loop: {error}");
            ExitCode::from(2)
        }
    }
}

fn known(name: &str) -> Result<&'static Format, String> {
    let names = FORMATS.map(|format| format.name).join(", ");
    format(name).ok_or_else(|| format!("no format '{name}'; there are {names}"))
}

fn number(text: &str) -> Result<u64, String> {
    text.parse()
        .map_err(|_| format!("'{text}' is no whole number"))
}

fn wishes(args: &[&str]) -> Result<Wishes, String> {
    let mut wishes = Wishes {
        seconds: 10,
        seed: 1,
        formats: Vec::new(),
    };
    let mut args = args.iter();
    while let Some(&arg) = args.next() {
        let mut value = || number(args.next().ok_or(format!("{arg} needs a number"))?);
        match arg {
            "--seconds" => wishes.seconds = value()?,
            "--seed" => wishes.seed = value()?,
            name => wishes.formats.push(known(name)?),
        }
    }
    if wishes.formats.is_empty() {
        wishes.formats = FORMATS.iter().collect();
    }
    Ok(wishes)
}

/// Reads one file; a panic says enough by itself.
fn repeat(name: &str, file: &Path) -> Result<bool, String> {
    let format = known(name)?;
    let bytes = fs::read(file).map_err(|error| format!("{}: {error}", file.display()))?;
    limit_memory()?;
    let is_read = (format.read)(&bytes);
    println!("{name}: {}", if is_read { "read" } else { "refused" });
    Ok(true)
}

/// A folder for each format, as `cargo fuzz` has them.
fn write_seeds(folder: &Path) -> Result<bool, String> {
    for format in &FORMATS {
        let folder = folder.join(format.name);
        let written = fs::create_dir_all(&folder).and_then(|()| {
            (format.seeds)()
                .iter()
                .enumerate()
                .try_for_each(|(i, file)| fs::write(folder.join(i.to_string()), file))
        });
        written.map_err(|error| format!("{}: {error}", folder.display()))?;
    }
    Ok(true)
}

fn limit_memory() -> Result<(), String> {
    let limit = Rlimit {
        current: Some(MEMORY_BYTES),
        maximum: Some(MEMORY_BYTES),
    };
    setrlimit(Resource::As, limit).map_err(|error| format!("no limit of memory: {error}"))
}

/// Reads input after input and writes before each which one it is; at the end, how many were read
/// to their end.
fn child(name: &str, seed: &str, seconds: &str, progress: &str) -> Result<bool, String> {
    let (format, seed, seconds) = (known(name)?, number(seed)?, number(seconds)?);
    let cannot = |error: std::io::Error| format!("{progress}: {error}");
    let progress_file = File::create(progress).map_err(cannot)?;
    let files = (format.seeds)();
    limit_memory()?;
    let end = Instant::now() + Duration::from_secs(seconds);
    let (mut i, mut n_read) = (0_u64, 0_u64);
    while Instant::now() < end || i < files.len() as u64 {
        progress_file
            .write_all_at(&i.to_le_bytes(), 0)
            .map_err(cannot)?;
        n_read += u64::from((format.read)(&mutation::input(format, &files, seed, i)));
        i += 1;
    }
    println!("{name}: {i} inputs, {n_read} of them read to the end");
    Ok(true)
}

/// Runs a child for each format; whether all of them came to their end.
fn parent(wishes: &Wishes) -> bool {
    println!("seed {}", wishes.seed);
    let mut is_well = true;
    for format in &wishes.formats {
        let folder = Folder::new();
        let (progress, errors) = (folder.path().join("progress"), folder.path().join("errors"));
        let child = Command::new(env::current_exe().expect("the program has a path"))
            .args(["--child", format.name])
            .args([wishes.seed.to_string(), wishes.seconds.to_string()])
            .arg(&progress)
            .env("RUST_BACKTRACE", "0")
            .stdin(Stdio::null())
            .stderr(File::create(&errors).expect("a file can be written there"))
            .spawn();
        let failure = watch(child.expect("the program starts"), &progress);
        if let Some(what) = failure {
            tell(format, wishes.seed, &what, &progress, &errors);
            is_well = false;
        }
    }
    is_well
}

/// Which input the child reads.
fn current(progress: &Path) -> Option<u64> {
    let bytes = fs::read(progress).ok()?;
    Some(u64::from_le_bytes(bytes.try_into().ok()?))
}

/// Waits for the child; what went wrong, if something did.
fn watch(mut child: std::process::Child, progress: &Path) -> Option<String> {
    let (mut input, mut since) = (None, Instant::now());
    loop {
        if let Some(status) = child.try_wait().expect("a child can be waited for") {
            return (!status.success()).then(|| ended(status));
        }
        let now = current(progress);
        if now != input {
            (input, since) = (now, Instant::now());
        }
        if since.elapsed() > HANG {
            child.kill().expect("a child can be ended");
            child.wait().expect("a child can be waited for");
            return Some(format!("takes more than {} s", HANG.as_secs()));
        }
        thread::sleep(Duration::from_millis(50));
    }
}

fn ended(status: ExitStatus) -> String {
    format!("ends with {status}")
}

fn tell(format: &Format, seed: u64, what: &str, progress: &Path, errors: &Path) {
    let name = format.name;
    let errors = fs::read_to_string(errors).unwrap_or_default();
    // The last lines are those of the panic; what the readers say comes before.
    let lines: Vec<&str> = errors.lines().collect();
    println!("{}", lines[lines.len().saturating_sub(8)..].join("\n"));
    let Some(i) = current(progress) else {
        println!("FAIL {name}: {what} before the first input");
        return;
    };
    let input = mutation::input(format, &(format.seeds)(), seed, i);
    let file = Path::new(FOLDER).join(format!("{name}-{seed}-{i}"));
    let written = fs::create_dir_all(FOLDER).and_then(|()| fs::write(&file, input));
    written.expect("the input can be written");
    println!("FAIL {name}: input {i} of seed {seed} {what}");
    println!(
        "again: cargo run --bin fuzz-loop -- --input {name} {}",
        file.display()
    );
}
