//! Builds again when a migration was added: the schema is embedded.

#![allow(clippy::print_stdout)] // How a build script speaks to cargo.

fn main() {
    println!("cargo:rerun-if-changed=../migrations");
}
