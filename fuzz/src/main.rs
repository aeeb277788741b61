//! The program that libFuzzer drives: `scripts/fuzz.sh` builds it with coverage and names the target.
#![no_main]

use cross_fuzz::limits::Counting;
use cross_fuzz::{TARGETS, Target, check, target};
use libfuzzer_sys::{Corpus, fuzz_mutator, fuzz_target, fuzzer_mutate};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
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

fuzz_target!(|input: &[u8]| -> Corpus {
    check(&TARGET, input);
    Corpus::Keep
});

fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    let mut rng = ChaCha8Rng::seed_from_u64(seed.into());
    // libFuzzer knows which bytes the program compared with what; the target's own changes know its form.
    if seed % 3 == 0 {
        return fuzzer_mutate(data, size, max_size);
    }
    let mut input = data[..size].to_vec();
    (TARGET.mutate)(&mut input, max_size.min(TARGET.longest), &mut rng);
    data[..input.len()].copy_from_slice(&input);
    input.len()
});
