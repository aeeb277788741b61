//! Keeps the committed generated code equal to what the `.proto` files give, so that building needs no `protoc`.
//!
//! After a change of the schema, rewrite it with
//! `CROSS_REGENERATE=1 cargo test --release -p cross-proto --test bootstrap`.

#![expect(clippy::unwrap_used, reason = "a test's helpers fail the test")]

mod sources;

use prost::Message as _;
use std::collections::BTreeMap;
use std::path::Path;

/// Everything that belongs in `src/generated`, by file name.
fn generate() -> BTreeMap<String, Vec<u8>> {
    // Comments become the documentation of the Rust items and what `grpcurl describe` prints.
    let descriptors = sources::descriptors();
    let out = tempfile::tempdir().unwrap();
    tonic_prost_build::configure()
        .out_dir(out.path())
        // A chunk of weights is shared by all watchers instead of copied for each.
        .bytes(".")
        // Ordered, so that equal messages have equal bytes.
        .btree_map(".")
        .codec_path("crate::codec::MessageCodec")
        .emit_rerun_if_changed(false)
        .compile_fds(descriptors.clone())
        .unwrap();
    let mut files: BTreeMap<String, Vec<u8>> = std::fs::read_dir(out.path())
        .unwrap()
        .map(|entry| entry.unwrap())
        .map(|entry| (entry.file_name().into_string().unwrap(), std::fs::read(entry.path()).unwrap()))
        .filter(|(_, content)| !content.is_empty())
        .collect();
    files.insert("cross.v1.bin".to_owned(), descriptors.encode_to_vec());
    files
}

#[test]
fn generated_code_is_that_of_the_schema() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/generated");
    let files = generate();
    if std::env::var_os("CROSS_REGENERATE").is_some() {
        for (name, content) in &files {
            std::fs::write(folder.join(name), content).unwrap();
        }
    }
    for (name, content) in &files {
        let committed = std::fs::read(folder.join(name)).unwrap_or_default();
        assert!(
            committed == *content,
            "proto/src/generated/{name} is not what the .proto files give; \
             run CROSS_REGENERATE=1 cargo test --release -p cross-proto --test bootstrap and commit the result"
        );
    }
    let committed = std::fs::read_dir(&folder).unwrap().count();
    assert_eq!(committed, files.len(), "proto/src/generated holds files that nothing generates");
}
