//! Every target on its corpus and on a few thousand changes of it, the same in every run: what `make test` fuzzes.
//!
//! `make fuzz` goes further, guided by coverage; `CROSS_FUZZ_INPUTS` and `CROSS_FUZZ_TARGET` make this one longer, or of one
//! target alone.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may panic")]

use cross_fuzz::limits::Counting;
use cross_fuzz::{Outcome, TARGETS, Target, check, corpus};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::mpsc;
use std::time::Duration;

#[global_allocator]
static COUNTING: Counting = Counting;

/// Changed inputs of each target, unless the environment says otherwise. All together take some seconds.
const INPUTS: usize = 10_000;
/// An input that takes so long by the clock hangs; what is slow is found by the time of the processor.
const HANGS: Duration = Duration::from_secs(120);

/// What a target did with its inputs.
#[derive(Debug)]
struct Done {
    name: &'static str,
    inputs: usize,
    accepted: usize,
}

/// Runs one input; a failure leaves it in a file and says which.
fn run(target: &Target, input: &[u8]) -> bool {
    match catch_unwind(AssertUnwindSafe(|| check(target, input))) {
        Ok(outcome) => outcome == Outcome::Accepted,
        Err(_) => {
            let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("failing-{}", target.name));
            std::fs::write(&file, input).unwrap();
            panic!(
                "{} failed; the input is in {}, and belongs into fuzz/corpus/{0}/ with its mending",
                target.name,
                file.display()
            );
        }
    }
}

/// Inputs and what became of them; `begun` learns of each before it runs.
fn fuzz(target: &Target, count: usize, begun: &mpsc::SyncSender<Option<(&'static str, Vec<u8>)>>) -> Done {
    let inputs = corpus::inputs(target).unwrap();
    // What is made once is not the first input's.
    let good: Vec<&Vec<u8>> =
        inputs.iter().filter(|input| (target.run)(input) == Outcome::Accepted).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut done = Done { name: target.name, inputs: 0, accepted: 0 };
    let mut one = |input: Vec<u8>| {
        begun.send(Some((target.name, input.clone()))).unwrap();
        done.inputs += 1;
        done.accepted += usize::from(run(target, &input));
    };
    inputs.iter().cloned().for_each(&mut one);
    for _ in 0..count {
        // Most that libFuzzer found are refused somewhere; half of the changes are of what is not.
        let among_good = rng.random() && !good.is_empty();
        let mut input = if among_good {
            good[rng.random_range(0..good.len())].clone()
        } else {
            inputs[rng.random_range(0..inputs.len())].clone()
        };
        for _ in 0..rng.random_range(1..3) {
            (target.mutate)(&mut input, target.longest, &mut rng);
        }
        one(input);
    }
    done
}

#[test]
fn every_target_keeps_its_promises_on_the_corpus_and_on_changes_of_it() {
    let environment = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
    let count = environment("CROSS_FUZZ_INPUTS").map_or(INPUTS, |count| count.parse().unwrap());
    let name = environment("CROSS_FUZZ_TARGET");
    let chosen = TARGETS.iter().filter(move |target| name.as_deref().is_none_or(|name| target.name == name));
    // One place: the watch below knows which input is running.
    let (begun, watch) = mpsc::sync_channel(0);
    let worker = std::thread::spawn(move || {
        let done: Vec<Done> = chosen.map(|target| fuzz(target, count, &begun)).collect();
        begun.send(None).unwrap();
        done
    });
    let mut running = None;
    loop {
        match watch.recv_timeout(HANGS) {
            Ok(None) | Err(mpsc::RecvTimeoutError::Disconnected) => break,
            Ok(Some(input)) => running = Some(input),
            Err(mpsc::RecvTimeoutError::Timeout) => panic!("an input hangs: {running:?}"),
        }
    }
    let done = worker.join().unwrap();
    assert!(!done.is_empty());
    for done in done {
        println!("{}: {} of {} accepted", done.name, done.accepted, done.inputs);
        assert!(done.inputs > count, "{done:?}");
        // Changes that all break the form would test the first check alone; changes that never do, nothing.
        assert!(done.accepted * 100 >= done.inputs, "too few inputs get through: {done:?}");
        assert!(done.accepted < done.inputs, "nothing is refused: {done:?}");
    }
}

#[test]
fn every_folder_of_the_corpus_is_a_targets_and_the_whole_is_small() {
    let mut bytes = 0;
    for entry in std::fs::read_dir(corpus::folder()).unwrap() {
        let folder = entry.unwrap().path();
        let name = folder.file_name().unwrap().to_str().unwrap().to_owned();
        if cfg!(feature = "checkpoints") {
            assert!(cross_fuzz::target(&name).is_some(), "there is no target {name}");
        }
        for file in std::fs::read_dir(&folder).unwrap() {
            bytes += file.unwrap().metadata().unwrap().len();
        }
    }
    assert!(bytes < 200_000, "{bytes} bytes");
}

#[test]
fn what_breaks_a_promise_is_found() {
    let sound = cross_fuzz::target("traci-values").unwrap();
    let greedy = Target {
        run: |input| {
            std::hint::black_box(vec![0u8; input.len() << 20]);
            Outcome::Accepted
        },
        ..*sound
    };
    let slow = Target {
        run: |_| {
            dawdle();
            Outcome::Accepted
        },
        ..*sound
    };
    for (target, words) in [(greedy, "bytes of memory"), (slow, "are allowed")] {
        let failure = catch_unwind(|| check(&target, b"12")).unwrap_err();
        let text = failure.downcast_ref::<String>().unwrap();
        assert!(text.contains("traci-values") && text.contains(words), "{text}");
    }
    assert_eq!(check(sound, b"12"), Outcome::Refused);
}

/// Keeps the processor busy for longer than any input may.
fn dawdle() {
    let now = || {
        let now = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
        now.tv_sec * 1000 + now.tv_nsec / 1_000_000
    };
    let begun = now();
    while now() - begun < 600 {}
}
