//! The `overcam` program: parse, run, exit status.

use std::process::ExitCode;

use overcam::cli::WrongArguments;
use overcam::command::execute;
use overcam::config::{Arguments, ArgumentsError};
use overcam::run::Completion;
use overcam::run::status::{is_broken_pipe, log, one_line};
use overcam::source::SourceError;

/// The arguments contradict each other. Arguments that cannot be parsed give the same status.
const WRONG_ARGUMENTS: u8 = 2;
/// Finished, but frames were lost from the recording.
const FRAMES_LOST: u8 = 3;

fn main() -> ExitCode {
    let arguments = match Arguments::parse(std::env::args_os()) {
        Ok(arguments) => arguments,
        // Prints the error, or the requested help.
        Err(ArgumentsError::CommandLine(error)) => error.exit(),
        Err(ArgumentsError::File(error)) => {
            log(format_args!("overcam: {error}"));
            return ExitCode::from(WRONG_ARGUMENTS);
        }
    };
    match execute(&arguments) {
        Ok(Completion::Done) => ExitCode::SUCCESS,
        Ok(Completion::FramesLost) => ExitCode::from(FRAMES_LOST),
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            log(format_args!("overcam: {}", one_line(&error)));
            match error.downcast_ref() {
                Some(SourceError::Argument { .. }) => ExitCode::from(WRONG_ARGUMENTS),
                _ if error.is::<WrongArguments>() => ExitCode::from(WRONG_ARGUMENTS),
                _ => ExitCode::FAILURE,
            }
        }
    }
}
