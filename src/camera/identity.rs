//! Identifies a camera, so that it is found again after it returns, possibly at another node.
//!
//! Node numbers are assigned anew at every boot and every plug. The stable properties are the name
//! of the camera and its port, which the driver states, and the links that udev creates below
//! `/dev/v4l`: by-id, from vendor and serial number, and by-path, from the port.

use std::fs;
use std::path::{Path, PathBuf};

use crate::camera::error::{CameraError, open_error};
use crate::camera::v4l2::{Card, Device};

/// Folders of udev links to nodes, most specific first.
const LINK_FOLDERS: [&str; 2] = ["/dev/v4l/by-id", "/dev/v4l/by-path"];

/// Properties that identify a camera.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Identity {
    /// Path given by the user.
    pub(super) given: PathBuf,
    /// Links to its node below `/dev/v4l`.
    links: Vec<PathBuf>,
    /// The camera's name.
    pub(super) card: String,
    /// Its port.
    pub(super) bus: String,
    /// Index of the node among those of the camera.
    index: Option<String>,
}

impl Identity {
    pub(super) fn new(given: &Path, card: &Card) -> Self {
        Self {
            given: given.to_owned(),
            links: stable_names(given),
            card: card.name.clone(),
            bus: card.bus.clone(),
            index: index(given),
        }
    }

    /// Opens the camera at its current path: the one given by the user, one of its links, or any
    /// node with the same name and port. A link may lead to another port, but not to another
    /// camera.
    ///
    /// # Errors
    ///
    /// The reason why it cannot be opened, or [`CameraError::Missing`].
    pub(super) fn find(&self) -> Result<(Device, PathBuf), CameraError> {
        let mut refusal = CameraError::Missing {
            path: self.given.display().to_string(),
        };
        let nodes = super::nodes(Path::new("/dev"));
        let paths = [&self.given].into_iter().chain(&self.links).chain(&nodes);
        for path in paths {
            let device = match Device::open(path) {
                Ok(device) => device,
                Err(source) => {
                    let error = open_error(path, source);
                    if self.is_named(path) && !matches!(error, CameraError::Missing { .. }) {
                        refusal = error;
                    }
                    continue;
                }
            };
            let is_this = device.card().is_ok_and(|card| {
                let is_at_its_place = card.bus == self.bus && index(path) == self.index;
                super::not_capturing(card.capabilities).is_none()
                    && card.name == self.card
                    && (is_at_its_place || path.is_symlink())
            });
            if is_this {
                return Ok((device, path.clone()));
            }
        }
        Err(refusal)
    }

    fn is_named(&self, path: &Path) -> bool {
        path == self.given || self.links.iter().any(|link| link == path)
    }
}

/// The links below `/dev/v4l` to the node of a path.
pub(crate) fn stable_names(path: &Path) -> Vec<PathBuf> {
    let folders = LINK_FOLDERS.map(Path::new);
    folders
        .iter()
        .flat_map(|folder| links_to(path, folder))
        .collect()
}

/// The links in a folder to the node of a path, sorted by name.
fn links_to(path: &Path, folder: &Path) -> Vec<PathBuf> {
    let Ok(node) = path.canonicalize() else {
        return Vec::new();
    };
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut links: Vec<PathBuf> = entries
        .map(|entry| entry.path())
        .filter(|link| link.canonicalize().is_ok_and(|target| target == node))
        .collect();
    links.sort();
    links
}

/// Index of a node among those of its camera, as counted by the kernel.
fn index(path: &Path) -> Option<String> {
    let node = path.canonicalize().ok()?;
    let folder = Path::new("/sys/class/video4linux").join(node.file_name()?);
    fs::read_to_string(folder.join("index")).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn links_to_a_node_are_found_whatever_name_is_given() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = |name: &str| folder.path().join(name);
        for node in ["video0", "video1"] {
            fs::write(path(node), b"").expect("written");
        }
        fs::create_dir(path("by-path")).expect("made");
        let link = |name: &str, node: &str| {
            symlink(path(node), path("by-path").join(name)).expect("linked")
        };
        link("pci-0000:00:14.0-usb-0:2:1.0-video-index0", "video1");
        link("pci-0000:00:14.0-usb-0:1:1.0-video-index0", "video0");
        link("a-dangling-one", "video7");
        let found = |name: &str| links_to(&path(name), &path("by-path"));
        let expected = path("by-path").join("pci-0000:00:14.0-usb-0:1:1.0-video-index0");
        let given = "by-path/pci-0000:00:14.0-usb-0:1:1.0-video-index0";
        for name in ["video0", given] {
            assert_eq!(found(name), std::slice::from_ref(&expected), "{name}");
        }
        assert!(found("video7").is_empty() && links_to(&path("video0"), &path("none")).is_empty());
    }

    #[test]
    fn a_camera_that_is_not_there_is_missing() {
        let identity = Identity {
            given: "/dev/no-such-camera".into(),
            links: Vec::new(),
            card: "a camera that nobody has".to_owned(),
            bus: String::new(),
            index: None,
        };
        let error = identity.find().expect_err("not there");
        assert!(
            error
                .to_string()
                .starts_with("/dev/no-such-camera: no such camera"),
            "{error}"
        );
    }
}
