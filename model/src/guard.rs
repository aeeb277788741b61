//! Runs work of the trainer so that a failure in it is an error and not the end of the learner.
//!
//! The bindings panic where libtorch throws, and a GPU without memory left must not take the learner down with it. A panic
//! of another kind is a defect of ours; it is told apart, because lowering a batch size would not help against it.

use crate::error::ModelError;
use std::any::Any;
use std::cell::{Cell, RefCell};
use std::panic::{AssertUnwindSafe, PanicHookInfo};
use std::sync::Once;

thread_local! {
    /// Whether this thread is inside [`guarded`].
    static GUARDED: Cell<bool> = const { Cell::new(false) };
    /// Where this thread panicked last inside it.
    static PLACE: RefCell<String> = const { RefCell::new(String::new()) };
}

/// The result of `work`; a panic in it is an error in one line, and gradients are on or off as they were before.
pub(crate) fn guarded<T>(work: impl FnOnce() -> Result<T, ModelError>) -> Result<T, ModelError> {
    keep_quiet();
    // Put back at the end: a panic inside `no_grad` would leave gradients off.
    let _mode = tch::no_grad_guard();
    let outer = GUARDED.replace(true);
    let result = std::panic::catch_unwind(AssertUnwindSafe(|| tch::with_grad(work)));
    GUARDED.set(outer);
    result.unwrap_or_else(|panic| Err(translate(panic.as_ref(), &PLACE.take())))
}

/// The standard hook writes several lines of its own to stderr, among lines of the log that may be JSON. Panics that become
/// errors keep their place in the source for the sentence and say nothing else; all others are reported as ever.
fn keep_quiet() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let others = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info: &PanicHookInfo<'_>| {
            if GUARDED.get() {
                PLACE.set(info.location().map(ToString::to_string).unwrap_or_default());
            } else {
                others(info);
            }
        }));
    });
}

fn translate(panic: &(dyn Any + Send), place: &str) -> ModelError {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic without a message");
    // libtorch's own stack trace follows its first line, in which the bindings' debug form spells line breaks out.
    let first = text.split('\n').next().unwrap_or(text).split("\\n").next().unwrap_or(text);
    // The bindings unwrap the error that holds what libtorch threw; c10 is libtorch's core.
    if text.contains("Torch(\"") || text.contains("c10::") {
        ModelError::Update(first.to_owned())
    } else {
        ModelError::Defect { message: first.to_owned(), place: place.to_owned() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tch::{Device, Kind, Tensor};

    #[test]
    fn what_libtorch_throws_is_an_error_in_one_line() {
        let ones = |rows: i64| Tensor::ones([rows, 2], (Kind::Float, Device::Cpu));
        let error = guarded(|| Ok(tch::no_grad(|| ones(3).matmul(&ones(5))))).unwrap_err();
        let text = error.to_string();
        assert!(matches!(error, ModelError::Update(_)), "{text}");
        assert!(text.contains("shapes") && !text.contains('\n') && text.len() < 400, "{text}");
        let x = ones(1).set_requires_grad(true);
        assert!((&x * 2.0).requires_grad(), "gradients are off after the failure");
        assert!(guarded(|| Ok((&x * 2.0).requires_grad())).unwrap());
    }

    #[test]
    fn any_other_panic_is_a_defect_with_its_place() {
        let rows: Vec<u32> = Vec::new();
        let error = guarded(|| Ok(rows[std::hint::black_box(7)])).unwrap_err();
        let text = error.to_string();
        assert!(matches!(error, ModelError::Defect { .. }), "{text}");
        assert!(text.contains("defect of CROSS") && text.contains("out of bounds"), "{text}");
        assert!(text.contains("guard.rs:") && text.contains("report it") && !text.contains('\n'), "{text}");
        assert!(!text.contains("minibatch_decisions"), "{text}");
    }
}
