//! The command `furrow`.

use std::process::ExitCode;

fn main() -> ExitCode {
    furrow_api::cli::main(std::env::args_os())
}
