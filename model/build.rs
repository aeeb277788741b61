//! Lets the executables find libtorch by themselves, from any folder and without environment variables.
//!
//! The build script of every crate that links libtorch: their `Cargo.toml` name this file.

use std::path::Path;

fn main() {
    println!("cargo:rerun-if-changed=../model/build.rs");
    println!("cargo:rerun-if-env-changed=LIBTORCH");
    // Relative to `target/release` and to `target/release/deps`, so that a checkout may be moved as a whole.
    for origin in ["$ORIGIN/../..", "$ORIGIN/../../.."] {
        println!("cargo:rustc-link-arg=-Wl,-rpath,{origin}/.deps/libtorch/torch/lib");
    }
    // A libtorch elsewhere, or a target directory elsewhere, is found where it was at build time.
    if let Some(home) = std::env::var_os("LIBTORCH") {
        let lib = Path::new(&home).join("lib");
        println!("cargo:rustc-link-arg=-Wl,-rpath,{}", lib.display());
    }
}
