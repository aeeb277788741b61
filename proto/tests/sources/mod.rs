//! The `.proto` files, compiled as they are now.

#![allow(clippy::unwrap_used, reason = "a test's helper fails the test")]

use std::path::{Path, PathBuf};

/// The folder that imports are relative to.
pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("proto")
}

/// Every `.proto` file below [`root`], sorted, so that a new one is not forgotten.
pub(crate) fn files() -> Vec<PathBuf> {
    let (mut found, mut folders) = (Vec::new(), vec![root()]);
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "proto") {
                found.push(path.strip_prefix(root()).unwrap().to_owned());
            }
        }
    }
    found.sort();
    found
}

/// Their descriptors with imports and comments.
pub(crate) fn descriptors() -> prost_types::FileDescriptorSet {
    let mut compiler = protox::Compiler::new([root()]).unwrap();
    compiler.include_imports(true).include_source_info(true).open_files(files()).unwrap();
    compiler.file_descriptor_set()
}
