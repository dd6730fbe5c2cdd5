//! `overcam devices`: the cameras of this machine, their modes, and their lockable controls.

use std::io::{self, Write};
use std::path::Path;

use crate::camera::controls::Controls;
use crate::camera::negotiation::{readable, text};
use crate::camera::v4l2::{Device, FourCc, Sizes};
use crate::camera::{nodes, not_capturing, open_error, stable_names};

/// Folder of the device nodes.
const FOLDER: &str = "/dev";

/// Prints each camera with its formats, sizes, rates and controls. Nodes that are not cameras or
/// cannot be opened are listed with the reason.
///
/// # Errors
///
/// If writing to `out` fails.
pub fn list(out: &mut impl Write) -> io::Result<()> {
    list_folder(Path::new(FOLDER), out)
}

fn list_folder(folder: &Path, out: &mut impl Write) -> io::Result<()> {
    let nodes = nodes(folder);
    let mut n_cameras = 0;
    for path in &nodes {
        n_cameras += usize::from(describe_node(path, out)?);
    }
    if n_cameras == 0 {
        writeln!(
            out,
            "No camera found: plug one in, and see with `lsusb` and `sudo dmesg` whether the kernel knows it. \
             In a container or virtual machine, its {}/video* must be passed through.",
            folder.display()
        )?;
    }
    Ok(())
}

/// Prints one node and returns whether it is a camera.
fn describe_node(path: &Path, out: &mut impl Write) -> io::Result<bool> {
    let device = match Device::open(path) {
        Ok(device) => device,
        Err(error) => {
            writeln!(out, "{}", open_error(path, error))?;
            return Ok(false);
        }
    };
    let names = stable_names(path);
    let path = path.display();
    let card = match device.card() {
        Ok(card) => card,
        Err(error) => {
            writeln!(out, "{path}: does not answer: {error}")?;
            return Ok(false);
        }
    };
    if let Some(what) = not_capturing(card.capabilities) {
        writeln!(out, "{path}: {}: {what}", card.name)?;
        return Ok(false);
    }
    writeln!(out, "{path}: {} (driver {})", card.name, card.driver)?;
    for name in names {
        writeln!(out, "  the same after every start: {}", name.display())?;
    }
    let (read, others): (Vec<FourCc>, Vec<FourCc>) = device
        .formats()
        .into_iter()
        .partition(|&fourcc| readable(fourcc).is_some());
    for &fourcc in &read {
        describe_format(&device, fourcc, out)?;
    }
    if read.is_empty() {
        writeln!(out, "  no format that overcam reads")?;
    }
    if !others.is_empty() {
        let others: Vec<String> = others.into_iter().map(text).collect();
        writeln!(out, "  not read by overcam: {}", others.join(" "))?;
    }
    let controls = Controls::read(&device).describe();
    if controls.is_empty() {
        writeln!(
            out,
            "  no control of exposure, gain, white balance or focus"
        )?;
    }
    for control in controls {
        writeln!(out, "  {control}")?;
    }
    Ok(true)
}

/// Prints a format, with a line for each size and its rates.
fn describe_format(device: &Device, fourcc: FourCc, out: &mut impl Write) -> io::Result<()> {
    writeln!(out, "  {}", text(fourcc))?;
    for sizes in device.sizes(fourcc) {
        // The rates of a grid are those of its largest size, which all smaller ones also reach.
        let (Sizes::One(size) | Sizes::Grid { max: size, .. }) = sizes;
        let intervals = device.intervals(fourcc, size);
        let rates: Vec<String> = intervals.iter().map(ToString::to_string).collect();
        match rates.as_slice() {
            [] => writeln!(out, "    {sizes}")?,
            rates => writeln!(out, "    {sizes}: {} frames/s", rates.join(", "))?,
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn listed(folder: &Path) -> String {
        let mut out = Vec::new();
        list_folder(folder, &mut out).expect("written");
        String::from_utf8(out).expect("text")
    }

    #[test]
    fn no_camera_says_what_to_check() {
        let folder = tempfile::tempdir().expect("a folder");
        assert!(listed(folder.path()).starts_with("No camera found: plug one in"));
        assert!(listed(&folder.path().join("missing")).starts_with("No camera found"));
    }

    #[test]
    fn nodes_come_in_the_order_of_their_numbers_with_the_reason() {
        let folder = tempfile::tempdir().expect("a folder");
        for name in ["video10", "video2", "videofile", "v4l-subdev0"] {
            fs::write(folder.path().join(name), b"").expect("written");
        }
        std::os::unix::fs::symlink("/dev/null", folder.path().join("video3")).expect("linked");
        let text = listed(folder.path());
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 4, "{text}");
        assert!(lines[0].contains("video2: not a camera but a file"));
        assert!(lines[1].contains("video3: does not answer"));
        assert!(lines[2].contains("video10: not a camera but a file"));
        assert!(lines[3].starts_with("No camera found"));
    }
}
