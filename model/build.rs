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
        link_cuda(Path::new(&home));
    }
}

/// libtorch registers CUDA when its CUDA library is loaded, and nothing here calls into that library by name: the linker
/// would leave it out as not needed, and no device would ever be found. Actors do without; loading it takes memory.
fn link_cuda(home: &Path) {
    // Both flavours of the set-up have this file, so that going from one to the other links anew.
    let version = home.join("build-version");
    if version.exists() {
        println!("cargo:rerun-if-changed={}", version.display());
    }
    let actor = std::env::var_os("CARGO_PKG_NAME").is_some_and(|name| name == "cross-actor");
    if !actor && home.join("lib/libtorch_cuda.so").exists() {
        for argument in ["-Wl,--push-state,--no-as-needed", "-ltorch_cuda", "-Wl,--pop-state"] {
            println!("cargo:rustc-link-arg={argument}");
        }
    }
}
