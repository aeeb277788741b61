//! Word from a running benchmark to whoever waits for it.

/// Takes one line at a time; the caller decides where it goes.
pub type Progress<'a> = &'a dyn Fn(&str);
