//! Damaged images among valid ones: each is skipped, counted and reported.

use std::fmt;

use crate::run::status::log;

/// Maximum number of images reported individually. A long recording may have thousands.
const REPORTED_MAX: u64 = 10;

/// Count of the damaged images of a source.
#[derive(Debug, Default)]
pub(crate) struct Damaged {
    pub(crate) count: u64,
}

impl Damaged {
    /// Counts an image and reports why it is skipped; `what` describes it.
    pub(crate) fn skip(&mut self, what: impl fmt::Display) {
        self.count += 1;
        if self.count <= REPORTED_MAX {
            log(format_args!("overcam: {what}; it is passed over"));
        }
        if self.count == REPORTED_MAX {
            log(format_args!(
                "overcam: further pictures that cannot be read are counted at the end only"
            ));
        }
    }
}
