//! Pictures that cannot be read among others that can: each is passed over, counted and told.

use std::fmt;

use crate::run::status::log;

/// Most pictures that are told one by one. A long recording may have thousands.
const TOLD_MAX: u64 = 10;

/// The pictures of a source that could not be read.
#[derive(Debug, Default)]
pub(crate) struct Damaged {
    pub(crate) count: u64,
}

impl Damaged {
    /// Counts a picture and says why it is passed over; `what` names it.
    pub(crate) fn skip(&mut self, what: impl fmt::Display) {
        self.count += 1;
        if self.count <= TOLD_MAX {
            log(format_args!("overcam: {what}; it is passed over"));
        }
        if self.count == TOLD_MAX {
            log(format_args!(
                "overcam: further pictures that cannot be read are counted at the end only"
            ));
        }
    }
}
