//! Trains the start weights of `predict`:
//!
//! ```text
//! cargo run --release -p forecast-lab --bin train -- crates/predict/src/forecast/start_weights.bin
//! ```

use std::process::ExitCode;

use forecast_lab::training::{PLAN, stored, train};

fn main() -> ExitCode {
    let Some(file) = std::env::args_os().nth(1) else {
        eprintln!("error: missing argument: the file to write the weights to");
        return ExitCode::from(2);
    };
    let network = train(PLAN, |epoch, loss| {
        eprintln!(
            "epoch {epoch}: position loss {:.4}, ellipse loss {:.4}",
            loss.mixture / loss.n,
            loss.ellipse / loss.n
        );
    });
    if let Err(error) = std::fs::write(&file, stored(&network)) {
        eprintln!("error: cannot write {}: {error}", file.display());
        return ExitCode::FAILURE;
    }
    ExitCode::SUCCESS
}
