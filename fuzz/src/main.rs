//! The program that libFuzzer drives: `scripts/fuzz.sh` builds it with coverage and names the target.
#![no_main]

use cross_fuzz::limits::Counting;
use cross_fuzz::{TARGETS, Target, check, target};
use libfuzzer_sys::{Corpus, fuzz_mutator, fuzz_target, fuzzer_mutate};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use std::sync::LazyLock;

#[global_allocator]
static COUNTING: Counting = Counting;

/// The one to fuzz, by the environment: libFuzzer keeps the arguments for itself.
static TARGET: LazyLock<&Target> = LazyLock::new(|| {
    let name = std::env::var("CROSS_FUZZ_TARGET").unwrap_or_default();
    let known = TARGETS.iter().map(|target| target.name).collect::<Vec<_>>().join(", ");
    let target = target(&name);
    assert!(target.is_some(), "CROSS_FUZZ_TARGET is {name:?}; it may be one of {known}");
    let target = target.unwrap_or(&TARGETS[0]);
    // What is made once is not the first input's.
    for input in (target.written)() {
        let _ = (target.run)(&input);
    }
    target
});

/// Puts what our own writers make where libFuzzer looks for its first inputs.
fn write_seeds() {
    let Some(folder) = std::env::var_os("CROSS_FUZZ_SEEDS") else { return };
    for (number, input) in (TARGET.written)().iter().enumerate() {
        let file = Path::new(&folder).join(format!("written-{number}"));
        let written = std::fs::write(&file, input);
        assert!(written.is_ok(), "cannot write {}", file.display());
    }
}

fuzz_target!(init: write_seeds(), |input: &[u8]| -> Corpus {
    check(&TARGET, input);
    Corpus::Keep
});

fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    let mut rng = ChaCha8Rng::seed_from_u64(seed.into());
    let most = max_size.min(TARGET.longest).max(size);
    // libFuzzer knows which bytes the program compared with what; the target's own changes know its form.
    if seed % 3 == 0 {
        return fuzzer_mutate(data, size, most);
    }
    let mut input = data[..size].to_vec();
    (TARGET.mutate)(&mut input, most, &mut rng);
    data[..input.len()].copy_from_slice(&input);
    input.len()
});
