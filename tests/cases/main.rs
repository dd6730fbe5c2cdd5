//! Cases from the field, in a folder of their own: `CASES=DIR cargo test --test cases`. Without the variable nothing is tested.

mod calibration;
mod svg;
